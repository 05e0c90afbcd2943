"""The same set of answers as ssik and OPW find, wherever they solve the arm."""

import importlib

import arms
import every
import numpy as np
import pytest

import ikjax

SSIK = {
    "irb120": "abb.irb120_ik",
    "kr6_r900": "kuka.kr6_r900_ik",
    "lrmate200id": "fanuc.lrmate200id_ik",
    "rx160": "staubli.rx160_ik",
    "puma560": "unimation.puma560_ik",
    "ur3e": "universal_robots.ur3e_ik",
    "ur5": "universal_robots.ur5_ik",
    "ur5e": "universal_robots.ur5e_ik",
    "ur10e": "universal_robots.ur10e_ik",
}


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
        if every.sigma_min(arm, np.concatenate([ours, theirs])).min() < 1e-3:
            continue
        off = np.abs(arms.wrapped(ours[:, None] - theirs[None])).max(-1)
        assert off.min(1).max() < 1e-6, f"goal {i}: a slot that they do not have"
        assert off.min(0).max() < 1e-6, f"goal {i}: an answer of theirs that is no slot"
        compared += 1
    assert compared > 0.8 * len(answers)


@pytest.mark.parametrize("name", SSIK)
def test_ssik_finds_the_same_set(name):
    pytest.importorskip("ssik")
    module = importlib.import_module(f"ssik.prebuilt.{SSIK[name]}")
    arm, goals, sol = _case(name, 40)
    # Their base may be half a turn off, and their tool anyhow.
    q = np.random.default_rng(1).uniform(-np.pi, np.pi, (4, 6))
    theirs, ours = np.stack([module.fk(row) for row in q]), arms.numpy_fk(arm, q)
    for base in (np.eye(4), np.diag([-1.0, -1, 1, 1])):
        tool = np.linalg.solve(base @ ours[0], theirs[0])
        if np.abs(base @ ours @ tool - theirs).max() < 1e-9:
            break
    np.testing.assert_allclose(base @ ours @ tool, theirs, atol=1e-9)
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
