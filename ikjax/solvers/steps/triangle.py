"""The two-link triangle: the step that almost every closed-form arm shares.

Branches: 2.

Bit: the elbow is left (+1) or right (-1) of the line from shoulder to wrist.

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
        setting: Fallback and tolerances.
        noise: What rounding may have taken from the wrist's distance to either circle of the ring, as in
            `cosine_sine`. It is added back near the circles, for callers whose later steps may fail there.
        fallback: The angle s where it is arbitrary: equal links folded onto the shoulder. By default it is
            the fallback of joint 2.

    Returns:
        Both angles as sines and cosines, clamped to the nearer end where the triangle cannot
        close, and the margin: how far the wrist is inside the ring, negative outside.
    """
    fallback, tolerance = setting.fallback[1] if fallback is None else fallback, setting.zero_tolerance
    span_squared = x * x + y * y
    span = safe.sqrt(span_squared)
    less, more = upper - fore, upper + fore
    scale = safe.divide(1, 2 * upper * fore)
    # Links of unlike signs are straight where others are folded.
    turned = safe.sign(scale)
    inner, outer = abs(less), abs(more)
    # 1 + cos(e) and 1 - cos(e) by the law of cosines, factored so that neither cancels (Kahan). The cosine
    # and the sine come from the smaller of the two, which is exact to rounding.
    folded = jnp.clip(_padded(span - inner, turned * noise) * (span + inner) * scale, 0, 2)
    straight = jnp.clip(_padded(outer - span, turned * noise) * (outer + span) * scale, 0, 2)
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


def _padded(gap: Scalar, noise: Scalar) -> Scalar:
    """The distance, larger by what rounding may have taken from it where it is near zero."""
    if isinstance(noise, float) and noise == 0:
        return gap
    return jnp.where(abs(gap) < 64 * abs(noise), gap + noise, gap)


def leaned(arm: Triangle, upper: Scalar, fore: Scalar, lean: Scalar, setting: Setting) -> Triangle:
    """The triangle with the forearm turned by a small angle, if the wrist moves by rounding only.

    Near straight or folded, rounding leaves the elbow's angle open. A later step may have an answer for one
    of these angles only.

    Args:
        arm: The triangle.
        upper, fore: Link lengths.
        lean: Wanted change of s + e [rad].
        setting: Tolerances.
    """
    span_squared = upper * upper + fore * fore + 2 * upper * fore * arm.elbow_cos
    bend = safe.divide(lean * span_squared, upper * (upper + fore * arm.elbow_cos))
    # How far the wrist moves, to first and to second order in the bend of the elbow.
    first, second = jnp.abs(arm.elbow_sin * bend), jnp.abs(arm.elbow_cos) * bend * bend / 2
    slip = abs(upper * fore) * (first + second) * safe.reciprocal_sqrt(span_squared)
    able = (slip <= setting.zero_tolerance) & (jnp.abs(lean) + jnp.abs(bend) <= _SMALL)
    lean, bend = jnp.where(able, lean, 0), jnp.where(able, bend, 0)
    shoulder_sin, shoulder_cos = _turned_by(arm.shoulder_sin, arm.shoulder_cos, lean - bend)
    elbow_sin, elbow_cos = _turned_by(arm.elbow_sin, arm.elbow_cos, bend)
    return Triangle(shoulder_sin, shoulder_cos, elbow_sin, elbow_cos, arm.margin, arm.continuum)


_SMALL = 5e-3
"""[rad] The cube of such an angle does not count beside the rounding that leaves it open."""


def _turned_by(sine: Scalar, cosine: Scalar, by: Scalar) -> tuple[Scalar, Scalar]:
    """An angle turned by a small one, to second order."""
    less = by * by / 2
    return sine + cosine * by - sine * less, cosine - sine * by - cosine * less
