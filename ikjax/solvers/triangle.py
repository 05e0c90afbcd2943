"""The two-link triangle: the step that almost every closed-form arm shares.

Storey: solvers. Branches: 2 (elbow left or right of the line from shoulder to wrist).
Source: law of cosines; Craig, Introduction to Robotics, 3rd ed., section 4.4; the two half-angle
forms are those of Kahan, Miscalculating area and angles of a needle-like triangle (2014).
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
    now, tiny, hold = setting.now[1], setting.tiny, setting.hold
    span_squared = x * x + y * y
    span = safe.sqrt(span_squared)
    less, more = upper - fore, upper + fore
    scale = 1 / (2 * upper * fore)
    # 1 + cos and 1 - cos, each without cancellation; the smaller one is exact to rounding.
    folded = jnp.clip((span - less) * (span + less) * scale, 0, 2)
    straight = jnp.clip((more - span) * (more + span) * scale, 0, 2)
    near = folded < straight
    small = jnp.where(near, folded, straight)
    cosine = hold(jnp.where(near, folded - 1, 1 - straight))
    sine = hold(-left * safe.sign(upper * fore) * safe.sqrt(small * (2 - small)))
    u, v = jnp.where(near, less + fore * folded, more - fore * straight), fore * sine
    weight = safe.reciprocal_sqrt(span_squared * (u * u + v * v))
    low, high = ring(upper, fore)
    free = (span_squared <= tiny * tiny) & (low <= tiny)
    lost = free | (weight == 0)
    return Triangle(
        jnp.where(lost, now.sin, (y * u - x * v) * weight),
        jnp.where(lost, now.cos, (x * u + y * v) * weight),
        sine,
        cosine,
        jnp.minimum(high - span, span - low),
        free,
    )
