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
from ikjax.ik.inline import entries_of, in_type, jit_with_arm, slots_of
from ikjax.ik.quality import joint_clearances, limit_clearance
from ikjax.ik.redundancy import with_ends
from ikjax.ik.results import Solutions
from ikjax.ik.select import of_slot, within_limits
from ikjax.ik.solve import as_goals, check_family, solve
from ikjax.ik.turns import nearest_turn
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

PARTS_SEARCHED = 6
"""Parts of one slot's curve, at most, that are searched for it."""

SAMPLES_SEARCHED = 256
"""Values of the redundant joint by which they are found: all slots are solved at once here, so more samples
cost little beside the search itself."""

PART_SAMPLES = 24
"""Values in each part, its ends among them. They are the roots of a Chebyshev polynomial, so denser near the
ends: at a fold the joints move as the square root of the distance from it, and so from one value to the next
by equal amounts."""

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
    samples: int = SAMPLES_SEARCHED,
) -> tuple[jax.Array, jax.Array]:
    """The posture whose largest joint move is least, over all values of the redundant joint.

    `nearest` takes the best branch at one value of the redundant joint; this searches all values, within the
    limits. The parts of every slot's curve are found as `self_motion` finds them; each is sampled, its ends
    and values that are denser near them, and the best local minima are searched by halving their brackets.
    It is a search and no proof: a part that `self_motion` does not find is left out.

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
    sol = solve(arm, goals[..., None, :, :], redundancy=values)
    clear = jnp.swapaxes(_clearance(arm, sol), goals.ndim - 2, goals.ndim - 1)
    flat, clear = goals.reshape(-1, 4, 4), clear.reshape(-1, *clear.shape[-2:])
    ends, is_part = _ends(arm, flat, values, clear, np.zeros(PARTS_SEARCHED, bool))
    search = functools.partial(_search, arm, factors, (values[0], values[-1]))
    rows = flat, present.reshape(-1, arm.n), ends, is_part
    found = in_blocks(search, (flat.shape[0],), rows, BLOCK).reshape(*goals.shape[:-2], arm.n + 1)
    return found[..., :-1], found[..., -1] > 0


def _checked(arm: Arm, goals: ArrayLike, samples: int) -> tuple[jax.Array, Arm]:
    check_family(arm)
    if len(arm.locked) != 1:
        raise ValueError(f"a self-motion wants one redundant joint, {arm.name} has {len(arm.locked)}")
    if not isinstance(samples, int | np.integer) or samples < 3:
        raise ValueError(f"samples must be a whole number, 3 or more, got {samples!r}")
    goals = as_goals(goals)
    return goals, in_type(arm, goals.dtype)


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
        # Sorting takes longer than the closed form.
        start = i == EXTREMUM_STEPS - 1
        new = jax.lax.cond(start, lambda: crossings(bracket), lambda: (low, high, rising, there))
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


def _part_samples(ends: jax.Array, own: jax.Array, span: tuple) -> tuple[jax.Array, ...]:
    """Values to be tried on the curves of all slots, and the values beside each on its curve, (N, M) each.

    Args:
        ends: (N, S, P, 2) of the parts.
        own: (N,) where the redundant joint is now: tried too, so that a goal that is reached already is found
            exactly.
        span: The least and the greatest value of the redundant joint.

    Returns:
        The slots (N, M), the values, those below and those above.
    """
    count, slots, parts, _ = ends.shape
    share = ((1 - np.cos(np.linspace(0, np.pi, PART_SAMPLES))) / 2).astype(ends.dtype)
    share = share.reshape(1, 1, 1, -1)
    low, high = ends[..., :1], ends[..., 1:]
    inner = low + (high - low) * share
    inner = jnp.where(share == 1, high, inner)
    below = jnp.concatenate([inner[..., :1], inner[..., :-1]], -1)
    above = jnp.concatenate([inner[..., 1:], inner[..., -1:]], -1)
    slot = jnp.arange(slots, dtype=jnp.int32)
    slot_inside = jnp.broadcast_to(slot[:, None, None], inner.shape)
    apart = (span[1] - span[0]) / SAMPLES
    now = jnp.broadcast_to(jnp.clip(own, *span)[:, None], (count, slots))
    beside = jnp.maximum(now - apart, span[0]), jnp.minimum(now + apart, span[1])
    ours = jnp.broadcast_to(slot, now.shape), now, *beside
    # A whole number of steps of the search.
    spare = -(slots * parts * PART_SAMPLES + slots) % (2 * CANDIDATES)

    def joined(inside, mine):
        every = jnp.concatenate([inside.reshape(count, -1), mine], -1)
        return jnp.concatenate([every, jnp.broadcast_to(every[:, -1:], (count, spare))], -1)

    return tuple(map(joined, (slot_inside, inner, below, above), ours))


def _peaks(level: jax.Array, is_part: jax.Array) -> jax.Array:
    """The levels (N, M) at local maxima along each part and where the arm is now, else -inf."""
    inside = level[:, : is_part[0].size * PART_SAMPLES].reshape(*is_part.shape, PART_SAMPLES)
    beside = jnp.full((*is_part.shape, 1), -jnp.inf, level.dtype)
    before = jnp.concatenate([beside, inside[..., :-1]], -1)
    after = jnp.concatenate([inside[..., 1:], beside], -1)
    is_peak = is_part[..., None] & (inside >= before) & (inside >= after)
    peaks = jnp.where(is_peak, inside, -jnp.inf).reshape(level.shape[0], -1)
    return jnp.concatenate([peaks, level[:, peaks.shape[1] :]], -1)


@functools.partial(jit_with_arm, whole=True)
def _search(arm: Arm, factors, span, flat: jax.Array, now: jax.Array, ends: jax.Array, is_part: jax.Array):
    """The nearest posture of each goal, and whether there is one, (N, n + 1).

    The first steps evaluate the samples of all parts, the others halve the brackets of the best of them; one
    loop, so that the closed form is compiled once.

    Args:
        arm: The arm.
        factors: (n,) on the moves.
        span: The least and the greatest value of the redundant joint.
        flat: (N, 4, 4) goals.
        now: (N, n) present joints.
        ends: (N, S, P, 2) of the parts of each slot's curve.
        is_part: (N, S, P) whether there are so many.
    """
    own, samples, below, above = _part_samples(ends, now[:, arm.locked[0]], span)
    weight = [factors[i] for i in range(arm.n)]
    ranges = [numbers(arm.limits[i]) for i in range(arm.n)]
    width = 2 * CANDIDATES
    sampling_steps = samples.shape[1] // width

    def at(own: jax.Array, r: jax.Array) -> tuple[jax.Array, jax.Array]:
        """Joints (N, K, n) of slots at values, both (N, K), and their levels."""
        pin = divider(r)
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
            moved.append(pin(turned))
            moves.append(jnp.abs(turned - near) * weight[i])
            counts = counts & inside
        return jnp.stack(moved, -1), pin(_level(arm, functools.reduce(jnp.maximum, moves), counts, clear))

    def best_samples(levels: jax.Array, joints: jax.Array):
        """Slot, bracket, level and joints of the best samples."""
        best, place = jax.lax.top_k(_peaks(levels, is_part), CANDIDATES)
        bracket = _pick(below, place), _pick(samples, place), _pick(above, place), best
        return _pick(own, place), bracket, jnp.take_along_axis(joints, place[..., None], axis=1)

    def step(i, state):
        levels, joints, (slot, bracket, q) = state
        sampling = i < sampling_steps
        first = jnp.minimum(i, sampling_steps - 1) * width
        low, middle, high, best = bracket
        halves = jnp.concatenate([(low + middle) / 2, (middle + high) / 2], -1)
        tried_q, tried = at(
            jnp.where(
                sampling,
                jax.lax.dynamic_slice_in_dim(own, first, width, 1),
                jnp.concatenate([slot, slot], -1),
            ),
            jnp.where(sampling, jax.lax.dynamic_slice_in_dim(samples, first, width, 1), halves),
        )
        left, right = tried[:, :CANDIDATES], tried[:, CANDIDATES:]
        better = jnp.where((left >= right)[..., None], tried_q[:, :CANDIDATES], tried_q[:, CANDIDATES:])
        q = jnp.where((jnp.maximum(left, right) > best)[..., None], better, q)

        def put(whole, part):
            return jax.lax.dynamic_update_slice_in_dim(whole, part, first, 1)

        levels = jnp.where(sampling, put(levels, tried), levels)
        joints = jnp.where(sampling, put(joints, tried_q), joints)
        searched = slot, _halved(bracket, (left, right)), q
        last = i == sampling_steps - 1
        chosen = jax.lax.cond(last, lambda: best_samples(levels, joints), lambda: searched)
        return levels, joints, chosen

    levels = jnp.full(samples.shape, -jnp.inf, samples.dtype)
    joints = jnp.zeros((*samples.shape, arm.n), samples.dtype)
    start = levels, joints, best_samples(levels, joints)
    steps = sampling_steps + EXTREMUM_STEPS
    _, _, (_, (_, _, _, level), q) = jax.lax.fori_loop(0, steps, step, start)
    winner = jnp.argmax(level, axis=-1)[:, None]
    level = jnp.take_along_axis(level, winner, axis=-1)
    q = jnp.take_along_axis(q, winner[..., None], axis=1)[:, 0]
    found = level > 0
    q = jnp.where(found, q, now)
    return jnp.concatenate([q, found.astype(q.dtype)], -1)
