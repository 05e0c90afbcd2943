"""Arms with a redundant joint are placed and designed by the best of some of its values."""

from dataclasses import replace

import numpy as np
import pytest

import ikjax
from ikjax.ik.redundancy import middles, solve_at_samples

SAMPLES = 6


def far_goals(arm, count, seed=0):
    """Goals that the arm reaches far out, by joints within its limits."""
    low, high = np.asarray(arm.limits).T
    q = np.random.default_rng(seed).uniform(low, high, (4000, 7))
    goals = np.asarray(ikjax.fk(arm, q))
    far = np.linalg.norm(goals[:, :3, 3] - (0, 0, 0.333), axis=-1)
    return goals[np.argsort(-far)[:count]]


def with_upper_arm(length):
    arm = ikjax.robots.fer()
    table = {key: np.array(getattr(arm, key)) for key in ("a", "alpha", "d", "theta")}
    table["d"][2] = length
    return ikjax.Arm.from_dh(
        **table, base=arm.base, tool=arm.tool, limits=arm.limits, convention="standard", name="longer"
    )


def within_by_hand(arm, goals, samples=SAMPLES):
    """Which goals some branch reaches at some value, within the limits."""
    low, high = np.asarray(arm.limits)[6]
    values = low + (high - low) * (np.arange(samples) + 0.5) / samples
    sol = ikjax.solve(arm, goals[:, None], redundancy=values)
    return np.asarray(ikjax.within_limits(arm, sol).valid).any((1, 2))


def test_slots_of_all_values_are_side_by_side():
    arm = ikjax.robots.fer()
    goals = far_goals(arm, 6).reshape(2, 3, 4, 4)
    sol = solve_at_samples(arm, goals, 2)
    values = middles(arm.baked(), 2, np.float64)[:, 0]
    assert sol.q.shape == (2, 3, 16, 7) and sol.valid.shape == (2, 3, 16) and sol.is_pose.shape == (2, 3)
    apart = ikjax.solve(arm, goals[:, :, None], redundancy=values)
    for name in ("q", "valid", "margin"):
        both = np.asarray(getattr(apart, name))
        np.testing.assert_array_equal(getattr(sol, name)[:, :, 8:], both[:, :, 1])


@pytest.mark.slow
def test_a_franka_is_made_longer_until_it_reaches():
    longer, arm = with_upper_arm(0.416), ikjax.robots.fer()
    np.testing.assert_allclose(with_upper_arm(0.316).d, arm.d)
    goals = far_goals(longer, 24)
    before = within_by_hand(arm, goals, 64).mean()
    found = ikjax.design(
        arm, goals, {"d3": (0.2, 0.5)}, starts=2, steps=60, redundancy_samples=SAMPLES, batch=None
    )
    assert found.start_score <= before < 0.2 and found.score > before + 0.4
    np.testing.assert_array_equal(found.reached, within_by_hand(found.arm, goals))
    assert found.score == pytest.approx(found.reached.mean())
    assert found.arm.family == arm.family and found.arm.locked == (6,) and found.values["d3"] > 0.36
    # The ascent moved the given arm itself, by derivatives alone.
    assert found.numbers[0] > arm.d[2] + 0.03 and found.scores[0] > found.start_score + 0.2


@pytest.mark.slow
def test_a_franka_is_placed_where_it_reaches_most():
    arm = ikjax.robots.fer()
    goals = far_goals(arm, 16, seed=1)
    shift = np.array([0.9, -0.4, 0])
    goals[:, :3, 3] += shift
    options = {"spacing": 0.3, "turns": 1, "starts": 2, "steps": 10, "keep": 2}
    found = ikjax.place(arm, goals, redundancy_samples=SAMPLES, **options)
    for base, reached in zip(found.base, found.reached, strict=True):
        np.testing.assert_array_equal(reached, within_by_hand(replace(arm, base=base), goals))
    there = replace(arm, base=ikjax.pose(xyz=shift))
    assert found.share[0] >= within_by_hand(there, goals).mean() > within_by_hand(arm, goals).mean()
    # Candidates are counted at all values too.
    at = np.unravel_index(np.argmax(found.tried), found.tried.shape)
    there = replace(arm, base=ikjax.pose(xyz=found.grid.points()[at[:3]]))
    assert found.tried[at] == within_by_hand(there, goals).mean() > 0.3


def test_values_of_an_arm_without_redundant_joints_are_refused():
    arm = ikjax.robots.puma560()
    for call in (
        ikjax.place,
        lambda arm, goals, **some: ikjax.design(arm, goals, {"a2": (0.3, 0.5)}, **some),
    ):
        with pytest.raises(ValueError, match="for arms with redundant joints, puma560 has none"):
            call(arm, np.eye(4), redundancy_samples=4)
