"""All real roots of a real trigonometric polynomial, by Rolle's theorem: between two roots lies an extremum.

The roots of a derivative divide the circle into intervals on which the polynomial is monotone, with at most
one root each. So a chain goes from a high derivative, whose sign changes are counted on a grid, through the
lower ones to the polynomial. A polynomial of degree m has 2 m intervals at most, and every
level of the chain has that many, in order of the angle: nothing is sorted, dropped or compared.

An interval without a change of sign gives the end where the polynomial is nearer to zero. Two roots that
merge, or that rounding has made complex, are thus given by the extremum between them, once from either side;
and a root of multiplicity k is given k times. A simple root of a derivative is found to rounding, where the
double root of the polynomial itself is not.

Arrays have the roots as their first axis, so that a program contains each step once.

Source: isolation of real roots by those of the derivatives is classical (Rolle); the osculating parabola is
Euler's method: Traub, Iterative Methods for the Solution of Equations (1964), section 5.21.
"""

import math
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ikjax.core import safe
from ikjax.core.trig import Scalar, sincos
from ikjax.core.xla import pin

GRID = 64
"""Points on which sign changes of the highest derivative are counted."""

LEVELS = 5
"""Order of that derivative. Close pairs of its own roots, which a grid misses, count only where all the lower
derivatives have close pairs too: every further level halves what is lost."""

STEPS = 5
"""Steps of Euler's method at each level. With two, one root in 400 of a CRX-10iA's polynomials was lost; with
four, one of 100 extrema between two roots that are just complex was 8e-4 rad off, in a wide interval."""


class Series(NamedTuple):
    """sum over k of cos[k] cos(k t) + sin[k] sin(k t): k is the first axis of both, from 0 to the degree."""

    cos: jax.Array
    sin: jax.Array

    @property
    def degree(self) -> int:
        return self.cos.shape[0] - 1

    def derivative(self) -> "Series":
        k = column(range(self.degree + 1), self.cos)
        return Series(k * self.sin, -k * self.cos)


class Roots(NamedTuple):
    """2 m candidates for the real roots of a polynomial of degree m, one in each interval between extrema."""

    angle: Scalar
    """(2 m, ...) in [-pi, pi] [rad], in ascending order but for the last, which may be beyond pi."""
    order: Scalar
    """(2 m, ...) of which derivative the angle is a root: 0 of the polynomial itself, 1 of the first. Where
    two roots of that are complex too, it is 2, and so on."""
    real: jax.Array
    """(2 m, ...) whether the polynomial changes its sign in the interval; if not, the angle is that of the
    extremum where it is nearer to zero."""
    first: jax.Array
    """(2 m, ...) whether that is the interval's first extremum."""
    extremum: Scalar
    """(2 m, ...) angle of the interval's first extremum; the second one is the first of the next interval."""
    extremum_order: Scalar
    """(2 m, ...) its order: 1 for an extremum; more where there are fewer than 2 m."""


def column(values, like: jax.Array) -> jax.Array:
    """Numbers as an array whose first axis counts them and that multiplies arrays like the one given."""
    return jnp.asarray(np.asarray(values, like.dtype).reshape(-1, *(1,) * (like.ndim - 1)))


def interpolated(samples: jax.Array, first: float) -> Series:
    """The polynomial of degree m from its values at 2 m + 2 angles `first` + j pi / (m + 1).

    Args:
        samples: (2 m + 2, ...).
        first: The first angle [rad].
    """
    count = samples.shape[0]
    m = count // 2 - 1
    angles = first + 2 * math.pi * np.arange(count) / count
    k = np.arange(m + 1)
    weight = np.where(k == 0, 1, 2) / count
    cos = sum(column(weight * np.cos(k * t), samples) * v[None] for t, v in zip(angles, samples, strict=True))
    sin = sum(column(weight * np.sin(k * t), samples) * v[None] for t, v in zip(angles, samples, strict=True))
    return Series(cos, sin)


def real_roots(series: Series) -> Roots:
    """The real roots of a trigonometric polynomial of degree m >= 1, and extrema in place of complex ones.

    Args:
        series: Coefficients of size about one.

    Returns:
        2 m candidates. Where there are fewer extrema than 2 m, some of them are equal.
    """
    chain = [series.derivative()]
    for _ in range(LEVELS - 1):
        chain.append(chain[-1].derivative())
    start, found = _changes(chain[-1])
    # One program for all levels below.
    levels = jax.tree.map(lambda *x: jnp.stack(x), *chain[-2::-1], series)
    order = pin(jnp.where(found, 0, LEVELS * jnp.ones_like(start)))
    roots, _ = jax.lax.scan(_between, Roots(start, order, found, found, start, order), levels)
    angle = jnp.where(roots.angle > math.pi, roots.angle - 2 * math.pi, roots.angle)
    return roots._replace(angle=pin(angle))


def values(series: Series, angle: Scalar) -> tuple[Scalar, Scalar, Scalar]:
    """The polynomial and its first two derivatives at an angle [rad]."""
    s, c = sincos(angle)
    x, y = c, s
    value: Scalar = series.cos[:1]
    first: Scalar = 0.0
    second: Scalar = 0.0
    for k in range(1, series.degree + 1):
        a, b = series.cos[k : k + 1], series.sin[k : k + 1]
        u, v = a * x + b * y, b * x - a * y
        value, first, second = value + u, first + k * v, second - k * k * u
        if k < series.degree:
            x, y = x * c - y * s, y * c + x * s
    return value, first, second


