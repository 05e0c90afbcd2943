"""The self-motion of a goal: its parts within the limits, and the nearest posture on it."""

import functools

import jax
import numpy as np
import pytest

import ikjax

Q = np.array([0.2, -0.4, 0.1, -1.9, 0.3, 1.8, 0.5])


@functools.cache
def fer():
    return ikjax.robots.fer()


@functools.cache
def motion():
    """Of a reachable goal, of one that is no pose, and of one out of reach."""
    goals = np.array(ikjax.fk(fer(), np.stack([Q, Q, Q])))
    goals[1, 0, 0], goals[2, 0, 3] = np.nan, 3.0
    return goals, ikjax.self_motion(fer(), goals)


@pytest.mark.slow
def test_the_samples_are_those_of_solve():
    goals, curve = motion()
    assert curve.q.shape == (3, 8, 64, 7) and curve.parts.shape == (3, 8, 4, 2)
    np.testing.assert_allclose(np.asarray(curve.redundancy)[[0, -1]], fer().limits[6])
    sol = ikjax.solve(fer(), goals[0], redundancy=curve.redundancy)
    np.testing.assert_array_equal(curve.valid[0].T, sol.valid)
    np.testing.assert_array_equal(curve.within[0].T, ikjax.within_limits(fer(), sol).valid)
    low, high = np.asarray(fer().limits).T
    inside = np.asarray(curve.q)[np.asarray(curve.within)]
    assert (inside >= low - 1e-12).all() and (inside <= high + 1e-12).all()


@pytest.mark.slow
def test_parts_are_where_dense_samples_are_within_the_limits():
    goals, curve = motion()
    dense = np.linspace(*np.asarray(fer().limits[6]), 20_001)
    within = np.asarray(ikjax.within_limits(fer(), ikjax.solve(fer(), goals[0], redundancy=dense)).valid)
    parts = np.asarray(curve.parts[0])
    covered = (dense >= parts[..., :1] - 1e-9) & (dense <= parts[..., 1:] + 1e-9)
    covered = (covered & np.asarray(curve.is_part[0])[..., None]).any(1)
    np.testing.assert_array_equal(covered.T, within)
    # One of them lies between two samples.
    widths = (parts[..., 1] - parts[..., 0])[np.asarray(curve.is_part[0])]
    assert widths.min() < 0.01 < 0.09 < curve.redundancy[1] - curve.redundancy[0]


@pytest.mark.slow
def test_an_end_is_where_the_flag_changes_to_a_billionth():
    goals, curve = motion()
    parts, is_part = np.asarray(curve.parts[0]), np.asarray(curve.is_part[0])
    step = np.array([-2e-9, 0])
    for side, outward in ((0, step), (1, -step)):
        ends = parts[..., side]
        sol = ikjax.solve(fer(), goals[0], redundancy=ends[..., None] + outward)
        # The tolerance of `valid` reaches a little beyond a fold.
        flags = np.asarray(ikjax.within_limits(fer(), sol).valid & (sol.margin >= 0))
        for slot in range(8):
            mine = flags[slot, :, :, slot][is_part[slot]]
            assert mine[:, 1].all() and not mine[:, 0].any()


@pytest.mark.slow
def test_goals_without_postures_have_no_parts_and_finite_numbers():
    _, curve = motion()
    assert curve.is_part[0].any() and not curve.is_part[1:].any() and not curve.within[1:].any()
    for field in ("q", "margin", "parts"):
        assert np.isfinite(getattr(curve, field)).all()
    assert "goal 0, slot 2: within the limits on [-0.132013, 1.58198]" in str(curve)
    assert "goal 1, slot 0: within the limits on nowhere" in str(curve)


@pytest.mark.slow
def test_it_is_the_same_under_jit():
    goals, curve = motion()
    jitted = jax.jit(lambda goals: ikjax.self_motion(fer(), goals))(goals)
    np.testing.assert_array_equal(jitted.is_part, curve.is_part)
    np.testing.assert_allclose(jitted.parts, curve.parts, atol=1e-8)


def nearest_of_dense_samples(goals, now, samples=512):
    """The largest joint move of the best of so many values."""
    dense = np.linspace(*np.asarray(fer().limits)[6], samples)
    inside = ikjax.within_limits(fer(), ikjax.solve(fer(), goals[:, None], redundancy=dense))
    best, some = ikjax.nearest(fer(), inside, now[:, None])
    return np.where(some, np.abs(np.asarray(best) - now[:, None]).max(-1), np.inf).min(-1)


@pytest.mark.slow
def test_the_nearest_of_1000_postures_is_never_farther_than_that_of_dense_samples():
    low, high = np.asarray(fer().limits).T
    made, now = np.random.default_rng(7).uniform(low, high, (2, 1000, 7))
    goals = np.asarray(ikjax.fk(fer(), made))
    q, found = ikjax.nearest_on_self_motion(fer(), goals, now)
    moves = np.abs(np.asarray(q) - now).max(-1)
    dense = [nearest_of_dense_samples(goals[k : k + 100], now[k : k + 100]) for k in range(0, 1000, 100)]
    off = moves - np.concatenate(dense)
    assert found.all() and (off > 1e-6).sum() == 0 and (off < -1e-3).mean() > 0.5


@pytest.mark.slow
def test_the_nearest_posture_is_as_near_as_that_of_dense_samples():
    low, high = np.asarray(fer().limits).T
    rng = np.random.default_rng(0)
    made, now = rng.uniform(low, high, (2, 24, 7))
    made[0], now[0] = Q, Q
    goals = np.array(ikjax.fk(fer(), made))
    goals[1, 0, 3] = 3.0
    q, found = ikjax.nearest_on_self_motion(fer(), goals, now)
    reached = np.arange(24) != 1
    np.testing.assert_array_equal(found, reached)
    np.testing.assert_array_equal(q[1], now[1])
    np.testing.assert_allclose(q[0], Q, atol=1e-9)
    q = np.asarray(q)
    np.testing.assert_allclose(ikjax.fk(fer(), q)[reached], goals[reached], atol=1e-8)
    assert (q[reached] >= low - 1e-12).all() and (q[reached] <= high + 1e-12).all()
    off = (np.abs(q - now).max(-1) - nearest_of_dense_samples(goals, now))[reached]
    assert off.max() < 1e-6 and off.min() < -1e-3


@pytest.mark.parametrize(
    ("call", "text"),
    [
        (lambda: ikjax.self_motion(ikjax.robots.puma560(), np.eye(4)), "one redundant joint, puma560 has 0"),
        (lambda: ikjax.self_motion(fer(), np.eye(4), samples=2), "samples must be a whole number, 3 or more"),
        (lambda: ikjax.self_motion(fer(), np.eye(4), parts=0), "parts must be 1 or more"),
        (
            lambda: ikjax.nearest_on_self_motion(fer(), np.eye(4), np.zeros(6)),
            r"q_now must have shape \(..., 7\)",
        ),
        (
            lambda: ikjax.nearest_on_self_motion(fer(), np.eye(4), Q, [1, 2]),
            r"weights must have shape \(7,\)",
        ),
    ],
)
def test_mistakes_are_named(call, text):
    with pytest.raises(ValueError, match=text):
        call()
