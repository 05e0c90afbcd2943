"""Industrial arms with a spherical wrist.

Joint zeros and directions are the makers' own, except where a line says otherwise; bars and gears
that couple joints are left out.
"""

import numpy as np

from ikjax.arm.arm import Arm
from ikjax.arm.robots.catalogue import robot

DEG = np.pi / 180
QUARTER = np.pi / 2
ZERO = (0,) * 6


def _ortho(name: str, a, alpha, d, theta, limits, base=None) -> Arm:
    return Arm.from_dh(
        a=a,
        alpha=np.multiply(alpha, DEG),
        d=d,
        theta=np.multiply(theta, DEG),
        limits=np.multiply(limits, DEG),
        base=base,
        convention="standard",
        name=name,
    )


@robot(zero=ZERO)
def irb120() -> Arm:
    """ABB IRB 120-3/0.6, to tool0.

    Source: ABB, Product specification IRB 120, 3HAC035960.
    Poses: "all_zero" of ROS-Industrial, abb, moveit/abb_irb120_moveit_config, abb_irb120_3_58.srdf.
    """
    return _ortho(
        "irb120",
        a=[0, 0.270, 0.070, 0, 0, 0],
        alpha=[-90, 0, -90, 90, -90, 0],
        d=[0.290, 0, 0, 0.302, 0, 0.072],
        theta=[0, -90, 0, 0, 0, 180],
        limits=[(-165, 165), (-110, 110), (-110, 70), (-160, 160), (-120, 120), (-400, 400)],
    )


@robot(zero=ZERO)
def irb2400() -> Arm:
    """ABB IRB 2400/10, to tool0; joint 3 is counted from the upper arm, not from the bars.

    Source: ABB, Product specification IRB 2400; lengths also in the ROS-Industrial OPW examples.
    Poses: "Home" of ROS-Industrial, abb, irb_2400_moveit_config, irb_2400.srdf.
    """
    return _ortho(
        "irb2400",
        a=[0.100, 0.705, 0.135, 0, 0, 0],
        alpha=[-90, 0, -90, 90, -90, 0],
        d=[0.615, 0, 0, 0.755, 0, 0.085],
        theta=[0, -90, 0, 0, 0, 180],
        limits=[(-180, 180), (-100, 110), (-60, 65), (-200, 200), (-120, 120), (-400, 400)],
    )


@robot(zero=ZERO, start=(0, -QUARTER, QUARTER, 0, QUARTER, 0))
def kr6_r900() -> Arm:
    """KUKA KR 6 R900 sixx: axis 1 points down, the upper arm lies level at zero.

    Source: KUKA, Specification KR AGILUS sixx.
    Poses: "null_pos" of kroshu, kuka_robot_descriptions, kuka_kr_moveit_config, kr_arm_macro.xacro; the
    start position of ROS-Industrial, kuka_experimental, kuka_rsi_hw_interface, KR_C4/ros_rsi.src: upper
    arm upright, forearm level, flange down.
    """
    return _ortho(
        "kr6_r900",
        a=[0.025, 0.455, 0.035, 0, 0, 0],
        alpha=[90, 0, 90, -90, 90, 0],
        d=[-0.400, 0, 0, -0.420, 0, -0.080],
        theta=[0, 0, -90, 0, 0, 0],
        limits=[(-170, 170), (-190, 45), (-120, 156), (-185, 185), (-120, 120), (-350, 350)],
        base=np.diag([1.0, -1.0, -1.0, 1.0]),
    )


@robot(zero=ZERO)
def lrmate200id() -> Arm:
    """FANUC LR Mate 200iD; joint 3 is counted from the upper arm, where FANUC counts from level.

    Source: FANUC, LR Mate 200iD data sheet; limits as in its ROS-Industrial description.
    Poses: "all-zeros" of ROS-Industrial, fanuc, fanuc_lrmate200id_moveit_config, fanuc_lrmate200id.srdf.
    Both ways of counting joint 3 have the same zero, because joint 2 is zero there.
    """
    return _ortho(
        "lrmate200id",
        a=[0.050, 0.330, 0.035, 0, 0, 0],
        alpha=[-90, 180, -90, 90, -90, 0],
        d=[0.330, 0, 0, -0.335, 0, -0.080],
        theta=[0, -90, 0, 0, 0, 0],
        limits=[(-170, 170), (-100, 145), (-70, 205), (-190, 190), (-125, 125), (-360, 360)],
    )


@robot(zero=ZERO)
def rx160() -> Arm:
    """Staubli RX160: the arm stands straight up at zero.

    Source: Staubli, Arm RX series 160 family, instruction manual.
    Poses: "all-zeros" of ROS-Industrial, staubli, staubli_rx160_moveit_config, staubli_rx160.srdf.
    """
    return _ortho(
        "rx160",
        a=[0.150, 0.825, 0, 0, 0, 0],
        alpha=[-90, 0, 90, -90, 90, 0],
        d=[0.550, 0, 0, 0.625, 0, 0.110],
        theta=[0, -90, 90, 0, 0, 0],
        limits=[(-160, 160), (-137.5, 137.5), (-150, 150), (-270, 270), (-105, 120), (-270, 270)],
    )
