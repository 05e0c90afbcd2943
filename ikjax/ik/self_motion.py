"""The self-motion of a goal: every posture that reaches it, as the redundant joint moves.

Each slot is a curve over the values of the redundant joint. It is sampled; then its parts are found whose
joints are within the limits, and the ends of each. Between two samples the clearance (of the fold, and of the
limits) may change its sign twice: so local extrema of the samples are searched for a value of the other sign.

Both searches evaluate the closed form at a few values a slot and step, in one loop: in scalars, because a
stack of all slots would compile for ten seconds more.
"""

import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike

from ikjax.arm.arm import Arm, numbers
from ikjax.arm.forward import reach, whole_turns
from ikjax.core.tolerances import TINY
from ikjax.core.warn import MOST_TURNS, warn_of_degrees
from ikjax.core.xla import as_array, divider, in_blocks, pinning, stop_gradient
from ikjax.ik.inline import entries_of, jit_with_arm, slots_of
from ikjax.ik.quality import joint_clearances, limit_clearance
from ikjax.ik.redundancy import with_ends
from ikjax.ik.results import Solutions
from ikjax.ik.select import of_slot, within_limits
from ikjax.ik.solve import as_goals, check_family, solve
from ikjax.ik.turns import limits_like, nearest_turn
from ikjax.solvers.pipeline import Slot

SAMPLES = 64
"""Values of the redundant joint over its range."""

PARTS = 4
"""Parts of one slot's curve, at most."""

EXTREMUM_STEPS = 30
"""Each halves the bracket of an extremum: 2e-10 rad of the 0.2 rad that two of 64 samples are apart."""

END_STEPS = 34
"""Each halves the bracket of an end: 6e-12 rad of 0.1 rad."""

CANDIDATES = 16
"""Local minima of the samples that are searched for the nearest posture."""

BLOCK = 64
"""Goals whose nearest postures are searched at a time: their samples fit the cache."""


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True, eq=False)
class SelfMotion:
    """Every posture that reaches a goal: R values of the redundant joint, S slots, P parts a slot."""

    redundancy: jax.Array
    """(R,) values of the redundant joint [rad, m], over its limits, or over a turn."""
    q: jax.Array
    """(..., S, R, n) joint values [rad, m], moved by whole turns into the limits where that is possible."""
    valid: jax.Array
    """(..., S, R) bool: the slot reaches the goal."""
    within: jax.Array
    """(..., S, R) bool: and its joints are within the limits."""
    margin: jax.Array
    """(..., S, R) clearance of the fold [m]; see `Solutions`."""
    parts: jax.Array
    """(..., S, P, 2) ends of the parts within the limits, as values of the redundant joint, increasing."""
    is_part: jax.Array
    """(..., S, P) bool: there is such a part; elsewhere the ends mean nothing, and are finite."""

    def __str__(self) -> str:
        if isinstance(self.parts, jax.core.Tracer):
            return repr(self)
        parts, is_part = np.asarray(self.parts), np.asarray(self.is_part)
        lines = [f"{len(self.redundancy)} samples from {self.redundancy[0]:.4g} to {self.redundancy[-1]:.4g}"]
        for *goal, slot in np.ndindex(is_part.shape[:-1]):
            ends = parts[(*goal, slot)][is_part[(*goal, slot)]]
            where = f"goal {', '.join(map(str, goal))}, " if goal else ""
            said = ", ".join(f"[{low:.6g}, {high:.6g}]" for low, high in ends) or "nowhere"
            lines.append(f"{where}slot {slot}: within the limits on {said}")
        return "\n".join(lines)


