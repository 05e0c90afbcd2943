"""Real roots of the equations that closed forms come down to.

Storey: core.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax.numpy as jnp

from ikjax.core import safe
from ikjax.core.trig import Scalar


class CosineSine(NamedTuple):
    """One root of a cos(t) + b sin(t) = c."""

    sin: Scalar
    cos: Scalar
    height: Scalar
    """b cos(t) - a sin(t): the derivative of the left side, with the sign that was asked for."""
    margin: Scalar
    """hypot(a, b) - |c|: zero where the two roots merge, negative where there is none."""
    free: Scalar
    """a = b = 0: no angle is told apart, and `sin`, `cos` are zero."""


def cosine_sine(
    a: Scalar,
    b: Scalar,
    c: Scalar,
    side: Scalar,
    noise: float = 0.0,
    root: Callable[[Scalar], Scalar] = safe.sqrt,
) -> CosineSine:
    """Solve a cos(t) + b sin(t) = c by its sine and cosine, with nothing infinite at t = pi.

    Args:
        a, b, c: Coefficients of one unit.
        side: +1 or -1: the sign of b cos(t) - a sin(t), which tells the two roots apart.
        noise: What rounding may have taken from hypot(a, b). It is put back near a double root, so
            that the true one lies between the two that are returned.
        root: The square root to take: what rounding makes uncertain near zero.

    Returns:
        The root, clamped to the nearest angle where there is none.

    Source: Craig, Introduction to Robotics, 3rd ed., equations (4.36)-(4.40), by atan2 of both
    coordinates instead of the half angle's tangent.
    """
    size_squared = a * a + b * b
    gap = size_squared - c * c
    if noise:
        taken = 2 * noise * abs(c)
        gap = jnp.where(gap < 64 * taken, gap + taken, gap)
    height = side * root(gap)
    # The length of (c, height) is hypot(a, b), except where the root is clamped.
    weight = safe.reciprocal_sqrt(size_squared * (height * height + c * c))
    return CosineSine(
        (b * c - a * height) * weight,
        (a * c + b * height) * weight,
        height,
        safe.sqrt(size_squared) - abs(c),
        weight == 0,
    )
