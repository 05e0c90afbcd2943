"""Multistart descent to the nearest pose: the starts, the descent of each, and the choice of the best.

The starts are the branches of the closed form. Limits, and joints too few, make basins that no branch leads
to: further starts have a joint at a limit (`starts_at_limits`) or are spread over the limits
(`scattered_starts`). Each start takes Newton steps (`ik.newton`), in stages where one error comes first
(`ik.lexicographic`).

`descend_all` is what `project` and `refine` call. Inside a jit every start takes all steps, in one program.
Called eagerly, all starts take a few steps, and only those that have not converged take more, in rounds.
"""

import dataclasses
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike

from ikjax.arm.arm import Arm, array_of, numbers
from ikjax.arm.forward import reach, whole_turns
from ikjax.core.pose import Pose, nearest_pose
from ikjax.core.tolerances import CONVERGED, NEARLY_ROTATION
from ikjax.core.trig import Scalar
from ikjax.core.xla import (
    Pin,
    as_array,
    divider_once,
    is_traced,
    one_by_one,
    pinning,
    stop_gradient,
    to_columns,
    to_rows,
)
from ikjax.ik import batched, lexicographic, newton
from ikjax.ik.inline import Entries, entries_of
from ikjax.ik.newton import Joints
from ikjax.ik.project_gradient import with_derivatives
from ikjax.ik.results import Projection
from ikjax.ik.solve import as_goals
from ikjax.ik.turns import TURN
from ikjax.solvers.pipeline import proposed, proposed_at_limits

STEPS = 60
"""Newton steps of `project` and `refine`, at most."""

FIRST_STEPS = 6
"""Steps that every start of an eager call takes. Those that have not converged take as many again, and so
on."""

FIELDS = ("cost", "position_error", "rotation_error", "gradient_norm", "converged")


def checked_arguments(arm: Arm, goals, characteristic_length, steps: int) -> tuple[jax.Array, Arm]:
    """Goals as an array (..., 4, 4), and the arm in their type.

    Raises:
        ValueError: Naming the argument that is wrong.
    """
    goals = as_goals(goals)
    if not isinstance(steps, int | np.integer) or steps < 0:
        raise ValueError(f"steps must be a whole number, not negative, got {steps!r}")
    if np.ndim(characteristic_length) or (
        not isinstance(characteristic_length, jax.core.Tracer)
        and not 0 < float(characteristic_length) < np.inf
    ):
        raise ValueError(
            f"characteristic_length must be a positive number of metres, got {characteristic_length}"
        )
    return goals, arm.baked().astype(goals.dtype)


# The starts.


def closed_form_starts(arm: Arm, goal: Pose, policy: Pin, free: Joints = ()) -> Joints:
    """The joints of every branch of the closed form, each (S, ...).

    Args:
        arm: An arm with a family.
        goal: T_world_tool.
        policy: Pins values that have the shape of the goal's numbers.
        free: The values of the joints in `Arm.locked`.
    """
    shape = goal.position[0].shape
    with pinning(policy):
        columns = zip(*proposed(arm, goal, free), strict=True)
    return tuple(jnp.stack([jnp.broadcast_to(x, shape) for x in column]) for column in columns)


def starts_at_limits(arm: Arm, goals: jax.Array) -> jax.Array:
    """Starts with a joint at a limit by the closed form, (..., S, n), for an arm whose family has them.

    Each joint that the family can fix is put at each of its limits, with every branch of the rest. Each of
    these, and each branch, is taken once more with the last joint at the limit that is farther off: there is
    a basin on both sides of the gap in its range.
    """
    if not is_traced((arm, goals)):
        starts = batched.map_blocks(_StartsAtLimitsBlock(), arm, goals.reshape(-1, 4, 4))
        return starts.reshape(*goals.shape[:-2], *starts.shape[1:])
    q, branches = _near_limits(*_known(arm, goals))
    return _starts_last(q)[..., branches:, :]


