"""Real roots of the two trigonometric equations that closed forms come down to.

`cosine_sine` solves a cos(t) + b sin(t) = c; `circle_quartic` solves a trigonometric polynomial of the second
degree, which is a quartic in tan(t / 2). Both return sines and cosines, and a margin or flag that says
whether a root is real.

Source: Craig, Introduction to Robotics, 3rd ed., section 4.4, for the first; the pencil of conics for the
second.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ikjax.core import safe
from ikjax.core.trig import Scalar, SinCos, add_small_angle
from ikjax.core.xla import agreed, agreed_root


class CosineSine(NamedTuple):
    """One root of a cos(t) + b sin(t) = c."""

    sin: Scalar
    cos: Scalar
    height: Scalar
    """b cos(t) - a sin(t): the derivative of the left side, with the sign of `side`."""
    margin: Scalar
    """hypot(a, b) - |c|: zero where the two roots merge, negative where there is no real root."""
    free: Scalar
    """a = b = 0: the equation does not depend on the angle, and `sin`, `cos` are zero."""


def cosine_sine(
    a: Scalar,
    b: Scalar,
    c: Scalar,
    side: Scalar,
    noise: Scalar = 0.0,
    margin: Scalar | None = None,
) -> CosineSine:
    """Solve a cos(t) + b sin(t) = c for the sine and cosine of t, with nothing infinite at t = pi.

    Args:
        a, b, c: Coefficients of one unit.
        side: +1 or -1: the sign of b cos(t) - a sin(t), which tells the two roots apart.
        noise: What rounding may have taken from hypot(a, b). It is added back near a double root, so
            that the true root lies between the two that are returned.
        margin: hypot(a, b) - |c|, where the caller knows it to more digits.

    Returns:
        The root, clamped to the nearest angle where there is none.

    Source: Craig, Introduction to Robotics, 3rd ed., equations (4.36)-(4.40), by both coordinates instead of
    the tangent of the half angle.
    """
    size_squared = a * a + b * b
    if margin is None:
        height_squared, margin = size_squared - c * c, safe.sqrt(size_squared) - abs(c)
    else:
        height_squared = margin * (safe.sqrt(size_squared) + abs(c))
    if not (isinstance(noise, float) and noise == 0):
        # The error of size^2 where that of the size is `noise`, and the size is about |c|.
        lost = 2 * noise * abs(c)
        height_squared = jnp.where(height_squared < 64 * lost, height_squared + lost, height_squared)
    height = side * agreed_root(height_squared)
    # The length of (c, height) is hypot(a, b), except where the root is clamped.
    weight = safe.reciprocal_sqrt(size_squared * (height * height + c * c))
    return CosineSine(
        (b * c - a * height) * weight,
        (a * c + b * height) * weight,
        height,
        margin,
        weight == 0,
    )


class CircleRoot(NamedTuple):
    """One root of a trigonometric polynomial of the second degree."""

    sin: Scalar
    cos: Scalar
    real: Scalar
    """False for one of a complex pair, of which only the real part is given."""


class CircleRoots(NamedTuple):
    """The four roots of a trigonometric polynomial of the second degree."""

    rising: tuple[CircleRoot, CircleRoot]
    """Roots where the derivative is positive; the first has the smaller angle in (-pi, pi]."""
    falling: tuple[CircleRoot, CircleRoot]
    """Roots where it is negative, in the same order."""


Harmonics = tuple[Scalar, Scalar, Scalar, Scalar, Scalar]
"""(u, v, x, y, w) of u cos(2t) + v sin(2t) + 2 x cos(t) + 2 y sin(t) + w."""


def circle_quartic(polynomial: Harmonics, steps: int = 6) -> CircleRoots:
    """The four roots t of u cos(2t) + v sin(2t) + 2 x cos(t) + 2 y sin(t) + w = 0.

    This is every quartic in tan(t / 2), with nothing infinite at t = pi. In the coordinates (cos(t), sin(t))
    the polynomial is a conic that meets the unit circle. In the pencil of the conic and the circle, the cubic
    resolvent finds a member that is a pair of real lines. Each line meets the circle in two roots, which are
    neighbors on the circle.

    Args:
        polynomial: Coefficients of one unit, of size about one.
        steps: Newton steps for the cubic, which come from one side and do not overshoot.

    Returns:
        Four candidates: real roots, after a last Newton step; and where two of them are complex, points near
        their real part. Of the two that merge in a double root one is rising and one falling.

    Source: the pencil of a conic and a circle is classical; the choice of the line pair is ours.
    """
    u, v, x, y, w = polynomial
    # Without a second harmonic the equation has two roots only. A tiny one has the other two far from real.
    u = u + safe.sign(u) * jnp.finfo(jnp.result_type(u, v, x, y, w)).eps
    # A rotation by half the angle of (u, v) makes one cosine of cos(2t) and sin(2t): after the division by
    # rho the polynomial is cos(2s) + 2 along cos(s) + 2 across sin(s) + level.
    rho = safe.sqrt(u * u + v * v)
    large = safe.sqrt((1 + abs(u) / rho) / 2)
    small = abs(v) / (2 * rho * large)
    half_cos = agreed(jnp.where(u >= 0, large, small))
    half_sin = agreed(safe.sign(v) * jnp.where(u >= 0, small, large))
    along, across = (x * half_cos + y * half_sin) / rho, (y * half_cos - x * half_sin) / rho
    level = w / rho
    # The member "conic - m circle" of the pencil is degenerate where its determinant (m + level)(m^2 - 1) +
    # along^2 (m + 1) + across^2 (m - 1) is zero. There is such an m in -1 <= m <= 1, and each of those gives
    # a pair of real lines. The sign at the inflection decides from which side Newton's method comes.
    middle = jnp.clip(-level / 3, -1, 1)
    at_middle = (
        (middle + level) * (middle * middle - 1)
        + along * along * (middle + 1)
        + across * across * (middle - 1)
    )
    above = at_middle <= 0
    # A further rotation by a quarter turn changes the sign of m, so that the root always lies above.
    p, q, k = (
        agreed(jnp.where(above, along, across)),
        agreed(jnp.where(above, across, -along)),
        agreed(jnp.where(above, level, -level)),
    )
    n, complement = _degenerate_member(p * p, q * q, k, steps)
    lines = _line_pair(p, q, k, n, complement)
    rising: list[CircleRoot] = []
    falling: list[CircleRoot] = []
    for (a, e, rhs), (other_a, other_e, other_rhs) in (lines, lines[::-1]):
        # The polynomial is the product of the two lines: it rises where one rises and the other is positive.
        # The chords do not cross, so that the other line has one sign on a chord: that at its midpoint.
        middle = jnp.clip(rhs, -_SQRT2, _SQRT2) / 2
        beyond = safe.sign(middle * (other_a * a + other_e * e) - other_rhs)
        outward = jnp.where(above, beyond, -beyond)
        for which, roots in ((1, rising), (-1, falling)):
            root = cosine_sine(a, e, rhs, which * outward)
            # Back from the quarter turn, and from half the angle of (u, v).
            sine, cosine = (
                jnp.where(above, root.sin, -root.cos),
                jnp.where(above, root.cos, root.sin),
            )
            sine, cosine = (
                sine * half_cos + cosine * half_sin,
                cosine * half_cos - sine * half_sin,
            )
            # A Newton step would lead the real part of a complex pair to another root nearby.
            real = root.margin >= 0
            sine, cosine = _polished(polynomial, agreed(sine), agreed(cosine), real)
            roots.append(CircleRoot(agreed(sine), agreed(cosine), real))
    return CircleRoots(_in_order(*rising), _in_order(*falling))


def _degenerate_member(p_squared: Scalar, q_squared: Scalar, k: Scalar, steps: int) -> tuple[Scalar, Scalar]:
    """n = 1 - m and 2 - n = 1 + m of the degenerate member of the pencil, each with its own digits.

    Source: Newton's method for n^3 - b n^2 + c n - d = 0, from a bound on the left of the root.
    """
    b, c, d = 3 + k, 2 + 2 * k + p_squared + q_squared, 2 * p_squared
    inflection = b / 3
    height = ((inflection - b) * inflection + c) * inflection - d
    bend = safe.sqrt((inflection * b - c) / 3)
    # On the left of the root and of the inflection the cubic rises and is concave, so that Newton's steps
    # stay on the left.
    n = jnp.maximum(inflection - 2 * jnp.maximum(bend, _above_cube_root(height / 2)), 0)
    for _ in range(steps):
        value = ((n - b) * n + c) * n - d
        derivative = (3 * n - 2 * b) * n + c
        n = jnp.clip(n - safe.divide(value, derivative), 0, 2)
    n = agreed(n)
    # Near n = 2 the difference 2 - n has lost its digits: two Newton steps in 2 - n restore them.
    complement = 2 - n
    for _ in range(2):
        value = (
            (complement + k - 3) * complement + p_squared + q_squared + 2 - 2 * k
        ) * complement - 2 * q_squared
        derivative = (3 * complement + 2 * k - 6) * complement + p_squared + q_squared + 2 - 2 * k
        complement = jnp.where(n > 1, jnp.clip(complement - safe.divide(value, derivative), 0, 2), complement)
    complement = agreed(complement)
    return jnp.where(n > 1, 2 - complement, n), complement


Line = tuple[Scalar, Scalar, Scalar]
"""(a, e, rhs) of a cos(s) + e sin(s) = rhs."""


def _line_pair(p: Scalar, q: Scalar, k: Scalar, n: Scalar, complement: Scalar) -> tuple[Line, Line]:
    """The two lines of the degenerate member of the pencil.

    Its equation is (near cos(s) + first)^2 = (far sin(s) - second)^2 with near^2 = n, far^2 = 2 - n, and
    first^2 - second^2 = gap.
    """
    near, far, gap = agreed(safe.sqrt(n)), agreed(safe.sqrt(complement)), k + 1 - n
    # Where the lines are parallel to an axis, its own quotient is 0 / 0: the other one, whose divisor is at
    # least 1, and the gap decide.
    first, second = safe.divide(p, near), safe.divide(q, far)
    first_squared, second_squared = gap + second * second, first * first - gap
    steep = n > 1
    first = jnp.where(~steep & (n < first_squared), safe.sign(p) * safe.sqrt(first_squared), first)
    second = jnp.where(
        steep & (complement < second_squared), safe.sign(q) * safe.sqrt(second_squared), second
    )
    # The sum and the difference of both without cancellation: their product is the gap.
    alike = (first < 0) == (second < 0)
    large = first + jnp.where(alike, second, -second)
    small = safe.divide(gap, large)
    total = agreed(jnp.where(alike, large, small))
    difference = agreed(jnp.where(alike, small, large))
    return (near, -far, -total), (near, far, -difference)


_SQRT2 = 2**0.5


def _above_cube_root(x: jax.Array) -> jax.Array:
    """An upper bound of the cube root of a positive number, up to 7 % above it, from its bits.

    A third of the bits of a float is about those of its cube root, because they are nearly its logarithm.
    """
    clipped = jnp.clip(x, 1e-30, 1e30).astype(jnp.float32)
    bits = jax.lax.bitcast_convert_type(clipped, jnp.int32).astype(jnp.float32)
    third = (bits * np.float32(1 / 3) + np.float32(0x2A571100)).astype(jnp.int32)
    return jax.lax.stop_gradient(jax.lax.bitcast_convert_type(third, jnp.float32)).astype(x.dtype)


def harmonics_at(polynomial: Harmonics, sine: Scalar, cosine: Scalar) -> tuple[Scalar, Scalar]:
    """The polynomial and its derivative."""
    u, v, x, y, w = polynomial
    double_cos, double_sin = (cosine - sine) * (cosine + sine), 2 * sine * cosine
    value = u * double_cos + v * double_sin + 2 * (x * cosine + y * sine) + w
    return value, 2 * (v * double_cos - u * double_sin + y * cosine - x * sine)


def _polished(polynomial: Harmonics, sine: Scalar, cosine: Scalar, real: jax.Array) -> SinCos:
    """A real root after a Newton step, which is left out where it is larger than the error can be."""
    value, derivative = harmonics_at(polynomial, sine, cosine)
    step = -safe.divide(value, derivative)
    step = jnp.where(real & (abs(step) < jnp.finfo(step.dtype).eps ** 0.25), step, 0)
    return add_small_angle(sine, cosine, step)


def _in_order(first: CircleRoot, second: CircleRoot) -> tuple[CircleRoot, CircleRoot]:
    """The two roots by their angle in (-pi, pi]."""
    # Keys that grow with the angle: from 0 to 2 above the axis, from -2 to 0 below it.
    keys = (jnp.where(r.sin >= 0, 1 - r.cos, r.cos - 1) for r in (first, second))
    swap = next(keys) > next(keys)
    low = (jnp.where(swap, s, f) for f, s in zip(first, second, strict=True))
    high = (jnp.where(swap, f, s) for f, s in zip(first, second, strict=True))
    return CircleRoot(*low), CircleRoot(*high)
