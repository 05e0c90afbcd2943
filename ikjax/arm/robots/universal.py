"""Universal Robots' arms.

Source of the tables: Universal Robots, DH parameters for calculations of kinematics and dynamics
(support article). Every joint turns one whole turn either way (data sheets); the UR3e's last joint
has no end.

Source of the named poses: Universal Robots, Universal_Robots_ROS2_Driver, ur_moveit_config,
srdf/ur_macro.srdf.xacro, where a quarter turn is written 1.5707. Zero, the arm stretched out level, is
"home" in ROS-Industrial's older universal_robot.
"""

import numpy as np

from ikjax.arm.arm import Arm
from ikjax.arm.robots.catalogue import robot

TURN = 2 * np.pi
QUARTER = np.pi / 2
POSES = {
    "zero": (0, 0, 0, 0, 0, 0),
    "home": (0, -QUARTER, 0, 0, 0, 0),
    "up": (0, -QUARTER, 0, -QUARTER, 0, 0),
    "test_configuration": (1.54, -1.62, 1.4, -1.2, -1.6, -0.11),
}


def _universal(name: str, upper: float, fore: float, d: tuple[float, float, float, float]) -> Arm:
    shoulder, wrist1, wrist2, wrist3 = d
    limits = np.tile([-TURN, TURN], (6, 1))
    if name == "ur3e":
        limits[5] = -np.inf, np.inf
    return Arm.from_dh(
        a=[0, -upper, -fore, 0, 0, 0],
        alpha=[np.pi / 2, 0, 0, np.pi / 2, -np.pi / 2, 0],
        d=[shoulder, 0, 0, wrist1, wrist2, wrist3],
        limits=limits,
        convention="standard",
        name=name,
    )


@robot(**POSES)
def ur3e() -> Arm:
    """Universal Robots UR3e."""
    return _universal("ur3e", 0.24355, 0.2132, (0.15185, 0.13105, 0.08535, 0.0921))


@robot(**POSES)
def ur5() -> Arm:
    """Universal Robots UR5."""
    return _universal("ur5", 0.425, 0.39225, (0.089159, 0.10915, 0.09465, 0.0823))


@robot(**POSES)
def ur5e() -> Arm:
    """Universal Robots UR5e."""
    return _universal("ur5e", 0.425, 0.3922, (0.1625, 0.1333, 0.0997, 0.0996))


@robot(**POSES)
def ur10e() -> Arm:
    """Universal Robots UR10e."""
    return _universal("ur10e", 0.6127, 0.57155, (0.1807, 0.17415, 0.11985, 0.11655))
