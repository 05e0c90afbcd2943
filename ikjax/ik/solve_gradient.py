"""Derivatives of joints and margins: one rule for every family, by the implicit function theorem.

The algebra of the branches is never differentiated for joints. A slot that reaches its goal keeps reaching
it, so its joints move by dq = J^+ (motion of the goal - motion of the tool by the arm's numbers at fixed
joints),

    J^+ = (J^T J + damping^2 I)^-1 J^T,

with lengths as shares of the reach, and only the rows that the task asks for. Far from a singularity this is
the derivative, to (damping / sigma_min)^2. At a singularity it is finite: the least motion that follows.
Slots that do not reach their goal have zero derivatives. Margins are differentiated as they are computed.

Source: the implicit function theorem; damped least squares after Wampler (1986), Nakamura and
Hanafusa (1986).
"""

import functools

import jax
import jax.numpy as jnp
import numpy as np
from jax.custom_derivatives import SymbolicZero

from ikjax.arm import twists
from ikjax.arm.arm import Arm
from ikjax.arm.forward import chain, fixed_pose, reach
from ikjax.core import pose as poses
from ikjax.core.linear import dot, solve_symmetric
from ikjax.core.tolerances import GRADIENT_DAMPING
from ikjax.core.trig import Scalar
from ikjax.core.xla import divider, in_blocks, opaque_one, pinning
from ikjax.ik.inline import entries_of, rows_of, slots_of

BLOCK = 4096
"""Goals whose derivatives are computed at a time."""

Known = tuple
"""The leaves of an arm that are not traced; see `Arm.split`."""


def with_derivatives(
    arm: Arm,
    goals: jax.Array,
    q: jax.Array,
    valid: jax.Array,
    margin: jax.Array,
    damping: float | None,
) -> tuple[jax.Array, jax.Array]:
    """Joints and margins as they are, with their derivatives in the arm and the goals.

    Args:
        arm: Its leaves may be traced.
        goals: T_world_tool, (..., 4, 4).
        q, valid, margin: The fields of `Solutions`, (..., S, n) and (..., S), without derivatives.
        damping: Of the pseudo-inverse; None is `GRADIENT_DAMPING` square roots of the rounding.

    Returns:
        q and margin.
    """
    if damping is None:
        damping = GRADIENT_DAMPING * float(jnp.finfo(q.dtype).eps) ** 0.5
    known, leaves = arm.split(whole=True)

    return (
        _joints(known, damping, leaves, goals, q, valid),
        _margins(known, leaves, goals, margin),
    )


@functools.partial(jax.custom_jvp, nondiff_argnums=(0, 1))
def _joints(known: Known, damping: float, leaves: list, goals, q, valid):
    """The joints q as they are; their derivatives are those of `_joints_jvp`."""
    return q


def _joints_jvp(known: Known, damping: float, primals, tangents):
    leaves, goals, q, valid = primals
    # Applied again, so that q has derivatives in derivatives of second order.
    q = _joints(known, damping, leaves, goals, q, valid)
    # Where no number of the arm changes, nothing is computed for the arm.
    arm_is_fixed = all(isinstance(rate, SymbolicZero) for rate in tangents[0])
    leaf_rates = [np.zeros(x.shape, x.dtype) if isinstance(x, SymbolicZero) else x for x in tangents[0]]

    def motion(goal_rates, q, valid):
        if arm_is_fixed and goal_rates is None:
            return jnp.zeros_like(q)
        arm = Arm.join(known, leaves)
        arm_rates = None if arm_is_fixed else _arm_of_rates(known, leaf_rates)
        return _joint_rates(arm, arm_rates, goal_rates, q, valid, damping)

    goal_rates = None if isinstance(tangents[1], SymbolicZero) else tangents[1]
    return q, in_blocks(motion, valid.shape[:-1], (goal_rates, q, valid), BLOCK)


_joints.defjvp(_joints_jvp, symbolic_zeros=True)


def _arm_of_rates(known: Known, leaf_rates: list) -> Arm:
    """An arm whose leaves are rates: those of the traced leaves, and zeros for leaves that are known."""
    form, parts = known
    rates = [
        rate if known_entries is None else np.zeros(shape, dtype)
        for (shape, dtype, known_entries, _), rate in zip(parts, leaf_rates, strict=True)
    ]
    return jax.tree.unflatten(form, rates)


