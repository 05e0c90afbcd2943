import itertools
import math

import jax
import jax.numpy as jnp
import numpy as np
from oracle import mp

from ikjax.core import trig

ANGLE_ERROR = {np.float32: 3e-7, np.float64: 1.5 * np.spacing(math.pi)}
sincos, atan2, wrap = (jax.jit(f) for f in (trig.sincos, trig.atan2, trig.wrap))


def angles(dtype, rng):
    """Every size up to 1e5, and the neighborhood of every multiple of pi/4 that matters most."""
    spread = rng.choice([-1, 1], 1500) * 10 ** rng.uniform(-9, 5, 1500)
    near = np.arange(-40, 41)[:, None] * math.pi / 4 + [-1e-5, 0, 1e-5]
    return np.array([*spread, *near.ravel(), 0.0, 1e5, -1e5], dtype)


def points(dtype, rng):
    """Every direction at every size, and every quadrant's edges."""
    phi = np.concatenate([rng.uniform(-math.pi, math.pi, 1500), np.arange(-16, 17) * math.pi / 16])
    size = 10 ** rng.uniform(-30, 30, phi.size)
    return (size * np.sin(phi)).astype(dtype), (size * np.cos(phi)).astype(dtype)


def worst(got, wanted):
    return max(abs(float(mp.mpf(float(g)) - w)) for g, w in zip(np.asarray(got), wanted, strict=True))


def worst_turn(got, wanted):
    """Likewise, whole turns left out."""
    gaps = [mp.mpf(float(g)) - mp.mpf(float(w)) for g, w in zip(np.asarray(got), wanted, strict=True)]
    return max(abs(float(gap - 2 * mp.pi * mp.nint(gap / (2 * mp.pi)))) for gap in gaps)


def test_sine_and_cosine_are_right_to_rounding(dtype, rng):
    x = angles(dtype, rng)
    sine, cosine = sincos(x)
    assert sine.dtype == cosine.dtype == dtype
    assert worst(sine, [mp.sin(float(v)) for v in x]) < 1.5 * np.finfo(dtype).eps
    assert worst(cosine, [mp.cos(float(v)) for v in x]) < 1.5 * np.finfo(dtype).eps


def test_sine_and_cosine_never_leave_their_range(dtype, rng):
    huge = (10 ** rng.uniform(5, 30, 2000)).astype(dtype)
    for value in (*sincos(angles(dtype, rng)), *sincos(huge), *sincos(np.array([1e30, -1e30], dtype))):
        assert np.all(np.abs(value) <= 1)


def test_what_is_no_angle_gives_nan(dtype):
    bad = np.array([np.nan, np.inf, -np.inf], dtype)
    assert np.isnan(sincos(bad)).all() and np.isnan(wrap(bad)).all()
    one = np.ones(1, dtype)
    assert np.isnan(atan2(bad[:1], one)) and np.isnan(atan2(one, bad[:1]))


def test_atan2_is_right_to_rounding(dtype, rng):
    y, x = points(dtype, rng)
    got = atan2(y, x)
    assert got.dtype == dtype
    wanted = [mp.atan2(float(v), float(u)) for v, u in zip(y, x, strict=True)]
    assert worst(got, wanted) < ANGLE_ERROR[dtype]


def test_atan2_follows_c_on_axes_signed_zeros_and_infinities(dtype):
    size = np.finfo(dtype).max
    special = [s * v for v in (0.0, 1.0, size, np.inf, np.finfo(dtype).tiny) for s in (1, -1)]
    y, x = np.array(list(itertools.product(special, special)), dtype).T
    got, wanted = atan2(y, x), np.arctan2(y.astype(float), x.astype(float))
    np.testing.assert_allclose(got, wanted, rtol=0, atol=ANGLE_ERROR[dtype])
    np.testing.assert_array_equal(np.signbit(got), np.signbit(y))


def test_a_subnormal_side_counts_as_itself_or_as_zero(dtype):
    tiny = np.finfo(dtype).smallest_subnormal
    sides = np.array([s * k * tiny for s in (1, -1) for k in (1, 2, 1000)] + [1, -1], dtype)
    for y, x in itertools.product(sides, sides):
        flushed = [(v, 0 * v) if abs(v) < 1 else (v,) for v in (float(y), float(x))]
        wanted = [math.atan2(*pair) for pair in itertools.product(*flushed)]
        assert min(abs(float(atan2(y, x)) - w) for w in wanted) < ANGLE_ERROR[dtype], (y, x)


def test_wrapping_keeps_the_direction(dtype, rng):
    x = angles(dtype, rng)
    got = np.asarray(wrap(x))
    assert worst_turn(got, x) < ANGLE_ERROR[dtype]
    assert np.all(got > -dtype(math.pi)) and np.all(got <= dtype(math.pi))


def test_wrapping_keeps_the_direction_at_odd_multiples_of_pi(dtype):
    odd = np.arange(1, 31830, 666) * math.pi
    assert np.abs(odd).max() < 1e5
    x = np.array([*odd, *-odd], dtype)
    x = np.concatenate([np.nextafter(x, dtype(0)), x, np.nextafter(x, 2 * x)])
    assert worst_turn(wrap(x), x) < ANGLE_ERROR[dtype]


