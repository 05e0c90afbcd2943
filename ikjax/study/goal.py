"""What a lane of a sweep's loop sees of a goal, and what a lane is.

Storey: study.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax

from ikjax.arm.arm import Arm
from ikjax.solvers.family import Slot
from ikjax.study.limits import within

GROUP = 32
"""Goals that are added up in 32 bits before anything else happens to them."""


class Goal(NamedTuple):
    """What a lane sees: arrays (positions, orientations) in the place of scalars."""

    arm: Arm
    slots: tuple[Slot, ...]
    hold: Callable[[Any], Any]
    """Keeps a value from being computed again; see `ik.graph`."""
    shape: tuple[int, int]

    def flags(self, inside: bool) -> list[jax.Array]:
        """Which slots count."""
        if not inside:
            return [slot.valid for slot in self.slots]
        return [slot.valid & within(self.arm, slot) for slot in self.slots]


class Lane(NamedTuple):
    """One number of every goal on its way into a statistic."""

    reduce: str
    """"count" (whole numbers, several of which share a word), "sum" (whole numbers), "max", "min", "bits"."""
    value: Callable[[Goal], jax.Array]
    most: int = 1
    """Of a count: the greatest number of one goal."""
    any_roll: bool = False
    """Of a count: over free rolls it is a yes or no, and not a sum."""
    held: bool = False
    """Needs joints, not only masks: the kernel keeps its values instead of computing them again."""
