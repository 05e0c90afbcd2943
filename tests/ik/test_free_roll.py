"""Intervals of rolls: what lies in them is reached, what does not is not, and their ends are ends."""

import dataclasses

import numpy as np
import pytest

import ikjax

PUMA = ikjax.robots.puma560()
ARM = dataclasses.replace(PUMA, limits=np.array(PUMA.limits) * np.array([1, 1, 1, 0.6, 1, 0.3])[:, None])
GOALS = [
    ikjax.pose((0.5, 0.1, 0.2), rpy=(np.pi, 0, 0.3)),
    ikjax.pose((0.3, -0.4, 0.1), rpy=(2.6, 0.3, 0)),
    ikjax.pose((3.0, 0, 0), rpy=(np.pi, 0, 0)),
]


def hit(goal, angles, arm=ARM):
    """Whether the goal is reached within limits at angles (m,), by `solve`."""
    zero = np.zeros_like(angles)
    angles = angles % (2 * np.pi)
    rolled = np.asarray(goal) @ np.asarray(ikjax.pose(rpy=np.stack([zero, zero, angles], -1)))
    return np.asarray(ikjax.within_limits(arm, ikjax.solve(arm, rolled)).valid).any(-1)


@pytest.fixture(scope="module")
def found():
    return ikjax.free_roll(ARM, np.stack(GOALS), 360)


def test_intervals_end_where_solve_says_so(found):
    partly = 0
    for goal, intervals in zip(GOALS, found.intervals, strict=True):
        fine = (np.arange(512) + 0.5) * 2 * np.pi / 512
        inside = np.zeros(512, bool)
        for first, last in intervals:
            inside |= ((fine - first) % (2 * np.pi)) <= last - first
        np.testing.assert_array_equal(hit(goal, fine), inside)
        if 0 < inside.sum() < 512:
            partly += 1
            ends = np.concatenate([intervals[:, 0], intervals[:, 1]])
            outwards = np.repeat([-1.0, 1.0], len(intervals))
            assert hit(goal, ends).all() and not hit(goal, ends + 1e-8 * outwards).any()
    assert partly >= 1
    assert len(found.intervals[2]) == 0 and found.share[2] == 0


def test_one_goal_gives_its_own_and_all_rolls_are_one_interval(found):
    one = ikjax.free_roll(ARM, GOALS[0], 360)
    np.testing.assert_allclose(one.intervals, found.intervals[0])
    assert one.reached.shape == (360,) and float(one.share) == pytest.approx(found.share[0])
    everywhere = ikjax.free_roll(ARM, GOALS[0], 48, limits=False)
    np.testing.assert_allclose(everywhere.intervals, [[0, 2 * np.pi]])
    assert "0.0 to 360.0 deg" in repr(everywhere) and "2 of 3" in repr(found)


@pytest.mark.slow
def test_float32_ends_where_float64_does(found):
    rough = ikjax.free_roll(ARM, np.stack(GOALS).astype(np.float32), 360)
    for one, other in zip(rough.intervals, found.intervals, strict=True):
        np.testing.assert_allclose(one, other, atol=2e-3)


def test_what_is_no_goal_or_no_number_is_refused():
    with pytest.raises(ValueError, match="n must be a whole number, at least 2"):
        ikjax.free_roll(ARM, GOALS[0], 1)
    with pytest.raises(ValueError, match="finite"):
        ikjax.free_roll(ARM, np.full((4, 4), np.nan))
