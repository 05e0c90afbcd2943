"""Whole turns of joints, against a count of all of them in numpy."""

import dataclasses
import functools
import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import ikjax

TURN = 2 * np.pi
BRUTE = np.arange(-12, 13)


def kr16(dtype=np.float64) -> ikjax.Arm:
    limits = np.radians([(-185, 185), (-155, 35), (-130, 154), (-350, 350), (-130, 130), (-350, 350)])
    return ikjax.Arm.from_dh(
        a=[0.26, 0.68, -0.035, 0, 0, 0],
        alpha=np.array([1, 0, 1, -1, 1, 0]) * np.pi / 2,
        d=[0.675, 0, 0, 0.67, 0, 0.158],
        convention="standard",
        limits=limits,
        dtype=dtype,
    )


def ur5(dtype=np.float64) -> ikjax.Arm:
    return dataclasses.replace(
        ikjax.robots.ur5().astype(dtype), limits=jnp.asarray(np.tile([-TURN, TURN], (6, 1)), dtype)
    )


def any_limits(rng, dtype) -> np.ndarray:
    """Of six joints: beyond a turn, off the center, one-sided, none."""
    low = rng.uniform(-9, 6, 6)
    limits = np.stack([low, low + rng.uniform(0, 20, 6)], 1).astype(dtype)
    limits[rng.random((6, 2)) < 0.15] = np.inf
    return np.where(np.isinf(limits), [-np.inf, np.inf], limits)


def made(q, valid, dtype) -> ikjax.Solutions:
    zero, flag = jnp.zeros(valid.shape, dtype), jnp.zeros(valid.shape, bool)
    return ikjax.Solutions(jnp.asarray(q, dtype), jnp.asarray(valid), zero, flag, zero, zero)


def brute(arm, q, near):
    """Best value of every joint, q and near (..., S, n), and whether its limits allow one, in float64."""
    low, high = np.asarray(arm.limits, float).T
    slides = np.array([kind == "P" for kind in arm.kinds])
    all_turns = np.asarray(q, float)[..., None] + TURN * BRUTE
    all_turns = np.where(slides[:, None], np.asarray(q, float)[..., None], all_turns)
    inside = (all_turns >= low[:, None]) & (all_turns <= high[:, None])
    move = abs(all_turns - np.asarray(near, float)[..., None])
    found = inside.any(-1)
    best = np.where(found[..., None] & ~inside, np.inf, move).argmin(-1)
    count = np.where(slides, found, inside.sum(-1))
    return np.take_along_axis(all_turns, best[..., None], -1)[..., 0], found, count


CASES = [("RRRRRR", 0), ("RRRRRR", 1), ("RPRRPR", 2)]


@functools.cache
def case(kinds, seed, dtype):
    """An arm with any limits, solutions, places and the best values."""
    rng = np.random.default_rng(seed)
    arms, sols, places = [], [], []
    for _ in range(20):
        limits = jnp.asarray(any_limits(rng, dtype))
        arms.append(
            dataclasses.replace(ikjax.robots.get("puma560").astype(dtype), limits=limits, kinds=kinds)
        )
        q = rng.uniform(-np.pi, np.pi, (5, 8, 6)).astype(dtype)
        sols.append(made(q, rng.random((5, 8)) < 0.7, dtype))
        places.append(rng.uniform(-15, 15, (5, 6)).astype(dtype))
    return arms, sols, places


def tolerance(dtype) -> float:
    return 64 * float(np.finfo(dtype).eps)


