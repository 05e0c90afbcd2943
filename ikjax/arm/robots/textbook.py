"""Arms from textbooks and lectures, with the tables that they print."""

import numpy as np

from ikjax.arm.arm import Arm
from ikjax.arm.robots.catalogue import robot

DEG = np.pi / 180
QUARTER = np.pi / 2


@robot(
    zero=(0, 0, 0, 0, 0, 0),
    ready=(0, QUARTER, -QUARTER, 0, 0, 0),
    stretch=(0, 0, -QUARTER, 0, 0, 0),
    # Corke's joint 3 is half a turn forward, which his limits do not allow; half a turn back is the same.
    nominal=(0, QUARTER / 2, -2 * QUARTER, 0, QUARTER / 2, 0),
)
def puma560() -> Arm:
    """Unimation PUMA 560.

    Source: Corke and Armstrong-Helouvry, A search for consensus among model parameters reported
    for the PUMA 560 robot (1994); limits as in Corke, Robotics, Vision and Control.
    Poses: qz, qr, qs and qn of Corke, Robotics Toolbox for Python, models/DH/Puma560.py.
    """
    return Arm.from_dh(
        a=[0, 0.4318, 0.0203, 0, 0, 0],
        alpha=np.multiply([90, 0, -90, 90, -90, 0], DEG),
        d=[0, 0, 0.15005, 0.4318, 0, 0],
        limits=np.multiply([(-160, 160), (-45, 225), (-225, 45), (-110, 170), (-100, 100), (-266, 266)], DEG),
        convention="standard",
        name="puma560",
    )


@robot(zero=(0, 0, 0, 0, 0, 0))
def elbow_manipulator(a2: float = 0.4, a3: float = 0.3, a4: float = 0.1) -> Arm:
    """The lectures' elbow manipulator; its three lengths [m] are free, the defaults are ours.

    Source: ME/SE 740, lectures 15 and 18.
    """
    return Arm.from_dh(
        a=[0, a2, a3, a4, 0, 0],
        alpha=np.multiply([90, 0, 0, -90, 90, 0], DEG),
        d=[0, 0, 0, 0, 0, 0],
        convention="standard",
        name="elbow_manipulator",
    )


@robot(zero=(0, 0, 0, 0, 0))
def motoman_l3(l2: float = 0.4, l3: float = 0.3) -> Arm:
    """Yasukawa Motoman L-3; Craig names its lengths [m] by letters only, the defaults are ours.

    Joints are Craig's, not the motors, which turn them through bars; he gives no limits.

    Source: Craig, Introduction to Robotics, 3rd ed., sections 3.7 and 4.7: frame 5 is the wrist.
    """
    return Arm.from_dh(
        a=[0, 0, l2, l3, 0],
        alpha=np.multiply([0, -90, 0, 0, 90], DEG),
        d=[0, 0, 0, 0, 0],
        convention="modified",
        name="motoman_l3",
    )


# No pose: the only published one, Corke's qz, is all zeros, where the slide is short of its range.
@robot()
def stanford() -> Arm:
    """The Stanford arm, RRPRRR: two revolute joints, a prismatic one, a spherical wrist.

    Source: the table and limits of Corke, Robotics Toolbox for MATLAB, models/mdl_stanford.m, which cites
    Stanford AIM-177 for the lengths; he calls the range of the slide a guess.
    """
    turns = np.multiply([(-170, 170), (-170, 170), (0, 0), (-170, 170), (-90, 90), (-170, 170)], DEG)
    turns[2] = 0.3048, 1.27
    return Arm.from_dh(
        a=[0, 0, 0, 0, 0, 0],
        alpha=np.multiply([-90, 90, 0, -90, 90, 0], DEG),
        d=[0.412, 0.154, 0, 0, 0, 0.263],
        theta=np.multiply([0, 0, -90, 0, 0, 0], DEG),
        kinds="RRPRRR",
        limits=turns,
        convention="standard",
        name="stanford",
    )


@robot(zero=(0, 0))
def planar_2r(l1: float = 0.5, l2: float = 0.4) -> Arm:
    """Two links in a plane; the lengths [m] are free, the defaults are ours. Task "planar_position".

    Source: Spong, Robot Modeling and Control, equations (1.5)-(1.8).
    """
    return Arm.from_dh(a=[l1, l2], alpha=[0, 0], d=[0, 0], convention="standard", name="planar_2r")


@robot(zero=(0, 0, 0))
def planar_3r(l1: float = 0.5, l2: float = 0.4, l3: float = 0.2) -> Arm:
    """Three links in a plane; the lengths [m] are free, the defaults are ours. Task "planar_pose".

    Source: Craig, Introduction to Robotics, 3rd ed., section 4.4.
    """
    return Arm.from_dh(a=[l1, l2, l3], alpha=[0, 0, 0], d=[0, 0, 0], convention="standard", name="planar_3r")


@robot(zero=(0, 0, 0))
def planar_rpr(l3: float = 0.3) -> Arm:
    """RPR, the slide along the first link: x = S c1 + l3 c13, y = S s1 + l3 s13. Task "planar_pose".

    The length [m] is free, the default is ours. Source: the lectures' slides on RPR arms.
    """
    return Arm.from_dh(
        a=[0, 0, l3],
        alpha=np.multiply([90, -90, 0], DEG),
        d=[0, 0, 0],
        theta=np.multiply([90, 0, -90], DEG),
        kinds="RPR",
        convention="standard",
        name="planar_rpr",
    )


# At zero the slide is short of its range.
@robot(stretch=(10, 0, 0))
def planar_prr(l2: float = 7.0, l3: float = 5.0) -> Arm:
    """PRR, a slide along y, then links that point along y at zero: x = -l2 s2 - l3 s23. Task "planar_pose".

    The lengths [m] and limits are those of the lectures' slides on PRR arms; stretched out it stands at
    (0, 22), the slides' first question.
    """
    upright = np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]])
    return Arm.from_dh(
        a=[0, l2, l3],
        alpha=np.multiply([90, 0, 0], DEG),
        d=[0, 0, 0],
        theta=np.multiply([0, 90, 0], DEG),
        kinds="PRR",
        limits=[(5, 10), (0, np.pi), (0, np.pi)],
        base=upright,
        convention="standard",
        name="planar_prr",
    )
