"""The accumulators of a sweep's loop: numbers of goals are reduced by bits, whole-number sums, or extremes.

A trial is one roll of a goal at one value of the redundant joint. The numbers of its trials are combined
first.

All of these reductions are exact, so the result has the same bits in any order. A sum of whole numbers is
stored as two halves of 16 bits each, because there are no 64-bit integers where x64 is off.
"""

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ikjax.maps.kernel.sample import DOUBT, GOALS_PER_WORD, Channel, Goal

COUNT_BITS = 31
"""Bits of an int32 that counts may use; the sign bit stays clear."""


REACHED = {False: "reached", True: "reached.within"}
"""Channels of the goals that are reached, without limits and within them, for certified sweeps of an arm with
redundant joints."""


class Accumulator(NamedTuple):
    """Channels whose numbers are reduced as one number of each goal.

    Only channels of "count" share an accumulator; any other channel has one of its own.
    """

    names: tuple[str, ...]
    """Names of its channels."""
    channels: tuple[Channel, ...]
    widths: tuple[int, ...]
    """Of counts: the bits of each channel, the first lowest. Else empty."""

    @property
    def reduce(self) -> str:
        """The reduction of its channels; they all have the same."""
        return self.channels[0].reduce

    def number_type(self, dtype: np.dtype) -> np.dtype:
        """Type of its numbers, where the kernel's floating type is `dtype`."""
        whole = {"count": np.int32, "sum": np.int32, "bits": np.uint32, "run": np.int32}
        return np.dtype(whole.get(self.reduce, dtype))


class Pass(NamedTuple):
    """Accumulators that share one solution of every goal: one loop over all goals."""

    accumulators: tuple[Accumulator, ...]
    pinned: bool
    """Every value of the kernel is pinned: joints are needed, or it is too large for one fused loop."""
    packs_flags: bool
    """Its channels look at flags alone, and all flags of a goal are read from one number."""
    doubt_name: str | None = None
    """Name of the channel that marks the goals left out of additive channels; None if none is left out."""


def passes_for(
    channels: dict[str, Channel], trials: int, small: bool, certify: bool = False, by_values: bool = False
) -> list[Pass]:
    """The passes over all goals that channels need.

    Channels that look at flags share one pass, channels that need joints another. Of a small kernel, each
    channel that needs margins alone has a pass of its own: a fused loop has one result.

    Args:
        channels: By name.
        trials: Of each goal, at least 1.
        small: The arm's kernel can be one fused loop (`ik.inline.is_small`).
        certify: Leave doubtful goals out of additive channels, and mark them in a channel of bits.
        by_values: A joint is redundant: certifying looks between its values too, where nothing was reached.
    """
    flag_channels, joint_channels, alone = {}, {}, []
    for name, channel in channels.items():
        if channel.pinned or not small:
            joint_channels[name] = channel
        elif channel.reduce in ("count", "bits", "run"):
            flag_channels[name] = channel
        else:
            alone.append(Pass((Accumulator((name,), (channel,), ()),), pinned=False, packs_flags=False))
    passes: list[Pass] = []
    for members, pinned in ((flag_channels, False), (joint_channels, True)):
        doubt_name = None
        if certify and any(channel.is_additive for channel in members.values()):
            doubt_name = f"{DOUBT}.{len(passes)}"
            kinds = {channel.inside for channel in members.values() if channel.any_value}
            members = members | {REACHED[inside]: _reached(inside) for inside in kinds if by_values}
            members = members | {doubt_name: Channel("bits", Goal.doubt)}
        accumulators = tuple(accumulators_for(members, trials))
        # One accumulator alone is cheaper without the packed number.
        packs_flags = not pinned and len(accumulators) > 1
        passes += [Pass(accumulators, pinned, packs_flags, doubt_name)] if accumulators else []
    return passes + alone


