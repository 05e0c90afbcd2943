"""Collaborative arms whose wrist has an offset, so that its three axes do not meet.

Source of the lengths and twists: the package robotkinematicscatalogue 1.1.2 (modified DH tables); of the
xArm 6 UFACTORY, Kinematic and dynamic parameters of xArm 6 (support article), standard table. Joint zeros are
the maker's for the xArm 6, and those of the table for the others, whose only pose is that zero. Joint limits
are left out: each joint turns without an end.
"""

import numpy as np

from ikjax.arm.arm import Arm
from ikjax.arm.robots.catalogue import robot

DEG = np.pi / 180
ZERO = (0,) * 6
COMMON = (-90, 0, -90, 90, -90, 0)
"""[deg] The twists of all of them."""


def _offset(name: str, a, d, theta=ZERO) -> Arm:
    return Arm.from_dh(
        a=np.multiply(a, 1e-3),
        alpha=np.multiply(COMMON, DEG),
        d=np.multiply(d, 1e-3),
        theta=theta,
        convention="standard",
        name=name,
    )


@robot(zero=ZERO)
def crx10ia() -> Arm:
    """FANUC CRX-10iA, from the height of axis 2."""
    return _offset("crx10ia", a=[0, 540, 0, 0, 0, 0], d=[0, 0, 0, 540, -150, 160])


@robot(zero=ZERO)
def hc10() -> Arm:
    """Yaskawa HC10, from the height of axis 2."""
    return _offset("hc10", a=[0, 700, 0, 0, 0, 0], d=[0, 0, 0, 500, 162, 130])


@robot(zero=ZERO)
def xarm6() -> Arm:
    """UFACTORY xArm 6."""
    upper, turn = np.hypot(284.5, 53.5), np.arctan2(284.5, 53.5)
    return _offset(
        "xarm6",
        a=[0, upper, 77.5, 0, 76, 0],
        d=[267, 0, 0, 342.5, 0, 97],
        theta=[0, -turn, turn, 0, 0, 0],
    )


@robot(zero=ZERO)
def gofa5() -> Arm:
    """ABB GoFa 5 (CRB 15000-5)."""
    return _offset("gofa5", a=[0, 444, 110, 0, 80, 0], d=[265, 0, 0, 470, 0, 101])


@robot(zero=ZERO)
def gen3lite() -> Arm:
    """Kinova Gen3 lite."""
    return _offset("gen3lite", a=[0, 280, 0, 0, 0, 0], d=[243.25, 10, 0, 245, -57, 105])


@robot(zero=ZERO)
def cobotta() -> Arm:
    """Denso Cobotta."""
    return _offset("cobotta", a=[0, 165, 12, 0, 0, 0], d=[180, 20, 0, 177.5, -64.5, 102])
