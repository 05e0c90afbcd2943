"""What a sweep stores: statistics by name, and the channels of the loop that feed them.

A channel is one number of a goal and the reduction of these numbers over many goals: a count, a sum of whole
numbers, the greatest, the least, or bits. All of these have the same bits in any order. There are channels
only for the statistics asked for; nothing else is computed or stored.

Every name but `best_limit_share` and `limited_by` has a twin with `_within`, for solutions within the joint
limits alone:

    reachable, solutions              orientations with a solution; solutions over all orientations
    branches                          orientations that each branch reaches
    mask                              which orientations are reached, a bit each
    best_margin                       greatest margin [m]; without limits over all slots, valid or not
    best_, mean_manipulability        |det J| in reaches, over solutions; 0 without one
    best_, mean_sigma_min             least singular value of J in reaches, likewise
    best_limit_share                  of the joint nearest to its limit, 1 in the middle, 0 at the limit,
                                      negative beyond it; -inf without a solution
    limited_by                        for each joint, orientations lost to its limits alone: reached by a
                                      solution that is within all other limits, and by none within all

Of an arm with redundant joints each goal is tried at several values of them. An orientation is reached if one
of these does; solutions are those of all values together, and means are over them.

    widest_interval                   of an arm with one redundant joint: the longest interval of its values
                                      on which one branch reaches one of the orientations [rad, m], by
                                      samples: the most in a row, times their distance. An interval that goes
                                      on past the ends of a whole turn counts as two

`Near` counts orientations that an arm comes near, `Measure` is a user's own statistic.
"""

import functools
from collections.abc import Callable, Iterable, Mapping
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ikjax.arm.arm import Arm
from ikjax.core.xla import through_one_number
from ikjax.ik.redundancy import redundant_range
from ikjax.maps.custom import Measure, Near
from ikjax.maps.kernel import joint_measures
from ikjax.maps.kernel.sample import GOALS_PER_WORD, Channel, Goal

Custom = Measure | Near

USUAL = ("reachable", "solutions", "reachable_within", "solutions_within", "best_margin")
"""The statistics of a sweep by default."""


class Statistic(NamedTuple):
    """What a map stores under a name."""

    dtype: str
    """Type of its numbers."""
    channels: tuple[str, ...]
    """Names of the channels that it is made of."""
    finish: Callable[..., np.ndarray]
    """From the results of these channels, as from `Kernel.accumulate`, to (positions, ...) numbers."""
    extra_axes: tuple[tuple[str, int], ...] = ()
    """Names and sizes of its axes after those of the positions."""
    facts: Mapping[str, Any] = {}
    """What else tells it from another of its name, for the spec."""

    def spec(self) -> dict[str, Any]:
        """What the map's spec says of it."""
        axes, shape = [name for name, _ in self.extra_axes], [size for _, size in self.extra_axes]
        return {"dtype": self.dtype, "axes": axes, "shape": shape, **self.facts}


class Plan(NamedTuple):
    """Statistics by name, and the channels that they need."""

    statistics: dict[str, Statistic]
    channels: dict[str, Channel]
    certify: bool = False
    """Doubtful goals are solved again in float64."""

    def specs(self) -> dict[str, dict[str, Any]]:
        """What the map's spec says of each statistic, by name."""
        return {name: statistic.spec() for name, statistic in self.statistics.items()}


def plan(
    arm: Arm, wanted: Iterable[str | Custom], orientations: int, rolls: int = 1, samples: int = 1
) -> Plan:
    """The statistics asked for, and their channels.

    Args:
        arm: An arm with a family, of the kernel's type.
        wanted: Names from `available`, or statistics of the user's own.
        orientations: Number at each position.
        rolls: Free rolls of each orientation.
        samples: Values of each redundant joint.

    Raises:
        ValueError: An unknown name, a name twice, or no name at all.
    """
    given, known = list(wanted), available(redundant=len(arm.locked) == 1)
    trials = rolls * samples ** len(arm.locked)
    names = [each.name if isinstance(each, Custom) else str(each) for each in given]
    wrong = [name for name, each in zip(names, given, strict=True) if (name in known) == (each is not name)]
    if wrong or not names or len(set(names)) < len(names):
        raise ValueError(f"statistics must be some of {', '.join(known)}, got {', '.join(names) or 'none'}")
    built = {
        name: _custom(arm, each, trials)
        if isinstance(each, Custom)
        else _widest_interval(arm, name, samples)
        if name.removesuffix("_within") == WIDEST
        else _limited_by(arm, orientations, trials)
        if name == LIMITED_BY
        else _named(arm, name, orientations, trials)
        for name, each in zip(names, given, strict=True)
    }
    channels = {key: channel for _, channels in built.values() for key, channel in channels.items()}
    return Plan({name: statistic for name, (statistic, _) in built.items()}, channels)