@pytest.mark.parametrize(("kinds", "seed"), CASES)
def test_nearest_and_within_limits_take_the_best_of_all_turns(kinds, seed, dtype):
    alone = refused = 0
    for arm, sol, now in zip(*case(kinds, seed, dtype), strict=True):
        near = np.broadcast_to(now[:, None], sol.q.shape)
        best, found, _ = brute(arm, sol.q, near)
        inside = ikjax.within_limits(arm, sol, now)
        np.testing.assert_array_equal(inside.valid, np.asarray(sol.valid) & found.all(-1))
        np.testing.assert_allclose(inside.q, np.where(found, best, sol.q), atol=tolerance(dtype))
        refused += (np.asarray(sol.valid) & ~found.all(-1)).sum()
        q, any_valid = ikjax.nearest(arm, sol, now)
        move = np.where(sol.valid, abs(best - near).max(-1), np.inf)
        np.testing.assert_array_equal(any_valid, np.asarray(sol.valid).any(-1))
        chosen = np.take_along_axis(best, move.argmin(-1)[:, None, None], 1)[:, 0]
        np.testing.assert_allclose(q, chosen, atol=tolerance(dtype))
        # As few turns as will do, which are those nearest to where the joint is.
        least, found, _ = brute(arm, sol.q, sol.q)
        inside = ikjax.within_limits(arm, sol)
        np.testing.assert_allclose(inside.q, np.where(found, least, sol.q), atol=tolerance(dtype))
        alone += inside.valid.sum()
        distance = np.asarray(ikjax.limit_clearance(arm, sol.q))
        np.testing.assert_array_equal(inside.valid, np.asarray(sol.valid) & (distance >= 0))
    assert alone > 20 and refused > 20


@pytest.mark.parametrize(("kinds", "seed"), CASES)
def test_turns_are_all_that_the_limits_allow(kinds, seed, dtype):
    for arm, sol, now in zip(*case(kinds, seed, dtype), strict=True):
        free = ~np.isfinite(np.asarray(arm.limits)).all(-1)
        _, _, count = brute(arm, sol.q, sol.q)
        found = ikjax.turns(arm, sol)
        assert np.isfinite(found.q).all()
        within, values = np.asarray(found.within), np.asarray(found.q, float)
        low, high = np.asarray(arm.limits, float).T
        inside = (values >= low[:, None] - 1e-4) & (values <= high[:, None] + 1e-4)
        assert inside[within].all() and not within[~np.asarray(sol.valid)].any()
        wanted = np.where(np.asarray(sol.valid)[..., None], count, 0)
        np.testing.assert_array_equal(within.sum(-1)[..., ~free], wanted[..., ~free])
        turning = np.array([kind == "R" for kind in arm.kinds])
        assert (within.sum(-1) >= np.minimum(wanted, 3))[..., free & turning].all()
        off = (values - np.asarray(sol.q, float)[..., None]) / TURN
        np.testing.assert_allclose(off, np.round(off), atol=1e-5)
        assert (np.diff(values)[within[..., 1:]] > 6).all()
        # The nearest of all is among them, also where there are more than are asked for.
        few = ikjax.turns(arm, sol, now, most=1)
        best, found, _ = brute(arm, sol.q, np.broadcast_to(now[:, None], sol.q.shape))
        there = found & np.asarray(sol.valid)[..., None]
        np.testing.assert_array_equal(few.within[..., 0], there)
        np.testing.assert_allclose(few.q[..., 0][there], best[there], atol=tolerance(dtype))


def test_an_arm_that_is_asked_to_stay_stays(costly_dtype):
    dtype = costly_dtype
    rng = np.random.default_rng(4)
    for arm in (kr16(dtype), ur5(dtype)):
        low, high = np.asarray(arm.limits).T
        now = rng.uniform(low, high, (50, 6)).astype(dtype)
        now[:, 4] = np.sign(now[:, 4]) * np.clip(abs(now[:, 4]), 0.3, 2)  # not at the wrist's singularity
        sol = ikjax.solve(arm, ikjax.fk(arm, now))
        for given in (sol, ikjax.within_limits(arm, sol), ikjax.within_limits(arm, sol, now)):
            q, found = ikjax.nearest(arm, given, now)
            assert found.all()
            move = abs(np.asarray(q) - now).max(-1)
            assert np.median(move) < 1e3 * np.finfo(dtype).eps and np.quantile(move, 0.9) < 0.1


def test_a_kr16_has_two_values_a_wrist_axis_and_a_universal_robot_mostly_two_of_three():
    for arm, most, configurations in ((kr16(), 2, 4), (ur5(), 3, 64)):
        q = np.array([0.3, -0.9, 0.7, 0.5, 0.8, -0.4])
        found = ikjax.turns(arm, ikjax.solve(arm, ikjax.fk(arm, q)))
        assert found.q.shape == (8, 6, most)
        counts = np.asarray(found.within.sum(-1).prod(-1))
        assert set(counts[counts > 0]) == {configurations}
        slot = int(counts.argmax())
        rows = [values[flag] for values, flag in zip(found.q[slot], found.within[slot], strict=True)]
        every = np.array(list(itertools.product(*rows)))
        assert len(np.unique(every.round(6), axis=0)) == configurations
        gap, turn = ikjax.pose_error(ikjax.fk(arm, every), ikjax.fk(arm, q))
        assert gap.max() < 1e-12 and turn.max() < 1e-12
    ends = dataclasses.replace(ur5(), limits=jnp.asarray(np.tile([-TURN, TURN], (6, 1))))
    zero = made(np.zeros((1, 6)), np.ones(1, bool), np.float64)
    assert ikjax.turns(ends, zero).within.all()


