"""Doubtful goals of a float32 sweep, solved again in float64.

The float32 loop leaves them out of every additive channel; here they are put in. Greatest and least values
stay those of float32.
"""

import dataclasses
from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np

from ikjax.core import vector
from ikjax.core.pose import Pose
from ikjax.core.xla import wide_vectors
from ikjax.maps.kernel.accumulators import Pass, accumulators_for
from ikjax.maps.kernel.loop import each_goal, rows_of, trials_of
from ikjax.maps.kernel.sample import GOALS_PER_WORD, Channel
from ikjax.maps.sets.protocol import OrientationSet, PositionSet, Tables
from ikjax.maps.sets.surface import Surface
from ikjax.maps.store import manifest
from ikjax.solvers.pipeline import as_solved

BLOCK = 2**13
"""Goals in one call."""

WIDE = np.dtype(np.float64)


def certified_channels(passes: list[Pass]) -> dict[str, Channel]:
    """The channels that doubtful goals were left out of, by name."""
    pairs = [
        (name, channel)
        for this_pass in passes
        if this_pass.doubt_name is not None
        for accumulator in this_pass.accumulators
        for name, channel in zip(accumulator.names, accumulator.channels, strict=True)
        if channel.is_additive and name != this_pass.doubt_name
    ]
    return dict(pairs)


def certifying_program(study: manifest.Study, channels: dict[str, Channel]) -> Callable:
    """A compiled program that solves single goals in float64.

    Its inputs are the tables of both sets, places (BLOCK, axes) int32 and orientations (BLOCK,) int32. It
    returns the number of each channel, (BLOCK,) each, in the order of `channels`.

    Args:
        study: Arm, sets and trials.
        channels: From `certified_channels`.
    """
    positions, orientations = study.positions, study.orientations
    arm = as_solved(study.arm.astype(WIDE).baked())
    trials = trials_of(arm, study.free_rolls, study.redundancy_samples)
    # An accumulator for each channel: their numbers are wanted one by one.
    accumulators = [
        acc for name, channel in channels.items() for acc in accumulators_for({name: channel}, trials.number)
    ]
    one_pass = Pass(tuple(accumulators), pinned=True, packs_flags=False)

    def solved(tables, index, turn):
        columns = tuple(index[:, k] for k in range(index.shape[1]))
        place = positions.at(tables[0], columns, jnp, WIDE)
        rotation = orientations.at(tables[1], turn, jnp, WIDE)
        frame = positions.frame_at(tables[0], columns) if isinstance(positions, Surface) else None
        if frame is not None:
            rotation = vector.matmul(frame, rotation)
        numbers = [jnp.broadcast_to(x, (BLOCK,)) for x in (*sum(rotation, ()), *place)]
        goal = Pose(rows_of(numbers[:9]), tuple(numbers[9:]))
        return each_goal(arm, one_pass, goal, trials, WIDE, (BLOCK,))

    tables = positions.tables(WIDE), orientations.tables(WIDE)
    shapes = jax.tree.map(lambda x: jax.ShapeDtypeStruct(x.shape, x.dtype), tables)
    index = jax.ShapeDtypeStruct((BLOCK, len(positions.shape)), np.int32)
    turn = jax.ShapeDtypeStruct((BLOCK,), np.int32)
    return jax.jit(solved, compiler_options=wide_vectors()).lower(shapes, index, turn).compile()


@dataclasses.dataclass(frozen=True)
class Certifier:
    """Solves doubtful goals again and adds them to the results of a call."""

    program: Callable
    """From `certifying_program`."""
    tables: tuple[Tables, Tables]
    """What both sets look up, in float64."""
    passes: tuple[Pass, ...]
    """Those that leave doubtful goals out."""

    @staticmethod
    def of(
        program: Callable, positions: PositionSet, orientations: OrientationSet, passes: list[Pass]
    ) -> "Certifier":
        """The certifier of a compiled program, its sets, and the passes of the float32 loop."""
        # As jax arrays, because other threads do not see the caller's settings.
        tables = jax.device_put((positions.tables(WIDE), orientations.tables(WIDE)))
        return Certifier(program, tables, tuple(each for each in passes if each.doubt_name is not None))

    def add_doubtful(self, results: dict[str, np.ndarray], index: np.ndarray, first: int) -> None:
        """Add what float64 says of doubtful goals to the results of one call, in place.

        Args:
            results: From `Kernel.accumulate`, (n, k) each; those of doubts say which goals.
            index: (n, axes) places of its positions.
            first: Its first orientation.
        """
        doubts = [results[str(this_pass.doubt_name)] for this_pass in self.passes]
        row, column = _set_bits(np.bitwise_or.reduce(doubts))
        values = self._values(index[row], first + column)
        for this_pass, bits in zip(self.passes, doubts, strict=True):
            shift = (column % GOALS_PER_WORD).astype(np.uint32)
            mine = bits[row, column // GOALS_PER_WORD] >> shift & 1 == 1
            channels = certified_channels([this_pass])
            for name, channel in channels.items():
                _add_values(results, name, channel.reduce, row[mine], column[mine], values[name][mine])

    def _values(self, index: np.ndarray, turn: np.ndarray) -> dict[str, np.ndarray]:
        """The number of each channel for goals at places (m, axes) with orientations (m,), (m,) each."""
        names, count = list(certified_channels(list(self.passes))), len(turn)
        blocks: list[list[np.ndarray]] = [[] for _ in names]
        # At least one block, so that the types are known where no goal is doubtful.
        for begin in range(0, max(count, 1), BLOCK):
            part = index[begin : begin + BLOCK]
            places, turns = np.zeros((BLOCK, index.shape[1]), np.int32), np.zeros(BLOCK, np.int32)
            places[: len(part)], turns[: len(part)] = part, turn[begin : begin + BLOCK]
            for values, value in zip(blocks, self.program(self.tables, places, turns), strict=True):
                values.append(np.asarray(value)[: len(part)])
        return {name: np.concatenate(values) for name, values in zip(names, blocks, strict=True)}


def _set_bits(bits: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Row and bit number of every bit that is set in (n, words) uint32."""
    row, word = np.nonzero(bits)
    which, shift = np.nonzero(bits[row, word][:, None] >> np.arange(GOALS_PER_WORD, dtype=np.uint32) & 1)
    return row[which], word[which] * GOALS_PER_WORD + shift


def _add_values(
    results: dict[str, np.ndarray],
    name: str,
    reduce: str,
    row: np.ndarray,
    column: np.ndarray,
    value: np.ndarray,
) -> None:
    """Add the numbers of goals to the results of one channel.

    Args:
        results: From `Kernel.accumulate`; that of `name` is changed.
        name: Of the channel.
        reduce: Its reduction, an additive one.
        row: (m,) the goals' positions.
        column: (m,) the goals' orientations, counted from the first of the call.
        value: (m,) the goals' numbers.
    """
    if reduce == "bits":
        results[name] = results[name].copy()
        shift = (column % GOALS_PER_WORD).astype(np.uint32)
        np.bitwise_or.at(results[name], (row, column // GOALS_PER_WORD), value << shift)
    else:
        np.add.at(results[name][:, 0], row, value.astype(np.int64))
