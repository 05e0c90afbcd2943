"""ikjax: closed-form inverse kinematics as differentiable JAX."""

from typing import TYPE_CHECKING as _TYPE_CHECKING
from typing import Any as _Any

from ikjax import maps as maps
from ikjax.arm import robots as robots
from ikjax.arm.arm import Arm as Arm
from ikjax.arm.forward import fk as fk
from ikjax.arm.forward import frames as frames
from ikjax.arm.load import load as load
from ikjax.arm.twists import jacobian as jacobian
from ikjax.arm.urdf.xml import ArmFileError as ArmFileError
from ikjax.core.pose import planar_pose as planar_pose
from ikjax.core.pose import pose as pose
from ikjax.core.pose import pose_error as pose_error
from ikjax.core.pose import position as position
from ikjax.core.pose import to_wxyz_xyz as to_wxyz_xyz
from ikjax.ik.arm_angle import arm_angle as arm_angle
from ikjax.ik.check import check_goals as check_goals
from ikjax.ik.check import explain as explain
from ikjax.ik.free_roll import FreeRolls as FreeRolls
from ikjax.ik.free_roll import free_roll as free_roll
from ikjax.ik.margins import best_margin as best_margin
from ikjax.ik.margins import limited_margins as limited_margins
from ikjax.ik.margins import smooth_max as smooth_max
from ikjax.ik.margins import smooth_min as smooth_min
from ikjax.ik.project import project as project
from ikjax.ik.quality import inverse_condition as inverse_condition
from ikjax.ik.quality import limit_clearance as limit_clearance
from ikjax.ik.quality import manipulability as manipulability
from ikjax.ik.quality import sigma_min as sigma_min
from ikjax.ik.refine import refine as refine
from ikjax.ik.results import Projection as Projection
from ikjax.ik.results import Solutions as Solutions
from ikjax.ik.results import Trajectory as Trajectory
from ikjax.ik.robot_kinematics import RobotKinematics as RobotKinematics
from ikjax.ik.select import nearest as nearest
from ikjax.ik.select import within_limits as within_limits
from ikjax.ik.self_motion import SelfMotion as SelfMotion
from ikjax.ik.self_motion import nearest_on_self_motion as nearest_on_self_motion
from ikjax.ik.self_motion import self_motion as self_motion
from ikjax.ik.solve import solve as solve
from ikjax.ik.track import track as track
from ikjax.ik.turns import Turns as Turns
from ikjax.ik.turns import turns as turns
from ikjax.ik.verify import VerifyReport as VerifyReport
from ikjax.ik.verify import verify as verify
from ikjax.maps.reach_map import ReachMap as ReachMap
from ikjax.maps.runner import SweepStoppedError as SweepStoppedError
from ikjax.maps.store.storage import StorageError as StorageError
from ikjax.maps.sweep import sweep as sweep
from ikjax.synthesis import objectives as objectives
from ikjax.synthesis.design import DesignResult as DesignResult
from ikjax.synthesis.design import design as design
from ikjax.synthesis.place import Placements as Placements
from ikjax.synthesis.place import place as place

if _TYPE_CHECKING:
    from ikjax import plot as plot

__version__ = "0.1.0"


def __getattr__(name: str) -> _Any:
    """`ikjax.plot`, which is imported when it is first used."""
    if name == "plot":
        import importlib

        return importlib.import_module("ikjax.plot")
    raise AttributeError(f"module 'ikjax' has no attribute {name!r}")