@functools.partial(jax.custom_jvp, nondiff_argnums=(0,))
def _margins(known: Known, leaves: list, goals, margin):
    """The margins as they are; their derivatives are those of the rule below."""
    return margin


@_margins.defjvp
def _margins_jvp(known: Known, primals, tangents):
    leaves, goals, margin = primals

    def computed(leaves, goals):
        with pinning(divider(goals[..., 0, 3])):
            arm, entries = Arm.join(known, leaves), entries_of(goals)
            rows = rows_of(arm, entries, None, None)
            if rows is not None:
                return jnp.moveaxis(rows.margin, 0, -1)
            slots = slots_of(arm, entries, None, None)
        return jnp.stack([jnp.broadcast_to(s.margin, goals.shape[:-2]) for s in slots], axis=-1)

    _, rate = jax.jvp(computed, (leaves, goals), tangents[:2])
    return _margins(known, leaves, goals, margin), rate


def _joint_rates(
    arm: Arm,
    arm_rates: Arm | None,
    goal_rates: jax.Array | None,
    q: jax.Array,
    valid: jax.Array,
    damping: float,
) -> jax.Array:
    """Rates of the joints (..., S, n) for rates of the goals and of the arm's numbers.

    Inside, slots are the first axis, so that each number is one array (S, ...).

    Args:
        arm: The arm.
        arm_rates: An arm whose leaves are rates; None for zero.
        goal_rates: (..., 4, 4); None for zero.
        q: (..., S, n).
        valid: (..., S); elsewhere the rates are zero.
        damping: Of the pseudo-inverse.
    """
    count = q.shape[-2]

    def slots_first(x):
        return jnp.stack([x[..., s] for s in range(count)])

    # Of the whole shape: XLA turns a division by a number that is broadcast into a multiplication.
    one = opaque_one(slots_first(q[..., 0]))

    def divide(x: Scalar) -> Scalar:
        return x if not isinstance(x, jax.Array) else x / one

    joints = tuple(slots_first(q[..., i]) for i in range(arm.n))
    with pinning(divide):
        kinematics = chain(arm, joints)
    reached = poses.compose(kinematics.last, fixed_pose(arm.tool))
    twist = twists.ZERO
    if goal_rates is not None:
        rows = tuple(tuple(x[None] for x in row) for row in entries_of(goal_rates)[:3])
        # The reached rotation and not the goal's, which may be anything where no slot is valid.
        angular = twists.angular_velocity(reached.rotation, tuple(row[:3] for row in rows))
        twist = twists.Twist(tuple(row[3] for row in rows), angular)
    if arm_rates is not None:
        arm_twist = twists.parameter_twist(arm, arm_rates, joints, kinematics, reached.position)
        twist = twist.plus(arm_twist.times(-1.0))
    size = reach(arm)
    task_rows = twists.task_rows(arm, kinematics, 1 / size)
    wanted = [divide(x) for x in task_rows(twist)]
    # The value of a slide counts in reaches too.
    units = [size if kind == "P" else 1.0 for kind in arm.kinds]
    motions = zip(units, twists.motor_twists(arm, kinematics, reached.position), strict=True)
    columns = [[divide(x) for x in task_rows(motion.times(unit))] for unit, motion in motions]
    # The normal equations of damped least squares, (J^T J + damping^2 I) x = J^T wanted.
    matrix = [[divide(dot(u, v)) for v in columns] for u in columns]
    for i in range(arm.n):
        matrix[i][i] = matrix[i][i] + damping * damping
    invalid = ~slots_first(valid)
    right = [dot(u, wanted) for u in columns]
    # What no rate enters is a known zero. jax transposes the solution only if each entry depends on a rate.
    zero = 0 * sum(x for x in wanted if isinstance(x, jax.Array))
    right = [x if isinstance(x, jax.Array) else x + zero for x in right]
    right = [divide(jnp.broadcast_to(x, invalid.shape)) for x in right]

    def solve(_, b):
        with pinning(divide):
            return solve_symmetric(matrix, b)

    steps = jax.lax.custom_linear_solve(
        lambda x: [dot(row, x) for row in matrix], right, solve, symmetric=True
    )
    rates = [jnp.where(invalid, 0, unit * step) for unit, step in zip(units, steps, strict=True)]
    return jnp.stack([jnp.moveaxis(jnp.broadcast_to(x, invalid.shape), 0, -1) for x in rates], axis=-1)
