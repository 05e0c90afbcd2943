"""Which slots hold within the joint limits, and which goals float32 cannot decide.

Limits are tested on sines and cosines: no angle is ever computed. Near a fold a rounding decides whether two
answers are there or none, and near a limit whether a joint is within it: a goal is doubtful that is within
some roundings of either. Of random goals some thousandths are, of which one in a hundred comes out otherwise
in float64.
"""

import math

import jax
import jax.numpy as jnp

from ikjax.arm.arm import Arm
from ikjax.arm.forward import links, reach, whole_turns
from ikjax.core.tolerances import DOUBTFUL_FOLD, DOUBTFUL_LIMIT, DOUBTFUL_MISSES, VALID
from ikjax.solvers.pipeline import Slot


def within(arm: Arm, slot: Slot, slack: float | None = None) -> jax.Array:
    """Whether whole turns can bring every joint of a slot between its limits.

    An angle lies between two others when it is left of the one and right of the other, by the sign
    of cross products; an arc of more than half a turn is the complement of one of less.

    Args:
        arm: A baked arm.
        slot: One of its slots.
        slack: So far beyond a limit is still within [rad, m]; by default what rounding takes.
    """
    slack = 8 * float(jnp.finfo(arm.dtype).eps) if slack is None else slack
    if arm.coupling is not None:
        return _by_value(arm, slot, slack)
    inside = jnp.asarray(True)
    rows = zip(links(arm), slot.joints, slot.q, arm.limits.tolist(), strict=True)
    for link, joint, value, (lower, upper) in rows:
        width = upper - lower
        if link.kind == "P":
            inside = inside & (value >= lower - slack) & (value <= upper + slack)
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
        inside = inside & between
    return inside


def distance(arm: Arm, slot: Slot) -> jax.Array:
    """How far the joint that is nearest to a limit is from it, as a share of half its range.

    1 is the middle, 0 at the limit, negative beyond it; a turning joint is taken at the turn nearest
    to the middle, and left out with one limit or none: whole turns always meet it. Without any limit it is 1.

    Args:
        arm: A baked arm.
        slot: One of its slots.
    """
    least = jnp.ones_like(slot.margin)
    for whole, value, (lower, upper) in zip(whole_turns(arm), slot.q, arm.limits.tolist(), strict=True):
        if not (math.isfinite(lower) and math.isfinite(upper)):
            near = value - lower if math.isfinite(lower) else upper - value if math.isfinite(upper) else None
            if near is not None and not whole:  # one limit alone: a range of two radians or metres
                least = jnp.minimum(least, near)
            continue
        away = value - (lower + upper) / 2
        if whole:
            away = away - 2 * math.pi * jnp.round(away / (2 * math.pi))
        half = max((upper - lower) / 2, float(jnp.finfo(arm.dtype).tiny))
        least = jnp.minimum(least, 1 - jnp.abs(away) / half)
    return least


def _by_value(arm: Arm, slot: Slot, slack: float) -> jax.Array:
    """The same for coupled joints, whose limits are those of the motors."""
    inside = jnp.asarray(True)
    for whole, value, (lower, upper) in zip(whole_turns(arm), slot.q, arm.limits.tolist(), strict=True):
        if whole and upper - lower >= 2 * math.pi:
            continue
        if whole:
            turn = 2 * math.pi
            value = value + turn * jnp.ceil((lower - slack - value) / turn)
        inside = inside & (value >= lower - slack) & (value <= upper + slack)
    return inside


FREEDOMS = {"pose": 6, "position": 3, "planar_pose": 3, "planar_position": 2}
"""Numbers that a task asks for. An arm of fewer joints meets them on a surface, never for sure off a grid."""


def doubtful(arm: Arm, slot: Slot) -> jax.Array:
    """Whether another rounding may decide otherwise.

    Args:
        arm: A baked arm.
        slot: One of its slots.
    """
    least, most = DOUBTFUL_MISSES
    close = slot.miss_squared <= most * most
    fold = slot.margin <= DOUBTFUL_FOLD * VALID[slot.margin.dtype.name] * reach(arm)
    unsure = fold | (slot.miss_squared >= least * least) | slot.continuum
    if FREEDOMS[arm.task] > arm.n:
        return close
    at_limit = within(arm, slot, DOUBTFUL_LIMIT) != within(arm, slot, -DOUBTFUL_LIMIT)
    return close & (unsure | at_limit)


def any_doubtful(arm: Arm, slots: tuple[Slot, ...]) -> jax.Array:
    """Whether any slot of a goal is."""
    found = jnp.zeros((), bool)
    for slot in slots:
        found = found | doubtful(arm, slot)
    return found
