"""What a channel of a sweep's loop sees of a goal, and what a channel is."""

import functools
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from ikjax.arm.arm import Arm
from ikjax.arm.forward import fixed_pose, reach
from ikjax.core.pose import Pose
from ikjax.core.trig import Scalar
from ikjax.core.xla import Pin, through_one_number
from ikjax.maps.kernel.flags import (
    LimitTests,
    any_doubtful,
    slot_passes,
    slot_within_limits,
    within_all_but_one,
)
from ikjax.solvers.pipeline import Slot

GOALS_PER_WORD = 32
"""Goals whose numbers are reduced to one 32-bit word before anything else happens to them."""

DOUBT = "doubt"
"""The channel of doubtful goals, and the key of their flags in `Goal.cache`."""


BUT_ONE = "but one"
"""The key in `Goal.cache` of the flags of `Goal.reached_but_for`."""


class Goal(NamedTuple):
    """A batch of solved goals, as a channel sees it.

    Where the solvers have one scalar, each value here is an array (positions, orientations).
    """

    arm: Arm
    """Baked: its parameters are constants of the program."""
    slots: tuple[Slot, ...]
    """Every branch of the closed form."""
    pin: Pin
    """Keeps a value of this shape from being computed again (`core.xla`)."""
    shape: tuple[int, ...]
    """(positions, orientations); (goals,) where doubtful goals are solved again."""
    cache: dict[Any, Any]
    """Values that several channels use, each under a key of its own, made at the first use. Flags that were
    read from one number are under False (without limits) and True (within limits)."""
    pose: Pose | None = None
    """T_world_tool, for channels that look at more than solutions."""
    free: tuple[jax.Array, ...] = ()
    """Values of the redundant joints, one number each for all goals."""
    limits: LimitTests | None = None
    """The limits, where they are not those of `arm`."""
    tool: Pose | None = None
    """The tool in the frame of the last link, where it is not that of `arm`."""
    reach: jax.Array | None = None
    """The reach [m], where it is not that of `arm`."""

    @property
    def tool_pose(self) -> Pose:
        """The tool in the frame of the last link."""
        return fixed_pose(self.arm.tool) if self.tool is None else self.tool

    @property
    def whole_reach(self) -> Scalar:
        """The reach of the arm with its tool [m]."""
        return reach(self.arm) if self.reach is None else self.reach

    def is_within_limits(self, slot: Slot) -> jax.Array:
        """Whether whole turns can bring every joint of a slot between its limits."""
        if self.limits is None:
            return slot_within_limits(self.arm, slot)
        return slot_passes(self.arm, slot, self.limits)

    def flags(self, inside: bool) -> list[jax.Array]:
        """Which slots count, one bool array (positions, orientations) for each slot.

        Args:
            inside: Only solutions within the joint limits count.
        """
        if inside in self.cache:
            return self.cache[inside]
        if not inside:
            return [slot.valid for slot in self.slots]
        return [slot.valid & self.is_within_limits(slot) for slot in self.slots]

    def reached_but_for(self, joint: int) -> jax.Array:
        """Whether a solution is within the limits of all other joints, bool (positions, orientations).

        The flags of all joints are read from one number that is computed once.
        """
        if BUT_ONE not in self.cache:
            others = [within_all_but_one(self.arm, slot, self.limits) for slot in self.slots]
            rows = [[slot.valid & x for x in row] for slot, row in zip(self.slots, others, strict=True)]
            flags = [functools.reduce(jnp.logical_or, column) for column in zip(*rows, strict=True)]
            code = through_one_number(flags, self.slots[0].margin, self.shape, self.pin)
            self.cache[BUT_ONE] = [(code >> k & 1) == 1 for k in range(len(flags))]
        return self.cache[BUT_ONE][joint]

    def doubt(self) -> jax.Array:
        """Whether another rounding may give other flags, bool (positions, orientations)."""
        if DOUBT not in self.cache:
            self.cache[DOUBT] = any_doubtful(self.arm, self.slots)
        return self.cache[DOUBT]

    def with_packed_flags(self, kinds: Sequence[bool], with_doubt: bool) -> "Goal":
        """The same goals, with their flags read from one number that is computed once.

        Args:
            kinds: Which flags to pack, as the argument `inside` of `flags`.
            with_doubt: Whether `doubt` is packed too.
        """
        flags = [flag for inside in kinds for flag in self.flags(inside)]
        flags += [self.doubt()] if with_doubt else []
        code = through_one_number(flags, self.slots[0].margin, self.shape, self.pin)
        unpacked = [(code >> k & 1) == 1 for k in range(len(flags))]
        count = len(self.slots)
        cache = dict(self.cache)
        for k, inside in enumerate(kinds):
            cache[inside] = unpacked[k * count : (k + 1) * count]
        if with_doubt:
            cache[DOUBT] = unpacked[-1]
        return self._replace(cache=cache)


class Channel(NamedTuple):
    """One number of every goal on its way into a statistic, and how the numbers of many goals are reduced."""

    reduce: str
    """"count" (whole numbers; several channels share a 32-bit word), "sum" (whole numbers), "max", "min",
    "bits" (a flag of every goal), "run" (the most values of the redundant joint in a row at which one of the
    flags, which are bits of a whole number, stays set)."""
    value: Callable[[Goal], jax.Array]
    """From goals to their numbers (positions, orientations): int32 of "count", "sum" and "run", bool of
    "bits"."""
    max_per_goal: int = 1
    """Of "count": the greatest number of one goal at one trial. Of "run": the number of flags."""
    inside: bool = False
    """Of "count", "bits" and "run": whether it looks at the flags within joint limits."""
    any_trial: bool = False
    """Of "count": over trials the numbers 0 and 1 are joined by "or", not added."""
    any_value: bool = False
    """Of "count" and "bits": one where any value of the redundant joint reaches the goal; a certified sweep
    looks between the values too."""
    pinned: bool = False
    """Needs joints, not only flags: values of the kernel are pinned."""
    needs_whole_arm: bool = False
    """Needs the arm with its mount, tool and limits, which then are constants of the program."""

    @property
    def is_additive(self) -> bool:
        """Whether a goal can be left out of the result and put in later."""
        return self.reduce in ("count", "sum", "bits")