def self_motion(arm: Arm, goals: ArrayLike, *, samples: int = SAMPLES, parts: int = PARTS) -> SelfMotion:
    """Every posture that reaches a goal, over the range of the redundant joint.

    The ends of a part are where the margin or a limit's clearance changes its sign, found by bisection to the
    rounding of the goals' type. A part, or a gap, that is narrower than two samples and shows in none of them
    as an extremum is not found.

    Args:
        arm: An arm with one redundant joint (`arm.redundant`).
        goals: T_world_tool, (..., 4, 4), float32 or float64.
        samples: Values of the redundant joint, 3 or more.
        parts: Parts of each slot's curve, at most; further ones are left out.

    Returns:
        `SelfMotion`. It has no derivatives: `solve` at one of its values has.

    Raises:
        ValueError: Another number of redundant joints than one, wrong shapes or types.
    """
    goals, arm = _checked(arm, goals, samples)
    if parts < 1:
        raise ValueError(f"parts must be 1 or more, got {parts}")
    arm, goals = stop_gradient((arm, goals))
    values = with_ends(arm, samples, goals.dtype)
    sol = solve(arm, goals[..., None, :, :], redundancy=values)
    inside = within_limits(arm, sol)

    def slots_first(x):
        return jnp.swapaxes(x, goals.ndim - 2, goals.ndim - 1)

    clear = slots_first(_clearance(arm, sol))
    batch, flat = goals.shape[:-2], goals.reshape(-1, 4, 4)
    ends, is_part = _ends(arm, flat, values, clear.reshape(-1, *clear.shape[-2:]), np.zeros(parts, bool))
    return SelfMotion(
        jnp.asarray(values),
        slots_first(inside.q),
        slots_first(sol.valid),
        slots_first(inside.valid),
        slots_first(sol.margin),
        ends.reshape(*batch, *ends.shape[1:]),
        is_part.reshape(*batch, *is_part.shape[1:]),
    )


def nearest_on_self_motion(
    arm: Arm,
    goals: ArrayLike,
    q_now: ArrayLike,
    weights: ArrayLike | None = None,
    *,
    samples: int = SAMPLES,
) -> tuple[jax.Array, jax.Array]:
    """The posture whose largest joint move is least, over all values of the redundant joint.

    `nearest` takes the best branch at one value of the redundant joint; this searches all values, within the
    limits: from the best local minima of the samples, each by halving its bracket. It is a search and no
    proof: of 1,000 pairs of random postures of a Franka, 8 answers were farther than the best of 512 values,
    by up to 1 rad. They are beside folds, where the joints turn so fast that no sample points to the place.

    Args:
        arm: An arm with one redundant joint.
        goals: T_world_tool, (..., 4, 4), float32 or float64.
        q_now: The arm's present joints, (..., n) [rad, m].
        weights: (n,) non-negative factors on the moves, one by default.
        samples: Values of the redundant joint, 3 or more.

    Returns:
        `q`, (..., n), within the limits, and whether there is such a posture, (...); else `q` is q_now.
        There are no derivatives.

    Raises:
        ValueError: Another number of redundant joints than one, wrong shapes or types.
    """
    goals, arm = _checked(arm, goals, samples)
    present = as_array(q_now, goals.dtype)
    if present.ndim == 0 or present.shape[-1] != arm.n:
        raise ValueError(f"q_now must have shape (..., {arm.n}), got {present.shape}")
    warn_of_degrees("q_now", present, MOST_TURNS, arm.kinds)
    factors = np.ones(arm.n) if weights is None else weights
    factors = as_array(np.asarray(factors) if isinstance(factors, list | tuple) else factors, goals.dtype)
    if factors.shape != (arm.n,):
        raise ValueError(f"weights must have shape ({arm.n},), got {factors.shape}")
    present = jnp.broadcast_to(present, (*goals.shape[:-2], arm.n))
    values = with_ends(arm, samples, goals.dtype)
    arm, goals, present, factors = stop_gradient((arm, goals, present, factors))
    # Where the arm is now is one of the samples: a goal that it reaches already is found exactly.
    own = jnp.clip(present[..., arm.locked], values[0], values[-1])
    every = jnp.concatenate([jnp.broadcast_to(values, (*goals.shape[:-2], samples)), own], -1)
    sol = solve(arm, goals[..., None, :, :], redundancy=every)
    near = jnp.broadcast_to(present[..., None, None, :], sol.q.shape)
    q, inside = nearest_turn(sol.q, *limits_like(arm, sol.q), near)
    move = jnp.max(jnp.abs(q - near) * jnp.broadcast_to(factors, q.shape), axis=-1)
    level = _level(arm, move, sol.valid & inside.all(-1), _clearance(arm, sol))
    starts = _candidates(every, level, q)
    search = functools.partial(_search, arm, factors)
    found = in_blocks(search, goals.shape[:-2], (goals, present, *starts), BLOCK)
    return found[..., :-1], found[..., -1] > 0


