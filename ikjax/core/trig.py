"""Sine with cosine, atan2 and wrapping as plain polynomials, so that they vectorize.

The same code on every device, in float32 and float64.
`jnp.sin`, `jnp.cos` and `jnp.arctan2` are one library call for each number on a CPU, which is too slow for a
kernel; these are a few fused multiply-adds each, without tables.

Source: the reduction by a multiple of pi/2 that is given in several parts is Cody and Waite, Software
Manual for the Elementary Functions (1980), chapter 8. The polynomials are minimax fits of
atan(t)/t, sin(t)/t and cos(t) in t^2, made with Remez exchange at 50 digits.
"""

import math
from collections.abc import Callable
from fractions import Fraction
from typing import Any, NamedTuple, TypeVar, cast

import jax
import jax.numpy as jnp
import numpy as np

Scalar = Any
"""A jax array of any batch shape, or a Python float that is known while tracing."""
SinCos = tuple[Scalar, Scalar]
"""An angle as (sine, cosine): the form in which kernels pass angles on."""

PI = math.pi


F = TypeVar("F", bound=Callable[..., Any])


def _traced_once(f: F) -> F:
    """Trace a function once for each shape, and inline it where it is called.

    A kernel calls these functions some fifty times. Outside a jit each is one program instead of thirty.
    """
    return cast(F, jax.jit(f, inline=True))


class Angle(NamedTuple):
    """An angle as its sine and cosine, and its value in [-pi, pi] [rad].

    Under jit a value that is not used is not computed, so that a step may always fill it in.
    """

    sin: Scalar
    cos: Scalar
    value: Scalar


# (atan(t)/t - 1) / t^2 on 0 <= t <= 1; the errors of the fit are 7e-9 and 2e-18 rad.
_ATAN = {
    32: (
        -0.3333298705816917,
        0.19990396658429518,
        -0.14185975250390495,
        0.10573930367216325,
        -0.07366699739175069,
        0.041121760585788945,
        -0.015132464032167526,
        0.0026222244141954304,
    ),
    64: (
        -0.3333333333333237,
        0.19999999999866647,
        -0.14285714278620995,
        0.11111110908256717,
        -0.09090905471176958,
        0.07692263802313255,
        -0.066662845257508,
        0.05879870357246353,
        -0.05250783219583884,
        0.04713568009481782,
        -0.04197395349139751,
        0.036218156700692054,
        -0.029259146155968183,
        0.021221436654943453,
        -0.013204938228923139,
        0.006718487029658633,
        -0.0026454380009822373,
        0.0007488153585210588,
        -0.00013469062284092526,
        1.1511666747627738e-05,
    ),
}
# (sin(t)/t - 1) / t^2 and (cos(t) - 1 + t^2/2) / t^4 on |t| <= pi/4; in float32 on |t| <= 0.8,
# because there a large angle can be rounded into the neighboring quarter.
_SIN = {
    32: (-0.1666664880690369, 0.008331875627470087, -0.00019482769794619849),
    64: (
        -0.166666666666666,
        0.008333333333316465,
        -0.00019841269825922125,
        2.7557312540860617e-06,
        -2.5050599649667284e-08,
        1.5888552675037032e-10,
    ),
}
_COS = {
    32: (0.04166664456185721, -0.0013887251778236325, 2.4424924159741062e-05),
    64: (
        0.0416666666666666,
        -0.0013888888888874125,
        2.480158728948234e-05,
        -2.7557314352372173e-07,
        2.087572327813221e-09,
        -1.1359648042270426e-11,
    ),
}


def _in_parts(value: str, widths: tuple[int, ...]) -> tuple[float, ...]:
    """A long decimal as a sum of floats of so many bits each, so that products with integers are exact."""
    rest, parts = Fraction(value), []
    for bits in widths:
        step = Fraction(2) ** (math.floor(math.log2(abs(float(rest)))) + 1 - bits)
        part = math.floor(rest / step) * step
        parts.append(float(part))
        rest -= part
    return tuple(parts)


# k * part is exact for every k that |x| <= 1e5 needs (16 bits), with or without fused multiply-add.
_HALF_PI_DIGITS = "1.57079632679489661923132169163975144209858469968755291"
_HALF_PI = {
    32: _in_parts(_HALF_PI_DIGITS, (8, 8, 8, 24)),
    64: _in_parts(_HALF_PI_DIGITS, (37, 37, 53)),
}


def _bits(x: jax.Array) -> int:
    return 64 if x.dtype == jnp.float64 else 32


def _polynomial(coefficients: tuple[float, ...], x: jax.Array) -> jax.Array:
    """The polynomial with these coefficients, the constant first, by Horner's rule."""
    value = jnp.full_like(x, coefficients[-1])
    for c in reversed(coefficients[:-1]):
        value = value * x + x.dtype.type(c)
    return value


def _floating(*values) -> tuple[jax.Array, ...]:
    """Arrays of one floating type and one shape; Python numbers follow the arrays beside them."""
    dtype = jnp.result_type(*values)
    if not jnp.issubdtype(dtype, jnp.floating):
        dtype = jnp.result_type(float)
    return tuple(jnp.broadcast_arrays(*(jnp.asarray(v, dtype) for v in values)))


@_traced_once
def sincos(x: Scalar) -> tuple[jax.Array, jax.Array]:
    """Sine and cosine of an angle [rad].

    The error is below 1.5 ulp of 1 for |x| <= 1e5 and grows with |x| beyond; the values never
    leave [-1, 1]. Infinity and NaN give NaN. The derivative is exact: (cos, -sin).
    """
    return _sincos(*_floating(x))


