"""Smooth extremes, and margins with joint limits in them, from inside and outside of a workspace."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import ikjax


def test_a_smooth_maximum_lies_between_the_maximum_and_its_bound(dtype, rng):
    x = jnp.asarray(rng.normal(size=(50, 8)), dtype)
    for blur in (1e-3, 0.1, 10.0):
        over = np.asarray(ikjax.smooth_max(x, blur) - x.max(-1))
        assert (over >= -1e-5).all() and (over <= blur * np.log(8) + 1e-5).all()
        under = np.asarray(ikjax.smooth_min(x, blur) - x.min(-1))
        assert (under <= 1e-5).all() and (under >= -blur * np.log(8) - 1e-5).all()
    np.testing.assert_array_equal(ikjax.smooth_max(x), x.max(-1))
    np.testing.assert_array_equal(ikjax.smooth_min(x, jnp.zeros((), dtype), axis=0), x.min(0))


def test_equal_entries_share_the_gradient_and_far_ones_do_not_overflow(dtype):
    x = jnp.asarray([1e4, 1e4, -1e4, 3.0], dtype)
    gradient = jax.grad(lambda x: ikjax.smooth_max(x, 1e-3))(x)
    np.testing.assert_allclose(gradient, [0.5, 0.5, 0, 0], atol=1e-6)


@pytest.mark.parametrize("blur", [0.0, 0.1])
def test_what_is_not_finite_or_masked_counts_for_nothing(blur, dtype):
    x = jnp.asarray([[1.0, np.nan, 2.0, np.inf], [np.nan, np.nan, -np.inf, np.nan]], dtype)
    where = jnp.asarray([[True, True, False, True], [True] * 4])
    value, gradient = jax.value_and_grad(lambda x: ikjax.smooth_max(x, blur, where=where, empty=-7.0).sum())(
        x
    )
    np.testing.assert_allclose(value, 1 - 7)
    np.testing.assert_array_equal(gradient, [[1, 0, 0, 0], [0, 0, 0, 0]])


def limited(dtype):
    arm = ikjax.robots.planar_2r().astype(dtype)
    return dataclasses.replace(arm, limits=jnp.array([[-1.0, 2.0], [-2.0, 0.2]], dtype))


def goals(rng, dtype, count=400):
    x, y = rng.uniform(-1.5, 1.5, (2, count))
    return ikjax.position(x, y, 0 * x).astype(dtype)


@jax.jit
def margins(arm, goals):
    sol = ikjax.solve(arm, goals)
    narrowed = ikjax.limited_margins(arm, sol)
    return ikjax.best_margin(arm, sol), narrowed.margin, narrowed.valid, sol.margin


def test_a_margin_with_limits_is_positive_just_where_a_goal_is_reached_within_them(dtype, rng):
    best, each, valid, free = map(np.asarray, margins(limited(dtype), goals(rng, dtype)))
    clear = np.abs(each) > 1e-4
    np.testing.assert_array_equal((each > 0)[clear], valid[clear])
    np.testing.assert_array_equal(best, each.max(-1))
    assert (each <= free).all() and 0.05 < (best > 0).mean() < 0.5


def test_margins_with_limits_lead_in_from_outside_and_are_finite_beside_nan(costly_dtype, rng):
    arm, where = limited(costly_dtype), goals(rng, costly_dtype)
    where = where.at[3].set(jnp.nan)

    @jax.jit
    @jax.grad
    def gradient(shift, a):
        moved = where.at[..., :2, 3].add(shift)
        other = dataclasses.replace(arm, a=a)
        return ikjax.best_margin(other, ikjax.solve(other, moved)).sum()

    gradients = np.asarray(gradient(jnp.zeros((400, 2), costly_dtype), arm.a))
    best = np.asarray(margins(arm, where)[0])
    assert np.isfinite(best).all() and np.isfinite(gradients).all()
    # Further out than both links: straight back is the way, whatever the limits.
    point = np.asarray(where[:, :2, 3])
    out = np.linalg.norm(point, axis=-1) > 1.0
    back = -point[out] / np.linalg.norm(point[out], axis=-1, keepdims=True)
    np.testing.assert_allclose(gradients[out], back, atol=1e-5)


@pytest.mark.parametrize("name", ["planar_2r", pytest.param("puma560", marks=pytest.mark.slow)])
def test_margins_with_limits_have_the_derivative_of_differences_inside_and_outside(name, rng):
    arm = limited(np.float64) if name == "planar_2r" else ikjax.robots.get(name)
    here = rng.uniform(-1.3, 1.3, (200, 3))
    turns = np.asarray(ikjax.maps.even_rotations(200), np.float64)
    where = goals(rng, np.float64, 200) if arm.n == 2 else ikjax.pose(xyz=here, matrix=turns)
    rates = {key: rng.normal(size=arm.n) * (np.asarray(getattr(arm, key)) != 0) for key in ("a", "d")}
    shift = np.where(arm.n == 2, [1, 1, 0], 1) * rng.normal(size=3)

    @jax.jit
    def both(t):
        def margin(t):
            other = dataclasses.replace(arm, **{key: getattr(arm, key) + t * rates[key] for key in rates})
            sol = ikjax.solve(other, where.at[:, :3, 3].add(t * shift))
            return ikjax.limited_margins(other, sol).margin, sol.valid

        return jax.jvp(margin, (t,), (jnp.ones_like(t),), has_aux=True)

    step = 1e-6
    behind, now, ahead = (np.asarray(both(jnp.asarray(t))[0]) for t in (-step, 0.0, step))
    _, derivative, valid = map(np.asarray, both(jnp.asarray(0.0)))
    # A corner bends as much as the step is long, a curve as its square.
    smooth = np.abs(ahead - 2 * now + behind) < 1e-3 * step
    assert smooth.mean() > 0.98
    assert (valid & (now < 0)).mean() > 0.05 and (~valid & (now < 0)).mean() > 0.2
    np.testing.assert_allclose(
        derivative[smooth], ((ahead - behind) / (2 * step))[smooth], rtol=1e-6, atol=1e-6
    )
