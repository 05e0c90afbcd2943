"""Many starts down to the nearest pose: where they stand, how they go down, which of them is taken.

Starts are the branches of the closed form; limits, and joints too few, make basins that no branch leads to,
so others stand at limits (`at_limits`) or spread over them (`scattered`). Each takes Newton steps
(`ik.newton`). Called eagerly, all starts take a few steps, and those that have not converged take more in
rounds.
"""

import dataclasses
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ikjax.arm.arm import Arm
from ikjax.arm.forward import reach, whole_turns
from ikjax.core.known import as_array, is_traced, stop_gradient
from ikjax.core.pose import Pose, nearest_pose
from ikjax.core.tolerances import CONVERGED, NEARLY_ROTATION
from ikjax.core.trig import Scalar
from ikjax.core.xla import Pin, divider_once, one_by_one, pinning, to_columns, to_rows
from ikjax.ik import batched, newton
from ikjax.ik import lexicographic as priorities
from ikjax.ik.inline import Entries, entries_of
from ikjax.ik.newton import bounds
from ikjax.ik.project_gradient import with_slopes
from ikjax.ik.results import Projection
from ikjax.ik.solve import as_goals
from ikjax.ik.turns import TURN
from ikjax.solvers.pipeline import proposed, proposed_at_limits

STEPS = 60

FIRST = 6
"""Steps that every start of an eager call takes; those not down yet take as many again, and so on."""

FIELDS = ("cost", "position_error", "rotation_error", "gradient_norm", "converged")


def at_limits(arm: Arm, goals: jax.Array) -> jax.Array:
    """Starts with a joint at a limit by the closed form, (..., S, n), for an arm whose family has them.

    Each joint that the family may hold, at each of its limits, with every branch of the rest; and of these
    and of the branches the same with the last joint at that limit which is further off: on both sides of the
    gap in its range there is a basin.
    """
    if not is_traced((arm, goals)):
        found = batched.in_blocks(_AtLimits(), arm, goals.reshape(-1, 4, 4))
        return found.reshape(*goals.shape[:-2], *found.shape[1:])
    arm, goals = stop_gradient((arm, goals))
    rows = _at_limits(arm.baked(), entries_of(goals))
    return jnp.stack([jnp.stack(row, axis=-1) for row in rows], axis=-2)


@dataclasses.dataclass(frozen=True)
class _AtLimits:
    """A block of goals."""

    def __call__(self, arm: Arm, goals: jax.Array) -> jax.Array:
        rows = _at_limits(arm, batched.entries_in(goals))
        return to_rows([x for row in rows for x in row], batched.BLOCK).reshape(-1, len(rows), arm.n)


def _at_limits(arm: Arm, entries: Entries) -> list[tuple[jax.Array, ...]]:
    goal, _, policy = asked(arm, entries)
    shape = goal.position[0].shape
    with pinning(policy):
        ends, branches = proposed_at_limits(arm, goal), proposed(arm, goal)
    low, high = bounds(arm)[-1]
    rows = [*ends, *((*q[:-1], _further(q[-1], low, high)) for q in [*branches, *ends])]
    return [tuple(policy(jnp.broadcast_to(x, shape)) for x in q) for q in rows]


def _further(x: Scalar, low: Scalar, high: Scalar) -> Scalar:
    """The limit further off round the circle; without limits the opposite angle."""
    low, high = (jnp.asarray(limit, x.dtype) for limit in (low, high))
    limited = jnp.isfinite(low) & jnp.isfinite(high)
    middle = jnp.where(limited, low / 2 + high / 2, 0)
    away = x - middle - TURN * jnp.round((x - middle) * (1 / TURN))
    opposite = jnp.where(x > 0, x - TURN / 2, x + TURN / 2)
    return jnp.where(limited, jnp.where(away < 0, high, low), opposite)


def ranges(arm: Arm) -> tuple[jax.Array, jax.Array]:
    """Lower and upper end (n,) of the values from which joints are drawn, within the limits.

    All that lies between two limits, but for what turns round: there a whole turn in the middle. From one
    limit alone a whole turn on, or two reaches; without any as much about zero.
    """
    low, high = (jnp.asarray(arm.limits)[:, k] for k in (0, 1))
    size = jnp.asarray(reach(arm), arm.dtype)
    size = jnp.where(size > 0, size, 1)  # of slides alone, whose table has no lengths
    half = jnp.stack([jnp.asarray(np.pi, arm.dtype) if kind == "R" else size for kind in arm.kinds])
    below, above = jnp.isfinite(low), jnp.isfinite(high)
    middle = jnp.where(below, low + half, jnp.where(above, high - half, 0))
    middle = jnp.where(below & above, low / 2 + high / 2, middle)
    whole = jnp.stack([jnp.asarray(turns) for turns in whole_turns(arm)])
    half = jnp.where(below & above & ~whole, jnp.inf, half)
    return jnp.maximum(low, middle - half), jnp.minimum(high, middle + half)


