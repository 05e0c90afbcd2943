"""The two-link triangle: the step that almost every closed-form arm shares.

Storey: solvers. Branches: 2 (elbow left or right of the line from shoulder to wrist).
Source: law of cosines; Craig, Introduction to Robotics, 3rd ed., section 4.4.
"""

from typing import NamedTuple

import jax.numpy as jnp

from ikjax.core import safe
from ikjax.core.trig import Scalar
from ikjax.solvers.branch import Setting


class Triangle(NamedTuple):
    shoulder_sin: Scalar
    shoulder_cos: Scalar
    elbow_sin: Scalar
    elbow_cos: Scalar
    margin: Scalar
    continuum: Scalar


def ring(upper: Scalar, fore: Scalar) -> tuple[Scalar, Scalar]:
    """Least and greatest distance that two links of any sign span."""
    return abs(abs(upper) - abs(fore)), abs(upper) + abs(fore)


def triangle(x: Scalar, y: Scalar, upper: Scalar, fore: Scalar, left: Scalar, setting: Setting) -> Triangle:
    """Angles s and e with upper (cos s, sin s) + fore (cos(s + e), sin(s + e)) = (x, y).

    Args:
        x, y: The wrist, seen from the shoulder in the arm's plane.
        upper, fore: Link lengths of any sign, not zero.
        left: +1 puts the elbow left of the line from shoulder to wrist, -1 right of it.
        setting: Fills s with joint 2 where it is arbitrary: equal links folded onto the shoulder.

    Returns:
        Both angles as sines and cosines, clamped to the nearer end where the triangle cannot
        close, and the margin: how far the wrist is inside the ring, negative outside.
    """
    now, tiny = setting.now[1], setting.tiny
    span_squared = x * x + y * y
    scale = 1 / (2 * upper * fore)
    cosine = jnp.clip((span_squared - (upper * upper + fore * fore)) * scale, -1, 1)
    sine = -left * safe.sign(upper * fore) * safe.sqrt((1 - cosine) * (1 + cosine))
    u, v = upper + fore * cosine, fore * sine
    weight = safe.reciprocal_sqrt(span_squared * (u * u + v * v))
    low, high = ring(upper, fore)
    free = (span_squared <= tiny * tiny) & (low <= tiny)
    lost = free | (weight == 0)
    span = safe.sqrt(span_squared)
    return Triangle(
        jnp.where(lost, now.sin, (y * u - x * v) * weight),
        jnp.where(lost, now.cos, (x * u + y * v) * weight),
        sine,
        cosine,
        jnp.minimum(high - span, span - low),
        free,
    )
