"""Five joints, one of them at a limit: the joints that made such a goal are among the starts."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import ikjax
from ikjax.ik.multistart import branches_and_limits

KATANA = ikjax.robots.katana_6m180()
LIMITED_L3 = dataclasses.replace(ikjax.robots.motoman_l3(), limits=jnp.array([[-2.0, 1.5]] * 5))
BENT = ikjax.Arm.from_dh(
    **{
        "a": [0.05, -0.3, 0.25, 0.04, 0],
        "alpha": [1.2, np.pi, 0, -1.1, 0],
        "d": [0.3, 0.03, -0.02, 0.05, 0.1],
    },
    **{
        "theta": [0.3, -1, 0.7, 2, 0.1],
        "limits": [(-2.5, 2.7), (-1.2, 2), (-2.2, 2.1), (-2, 1.8), (-2.9, 2.8)],
    },
    convention="standard",
)


def made(arm, joint: int, end: int, count: int = 40):
    low, high = np.array(arm.limits).T
    q = np.random.default_rng(joint).uniform(low, high, (count, 5))
    q[:, joint] = (low, high)[end][joint]
    return q, ikjax.fk(arm, q)


@pytest.mark.slow
@pytest.mark.parametrize("arm", [KATANA, LIMITED_L3, BENT], ids=["katana", "l3", "bent"])
def test_joints_that_made_a_goal_with_one_at_a_limit_are_among_the_starts(arm):
    cases = [made(arm, joint, end) for joint in (1, 3) for end in (0, 1)]
    q, goals = (np.concatenate(x) for x in zip(*cases, strict=True))
    starts = np.array(branches_and_limits(arm, goals)[..., 4:, :])
    assert starts.shape == (len(q), 36, 5) and np.isfinite(starts).all()
    off = np.abs((starts[:, :16] - q[:, None] + np.pi) % (2 * np.pi) - np.pi).max(-1).min(-1)
    # With joint 2 locked, the L-3's hand has no length in the plane: its pitch is its own.
    known = slice(80, None) if arm is LIMITED_L3 else slice(None)
    assert np.median(off[known]) < 1e-9 and off[known].max() < 1e-5
    # The last joint stands at the end that the joints of the twin are further from.
    low, high = np.array(arm.limits)[4]
    assert np.isin(starts[:, 16:, 4], [low, high]).all()
    turned = (starts[:, :16, 4] - (low + high) / 2 + np.pi) % (2 * np.pi) - np.pi
    np.testing.assert_array_equal(starts[:, 20:, 4], np.where(turned < 0, high, low))


@pytest.mark.slow
def test_limits_may_be_missing_and_traced():
    arm = dataclasses.replace(BENT, limits=BENT.limits.at[1].set(jnp.array([-jnp.inf, jnp.inf])))
    _, goals = made(BENT, 3, 0, 3)
    starts = branches_and_limits(arm, goals)[..., 4:, :]
    assert jnp.isfinite(starts).all()
    traced = jax.jit(lambda arm, goals: branches_and_limits(arm, goals)[..., 4:, :])(arm, goals)
    np.testing.assert_allclose(np.sin(starts), np.sin(traced), atol=1e-9)


@pytest.mark.slow
def test_a_point_that_is_attained_within_limits_is_attained_by_a_start():
    """By the branches alone, put on their limits, it was three goals in four."""
    arm = ikjax.robots.vx300()
    low, high = np.array(arm.limits).T
    goals = np.array(ikjax.fk(arm, np.random.default_rng(0).uniform(low, high, (500, 5))))
    goals[:, :3, :3] = ikjax.maps.even_rotations(500)
    starts = branches_and_limits(arm, goals)[..., 4:, :]
    attained = ikjax.pose_error(ikjax.fk(arm, into_limits(arm, starts)), goals[:, None])[0].min(-1)
    branches = ikjax.project(arm, goals, steps=0).branches.position_error.min(-1)
    assert 0.6 < (branches < 1e-9).mean() < 0.9
    assert np.minimum(branches, attained).max() < 1e-9


def into_limits(arm, q):
    """By whole turns, else to the nearer limit."""
    low, high = np.array(arm.limits).T
    return np.clip(q - 2 * np.pi * np.round((np.array(q) - (low + high) / 2) / (2 * np.pi)), low, high)