def scattered(arm: Arm, batch: tuple[int, ...], count: int):
    """Joints spread evenly over the limits, the same for every goal, (..., S, n).

    Source: the additive recurrence R_d of Roberts, The unreasonable effectiveness of quasirandom
    sequences (2018).
    """
    root = 1.5
    for _ in range(64):
        root = (1 + root) ** (1 / (arm.n + 1))
    shares = np.outer(np.arange(1, count + 1), root ** -np.arange(1.0, arm.n + 1)) % 1
    low, high = (end[None] for end in ranges(arm))
    starts = low + (high - low) * jnp.asarray(shares, arm.dtype)
    return jnp.broadcast_to(starts, (*batch, *starts.shape))


def checked(arm: Arm, goals, length, steps: int) -> tuple[jax.Array, Arm]:
    goals = as_goals(goals)
    if not isinstance(steps, int | np.integer) or steps < 0:
        raise ValueError(f"steps must be a whole number, not negative, got {steps!r}")
    if np.ndim(length) or (not isinstance(length, jax.core.Tracer) and not 0 < float(length) < np.inf):
        raise ValueError(f"characteristic_length must be a positive number of metres, got {length}")
    return goals, arm.baked().astype(goals.dtype)


def best_of(arm: Arm, goals, branches: Projection, priority: str = "weighted") -> Projection:
    """The start that came out lowest, the first of several that are level, and all of them."""
    best = priorities.best(arm, branches, priority)

    def pick(x: jax.Array) -> jax.Array:
        index = best.reshape(*best.shape, *[1] * (x.ndim - best.ndim))
        return jnp.take_along_axis(x, index, axis=best.ndim).squeeze(best.ndim)

    fields = {k: pick(x) for k, x in vars(branches).items() if x is not None}
    return Projection(**fields, goal_error=goal_error(goals), branches=branches)


def descended(
    arm: Arm, goals: jax.Array, starts, length, steps: int, priority: str = "weighted"
) -> Projection:
    """Every start (..., S, n) after its steps, fields (..., S); the closed form's own where it is None."""
    length = as_array(length, goals.dtype)
    if not is_traced((arm, goals, starts, length)):
        return _in_blocks(arm, goals, starts, length, steps, priority)
    still = stop_gradient((arm, goals, starts, length))
    arm_still = still[0].baked()
    columns = None if starts is None else tuple(still[2][..., i] for i in range(arm.n))
    if columns is not None:
        columns = tuple(jnp.moveaxis(x, -1, 0) for x in columns)
    entries = entries_of(still[1])
    if columns is None and steps == 0:
        found = jax.tree.map(lambda *slots: jnp.stack(slots), *closed(arm_still, entries, still[3]))
    else:
        goal, proper, policy = asked(arm_still, entries)
        columns = proposals(arm_still, goal, policy) if columns is None else columns
        found = from_starts(arm_still, goal, proper, columns, still[3], steps, None, priority)
    shape = found.cost.shape

    def rows(x):
        return jnp.moveaxis(jnp.broadcast_to(x, shape), 0, -1)

    q, bottom = (jnp.stack([rows(x) for x in joints], axis=-1) for joints in (found.q, found.bottom))
    fields = {name: rows(getattr(found, name)) for name in FIELDS}
    q, errors = with_slopes(arm, goals, q, bottom, length, fields["converged"], priority)
    return Projection(q=q, **{**fields, **errors})


class Found(NamedTuple):
    """Of `Projection`, starts first."""

    q: tuple
    cost: jax.Array
    position_error: jax.Array
    rotation_error: jax.Array
    gradient_norm: jax.Array
    converged: jax.Array
    damping: jax.Array
    bottom: tuple
    """Joints at which the slopes are taken."""


def closed(arm: Arm, entries: Entries, length) -> list[Found]:
    """Every slot of the closed form within the limits, each by itself: a stack of them would be computed
    number by number."""
    goal, proper, policy = asked(arm, entries)
    shape, slots = goal.position[0].shape, []
    with pinning(policy):
        branches = proposed(arm, goal)
    for q in branches:
        clamped = tuple(policy(jnp.broadcast_to(x, shape)) for x in newton.into_limits(arm, q))
        found = _from_starts(arm, goal, proper, clamped, length, 0, None, "weighted", policy)
        slots.append(found._replace(cost=policy(found.cost)))
    return slots


def asked(arm: Arm, entries: Entries):
    """The nearest pose in scalars, whether there is one, and what pins numbers of its shape."""
    goal, off = nearest_pose(entries, reach(arm))
    policy = divider_once(entries[0][3])
    return jax.tree.map(policy, goal), off <= NEARLY_ROTATION, policy


@jax.jit
def goal_error(goals: jax.Array) -> jax.Array:
    """By how much goals (..., 4, 4) are no poses, (...)."""
    return jax.lax.stop_gradient(nearest_pose(entries_of(goals), 1.0)[1])


def proposals(arm: Arm, goal: Pose, policy: Pin) -> tuple[jax.Array, ...]:
    """The closed form's joints, each (S, ...)."""
    shape = goal.position[0].shape
    with pinning(policy):
        columns = zip(*proposed(arm, goal), strict=True)
    return tuple(jnp.stack([jnp.broadcast_to(x, shape) for x in column]) for column in columns)


