"""Choosing a branch: nearest to where the arm is, and within its limits."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import ikjax

ARM = ikjax.robots.get("puma560")
FREE = dataclasses.replace(ARM, limits=jnp.asarray(np.tile([-np.inf, np.inf], (6, 1))))
PI = np.pi


def solutions(q, valid=None) -> ikjax.Solutions:
    """Solutions with these joints, (..., S, n), all valid unless told otherwise."""
    q = jnp.asarray(q)
    shape, flag = q.shape[:-1], jnp.zeros(q.shape[:-1], bool)
    zero = jnp.zeros(shape, q.dtype)
    valid = ~flag if valid is None else jnp.asarray(valid)
    return ikjax.Solutions(
        q=q, valid=valid, margin=zero, continuum=flag, position_error=zero, rotation_error=zero
    )


def row(*first, dtype=np.float64):
    """Six joints of which the first are given."""
    return np.array([*first, *[0.0] * (6 - len(first))], dtype)


def eps(dtype) -> float:
    return float(np.finfo(dtype).eps)


def limited(lower, upper, kinds="RRRRRR") -> ikjax.Arm:
    limits = np.tile([-np.inf, np.inf], (6, 1))
    limits[0] = lower, upper
    return dataclasses.replace(ARM, limits=jnp.asarray(limits), kinds=kinds)


class TestNearest:
    def test_the_largest_move_counts_not_the_length(self):
        # 1.0 in one joint is further in L2 than 0.9 in one, but nearer than six of 0.95 only in L2's eyes.
        one_big, many_small = row(1.0), np.full(6, 0.9)
        q, found = ikjax.nearest(ARM, solutions([one_big, many_small]), np.zeros(6))
        assert bool(found)
        np.testing.assert_array_equal(q, many_small)

    def test_a_joint_is_near_across_the_seam_and_goes_on_turning(self, dtype):
        sol = solutions(np.array([row(2.0), row(-PI + 0.1)], dtype))
        q, _ = ikjax.nearest(FREE.astype(dtype), sol, row(PI - 0.1, dtype=dtype))
        assert float(q[0]) == pytest.approx(PI + 0.1, abs=8 * eps(dtype))

    def test_a_joint_that_may_not_turn_on_goes_back(self):
        sol = solutions([row(2.0), row(-PI + 0.1)])
        q, _ = ikjax.nearest(limited(-PI, PI), sol, row(PI - 0.1))
        assert float(q[0]) == 2.0

    def test_a_joint_that_no_turn_brings_inside_is_compared_without_its_limits(self):
        sol = solutions([row(0.5), row(2.5)])
        q, found = ikjax.nearest(limited(-0.1, 0.1), sol, row(7.0))
        assert bool(found) and float(q[0]) == pytest.approx(0.5 + 2 * PI)

    def test_a_sliding_joint_has_no_seam(self):
        arm = dataclasses.replace(ARM, kinds="PRRRRR")
        q, _ = ikjax.nearest(arm, solutions([row(2.0), row(-PI + 0.1)]), row(PI - 0.1))
        assert float(q[0]) == 2.0

    def test_an_arm_that_has_turned_1e5_rad_is_no_further_away(self, dtype):
        turns = np.round(1e5 / (2 * PI))
        now = np.asarray(turns * 2 * PI + 0.5, dtype)
        exact = np.remainder(np.float64(now), 2 * PI)
        sol = solutions(np.array([row(exact + 0.2), row(exact - 0.1), row(exact + 0.15)], dtype))
        q, _ = ikjax.nearest(FREE.astype(dtype), sol, row(now, dtype=dtype))
        assert float(q[0]) == pytest.approx(float(now) - 0.1, abs=2e5 * eps(dtype))

    def test_weights_scale_the_moves(self):
        sol = solutions([row(1.0), row(0.0, 0.9)])
        assert float(ikjax.nearest(ARM, sol, np.zeros(6))[0][1]) == 0.9
        weights = np.array([0.1, 1, 1, 1, 1, 1])
        assert float(ikjax.nearest(ARM, sol, np.zeros(6), weights)[0][0]) == 1.0

    def test_a_slot_that_is_not_valid_is_never_chosen(self):
        sol = solutions([row(0.0), row(3.0)], [False, True])
        q, found = ikjax.nearest(ARM, sol, np.zeros(6))
        assert bool(found) and float(q[0]) == 3.0

    def test_without_a_valid_slot_found_is_false_and_q_finite(self):
        sol = solutions([row(0.3), row(3.0)], [False, False])
        q, found = ikjax.nearest(ARM, sol, np.zeros(6))
        assert not bool(found)
        np.testing.assert_array_equal(q, row(0.3))

    def test_one_place_serves_a_whole_batch(self):
        sol = solutions(np.stack([[row(0.1), row(1.0)], [row(2.0), row(0.2)], [row(0.3), row(-0.1)]]))
        q, found = ikjax.nearest(ARM, sol, np.zeros(6))
        np.testing.assert_array_equal(q[:, 0], [0.1, 0.2, -0.1])
        assert found.shape == (3,)

    def test_jit_and_vmap_choose_the_same(self, rng):
        sol = solutions(rng.uniform(-PI, PI, (20, 8, 6)), rng.uniform(size=(20, 8)) < 0.6)
        now = rng.uniform(-PI, PI, (20, 6))
        wanted = ikjax.nearest(FREE, sol, now)

        def call(sol, now):
            return ikjax.nearest(FREE, sol, now)

        for other in (jax.jit(call), jax.vmap(call), jax.jit(jax.vmap(call))):
            for u, v in zip(other(sol, jnp.asarray(now)), wanted, strict=True):
                np.testing.assert_array_equal(u, v)
        move = (np.asarray(sol.q) - now[:, None] + PI) % (2 * PI) - PI
        best = np.where(sol.valid, np.abs(move).max(-1), np.inf).argmin(-1)
        np.testing.assert_allclose(wanted[0], now + move[np.arange(20), best], atol=1e-14)

    @pytest.mark.parametrize("shape", [(), (5,), (7,), (6, 1)])
    def test_a_wrong_place_raises(self, shape):
        with pytest.raises(ValueError, match=r"q_now must have shape \(\.\.\., 6\), got"):
            ikjax.nearest(ARM, solutions([row(0.0)]), np.zeros(shape))

    @pytest.mark.parametrize("shape", [(), (5,), (1, 6)])
    def test_wrong_weights_raise(self, shape):
        with pytest.raises(ValueError, match=r"weights must have shape \(6,\), got"):
            ikjax.nearest(ARM, solutions([row(0.0)]), np.zeros(6), np.zeros(shape))


class TestWithinLimits:
    def moved(self, arm, value, dtype=np.float64):
        sol = ikjax.within_limits(arm, solutions(row(value, dtype=dtype)[None]))
        return float(sol.q[0, 0]), bool(sol.valid[0])

    def test_what_is_inside_stays(self, dtype):
        assert self.moved(limited(-1, 1), 0.5, dtype) == (0.5, True)

    @pytest.mark.parametrize(
        ("lower", "upper", "value", "turns"),
        [(2, 8, 1, 1), (-8, -2, 1, -1), (10, 20, 1, 2), (-20, -10, 1, -2), (3, 3 + 2 * PI, -3, 1)],
    )
    def test_whole_turns_bring_it_inside(self, lower, upper, value, turns, dtype):
        q, valid = self.moved(limited(lower, upper), value, dtype)
        assert valid
        assert q == pytest.approx(value + turns * 2 * PI, abs=80 * eps(dtype))

    def test_as_few_turns_as_will_do(self):
        assert self.moved(limited(4, 100), 0.0)[0] == pytest.approx(2 * PI)
        assert self.moved(limited(-100, -4), 0.0)[0] == pytest.approx(-2 * PI)

    def test_where_no_turn_helps_q_stays_and_is_not_valid(self, dtype):
        assert self.moved(limited(1, 2), 0.5, dtype) == (0.5, False)

    def test_no_limit_keeps_everything(self):
        assert self.moved(limited(-np.inf, np.inf), 3.0) == (3.0, True)

    def test_one_infinite_limit_is_reached_by_turns(self):
        assert self.moved(limited(5, np.inf), 0.0) == (pytest.approx(2 * PI), True)
        assert self.moved(limited(-np.inf, -5), 0.0) == (pytest.approx(-2 * PI), True)

    def test_equal_limits_hold_one_value(self, dtype):
        value = float(np.asarray(0.7, dtype))
        assert self.moved(limited(0.7, 0.7), value, dtype) == (value, True)
        assert self.moved(limited(0.7, 0.7), 0.71, dtype)[1] is False

    def test_equal_limits_a_turn_away(self, dtype):
        q, valid = self.moved(limited(0.7 + 2 * PI, 0.7 + 2 * PI), float(np.asarray(0.7, dtype)), dtype)
        assert valid and q == pytest.approx(0.7 + 2 * PI, abs=32 * eps(dtype))

    def test_the_limit_itself_is_inside_and_a_bit_beyond_is_not(self, dtype):
        assert self.moved(limited(-1, 1), 1.0, dtype) == (1.0, True)
        assert self.moved(limited(-1, 1), 1 + 1e3 * eps(dtype), dtype)[1] is False

    def test_pi_counts_as_minus_pi(self, dtype):
        q, valid = self.moved(limited(-PI, 0), float(np.asarray(PI, dtype)), dtype)
        assert valid and q == pytest.approx(-PI, abs=16 * eps(dtype))

    def test_a_sliding_joint_is_not_turned(self):
        arm = limited(2, 8, kinds="PRRRRR")
        assert self.moved(arm, 1.0) == (1.0, False)
        assert self.moved(arm, 3.0) == (3.0, True)

    def test_one_joint_outside_clears_the_slot_but_not_its_neighbor(self):
        arm = limited(-1, 1)
        sol = ikjax.within_limits(arm, solutions([row(0.0), row(2.0)]))
        assert sol.valid.tolist() == [True, False]

    def test_it_never_makes_a_slot_valid(self):
        assert not ikjax.within_limits(limited(-1, 1), solutions([row(0.0)], [False])).valid.any()

    def test_jit_and_vmap_agree_and_the_gradient_is_one(self, rng):
        arm = ARM
        sol = solutions(rng.uniform(-PI, PI, (10, 8, 6)))

        def call(sol):
            return ikjax.within_limits(arm, sol)

        wanted = call(sol)
        assert 0 < wanted.valid.sum() < 80
        for other in (jax.jit(call), jax.vmap(call)):
            np.testing.assert_array_equal(other(sol).q, wanted.q)
            np.testing.assert_array_equal(other(sol).valid, wanted.valid)
        gradient = jax.grad(lambda q: call(dataclasses.replace(sol, q=q)).q.sum())(sol.q)
        np.testing.assert_array_equal(gradient, 1)


def test_a_choice_in_the_trace_of_solve_is_that_among_its_arrays():
    """There it is made before the joints are stacked, and one slot is differentiated instead of eight."""
    q = np.random.default_rng(3).uniform(-2.6, 2.6, (60, 6))
    goals, now = ikjax.fk(ARM, q), np.full(6, 0.4)

    def chosen(T, forgotten):
        sol = ikjax.solve(ARM, T)
        # A copy does not know where its joints come from.
        sol = dataclasses.replace(sol) if forgotten else sol
        q, found = ikjax.nearest(ARM, ikjax.within_limits(ARM, sol), now)
        return (jnp.where(found[:, None], jnp.sin(q), 0) @ np.arange(1.0, 7)).sum(), (q, found)

    gradient = jax.jit(jax.grad(chosen, has_aux=True), static_argnums=1)
    fast, (q, found) = gradient(goals, False)
    slow, (wanted, wanted_found) = gradient(goals, True)
    assert 10 < found.sum() < 60
    np.testing.assert_array_equal(found, wanted_found)
    np.testing.assert_allclose(q, wanted, atol=1e-9)
    assert np.abs(slow).max() > 1
    np.testing.assert_allclose(fast, slow, rtol=1e-7, atol=1e-7)
