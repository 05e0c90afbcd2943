"""Three joints that bring the tool point where it is wanted, whatever its orientation.

Branches: those of `regional`. Task: "position".
"""

from ikjax.arm.forward import Link
from ikjax.arm.recognition.signs import PositionSigns
from ikjax.core.pose import Pose
from ikjax.solvers.context import Branch, Setting
from ikjax.solvers.steps.regional.three_joints import regional


def branches(
    signs: PositionSigns, links: tuple[Link, ...], goal: Pose, setting: Setting
) -> tuple[Branch, ...]:
    """All slots for one goal, of which only the position is looked at.

    Arguments as in `pieper`.
    """
    ways = regional(links, setting.tool_point, goal.position, signs.split, setting)
    return tuple(Branch(way.joints, goal, way.margin, way.continuum) for way in ways)
