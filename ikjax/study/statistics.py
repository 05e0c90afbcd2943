"""What a sweep keeps of its goals: statistics by name, and the lanes of the loop that feed them.

Storey: study. A lane is one number of a goal and the way in which those of many goals become one: counts,
sums of whole numbers, greatest, least, or bits. All of these come out the same in any order. What no
statistic asked for needs has no lane, so it is neither computed nor stored.

Every name but `best_limit_distance` has a twin with `_within`, for solutions within the joint limits alone:

    reachable, solutions              orientations with a solution; solutions over all orientations
    branches                          orientations that each branch reaches
    mask                              which orientations are reached, a bit each
    best_margin                       greatest margin [m]; without limits over all slots, valid or not
    best_, mean_manipulability        |det J| in reaches, over solutions; 0 without one
    best_, mean_sigma_min             least singular value of J in reaches, likewise
    best_limit_distance               from the nearest limit, as a share of half the range; see `limits`
"""

import functools
from collections.abc import Callable, Iterable, Mapping
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ikjax.arm.arm import Arm
from ikjax.solvers.family import Slot
from ikjax.study.limits import within

GROUP = 32
"""Goals that are added up in 32 bits before anything else happens to them."""

USUAL = ("reachable", "solutions", "reachable_within", "solutions_within", "best_margin")
"""What a sweep keeps if nothing is said."""


class Goal(NamedTuple):
    """What a lane sees: arrays (positions, orientations) in the place of scalars."""

    arm: Arm
    slots: tuple[Slot, ...]
    hold: Callable[[Any], Any]
    """Keeps a value from being computed again; see `ik.graph`."""

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


class Statistic(NamedTuple):
    """What a map stores under a name."""

    dtype: str
    lanes: tuple[str, ...]
    """What `finish` is given."""
    finish: Callable[..., np.ndarray]
    """From the lanes' totals (positions, k), 64-bit where they are whole numbers."""
    more: tuple[tuple[str, int], ...] = ()
    """Names and sizes of further axes after those of the positions."""
    facts: Mapping[str, Any] = {}
    """What else tells it from another of its name, for the spec."""


class Plan(NamedTuple):
    """Statistics by name, and the lanes that they need."""

    statistics: dict[str, Statistic]
    lanes: dict[str, Lane]


def plan(arm: Arm, names: Iterable[str], orientations: int) -> Plan:
    """The statistics of given names.

    Raises:
        ValueError: A name that is none, or one twice, or no name at all.
    """
    names, known = list(names), available(arm)
    wrong = [name for name in names if name not in known]
    if wrong or not names or len(set(names)) < len(names):
        raise ValueError(f"statistics must be some of {', '.join(known)}, got {', '.join(names) or 'none'}")
    built = {name: _build(arm, name, orientations) for name in names}
    lanes = {key: lane for statistic, given in built.values() for key, lane in given.items()}
    return Plan({name: statistic for name, (statistic, _) in built.items()}, lanes)


def available(arm: Arm) -> list[str]:
    """Names of statistics."""
    return [name + end for name in _TWINS for end in ("", "_within")]


_TWINS = ("reachable", "solutions", "branches", "mask", "best_margin")


def _build(arm: Arm, name: str, orientations: int) -> tuple[Statistic, dict[str, Lane]]:
    base = name.removesuffix("_within")
    inside = base != name
    slots = len(arm.branches)
    if base == "reachable":
        lane = Lane("count", lambda goal: _any(goal.flags(inside)).astype(jnp.int32), any_roll=True)
        return Statistic("int32", (name,), _whole), {name: lane}
    if base == "solutions":
        lane = Lane("count", lambda goal: _number(goal.flags(inside)), most=slots)
        return Statistic("int32", (name,), _whole), {name: lane}
    if base == "branches":
        lanes = {
            f"{name}.{k}": Lane("count", functools.partial(_branch, k=k, inside=inside), any_roll=True)
            for k in range(slots)
        }
        return Statistic("int32", tuple(lanes), _side_by_side, (("branch", slots),)), lanes
    if base == "mask":
        lane = Lane("bits", lambda goal: _any(goal.flags(inside)))
        words = -(-orientations // GROUP)
        return Statistic("uint32", (name,), lambda total: total[:, :words], (("word", words),)), {name: lane}
    lane = Lane("max", functools.partial(_margin, inside=inside))
    return Statistic("float32", (name,), _column), {name: lane}


def _branch(goal: Goal, k: int, inside: bool) -> jax.Array:
    return goal.flags(inside)[k].astype(jnp.int32)


def _margin(goal: Goal, inside: bool) -> jax.Array:
    margins = [slot.margin for slot in goal.slots]
    if inside:
        flags = goal.flags(True)
        margins = [jnp.where(f, margin, -jnp.inf) for f, margin in zip(flags, margins, strict=True)]
    return functools.reduce(jnp.maximum, margins)


def _any(flags: list[jax.Array]) -> jax.Array:
    return functools.reduce(jnp.logical_or, flags)


def _number(flags: list[jax.Array]) -> jax.Array:
    return functools.reduce(jnp.add, [flag.astype(jnp.int32) for flag in flags])


def _whole(total: np.ndarray) -> np.ndarray:
    return total[:, 0].astype(np.int32)


def _side_by_side(*totals: np.ndarray) -> np.ndarray:
    return np.concatenate(totals, axis=1).astype(np.int32)


def _column(total: np.ndarray) -> np.ndarray:
    return total[:, 0]


def unpacked(mask: np.ndarray, orientations: int) -> np.ndarray:
    """Whether each orientation is reached, (..., orientations) bool, from a mask (..., words)."""
    bits = np.unpackbits(np.ascontiguousarray(mask, "<u4").view(np.uint8), axis=-1, bitorder="little")
    return bits[..., :orientations].astype(bool)
