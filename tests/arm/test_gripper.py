"""Names and ranges as in files that makers publish."""

import math

import pytest

from ikjax.arm.urdf.gripper import Moved, gripper

INF = math.inf
ARM = [Moved(f"joint{i}", f"link{i}", "R", -3.0, 3.0) for i in range(1, 6)]
GRIPPERS = {
    "so100": [("Jaw", "Moving_Jaw", "R", -0.2, 2.0)],
    "so100 by number": [("6", "moving_jaw", "R", -0.2, 2.0)],
    "so101": [("gripper", "moving_jaw_so101_v1_link", "R", -0.1745, 1.7453)],
    "only a range": [("joint6", "link6", "R", -0.2, 2.0)],
    "only a short slide": [("joint6", "link6", "P", 0.0, 0.04)],
    "panda": [("panda_finger_joint1", "panda_leftfinger", "P", 0, 0.04)],
    "robotiq": [("drive", "left_outer_knuckle", "R", 0, 0.8), ("f", "left_finger", "R", -0.8, 0)],
    "nao": [("LHand", "l_gripper", "R", 0, 1.0)],
    "open manipulator": [("gripper", "gripper_link", "P", -0.01, 0.019)],
    "kinova": [("j2n6s300_joint_finger_1", "j2n6s300_link_finger_1", "R", 0, 1.51)],
    "niryo": [("joint_base_to_jaw_1", "jaw", "P", -0.01, 0.01)],
    "widowx": [("left_finger", "left_finger_link", "P", 0.015, 0.037)],
    "a claw that turns without end": [("claw", "claw_link", "R", -INF, INF)],
    "wrist to jaw": [("wrist_to_jaw", "jaw", "R", 0, 1.0)],
}
WRISTS = {
    "universal robots": ("wrist_3_joint", "wrist_3_link", "R", -6.28, 6.28),
    "so100": ("Wrist_Roll", "Fixed_Jaw", "R", -3.14158, 3.14158),
    "so100 by number": ("5", "fixed_jaw", "R", -1.0, 1.0),
    "the link is the gripper": ("gripper_joint", "gripper", "R", -3.14158, 3.14158),
    "a gripper's base": ("joint5", "gripper_base", "R", -1.0, 1.0),
    "widowx": ("wrist_rotate", "gripper_link", "R", -1.0, 1.0),
    "niryo": ("joint_6", "hand_link", "R", -2.53, 2.53),
    "panda": ("panda_joint7", "panda_link7", "R", -2.8973, 2.8973),
    "a narrow wrist": ("joint6", "link6", "R", -0.8, 0.8),
    "a wrist that bends one way": ("wrist_flex", "hand", "R", 0.0, 1.5),
    "a continuous flange": ("joint6", "link6", "R", -INF, INF),
    "a long slide": ("joint6", "link6", "P", 0.0, 0.4),
    "an ankle": ("left_ankle_roll", "left_foot", "R", -0.05, 0.3),
    "a handle": ("joint6", "handle_link", "R", -3.0, 3.0),
}


@pytest.mark.parametrize("fingers", GRIPPERS.values(), ids=GRIPPERS)
def test_a_gripper_is_noticed_with_all_its_joints(fingers):
    assert gripper([*ARM, *(Moved(*finger) for finger in fingers)]) == len(fingers)


@pytest.mark.parametrize("wrist", WRISTS.values(), ids=WRISTS)
def test_a_wrist_is_none(wrist):
    assert gripper([*ARM, Moved(*wrist)]) == 0


def test_a_chain_of_fingers_alone_is_meant_as_it_is():
    assert gripper([Moved("finger_1", "f1", "R", 0, 1), Moved("finger_2", "f2", "R", 0, 1)]) == 0


def test_a_leg_or_a_small_arm_may_bend_one_way():
    assert gripper([*ARM[:2], Moved("knee", "shank", "R", -2.5, 0.0)]) == 0