def _reached(inside: bool) -> Channel:
    def value(goal: Goal) -> jax.Array:
        return functools.reduce(jnp.logical_or, goal.flags(inside))

    return Channel("bits", value, inside=inside, any_value=True)


def accumulators_for(channels: dict[str, Channel], trials: int) -> list[Accumulator]:
    """Channels packed into accumulators: counts side by side while their bits fit one word.

    The width of a count is that of the greatest sum over `GOALS_PER_WORD` goals with all their trials.
    """
    accumulators: list[Accumulator] = []
    for name, channel in channels.items():
        if channel.reduce != "count":
            accumulators.append(Accumulator((name,), (channel,), ()))
            continue
        greatest = channel.max_per_goal if channel.any_trial else channel.max_per_goal * trials
        width = (GOALS_PER_WORD * greatest).bit_length()
        last = accumulators[-1] if accumulators else None
        if last is not None and last.reduce == "count" and sum(last.widths) + width <= COUNT_BITS:
            accumulators[-1] = Accumulator(
                (*last.names, name), (*last.channels, channel), (*last.widths, width)
            )
        else:
            accumulators.append(Accumulator((name,), (channel,), (width,)))
    return accumulators


def value_per_goal(accumulator: Accumulator, goal: Goal, dtype: np.dtype) -> jax.Array:
    """The accumulator's number of each goal at one trial, (positions, orientations)."""
    if accumulator.reduce != "count":
        value = jnp.broadcast_to(accumulator.channels[0].value(goal), goal.shape)
        return value.astype(accumulator.number_type(dtype))
    packed, shift = jnp.zeros(goal.shape, jnp.int32), 0
    for channel, width in zip(accumulator.channels, accumulator.widths, strict=True):
        packed, shift = packed + (channel.value(goal) << shift), shift + width
    return packed


def before_trials(accumulator: Accumulator, shape: tuple[int, ...], dtype: np.dtype) -> Any:
    """What `add_trial` begins with: of "run" the longest run so far, and the present run of each flag."""
    start = neutral_values(accumulator, shape, dtype)
    return (start,) * (1 + accumulator.channels[0].max_per_goal) if accumulator.reduce == "run" else start


def after_trials(accumulator: Accumulator, total: Any) -> jax.Array:
    """The number of each goal over all trials, of what `add_trial` returned last."""
    return total[0] if accumulator.reduce == "run" else total


def add_trial(accumulator: Accumulator, total: Any, value: jax.Array, is_first: jax.Array) -> Any:
    """What is known of each goal after earlier trials, `total`, and its number at one more, `value`.

    Args:
        accumulator: Says which reduction.
        total: From `before_trials` or from this function.
        value: From `value_per_goal`.
        is_first: A run cannot go on here, because the redundant joint is at its least value.
    """
    if accumulator.reduce == "run":
        longest, *present = total
        # A run that began before is cut by a factor: a choice would be computed for each flag again.
        going_on = jnp.where(is_first, 0, 1)
        present = [(run * going_on + 1) * (value >> k & 1) for k, run in enumerate(present)]
        return functools.reduce(jnp.maximum, present, longest), *present
    if accumulator.reduce in ("max", "min"):
        return (jnp.maximum if accumulator.reduce == "max" else jnp.minimum)(total, value)
    if accumulator.reduce == "bits":
        return total | value
    if accumulator.reduce == "sum":
        return total + value
    # Of packed counts, some fields are added and the others joined by "or".
    added_fields, shift = 0, 0
    for channel, width in zip(accumulator.channels, accumulator.widths, strict=True):
        added_fields |= 0 if channel.any_trial else ((1 << width) - 1) << shift
        shift += width
    added = jnp.int32(added_fields)
    return ((total & added) + (value & added)) | ((total | value) & ~added)


