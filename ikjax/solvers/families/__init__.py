"""The families: one closed form a file, in the order of `arm.recognition.rules.RULES`."""

from collections.abc import Callable
from typing import NamedTuple

from ikjax.solvers.context import Branch, Joints
from ikjax.solvers.families import (
    five_axis,
    five_held,
    five_nearest,
    ortho_parallel_wrist,
    parallel_axes,
    pieper,
    planar,
    position,
    scara,
    three_parallel,
)


class Family(NamedTuple):
    """A closed form, and where its slots part."""

    branches: Callable[..., tuple[Branch, ...]]
    """(signs, links, goal, setting) -> every slot."""
    first: int
    """So many first joints are shared by slots that differ in the rest."""
    last: int
    """So many last joints likewise."""
    small: bool = False
    """XLA can compute all masks in one fused loop; see `ik.inline`."""
    nearest: Callable[..., tuple[Branch, ...]] | None = None
    """Every slot for a goal that cannot be reached, where clamping `branches` would not hold its point."""
    held: Callable[..., list[Joints]] | None = None
    """(signs, links, goal, setting, ends) -> joints likewise, one of them at one of its ends."""
    may_hold: tuple[int, ...] = ()
    """Joints that `held` holds."""


FAMILIES = {
    "ortho_parallel_wrist": Family(ortho_parallel_wrist.branches, first=3, last=0, small=True),
    "three_parallel": Family(three_parallel.branches, first=1, last=2, small=True),
    "pieper": Family(pieper.branches, first=3, last=0),
    "pieper_reversed": Family(pieper.reversed_branches, first=0, last=3),
    "parallel_axes": Family(parallel_axes.branches, first=0, last=0),
    "scara": Family(scara.branches, first=0, last=0, small=True),
    "five_axis": Family(
        five_axis.branches,
        first=0,
        last=0,
        small=True,
        nearest=five_nearest.branches,
        held=five_held.branches,
        may_hold=five_held.HELD,
    ),
    "turret": Family(scara.turret_branches, first=0, last=0, small=True),
    "planar_pose": Family(planar.branches, first=0, last=0, small=True),
    "planar_position": Family(planar.branches, first=0, last=0, small=True),
    "position": Family(position.branches, first=0, last=0),
}
