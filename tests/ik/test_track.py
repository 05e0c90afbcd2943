"""A path followed on one branch: steps, jumps, and goals that are no poses."""

import dataclasses

import jax.numpy as jnp
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


def test_turns_are_counted_on_within_the_limits_and_unwound_beyond_them():
    """A tool that turns on and on, seen from a joint that may turn twice."""
    arm = ikjax.robots.planar_3r()
    turn = 2 * np.pi
    arm = dataclasses.replace(arm, limits=jnp.asarray([[-3, 3], [-3, 3], [-1.0, 1.2 * turn]]))
    q0 = np.array([0.4, 0.9, 0.2])
    goals = np.array(ikjax.fk(arm, q0 + np.linspace(0, 1.1 * turn, 40)[:, None] * [0, 0, 1]))
    path = ikjax.track(arm, goals, q0)
    assert path.reached.all() and path.followed.all()
    np.testing.assert_allclose(path.q[-1], [0.4, 0.9, 0.2 + 1.1 * turn], atol=1e-7)
    # Each goal alone, from where the path ended: the turn is kept, not given back.
    stays = ikjax.track(arm, goals[-1:], path.q[-1])
    np.testing.assert_allclose(stays.q[0], path.q[-1], atol=1e-7)
    tight = dataclasses.replace(arm, limits=jnp.asarray([[-3, 3], [-3, 3], [-1.0, 6.0]]))
    path = ikjax.track(tight, goals, q0)
    assert path.reached.mean() > 0.9 and path.jumped.sum() == 1
    assert (np.asarray(path.q)[:, 2] <= 6).all() and (np.asarray(path.q)[:, 2] >= -1).all()


def test_typed_goals_are_followed_and_goals_that_are_no_poses_waited_out():
    arm = ikjax.robots.planar_3r()
    q = np.array([0.4, 0.9, 0.2]) + np.linspace(0, 0.5, 5)[:, None]
    goals = np.array(ikjax.fk(arm, q))
    goals[:, :3, :3] = goals[:, :3, :3].round(3)
    goals[2, :3, :3] = np.diag([1, 1, -1])
    path = ikjax.track(arm, goals, q[0])
    lost = np.arange(5) == 2
    np.testing.assert_array_equal(path.reached, ~lost)
    assert (np.asarray(path.goal_error)[~lost] < 5e-3).all() and np.isinf(path.goal_error[2])
    for field in ("cost", "position_error", "rotation_error"):
        np.testing.assert_array_equal(np.isnan(getattr(path, field)), lost)
    np.testing.assert_array_equal(path.q[2], path.q[1])
    np.testing.assert_allclose(path.q[~lost], q[~lost], atol=5e-3)


def test_an_arm_of_no_family_raises_by_name():
    arm = dataclasses.replace(ARM, family=None)
    with pytest.raises(ValueError, match="motoman_l3 has no closed form"):
        ikjax.track(arm, np.tile(np.eye(4), (3, 1, 1)), np.zeros(5))
