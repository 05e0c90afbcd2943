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
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.custom_derivatives import SymbolicZero

from ikjax.arm import twists
from ikjax.arm.arm import Arm
from ikjax.arm.forward import Chain, chain, fixed_pose, reach
from ikjax.core import pose as poses
from ikjax.core.linear import dot, solve_symmetric
from ikjax.core.tolerances import GRADIENT_DAMPING
from ikjax.core.trig import Scalar
from ikjax.core.xla import divider, in_blocks, opaque_one, pinning, stop_gradient, stored
from ikjax.ik import arm_angle
from ikjax.ik.inline import Entries, entries_of, margins_of, slots_of
from ikjax.solvers.pipeline import Slot

BLOCK = 4096
"""Goals whose derivatives are computed at a time."""

Known = tuple
"""The leaves of an arm that are not traced; see `Arm.split`."""


class DerivativeRule(NamedTuple):
    """Gives joints and margins their derivatives in the arm, the goals and the redundant joints.

    The values stay as they are.
    """

    known: Known
    leaves: list
    """Of the arm, those that are traced."""
    goals: jax.Array
    """T_world_tool, (..., 4, 4)."""
    damping: float
    """Of the pseudo-inverse."""
    free: jax.Array | None
    """Values of the joints in `Arm.locked`, or the arm angle, (..., k); None where there is none."""

    @staticmethod
    def of(
        arm: Arm, goals: jax.Array, damping: float | None, free: jax.Array | None = None
    ) -> "DerivativeRule":
        """The rule for an arm, whose leaves may be traced; see `solve` for the damping."""
        if damping is None:
            damping = GRADIENT_DAMPING * float(jnp.finfo(goals.dtype).eps) ** 0.5
        known, leaves = arm.split(whole=True)
        return DerivativeRule(known, leaves, goals, damping, free)

    def joints(self, q: jax.Array, valid: jax.Array) -> jax.Array:
        """Joints (..., S, n) of slots that reach their goals, or not, (..., S)."""
        return _joints(self.known, self.damping, self.leaves, self.goals, self.free, q, valid)

    def chosen_joints(self, q: jax.Array, valid: jax.Array) -> jax.Array:
        """Joints (..., n) of one slot for each goal, which reaches it or not, (...)."""
        return self.joints(q[..., None, :], valid[..., None])[..., 0, :]

    def margins(self, margin: jax.Array, slots: tuple[Slot, ...]) -> jax.Array:
        """Margins (..., S) of slots."""
        fold = stop_gradient(jax.tree.map(lambda *x: jnp.stack(x), *[slot.fold for slot in slots]))
        return _margins(self.known, self.leaves, self.goals, self.free, fold, margin)


@functools.partial(jax.custom_jvp, nondiff_argnums=(0, 1))
def _joints(known: Known, damping: float, leaves: list, goals, free, q, valid):
    """The joints q as they are; their derivatives are those of `_joints_jvp`."""
    return q


def _joints_jvp(known: Known, damping: float, primals, tangents):
    leaves, goals, free, q, valid = primals
    # Applied again, so that q has derivatives in derivatives of second order.
    q = _joints(known, damping, leaves, goals, free, q, valid)
    # Where no number of the arm changes, nothing is computed for the arm.
    arm_is_fixed = all(isinstance(rate, SymbolicZero) for rate in tangents[0])
    leaf_rates = [np.zeros(x.shape, x.dtype) if isinstance(x, SymbolicZero) else x for x in tangents[0]]

    goals_are_fixed, free_is_fixed = (x is None or isinstance(x, SymbolicZero) for x in tangents[1:3])
    if arm_is_fixed and goals_are_fixed and free_is_fixed:
        return q, jnp.zeros_like(q)

    def motion(goal_rates, free_rates, joints, valid):
        arm = Arm.join(known, leaves)
        arm_rates = None if arm_is_fixed else _arm_of_rates(known, leaf_rates)
        return _joint_rates(arm, arm_rates, goal_rates, free_rates, joints, valid, damping)

    # Numbers and not rows: each is then one contiguous array of a block, forwards and backwards.
    goal_rates = None if goals_are_fixed else tuple(row[:4] for row in entries_of(tangents[1])[:3])
    free_rates = None if free_is_fixed else tangents[2]
    joints = tuple(q[..., i] for i in range(q.shape[-1]))
    rates = in_blocks(motion, valid.shape[:-1], (goal_rates, free_rates, joints, valid), BLOCK)
    return q, jnp.stack(rates, axis=-1)


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
def _margins(known: Known, leaves: list, goals, free, fold, margin):
    """The margins as they are; their derivatives are those of the rule below."""
    return margin


