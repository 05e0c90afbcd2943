"""Multistart descent to the nearest pose: the starts, the descent of each, and the choice of the best.

The starts are the branches of the closed form. Limits, and joints too few, make basins that no branch leads
to: further starts have a joint at a limit (`branches_and_limits`) or are spread over the limits
(`scattered_starts`). Each start takes Newton steps (`ik.newton`), in stages where one error comes first
(`ik.lexicographic`).

`descend_all` is what `project` and `refine` call. Inside a jit all starts are in one program, whose loop ends
with the last of them. Called eagerly, all starts take a few steps, and only those that have not converged
take more, in rounds.
"""

import dataclasses
from typing import Any, NamedTuple

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
    pinning,
    stop_gradient,
    to_columns,
    to_rows,
)
from ikjax.ik import batched, lexicographic, newton
from ikjax.ik.inline import Entries, entries_of, in_type
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

LARGEST_ROUND = 2**20
"""Starts of an eager call that are descended at a time, about; each holds its goal."""

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
    return goals, in_type(arm, goals.dtype)


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


def branches_and_limits(arm: Arm, goals: jax.Array) -> jax.Array:
    """The branches and starts with a joint at a limit, (..., S, n), for an arm whose family has these.

    Each joint that the family can fix is put at each of its limits, with every branch of the rest. Each of
    these, and each branch, is taken once more with the last joint at the limit that is farther off: there is
    a basin on both sides of the gap in its range.
    """
    return _starts_of(arm, goals, limits=True)


def branches(arm: Arm, goals: jax.Array) -> jax.Array:
    """The branches of the closed form, (..., S, n)."""
    return _starts_of(arm, goals, limits=False)


def _starts_of(arm: Arm, goals: jax.Array, limits: bool) -> jax.Array:
    if not is_traced((arm, goals)):
        starts = batched.map_blocks(_StartsBlock(limits), arm, goals.reshape(-1, 4, 4))
        return starts.reshape(*goals.shape[:-2], *starts.shape[1:])
    arm, goals = stop_gradient((arm, goals))
    q = _columns_of(arm.baked(), entries_of(goals), limits)
    return jnp.moveaxis(jnp.stack(q, axis=-1), 0, -2)


@dataclasses.dataclass(frozen=True)
class _StartsBlock:
    """The branches of one block of goals, or those and the starts at limits."""

    limits: bool

    def __call__(self, arm: Arm, goals: jax.Array) -> jax.Array:
        q = _columns_of(arm, batched.entries_in(goals), self.limits)
        count = q[0].shape[0]
        return to_rows([x[s] for s in range(count) for x in q], goals.shape[0]).reshape(-1, count, arm.n)


def _columns_of(arm: Arm, entries: Entries, limits: bool) -> Joints:
    """The branches, or those and the starts at limits, each joint (S, ...)."""
    goal, _, policy = nearest_goal(arm, entries)
    if not limits:
        return closed_form_starts(arm, goal, policy)
    with pinning(policy):
        q = proposed_at_limits(arm, goal)
        across = policy(_farther_limit(q[-1], *numbers(arm.limits[-1])))
    return (*(jnp.concatenate([x, x]) for x in q[:-1]), jnp.concatenate([q[-1], across]))


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
    starts: jax.Array,
    characteristic_length: ArrayLike,
    steps: int,
    priority: str = "weighted",
) -> Projection:
    """Every start after its descent, differentiable in the arm and the goals.

    Args:
        arm: The arm, baked and in the type of the goals.
        goals: T_world_tool, (..., 4, 4).
        starts: (..., S, n).
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
    fixed_arm, entries = fixed_arm.baked(), entries_of(fixed_goals)
    goal, proper, _ = nearest_goal(fixed_arm, entries)
    columns = tuple(jnp.moveaxis(fixed_starts, (-1, -2), (0, 1)))
    ends = descend_starts(fixed_arm, goal, proper, columns, fixed_length, steps, None, priority)
    return _in_trace(arm, goals, length, ends, priority)


def closed_form_ends(arm: Arm, goals: jax.Array, characteristic_length: ArrayLike) -> Projection:
    """Every branch of the closed form, moved into the limits and measured; as `descend_all` without steps."""
    length = as_array(characteristic_length, goals.dtype)
    if not is_traced((arm, goals, length)):
        rows = goals.reshape(-1, 4, 4)
        inputs = rows, jnp.broadcast_to(length, rows.shape[:1])
        ends = batched.map_blocks(_ClosedFormBlock(), arm, inputs)
        return _as_projection(ends, goals.shape[:-2])
    fixed_arm, fixed_goals, fixed_length = stop_gradient((arm, goals, length))
    slots = closed_form(fixed_arm.baked(), entries_of(fixed_goals), fixed_length)
    ends = jax.tree.map(lambda *slots: jnp.stack(slots), *slots)
    return _in_trace(arm, goals, length, ends, "weighted")


def _in_trace(arm: Arm, goals: jax.Array, length: jax.Array, ends: "Descent", priority: str) -> Projection:
    """Where starts ended, fields (..., S), differentiable in the arm and the goals."""
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
    arm: Arm, goals: jax.Array, starts: jax.Array, length, steps: int, priority: str
) -> Projection:
    """`descend_all` of an eager call, arguments as there: without derivatives, and in rounds."""
    batch, count = starts.shape[:-1], starts.shape[-2]
    goals, starts = goals.reshape(-1, 4, 4), starts.reshape(-1, count, arm.n)
    # A row is a goal and one of its starts, so that all rounds are one program. Some goals at a time, because
    # each is repeated for its starts.
    chunk = max(1, LARGEST_ROUND // count)
    parts = []
    for first in range(0, max(1, goals.shape[0]), chunk):
        repeated = jnp.repeat(goals[first : first + chunk], count, axis=0)
        rows = starts[first : first + chunk].reshape(-1, arm.n)
        parts.append(_descend_rows(arm, repeated, rows, length, steps, priority))
    return _as_projection(jax.tree.map(lambda *parts: np.concatenate(parts), *parts), batch)


def _as_projection(fields: dict[str, Any], batch: tuple[int, ...]) -> Projection:
    """Fields (N, ...) with the batch's axes."""
    shaped: dict[str, Any] = {k: jnp.asarray(x).reshape(*batch, *x.shape[1:]) for k, x in fields.items()}
    return Projection(**shaped)