def _checked(arm: Arm, goals: ArrayLike, samples: int) -> tuple[jax.Array, Arm]:
    check_family(arm)
    if len(arm.locked) != 1:
        raise ValueError(f"a self-motion wants one redundant joint, {arm.name} has {len(arm.locked)}")
    if not isinstance(samples, int | np.integer) or samples < 3:
        raise ValueError(f"samples must be a whole number, 3 or more, got {samples!r}")
    goals = as_goals(goals)
    return goals, arm.baked().astype(goals.dtype)


def _clearance(arm: Arm, sol: Solutions) -> jax.Array:
    """Of the fold, and within it of the limits as well [m]: the sign says whether a slot counts."""
    return _joined(arm, sol.margin, sol.valid, limit_clearance(arm, sol.q))


def _joined(arm: Arm, margin: jax.Array, valid: jax.Array, spare: jax.Array) -> jax.Array:
    """The clearance of a slot from its margin [m] and that of its limits [rad]."""
    size = jnp.asarray(reach(arm), margin.dtype)
    # What rounding masks within its fold counts as just outside.
    inside = jnp.where(valid, size * spare, jnp.minimum(size * spare, -TINY * jnp.finfo(margin.dtype).eps))
    return jnp.where(margin >= 0, jnp.minimum(margin, inside), margin)


def _level(arm: Arm, move, counts, clear):
    """What the nearest posture maximizes: positive and decreasing with the move where it counts, else the
    clearance in reaches, which leads to where it counts."""
    size = jnp.asarray(reach(arm), clear.dtype)
    return jnp.where(counts, 1 / (1 + move), jnp.minimum(clear, 0) / size)


def _slots_at(arm: Arm, flat: jax.Array, r: jax.Array) -> tuple[Slot, ...]:
    """Every slot of goals (N, 4, 4) at values (N, ...), each number an array of that shape."""
    shape = (-1, *[1] * (r.ndim - 1))
    entries = jax.tree.map(lambda x: jnp.broadcast_to(x.reshape(shape), r.shape), entries_of(flat))
    policy = divider(r)
    with pinning(policy):
        slots = slots_of(arm, entries, None, None, r[..., None])
    return tuple(slot._replace(q=tuple(map(policy, slot.q)), margin=policy(slot.margin)) for slot in slots)


def _first(flags: jax.Array, count: int) -> tuple[jax.Array, jax.Array]:
    """Places of the first flags that are set along the last axis, and whether there are so many."""
    order = jnp.argsort(~flags, axis=-1, stable=True)[..., :count]
    return order, jnp.take_along_axis(flags, order, axis=-1)


def _pick(x: jax.Array, places: jax.Array) -> jax.Array:
    return jnp.take_along_axis(x, places, axis=-1)


def _halved(bracket: tuple[jax.Array, ...], tried: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, ...]:
    """A bracket (low, middle, high) of a maximum of the values, and the middle's, half as wide.

    Args:
        bracket: Two ends, the middle between them, and its value.
        tried: The values half-way between the middle and the ends, the lower half first.
    """
    low, middle, high, best = bracket
    left, right = tried
    lower, upper = (low + middle) / 2, (middle + high) / 2
    go_left, go_right = (left > best) & (left >= right), (right > best) & (right > left)
    return (
        jnp.where(go_left, low, jnp.where(go_right, middle, lower)),
        jnp.where(go_left, lower, jnp.where(go_right, upper, middle)),
        jnp.where(go_left, middle, jnp.where(go_right, high, upper)),
        jnp.where(go_left, left, jnp.where(go_right, right, best)),
    )


