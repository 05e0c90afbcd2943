"""Doubtful goals of a float32 sweep, solved again in float64.

The float32 loop leaves them out of every additive channel; here they are put in. Greatest and least values
stay those of float32.

Where one joint is redundant, goals that none of its values reaches are searched between them (`between`).
"""

import dataclasses
import functools
import math
from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np

from ikjax.arm.arm import Arm
from ikjax.arm.forward import reach
from ikjax.core import vector
from ikjax.core.pose import Pose
from ikjax.core.xla import divider, pinning, wide_vectors
from ikjax.ik.quality import joint_clearances
from ikjax.ik.redundancy import with_ends
from ikjax.maps.kernel import between
from ikjax.maps.kernel.accumulators import REACHED, Pass, accumulators_for
from ikjax.maps.kernel.flags import slot_within_limits
from ikjax.maps.kernel.loop import each_goal, rolled_by, rows_of, trials_of
from ikjax.maps.kernel.sample import GOALS_PER_WORD, Channel
from ikjax.maps.sets.protocol import OrientationSet, PositionSet, Tables
from ikjax.maps.sets.surface import Surface
from ikjax.maps.store import manifest
from ikjax.solvers.pipeline import Slot, as_solved, solve_scalars

BLOCK = 2**13
"""Goals in one call."""

LEAST_SAMPLES = 64
"""Values of the redundant joint between which goals are searched; twice the sweep's if that is more."""

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
    arm = as_solved(study.arm.astype(WIDE).baked())
    trials = trials_of(arm, study.free_rolls, study.redundancy_samples)
    # An accumulator for each channel: their numbers are wanted one by one.
    accumulators = [
        acc for name, channel in channels.items() for acc in accumulators_for({name: channel}, trials.number)
    ]
    one_pass = Pass(tuple(accumulators), pinned=True, packs_flags=False)

    def solved(tables, index, turn):
        goal = _goal_at(study, tables, index, turn)
        return each_goal(arm, one_pass, goal, trials, WIDE, (BLOCK,))

    return _compiled(solved, study, BLOCK)


def _goal_at(study: manifest.Study, tables, index: jax.Array, turn: jax.Array) -> Pose:
    """Goals at places (n, axes) with orientations (n,): T_world_tool in scalars, (n,) each."""
    positions, orientations = study.positions, study.orientations
    columns = tuple(index[:, k] for k in range(index.shape[1]))
    place = positions.at(tables[0], columns, jnp, WIDE)
    rotation = orientations.at(tables[1], turn, jnp, WIDE)
    frame = positions.frame_at(tables[0], columns) if isinstance(positions, Surface) else None
    if frame is not None:
        rotation = vector.matmul(frame, rotation)
    numbers = [jnp.broadcast_to(x, turn.shape) for x in (*sum(rotation, ()), *place)]
    return Pose(rows_of(numbers[:9]), tuple(numbers[9:]))


def _compiled(f: Callable, study: manifest.Study, rows: int, *further: jax.ShapeDtypeStruct) -> Callable:
    """The program of f(tables, places (rows, axes), orientations (rows,), ...)."""
    tables = study.positions.tables(WIDE), study.orientations.tables(WIDE)
    shapes = jax.tree.map(lambda x: jax.ShapeDtypeStruct(x.shape, x.dtype), tables)
    index = jax.ShapeDtypeStruct((rows, len(study.positions.shape)), np.int32)
    turn = jax.ShapeDtypeStruct((rows,), np.int32)
    return jax.jit(f, compiler_options=wide_vectors()).lower(shapes, index, turn, *further).compile()


