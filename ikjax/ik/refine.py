"""`refine`: from given joints down to the nearest attainable pose.

The default descends by damped Newton steps (`ik.newton`); any other loss by an optax optimiser.
Called eagerly, all starts take a few steps, and those that are not down yet take more in turns.
"""

import dataclasses
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ikjax.arm.arm import Arm
from ikjax.core.known import as_array, is_traced, stop_gradient
from ikjax.core.pose import Pose
from ikjax.core.xla import pinned
from ikjax.ik import batched, newton
from ikjax.ik import lexicographic as priorities
from ikjax.ik.inline import Entries, entries_of
from ikjax.ik.lossy import minimised
from ikjax.ik.project_gradient import with_slopes
from ikjax.ik.projection import Projection
from ikjax.ik.solve import as_goals
from ikjax.solvers.pipeline import NEARLY_ROTATION, nearest_pose, proposed, reach

STEPS = 60
FIRST = 6
"""Steps that every start of an eager call takes; those not down yet take as many again, and so on."""


def refine(
    arm: Arm,
    goals,
    q0,
    length: float = 0.1,
    *,
    priority: str = "weighted",
    steps: int = STEPS,
    loss=None,
    optimizer=None,
) -> Projection:
    """The nearest attainable pose downhill from given joints, within the joint limits.

    Minimises |dp|^2 + (length * angle)^2, dp being the way between the tool's point and the goal's and angle
    the rotation between them. An arm whose task leaves out the orientation, or what lies off its plane, is
    asked for the rest. A start outside the limits is first moved into them, by whole turns where that will
    do. From there on no step makes the cost greater, beyond its rounding.

    Args:
        arm: Any arm of up to seven joints, of a family or of none.
        goals: T_world_tool, (..., 4, 4), float32 or float64. Of a rotation that is off by up to 1e-2, as
            three typed decimals are, the nearest rotation is the goal; `goal_error` says by how much. Beyond
            that, or of another bottom row, the goal is no pose: errors are NaN, and `q` is where it started.
        q0: (..., n) joint values to start from, or (..., S, n) for S starts of each goal.
        length: What a radian is worth [m]; positive. A short one holds the point and a long one the
            orientation, each to about its square over a square length of the arm.
        priority: "weighted" is that sum. "position": of the poses with the least distance, that of the least
            angle; "orientation" the reverse (`ik.lexicographic`), in stages of `steps`. Of the starts, those
            whose first error is the least to 1e-7 (float32: 1e-4) reaches or rad count as equal, and the
            second decides.
        steps: At most so many.
        loss: `loss(arm, goal, q)` of one goal (4, 4) and joints (n,), to minimise instead.
        optimizer: An optax optimiser for `loss`; `optax.adam(0.02)` by default. Joints are put back into the
            limits after each step, and the best of all steps is returned.

    Returns:
        `Projection`; its `cost` is the weighted one whatever the priority, and with `loss` that. Of several
        starts the best, and of those that are level, as branches in one pose are, the first. Inside jit it
        takes all `steps` for every start. `q`, `cost` and the errors have slopes in the goals and the arm's
        leaves, by the condition that holds at the bottom, joints at a limit standing still; those of `q` are
        zero where it is not `converged`. With a priority they are those of a last sum of both errors, to
        some 1e-3. With `loss` the slopes are those of its steps.

    Raises:
        ValueError: Wrong shapes or types.
    """
    goals, arm = checked(arm, goals, length, steps)
    starts = as_array(q0, goals.dtype)
    batch = goals.shape[:-2]
    wanted = (*batch, arm.n)
    if starts.ndim < goals.ndim or (goals.ndim == 2 and starts.ndim == 1):
        starts = starts[..., None, :] if starts.ndim else starts
    if starts.ndim == 0 or starts.shape[-1] != arm.n:
        raise ValueError(f"q0 must have shape {wanted} or (..., S, {arm.n}), got {jnp.shape(q0)}")
    if starts.shape[-2] == 0:
        raise ValueError(f"q0 must hold at least one start, got shape {jnp.shape(q0)}")
    try:
        starts = jnp.broadcast_to(starts, (*batch, starts.shape[-2], arm.n))
    except ValueError as error:
        raise ValueError(f"q0 must have shape {wanted} or (..., S, {arm.n}), got {jnp.shape(q0)}") from error
    if loss is None and optimizer is not None:
        raise ValueError("optimizer is of a loss: give loss= too")
    if loss is not None:
        if priority != "weighted":
            raise ValueError(f"priority is of the errors, and not of a loss: got {priority!r} with loss=")
        return best_of(arm, goals, minimised(arm, goals, starts, loss, optimizer, steps))
    priority = priorities.checked(arm, priority)
    return best_of(arm, goals, descended(arm, goals, starts, length, steps, priority), priority)


