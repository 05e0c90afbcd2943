"""The same set of answers as ssik and OPW find, wherever they solve the arm."""

import arm_patterns
import arms
import numpy as np
import peers
import pytest

import ikjax


def _case(name, count):
    arm = ikjax.robots.get(name).astype(np.float64)
    goals = arms.numpy_fk(arm, np.random.default_rng(6).uniform(-np.pi, np.pi, (count, 6)))
    return arm, goals, arms.solve_by_hand(arm, goals)


def _same(arm, sol, answers):
    """Each of our slots is an answer of theirs and the other way round; near a fold a double answer may
    be counted once or twice."""
    compared = 0
    for i, theirs in enumerate(answers):
        ours = sol.q[i][sol.valid[i]]
        if arm_patterns.sigma_min(arm, np.concatenate([ours, theirs])).min() < 1e-3:
            continue
        off = np.abs(arms.wrapped(ours[:, None] - theirs[None])).max(-1)
        assert off.min(1).max() < 1e-6, f"goal {i}: a slot that they do not have"
        assert off.min(0).max() < 1e-6, f"goal {i}: an answer of theirs that is no slot"
        compared += 1
    assert compared > 0.8 * len(answers)


@pytest.mark.parametrize("name", peers.SSIK)
def test_ssik_finds_the_same_set(name):
    module, base = peers.ssik(name), peers.ssik_base(name)
    arm, goals, sol = _case(name, 40)
    # Their tool frame may have any orientation.
    q = np.random.default_rng(1).uniform(-np.pi, np.pi, (4, 6))
    theirs, ours = np.stack([module.fk(row) for row in q]), base @ arms.numpy_fk(arm, q)
    tool = np.linalg.solve(ours[0], theirs[0])
    np.testing.assert_allclose(ours @ tool, theirs, atol=1e-9)
    answers = [
        np.array([found.q for found in module.solve(pose, respect_limits=False)], float).reshape(-1, 6)
        for pose in base @ goals @ tool
    ]
    _same(arm, sol, answers)


def test_opw_finds_the_same_set():
    package = pytest.importorskip("py_opw_kinematics")
    model = package.KinematicModel(
        a2=0.0203,
        b=-0.15005,
        c2=0.4318,
        c3=0.4318,
        offsets=(0, -np.pi / 2, np.pi / 2, 0, 0, 0),
        flip_axes=(False, True, True, False, True, False),
    )
    robot = package.Robot(model, degrees=False)
    arm, goals, sol = _case("puma560", 200)
    never = np.tile([10.0, 11.0], (6, 1))  # limits that leave their singular values out, not their joints
    joints = robot.reach(package.RigidTransform.from_matrix(goals), joint_limits=never, threads=1).joints
    _same(arm, sol, [rows[np.isfinite(rows).all(-1)] for rows in joints])
