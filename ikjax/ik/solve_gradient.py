"""Slopes of joints and margins: one implicit rule for every family.

The branch algebra is never differentiated for joints. A slot that reaches its goal keeps
reaching it, so its joints move by dq = J^+ (what the goal moved - what the arm moved at fixed joints),

    J^+ = (J^T J + damping^2 I)^-1 J^T,

with lengths as shares of the reach and only the rows that the task asks for. Far from a singularity
that is the derivative, to (damping / sigma_min)^2; at one it is finite, the least motion that follows.
Slots that reach nothing stand still. Margins are differentiated as they are written.

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
from ikjax.ik.inline import entries_of, slots_of

BLOCK = 4096
"""Goals whose slopes are worked on at a time."""

Known = tuple
"""The leaves of an arm that are not traced; see `Arm.split`."""


def with_slopes(arm: Arm, goals: jax.Array, q, valid, margin, damping: float | None):
    """Joints and margins as they are, with their derivatives in the arm and the goals.

    Args:
        arm: Its leaves may be traced.
        goals: (..., 4, 4).
        q, valid, margin: Of `Solutions`, without derivatives.
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
    return q


def _slope_of_joints(known: Known, damping: float, primals, tangents):
    leaves, goals, q, valid = primals
    # Joints with their slopes, for slopes of this slope.
    q = _joints(known, damping, leaves, goals, q, valid)
    # Numbers that stand still are zeros which need not be computed with.
    still = all(isinstance(rate, SymbolicZero) for rate in tangents[0])
    leaf_rates = [np.zeros(x.shape, x.dtype) if isinstance(x, SymbolicZero) else x for x in tangents[0]]

    def motion(goal_rates, q, valid):
        if still and goal_rates is None:
            return jnp.zeros_like(q)
        arm = Arm.join(known, leaves)
        arm_rates = None if still else _arm_of_rates(known, leaf_rates)
        return _motion(arm, arm_rates, goal_rates, q, valid, damping)

    goal_rates = None if isinstance(tangents[1], SymbolicZero) else tangents[1]
    return q, in_blocks(motion, valid.shape[:-1], (goal_rates, q, valid), BLOCK)


_joints.defjvp(_slope_of_joints, symbolic_zeros=True)


def _arm_of_rates(known: Known, leaf_rates: list) -> Arm:
    """The rates of the traced leaves, and zeros for those that are known."""
    form, parts = known
    rates = [
        rate if keep is None else np.zeros(shape, dtype)
        for (shape, dtype, keep, _), rate in zip(parts, leaf_rates, strict=True)
    ]
    return jax.tree.unflatten(form, rates)


@functools.partial(jax.custom_jvp, nondiff_argnums=(0,))
def _margins(known: Known, leaves: list, goals, margin):
    return margin


@_margins.defjvp
def _(known: Known, primals, tangents):
    leaves, goals, margin = primals

    def written(leaves, goals):
        with pinning(divider(goals[..., 0, 3])):
            slots = slots_of(Arm.join(known, leaves), entries_of(goals), None, None)
        return jnp.stack([jnp.broadcast_to(s.margin, goals.shape[:-2]) for s in slots], axis=-1)

    _, slope = jax.jvp(written, (leaves, goals), tangents[:2])
    return _margins(known, leaves, goals, margin), slope


def _motion(arm: Arm, arm_rates: Arm | None, goal_rates, q, valid, damping):
    """How the joints move, (..., S, n). Slots lead, so that each number is one array (S, ...).

    Rates of None are zero.
    """
    count = q.shape[-2]

    def slots_first(x):
        return jnp.stack([x[..., s] for s in range(count)])

    # Of the whole shape: a division by a number that is spread out becomes a multiplication.
    one = opaque_one(slots_first(q[..., 0]))

    def divide(x: Scalar) -> Scalar:
        return x if not isinstance(x, jax.Array) else x / one

    joints = tuple(slots_first(q[..., i]) for i in range(arm.n))
    with pinning(divide):
        found = chain(arm, joints)
    reached = poses.compose(found.last, fixed_pose(arm.tool))
    twist = twists.ZERO
    if goal_rates is not None:
        wished = tuple(tuple(x[None] for x in row) for row in entries_of(goal_rates)[:3])
        # The goal's own rotation is not looked at: where nothing is valid it may hold anything.
        turn = twists.angular_velocity(reached.rotation, tuple(row[:3] for row in wished))
        twist = twists.Twist(tuple(row[3] for row in wished), turn)
    if arm_rates is not None:
        own = twists.parameter_twist(arm, arm_rates, joints, found, reached.position)
        twist = twist.plus(own.times(-1.0))
    size = reach(arm)
    rows = twists.task_rows(arm, found, 1 / size)
    wanted = [divide(x) for x in rows(twist)]
    # A slide counts in reaches too.
    units = [size if kind == "P" else 1.0 for kind in arm.kinds]
    motions = zip(units, twists.motor_twists(arm, found, reached.position), strict=True)
    columns = [[divide(x) for x in rows(motion.times(unit))] for unit, motion in motions]
    matrix = [[divide(dot(u, v)) for v in columns] for u in columns]
    for i in range(arm.n):
        matrix[i][i] = matrix[i][i] + damping * damping
    still = ~slots_first(valid)
    right = [divide(jnp.broadcast_to(dot(u, wanted), still.shape)) for u in columns]

    def solved(_, b):
        with pinning(divide):
            return solve_symmetric(matrix, b)

    steps = jax.lax.custom_linear_solve(
        lambda x: [dot(row, x) for row in matrix], right, solved, symmetric=True
    )
    moves = [jnp.where(still, 0, unit * step) for unit, step in zip(units, steps, strict=True)]
    return jnp.stack([jnp.moveaxis(jnp.broadcast_to(x, still.shape), 0, -1) for x in moves], axis=-1)
