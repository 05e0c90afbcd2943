"""The two-link triangle: the step that almost every closed-form arm shares.

Branches: 2 (elbow left or right of the line from shoulder to wrist).
Source: law of cosines; Craig, Introduction to Robotics, 3rd ed., section 4.4; the two half-angle
forms are those of Kahan, Miscalculating area and angles of a needle-like triangle (2014).
"""

from typing import NamedTuple

import jax.numpy as jnp

from ikjax.core import safe
from ikjax.core.trig import Angle, Scalar
from ikjax.core.xla import agreed_root, pin
from ikjax.solvers.context import Setting


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


def triangle(
    x: Scalar,
    y: Scalar,
    upper: Scalar,
    fore: Scalar,
    left: Scalar,
    setting: Setting,
    noise: float = 0.0,
    fallback: Angle | None = None,
) -> Triangle:
    """Angles s and e with upper (cos s, sin s) + fore (cos(s + e), sin(s + e)) = (x, y).

    Args:
        x, y: The wrist, seen from the shoulder in the arm's plane.
        upper, fore: Link lengths of any sign, not zero.
        left: +1 puts the elbow left of the line from shoulder to wrist, -1 right of it.
        noise: As in `cosine_sine`: what rounding may have taken from the wrist's distance to either
            circle. It is put back where a later step may fail.
        setting: What counts as zero.
        fallback: Fills s where it is arbitrary: equal links folded onto the shoulder. Joint 2 by default.

    Returns:
        Both angles as sines and cosines, clamped to the nearer end where the triangle cannot
        close, and the margin: how far the wrist is inside the ring, negative outside.
    """
    fallback, tolerance = setting.fallback[1] if fallback is None else fallback, setting.zero_tolerance
    span_squared = x * x + y * y
    span = safe.sqrt(span_squared)
    less, more = upper - fore, upper + fore
    scale = safe.divide(1, 2 * upper * fore)
    turned = safe.sign(scale)  # links of unlike signs are straight where others are folded
    inner, outer = abs(less), abs(more)
    # 1 + cos and 1 - cos, each without cancellation; the smaller one is exact to rounding.
    folded = jnp.clip(_given_back(span - inner, turned * noise) * (span + inner) * scale, 0, 2)
    straight = jnp.clip(_given_back(outer - span, turned * noise) * (outer + span) * scale, 0, 2)
    near = folded < straight
    small = jnp.where(near, folded, straight)
    cosine = pin(jnp.where(near, folded - 1, 1 - straight))
    root = safe.sqrt if isinstance(noise, float) and noise == 0 else agreed_root
    sine = pin(-left * turned * root(small * (2 - small)))
    u, v = jnp.where(near, less + fore * folded, more - fore * straight), fore * sine
    weight = safe.reciprocal_sqrt(span_squared * (u * u + v * v))
    low, high = ring(upper, fore)
    free = (span_squared <= tolerance * tolerance) & (low <= tolerance)
    lost = free | (weight == 0)
    return Triangle(
        jnp.where(lost, fallback.sin, (y * u - x * v) * weight),
        jnp.where(lost, fallback.cos, (x * u + y * v) * weight),
        sine,
        cosine,
        jnp.minimum(high - span, span - low),
        free,
    )


def _given_back(gap: Scalar, noise: Scalar) -> Scalar:
    """A distance near zero, larger by what rounding may have taken from it."""
    if isinstance(noise, float) and noise == 0:
        return gap
    return jnp.where(abs(gap) < 64 * abs(noise), gap + noise, gap)


def leaned(arm: Triangle, upper: Scalar, fore: Scalar, lean: Scalar, setting: Setting) -> Triangle:
    """The triangle with the forearm leaned by a small angle, where the wrist stays to within rounding.

    Near straight or folded the elbow's angle is open to rounding, and a later step may need just that.

    Args:
        lean: Wanted change of s + e [rad].
    """
    span_squared = upper * upper + fore * fore + 2 * upper * fore * arm.elbow_cos
    bend = safe.divide(lean * span_squared, upper * (upper + fore * arm.elbow_cos))
    first, second = jnp.abs(arm.elbow_sin * bend), jnp.abs(arm.elbow_cos) * bend * bend / 2
    slip = abs(upper * fore) * (first + second) * safe.reciprocal_sqrt(span_squared)
    able = (slip <= setting.zero_tolerance) & (jnp.abs(lean) + jnp.abs(bend) <= _SMALL)
    lean, bend = jnp.where(able, lean, 0), jnp.where(able, bend, 0)
    shoulder_sin, shoulder_cos = _on(arm.shoulder_sin, arm.shoulder_cos, lean - bend)
    elbow_sin, elbow_cos = _on(arm.elbow_sin, arm.elbow_cos, bend)
    return Triangle(shoulder_sin, shoulder_cos, elbow_sin, elbow_cos, arm.margin, arm.continuum)


_SMALL = 5e-3
"""An angle [rad] whose cube does not count beside the rounding that lets it be chosen."""


def _on(sine: Scalar, cosine: Scalar, by: Scalar) -> tuple[Scalar, Scalar]:
    less = by * by / 2
    return sine + cosine * by - sine * less, cosine - sine * by - cosine * less
