"""Which slots are within the joint limits, and which goals float32 cannot decide.

Limits are tested on sines and cosines: no angle is computed. Near a fold a rounding decides whether there are
two answers or none, and near a limit it decides whether a joint is within it. A goal within some roundings of
either is doubtful. Of random goals some thousandths are doubtful, and float64 decides one in a hundred of
these otherwise.
"""

import enum
import math
from collections.abc import Iterator
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ikjax.arm.arm import Arm
from ikjax.arm.forward import links, reach, whole_turns
from ikjax.core.tolerances import DOUBTFUL_FOLD, DOUBTFUL_LIMIT, DOUBTFUL_MISSES, VALID
from ikjax.solvers.pipeline import Slot


class LimitTests(NamedTuple):
    """The limits of an arm as the numbers that slots are tested with."""

    ends: Any
    """(n, 5) of a turning joint with a wide arc: sine and cosine of its middle, and the cosine of half of it.
    With a narrow arc or a narrow gap: the factors of sine and cosine
    in the cross products with both ends, and 1 or -1. Of a slide, and of coupled joints, the lower and the
    upper limit first."""
    shares: Any
    """(n, 6) of `limit_share`: the middle, a turn or zero, then constant and factor of two lines, of which
    the lesser counts."""


NARROW = 0.1
"""Arcs, and gaps between arcs, below this [rad] are tested by both ends: the cosine of half an arc tells it
to 4 roundings over its sine, which at this width is 1e-5 rad in float32, half of what `VALID` allows."""


class LimitKind(enum.Enum):
    """What is fixed of a joint's limits in a program whose limits are data."""

    NONE = (-math.inf, math.inf)
    """No limits, or a turn and more between them. A kernel without the test is a tenth faster."""
    WIDE = (-1.0, 1.0)
    NARROW = (0.0, 0.0)
    """An arc that is narrow, or leaves a narrow gap."""
    ENDS = (-2.0, 2.0)
    """Of slides and of coupled joints."""


def limit_kinds(arm: Arm) -> tuple[LimitKind, ...]:
    """The kind of each joint's limits; that of limits `LimitKind.value` is the same kind."""
    kinds = []
    limits = np.asarray(arm.limits, float)
    for whole, kind, (lower, upper) in zip(whole_turns(arm), arm.kinds, limits, strict=True):
        width = upper - lower
        is_open = bool(np.isinf([lower, upper]).all())
        if is_open or (whole and width >= 2 * math.pi):
            kinds.append(LimitKind.NONE)
        elif arm.coupling is not None or kind == "P":
            kinds.append(LimitKind.ENDS)
        elif width < NARROW or 2 * math.pi - width < NARROW:
            kinds.append(LimitKind.NARROW)
        else:
            kinds.append(LimitKind.WIDE)
    return tuple(kinds)


def limit_tests(arm: Arm) -> LimitTests:
    """The tests of an arm's limits, in numbers of the arm's type.

    Args:
        arm: A baked arm.
    """
    eps, ends, shares = float(np.finfo(arm.dtype).eps), np.zeros((arm.n, 5)), np.zeros((arm.n, 6))
    rows = zip(links(arm), whole_turns(arm), limit_kinds(arm), np.asarray(arm.limits, float), strict=True)
    for i, (link, whole, kind, (lower, upper)) in enumerate(rows):
        # A limit that is met exactly is within.
        low, high = lower - 8 * eps, upper + 8 * eps
        if kind == LimitKind.ENDS:
            ends[i, :2] = low, high
        elif kind == LimitKind.NARROW:
            # Left of the first end and right of the second one, and, where the arc is more than half a turn,
            # one of both: then both products have the other sign, and the lesser of them is the greater one.
            sign, first, last = 1 if high - low <= math.pi else -1, link.theta + low, link.theta + high
            ends[i, :2] = sign * math.cos(first), -sign * math.sin(first)
            ends[i, 2:4] = -sign * math.cos(last), sign * math.sin(last)
            ends[i, 4] = sign
        elif kind == LimitKind.WIDE:
            middle = link.theta + (lower + upper) / 2
            ends[i, :3] = math.sin(middle), math.cos(middle), math.cos((upper - lower) / 2) - 4 * eps
        shares[i] = _share_lines(arm, bool(whole), lower, upper)
    return LimitTests(ends.astype(arm.dtype), shares.astype(arm.dtype))