@functools.partial(jit_with_arm, whole=True)
def _ends(
    arm: Arm, flat: jax.Array, samples: jax.Array, clear: jax.Array, slots_of_parts: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """The parts of curves where their clearance is positive, (N, S, P, 2), and whether there are so many.

    Args:
        arm: The arm.
        flat: (N, 4, 4) goals.
        samples: (R,) values of the redundant joint, increasing.
        clear: (N, S, R) the clearance there.
        slots_of_parts: (P,), whose length is how many parts are looked for.
    """
    parts = slots_of_parts.shape[0]
    count, slots = 2 * parts, clear.shape[1]
    values = jnp.broadcast_to(samples, clear.shape)

    def at(r: jax.Array) -> jax.Array:
        """The clearance of each slot at values of its own, (N, S, K)."""
        own = jnp.broadcast_to(jnp.arange(slots, dtype=jnp.int32)[None, :, None], r.shape)
        every = _slots_at(arm, flat, r)
        spare = [functools.reduce(jnp.minimum, joint_clearances(arm, slot.q)) for slot in every]
        fields = ([slot.margin for slot in every], [slot.valid for slot in every], spare)
        return _joined(arm, *(of_slot(own, field) for field in fields))

    positive = clear >= 0
    toward = jnp.where(positive, -clear, clear)
    before, after = toward[..., :-2], toward[..., 2:]
    alike = (positive[..., :-2] == positive[..., 1:-1]) & (positive[..., 2:] == positive[..., 1:-1])
    peak = alike & (toward[..., 1:-1] >= before) & (toward[..., 1:-1] >= after)
    place, is_peak = _first(peak, count)
    sign = jnp.where(_pick(positive, place + 1), -1, 1).astype(clear.dtype)
    bracket = (*(_pick(values, place + k) for k in range(3)), _pick(toward, place + 1))

    def crossings(bracket):
        """The brackets of the ends: (..., 2 count), and which side is positive."""
        extremum, level = bracket[1], sign * bracket[3]
        r = jnp.concatenate([values, jnp.where(is_peak, extremum, values[..., -1:])], -1)
        g = jnp.concatenate([clear, jnp.where(is_peak, level, clear[..., -1:])], -1)
        order = jnp.argsort(r, axis=-1, stable=True)
        r, g = _pick(r, order), _pick(g, order)
        change, there = _first((g[..., 1:] >= 0) != (g[..., :-1] >= 0), count)
        return _pick(r, change), _pick(r, change + 1), _pick(g, change + 1) >= 0, there

    def step(i, state):
        bracket, low, high, rising, there = state
        searching = i < EXTREMUM_STEPS
        first, middle, last, _ = bracket
        points = jnp.concatenate([(first + middle) / 2, (middle + last) / 2], -1)
        half = (low + high) / 2
        tried = at(jnp.where(searching, points, jnp.concatenate([half, half], -1)))
        left, right = tried[..., :count], tried[..., count:]
        moved = _halved(bracket, (sign * left, sign * right))
        bracket = tuple(jnp.where(searching & is_peak, x, y) for x, y in zip(moved, bracket, strict=True))
        to_high = (left >= 0) == rising
        low = jnp.where(searching | to_high, low, half)
        high = jnp.where(searching | ~to_high, high, half)
        found = crossings(bracket)
        start = i == EXTREMUM_STEPS - 1
        new = tuple(jnp.where(start, x, y) for x, y in zip(found, (low, high, rising, there), strict=True))
        return bracket, *new

    start = (bracket, *crossings(bracket))
    _, low, high, rising, there = jax.lax.fori_loop(0, EXTREMUM_STEPS + END_STEPS, step, start)
    # The end that is within: the bracket's side of positive clearance.
    infinity = jnp.asarray(jnp.inf, clear.dtype)
    begins = jnp.where(there & rising, high, infinity)
    stops = jnp.where(there & ~rising, low, infinity)
    begins = jnp.concatenate([jnp.where(clear[..., :1] >= 0, values[..., :1], infinity), begins], -1)
    stops = jnp.concatenate([stops, jnp.where(clear[..., -1:] >= 0, values[..., -1:], infinity)], -1)
    pairs = jnp.stack([jnp.sort(begins, axis=-1), jnp.sort(stops, axis=-1)], -1)[..., :parts, :]
    is_part = jnp.isfinite(pairs).all(-1)
    return jnp.where(is_part[..., None], pairs, values[..., -1:, None]), is_part


def _candidates(every: jax.Array, level: jax.Array, q: jax.Array) -> tuple[jax.Array, ...]:
    """The best local maxima of samples: slot, bracket, level and joints of each, (..., C) and (..., C, n).

    Args:
        every: (..., R + 1) the values, of which the last is of the arm's present joints.
        level: (..., R + 1, S).
        q: (..., R + 1, S, n).
    """
    batch, count, slots = level.shape[:-2], level.shape[-2], level.shape[-1]
    grid, beside = level[..., :-1, :], jnp.full((*batch, 1, slots), -jnp.inf, level.dtype)
    before = jnp.concatenate([beside, grid[..., :-1, :]], -2)
    after = jnp.concatenate([grid[..., 1:, :], beside], -2)
    peak = jnp.where((grid >= before) & (grid >= after), grid, -jnp.inf)
    peak = jnp.concatenate([peak, level[..., -1:, :]], -2).reshape(*batch, count * slots)
    best, place = jax.lax.top_k(peak, CANDIDATES)
    middle = _pick(every, place // slots)
    apart = every[..., 1:2] - every[..., :1]
    low = jnp.maximum(middle - apart, every[..., :1])
    high = jnp.minimum(middle + apart, every[..., -2:-1])
    joints = jnp.take_along_axis(q.reshape(*batch, count * slots, -1), place[..., None], axis=-2)
    return place % slots, low, middle, high, best, joints


@functools.partial(jit_with_arm, whole=True)
def _search(arm: Arm, factors, goals: jax.Array, present: jax.Array, slot, low, middle, high, level, q):
    """The best candidate after its search: q and whether it counts, (..., n + 1)."""
    batch, flat = goals.shape[:-2], goals.reshape(-1, 4, 4)
    now = present.reshape(-1, arm.n)
    slot, low, middle, high, level = (x.reshape(-1, CANDIDATES) for x in (slot, low, middle, high, level))
    q = q.reshape(-1, CANDIDATES, arm.n)
    own = jnp.concatenate([slot, slot], -1)
    weight = [factors[i] for i in range(arm.n)]
    ranges = [numbers(arm.limits[i]) for i in range(arm.n)]

    def at(r: jax.Array) -> tuple[jax.Array, jax.Array]:
        """Joints (N, K, n) of the candidates' slots at values (N, K), and their levels."""
        every = _slots_at(arm, flat, r)
        values = [of_slot(own, [each.q[i] for each in every]) for i in range(arm.n)]
        margin, valid = (
            of_slot(own, [getattr(each, name) for each in every]) for name in ("margin", "valid")
        )
        clear = _joined(
            arm, margin, valid, functools.reduce(jnp.minimum, joint_clearances(arm, tuple(values)))
        )
        moved, moves, counts = [], [], valid
        for i, (x, (lower, upper), whole) in enumerate(zip(values, ranges, whole_turns(arm), strict=True)):
            near = jnp.broadcast_to(now[:, i : i + 1], x.shape)
            turned, inside = nearest_turn(x, lower, upper, whole, near)
            moved.append(turned)
            moves.append(jnp.abs(turned - near) * weight[i])
            counts = counts & inside
        return jnp.stack(moved, -1), _level(arm, functools.reduce(jnp.maximum, moves), counts, clear)

    def step(_, state):
        bracket, q = state
        low, middle, high, _ = bracket
        tried_q, tried = at(jnp.concatenate([(low + middle) / 2, (middle + high) / 2], -1))
        left, right = tried[:, :CANDIDATES], tried[:, CANDIDATES:]
        better = jnp.where((left >= right)[..., None], tried_q[:, :CANDIDATES], tried_q[:, CANDIDATES:])
        q = jnp.where((jnp.maximum(left, right) > bracket[3])[..., None], better, q)
        return _halved(bracket, (left, right)), q

    (_, _, _, level), q = jax.lax.fori_loop(0, EXTREMUM_STEPS, step, ((low, middle, high, level), q))
    winner = jnp.argmax(level, axis=-1)[:, None]
    level = jnp.take_along_axis(level, winner, axis=-1)
    q = jnp.take_along_axis(q, winner[..., None], axis=1)[:, 0]
    found = level > 0
    q = jnp.where(found, q, now)
    return jnp.concatenate([q, found.astype(q.dtype)], -1).reshape(*batch, arm.n + 1)
