"""Three joints that bring the tool point where it is wanted, whatever its orientation.

Branches: those of `regional.three_joints`; 4, 2 or 1. Task: "position".

Frames: standard DH. The tool point is given in frame 3.

Steps:
1. regional: joints 1, 2, 3 bring the tool point where the goal has it.

Bits: those of `regional.three_joints`.

Source: as there.
"""

from ikjax.arm.forward import Link
from ikjax.arm.recognition.signs import PositionSigns
from ikjax.core.pose import Pose
from ikjax.solvers.context import Branch, Setting
from ikjax.solvers.steps.regional.three_joints import regional


def branches(
    signs: PositionSigns, links: tuple[Link, ...], goal: Pose, setting: Setting
) -> tuple[Branch, ...]:
    """All slots for one goal, of which only the position is used.

    Arguments as in `pieper`.
    """
    ways = regional(links, setting.tool_point, goal.position, signs.split, setting)
    return tuple(Branch(way.joints, goal, way.margin, way.continuum) for way in ways)