def _share_lines(arm: Arm, whole: bool, lower: float, upper: float) -> tuple[float, ...]:
    """A row of `LimitTests.shares`, by the rules of `limit_share`."""
    if math.isfinite(lower) and math.isfinite(upper):
        per = 1 / max((upper - lower) / 2, float(np.finfo(arm.dtype).tiny))
        return (lower + upper) / 2, 2 * math.pi if whole else 0.0, 1.0, per, 1.0, -per
    if whole or not (math.isfinite(lower) or math.isfinite(upper)):
        return 0.0, 0.0, 1.0, 0.0, 1.0, 0.0
    line = (-lower, 1.0) if math.isfinite(lower) else (upper, -1.0)
    return 0.0, 0.0, *line, *line


def tested_joints(arm: Arm, slot: Slot, tests: LimitTests) -> Iterator[tuple[int, jax.Array]]:
    """Each joint that has limits, counted from 0, and whether whole turns can bring it between them.

    Args:
        arm: A baked arm; of its own limits the kinds matter.
        slot: One of its slots.
        tests: The limits, of the kinds that the limits of `arm` have.
    """
    rows = zip(limit_kinds(arm), whole_turns(arm), slot.joints, slot.q, tests.ends, strict=True)
    for i, (kind, whole, joint, value, (first, second, third, fourth, sign)) in enumerate(rows):
        if kind == LimitKind.WIDE:
            yield i, joint.sin * first + joint.cos * second >= third
        elif kind == LimitKind.NARROW:
            past = joint.sin * first + joint.cos * second
            before = joint.sin * third + joint.cos * fourth
            yield i, sign * jnp.minimum(past, before) >= 0
        elif kind == LimitKind.ENDS:
            if whole:
                value = value + 2 * math.pi * jnp.ceil((first - value) / (2 * math.pi))
            yield i, (value >= first) & (value <= second)


def slot_within_limits(arm: Arm, slot: Slot, slack: float | None = None) -> jax.Array:
    """Whether whole turns can bring every joint of a slot between its limits.

    An angle lies between two others if it is left of the first and right of the second, by the signs of two
    cross products. An arc of more than half a turn is the complement of a shorter one, so there one of the
    two is enough.

    Args:
        arm: A baked arm.
        slot: One of its slots.
        slack: A joint so far beyond a limit is still within it [rad, m]; negative for so far inside. By
            default 8 roundings of the arm's type.

    Returns:
        bool, of the slot's shape; a scalar where no joint has limits.
    """
    return _all_of(joints_within_limits(arm, slot, slack))


def slot_passes(arm: Arm, slot: Slot, tests: LimitTests) -> jax.Array:
    """`slot_within_limits` for limits that are data."""
    return _all_of(tested_joints(arm, slot, tests))


def _all_of(flags: Iterator[tuple[int, jax.Array]]) -> jax.Array:
    inside = jnp.asarray(True)
    for _, flag in flags:
        inside = inside & flag
    return inside


def joints_within_limits(arm: Arm, slot: Slot, slack: float | None = None) -> Iterator[tuple[int, jax.Array]]:
    """Each joint that has limits, counted from 0, and whether whole turns can bring it between them.

    Arguments as in `slot_within_limits`.
    """
    slack = 8 * float(jnp.finfo(arm.dtype).eps) if slack is None else slack
    if arm.coupling is not None:
        yield from _coupled_within_limits(arm, slot, slack)
        return
    rows = zip(links(arm), slot.joints, slot.q, arm.limits.tolist(), strict=True)
    for i, (link, joint, value, (lower, upper)) in enumerate(rows):
        width = upper - lower
        if link.kind == "P":
            yield i, (value >= lower - slack) & (value <= upper + slack)
            continue
        if width >= 2 * math.pi:
            continue
        first, last = link.theta + lower, link.theta + upper
        past_first = joint.sin * math.cos(first) - joint.cos * math.sin(first)
        before_last = joint.cos * math.sin(last) - joint.sin * math.cos(last)
        if width <= math.pi:
            between = (past_first >= -slack) & (before_last >= -slack)
            # A short arc has an opposite one, where both signs are right for a limit met exactly.
            middle = (first + last) / 2
            between &= joint.cos * math.cos(middle) + joint.sin * math.sin(middle) > -max(slack, 0)
        else:
            between = (past_first >= -slack) | (before_last >= -slack)
        yield i, between


