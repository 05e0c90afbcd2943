"""ikjax: closed-form inverse kinematics as differentiable JAX."""

from ikjax.arm import robots
from ikjax.arm.arm import Arm
from ikjax.arm.forward import fk, frames
from ikjax.arm.twists import jacobian
from ikjax.core.pose import planar_pose, pose, pose_error, position
from ikjax.ik.check import check_goals, explain
from ikjax.ik.margins import best_margin, limited_margins, smooth_max, smooth_min
from ikjax.ik.project import project
from ikjax.ik.quality import inverse_condition, limit_distance, manipulability, sigma_min
from ikjax.ik.refine import refine
from ikjax.ik.results import Path, Projection, Solutions
from ikjax.ik.select import nearest, within_limits
from ikjax.ik.solve import solve
from ikjax.ik.track import track
from ikjax.ik.turns import Turns, turns
from ikjax.ik.verify import verify
from ikjax.maps.custom import Measure, Near
from ikjax.maps.reach_map import ReachMap
from ikjax.maps.sets.hopf import Hopf, hopf
from ikjax.maps.sets.orientations import Cone, cone, even_rotations
from ikjax.maps.sets.positions import Grid, Shell, around, grid, shell
from ikjax.maps.sets.surface import Surface, surface
from ikjax.maps.sweep import sweep
from ikjax.synthesis import objectives
from ikjax.synthesis.design import Designed, design
from ikjax.synthesis.place import Bases, place

__version__ = "0.1.0"
