"""A path followed on one branch: steps, jumps, and goals that are no poses."""

import dataclasses

import numpy as np
import pytest

import ikjax

ARM = ikjax.robots.get("motoman_l3")
T = 40


def path():
    """Joints that move evenly, and where the tool then stands."""
    start, end = np.array([0.3, -0.9, 1.2, 0.4, -0.5]), np.array([1.1, -0.4, 0.7, -0.3, 2.9])
    q = start + np.linspace(0, 1, T)[:, None] * (end - start)
    return q, np.array(ikjax.fk(ARM, q))


@pytest.mark.slow
def test_an_attainable_path_is_followed_on_its_branch_and_a_bad_goal_is_waited_out():
    q, goals = path()
    found = ikjax.track(ARM, goals, q[0])
    np.testing.assert_allclose(found.q, q, atol=1e-7)
    assert found.followed.all() and found.reached.all() and not found.jumped.any()
    bad = goals.copy()
    bad[5] = np.nan
    waited = ikjax.track(ARM, bad, q[0])
    assert not (waited.followed[5] or waited.jumped[5] or waited.reached[5])
    np.testing.assert_array_equal(waited.q[5], waited.q[4])
    np.testing.assert_allclose(waited.q[6:], q[6:], atol=1e-7)
    # From another branch the path is followed on that one.
    first = np.array(ikjax.solve(ARM, goals[0]).q)
    other = first[np.argmax(np.abs(first - q[0]).max(-1))]
    found = ikjax.track(ARM, goals, other)
    assert found.reached.all() and found.followed.all()
    assert np.abs(found.q - q).max(-1).min() > 0.1
    # A leap of the goal is a jump; what comes after it is followed again.
    far = np.concatenate([goals[:5], goals[30:35], np.repeat(goals[34:35], 30, 0)])
    found = ikjax.track(ARM, far, q[0])
    assert found.jumped[5] and found.jumped.sum() == 1 and found.reached.all()


@pytest.mark.parametrize("shape", [(4, 4), (7,)])
def test_a_path_of_another_shape_raises(shape):
    with pytest.raises(ValueError, match="goals must have shape"):
        ikjax.track(ARM, np.zeros(shape), np.zeros(5))


def test_an_arm_of_no_family_raises_by_name():
    arm = dataclasses.replace(ARM, family=None)
    with pytest.raises(ValueError, match="motoman_l3 has no closed form"):
        ikjax.track(arm, np.tile(np.eye(4), (3, 1, 1)), np.zeros(5))
