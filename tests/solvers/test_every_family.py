"""Every family over its whole class: what made the goal is found, and what is found is right."""

import arms
import every
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import ikjax

TYPES = (np.float64, np.float32)
FAMILY = {
    "wrist": "pieper",
    "point": "position",
    "SCARA": "scara",
    "turret": "turret",
    "wrist first": "pieper_reversed",
    "skew wrist": "pieper",
}


def family(name: str) -> str:
    for part in ("wrist first", "skew wrist", "SCARA", "turret"):
        if part in name:
            return FAMILY[part]
    if "parallel" in name and "," in name and name[0] in "1234":
        return "parallel_axes"
    if name.endswith(("wrist", "point")):
        return FAMILY[name[-5:]]
    return "planar_position" if len(every.TABLE[name]["kinds"]) == 2 else "planar_pose"


def _promised(arm, goals, dtype):
    """How far a valid slot may be off: what `valid` promises, and the rounding of its joints."""
    tolerance = arms.TOLERANCE[np.dtype(dtype).name] + 40 * np.finfo(dtype).eps
    return tolerance, tolerance * (arms.reach(arm) + np.linalg.norm(goals[..., :3, 3], axis=-1))[:, None]


def _wrong(arm, sol, goals, dtype):
    rounded = goals.astype(dtype).astype(float)
    gap, turn = every.errors(arm, sol.q, rounded[:, None])
    angle, length = _promised(arm, rounded, dtype)
    # Slides may be long: their rounding counts over what they span.
    spread = 8 * np.finfo(dtype).eps * np.abs(sol.q).max(-1)
    return sol.valid & ((gap > length + spread) | (turn > angle))


@pytest.mark.parametrize("name", every.NAMES)
def test_the_family_is_recognised(name):
    arm = every.build(name)
    assert arm.family == family(name)
    assert len(set(arm.branches)) == len(arm.branches) >= 1
    assert "NO" not in ikjax.explain(arm)


@pytest.mark.parametrize("dtype", TYPES)
@pytest.mark.parametrize("name", every.NAMES)
def test_the_joints_that_made_the_goal_are_found_and_nothing_is_wrong(name, dtype):
    arm = every.build(name)
    q = every.joints(arm, 400)
    goals = arms.numpy_fk(arm, q)
    sol = arms.solve_by_hand(arm, goals, dtype=dtype)
    assert sol.q.shape == (400, len(arm.branches), arm.n)
    for field in ("q", "margin", "position_error", "rotation_error"):
        assert np.isfinite(getattr(sol, field)).all(), field
    assert not _wrong(arm, sol, goals, dtype).any()
    off = np.abs(sol.q - q[:, None])
    off = np.where([kind == "R" for kind in arm.kinds], np.abs(arms.wrapped(off)), off).max(-1)
    near = np.where(sol.valid, off, np.inf).min(-1)
    least = every.sigma_min(arm, q)
    if dtype == np.float64:
        assert sol.valid.any(-1).all()
        # The pose is right to the tolerance, and joints to that over the least singular value.
        assert (near[least > 1e-4] <= np.minimum(1e-8 / least, 1e-3)[least > 1e-4]).all()
    else:
        assert sol.valid.any(-1).mean() > 0.985
        assert (near[least >= np.median(least)] < 0.02).mean() > 0.98


@pytest.mark.parametrize("dtype", TYPES)
@pytest.mark.parametrize("name", every.NAMES)
def test_joints_at_right_angles_leave_everything_finite_and_nothing_wrong(name, dtype):
    arm = every.build(name)
    rng = np.random.default_rng(7)
    turning = np.array([kind == "R" for kind in arm.kinds])
    quarter = rng.integers(-1, 3, (64, arm.n)) * np.pi / 2
    q = np.where(turning, quarter - arms.leaves(arm)["theta"], rng.integers(-1, 2, (64, arm.n)) * 0.2)
    goals = arms.numpy_fk(arm, q)
    sol = arms.solve_by_hand(arm, goals, dtype=dtype)
    for field in ("q", "margin", "position_error", "rotation_error"):
        assert np.isfinite(getattr(sol, field)).all(), field
    assert not _wrong(arm, sol, goals, dtype).any()


COMPILED = ("RRR, wrist", "RRP meet, wrist", "2, 3, 4 parallel", "SCARA RRPR", "3R", "RRR, point")


@pytest.mark.parametrize("name", COMPILED)
def test_the_front_door_masks_and_joints_agree(name):
    arm = every.build(name)
    q = every.joints(arm, 200, seed=1)
    goals = arms.numpy_fk(arm, q)
    eager = ikjax.solve(arm, goals)
    assert eager.valid.any(-1).all()
    assert not _wrong(arm, jax.tree.map(np.asarray, eager), goals, np.float64).any()
    traced = jax.jit(lambda T: vars(ikjax.solve(arm, T)))(jnp.asarray(goals))
    sol = ikjax.Solutions(**{k: np.asarray(v) for k, v in traced.items()})
    assert sol.valid.any(-1).all()
    assert not _wrong(arm, sol, goals, np.float64).any()


@pytest.mark.parametrize("name", ("RRR, point", "3R", "2R"))
def test_what_the_task_leaves_out_is_not_looked_at(name):
    arm = every.build(name)
    q = every.joints(arm, 20)
    goals = arms.numpy_fk(arm, q)
    sol = arms.solve_by_hand(arm, goals)
    changed = goals.copy()
    turn = arms.numpy_pose([0, 0, 0], [0.3, -0.2, 0.4])[:3, :3]
    if arm.task == "planar_pose":
        changed[:, :3, 3] += 0.3 * every.plane_normal(arm)
    else:
        changed[:, :3, :3] = turn @ goals[:, :3, :3]
    again = arms.solve_by_hand(arm, changed)
    np.testing.assert_array_equal(sol.valid, again.valid)
    np.testing.assert_allclose(sol.q, again.q, atol=1e-9)
