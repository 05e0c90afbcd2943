"""The families: one file for each closed form, in the order of `arm.recognition.rules.RULES`.

Each file has a function `branches` with the same arguments and result:

    signs       what the kernel must know besides the numbers, see `arm.recognition.signs`
    links       the DH table, lengths in units of the reach
    goal        the pose of the last frame, seen from frame 0
    setting     fallback joint values and tolerances, see `solvers.context.Setting`
    result      one `Branch` for each slot, in slot order

Bit k of a slot's number (0 for the lowest) is clear for the first of the two answers that the header of the
file names, and set for the second.
"""

from collections.abc import Callable
from typing import NamedTuple

from ikjax.core.trig import Scalar
from ikjax.solvers.context import Branch, Joints
from ikjax.solvers.families import (
    arm_angle,
    five_axis,
    five_locked,
    five_nearest,
    offset_wrist,
    ortho_parallel_wrist,
    parallel_axes,
    pieper,
    planar,
    position,
    scara,
    three_parallel,
)


class Family(NamedTuple):
    """A closed form, and which joints its slots have in common."""

    branches: Callable[..., tuple[Branch, ...]]
    """(signs, links, goal, setting) -> every slot."""
    first: int
    """This many first joints are the same in slots that differ in the rest."""
    last: int
    """This many last joints likewise."""
    small: bool = False
    """XLA can compute all masks in one fused loop; see `ik.inline`."""
    nearest: Callable[..., tuple[Branch, ...]] | None = None
    """Every slot for a goal that cannot be reached; None where the clamped answers of `branches` will do. It
    attains the goal's point where that can be reached, with the nearest orientation."""
    locked: Callable[..., list[Joints]] | None = None
    """(signs, links, goal, setting, limits) -> joints likewise, with one of them locked at one of its
    limits."""
    lockable: tuple[int, ...] = ()
    """The joints that `locked` can lock, counted from 0."""
    stacked: Callable[..., Branch] | None = None
    """As `branches`, but all slots are one `Branch`, whose numbers have the slots as their first axis: where
    there are so many that a program should contain each step once. Newton's method finishes them."""
    margins: Callable[..., Scalar] | None = None
    """(signs, links, goal, `Branch.fold`) -> the margins of `stacked`, to be differentiated."""


FAMILIES = {
    "ortho_parallel_wrist": Family(ortho_parallel_wrist.branches, first=3, last=0, small=True),
    "three_parallel": Family(three_parallel.branches, first=1, last=2, small=True),
    "pieper": Family(pieper.branches, first=3, last=0),
    "pieper_reversed": Family(pieper.reversed_branches, first=0, last=3),
    "parallel_axes": Family(parallel_axes.branches, first=0, last=0),
    "offset_wrist": Family(
        offset_wrist.branches,
        first=0,
        last=0,
        stacked=offset_wrist.stacked,
        margins=offset_wrist.margins,
    ),
    "offset_wrist_reversed": Family(
        offset_wrist.reversed_branches,
        first=0,
        last=0,
        stacked=offset_wrist.reversed_stacked,
        margins=offset_wrist.reversed_margins,
    ),
    "scara": Family(scara.branches, first=0, last=0, small=True),
    "five_axis": Family(
        five_axis.branches,
        first=0,
        last=0,
        small=True,
        nearest=five_nearest.branches,
        locked=five_locked.branches,
        lockable=five_locked.LOCKABLE,
    ),
    "turret": Family(scara.turret_branches, first=0, last=0, small=True),
    "planar_pose": Family(planar.branches, first=0, last=0, small=True),
    "planar_position": Family(planar.branches, first=0, last=0, small=True),
    "position": Family(position.branches, first=0, last=0),
}

KERNELS = {**FAMILIES, "arm_angle": Family(arm_angle.branches, first=0, last=0, small=True)}
"""With that of `solve(arm_angle=...)`, which no arm is recognized as."""