def test_wrapping_leaves_alone_what_is_wrapped(dtype, rng):
    pi = dtype(math.pi)
    x = np.array([*rng.uniform(-3.14, 3.14, 500), pi, np.nextafter(-pi, dtype(0)), 0.0], dtype)
    np.testing.assert_array_equal(wrap(x), x)
    assert wrap(-pi) == pi
    np.testing.assert_array_equal(wrap(np.array([1e30, -1e30], dtype)) <= pi, True)


def test_wrapping_has_derivative_one(dtype):
    x = np.array([-math.pi, math.pi, 0.0, 3 * math.pi, -100.0, 1e5], dtype)
    np.testing.assert_array_equal(jax.vmap(jax.grad(trig.wrap))(x), 1)


def test_derivatives_of_sine_and_cosine_are_cosine_and_minus_sine(dtype, rng):
    x = angles(dtype, rng)
    sine, cosine = sincos(x)
    _, forward = jax.jit(lambda x: jax.jvp(trig.sincos, (x,), (jnp.ones_like(x),)))(x)
    backward = jax.jit(jax.vmap(jax.jacrev(trig.sincos)))(x)
    for derivatives in (forward, backward):
        np.testing.assert_array_equal(derivatives[0], cosine)
        np.testing.assert_array_equal(derivatives[1], -sine)


def test_derivatives_of_atan2_are_those_of_the_angle(dtype, rng):
    y, x = points(dtype, rng)
    size = np.hypot(y.astype(float), x)
    for transform in (jax.jacfwd, jax.jacrev):
        derivatives = jax.jit(jax.vmap(transform(trig.atan2, (0, 1))))(y, x)
        got = np.asarray(derivatives, float) * size
        np.testing.assert_allclose(got, [x / size, -y / size], atol=8 * np.finfo(dtype).eps, rtol=0)


def test_second_derivatives_are_exact_too(dtype):
    def second(f, *args):
        return jax.jit(jax.vmap(jax.hessian(f, tuple(range(len(args))))))(*args)

    y, x = np.array([[0.3, -2.0, 30.0], [-1.0, 0.5, 40.0]], dtype)
    near = {"rtol": 16 * np.finfo(dtype).eps}
    np.testing.assert_allclose(
        [second(trig.sincos, x)[k][0][0] for k in (0, 1)], [-np.sin(x), -np.cos(x)], **near
    )
    wanted = np.array([[-2 * x * y, y**2 - x**2], [y**2 - x**2, 2 * x * y]]) / (x**2 + y**2) ** 2
    np.testing.assert_allclose(second(trig.atan2, y, x), wanted, **near)


def test_atan2_has_derivative_zero_at_the_origin(dtype):
    y, x = np.array(list(itertools.product([0.0, -0.0], repeat=2)), dtype).T
    first, second = jax.grad(trig.atan2, (0, 1)), jax.hessian(trig.atan2, (0, 1))
    np.testing.assert_array_equal(jax.jit(jax.vmap(first))(y, x), 0)
    assert np.isfinite(jax.jit(jax.vmap(second))(y, x)).all()


def test_atan2_has_finite_derivatives_beside_the_origin_and_far_out(dtype):
    info = np.finfo(dtype)
    sizes = [info.smallest_subnormal, info.tiny / 8, info.tiny, info.max, np.inf]
    y, x = np.array(list(itertools.product([0.0, *sizes], sizes)), dtype).T
    derivatives = jax.jit(jax.vmap(jax.grad(trig.atan2, (0, 1))))(y, x)
    assert np.isfinite(derivatives).all()


def test_angles_half_a_turn_apart_share_one_atan2():
    for value in (-3.0, -0.0, 0.5, math.pi):
        given = trig.angle(jnp.sin(value), jnp.cos(value))
        turned = trig.half_turn(given)
        assert abs(trig.atan2(turned.sin, turned.cos) - wrap(turned.value)) < 1e-15
        assert trig.choose(jnp.bool_(True), given, turned).value == given.value
        assert trig.choose(jnp.bool_(False), given, turned).value == turned.value


def test_whole_turns_are_added_to_two_roundings(dtype, rng):
    x = rng.uniform(-math.pi, math.pi, 500).astype(dtype)
    turns = rng.integers(-10_000, 10_000, 500)
    turns[:300] = rng.integers(-2, 3, 300)
    got = np.asarray(jax.jit(trig.with_turns)(x, jnp.asarray(turns, dtype)))
    exact = [mp.mpf(float(a)) + 2 * mp.pi * int(k) for a, k in zip(x, turns, strict=True)]
    off = [abs(float(mp.mpf(float(g)) - w)) / max(1, abs(float(w))) for g, w in zip(got, exact, strict=True)]
    assert max(off) < 1.5 * np.finfo(dtype).eps
    np.testing.assert_array_equal(got[turns == 0], x[turns == 0])
    derivative = jax.vmap(jax.grad(lambda x, k: trig.with_turns(x, k)))(
        jnp.asarray(x), jnp.asarray(turns, dtype)
    )
    np.testing.assert_array_equal(derivative, 1)