def branches_and_limits(arm: Arm, goals: jax.Array) -> jax.Array:
    """The branches of the closed form and `starts_at_limits`, (..., S, n), in a trace.

    In one program: the second ones are made of the first.
    """
    return _starts_last(_near_limits(*_known(arm, goals))[0])


def branch_starts(arm: Arm, goals: jax.Array) -> jax.Array:
    """The branches of the closed form, (..., S, n), in a trace."""
    arm, entries = _known(arm, goals)
    goal, _, policy = nearest_goal(arm, entries)
    return _starts_last(closed_form_starts(arm, goal, policy))


def _known(arm: Arm, goals: jax.Array) -> tuple[Arm, Entries]:
    """The arm and the entries of goals (..., 4, 4), without derivatives."""
    arm, goals = stop_gradient((arm, goals))
    return arm.baked(), entries_of(goals)


def _starts_last(q: Joints) -> jax.Array:
    """Joints, each (S, ...), as one array (..., S, n)."""
    return jnp.moveaxis(jnp.stack(q, axis=-1), 0, -2)


@dataclasses.dataclass(frozen=True)
class _StartsAtLimitsBlock:
    """`starts_at_limits` of one block of goals."""

    def __call__(self, arm: Arm, goals: jax.Array) -> jax.Array:
        q, branches = _near_limits(arm, batched.entries_in(goals))
        count = q[0].shape[0]
        rows = to_rows([x[s] for s in range(branches, count) for x in q], goals.shape[0])
        return rows.reshape(-1, count - branches, arm.n)


def _near_limits(arm: Arm, entries: Entries) -> tuple[Joints, int]:
    """The branches and the starts with a joint at a limit, each joint (S, ...); how many are branches."""
    goal, _, policy = nearest_goal(arm, entries)
    with pinning(policy):
        q, branches = proposed_at_limits(arm, goal)
        across = policy(_farther_limit(q[-1], *numbers(arm.limits[-1])))
    return (*(jnp.concatenate([x, x]) for x in q[:-1]), jnp.concatenate([q[-1], across])), branches


def _farther_limit(x: Scalar, low: Scalar, high: Scalar) -> Scalar:
    """The limit that is farther off round the circle; without limits the opposite angle."""
    low, high = (jnp.asarray(limit, x.dtype) for limit in (low, high))
    limited = jnp.isfinite(low) & jnp.isfinite(high)
    middle = jnp.where(limited, low / 2 + high / 2, 0)
    away = x - middle - TURN * jnp.round((x - middle) * (1 / TURN))
    opposite = jnp.where(x > 0, x - TURN / 2, x + TURN / 2)
    return jnp.where(limited, jnp.where(away < 0, high, low), opposite)


def sampling_ranges(arm: Arm) -> tuple[jax.Array, jax.Array]:
    """Lower and upper end (n,) of the values from which joints are drawn, within the limits [rad, m].

    Between two limits the whole range; of a joint whose whole turn leaves the pose, one turn in the middle of
    it. From a single limit one turn, or two reaches for a slide; without limits as much, about zero.
    """
    low, high = (jnp.asarray(array_of(arm.limits[:, end], arm.dtype)) for end in (0, 1))
    size = jnp.asarray(reach(arm), arm.dtype)
    size = jnp.where(size > 0, size, 1)  # of slides alone, whose table has no lengths
    half = jnp.stack([jnp.asarray(np.pi, arm.dtype) if kind == "R" else size for kind in arm.kinds])
    below, above = jnp.isfinite(low), jnp.isfinite(high)
    middle = jnp.where(below, low + half, jnp.where(above, high - half, 0))
    middle = jnp.where(below & above, low / 2 + high / 2, middle)
    whole = jnp.stack([jnp.asarray(turns) for turns in whole_turns(arm)])
    half = jnp.where(below & above & ~whole, jnp.inf, half)
    return jnp.maximum(low, middle - half), jnp.minimum(high, middle + half)