def _descend_rows(
    arm: Arm, goals: jax.Array, q: jax.Array, length, steps: int, priority: str
) -> dict[str, np.ndarray]:
    """Goals (N, 4, 4), each from joints (N, n), after their descent: fields (N, ...) of `Projection`."""
    block, few = _DescentBlock(priority), q.shape[0] <= batched.FEW

    def taken(goals, q, damping, steps: int) -> dict[str, np.ndarray]:
        numbers = [jnp.full(damping.shape, x, dtype) for x, dtype in ((length, q.dtype), (steps, np.int32))]
        rows = batched.map_few if few else batched.map_blocks
        return jax.tree.map(np.array, rows(block, arm, (goals, *numbers, q, damping)))

    done = min(steps, FIRST_STEPS)
    ends = taken(goals, q, jnp.full(q.shape[:1], newton.FIRST_DAMPING, q.dtype), done)
    while done < steps:
        (rows,) = np.nonzero(~ends["converged"])
        if not rows.size:
            break
        # Few starts are left after each round, and all of a block take as many steps.
        more = done if 3 * done < steps else steps - done
        rest = taken(goals[rows], ends["q"][rows], ends["damping"][rows], more)
        for name, x in rest.items():
            ends[name][rows] = x
        done += more
    del ends["damping"]
    return ends


@dataclasses.dataclass(frozen=True)
class _DescentBlock:
    """The descents of one block of goals.

    Its rows are goals (N, 4, 4), the characteristic length (N,), the steps (N,), which are alike in all rows,
    joints (N, n), and their damping (N,).
    """

    priority: str

    def __call__(self, arm: Arm, rows) -> dict[str, jax.Array]:
        goals, length, steps, starts, damping = rows
        goal, proper, _ = nearest_goal(arm, batched.entries_in(goals))
        columns = to_columns(starts)
        q = tuple(columns[i : i + 1] for i in range(arm.n))
        end = descend_starts(arm, goal, proper, q, length[None], steps[0], damping[None], self.priority)
        fields = {name: getattr(end, name)[0] for name in (*FIELDS, "damping")}
        return {**fields, "q": to_rows([x[0] for x in end.q], goals.shape[0])}


@dataclasses.dataclass(frozen=True)
class _ClosedFormBlock:
    """The closed form alone, of one block of goals (N, 4, 4) with their characteristic length (N,)."""

    def __call__(self, arm: Arm, rows) -> dict[str, jax.Array]:
        goals, length = rows
        entries = batched.entries_in(goals)
        slots = closed_form(arm, entries, length)
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
    inside = newton.into_limits(arm, starts)
    return _descend_within_limits(
        arm, goal, proper[None], inside, characteristic_length, steps, damping, priority, None
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
