"""Which slots are within the joint limits, and which goals float32 cannot decide.

Limits are tested on sines and cosines: no angle is computed. Near a fold a rounding decides whether there are
two answers or none, and near a limit it decides whether a joint is within it. A goal within some roundings of
either is doubtful. Of random goals some thousandths are doubtful, and float64 decides one in a hundred of
these otherwise.
"""

import math
from collections.abc import Iterator

import jax
import jax.numpy as jnp

from ikjax.arm.arm import Arm
from ikjax.arm.forward import links, reach, whole_turns
from ikjax.core.tolerances import DOUBTFUL_FOLD, DOUBTFUL_LIMIT, DOUBTFUL_MISSES, VALID
from ikjax.solvers.pipeline import Slot


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
    inside = jnp.asarray(True)
    for _, flag in joints_within_limits(arm, slot, slack):
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


def limit_share(arm: Arm, slot: Slot) -> jax.Array:
    """The distance of the joint nearest to a limit from that limit, as a share of half the joint's range.

    It is 1 in the middle of the range, 0 at the limit, and negative beyond it. A revolute joint is taken at
    the turn nearest to the middle; it is left out with one limit or none, because a whole turn can always
    meet one limit. Any other joint with one limit counts as if half its range were 1 m (or 1 rad). Without
    any limit the share is 1.

    Args:
        arm: A baked arm.
        slot: One of its slots.

    Returns:
        Of the shape and type of the slot's margin.
    """
    least = jnp.ones_like(slot.margin)
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


def within_all_but_one(arm: Arm, slot: Slot) -> list[jax.Array | bool]:
    """For each joint, whether all other joints of a slot are within their limits.

    Args:
        arm: A baked arm.
        slot: One of its slots.
    """
    flags: list[jax.Array | bool] = [True] * arm.n
    for i, inside in joints_within_limits(arm, slot):
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