def scattered_starts(arm: Arm, batch: tuple[int, ...], count: int) -> jax.Array:
    """A low-discrepancy sequence of joints in `sampling_ranges`, (*batch, count, n), the same for all goals.

    Source: the additive recurrence R_d of Roberts, The unreasonable effectiveness of quasirandom
    sequences (2018).
    """
    root = 1.5
    for _ in range(64):
        root = (1 + root) ** (1 / (arm.n + 1))
    shares = np.outer(np.arange(1, count + 1), root ** -np.arange(1.0, arm.n + 1)) % 1
    low, high = (end[None] for end in sampling_ranges(arm))
    starts = low + (high - low) * jnp.asarray(shares, arm.dtype)
    return jnp.broadcast_to(starts, (*batch, *starts.shape))


# The descent.


def descend_all(
    arm: Arm,
    goals: jax.Array,
    starts: jax.Array | None,
    characteristic_length: ArrayLike,
    steps: int,
    priority: str = "weighted",
) -> Projection:
    """Every start after its descent, differentiable in the arm and the goals.

    Args:
        arm: The arm, baked and in the type of the goals.
        goals: T_world_tool, (..., 4, 4).
        starts: (..., S, n); None for the branches of the closed form.
        characteristic_length: Length that counts as much as one radian [m].
        steps: Newton steps at most, of each stage.
        priority: See `refine`.

    Returns:
        `Projection` with fields (..., S).
    """
    length = as_array(characteristic_length, goals.dtype)
    if not is_traced((arm, goals, starts, length)):
        return _descend_in_blocks(arm, goals, starts, length, steps, priority)
    fixed_arm, fixed_goals, fixed_starts, fixed_length = stop_gradient((arm, goals, starts, length))
    fixed_arm = fixed_arm.baked()
    columns = None if fixed_starts is None else tuple(fixed_starts[..., i] for i in range(arm.n))
    if columns is not None:
        columns = tuple(jnp.moveaxis(x, -1, 0) for x in columns)
    entries = entries_of(fixed_goals)
    if columns is None and steps == 0:
        slots = closed_form(fixed_arm, entries, fixed_length)
        ends = jax.tree.map(lambda *slots: jnp.stack(slots), *slots)
    else:
        goal, proper, policy = nearest_goal(fixed_arm, entries)
        columns = closed_form_starts(fixed_arm, goal, policy) if columns is None else columns
        ends = descend_starts(fixed_arm, goal, proper, columns, fixed_length, steps, None, priority)
    shape = ends.cost.shape

    def starts_last(x):
        return jnp.moveaxis(jnp.broadcast_to(x, shape), 0, -1)

    q, minimizer = (
        jnp.stack([starts_last(x) for x in joints], axis=-1) for joints in (ends.q, ends.minimizer)
    )
    fields = {name: starts_last(getattr(ends, name)) for name in FIELDS}
    if arm.is_joined:
        # In the program of an eager call, which has no derivatives.
        return Projection(q=q, **fields)
    q, errors = with_derivatives(arm, goals, q, minimizer, length, fields["converged"], priority)
    return Projection(q=q, **{**fields, **errors})


def _descend_in_blocks(
    arm: Arm, goals: jax.Array, starts: jax.Array | None, length, steps: int, priority: str
) -> Projection:
    """`descend_all` of an eager call, arguments as there: without derivatives, and in rounds."""
    batch, goals = goals.shape[:-2], goals.reshape(-1, 4, 4)
    length = jnp.broadcast_to(length, (goals.shape[0], 1))
    if starts is None and steps == 0:
        ends = batched.map_blocks(_ClosedFormBlock(), arm, (goals, length))
        return Projection(**{name: x.reshape(*batch, *x.shape[1:]) for name, x in ends.items()})
    if starts is not None:
        starts = starts.reshape(-1, *starts.shape[-2:])
    first = jnp.full(length.shape, min(steps, FIRST_STEPS), jnp.int32)
    block = _DescentBlock(priority)
    ends = batched.map_blocks(block, arm, (goals, length, first, starts, None))
    done = FIRST_STEPS
    while done < steps:
        unfinished = np.nonzero(~np.asarray(ends["converged"]))
        if not unfinished[0].size:
            break
        # Few starts are left after each round, and all of a block take as many steps.
        more = done if 3 * done < steps else steps - done
        row, slot = (jnp.asarray(x) for x in unfinished)
        q, damping = ends["q"][row, slot][:, None], ends["damping"][row, slot][:, None]
        round_steps = jnp.full((*row.shape, 1), more, jnp.int32)
        rest = batched.map_blocks(block, arm, (goals[row], length[row], round_steps, q, damping))
        ends = {name: x.at[row, slot].set(rest[name][:, 0]) for name, x in ends.items()}
        done += more
    del ends["damping"]
    return Projection(**{name: x.reshape(*batch, *x.shape[1:]) for name, x in ends.items()})