def drop_doubtful(this_pass: Pass, values: tuple[jax.Array, ...]) -> tuple[jax.Array, ...]:
    """The number of each goal, one array an accumulator; of doubtful goals zero in additive channels."""
    if this_pass.doubt_name is None:
        return values
    pairs = list(zip(this_pass.accumulators, values, strict=True))
    doubtful = next(value for acc, value in pairs if this_pass.doubt_name in acc.names) == 1
    unchanged = [this_pass.doubt_name in acc.names or not acc.channels[0].is_additive for acc, _ in pairs]
    return tuple(
        value if keep else jnp.where(doubtful, neutral_values(acc, (), value.dtype), value)
        for keep, (acc, value) in zip(unchanged, pairs, strict=True)
    )


def reduce_tile(accumulator: Accumulator, value: jax.Array, real: jax.Array | None) -> jax.Array:
    """Results of one tile for each position.

    Args:
        accumulator: Says which reduction.
        value: The number of each goal, (positions, orientations); their number is a multiple of 32.
        real: Which orientations exist, bool (1, orientations); None where all of them do.

    Returns:
        (positions, k): one column for "max", "min" and "run", the upper and lower 16 bits of "sum", one
        column for each channel of "count", one word for every 32 orientations of "bits".
    """
    if real is not None:
        value = jnp.where(real, value, neutral_values(accumulator, (), value.dtype))
    if accumulator.reduce in ("max", "min", "run"):
        return (value.min(-1) if accumulator.reduce == "min" else value.max(-1))[:, None]
    words = value.reshape(value.shape[0], -1, GOALS_PER_WORD)
    if accumulator.reduce == "bits":
        bit = jnp.arange(GOALS_PER_WORD, dtype=jnp.uint32).reshape(1, 1, GOALS_PER_WORD)
        return (words << bit).sum(-1, dtype=jnp.uint32)
    sums = words.sum(-1, dtype=jnp.int32)
    if accumulator.reduce == "sum":
        parts = [sums >> 16, sums & 0xFFFF]
    else:
        parts, shift = [], 0
        for width in accumulator.widths:
            parts.append(sums >> shift & ((1 << width) - 1))
            shift += width
    return jnp.stack([part.sum(-1, dtype=jnp.int32) for part in parts], axis=-1)


def empty_results(accumulator: Accumulator, rows: int, orientations: int, dtype: np.dtype) -> jax.Array:
    """Results before the first goal, (rows, k) with the columns of `reduce_tile`."""
    columns = {"max": 1, "min": 1, "run": 1, "sum": 2, "bits": orientations // GOALS_PER_WORD}
    shape = rows, columns.get(accumulator.reduce, len(accumulator.channels))
    return neutral_values(accumulator, shape, dtype)


def neutral_values(accumulator: Accumulator, shape: tuple[int, ...], dtype) -> jax.Array:
    """The neutral element of the reduction, in an array of that shape."""
    neutral = {"max": -np.inf, "min": np.inf}.get(accumulator.reduce, 0)
    return jnp.full(shape, neutral, accumulator.number_type(dtype))


def add_tile(accumulator: Accumulator, total: jax.Array, part: jax.Array, tile) -> jax.Array:
    """Results of earlier tiles of orientations, `total`, with those of one more, `part`.

    Args:
        accumulator: Says which reduction.
        total: (positions, k)
        part: From `reduce_tile`.
        tile: Number of that tile: where its bits go.
    """
    if accumulator.reduce in ("max", "run"):
        return jnp.maximum(total, part)
    if accumulator.reduce == "min":
        return jnp.minimum(total, part)
    if accumulator.reduce == "bits":
        return jax.lax.dynamic_update_slice_in_dim(total, part, tile * part.shape[1], 1)
    return total + part


JOIN_CALLS: dict[str, Callable[[np.ndarray, np.ndarray], np.ndarray]] = {
    "count": np.add,
    "sum": np.add,
    "max": np.maximum,
    "run": np.maximum,
    "min": np.minimum,
    "bits": lambda a, b: np.concatenate([a, b], axis=1),
}
"""How results of two calls for the same positions become one, the earlier orientations first."""