@jax.custom_jvp
def _sincos(x: jax.Array) -> tuple[jax.Array, jax.Array]:
    bits, const = _bits(x), x.dtype.type
    turns = jnp.round(x * const(2 / PI))
    t = x
    for part in _HALF_PI[bits]:
        t = t - turns * const(part)
    # Only an |x| beyond the stated range is changed by the clip.
    t = jnp.clip(t, const(-0.8), const(0.8))
    z = t * t
    s = t + t * z * _polynomial(_SIN[bits], z)
    c = const(1) - const(0.5) * z + z * z * _polynomial(_COS[bits], z)
    quarter = turns - const(4) * jnp.floor(turns * const(0.25))  # 0, 1, 2, 3
    odd = (quarter == 1) | (quarter == 3)
    sine, cosine = jnp.where(odd, c, s), jnp.where(odd, s, c)
    return (
        jnp.where(quarter >= 2, -sine, sine),
        jnp.where((quarter == 1) | (quarter == 2), -cosine, cosine),
    )


@_sincos.defjvp
def _sincos_jvp(primals, tangents):
    s, c = _sincos(*primals)
    (dx,) = tangents
    return (s, c), (c * dx, -s * dx)


@_traced_once
def atan2(y: Scalar, x: Scalar) -> jax.Array:
    """Angle of the point (x, y) in [-pi, pi] [rad], as C's atan2: signed zeros and infinities too.

    The error is below 1.5 ulp of pi (float64), 3e-7 rad (float32). Subnormal numbers may count as
    zero. The derivative is exact, and zero at the origin, where there is none.
    """
    return _atan2(*_floating(y, x))


@jax.custom_jvp
def _atan2(y: jax.Array, x: jax.Array) -> jax.Array:
    bits, const = _bits(x), x.dtype.type
    ax, ay = jnp.abs(x), jnp.abs(y)
    low, high = jnp.minimum(ax, ay), jnp.maximum(ax, ay)
    # Neither inf / inf nor 0 / 0 may become NaN: two infinities give 45 degrees, two zeros give zero.
    high = jnp.maximum(high, jnp.finfo(x.dtype).tiny)
    t = jnp.where(low == high, const(1), low / high)
    z = t * t
    angle = t + t * z * _polynomial(_ATAN[bits], z)
    angle = jnp.where(ay > ax, const(PI / 2) - angle, angle)
    left = jnp.signbit(x)
    angle = jnp.where(left, const(PI) - angle, angle)
    return jnp.copysign(angle, y)


@_atan2.defjvp
def _atan2_jvp(primals, tangents):
    y, x = primals
    dy, dx = tangents
    # The larger component is divided out first: no square overflows, and none of a short vector underflows.
    size = jnp.maximum(jnp.abs(x), jnp.abs(y))
    usable = (size > 0) & jnp.isfinite(size)
    size = jnp.where(usable, size, 1)
    u, v = jnp.where(usable, x / size, 1), jnp.where(usable, y / size, 0)
    weight = jnp.where(usable, 1 / ((u * u + v * v) * size), 0)
    return _atan2(y, x), (u * weight) * dy - (v * weight) * dx


@_traced_once
def wrap(x: Scalar) -> jax.Array:
    """The same direction in (-pi, pi] [rad]; pi itself stays pi. The derivative is 1 everywhere."""
    return _wrap(*_floating(x))


@jax.custom_jvp
def _wrap(x: jax.Array) -> jax.Array:
    const = x.dtype.type
    quarters = const(4) * jnp.round(x * const(0.5 / PI))
    t = x
    for part in _HALF_PI[_bits(x)]:
        t = t - quarters * const(part)
    # The number of turns can be rounded to the wrong side of half a turn.
    more = jnp.where(jnp.abs(t) > const(PI), jnp.copysign(const(4), t), const(0))
    for part in _HALF_PI[_bits(x)]:
        t = t - more * const(part)
    t = jnp.where(jnp.abs(x) <= const(PI), x, t)  # exact where there is nothing to wrap
    return canonical(jnp.clip(t, const(-PI), const(PI)))


@_wrap.defjvp
def _wrap_jvp(primals, tangents):
    return _wrap(*primals), tangents[0]


def with_turns(x: jax.Array, turns: jax.Array) -> jax.Array:
    """x + 2 pi turns, with two roundings up to 10^4 turns; there is no derivative in the turns.

    In float32, 2 pi itself is off by 1.7e-7, an error that would be added with every turn.
    """
    quarters = 4 * jax.lax.stop_gradient(turns)
    first, *rest = (quarters * x.dtype.type(part) for part in _HALF_PI[_bits(x)])
    return (x + first) + sum(reversed(rest))


def canonical(angle: jax.Array) -> jax.Array:
    """An angle in [-pi, pi] brought to (-pi, pi]: -pi becomes pi."""
    return jnp.where(angle <= -np.asarray(PI, angle.dtype), np.asarray(PI, angle.dtype), angle)


def angle(sine: Scalar, cosine: Scalar) -> Angle:
    """The angle of a sine and a cosine that belong together."""
    return Angle(sine, cosine, atan2(sine, cosine))


def add_small_angle(sine: Scalar, cosine: Scalar, step: Scalar) -> SinCos:
    """Sine and cosine of an angle plus a small step; their squares add up to one but for step^4 / 4."""
    cos_step = 1 - step * step / 2
    return sine * cos_step + cosine * step, cosine * cos_step - sine * step


def half_turn(x: Angle) -> Angle:
    """The opposite direction, without a second atan2."""
    return Angle(-x.sin, -x.cos, jnp.where(x.value > 0, x.value - PI, x.value + PI))


def choose(which: jax.Array, first: Angle, second: Angle) -> Angle:
    """The first angle where `which` is true, else the second."""
    return Angle(*(jnp.where(which, u, v) for u, v in zip(first, second, strict=True)))
