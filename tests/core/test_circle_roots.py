"""Real roots of trigonometric polynomials, against those at 50 digits."""

import functools
import math

import jax
import jax.numpy as jnp
import mpmath
import numpy as np
import pytest
from root_counts import LOWEST_FIRST

from ikjax.core import circle_roots
from ikjax.core.circle_roots import Series
from ikjax.core.xla import divider, pinning

mp = mpmath.mp.clone()
mp.dps = 50


@jax.jit
def solved(series):
    with pinning(divider(series.cos[0])):
        return circle_roots.real_roots(series)


def product(angles, radii=()) -> Series:
    """The polynomial with these real roots, (N, k) at 50 digits, and pairs of complex ones (angle, radius).

    It is the product of sin((t - angle) / 2) over the roots, scaled so that its largest coefficient is one.
    """
    columns = []
    for row, pairs in zip(angles, radii, strict=True):
        points = [mp.expj(mp.mpf(x)) for x in row]
        points += [mp.expj(mp.mpf(x)) * mp.mpf(r) ** sign for x, r in pairs for sign in (1, -1)]
        m, c = len(points) // 2, [mp.mpc(1)]
        for z in points:
            c = [a - z * b for a, b in zip([mp.mpc(0), *c], [*c, mp.mpc(0)], strict=True)]
        # A factor of length one makes the middle coefficient real, and with it the polynomial.
        turn = mp.sqrt(mp.conj(c[0]) / c[-1]) / abs(mp.sqrt(mp.conj(c[0]) / c[-1]))
        c = [x * turn for x in c]
        size = max(map(abs, c))
        twice = [2 if k else 1 for k in range(m + 1)]
        columns.append(
            (
                [float(f * mp.re(c[m + k]) / size) for k, f in enumerate(twice)],
                [-float(f * mp.im(c[m + k]) / size) for k, f in enumerate(twice)],
            )
        )
    cos, sin = (np.array(x).T for x in zip(*columns, strict=True))
    return Series(jnp.asarray(cos), jnp.asarray(sin))


def exact_roots(cos, sin) -> list[float]:
    """The real roots of one series at 50 digits."""
    m = len(cos) - 1
    upper = [mp.mpc(a, -b) / 2 for a, b in zip(cos[1:], sin[1:], strict=True)]
    c = [*map(mp.conj, upper[::-1]), mp.mpf(cos[0]), *upper]
    start = [mp.mpc(complex(x)) for x in np.roots([complex(x) for x in c[::-1]])]
    ordered = c if LOWEST_FIRST else c[::-1]
    found = mp.polyroots(ordered, **LOWEST_FIRST, maxsteps=60, extraprec=150, roots_init=start)
    assert len(found) == 2 * m
    return sorted(float(mp.arg(z)) for z in found if abs(abs(z) - 1) < mp.mpf(10) ** -35)


def apart(a, b):
    return np.abs(np.angle(np.exp(1j * (np.asarray(a)[:, None] - np.asarray(b)[None]))))


@functools.cache
def random_series(degree, decay=1.0) -> Series:
    rng = np.random.default_rng([degree, 3])
    cos, sin = rng.normal(size=(2, degree + 1, 300)) * decay ** np.arange(degree + 1)[:, None]
    return Series(jnp.asarray(cos), jnp.asarray(sin))


@pytest.mark.parametrize(("degree", "decay"), [(1, 1.0), (2, 1.0), (4, 1.0), (8, 1.0), (8, 0.4)])
def test_every_real_root_is_found_and_no_other(degree, decay):
    series = random_series(degree, decay)
    roots = solved(series)
    assert roots.angle.shape == (2 * degree, 300)
    total = 0
    for i in range(300):
        wanted = exact_roots(*(np.asarray(x)[:, i] for x in series))
        found = np.asarray(roots.angle)[np.asarray(roots.real)[:, i], i]
        assert len(found) == len(wanted), i
        total += len(wanted)
        if wanted:
            assert apart(found, wanted).min(1).max() < 1e-10 and apart(found, wanted).min(0).max() < 1e-10
    assert total > 300


EPS = 64 * np.finfo(float).eps
"""What rounding leaves of a polynomial whose coefficients are one at most, with a sum of some dozen terms."""


def derivative(series, order, angle) -> np.ndarray:
    """(N,) of each series at its angle."""
    for _ in range(order):
        series = series.derivative()
    k = np.arange(series.degree + 1)[:, None]
    return np.sum(np.cos(k * angle) * np.asarray(series.cos) + np.sin(k * angle) * np.asarray(series.sin), 0)