def certified(plan: Plan, by_values: bool = False) -> Plan:
    """The same plan, with doubtful goals solved again in float64.

    Args:
        plan: The statistics.
        by_values: One joint is redundant, and goals are searched between its values too.

    Raises:
        ValueError: No statistic counts or sums, or one of them is `Near`.
    """
    if any("near" in statistic.facts for statistic in plan.statistics.values()):
        raise ValueError("certify does not support Near: sweep for it without certify")
    if not any(channel.is_additive for channel in plan.channels.values()):
        raise ValueError(f"certify needs a statistic that counts, got {', '.join(plan.statistics)}")

    def facts(statistic: Statistic) -> dict[str, Any]:
        channels = [plan.channels[channel] for channel in statistic.channels]
        found = {"certified": any(channel.is_additive for channel in channels)}
        found["between_values"] = by_values and any(channel.any_value for channel in channels)
        return {**statistic.facts, **{key: True for key, holds in found.items() if holds}}

    again = {name: each._replace(facts=facts(each)) for name, each in plan.statistics.items()}
    return Plan(again, plan.channels, certify=True)


def available(redundant: bool = False) -> list[str]:
    """Names of all statistics; every arm that can be swept has all of them.

    Args:
        redundant: With those of an arm with one redundant joint.
    """
    names = [*(name + end for name in _TWINS for end in ("", "_within")), "best_limit_share", LIMITED_BY]
    return [*names, WIDEST, f"{WIDEST}_within"] if redundant else names


WIDEST = "widest_interval"
LIMITED_BY = "limited_by"

_TWINS = (
    *("reachable", "solutions", "branches", "mask", "best_margin"),
    *("best_manipulability", "mean_manipulability", "best_sigma_min", "mean_sigma_min"),
)


def _custom(arm: Arm, wanted: Custom, trials: int) -> tuple[Statistic, dict[str, Channel]]:
    """A statistic of the user's own, and its channels."""
    if isinstance(wanted, Near):
        statistic = Statistic("int32", (wanted.name,), _as_counts, facts=wanted.facts())
        return statistic, {wanted.name: wanted.channel()}
    channels = wanted.channels(trials)
    dtype = "float64" if wanted.reduce == "sum" else arm.dtype.name
    return Statistic(dtype, tuple(channels), wanted.finish, facts=wanted.facts(arm)), channels