def checked(arm: Arm, goals, length, steps: int) -> tuple[jax.Array, Arm]:
    goals = as_goals(goals)
    if not isinstance(steps, int | np.integer) or steps < 0:
        raise ValueError(f"steps must be a whole number, not negative, got {steps!r}")
    if np.ndim(length) or (not isinstance(length, jax.core.Tracer) and not 0 < float(length) < np.inf):
        raise ValueError(f"length must be a positive number of metres, got {length}")
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
        goal, proper, near = asked(arm_still, entries)
        columns = proposals(arm_still, goal, near) if columns is None else columns
        found = from_starts(arm_still, goal, proper, columns, still[3], steps, None, priority)
    shape = found.cost.shape

    def rows(x):
        return jnp.moveaxis(jnp.broadcast_to(x, shape), 0, -1)

    q, bottom = (jnp.stack([rows(x) for x in joints], axis=-1) for joints in (found.q, found.bottom))
    fields = {name: rows(getattr(found, name)) for name in FIELDS}
    q, errors = with_slopes(arm, goals, q, bottom, length, fields["converged"], priority)
    return Projection(q=q, **{**fields, **errors})


FIELDS = ("cost", "position_error", "rotation_error", "gradient_norm", "converged")


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
    goal, proper, near = asked(arm, entries)
    shape, slots = goal.position[0].shape, []
    for q in proposed(arm, goal, near):
        held = tuple(near(jnp.broadcast_to(x, shape)) for x in newton.into_limits(arm, q))
        found = _from_starts(arm, goal, proper, held, length, 0, None, "weighted", near)
        slots.append(found._replace(cost=near(found.cost)))
    return slots


def asked(arm: Arm, entries: Entries):
    """The nearest pose in scalars, whether there is one, and what holds numbers of its shape."""
    goal, off = nearest_pose(entries, reach(arm))
    near = pinned(entries[0][3])
    return jax.tree.map(near, goal), off <= NEARLY_ROTATION, near


@jax.jit
def goal_error(goals: jax.Array) -> jax.Array:
    """By how much goals (..., 4, 4) are no poses, (...)."""
    return jax.lax.stop_gradient(nearest_pose(entries_of(goals), 1.0)[1])


def proposals(arm: Arm, goal: Pose, near) -> tuple[jax.Array, ...]:
    """The closed form's joints, each (S, ...)."""
    shape = goal.position[0].shape
    columns = zip(*proposed(arm, goal, near), strict=True)
    return tuple(jnp.stack([jnp.broadcast_to(x, shape) for x in column]) for column in columns)


def from_starts(
    arm: Arm, goal: Pose, proper, starts, length, steps, damping, priority: str = "weighted"
) -> Found:
    """All starts after their steps."""
    starts = newton.into_limits(arm, starts)
    goal = jax.tree.map(lambda x: x[None], goal)
    return _from_starts(arm, goal, proper[None], starts, length, steps, damping, priority, lambda x: x)


def _from_starts(arm: Arm, goal: Pose, proper, starts, length, steps, damping, priority: str, hold) -> Found:
    """Starts within the limits; what stands for the goal has their shape."""
    state, flat, bottom = priorities.descend(arm, goal, length, priority, starts, steps, pinned, damping)
    flat = hold(flat)
    at, size = state.at, reach(arm)
    seen = newton.is_seen(arm, goal, at, length)
    down = proper & seen & (flat <= newton.CONVERGED[flat.dtype.name])
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
        columns = batched.columns_of(goals)
        entries = tuple(tuple(columns[4 * i + j] for j in range(4)) for i in range(4))
        if starts is not None:
            spread = batched.columns_of(starts).reshape(*starts.shape[1:], -1)
            starts = tuple(spread[:, i] for i in range(arm.n))
            damping = None if damping is None else batched.columns_of(damping)
        goal, proper, near = asked(arm, entries)
        starts = proposals(arm, goal, near) if starts is None else starts

        def of_one(start):
            q, easing = jax.tree.map(lambda x: x[None], start)
            worth = length[None, :, 0]
            found = from_starts(arm, goal, proper, q, worth, steps[0, 0], easing, self.priority)
            return jax.tree.map(lambda x: x[0], found)

        # One start after the other: what lies between two steps of all of them is more than a cache holds.
        found = jax.lax.map(of_one, (starts, damping))
        count = found.cost.shape[0]
        fields = {name: batched.packed(list(getattr(found, name))) for name in (*FIELDS, "damping")}
        q = batched.packed([x[s] for s in range(count) for x in found.q])
        return {**fields, "q": q.reshape(-1, count, arm.n)}


@dataclasses.dataclass(frozen=True)
class _Closed:
    """A block of goals, the closed form alone."""

    def __call__(self, arm: Arm, rows) -> dict[str, jax.Array]:
        goals, length = rows
        columns = batched.columns_of(goals)
        entries = tuple(tuple(columns[4 * i + j] for j in range(4)) for i in range(4))
        slots = closed(arm, entries, length[:, 0])
        fields = {name: batched.packed([getattr(slot, name) for slot in slots]) for name in FIELDS}
        q = batched.packed([x for slot in slots for x in slot.q])
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
