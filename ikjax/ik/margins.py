"""Margins as objectives for gradient ascent: smooth over branches and goals, and with the joint limits in
them.

A margin says how far a branch is from its end. It does so from outside too, where no joints exist, so its
gradient leads into the workspace. The maximum over branches and the minimum over goals have a gradient for
one entry alone, which jumps from one entry to another. The smooth ones (log-sum-exp) share it among entries
that differ by less than a `blur`.
"""

import dataclasses

import jax
import jax.numpy as jnp
from jax.typing import ArrayLike

from ikjax.arm.arm import Arm
from ikjax.arm.forward import reach
from ikjax.ik.quality import limit_clearance
from ikjax.ik.results import Solutions
from ikjax.ik.select import within_limits


def smooth_max(
    x: ArrayLike,
    blur: ArrayLike = 0.0,
    *,
    axis: int = -1,
    where: ArrayLike | None = None,
    empty: float = 0.0,
) -> jax.Array:
    """The maximum with a gradient for every entry: blur * log(sum(exp(x / blur))).

    It is never below the maximum, and above it by blur * log(number of entries) at most.

    Args:
        x: (..., m, ...), floating-point.
        blur: Width of the smoothing, (), in the units of x, >= 0; may be traced. Zero gives the maximum.
        axis: Which axis is reduced.
        where: Mask of the shape of x. Entries where it is False do not count, nor do those that are not
            finite.
        empty: The value where no entry counts; its gradient is zero.

    Returns:
        (..., ...): the shape of x without the axis.

    Source: the log-sum-exp function.
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
        # The greatest entry is only a shift that avoids overflow: it takes no part in the gradient.
        top = jax.lax.stop_gradient(top)
        below = jnp.where(counts, x - top, 0) / soft
        sums = jnp.sum(jnp.where(counts, jnp.exp(below), 0), axis=axis)
        smooth = jnp.squeeze(top, axis) + soft * jnp.log(jnp.where(sums > 0, sums, 1))
        best = jnp.where(blur > 0, smooth, best)
    return jnp.where(counts.any(axis), best, jnp.asarray(empty, x.dtype))


def smooth_min(
    x: ArrayLike,
    blur: ArrayLike = 0.0,
    *,
    axis: int = -1,
    where: ArrayLike | None = None,
    empty: float = 0.0,
) -> jax.Array:
    """The minimum with a gradient for every entry: -smooth_max(-x), never above the minimum.

    Arguments as in `smooth_max`.
    """
    return -smooth_max(-jnp.asarray(x), blur, axis=axis, where=where, empty=-empty)


def limited_margins(arm: Arm, sol: Solutions) -> Solutions:
    """`within_limits`, and margins that end at the joint limits as well as at the folds.

    A radian counts as one reach [m], as a slide of one reach counts as a radian. Where a branch reaches its
    goal, the margin is the lesser of the two clearances. Elsewhere there are no joints whose limits could be
    compared, and the margin is the distance to the fold, zero at most: a branch that arrives beyond its
    limits drops below zero as it arrives. Joints of slots that are not valid have zero derivatives, so a
    margin made of them would have a value that changes and a gradient that does not.

    Args:
        arm: The arm, with limits (n, 2).
        sol: From `solve`, unchanged.

    Returns:
        `Solutions` of the same shape; `q`, `valid` and `margin` differ.
    """
    arm = arm.baked()
    spare = reach(arm) * limit_clearance(arm, sol.q)
    spare = jnp.asarray(spare, sol.margin.dtype)
    margin = jnp.minimum(sol.margin, jnp.where(sol.valid, spare, 0))
    return dataclasses.replace(within_limits(arm, sol), margin=margin)


def best_margin(arm: Arm, sol: Solutions, *, blur: ArrayLike = 0.0, limits: bool = True) -> jax.Array:
    """The margin of the best branch of each goal [m]: positive where the goal is reached.

    Outside the workspace it says how far the goal is from a fold, joint limits aside, and its gradient leads
    there. Where a quartic is solved (`pieper`, `position`, `parallel_axes`) it is that distance to first
    order.

    Args:
        arm: The arm.
        sol: From `solve`, unchanged.
        blur: Branches whose margins differ by less share the gradient [m], (); see `smooth_max`.
        limits: Whether the joint limits count; see `limited_margins`.

    Returns:
        (...) [m], one for each goal.
    """
    return smooth_max((limited_margins(arm, sol) if limits else sol).margin, blur)