@dataclasses.dataclass(frozen=True)
class _DescentBlock:
    """All starts of one block of goals.

    Its rows are goals (N, 4, 4), the characteristic length (N, 1) and the steps (N, 1), alike in all rows,
    the starts (N, S, n) or None for the branches, and their damping (N, S) or None for the first one.
    """

    priority: str

    def __call__(self, arm: Arm, rows) -> dict[str, jax.Array]:
        goals, length, steps, starts, damping = rows
        entries = batched.entries_in(goals)
        if starts is not None:
            spread = to_columns(starts).reshape(*starts.shape[1:], -1)
            starts = tuple(spread[:, i] for i in range(arm.n))
            damping = None if damping is None else to_columns(damping)
        goal, proper, policy = nearest_goal(arm, entries)
        starts = closed_form_starts(arm, goal, policy) if starts is None else starts

        def descend_one(start):
            q, damping = jax.tree.map(lambda x: x[None], start)
            row_length = length[None, :, 0]
            end = descend_starts(arm, goal, proper, q, row_length, steps[0, 0], damping, self.priority)
            return jax.tree.map(lambda x: x[0], end)

        ends = one_by_one(descend_one, (starts, damping))
        count = ends.cost.shape[0]
        fields = {name: to_rows(list(getattr(ends, name)), goals.shape[0]) for name in (*FIELDS, "damping")}
        q = to_rows([x[s] for s in range(count) for x in ends.q], goals.shape[0])
        return {**fields, "q": q.reshape(-1, count, arm.n)}


@dataclasses.dataclass(frozen=True)
class _ClosedFormBlock:
    """The closed form alone, of one block of goals (N, 4, 4) with their characteristic length (N, 1)."""

    def __call__(self, arm: Arm, rows) -> dict[str, jax.Array]:
        goals, length = rows
        entries = batched.entries_in(goals)
        slots = closed_form(arm, entries, length[:, 0])
        fields = {name: to_rows([getattr(slot, name) for slot in slots], goals.shape[0]) for name in FIELDS}
        q = to_rows([x for slot in slots for x in slot.q], goals.shape[0])
        return {**fields, "q": q.reshape(-1, len(slots), arm.n)}


class Descent(NamedTuple):
    """Where starts ended. Fields as of `Projection`, but with the starts as the first axis, (S, ...)."""

    q: Joints
    cost: jax.Array
    position_error: jax.Array
    rotation_error: jax.Array
    gradient_norm: jax.Array
    converged: jax.Array
    damping: jax.Array
    minimizer: Joints
    """Joints at which derivatives are taken: q, or with a priority the minimizer of the last weighted sum."""


def closed_form(arm: Arm, entries: Entries, characteristic_length, free: Joints = ()) -> list[Descent]:
    """Every branch of the closed form, moved into the limits and measured, without a step.

    `free` are the values of the joints in `Arm.locked`.
    A list with fields (...) for each branch: a stack of them would be computed number by number.
    """
    goal, proper, policy = nearest_goal(arm, entries)
    shape, slots = goal.position[0].shape, []
    with pinning(policy):
        branches = proposed(arm, goal, free)
    for q in branches:
        inside = policy(newton.into_limits(arm, tuple(jnp.broadcast_to(x, shape) for x in q)))
        end = _descend_within_limits(
            arm, goal, proper, inside, characteristic_length, 0, None, "weighted", policy
        )
        slots.append(end._replace(cost=policy(end.cost)))
    return slots