def complex_pairs(rng, count):
    """(100, count, 2) angles and radii."""
    return np.stack([rng.uniform(-np.pi, np.pi, (100, count)), rng.uniform(0.3, 0.8, (100, count))], -1)


@pytest.mark.parametrize("multiplicity", [2, 3, 4])
def test_a_multiple_root_is_given_as_often_as_it_counts(multiplicity):
    rng = np.random.default_rng(multiplicity)
    base = rng.uniform(-3, 3, 100)
    # The other real root makes their number even, and is far away.
    rest = [base + np.pi] if multiplicity % 2 else []
    angles = np.stack([base] * multiplicity + rest, 1)
    series = product(angles, complex_pairs(rng, 8 - angles.shape[1] // 2))
    off = np.sort(np.abs(np.angle(np.exp(1j * (np.asarray(solved(series).angle) - base)))), axis=0)
    # Rounding moves the root to where the first term that is left of the Taylor series is as large.
    least = abs(derivative(series, multiplicity, base)) / math.factorial(multiplicity)
    assert (off[multiplicity - 1] < 2 * (EPS / least) ** (1 / multiplicity)).all()


@pytest.mark.parametrize("gap", [1e-1, 1e-2, 1e-3, 1e-5])
def test_two_close_roots_are_told_apart(gap):
    rng = np.random.default_rng(5)
    base = rng.uniform(-3, 3, 100)
    series = product(np.stack([base, base + gap], 1), complex_pairs(rng, 7))
    roots = solved(series)
    # Between the two roots the polynomial must be larger than its rounding.
    certain = abs(derivative(series, 2, base)) * gap**2 / 8 > EPS
    assert certain.sum() > 50
    real, angle = np.asarray(roots.real)[:, certain], np.asarray(roots.angle)[:, certain]
    assert (real.sum(0) == 2).all()
    found = np.sort((angle.T[real.T].reshape(-1, 2) - base[certain, None] + 1) % (2 * np.pi) - 1, axis=1)
    allowed = EPS / abs(derivative(series, 1, base))[certain, None] + EPS
    assert (abs(found - [0, gap]) < 4 * allowed).all()


def test_a_pair_that_is_just_complex_is_given_by_the_extremum_between():
    rng = np.random.default_rng(6)
    base = rng.uniform(-3, 3, (100, 1))
    nearly = np.stack([base, np.full((100, 1), 1 - 1e-6)], -1)
    radii = np.concatenate([nearly, complex_pairs(rng, 7)], axis=1)
    roots = solved(product(np.empty((100, 0)), radii))
    assert not np.asarray(roots.real).any()
    near = np.abs(np.angle(np.exp(1j * (np.asarray(roots.angle) - base.T)))) < 1e-5
    assert (near.sum(0) >= 2).all()


@pytest.mark.parametrize("case", ["zero", "constant", "one harmonic", "not a number"])
def test_angles_are_in_range_where_there_is_little_to_find(case, dtype):
    cos, sin = np.zeros((2, 9, 3), dtype)
    if case == "constant":
        cos[0] = 1
    if case == "one harmonic":
        cos[3] = 1
    if case == "not a number":
        cos[2, 1] = np.nan
    roots = solved(Series(jnp.asarray(cos), jnp.asarray(sin)))
    good = np.array([0, 2])
    assert (np.abs(np.asarray(roots.angle)[:, good]) <= np.pi).all()
    assert np.asarray(roots.real).sum(0)[0] == (6 if case == "one harmonic" else 0)
    if case == "one harmonic":
        found = np.asarray(roots.angle)[np.asarray(roots.real)[:, 0], 0]
        np.testing.assert_allclose(np.sort(np.cos(3 * found)), 0, atol=1e-5)


def test_the_coefficients_come_from_samples(dtype):
    series = random_series(8)
    at = 0.1 + np.pi * np.arange(18) / 9
    k = np.arange(9)[:, None]
    samples = np.cos(k * at).T @ series.cos + np.sin(k * at).T @ series.sin
    again = circle_roots.interpolated(jnp.asarray(samples, dtype), 0.1)
    for one, other in zip(series, again, strict=True):
        # A constant has no sine.
        keep = slice(1, None) if one is series.sin else slice(None)
        np.testing.assert_allclose(other[keep], one[keep], atol=100 * np.finfo(dtype).eps)