def _named(arm: Arm, name: str, orientations: int, trials: int) -> tuple[Statistic, dict[str, Channel]]:
    """The statistic of a name from `available`, and its channels."""
    base = name.removesuffix("_within")
    inside = base != name
    slots = len(arm.branches)
    if base == "reachable":
        value = functools.partial(_is_reached, inside=inside)
        channel = Channel("count", value, inside=inside, any_trial=True, any_value=True)
        return Statistic("int32", (name,), _as_counts), {name: channel}
    if base == "solutions":
        value = functools.partial(_solution_count, inside=inside)
        channel = Channel("count", value, max_per_goal=slots, inside=inside)
        return Statistic("int32", (name,), _as_counts), {name: channel}
    if base == "branches":
        channels = {
            f"{name}.{k}": Channel(
                "count", functools.partial(_is_valid, k=k, inside=inside), inside=inside, any_trial=True
            )
            for k in range(slots)
        }
        return Statistic("int32", tuple(channels), _side_by_side, (("branch", slots),)), channels
    if base == "mask":
        words = -(-orientations // GOALS_PER_WORD)
        channel = Channel("bits", lambda goal: _any(goal.flags(inside)), inside=inside, any_value=True)
        # The last tile may be longer than the orientations, so its last words are cut off.
        statistic = Statistic("uint32", (name,), lambda bits: bits[:, :words], (("word", words),))
        return statistic, {name: channel}
    if base == "best_margin":
        channel = Channel("max", functools.partial(_best_margin, inside=inside))
        return Statistic("float32", (name,), _first_column), {name: channel}
    if base == "best_limit_share":
        channel = Channel("max", joint_measures.best_limit_share, pinned=True)
        return Statistic("float32", (name,), _first_column), {name: channel}
    kind, _, what = base.partition("_")
    if kind == "best":
        value = functools.partial(joint_measures.best_of_slots, what=what, inside=inside)
        return Statistic("float32", (name,), _first_column), {name: Channel("max", value, pinned=True)}
    unit = joint_measures.unit_of_mean(slots, trials)
    value = functools.partial(joint_measures.sum_of_slots, what=what, inside=inside, unit=unit)
    # A mean needs the number of solutions too.
    counted = f"solutions{'_within' if inside else ''}"
    channels = {name: Channel("sum", value, pinned=True)} | _named(arm, counted, orientations, trials)[1]
    finish = functools.partial(_mean, unit=unit)
    return Statistic("float32", tuple(channels), finish, facts={"unit": unit}), channels


def _widest_interval(arm: Arm, name: str, samples: int) -> tuple[Statistic, dict[str, Channel]]:
    low, high = redundant_range(arm.baked(), arm.locked[0], arm.dtype)
    inside = name != WIDEST
    value = functools.partial(_flags_in_bits, inside=inside)
    channel = Channel("run", value, max_per_goal=len(arm.branches), inside=inside)
    finish = functools.partial(_in_spacings, spacing=float(high - low) / samples)
    return Statistic("float32", (name,), finish), {name: channel}


def _limited_by(arm: Arm, orientations: int, trials: int) -> tuple[Statistic, dict[str, Channel]]:
    # What is reached within all limits is reached within all but one, at the same trial. So the difference of
    # two counts is the number of goals between.
    limited = [
        i for i, (lower, upper) in enumerate(np.asarray(arm.limits)) if lower > -np.inf or upper < np.inf
    ]
    channels = {
        f"{LIMITED_BY}.{i}": Channel(
            "count",
            functools.partial(Goal.reached_but_for, joint=i),
            inside=True,
            any_trial=True,
            any_value=True,
        )
        for i in limited
    }
    channels = {name: each._replace(value=_as_whole(each.value)) for name, each in channels.items()}
    channels |= _named(arm, "reachable_within", orientations, trials)[1]
    finish = functools.partial(_lost, joints=arm.n, limited=limited)
    return Statistic("int32", tuple(channels), finish, (("joint", arm.n),)), channels


def _as_whole(flag: Callable[[Goal], jax.Array]) -> Callable[[Goal], jax.Array]:
    return lambda goal: flag(goal).astype(jnp.int32)


def _lost(*results: np.ndarray, joints: int, limited: list[int]) -> np.ndarray:
    """Per joint what is reached but for its limits, less what is reached within all (the last result)."""
    lost = np.zeros((len(results[-1]), joints), np.int32)
    for i, count in zip(limited, results[:-1], strict=True):
        lost[:, i] = count[:, 0] - results[-1][:, 0]
    return lost


def _flags_in_bits(goal: Goal, inside: bool) -> jax.Array:
    return through_one_number(goal.flags(inside), goal.slots[0].margin, goal.shape, goal.pin)


def _in_spacings(result: np.ndarray, spacing: float) -> np.ndarray:
    return (result[:, 0] * spacing).astype(np.float32)


def _mean(total: np.ndarray, number: np.ndarray, unit: float) -> np.ndarray:
    """Sums in whole units over numbers of solutions; 0 without a solution."""
    return (total[:, 0] * unit / np.maximum(number[:, 0], 1)).astype(np.float32)


def _is_reached(goal: Goal, inside: bool) -> jax.Array:
    return _any(goal.flags(inside)).astype(jnp.int32)


def _solution_count(goal: Goal, inside: bool) -> jax.Array:
    return functools.reduce(jnp.add, [flag.astype(jnp.int32) for flag in goal.flags(inside)])


def _is_valid(goal: Goal, k: int, inside: bool) -> jax.Array:
    return goal.flags(inside)[k].astype(jnp.int32)


def _best_margin(goal: Goal, inside: bool) -> jax.Array:
    margins = [slot.margin for slot in goal.slots]
    if inside:
        flags = goal.flags(True)
        margins = [jnp.where(f, margin, -jnp.inf) for f, margin in zip(flags, margins, strict=True)]
    return functools.reduce(jnp.maximum, margins)


def _any(flags: list[jax.Array]) -> jax.Array:
    return functools.reduce(jnp.logical_or, flags)


def _as_counts(result: np.ndarray) -> np.ndarray:
    return result[:, 0].astype(np.int32)


def _side_by_side(*results: np.ndarray) -> np.ndarray:
    return np.concatenate(results, axis=1).astype(np.int32)


def _first_column(result: np.ndarray) -> np.ndarray:
    return result[:, 0]


def unpacked_mask(mask: np.ndarray, orientations: int) -> np.ndarray:
    """Whether each orientation is reached, of the statistic `mask`.

    Args:
        mask: (..., words) uint32; orientation i is bit i % 32 of word i // 32.
        orientations: Their number.

    Returns:
        (..., orientations) bool.
    """
    bits = np.unpackbits(np.ascontiguousarray(mask, "<u4").view(np.uint8), axis=-1, bitorder="little")
    return bits[..., :orientations].astype(bool)