@_margins.defjvp
def _margins_jvp(known: Known, primals, tangents):
    leaves, goals, free, fold, margin = primals

    def computed(leaves, goals, free):
        with pinning(divider(goals[..., 0, 3])):
            arm, entries = Arm.join(known, leaves), entries_of(goals)
            if fold:
                return jnp.moveaxis(margins_of(arm, entries, fold, free), 0, -1)
            slots = slots_of(arm, entries, None, None, free)
        return jnp.stack([jnp.broadcast_to(s.margin, goals.shape[:-2]) for s in slots], axis=-1)

    _, rate = jax.jvp(computed, (leaves, goals, free), tangents[:3])
    return _margins(known, leaves, goals, free, fold, margin), rate


def _joint_rates(
    arm: Arm,
    arm_rates: Arm | None,
    goal_rates: Entries | None,
    free_rates: jax.Array | None,
    joints: tuple[jax.Array, ...],
    valid: jax.Array,
    damping: float,
) -> tuple[jax.Array, ...]:
    """Rates of the n joints, each (..., S), for rates of the goals and of the arm's numbers.

    Inside, slots are the first axis, so that each number is one array (S, ...).

    Args:
        arm: The arm.
        arm_rates: An arm whose leaves are rates; None for zero.
        goal_rates: The first three rows, each number (...); None for zero.
        free_rates: (..., k) of the joints in `Arm.locked`, or of the arm angle; None for zero.
        joints: n arrays (..., S).
        valid: (..., S); elsewhere the rates are zero.
        damping: Of the pseudo-inverse.
    """

    def slots_first(x):
        return jnp.moveaxis(x, -1, 0)

    joints = tuple(stored(slots_first(x)) for x in joints)
    # Of the whole shape: XLA turns a division by a number that is broadcast into a multiplication.
    one = opaque_one(joints[0])

    def divide(x: Scalar) -> Scalar:
        return x if not isinstance(x, jax.Array) else x / one

    with pinning(divide):
        kinematics = chain(arm, joints)
    reached = poses.compose(kinematics.last, fixed_pose(arm.tool))
    twist = twists.ZERO
    if goal_rates is not None:
        rows = tuple(tuple(x[None] for x in row) for row in goal_rates)
        # The reached rotation and not the goal's, which may be anything where no slot is valid.
        angular = twists.angular_velocity(reached.rotation, tuple(row[:3] for row in rows))
        twist = twists.Twist(tuple(row[3] for row in rows), angular)
    if arm_rates is not None:
        arm_twist = twists.parameter_twist(arm, arm_rates, joints, kinematics, reached.position)
        twist = twist.plus(arm_twist.times(-1.0))
    # Joints that are locked move as they are told to; the others make up for it.
    given: list[Scalar] = [0.0] * len(arm.locked)
    if free_rates is not None:
        given = [free_rates[..., j][None] for j in range(len(arm.locked))]
        columns_of_q = twists.motor_twists(arm, kinematics, reached.position)
        for i, rate in zip(arm.locked, given, strict=True):
            twist = twist.plus(columns_of_q[i].times(-rate))
    size = reach(arm)
    task_rows = twists.task_rows(arm, kinematics, 1 / size)
    wanted = [divide(x) for x in task_rows(twist)]
    # The value of a slide counts in reaches too.
    units = [size if arm.kinds[i] == "P" else 1.0 for i in arm.solved]
    solved_twists = twists.motor_twists(arm, kinematics, reached.position)
    solved_twists = solved_twists[arm.solved.start : arm.solved.stop]
    motions = zip(units, solved_twists, strict=True)
    columns = [[divide(x) for x in task_rows(motion.times(unit))] for unit, motion in motions]
    if arm.family == arm_angle.FAMILY:
        # Of seven joints the arm angle asks for one thing more.
        row, rate = _angle_row(arm, arm_rates, free_rates, joints, kinematics)
        columns = [[*column, divide(entry)] for column, entry in zip(columns, row, strict=True)]
        wanted.append(divide(rate))
    # The normal equations of damped least squares, (J^T J + damping^2 I) x = J^T wanted.
    matrix = [[divide(dot(u, v)) for v in columns] for u in columns]
    for i in range(len(columns)):
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
    locked = [jnp.where(invalid, 0, rate) for rate in given]
    rates = [*locked[: arm.solved.start], *rates, *locked[arm.solved.start :]]
    return tuple(jnp.moveaxis(jnp.broadcast_to(x, invalid.shape), 0, -1) for x in rates)


def _angle_row(
    arm: Arm,
    arm_rates: Arm | None,
    free_rates: jax.Array | None,
    joints: tuple[jax.Array, ...],
    kinematics: Chain,
) -> tuple[list[Scalar], Scalar]:
    """The derivatives of the arm angle by the joints, and the rate that these have to make up for.

    Both are times `Measured.scale`, and so finite where the reference is not defined.
    """
    now = arm_angle.measured(arm, kinematics)
    rate = jnp.zeros_like(joints[0]) if free_rates is None else free_rates[..., 0][None]
    if arm_rates is not None:
        _, by_arm = jax.jvp(
            lambda arm: arm_angle.measured(arm, chain(arm, joints)).angle, (arm,), (arm_rates,)
        )
        rate = rate - by_arm
    return list(now.row), now.scale * rate
