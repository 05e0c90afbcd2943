"""The words of a sweep's loop: numbers of goals added up by bits, by whole numbers, or by the greatest.

Storey: study. Whatever happens to them here gives the same bits in any order. Sums of whole numbers travel
as two halves, because there are no 64-bit integers where x64 is off.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ikjax.study.goal import GROUP, Lane

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

    @property
    def held(self) -> bool:
        return self.lanes[0].held


def words_of(lanes: dict[str, Lane], rolls: int) -> list[Word]:
    """The loops that lanes need."""
    words: list[Word] = []
    open_words: dict[bool, Word] = {}
    for name, lane in lanes.items():
        open_word = open_words.get(lane.held)
        if lane.reduce != "count":
            words.append(Word((name,), (lane,), ()))
            continue
        most = lane.most if lane.any_roll else lane.most * rolls
        width = (GROUP * most).bit_length()
        if open_word is not None and sum(open_word.widths) + width <= WORD:
            merged = Word((*open_word.names, name), (*open_word.lanes, lane), (*open_word.widths, width))
            words[words.index(open_word)] = open_words[lane.held] = merged
        else:
            words.append(Word((name,), (lane,), (width,)))
            open_words[lane.held] = words[-1]
    return words


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