def from_starts(
    arm: Arm, goal: Pose, proper, starts, length, steps, damping, priority: str = "weighted"
) -> Found:
    """All starts after their steps."""
    starts = newton.into_limits(arm, starts)
    goal = jax.tree.map(lambda x: x[None], goal)
    return _from_starts(arm, goal, proper[None], starts, length, steps, damping, priority, None)


def _from_starts(
    arm: Arm, goal: Pose, proper, starts, length, steps, damping, priority: str, policy: Pin | None
) -> Found:
    """Starts within the limits; what stands for the goal has their shape."""
    state, flat, bottom = priorities.descend(arm, goal, length, priority, starts, steps, damping)
    flat = flat if policy is None else policy(flat)
    at, size = state.at, reach(arm)
    seen = newton.is_seen(arm, goal, at, length)
    down = proper & seen & (flat <= CONVERGED[flat.dtype.name])
    cost = size * size * at.cost
    if priority != "weighted":
        cost = (size * at.gap) ** 2 + (length * at.angle) ** 2
    # Nothing is measured against what stands for a goal that is no pose, and the arm does not move to it.
    q = tuple(jnp.where(proper, x, y) for x, y in zip(state.q, starts, strict=True))
    cost, gap, angle, flat = (jnp.where(proper, x, jnp.nan) for x in (cost, size * at.gap, at.angle, flat))
    return Found(q, cost, gap, angle, flat, down, state.damping, bottom)


@dataclasses.dataclass(frozen=True)
class _Descending:
    """A block of goals; each row holds what a radian is worth to it, and the steps, alike in all."""

    priority: str

    def __call__(self, arm: Arm, rows) -> dict[str, jax.Array]:
        goals, length, steps, starts, damping = rows
        entries = batched.entries_in(goals)
        if starts is not None:
            spread = to_columns(starts).reshape(*starts.shape[1:], -1)
            starts = tuple(spread[:, i] for i in range(arm.n))
            damping = None if damping is None else to_columns(damping)
        goal, proper, policy = asked(arm, entries)
        starts = proposals(arm, goal, policy) if starts is None else starts

        def of_one(start):
            q, easing = jax.tree.map(lambda x: x[None], start)
            worth = length[None, :, 0]
            found = from_starts(arm, goal, proper, q, worth, steps[0, 0], easing, self.priority)
            return jax.tree.map(lambda x: x[0], found)

        found = one_by_one(of_one, (starts, damping))
        count = found.cost.shape[0]
        fields = {name: to_rows(list(getattr(found, name)), batched.BLOCK) for name in (*FIELDS, "damping")}
        q = to_rows([x[s] for s in range(count) for x in found.q], batched.BLOCK)
        return {**fields, "q": q.reshape(-1, count, arm.n)}


@dataclasses.dataclass(frozen=True)
class _Closed:
    """A block of goals, the closed form alone."""

    def __call__(self, arm: Arm, rows) -> dict[str, jax.Array]:
        goals, length = rows
        entries = batched.entries_in(goals)
        slots = closed(arm, entries, length[:, 0])
        fields = {name: to_rows([getattr(slot, name) for slot in slots], batched.BLOCK) for name in FIELDS}
        q = to_rows([x for slot in slots for x in slot.q], batched.BLOCK)
        return {**fields, "q": q.reshape(-1, len(slots), arm.n)}


def _in_blocks(arm: Arm, goals: jax.Array, starts, length, steps: int, priority: str) -> Projection:
    batch, flat = goals.shape[:-2], goals.reshape(-1, 4, 4)
    worth = jnp.broadcast_to(length, (flat.shape[0], 1))
    if starts is None and steps == 0:
        found = batched.in_blocks(_Closed(), arm, (flat, worth))
        return Projection(**{name: x.reshape(*batch, *x.shape[1:]) for name, x in found.items()})
    if starts is not None:
        starts = starts.reshape(-1, *starts.shape[-2:])
    few = jnp.full(worth.shape, min(steps, FIRST), jnp.int32)
    block = _Descending(priority)
    found = batched.in_blocks(block, arm, (flat, worth, few, starts, None))
    done = FIRST
    while done < steps:
        late = np.nonzero(~np.asarray(found["converged"]))
        if not late[0].size:
            break
        # Few are left after each turn, and all of a block take as many steps.
        more = done if 3 * done < steps else steps - done
        at, slot = (jnp.asarray(x) for x in late)
        q, damping = found["q"][at, slot][:, None], found["damping"][at, slot][:, None]
        turn = jnp.full((*at.shape, 1), more, jnp.int32)
        rest = batched.in_blocks(block, arm, (flat[at], worth[at], turn, q, damping))
        found = {name: x.at[at, slot].set(rest[name][:, 0]) for name, x in found.items()}
        done += more
    del found["damping"]
    return Projection(**{name: x.reshape(*batch, *x.shape[1:]) for name, x in found.items()})