def derivatives(series: Series, angle: Scalar, order: Scalar) -> tuple[Scalar, Scalar]:
    """The derivative of an order, which may differ from angle to angle, and the next one, at angles [rad]."""
    s, c = sincos(angle)
    x, y = c, s
    even: Scalar = 0.0
    odd: Scalar = 0.0
    next_even: Scalar = 0.0
    next_odd: Scalar = 0.0
    for k in range(1, series.degree + 1):
        a, b, size = series.cos[k : k + 1], series.sin[k : k + 1], jnp.exp(math.log(k) * order)
        u, v = size * (a * x + b * y), size * (b * x - a * y)
        even, odd, next_even, next_odd = even + u, odd + v, next_even + k * u, next_odd + k * v
        if k < series.degree:
            x, y = x * c - y * s, y * c + x * s
    # Each derivative turns the phase by a quarter.
    quarters = order - 4 * jnp.floor(order / 4)
    cos = jnp.where(quarters == 0, 1, jnp.where(quarters == 2, -1, 0)).astype(x.dtype)
    sin = jnp.where(quarters == 1, 1, jnp.where(quarters == 3, -1, 0)).astype(x.dtype)
    return cos * even + sin * odd, cos * next_odd - sin * next_even


def _changes(series: Series) -> tuple[jax.Array, jax.Array]:
    """Up to 2 m angles in ascending order at which the series changes its sign, by its values on a grid.

    Where there are fewer, the rest are at the end of the grid, and the second result is False.
    """
    start, step = -math.pi, 2 * math.pi / GRID
    t = start + step * np.arange(GRID)
    at = series.cos[:1] * jnp.ones_like(column(t, series.cos))
    for k in range(1, series.degree + 1):
        at += series.cos[k : k + 1] * column(np.cos(k * t), at)
        at += series.sin[k : k + 1] * column(np.sin(k * t), at)
    positive = pin(at) > 0
    changes = positive != jnp.concatenate([positive[1:], positive[:1]])
    # The k-th change is in the cell before which so many changes have been counted.
    wanted = column(range(2 * series.degree), at)
    steps = changes.astype(at.dtype)

    def counted(j, carry):
        count, place = carry
        count = count + jax.lax.dynamic_slice_in_dim(steps, j, 1)
        return count, place + (count <= wanted).astype(at.dtype)

    _, place = jax.lax.fori_loop(0, GRID, counted, (jnp.zeros_like(at[:1]), jnp.zeros_like(at[:1]) * wanted))
    left = pin(start + step * jnp.minimum(place, GRID))
    right = jnp.minimum(left + step, math.pi)
    both = pin(values(series, jnp.concatenate([left, right]))[0])
    low, high = both[: 2 * series.degree], both[2 * series.degree :]
    return _refined(series, (left, right), (low, high))


def _between(roots: Roots, series: Series) -> tuple[Roots, None]:
    """The root in each interval between those of the derivative; the last one ends a turn after the first.

    The angles are not yet brought back to [-pi, pi].
    """
    last = roots.angle[-1:]
    # The last interval crosses pi: its root may belong to the front of the row.
    turned = jnp.concatenate([last - 2 * math.pi, roots.angle[:-1]])
    points = pin(jnp.where(last > math.pi, turned, roots.angle))
    above = jnp.concatenate([roots.order[-1:], roots.order[:-1]])
    above = pin(1 + jnp.where(last > math.pi, above, roots.order))
    low = pin(values(series, points)[0])
    high = shifted(low)
    angle, real = _refined(series, (points, shifted(points, 2 * math.pi)), (low, high))
    first = abs(low) <= abs(high)
    order = pin(jnp.where(real, 0, jnp.where(first, above, shifted(above))))
    return Roots(angle, order, real, first, points, above), None


def shifted(row: jax.Array, turn: float = 0.0) -> jax.Array:
    """The next entry in the place of each, pinned; the first comes last, with a turn added."""
    return pin(jnp.concatenate([row[1:], row[:1] + turn]))


def _refined(
    series: Series, ends: tuple[jax.Array, jax.Array], at_ends: tuple[jax.Array, jax.Array]
) -> tuple[jax.Array, jax.Array]:
    """The root in an interval by Euler's method, or the end that is nearer to zero."""
    (left, right), (low, high) = ends, at_ends
    change = (low > 0) != (high > 0)
    # The ends are extrema, where the polynomial grows as the square of the distance.
    a, b = safe.sqrt(abs(low)), safe.sqrt(abs(high))
    start = left + (right - left) * safe.divide(a, a + b)
    sign = jnp.where(high < low, -1, 1).astype(low.dtype)
    middle = (left + right) / 2

    def step(_, t):
        value, first, second = values(series, t)
        # The root of the osculating parabola on the rising side.
        root = jnp.maximum(sign * first, 0) + safe.sqrt(first * first - 2 * value * second)
        moved = jnp.clip(t - 2 * safe.divide(sign * value, root), left, right)
        return pin(jnp.where(root > 0, moved, middle))

    t = jax.lax.fori_loop(0, STEPS, step, pin(start))
    # Beside a multiple root Euler's method is slow, and the end may be that root.
    end, least = jnp.where(abs(low) <= abs(high), left, right), jnp.minimum(abs(low), abs(high))
    return pin(jnp.where(change & (abs(values(series, t)[0]) <= least), t, end)), change
