"""Small arms with five revolute joints, as their makers' files place them.

Each joint is given as in a URDF: its frame in that of the joint before, xyz [m] and rpy [rad], and its axis
there.
"""

import numpy as np

from ikjax.arm.arm import Arm
from ikjax.arm.axes_to_dh import Axes, rewritten
from ikjax.arm.robots.catalogue import robot
from ikjax.arm.urdf.reader import rotation_of
from ikjax.core.tolerances import FACT

DEG = np.pi / 180
QUARTER = np.pi / 2
ZERO = (0,) * 5


def _pose(xyz, rpy) -> np.ndarray:
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation_of(*rpy), xyz
    return pose


def _placed(name: str, joints, tool, limits) -> Arm:
    """The arm of joints (xyz, rpy, axis) and a tool (xyz, rpy) in the frame of the last one."""
    frame, along, points = np.eye(4), [], []
    for xyz, rpy, axis in joints:
        frame = frame @ _pose(xyz, rpy)
        along.append(frame[:3, :3] @ axis)
        points.append(frame[:3, 3])
    axes = Axes("R" * len(joints), np.array(along), np.array(points), frame @ _pose(*tool))
    table = rewritten(axes, FACT)
    a, alpha, d, theta = (table.columns[key] for key in ("a", "alpha", "d", "theta"))
    return Arm.from_dh(
        a=a,
        alpha=alpha,
        d=d,
        theta=theta,
        base=table.base,
        tool=table.tool,
        limits=limits,
        convention="standard",
        name=name,
    )


X, Y, Z = np.eye(3)


@robot(zero=ZERO)
def so101() -> Arm:
    """SO-101, the follower arm, to its gripper frame: its roll axis passes 0.18 mm beside its first.

    The file's angles are rounded: the roll axis is 3.7e-6 rad off perpendicular, and stays so here.

    Source: TheRobotStudio/SO-ARM100, Simulation/SO101/so101_new_calib.urdf, commit 0aee1d0. The gripper frame
    is turned as in later versions of that file (`gripper_frame_joint`); in this one it stands at the same
    point, turned by rpy (1.5708, 0, 1.5708).
    Poses: the zero of the file.
    """
    return _placed(
        "so101",
        joints=[
            ((0.0207909, -0.0230745, 0.0948817), (-3.14159, 0, 1.5708), Z),
            ((-0.0303992, -0.0182778, -0.0542), (-1.5708, -1.5708, 0), Z),
            ((-0.11257, -0.028, 0), (0, 0, 1.5708), Z),
            ((-0.1349, 0.0052, 0), (0, 0, -1.5708), Z),
            ((0, -0.0611, 0.0181), (1.5708, -9.38083e-08, 3.14159), Z),
        ],
        tool=((-0.0079, -0.000218121, -0.0981274), (0, 3.14159, 0)),
        limits=[
            (-1.91986, 1.91986),
            (-1.74533, 1.74533),
            (-1.69, 1.69),
            (-1.65806, 1.65806),
            (-2.79253, 2.79253),
        ],
    )


@robot(zero=ZERO)
def katana_6m180() -> Arm:
    """Neuronics Katana 400 6M180 with its angle gripper, to the gripper's tool frame; joint 4 turns down.

    Source: uos/katana_driver, katana_description/urdf/katana_400_6m180.urdf.xacro, which cites the maker's
    manual for the lengths and takes the limits from its encoders.
    Poses: the zero of the file: stretched out level.
    """
    return _placed(
        "katana_6m180",
        joints=[
            ((0, 0, 0.2015), (0, 0, 0), Z),
            ((0, 0, 0), (QUARTER, 0, 0), Z),
            ((0.19, 0, 0), (0, 0, 0), Z),
            ((0.139, 0, 0), (2 * QUARTER, 0, 0), Z),
            ((0.1523, 0, 0), (QUARTER, 0, -QUARTER), Z),
        ],
        tool=((0, 0, -0.1505), (0, QUARTER, 0)),
        limits=[
            (-3.025528, 2.891097),
            (-0.135228, 2.168572),
            (-2.221804, 2.054223),
            (-2.033309, 1.876133),
            (-2.993240, 2.870985),
        ],
    )


# "Upright" is written -1.5708 there.
@robot(home=ZERO, upright=(0, 0, -QUARTER, 0, 0), sleep=(0, -1.76, 1.55, 0.8, 0))
def vx300() -> Arm:
    """Trossen Robotics (Interbotix) ViperX 300, the one with five joints, to `ee_gripper_link`.

    Source: Interbotix/interbotix_ros_manipulators, interbotix_xsarm_descriptions/urdf/vx300.urdf.xacro,
    commit 41746ab, gripper bar and fingers mounted.
    Poses: the same repository, interbotix_xsarm_moveit/config/srdf/vx300.srdf.xacro.
    """
    whole = np.pi - 1e-5
    return _placed(
        "vx300",
        joints=[
            ((0, 0, 0.079), (0, 0, 0), Z),
            ((0, 0, 0.04805), (0, 0, 0), Y),
            ((0.05955, 0, 0.3), (0, 0, 0), Y),
            ((0.3, 0, 0), (0, 0, 0), Y),
            ((0.069744, 0, 0), (0, 0, 0), X),
        ],
        tool=((0.042825 + 0.025875 + 0.0385, 0, 0), (0, 0, 0)),
        limits=[
            (-whole, whole),
            (-106 * DEG, 72 * DEG),
            (-101 * DEG, 92 * DEG),
            (-107 * DEG, 128 * DEG),
            (-whole, whole),
        ],
    )
