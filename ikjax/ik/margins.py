"""Margins that can be climbed: smoothly over branches and goals, and with the joint limits in them.

A margin says how far a branch is from its end, also from outside, where no joints exist; so it
shows the way in. The maximum over branches and the minimum over goals have a slope for one entry alone,
which jumps from one to another; the smooth ones share it out among entries that differ by less than a `blur`.
"""

import dataclasses

import jax
import jax.numpy as jnp

from ikjax.arm.arm import Arm
from ikjax.arm.forward import reach
from ikjax.ik.quality import limit_clearance
from ikjax.ik.results import Solutions
from ikjax.ik.select import within_limits


def smooth_max(x, blur=0.0, *, axis: int = -1, where=None, empty: float = 0.0) -> jax.Array:
    """The maximum with a slope for every entry: blur * log(sum(exp(x / blur))).

    It is never below the maximum, and above it by blur * log(number of entries) at most.

    Args:
        x: (..., m, ...).
        blur: In the units of x, >= 0, and may be traced. Zero is the maximum itself.
        axis: Which axis is reduced.
        where: Mask of the shape of x: what is masked counts for nothing, nor does what is not finite.
        empty: The value where nothing counts; its slope is zero.

    Returns:
        x without the axis.
    """
    x = jnp.asarray(x)
    counts = jnp.isfinite(x) if where is None else jnp.isfinite(x) & where
    least = jnp.finfo(x.dtype).min
    x = jnp.where(counts, x, least)
    top = jnp.max(x, axis=axis, keepdims=True)
    best = jnp.squeeze(top, axis)
    if not (isinstance(blur, int | float) and blur == 0):
        blur = jnp.asarray(blur, x.dtype)
        soft = jnp.where(blur > 0, blur, 1)
        # The greatest entry is only a shift: it takes no part in the slope.
        top = jax.lax.stop_gradient(top)
        below = jnp.where(counts, x - top, 0) / soft
        sums = jnp.sum(jnp.where(counts, jnp.exp(below), 0), axis=axis)
        smooth = jnp.squeeze(top, axis) + soft * jnp.log(jnp.where(sums > 0, sums, 1))
        best = jnp.where(blur > 0, smooth, best)
    return jnp.where(counts.any(axis), best, jnp.asarray(empty, x.dtype))


def smooth_min(x, blur=0.0, *, axis: int = -1, where=None, empty: float = 0.0) -> jax.Array:
    """The minimum with a slope for every entry: -smooth_max(-x), never above the minimum."""
    return -smooth_max(-jnp.asarray(x), blur, axis=axis, where=where, empty=-empty)


def limited_margins(arm: Arm, sol: Solutions) -> Solutions:
    """`within_limits`, and margins that end at the joint limits as well as at the folds.

    A radian counts one reach [m], as a slide of one reach counts a radian. Where a branch reaches its
    goal, the margin is the lesser of the two clearances. Elsewhere there are no joints whose limits could
    be looked at, and the margin is what is left to the fold, zero at most: a branch that arrives beyond
    its limits drops below zero as it arrives. Joints of slots that are not valid stand still, so a margin
    made of them would have a value that moves and a slope that does not.

    Args:
        arm: The arm, with limits.
        sol: From `solve`, as it came.
    """
    arm = arm.baked()
    spare = reach(arm) * limit_clearance(arm, sol.q)
    spare = jnp.asarray(spare, sol.margin.dtype)
    margin = jnp.minimum(sol.margin, jnp.where(sol.valid, spare, 0))
    return dataclasses.replace(within_limits(arm, sol), margin=margin)


def best_margin(arm: Arm, sol: Solutions, *, blur=0.0, limits: bool = True) -> jax.Array:
    """The margin of the best branch of each goal [m]: positive where the goal is reached.

    Outside the workspace it says how far the goal is from a fold, joint limits aside, and has the slope that
    leads there.
    Where a quartic is solved (`pieper`, `position`, `parallel_axes`) it is that distance to first order.

    Args:
        arm: The arm.
        sol: From `solve`, as it came.
        blur: Branches whose margins differ by less [m] share the slope; see `smooth_max`.
        limits: Whether the joint limits count; see `limited_margins`.

    Returns:
        (...), one for each goal.
    """
    return smooth_max((limited_margins(arm, sol) if limits else sol).margin, blur)
