"""Arms of seven joints, one of which is redundant: `solve` is given its value.

Source of the Franka tables: frankaemika/franka_ros, franka_description, whose frames are those of a table in
Craig's convention; limits of the FER: joint_limits.yaml there; of the FR3: the crate franka_rust, in
franka_fr3.rs (those of the robot, without the margin that franka_ros keeps). "Ready" is the default there.

Source of the iiwa's lengths, ranges, signs and zeros: IFL-CAMP/iiwa_stack, iiwa_description/urdf.

Source of the xArm 7: UFACTORY, xarm_ros, xarm_description: config/kinematics/default and urdf/xarm7.

Source of the Gen3: Kinova, ros_kortex, kortex_description/arms/gen3/7dof, gen3_macro.xacro. Its axis 6 misses
axes 5 and 7 by 0.175 mm each.

Source of the RealMan arms: RealMan, ros2_rm_robot, rm_description/urdf, rm_75.urdf and rm_gen72.urdf.
"""

import numpy as np

from ikjax.arm.arm import Arm
from ikjax.arm.robots.catalogue import robot

QUARTER = np.pi / 2
DEGREE = np.pi / 180
ZERO = (0,) * 7
READY = (0, -QUARTER / 2, 0, -3 * QUARTER / 2, 0, QUARTER, QUARTER / 2)


def _shifted(z: float) -> np.ndarray:
    """A pose that far along z."""
    T = np.eye(4)
    T[2, 3] = z
    return T


def _franka(name: str, limits) -> Arm:
    return Arm.from_dh(
        a=[0, 0, 0, 0.0825, -0.0825, 0, 0.088],
        alpha=np.multiply([0, -1, 1, 1, -1, 1, 1], QUARTER),
        d=[0.333, 0, 0.316, 0, 0.384, 0, 0],
        tool=_shifted(0.107),
        limits=limits,
        convention="modified",
        name=name,
    )


@robot(ready=READY)
def fer() -> Arm:
    """Franka Emika Robot, also called Panda; joint 7 is redundant."""
    wide = (-2.8973, 2.8973)
    shoulder, elbow, wrist = (-1.7628, 1.7628), (-3.0718, -0.0698), (-0.0175, 3.7525)
    return _franka("fer", [wide, shoulder, wide, elbow, wide, wrist, wide])


@robot(ready=READY)
def fr3() -> Arm:
    """Franka Research 3, which has the Panda's table; joint 7 is redundant."""
    ends = [2.7437, 1.7837, 2.9007, None, 2.8065, None, 3.0159]
    limits = [(0.0, 0.0) if end is None else (-end, end) for end in ends]
    limits[3], limits[5] = (-3.0421, -0.1518), (0.5445, 4.5169)
    return _franka("fr3", limits)


def _straight(name: str, lengths: tuple[float, float, float, float], limits) -> Arm:
    """Axes 1, 3, 5, 7 along one line at zero, with 2, 4, 6 square to it, all about y."""
    shoulder, upper, fore, hand = lengths
    return Arm.from_dh(
        a=[0] * 7,
        alpha=np.multiply([-1, 1, -1, 1, -1, 1, 0], QUARTER),
        d=[shoulder, 0, upper, 0, fore, 0, hand],
        limits=limits,
        convention="standard",
        name=name,
    )


IIWA = np.multiply([[-1, 1]], np.multiply([[170, 120, 170, 120, 170, 120, 175]], DEGREE).T)
"""Limits of both [rad]."""


def _iiwa(name: str, lengths: tuple[float, float, float, float]) -> Arm:
    """As KUKA counts, joint 4 turns the other way than 2 and 6."""
    shoulder, upper, fore, hand = lengths
    return Arm.from_dh(
        a=[0] * 7,
        alpha=np.multiply([-1, 1, 1, -1, -1, 1, 0], QUARTER),
        d=[shoulder, 0, upper, 0, fore, 0, hand],
        limits=IIWA,
        convention="standard",
        name=name,
    )


@robot(zero=ZERO)
def iiwa7() -> Arm:
    """KUKA LBR iiwa 7 R800; joint 1 is redundant."""
    return _iiwa("iiwa7", (0.34, 0.4, 0.4, 0.126))


@robot(zero=ZERO)
def iiwa14() -> Arm:
    """KUKA LBR iiwa 14 R820; joint 1 is redundant."""
    return _iiwa("iiwa14", (0.36, 0.42, 0.4, 0.126))


@robot(zero=ZERO)
def xarm7() -> Arm:
    """UFACTORY xArm 7; joint 7 is redundant."""
    turn = (-4 * QUARTER, 4 * QUARTER)
    shoulder, elbow, wrist = (-2.059, 2.0944), (-0.19198, 3.927), (-1.69297, 2 * QUARTER)
    return Arm.from_dh(
        a=[0, 0, 0, 0.0525, 0.0775, 0, 0.076],
        alpha=np.multiply([0, -1, 1, 1, 1, 1, -1], QUARTER),
        d=[0.267, 0, 0.293, 0, 0.3425, 0, 0.097],
        limits=[turn, shoulder, turn, elbow, turn, wrist, turn],
        convention="modified",
        name="xarm7",
    )


@robot(zero=ZERO)
def gen3() -> Arm:
    """Kinova Gen3 with seven joints; joint 1 is redundant."""
    limits = np.tile([-np.inf, np.inf], (7, 1))
    limits[[1, 3, 5]] = [(-2.41, 2.41), (-2.66, 2.66), (-2.23, 2.23)]
    over = np.diag([1.0, -1.0, -1.0, 1.0])
    return Arm.from_dh(
        a=[0] * 7,
        alpha=np.multiply([0, 1, -1, 1, -1, 1, -1], QUARTER),
        d=[
            -0.12838,
            -0.005375 - 0.006375,
            -0.21038 - 0.21038,
            -0.006375 - 0.006375,
            -0.20843 - 0.10593,
            -0.00017505 - 0.00017505,
            -0.10593,
        ],
        base=_shifted(0.15643) @ over,
        tool=_shifted(-0.0615250000000001) @ over,
        limits=limits,
        convention="modified",
        axis_tolerance=1e-3,
        name="gen3",
    )


@robot(zero=ZERO)
def rm75() -> Arm:
    """RealMan RM75-B; joint 1 is redundant."""
    ends = np.array([3.1, 2.268, 3.1, 2.355, 3.1, 2.233, 6.28])
    return _straight("rm75", (0.2405, 0.256, 0.21, 0.144), np.stack([-ends, ends], -1))


@robot(zero=ZERO)
def gen72() -> Arm:
    """RealMan GEN72; joint 7 is redundant."""
    ends = np.array([3.0014, 1.8323, 3.0014, 0, 3.0014, 0, 3.0014])
    limits = np.stack([-ends, ends], -1)
    limits[3], limits[5] = (-2.8792, 0.9597), (-1.707, 1.783)
    return Arm.from_dh(
        a=[0, 0, 0, 0.04, -0.019, 0, 0.067],
        alpha=np.multiply([0, -1, 1, 1, -1, 1, 1], QUARTER),
        d=[0.218, 0, 0.28, 0, 0.2525, 0, 0.0905],
        theta=[0, 0, 0, 0, 0, QUARTER, 0],
        limits=limits,
        convention="modified",
        name="gen72",
    )
