"""What a sweep keeps of its goals: statistics by name, and the lanes of the loop that feed them.

A lane is one number of a goal and the way in which those of many goals become one: counts,
sums of whole numbers, greatest, least, or bits. All of these come out the same in any order. What no
statistic asked for needs has no lane, so it is neither computed nor stored.

Every name but `best_limit_share` has a twin with `_within`, for solutions within the joint limits alone:

    reachable, solutions              orientations with a solution; solutions over all orientations
    branches                          orientations that each branch reaches
    mask                              which orientations are reached, a bit each
    best_margin                       greatest margin [m]; without limits over all slots, valid or not
    best_, mean_manipulability        |det J| in reaches, over solutions; 0 without one
    best_, mean_sigma_min             least singular value of J in reaches, likewise
    best_limit_share               of the joint nearest to its limit, 1 in the middle, 0 at the limit,
                                      negative beyond it; -inf without a solution

`Near` counts orientations that an arm comes near, `Measure` is a statistic of one's own.
"""

import functools
from collections.abc import Callable, Iterable, Mapping
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ikjax.arm.arm import Arm
from ikjax.maps.custom import Measure, Near
from ikjax.maps.kernel import joint_measures
from ikjax.maps.kernel.sample import GROUP, Goal, Lane

Own = Measure | Near

USUAL = ("reachable", "solutions", "reachable_within", "solutions_within", "best_margin")
"""What a sweep keeps if nothing is said."""


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

    def told(self) -> dict[str, Any]:
        """What the spec says of it."""
        axes, shape = [name for name, _ in self.more], [size for _, size in self.more]
        return {"dtype": self.dtype, "axes": axes, "shape": shape, **self.facts}


class Plan(NamedTuple):
    """Statistics by name, and the lanes that they need."""

    statistics: dict[str, Statistic]
    lanes: dict[str, Lane]
    certify: bool = False
    """Doubtful goals are solved again in float64."""

    def told(self) -> dict[str, dict[str, Any]]:
        """What the spec says of each."""
        return {name: statistic.told() for name, statistic in self.statistics.items()}


def plan(arm: Arm, wanted: Iterable[str | Own], orientations: int, rolls: int = 1) -> Plan:
    """The statistics of given names, and one's own.

    Raises:
        ValueError: A name that is none, or one twice, or no name at all.
    """
    given, known = list(wanted), available()
    names = [each.name if isinstance(each, Own) else str(each) for each in given]
    wrong = [name for name, each in zip(names, given, strict=True) if (name in known) == (each is not name)]
    if wrong or not names or len(set(names)) < len(names):
        raise ValueError(f"statistics must be some of {', '.join(known)}, got {', '.join(names) or 'none'}")
    built = {
        name: _own(arm, each, rolls) if isinstance(each, Own) else _build(arm, name, orientations, rolls)
        for name, each in zip(names, given, strict=True)
    }
    lanes = {key: lane for statistic, given in built.values() for key, lane in given.items()}
    return Plan({name: statistic for name, (statistic, _) in built.items()}, lanes)


def certified(plan: Plan) -> Plan:
    """The same, with doubtful goals solved again in float64.

    Raises:
        ValueError: No statistic is of numbers that are added up, or one of them is `Near`.
    """
    if any("near" in statistic.facts for statistic in plan.statistics.values()):
        raise ValueError("certify knows no doubts about what is near: sweep for that by itself")
    if not any(lane.added for lane in plan.lanes.values()):
        raise ValueError(f"certify needs a statistic that counts, got {', '.join(plan.statistics)}")
    mark = {"certified": True}
    again = {
        name: statistic._replace(facts={**statistic.facts, **mark})
        if any(plan.lanes[lane].added for lane in statistic.lanes)
        else statistic
        for name, statistic in plan.statistics.items()
    }
    return Plan(again, plan.lanes, certify=True)


def available() -> list[str]:
    """Names of statistics: every arm that can be swept has all of them."""
    return [*(name + end for name in _TWINS for end in ("", "_within")), "best_limit_share"]


_TWINS = (
    *("reachable", "solutions", "branches", "mask", "best_margin"),
    *("best_manipulability", "mean_manipulability", "best_sigma_min", "mean_sigma_min"),
)


def _own(arm: Arm, measure: Own, rolls: int) -> tuple[Statistic, dict[str, Lane]]:
    if isinstance(measure, Near):
        return Statistic("int32", (measure.name,), _whole, facts=measure.facts()), {
            measure.name: measure.lane()
        }
    lanes = measure.lanes(arm, rolls)
    kind = "float64" if measure.reduce == "sum" else arm.dtype.name
    return Statistic(kind, tuple(lanes), measure.finish, facts=measure.facts(arm)), lanes


def _build(arm: Arm, name: str, orientations: int, rolls: int) -> tuple[Statistic, dict[str, Lane]]:
    base = name.removesuffix("_within")
    inside = base != name
    slots = len(arm.branches)
    if base == "reachable":
        lane = Lane(
            "count", lambda goal: _any(goal.flags(inside)).astype(jnp.int32), inside=inside, any_roll=True
        )
        return Statistic("int32", (name,), _whole), {name: lane}
    if base == "solutions":
        lane = Lane("count", lambda goal: _number(goal.flags(inside)), most=slots, inside=inside)
        return Statistic("int32", (name,), _whole), {name: lane}
    if base == "branches":
        lanes = {
            f"{name}.{k}": Lane(
                "count", functools.partial(_branch, k=k, inside=inside), inside=inside, any_roll=True
            )
            for k in range(slots)
        }
        return Statistic("int32", tuple(lanes), _side_by_side, (("branch", slots),)), lanes
    if base == "mask":
        lane = Lane("bits", lambda goal: _any(goal.flags(inside)), inside=inside)
        words = -(-orientations // GROUP)
        return Statistic("uint32", (name,), lambda total: total[:, :words], (("word", words),)), {name: lane}
    if base == "best_margin":
        lane = Lane("max", functools.partial(_margin, inside=inside))
        return Statistic("float32", (name,), _column), {name: lane}
    if base == "best_limit_share":
        lane = Lane("max", joint_measures.best_limit_share, pinned=True)
        return Statistic("float32", (name,), _column), {name: lane}
    kind, _, what = base.partition("_")
    if kind == "best":
        lane = Lane("max", functools.partial(joint_measures.best, what=what, inside=inside), pinned=True)
        return Statistic("float32", (name,), _column), {name: lane}
    unit = joint_measures.unit_of_mean(slots, rolls)
    lane = Lane(
        "sum", functools.partial(joint_measures.total, what=what, inside=inside, unit=unit), pinned=True
    )
    number = f"solutions{'_within' if inside else ''}"
    lanes = {name: lane} | _build(arm, number, orientations, rolls)[1]
    return Statistic(
        "float32", tuple(lanes), functools.partial(_mean, unit=unit), facts={"unit": unit}
    ), lanes


def _mean(total: np.ndarray, number: np.ndarray, unit: float) -> np.ndarray:
    return (total[:, 0] * unit / np.maximum(number[:, 0], 1)).astype(np.float32)


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
