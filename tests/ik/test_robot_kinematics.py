"""The interface of LeRobot's kinematics: degrees, the gripper kept, a path followed without jumps."""

import inspect
import time

import numpy as np
import pytest

import ikjax

NAMES = [f"joint{i}" for i in range(1, 6)]


@pytest.fixture(scope="module")
def follower():
    return ikjax.RobotKinematics(ikjax.robots.so101(), joint_names=[*NAMES, "gripper"])


def recorded(steps=300):
    """Joints [deg] of an SO-101 and its gripper over six seconds at 50 Hz: sums of sines, as a hand moves."""
    t = np.arange(steps)[:, None] / 50
    rates = np.array([0.9, 0.7, 1.1, 1.3, 0.5, 0.3])
    size = np.array([35.0, 20.0, 25.0, 30.0, 40.0, 20.0])
    middle = np.array([0.0, -30.0, 40.0, 20.0, 10.0, 30.0])
    return middle + size * np.sin(rates * t) + 0.2 * size * np.sin(3.1 * rates * t + 1)


def test_the_interface_is_that_of_lerobot():
    signature = inspect.signature(ikjax.RobotKinematics.__init__)
    assert list(signature.parameters) == ["self", "urdf_path", "target_frame_name", "joint_names"]
    assert signature.parameters["target_frame_name"].default == "gripper_frame_link"
    asked = inspect.signature(ikjax.RobotKinematics.inverse_kinematics).parameters
    assert list(asked) == [
        *("self", "current_joint_pos", "desired_ee_pose", "position_weight", "orientation_weight")
    ]
    assert (asked["position_weight"].default, asked["orientation_weight"].default) == (1.0, 0.01)


def test_a_recorded_path_is_followed_at_fifty_hertz_without_jumps(follower):
    path = recorded()
    goals = [follower.forward_kinematics(q) for q in path]
    action = path[0].copy()
    follower.inverse_kinematics(action, goals[0])
    followed, times = [], []
    for goal, gripper in zip(goals, path[:, 5], strict=True):
        action[5] = gripper
        start = time.perf_counter()
        action = follower.inverse_kinematics(action, goal)
        times.append(time.perf_counter() - start)
        followed.append(action.copy())
    # Its own joints are an answer of each goal, and the nearest one: the path is found again.
    np.testing.assert_allclose(followed, path, atol=0.05)
    assert np.abs(np.diff(followed, axis=0)).max() < 1.5 * np.abs(np.diff(path, axis=0)).max() + 0.05
    assert np.median(times) < 0.02, f"median {1e3 * np.median(times):.1f} ms"


def test_the_pose_of_joints_is_that_of_the_arm_and_the_gripper_does_not_count(follower):
    q = recorded(5)[3]
    expected = ikjax.fk(ikjax.robots.so101(), np.deg2rad(q[:5]))
    np.testing.assert_allclose(follower.forward_kinematics(q), expected, atol=1e-12)
    np.testing.assert_array_equal(follower.forward_kinematics(q), follower.forward_kinematics([*q[:5], 99.0]))


def test_a_gripper_at_any_place_is_kept(follower):
    q = recorded(1)[0]
    goal = follower.forward_kinematics(q)
    goal[2, 3] += 0.01
    moved = follower.inverse_kinematics(q, goal)
    assert moved[5] == q[5] and np.abs(moved[:5] - q[:5]).max() > 0.1
    turned = ikjax.RobotKinematics(ikjax.robots.so101(), joint_names=["gripper", *NAMES])
    other = turned.inverse_kinematics(np.roll(q, 1), goal)
    np.testing.assert_allclose(np.roll(other, -1), moved, atol=1e-9)
    # Without names, further entries are kept.
    plain = ikjax.RobotKinematics(ikjax.robots.so101())
    np.testing.assert_allclose(plain.inverse_kinematics(q, goal), moved, atol=1e-9)


@pytest.mark.slow
def test_the_weights_say_what_gives_way(follower):
    q = recorded(1)[0]
    goal = follower.forward_kinematics(q)
    goal[:3, :3] = goal[:3, :3] @ np.asarray(ikjax.pose(rotvec=[0.4, 0.3, 0.2]))[:3, :3]

    def errors(*weights):
        there = follower.forward_kinematics(follower.inverse_kinematics(q, goal, *weights))
        return (float(x) for x in ikjax.pose_error(there, goal))

    near, wide = errors(1.0, 1e-4)
    far, narrow = errors(1.0, 1.0)
    point, _ = errors(1.0, 0.0)
    assert near < 0.01 < far and narrow < wide
    assert point < 1e-6


def test_a_goal_that_is_no_pose_leaves_the_joints(follower):
    q = recorded(1)[0]
    np.testing.assert_allclose(follower.inverse_kinematics(q, np.full((4, 4), np.nan)), q, atol=1e-9)


def test_mistakes_are_named(follower):
    with pytest.raises(ValueError, match="joint_names lacks joint5"):
        ikjax.RobotKinematics(ikjax.robots.so101(), joint_names=NAMES[:4])
    with pytest.raises(ValueError, match=r"joints must be \(6,\) numbers or more, got \(3,\)"):
        follower.forward_kinematics(np.zeros(3))
    with pytest.raises(ValueError, match="weights must be positive"):
        follower.inverse_kinematics(np.zeros(6), np.eye(4), 0.0, 1.0)


def test_a_urdf_file_is_read_to_its_target_frame(tmp_path):
    pytest.importorskip("defusedxml")
    import sys

    sys.path.insert(0, str(__import__("pathlib").Path(__file__).parents[1] / "arm"))
    from test_robots import SO101

    text = '<robot name="so101"><link name="l0"/>'
    for i, (xyz, rpy) in enumerate(SO101, 1):
        child = "gripper_frame_link" if i == 6 else f"l{i}"
        kind, (at, turned) = "fixed" if i == 6 else "revolute", (" ".join(map(str, x)) for x in (xyz, rpy))
        text += f'<link name="{child}"/><joint name="j{i}" type="{kind}"><parent link="l{i - 1}"/>'
        text += f'<child link="{child}"/><origin xyz="{at}" rpy="{turned}"/><axis xyz="0 0 1"/>'
        text += '<limit lower="-3" upper="3" effort="1" velocity="1"/></joint>'
    file = tmp_path / "so101.urdf"
    file.write_text(text + "</robot>")
    read = ikjax.RobotKinematics(str(file), joint_names=[f"j{i}" for i in range(1, 6)])
    q = recorded(1)[0][:5]
    expected = ikjax.fk(ikjax.robots.so101(), np.deg2rad(q))
    np.testing.assert_allclose(read.forward_kinematics(q), expected, atol=1e-9)
