"""Doubtful goals of a float32 sweep, solved again in float64.

They were left out of all that is added up; here they are put in. Greatest and least values
stay those of float32.
"""

import dataclasses
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ikjax.arm.arm import Arm
from ikjax.core import vector
from ikjax.core.pose import Pose
from ikjax.core.xla import wide_vectors
from ikjax.maps.kernel.accumulators import Group, words_of
from ikjax.maps.kernel.loop import each_goal, rows_of
from ikjax.maps.kernel.sample import GROUP, Lane
from ikjax.maps.sets.orientations import Orientations
from ikjax.maps.sets.surface import Surface
from ikjax.solvers.pipeline import as_solved

BLOCK = 2**13
"""Goals in one call."""

WIDE = np.dtype(np.float64)


def lanes_of(groups: list[Group]) -> dict[str, Lane]:
    """Those that doubtful goals were left out of."""
    pairs = [
        (name, lane)
        for group in groups
        if group.doubt is not None
        for word in group.words
        for name, lane in zip(word.names, word.lanes, strict=True)
        if lane.added and name != group.doubt
    ]
    return dict(pairs)


def program(arm: Arm, positions, orientations: Orientations, rolls: int, lanes: dict[str, Lane]):
    """From tables, places (BLOCK, axes) and orientations (BLOCK,) to the number of each lane, (BLOCK,)."""
    arm = as_solved(arm.astype(WIDE).baked())
    # A word a lane: their numbers are wanted one by one.
    words = tuple(word for name, lane in lanes.items() for word in words_of({name: lane}, rolls))
    group = Group(words, pinned=True, coded=False)

    def solved(tables, index, turn):
        columns = tuple(index[:, k] for k in range(index.shape[1]))
        place = positions.at(tables[0], columns, jnp, WIDE)
        rotation = orientations.at(tables[1], turn, jnp, WIDE)
        frame = positions.frame_at(tables[0], columns) if isinstance(positions, Surface) else None
        if frame is not None:
            rotation = vector.matmul(frame, rotation)
        numbers = [jnp.broadcast_to(x, (BLOCK,)) for x in (*sum(rotation, ()), *place)]
        goal = Pose(rows_of(numbers[:9]), tuple(numbers[9:]))
        return each_goal(arm, group, goal, rolls, WIDE, (BLOCK,))

    tables = positions.tables(WIDE), orientations.tables(WIDE)
    shapes = jax.tree.map(lambda x: jax.ShapeDtypeStruct(x.shape, x.dtype), tables)
    index = jax.ShapeDtypeStruct((BLOCK, len(positions.shape)), np.int32)
    turn = jax.ShapeDtypeStruct((BLOCK,), np.int32)
    return jax.jit(solved, compiler_options=wide_vectors()).lower(shapes, index, turn).compile()


@dataclasses.dataclass(frozen=True)
class Certifier:
    """Puts doubtful goals in."""

    solved: Callable
    """From `program`."""
    tables: tuple[Any, ...]
    groups: tuple[Group, ...]

    @staticmethod
    def of(solved: Callable, positions, orientations: Orientations, groups: list[Group]) -> "Certifier":
        # As arrays of jax, because threads do not see the caller's settings.
        tables = jax.device_put((positions.tables(WIDE), orientations.tables(WIDE)))
        return Certifier(solved, tables, tuple(group for group in groups if group.doubt is not None))

    def mend(self, totals: dict[str, np.ndarray], index: np.ndarray, first: int) -> None:
        """Add what float64 says of doubtful goals.

        Args:
            totals: Of one call, (n, k) each.
            index: (n, axes) places of its positions.
            first: Its first orientation.
        """
        doubts = [totals[str(group.doubt)] for group in self.groups]
        row, column = _places(np.bitwise_or.reduce(doubts))
        found = self._values(index[row], first + column)
        for group, bits in zip(self.groups, doubts, strict=True):
            mine = bits[row, column // GROUP] >> (column % GROUP).astype(np.uint32) & 1 == 1
            lanes = lanes_of([group])
            for name in lanes:
                _put(totals, name, lanes[name].reduce, row[mine], column[mine], found[name][mine])

    def _values(self, index: np.ndarray, turn: np.ndarray) -> dict[str, np.ndarray]:
        """The number of each lane for each goal."""
        names, count = list(lanes_of(list(self.groups))), len(turn)
        found: list[list[np.ndarray]] = [[] for _ in names]
        # At least one block, so that the types are known.
        for begin in range(0, max(count, 1), BLOCK):
            some = index[begin : begin + BLOCK]
            here, turns = np.zeros((BLOCK, index.shape[1]), np.int32), np.zeros(BLOCK, np.int32)
            here[: len(some)], turns[: len(some)] = some, turn[begin : begin + BLOCK]
            for values, value in zip(found, self.solved(self.tables, here, turns), strict=True):
                values.append(np.asarray(value)[: len(some)])
        return {name: np.concatenate(values) for name, values in zip(names, found, strict=True)}


def _places(bits: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Row and number of every bit that is set, of (n, words)."""
    row, word = np.nonzero(bits)
    which, shift = np.nonzero(bits[row, word][:, None] >> np.arange(GROUP, dtype=np.uint32) & 1)
    return row[which], word[which] * GROUP + shift


def _put(totals: dict[str, np.ndarray], name: str, reduce: str, row, column, value: np.ndarray) -> None:
    """Into the totals of one lane."""
    if reduce == "bits":
        totals[name] = totals[name].copy()
        np.bitwise_or.at(totals[name], (row, column // GROUP), value << (column % GROUP).astype(np.uint32))
    else:
        np.add.at(totals[name], (row, 0), value.astype(np.int64))