def descend_starts(
    arm: Arm,
    goal: Pose,
    proper: jax.Array,
    starts: Joints,
    characteristic_length,
    steps,
    damping,
    priority: str = "weighted",
) -> Descent:
    """All starts after their steps.

    Args:
        arm: The arm.
        goal: T_world_tool, each number (...).
        proper: Whether there is such a goal, (...).
        starts: Joints, each (S, ...); moved into the limits first.
        characteristic_length: Length that counts as much as one radian [m].
        steps: Newton steps, of each stage; may be traced.
        damping: That at which an earlier descent ended, or None.
        priority: See `refine`.
    """
    goal = jax.tree.map(lambda x: x[None], goal)
    starts = newton.into_limits(arm, starts)
    return _descend_within_limits(
        arm, goal, proper[None], starts, characteristic_length, steps, damping, priority, None
    )


def _descend_within_limits(
    arm: Arm,
    goal: Pose,
    proper: jax.Array,
    starts: jax.Array,
    characteristic_length,
    steps,
    damping,
    priority: str,
    policy: Pin | None,
) -> Descent:
    """`descend_starts` of starts within the limits, whose shape the goal's numbers broadcast to."""
    state, gradient_norm, minimizer = lexicographic.descend(
        arm, goal, characteristic_length, priority, starts, steps, damping
    )
    gradient_norm = gradient_norm if policy is None else policy(gradient_norm)
    here, size = state.evaluation, reach(arm)
    trusted = newton.is_above_rounding(arm, goal, here, characteristic_length)
    converged = proper & trusted & (gradient_norm <= CONVERGED[gradient_norm.dtype.name])
    cost = size * size * here.cost
    if priority != "weighted":
        cost = (size * here.distance) ** 2 + (characteristic_length * here.angle) ** 2
    # Nothing is measured against what stands for a goal that is no pose, and the arm does not move to it.
    q = tuple(newton.choose(proper, state.q, starts))
    cost, position_error, rotation_error, gradient_norm = (
        jnp.where(proper, x, jnp.nan) for x in (cost, size * here.distance, here.angle, gradient_norm)
    )
    return Descent(
        q, cost, position_error, rotation_error, gradient_norm, converged, state.damping, tuple(minimizer)
    )


def nearest_goal(arm: Arm, entries: Entries) -> tuple[Pose, jax.Array, Pin]:
    """The pose nearest to a goal's numbers, whether it is near enough to stand for the goal, and a pin.

    The pin is for values of the shape of the goal's numbers.
    """
    policy = divider_once(entries[0][3])
    with pinning(policy):
        goal, off = nearest_pose(entries, reach(arm))
    return goal, off <= NEARLY_ROTATION, policy


@jax.jit
def goal_error(goals: jax.Array) -> jax.Array:
    """By how much goals (..., 4, 4) are no poses, (...); see `Projection.goal_error`."""
    return jax.lax.stop_gradient(nearest_pose(entries_of(goals), 1.0)[1])


# The best.


def with_best(arm: Arm, goals: jax.Array, branches: Projection, priority: str = "weighted") -> Projection:
    """The best of the starts, fields (...), with all of them as its `branches`, (..., S).

    Of several that are equal to rounding, the first.
    """
    best = lexicographic.best_start(arm, branches, priority)

    def pick(x: jax.Array) -> jax.Array:
        index = best.reshape(*best.shape, *[1] * (x.ndim - best.ndim))
        return jnp.take_along_axis(x, index, axis=best.ndim).squeeze(best.ndim)

    fields = {k: pick(x) for k, x in vars(branches).items() if x is not None}
    return Projection(**fields, goal_error=goal_error(goals), branches=branches)
