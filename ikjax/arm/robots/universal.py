"""Universal Robots' arms.

Source of the tables: Universal Robots, DH parameters for calculations of kinematics and dynamics
(support article). Every joint turns one whole turn either way (data sheets); the UR3e's last joint
has no end.
"""

import numpy as np

from ikjax.arm.arm import Arm

TURN = 2 * np.pi


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


def ur3e() -> Arm:
    """Universal Robots UR3e."""
    return _universal("ur3e", 0.24355, 0.2132, (0.15185, 0.13105, 0.08535, 0.0921))


def ur5() -> Arm:
    """Universal Robots UR5."""
    return _universal("ur5", 0.425, 0.39225, (0.089159, 0.10915, 0.09465, 0.0823))


def ur5e() -> Arm:
    """Universal Robots UR5e."""
    return _universal("ur5e", 0.425, 0.3922, (0.1625, 0.1333, 0.0997, 0.0996))


def ur10e() -> Arm:
    """Universal Robots UR10e."""
    return _universal("ur10e", 0.6127, 0.57155, (0.1807, 0.17415, 0.11985, 0.11655))
