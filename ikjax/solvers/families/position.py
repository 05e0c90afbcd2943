"""Three joints that bring the tool point where it is wanted, whatever its orientation.

Branches: those of `regional`. Task: "position".
"""

from ikjax.arm.forward import Link
from ikjax.core.pose import Pose
from ikjax.solvers.context import Branch, Setting
from ikjax.solvers.steps.regional.three_joints import regional


def branches(signs: tuple, links: tuple[Link, ...], goal: Pose, setting: Setting) -> tuple[Branch, ...]:
    """All slots for one goal, of which only the position is looked at.

    Arguments as in `pieper`; signs: how the regional equation splits.
    """
    ways = regional(links, setting.tool, goal.position, signs[0], setting)
    return tuple(Branch(way.joints, goal, way.margin, way.continuum) for way in ways)