def test_a_motor_whose_turn_is_another_pose_is_never_turned():
    arm = ur5()
    coupling = jnp.eye(6).at[5, 4].set(0.5)
    arm = dataclasses.replace(arm, coupling=coupling, limits=arm.limits.at[4].set(jnp.array([3.0, 9.0])))
    sol = made(np.tile([0.5, 0, 0, 0, 0.2, 0], (2, 1)), np.ones(2, bool), np.float64)
    now = np.full(6, 6.0)
    assert not ikjax.within_limits(arm, sol, now).valid.any()
    q, found = ikjax.nearest(arm, sol, now)
    assert found and q[4] == 0.2
    np.testing.assert_allclose(q[:4], [0.5, TURN, TURN, TURN], rtol=1e-15)
    assert not ikjax.turns(arm, sol).within[:, 4].any()
    traced = jax.jit(lambda arm: ikjax.nearest(arm, sol, now)[0])(arm)
    np.testing.assert_array_equal(traced, q)


def test_jit_vmap_and_grad_agree(dtype):
    arms, sols, places = case("RRRRRR", 0, dtype)
    arm, sol, now = arms[0], sols[0], jnp.asarray(places[0])

    def every(sol, now):
        return ikjax.nearest(arm, sol, now), ikjax.within_limits(arm, sol, now), ikjax.turns(arm, sol, now)

    wanted = jax.tree.leaves(every(sol, now))
    for other in (jax.jit(every), jax.vmap(every)):
        for x, y in zip(jax.tree.leaves(other(sol, now)), wanted, strict=True):
            np.testing.assert_array_equal(x, y)

    def total(q):
        nearest, inside, all_turns = every(dataclasses.replace(sol, q=q), now)
        return nearest[0].sum() + inside.q.sum() + all_turns.q.sum()

    gradient = np.asarray(jax.jit(jax.grad(total))(sol.q))
    np.testing.assert_array_equal(gradient.sum((1, 2)), 6 * (1 + 8 * (1 + wanted[-1].shape[-1])))


def test_traced_limits_need_to_be_told_how_many():
    sol = made(np.zeros((1, 6)), np.ones(1, bool), np.float64)
    with pytest.raises(ValueError, match="say most=, because the limits are traced"):
        jax.jit(lambda arm: ikjax.turns(arm, sol).q)(ur5())
    found = jax.jit(lambda arm: ikjax.turns(arm, sol, most=3))(ur5())
    assert found.within.all()
    with pytest.raises(ValueError, match="most must be a whole number, 1 or more, got 0"):
        ikjax.turns(ur5(), sol, most=0)
    with pytest.raises(ValueError, match=r"q_now must have shape \(\.\.\., 6\), got \(5,\)"):
        ikjax.turns(ur5(), sol, np.zeros(5))


def test_turns_without_limits_are_those_around_a_place():
    arm = dataclasses.replace(ur5(), limits=jnp.asarray(np.tile([-np.inf, np.inf], (6, 1))))
    sol = made(np.full((1, 6), 0.5), np.ones(1, bool), np.float64)
    np.testing.assert_allclose(ikjax.turns(arm, sol).q[0, 0], 0.5 + TURN * np.arange(-1, 2))
    np.testing.assert_allclose(
        ikjax.turns(arm, sol, np.full(6, 100.0), most=2).q[0, 0], 0.5 + TURN * np.array([16, 17])
    )
    ray = dataclasses.replace(arm, limits=jnp.asarray(np.tile([7.0, np.inf], (6, 1))))
    np.testing.assert_allclose(ikjax.turns(ray, sol).q[0, 0], 0.5 + TURN * np.arange(2, 5))
