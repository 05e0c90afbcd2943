"""What a lane of a sweep's loop sees of a goal, and what a lane is."""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax

from ikjax.arm.arm import Arm
from ikjax.core.pose import Pose
from ikjax.core.xla import Pin, through_one_number
from ikjax.maps.kernel.flags import any_doubtful, within
from ikjax.solvers.pipeline import Slot

GROUP = 32
"""Goals that are added up in 32 bits before anything else happens to them."""


DOUBT = "doubt"
"""The lane of doubtful goals."""


class Goal(NamedTuple):
    """What a lane sees: arrays (positions, orientations) in the place of scalars."""

    arm: Arm
    slots: tuple[Slot, ...]
    pin: Pin
    """Keeps a value of its shape from being computed again."""
    shape: tuple[int, int]
    kept: dict[Any, Any]
    """What several lanes look at and was made already."""
    pose: Pose | None = None
    """T_world_tool, for what looks at more than solutions."""

    def flags(self, inside: bool) -> list[jax.Array]:
        """Which slots count."""
        if inside in self.kept:
            return self.kept[inside]
        if not inside:
            return [slot.valid for slot in self.slots]
        return [slot.valid & within(self.arm, slot) for slot in self.slots]

    def doubt(self) -> jax.Array:
        """Whether another rounding may make other flags."""
        if DOUBT not in self.kept:
            self.kept[DOUBT] = any_doubtful(self.arm, self.slots)
        return self.kept[DOUBT]

    def coded(self, kinds: Sequence[bool], doubt: bool) -> "Goal":
        """The same goal, with its flags read from one number that is made once.

        Args:
            kinds: Which flags: without limits, within them.
            doubt: Whether doubts are read too.
        """
        flags = [flag for inside in kinds for flag in self.flags(inside)]
        flags += [self.doubt()] if doubt else []
        code = through_one_number(flags, self.slots[0].margin, self.shape, self.pin)
        read = [(code >> k & 1) == 1 for k in range(len(flags))]
        count = len(self.slots)
        parts = {inside: read[k * count : (k + 1) * count] for k, inside in enumerate(kinds)}
        return self._replace(kept={**self.kept, **parts, **({DOUBT: read[-1]} if doubt else {})})


class Lane(NamedTuple):
    """One number of every goal on its way into a statistic."""

    reduce: str
    """"count" (whole numbers, several of which share a word), "sum" (whole numbers), "max", "min", "bits"."""
    value: Callable[[Goal], jax.Array]
    most: int = 1
    """Of a count: the greatest number of one goal."""
    inside: bool = False
    """Of a count or bits: which flags it looks at."""
    any_roll: bool = False
    """Of a count: over free rolls it is a yes or no, and not a sum."""
    pinned: bool = False
    """Needs joints, not only masks: values of the kernel are pinned."""

    @property
    def added(self) -> bool:
        """Whether a goal's number can be taken out of the total again."""
        return self.reduce in ("count", "sum", "bits")
