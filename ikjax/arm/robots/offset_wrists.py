"""Collaborative arms whose wrist has an offset, so that its three axes do not meet.

Joint zeros, directions and limits are those of the descriptions that the sources name, except where a line
says otherwise.
"""

import numpy as np

from ikjax.arm.arm import Arm
from ikjax.arm.robots.catalogue import robot

DEG = np.pi / 180
ZERO = (0,) * 6


def _offset(name: str, a, alpha, d, theta, limits) -> Arm:
    """An arm from lengths [mm] and angles [deg]."""
    return Arm.from_dh(
        a=np.multiply(a, 1e-3),
        alpha=np.multiply(alpha, DEG),
        d=np.multiply(d, 1e-3),
        theta=np.multiply(theta, DEG),
        limits=np.multiply(limits, DEG),
        convention="standard",
        name=name,
    )


@robot(zero=ZERO)
def crx10ia() -> Arm:
    """FANUC CRX-10iA, from its foot to the flange; joint 3 is counted from the upper arm.

    Source: FANUC, fanuc_description, fanuc_crx_description/urdf/crx10ia_urdf_macro.xacro (2025).
    """
    return _offset(
        "crx10ia",
        a=[0, 540, 0, 0, 0, 0],
        alpha=[-90, 180, -90, 90, -90, 180],
        d=[245, 0, 0, -540, 150, -160],
        theta=[0, -90, 0, 0, 0, 0],
        limits=[(-190, 190), (-179.9, 179.9), (-71, 251), (-190, 190), (-179.9, 179.9), (-225, 225)],
    )


@robot(zero=ZERO)
def hc10() -> Arm:
    """Yaskawa Motoman HC10, to tool0; at zero its forearm hangs beside its upper arm.

    Source: ROS-Industrial, motoman, motoman_hc10_support/urdf/hc10_macro.xacro.
    """
    return _offset(
        "hc10",
        a=[0, 700, 0, 0, 0, 0],
        alpha=[-90, 180, -90, 90, -90, 180],
        d=[275, 0, 0, -500, -162, -130],
        theta=[0, -90, -90, 0, 0, 0],
        limits=[(-180, 180), (-180, 180), (-5, 355), (-180, 180), (-180, 180), (-180, 180)],
    )


@robot(zero=ZERO)
def xarm6() -> Arm:
    """UFACTORY xArm 6.

    Source: UFACTORY, xarm_ros2, xarm_description/urdf/xarm6/xarm6.urdf.xacro.
    """
    upper, turn = np.hypot(284.5, 53.5), np.arctan2(284.5, 53.5) / DEG
    return _offset(
        "xarm6",
        a=[0, upper, 77.5, 0, 76, 0],
        alpha=[-90, 0, -90, 90, -90, 0],
        d=[267, 0, 0, 342.5, 0, 97],
        theta=[0, -turn, turn, 0, 0, 0],
        # The file has rad.
        limits=[
            (-360, 360),
            (-2.059 / DEG, 2.0944 / DEG),
            (-3.927 / DEG, 0.19198 / DEG),
            (-360, 360),
            (-1.69297 / DEG, 180),
            (-360, 360),
        ],
    )


@robot(zero=ZERO)
def gofa5() -> Arm:
    """ABB GoFa 5 (CRB 15000-5/0.95), to tool0.

    Source: ROS-Industrial, abb, abb_crb15000_support/urdf/crb15000_5_95_macro.xacro.
    """
    return _offset(
        "gofa5",
        a=[0, 444, 110, 0, 80, 0],
        alpha=[-90, 0, -90, 90, -90, 0],
        d=[265, 0, 0, 470, 0, 101],
        theta=[0, -90, 0, 0, 0, 180],
        limits=[(-180, 180), (-180, 180), (-225, 85), (-180, 180), (-180, 180), (-180, 180)],
    )


@robot(zero=ZERO)
def gofa10() -> Arm:
    """ABB GoFa 10 (CRB 15000-10/1.52), to the flange, with the GoFa 5's zeros.

    Source: the package robotkinematicscatalogue 1.1.2, ABB_CRB_15000_10 (a table of modified parameters, with
    limits). Nobody else was found who prints it: ROS-Industrial's file of that name has the GoFa 5's lengths.
    """
    return _offset(
        "gofa10",
        a=[150, 707, 110, 0, 80, 0],
        alpha=[-90, 0, -90, 90, -90, 0],
        d=[400, 0, 0, 637, 0, 101],
        theta=[0, -90, 0, 0, 0, 180],
        limits=[(-270, 270), (-180, 180), (-225, 85), (-180, 180), (-180, 180), (-270, 270)],
    )


@robot(zero=ZERO)
def gen3lite() -> Arm:
    """Kinova Gen3 lite, to the end-effector frame without its gripper.

    Source: Kinova, ros2_kortex, kortex_description/arms/gen3_lite/6dof/urdf/gen3_lite_macro.xacro, limits in
    rad there.
    """
    ends = np.divide([2.69, 2.69, 2.69, 2.59, 2.57, 2.59], DEG)
    return _offset(
        "gen3lite",
        a=[0, 280, 0, 0, 0, 0],
        alpha=[90, 180, 90, -90, 90, 0],
        d=[243.25, 0, -10, 245, 57, 105],
        theta=[0, 90, 90, -90, 0, 90],
        limits=np.stack([-ends, ends], axis=-1),
    )


@robot(zero=ZERO)
def link6() -> Arm:
    """Kinova Link 6, to the flange.

    Source: the package robotkinematicscatalogue 1.1.2, Kinova_Link_6 (a table of modified parameters, with
    limits), whose joints turn as in its table. Nobody else was found who prints it.
    """
    return _offset(
        "link6",
        a=[110.24, 485, 0, 0, 86, 0],
        alpha=[-90, 0, -90, 90, -90, 0],
        d=[190.5, -22.447, 0, 374.91, 139.879, 179.028],
        theta=[0, -90, -90, 0, 90, 90],
        limits=[(-360, 360)] * 6,
    )


@robot()
def cobotta() -> Arm:
    """Denso Cobotta (CVR038A1), to the frame that joint 6 turns; joint 3 does not reach zero.

    Source: Denso, denso_cobotta_ros, denso_cobotta_descriptions/cobotta_description/cobotta.body.urdf.xacro.
    """
    return _offset(
        "cobotta",
        a=[0, 165, 12, 0, 0, 0],
        alpha=[-90, 0, -90, 90, -90, 0],
        d=[180, 0, 20, 177.5, -64.5, 42],
        theta=[0, -90, -90, 0, 0, 180],
        limits=[(-150, 150), (-60, 100), (18, 140), (-170, 170), (-95, 135), (-170, 170)],
    )
