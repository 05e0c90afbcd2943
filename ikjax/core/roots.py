"""Real roots of the equations that closed forms come down to."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ikjax.core import safe
from ikjax.core.trig import Scalar, SinCos, nudged
from ikjax.core.xla import agreed, agreed_root


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
    noise: Scalar = 0.0,
) -> CosineSine:
    """Solve a cos(t) + b sin(t) = c by its sine and cosine, with nothing infinite at t = pi.

    Args:
        a, b, c: Coefficients of one unit.
        side: +1 or -1: the sign of b cos(t) - a sin(t), which tells the two roots apart.
        noise: What rounding may have taken from hypot(a, b). It is put back near a double root, so
            that the true one lies between the two that are returned.

    Returns:
        The root, clamped to the nearest angle where there is none.

    Source: Craig, Introduction to Robotics, 3rd ed., equations (4.36)-(4.40), by atan2 of both
    coordinates instead of the half angle's tangent.
    """
    size_squared = a * a + b * b
    gap = size_squared - c * c
    if not (isinstance(noise, float) and noise == 0):
        taken = 2 * noise * abs(c)
        gap = jnp.where(gap < 64 * taken, gap + taken, gap)
    height = side * agreed_root(gap)
    # The length of (c, height) is hypot(a, b), except where the root is clamped.
    weight = safe.reciprocal_sqrt(size_squared * (height * height + c * c))
    return CosineSine(
        (b * c - a * height) * weight,
        (a * c + b * height) * weight,
        height,
        safe.sqrt(size_squared) - abs(c),
        weight == 0,
    )


class CircleRoot(NamedTuple):
    """One root of a trigonometric polynomial of the second degree."""

    sin: Scalar
    cos: Scalar
    real: Scalar
    """False where a complex pair was brought back to its real part."""


class CircleRoots(NamedTuple):
    rising: tuple[CircleRoot, CircleRoot]
    """Roots where the polynomial rises; the first has the smaller angle in (-pi, pi]."""
    falling: tuple[CircleRoot, CircleRoot]


Harmonics = tuple[Scalar, Scalar, Scalar, Scalar, Scalar]
"""(u, v, x, y, w) of u cos(2t) + v sin(2t) + 2 x cos(t) + 2 y sin(t) + w."""


def circle_quartic(polynomial: Harmonics, steps: int = 6) -> CircleRoots:
    """The four roots t of u cos(2t) + v sin(2t) + 2 x cos(t) + 2 y sin(t) + w = 0.

    This is every quartic in tan(t / 2), with nothing infinite at t = pi. The polynomial is a conic
    that meets the unit circle; one of the pencil through their common points is a pair of lines,
    and each line meets the circle in two roots, side by side on the circle. A cubic finds the pair.

    Args:
        polynomial: Coefficients of one unit, of size about one.
        steps: Newton steps for the cubic, which it approaches from one side without overshooting.

    Returns:
        Four candidates: real roots, polished; and where two of them are complex, points near their
        real part. On a double root the two that merge are one rising and one falling.

    Source: the pencil of a conic and a circle is classical; the choice of the line pair is ours.
    """
    u, v, x, y, w = polynomial
    # Where there is no second harmonic, next to nothing is one: its roots are two, and two far away.
    u = u + safe.sign(u) * jnp.finfo(jnp.result_type(u, v, x, y, w)).eps
    # Turned by half of that angle, cos(2t) and sin(2t) become one cosine.
    rho = safe.sqrt(u * u + v * v)
    large = safe.sqrt((1 + abs(u) / rho) / 2)
    small = abs(v) / (2 * rho * large)
    half_cos = agreed(jnp.where(u >= 0, large, small))
    half_sin = agreed(safe.sign(v) * jnp.where(u >= 0, small, large))
    ahead, aside = (x * half_cos + y * half_sin) / rho, (y * half_cos - x * half_sin) / rho
    level = w / rho
    # (m + level)(m^2 - 1) + ahead^2 (m + 1) + aside^2 (m - 1) has a root in -1 <= m <= 1, and each
    # of those is a pair of real lines. On which side of its inflection decides from where to come.
    middle = jnp.clip(-level / 3, -1, 1)
    at_middle = (
        (middle + level) * (middle * middle - 1) + ahead * ahead * (middle + 1) + aside * aside * (middle - 1)
    )
    above = at_middle <= 0
    # Seen a quarter turn on, one that lies below is one above.
    p, q, k = (
        agreed(jnp.where(above, ahead, aside)),
        agreed(jnp.where(above, aside, -ahead)),
        agreed(jnp.where(above, level, -level)),
    )
    p_squared, q_squared = p * p, q * q
    # n = 1 - m rises from 0: n^3 - b n^2 + c n - d = 0
    b, c, d = 3 + k, 2 + 2 * k + p_squared + q_squared, 2 * p_squared
    inflection = b / 3
    height = ((inflection - b) * inflection + c) * inflection - d
    bend = safe.sqrt((inflection * b - c) / 3)
    # A bound from the left. Newton's steps cannot pass the root from there, because the curve bends down.
    n = jnp.maximum(inflection - 2 * jnp.maximum(bend, _above_cube_root(height / 2)), 0)
    for _ in range(steps):
        value = ((n - b) * n + c) * n - d
        slope = (3 * n - 2 * b) * n + c
        n = jnp.clip(n - safe.divide(value, slope), 0, 2)
    # What is left to 2, anew where it is small, so that it keeps its digits too.
    n = agreed(n)
    left = 2 - n
    for _ in range(2):
        value = ((left + k - 3) * left + p_squared + q_squared + 2 - 2 * k) * left - 2 * q_squared
        slope = (3 * left + 2 * k - 6) * left + p_squared + q_squared + 2 - 2 * k
        left = jnp.where(n > 1, jnp.clip(left - safe.divide(value, slope), 0, 2), left)
    left = agreed(left)
    n = jnp.where(n > 1, 2 - left, n)
    near, far, gap = agreed(safe.sqrt(n)), agreed(safe.sqrt(left)), k + 1 - n
    # (near cos + first)^2 = (far sin - second)^2, first^2 = gap + second^2. Where a line runs along an
    # axis its own part is 0 / 0, and the other one tells it.
    first, second = safe.divide(p, near), safe.divide(q, far)
    first_squared, second_squared = gap + second * second, first * first - gap
    first = jnp.where(n < first_squared, safe.sign(p) * safe.sqrt(first_squared), first)
    second = jnp.where(left < second_squared, safe.sign(q) * safe.sqrt(second_squared), second)
    # Their sum and their difference, without cancellation: the product is the gap.
    alike = (first < 0) == (second < 0)
    large = first + jnp.where(alike, second, -second)
    small = safe.divide(gap, large)
    total = agreed(jnp.where(alike, large, small))
    difference = agreed(jnp.where(alike, small, large))
    lines = (near, -far, -total), (near, far, -difference)
    rising: list[CircleRoot] = []
    falling: list[CircleRoot] = []
    for (a, e, rhs), (other_a, other_e, other_rhs) in (lines, lines[::-1]):
        middle = jnp.clip(rhs, -_SQRT2, _SQRT2) / 2
        beyond = safe.sign(middle * (other_a * a + other_e * e) - other_rhs)
        outward = jnp.where(above, beyond, -beyond)
        for which, found in ((1, rising), (-1, falling)):
            root = cosine_sine(a, e, rhs, which * outward)
            sine, cosine = (
                jnp.where(above, root.sin, -root.cos),
                jnp.where(above, root.cos, root.sin),
            )
            sine, cosine = (
                sine * half_cos + cosine * half_sin,
                cosine * half_cos - sine * half_sin,
            )
            # Near another root, what is left of a complex pair would be led to that one.
            real = root.margin >= 0
            sine, cosine = _polished(polynomial, agreed(sine), agreed(cosine), real)
            found.append(CircleRoot(agreed(sine), agreed(cosine), real))
    return CircleRoots(_in_order(*rising), _in_order(*falling))


_SQRT2 = 2**0.5


def _above_cube_root(x: jax.Array) -> jax.Array:
    """The cube root of a positive number or a little more, up to 7 %, from the bits of its exponent."""
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
    """A root after a Newton step, no larger than the error it had to start with."""
    value, slope = harmonics_at(polynomial, sine, cosine)
    step = -safe.divide(value, slope)
    step = jnp.where(real & (abs(step) < jnp.finfo(step.dtype).eps ** 0.25), step, 0)
    return nudged(sine, cosine, step)


def _in_order(first: CircleRoot, second: CircleRoot) -> tuple[CircleRoot, CircleRoot]:
    keys = (jnp.where(r.sin >= 0, 1 - r.cos, r.cos - 1) for r in (first, second))
    swap = next(keys) > next(keys)
    low = (jnp.where(swap, s, f) for f, s in zip(first, second, strict=True))
    high = (jnp.where(swap, f, s) for f, s in zip(first, second, strict=True))
    return CircleRoot(*low), CircleRoot(*high)
