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


def test_equal_entries_share_the_slope_and_far_ones_do_not_overflow(dtype):
    x = jnp.asarray([1e4, 1e4, -1e4, 3.0], dtype)
    slope = jax.grad(lambda x: ikjax.smooth_max(x, 1e-3))(x)
    np.testing.assert_allclose(slope, [0.5, 0.5, 0, 0], atol=1e-6)


@pytest.mark.parametrize("blur", [0.0, 0.1])
def test_what_is_not_finite_or_masked_counts_for_nothing(blur, dtype):
    x = jnp.asarray([[1.0, np.nan, 2.0, np.inf], [np.nan, np.nan, -np.inf, np.nan]], dtype)
    where = jnp.asarray([[True, True, False, True], [True] * 4])
    value, slope = jax.value_and_grad(lambda x: ikjax.smooth_max(x, blur, where=where, empty=-7.0).sum())(x)
    np.testing.assert_allclose(value, 1 - 7)
    np.testing.assert_array_equal(slope, [[1, 0, 0, 0], [0, 0, 0, 0]])


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


def test_margins_with_limits_climb_from_outside_and_are_finite_beside_nan(costly_dtype, rng):
    arm, where = limited(costly_dtype), goals(rng, costly_dtype)
    where = where.at[3].set(jnp.nan)

    @jax.jit
    @jax.grad
    def slope(shift, a):
        moved = where.at[..., :2, 3].add(shift)
        other = dataclasses.replace(arm, a=a)
        return ikjax.best_margin(other, ikjax.solve(other, moved)).sum()

    slopes = np.asarray(slope(jnp.zeros((400, 2), costly_dtype), arm.a))
    best = np.asarray(margins(arm, where)[0])
    assert np.isfinite(best).all() and np.isfinite(slopes).all()
    # Further out than both links: straight back is the way, whatever the limits.
    point = np.asarray(where[:, :2, 3])
    out = np.linalg.norm(point, axis=-1) > 1.0
    back = -point[out] / np.linalg.norm(point[out], axis=-1, keepdims=True)
    np.testing.assert_allclose(slopes[out], back, atol=1e-5)