@dataclasses.dataclass(frozen=True)
class Between:
    """Searches goals that no sampled value of the redundant joint reaches."""

    program: Callable
    """Of tables, places, orientations, turns about the tool (ROWS,) [rad] and values (ROWS, WIDTH): levels
    and flags, as `between.Evaluate` returns them, a kind for each entry of `kinds`."""
    kinds: tuple[bool, ...]
    """What counts: whether slots have to be within the limits."""
    samples: np.ndarray
    """(m,) values of the redundant joint."""
    rolls: int
    """Turns of each goal about the tool's axis, of which one has to be reached."""

    @staticmethod
    def of(study: manifest.Study, channels: dict[str, Channel]) -> "Between | None":
        """What searches between the samples of a sweep; None unless one joint is redundant.

        Args:
            study: Arm, sets and trials.
            channels: From `certified_channels`.
        """
        arm = as_solved(study.arm.astype(WIDE).baked())
        kinds = tuple(inside for inside, name in REACHED.items() if name in channels)
        if len(arm.locked) != 1 or not kinds:
            return None
        least = max(LEAST_SAMPLES, 2 * study.redundancy_samples)
        count = -(-least // between.WIDTH) * between.WIDTH
        shapes = (between.ROWS,), (between.ROWS, between.WIDTH)
        further = [jax.ShapeDtypeStruct(shape, WIDE) for shape in shapes]
        program = _compiled(functools.partial(_levels, study, arm, kinds), study, between.ROWS, *further)
        return Between(program, kinds, np.asarray(with_ends(arm, count, WIDE)), study.free_rolls)

    def reached(self, tables, index: np.ndarray, turn: np.ndarray, wanted: np.ndarray) -> np.ndarray:
        """Whether goals are reached at some value, (n, kinds) bool.

        Args:
            tables: What both sets look up.
            index: (n, axes) places of the goals.
            turn: (n,) their orientations.
            wanted: (n, kinds) bool, of which goals that is asked.
        """
        found = np.zeros(wanted.shape, bool)
        for roll in range(self.rolls):
            angle = np.full(between.ROWS, 2 * math.pi * roll / self.rolls)

            def evaluate(goals, values, angle=angle):
                given = index[goals], turn[goals], values
                pad = between.ROWS - len(goals)
                places, turns, at = (np.pad(x, [(0, pad)] + [(0, 0)] * (x.ndim - 1)) for x in given)
                numbers = self.program(tables, places, turns.astype(np.int32), angle, at)
                return tuple(
                    np.moveaxis(np.asarray(x)[..., : len(goals), :], (0, 1), (3, 2)) for x in numbers
                )

            found |= between.is_reached(evaluate, wanted & ~found, self.samples)
        return found


def _levels(study: manifest.Study, arm: Arm, kinds: tuple[bool, ...], tables, index, turn, angle, values):
    """Levels and flags of the slots of goals, (kinds, slots, n, WIDTH) each: see `Between.program`."""
    goal = _goal_at(study, tables, index, turn)
    goal = Pose(rolled_by(goal.rotation, jnp.cos(angle), jnp.sin(angle)), goal.position)
    goal = jax.tree.map(lambda x: jnp.broadcast_to(x[:, None], values.shape), goal)
    policy = divider(values)
    with pinning(policy):
        slots = solve_scalars(arm, goal, free=(values,))
    size = reach(arm)

    def of_slot(slot: Slot, inside: bool) -> tuple[jax.Array, jax.Array]:
        level = policy(slot.margin) / size
        if not inside:
            return level, slot.valid
        spare = joint_clearances(arm, tuple(map(policy, slot.q)))
        level = functools.reduce(jnp.minimum, [spare[i] for i in arm.solved], level)
        return level, slot.valid & slot_within_limits(arm, slot)

    rows = [zip(*(of_slot(slot, inside) for slot in slots), strict=True) for inside in kinds]
    levels, counts = zip(*rows, strict=True)
    return tuple(jnp.stack([jnp.stack(row) for row in each]) for each in (levels, counts))


@dataclasses.dataclass(frozen=True)
class Certifier:
    """Solves doubtful goals again and adds them to the results of a call."""

    program: Callable
    """From `certifying_program`."""
    tables: tuple[Tables, Tables]
    """What both sets look up, in float64."""
    passes: tuple[Pass, ...]
    """Those that leave doubtful goals out."""
    orientations: int
    """Their number."""
    between: Between | None = None
    """Searches goals between the values of a redundant joint."""

    @staticmethod
    def of(
        programs: tuple[Callable, Between | None],
        positions: PositionSet,
        orientations: OrientationSet,
        passes: list[Pass],
    ) -> "Certifier":
        """The certifier of compiled programs, its sets, and the passes of the float32 loop."""
        # As jax arrays, because other threads do not see the caller's settings.
        tables = jax.device_put((positions.tables(WIDE), orientations.tables(WIDE)))
        doubting = tuple(each for each in passes if each.doubt_name is not None)
        return Certifier(programs[0], tables, doubting, orientations.count, programs[1])

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
            mine = _bits_at(bits, row, column)
            channels = certified_channels([this_pass])
            for name, channel in channels.items():
                _add_values(results, name, channel.reduce, row[mine], column[mine], values[name][mine])

    def add_between(self, results: dict[str, np.ndarray], index: np.ndarray, first: int) -> None:
        """Add the goals that are reached between two values of the redundant joint, in place.

        Arguments as in `add_doubtful`, which comes first.
        """
        if self.between is None:
            return
        kinds, channels = self.between.kinds, certified_channels(list(self.passes))
        missed = [~results[REACHED[inside]] for inside in kinds]
        row, column = _set_bits(functools.reduce(np.bitwise_or, missed))
        real = first + column < self.orientations
        row, column = row[real], column[real]
        wanted = np.stack([_bits_at(bits, row, column) for bits in missed], 1)
        found = self.between.reached(self.tables, index[row], first + column, wanted)
        some = found.any(1)
        row, column, found = row[some], column[some], found[some]
        values = self._values(index[row], first + column)
        for inside, new in zip(kinds, found.T, strict=True):
            for name, channel in channels.items():
                if channel.any_value and channel.inside == inside:
                    # What is one already, by the samples alone, stays so.
                    more = (1 - values[name][new].astype(np.int64)).astype(np.uint32)
                    _add_values(results, name, channel.reduce, row[new], column[new], more)

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


def _bits_at(bits: np.ndarray, row: np.ndarray, column: np.ndarray) -> np.ndarray:
    """The bits of (n, words) uint32 at rows (m,) and bit numbers (m,), bool."""
    shift = (column % GOALS_PER_WORD).astype(np.uint32)
    return bits[row, column // GOALS_PER_WORD] >> shift & 1 == 1


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