def limit_share(arm: Arm, slot: Slot, tests: LimitTests | None = None) -> jax.Array:
    """The distance of the joint nearest to a limit from that limit, as a share of half the joint's range.

    It is 1 in the middle of the range, 0 at the limit, and negative beyond it. A revolute joint is taken at
    the turn nearest to the middle; it is left out with one limit or none, because a whole turn can always
    meet one limit. Any other joint with one limit counts as if half its range were 1 m (or 1 rad). Without
    any limit the share is 1.

    Args:
        arm: A baked arm.
        slot: One of its slots.
        tests: Its limits, where they are not those of `arm`.

    Returns:
        Of the shape and type of the slot's margin.
    """
    least = jnp.ones_like(slot.margin)
    if tests is not None:
        for whole, value, row in zip(whole_turns(arm), slot.q, tests.shares, strict=True):
            offset = value - row[0]
            if whole:
                offset = offset - row[1] * jnp.round(offset / (2 * math.pi))
            least = jnp.minimum(least, jnp.minimum(row[2] + row[3] * offset, row[4] + row[5] * offset))
        return least
    for whole, value, (lower, upper) in zip(whole_turns(arm), slot.q, arm.limits.tolist(), strict=True):
        if not (math.isfinite(lower) and math.isfinite(upper)):
            inside = (
                value - lower if math.isfinite(lower) else upper - value if math.isfinite(upper) else None
            )
            if inside is not None and not whole:  # one limit alone: a range of two radians or meters
                least = jnp.minimum(least, inside)
            continue
        offset = value - (lower + upper) / 2
        if whole:
            offset = offset - 2 * math.pi * jnp.round(offset / (2 * math.pi))
        half_range = max((upper - lower) / 2, float(jnp.finfo(arm.dtype).tiny))
        least = jnp.minimum(least, 1 - jnp.abs(offset) / half_range)
    return least


def _coupled_within_limits(arm: Arm, slot: Slot, slack: float) -> Iterator[tuple[int, jax.Array]]:
    """The same for coupled joints: their limits are those of the motors, so angles are needed."""
    rows = zip(whole_turns(arm), slot.q, arm.limits.tolist(), strict=True)
    for i, (whole, value, (lower, upper)) in enumerate(rows):
        if whole and upper - lower >= 2 * math.pi:
            continue
        if whole:
            turn = 2 * math.pi
            value = value + turn * jnp.ceil((lower - slack - value) / turn)
        yield i, (value >= lower - slack) & (value <= upper + slack)


def within_all_but_one(arm: Arm, slot: Slot, tests: LimitTests | None = None) -> list[jax.Array | bool]:
    """For each joint, whether all other joints of a slot are within their limits.

    Args:
        arm: A baked arm.
        slot: One of its slots.
        tests: Its limits, where they are not those of `arm`.
    """
    flags: list[jax.Array | bool] = [True] * arm.n
    inside_of = joints_within_limits(arm, slot) if tests is None else tested_joints(arm, slot, tests)
    for i, inside in inside_of:
        flags[i] = inside
    before: list[jax.Array | bool] = [True]
    after: list[jax.Array | bool] = [True]
    for flag, last in zip(flags[:-1], flags[:0:-1], strict=True):
        before.append(before[-1] & flag)
        after.append(after[-1] & last)
    return [first & rest for first, rest in zip(before, reversed(after), strict=True)]


FREEDOMS = {"pose": 6, "position": 3, "planar_pose": 3, "planar_position": 2}
"""Numbers that a task asks for. An arm of fewer joints meets them on a lower-dimensional set only, so
every goal that it comes close to is doubtful."""


def is_doubtful(arm: Arm, slot: Slot) -> jax.Array:
    """Whether another rounding may decide otherwise: valid or not, within limits or not.

    Args:
        arm: A baked arm.
        slot: One of its slots.

    Returns:
        bool, of the slot's shape.
    """
    least, most = DOUBTFUL_MISSES
    close = slot.miss_squared <= most * most
    fold = slot.margin <= DOUBTFUL_FOLD * VALID[slot.margin.dtype.name] * reach(arm)
    unsure = fold | (slot.miss_squared >= least * least) | slot.continuum
    if FREEDOMS[arm.task] > arm.n:
        return close
    at_limit = slot_within_limits(arm, slot, DOUBTFUL_LIMIT) != slot_within_limits(arm, slot, -DOUBTFUL_LIMIT)
    return close & (unsure | at_limit)


def any_doubtful(arm: Arm, slots: tuple[Slot, ...]) -> jax.Array:
    """Whether any slot of a goal is doubtful."""
    any_slot = jnp.zeros((), bool)
    for slot in slots:
        any_slot = any_slot | is_doubtful(arm, slot)
    return any_slot
