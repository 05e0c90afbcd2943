"""The words of a sweep's loop: numbers of goals added up by bits, by whole numbers, or by the greatest.

Whatever happens to them here gives the same bits in any order. Sums of whole numbers travel
as two halves, because there are no 64-bit integers where x64 is off.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ikjax.maps.kernel.sample import DOUBT, GROUP, Goal, Lane

WORD = 31
"""Bits of a word of counts."""


class Word(NamedTuple):
    """Lanes that share one loop."""

    names: tuple[str, ...]
    lanes: tuple[Lane, ...]
    widths: tuple[int, ...]
    """Of counts: the bits of each."""

    @property
    def reduce(self) -> str:
        return self.lanes[0].reduce

    def kind(self, dtype) -> np.dtype:
        """Type of its numbers, where the kernel's is `dtype`."""
        return np.dtype({"count": np.int32, "sum": np.int32, "bits": np.uint32}.get(self.reduce, dtype))


class Group(NamedTuple):
    """Words that share one solution of every goal."""

    words: tuple[Word, ...]
    pinned: bool
    """Every value is kept: joints are needed, or the kernel is too large for one loop."""
    coded: bool
    """Its words look at flags alone, and these travel as one number."""
    doubt: str | None = None
    """The lane of goals that are left out of what is added up."""


def groups_of(lanes: dict[str, Lane], rolls: int, small: bool, certify: bool = False) -> list[Group]:
    """The loops that lanes need.

    Args:
        lanes: By name.
        rolls: Of each goal.
        small: The arm's kernel can be one fused loop.
        certify: Leave doubtful goals out of what is added up, and say which they are.
    """
    flags, joints, apart = {}, {}, []
    for name, lane in lanes.items():
        if lane.pinned or not small:
            joints[name] = lane
        elif lane.reduce in ("count", "bits"):
            flags[name] = lane
        else:
            apart.append(Group((Word((name,), (lane,), ()),), pinned=False, coded=False))
    groups: list[Group] = []
    for members, pinned in ((flags, False), (joints, True)):
        doubt = None
        if certify and any(lane.added for lane in members.values()):
            doubt = f"{DOUBT}.{len(groups)}"
            members = members | {doubt: Lane("bits", Goal.doubt)}
        words = tuple(words_of(members, rolls))
        # One word alone is cheaper without the number.
        groups += [Group(words, pinned, not pinned and len(words) > 1, doubt)] if words else []
    return groups + apart


def words_of(lanes: dict[str, Lane], rolls: int) -> list[Word]:
    """Lanes packed into words."""
    words: list[Word] = []
    for name, lane in lanes.items():
        if lane.reduce != "count":
            words.append(Word((name,), (lane,), ()))
            continue
        most = lane.most if lane.any_roll else lane.most * rolls
        width = (GROUP * most).bit_length()
        last = words[-1] if words else None
        if last is not None and last.reduce == "count" and sum(last.widths) + width <= WORD:
            words[-1] = Word((*last.names, name), (*last.lanes, lane), (*last.widths, width))
        else:
            words.append(Word((name,), (lane,), (width,)))
    return words


def value_of(word: Word, goal: Goal, dtype) -> jax.Array:
    """The word's number of each goal."""
    if word.reduce != "count":
        return jnp.broadcast_to(word.lanes[0].value(goal), goal.shape).astype(word.kind(dtype))
    code, shift = jnp.zeros(goal.shape, jnp.int32), 0
    for lane, width in zip(word.lanes, word.widths, strict=True):
        code, shift = code + (lane.value(goal) << shift), shift + width
    return code


def over_rolls(word: Word, total: jax.Array, value: jax.Array) -> jax.Array:
    """Numbers of a goal at two rolls in one."""
    if word.reduce in ("max", "min"):
        return (jnp.maximum if word.reduce == "max" else jnp.minimum)(total, value)
    if word.reduce == "bits":
        return total | value
    if word.reduce == "sum":
        return total + value
    added, shift = 0, 0
    for lane, width in zip(word.lanes, word.widths, strict=True):
        added |= 0 if lane.any_roll else ((1 << width) - 1) << shift
        shift += width
    counts = jnp.int32(added)
    return ((total & counts) + (value & counts)) | ((total | value) & ~counts)


def without_doubtful(group: Group, values: tuple[jax.Array, ...]) -> tuple[jax.Array, ...]:
    """The same numbers, of doubtful goals nothing where numbers are added up."""
    if group.doubt is None:
        return values
    found = list(zip(group.words, values, strict=True))
    out = next(value for word, value in found if group.doubt in word.names) == 1
    keeps = [group.doubt in word.names or not word.lanes[0].added for word, _ in found]
    return tuple(
        value if keep else jnp.where(out, blank(word, (), value.dtype), value)
        for keep, (word, value) in zip(keeps, found, strict=True)
    )


def reduced(word: Word, value: jax.Array, real: jax.Array | None) -> jax.Array:
    """Totals of one tile, (positions, k); None where all of it is real."""
    if real is not None:
        value = jnp.where(real, value, blank(word, (), value.dtype))
    if word.reduce in ("max", "min"):
        return (value.max(-1) if word.reduce == "max" else value.min(-1))[:, None]
    groups = value.reshape(value.shape[0], -1, GROUP)
    if word.reduce == "bits":
        bit = jnp.arange(GROUP, dtype=jnp.uint32).reshape(1, 1, GROUP)
        return (groups << bit).sum(-1, dtype=jnp.uint32)
    sums = groups.sum(-1, dtype=jnp.int32)
    if word.reduce == "sum":
        parts = [sums >> 16, sums & 0xFFFF]
    else:
        parts, shift = [], 0
        for width in word.widths:
            parts.append(sums >> shift & ((1 << width) - 1))
            shift += width
    return jnp.stack([part.sum(-1, dtype=jnp.int32) for part in parts], axis=-1)


def start(word: Word, rows: int, orientations: int, dtype) -> jax.Array:
    columns = {"max": 1, "min": 1, "sum": 2, "bits": orientations // GROUP}
    return blank(word, (rows, columns.get(word.reduce, len(word.lanes))), dtype)


def blank(word: Word, shape: tuple[int, ...], dtype) -> jax.Array:
    """Numbers of nothing."""
    nothing = {"max": -np.inf, "min": np.inf}.get(word.reduce, 0)
    return jnp.full(shape, nothing, word.kind(dtype))


def added(word: Word, total: jax.Array, part: jax.Array, tile) -> jax.Array:
    if word.reduce == "max":
        return jnp.maximum(total, part)
    if word.reduce == "min":
        return jnp.minimum(total, part)
    if word.reduce == "bits":
        return jax.lax.dynamic_update_slice_in_dim(total, part, tile * part.shape[1], 1)
    return total + part


JOIN: dict[str, Callable] = {
    "count": np.add,
    "sum": np.add,
    "max": np.maximum,
    "min": np.minimum,
    "bits": lambda a, b: np.concatenate([a, b], axis=1),
}
"""How totals of two calls for the same positions become one, the earlier orientations first."""
