import dataclasses
import importlib
import math

import jax
import numpy as np
import pytest

import ikjax

fk_and_frames = jax.jit(lambda arm, q: (ikjax.fk(arm, q), ikjax.frames(arm, q)))
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
HALF_TURN = np.diag([-1.0, -1, 1, 1])


def our_chain(arm, q):
    """fk and frames at (4, 6) joints; all arms share one program, because only their numbers differ."""
    arm = dataclasses.replace(arm, name="any", family=None, signs=(), branches=())
    return [np.asarray(poses) for poses in fk_and_frames(arm, np.broadcast_to(q, (4, 6)))]


def ssik_joints(name):
    """The joints of ssik's own model of an arm."""
    pytest.importorskip("ssik")
    module = importlib.import_module(f"ssik.prebuilt.{SSIK[name]}")
    return next(x for x in vars(module).values() if type(x).__name__ == "KinBody").joints


def turn(axis, angle):
    """Rodrigues' formula."""
    x, y, z = axis
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    T = np.eye(4)
    T[:3, :3] += math.sin(angle) * cross + (1 - math.cos(angle)) * cross @ cross
    return T


def their_chain(name, q):
    """Where ssik's tool stands, and each joint's axis with a point on it."""
    T, axes = HALF_TURN if name.startswith("ur") else np.eye(4), []
    for joint, angle in zip(ssik_joints(name), q, strict=True):
        T = T @ joint.T_left
        axes.append((T[:3, :3] @ joint.axis, T[:3, 3]))
        T = T @ turn(joint.axis, angle) @ joint.T_right
    return T, axes


def test_the_catalogue_is_listed_in_alphabetical_order():
    names = ikjax.robots.names()
    assert list(names) == sorted(names) and set(SSIK) < set(names)
    for name in names:
        assert ikjax.robots.get(name).name == name == getattr(ikjax.robots, name)().name


def test_an_unknown_robot_is_answered_with_the_list():
    with pytest.raises(
        ValueError, match="no robot 'puma'; the catalogue has elbow_manipulator, gx4_351s, irb120"
    ):
        ikjax.robots.get("puma")


@pytest.mark.parametrize("name", SSIK)
def test_joints_turn_about_the_same_lines_as_in_ssik(name, rng):
    q = rng.uniform(-math.pi, math.pi, (4, 6))
    for joints, ours in zip(q, our_chain(ikjax.robots.get(name), q)[1], strict=True):
        for frame, (axis, point) in zip(ours, their_chain(name, joints)[1], strict=False):
            np.testing.assert_allclose(frame[:3, 2], axis, atol=1e-9)
            np.testing.assert_allclose(np.cross(axis, frame[:3, 3] - point), 0, atol=1e-9)


@pytest.mark.parametrize("name", SSIK)
def test_the_tool_stands_where_ssik_says_up_to_a_fixed_turn(name, rng):
    q = rng.uniform(-math.pi, math.pi, (4, 6))
    ours = our_chain(ikjax.robots.get(name), q)[0]
    theirs = np.array([their_chain(name, joints)[0] for joints in q])
    fixed = np.linalg.inv(ours[0]) @ theirs[0]
    np.testing.assert_allclose(fixed[:3, 3], 0, atol=1e-9)
    np.testing.assert_allclose(ours @ fixed, theirs, atol=1e-9)


@pytest.mark.parametrize("name", [name for name in SSIK if name != "puma560" and name[:2] != "ur"])
def test_joint_limits_are_those_in_ssik(name):
    # ssik's PUMA has no limits of its own, and its UR arms keep the elbow to half a turn.
    wanted = [joint.limits for joint in ssik_joints(name)]
    np.testing.assert_allclose(ikjax.robots.get(name).limits, wanted, atol=1e-4)


def test_the_irb2400_stands_upright_with_its_forearm_level():
    # x = 0.100 + 0.755 + 0.085, z = 0.615 + 0.705 + 0.135.
    T = our_chain(ikjax.robots.irb2400(), np.zeros(6))[0][0]
    np.testing.assert_allclose(T[:3, 3], [0.94, 0, 1.455], atol=1e-12)
    np.testing.assert_allclose(T[:3, 2], [1, 0, 0], atol=1e-12)


QUARTER = math.pi / 2
PUMA_POSES = {
    "zero": ((0, 0, 0, 0, 0, 0), (0.4521, -0.15005, 0.4318)),
    "ready": ((0, QUARTER, -QUARTER, 0, 0, 0), (0.0203, -0.15005, 0.8636)),
    "stretch": ((0, 0, -QUARTER, 0, 0, 0), (0.8636, -0.15005, -0.0203)),
}


@pytest.mark.parametrize("pose", PUMA_POSES)
def test_the_puma_stands_where_the_textbook_puts_it(pose):
    q, wanted = PUMA_POSES[pose]
    T = our_chain(ikjax.robots.puma560(), np.array(q, float))[0][0]
    np.testing.assert_allclose(T[:3, 3], wanted, atol=1e-15)


def test_the_elbow_manipulator_has_free_lengths():
    T = our_chain(ikjax.robots.elbow_manipulator(0.5, 0.25, 0.125), np.zeros(6))[0][0]
    np.testing.assert_allclose(T[:3, 3], [0.875, 0, 0], atol=1e-15)
