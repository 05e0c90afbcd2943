"""ikjax: closed-form inverse kinematics as differentiable JAX."""

from ikjax.arm import robots
from ikjax.arm.arm import Arm
from ikjax.arm.forward import fk, frames
from ikjax.arm.jacobian import jacobian
from ikjax.core.pose import planar_pose, pose, pose_error, position
from ikjax.ik.check import check_goals, explain
from ikjax.ik.margins import best_margin, limited_margins, smooth_max, smooth_min
from ikjax.ik.project import project
from ikjax.ik.projection import Projection
from ikjax.ik.quality import inverse_condition, limit_distance, manipulability, sigma_min
from ikjax.ik.refine import refine
from ikjax.ik.select import nearest, within_limits
from ikjax.ik.solutions import Solutions
from ikjax.ik.solve import solve
from ikjax.ik.track import Path, track
from ikjax.ik.turns import Turns, turns
from ikjax.study import objectives
from ikjax.study.bases import place
from ikjax.study.design import design
from ikjax.study.designed import Designed
from ikjax.study.goals import Grid, Shell, around, grid, shell
from ikjax.study.hopf import Hopf, hopf
from ikjax.study.measures import Measure
from ikjax.study.near import Near
from ikjax.study.orientations import Cone, cone, even_rotations
from ikjax.study.placed import Bases
from ikjax.study.reach import ReachMap
from ikjax.study.surface import Surface, surface
from ikjax.study.sweep import sweep
from ikjax.study.verify import verify

__version__ = "0.1.0"
