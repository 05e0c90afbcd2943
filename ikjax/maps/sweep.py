"""The sweep: every position with every orientation, unit by unit, in memory or into a store.

A unit's positions are computed from its number, and its statistics are sums of integers and extremes. So the
results have the same bits for any size of units, in any order, and after any number of interruptions.
"""

import contextlib
import dataclasses
import functools
import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import ArrayLike, DTypeLike

from ikjax.arm.arm import Arm
from ikjax.core.tolerances import VALID
from ikjax.ik.redundancy import checked_samples
from ikjax.ik.solve import check_family
from ikjax.maps import statistics
from ikjax.maps.kernel.program import Kernel, kernel_of
from ikjax.maps.processes import Processes
from ikjax.maps.reach_map import ReachMap, Units
from ikjax.maps.runner import Sink, Stop, SweepStoppedError, run_units
from ikjax.maps.sets.orientations import Orientations, as_orientations
from ikjax.maps.sets.positions import Grid, Shell
from ikjax.maps.sets.protocol import NamedArrays, PositionSet
from ikjax.maps.sets.surface import Surface
from ikjax.maps.store import manifest, store
from ikjax.maps.store.lock import Lock
from ikjax.maps.store.log import Log
from ikjax.maps.store.storage import Storage

__all__ = ["SweepStoppedError", "sweep"]

MOST_POSITIONS = 2**31
"""Most positions of one sweep."""
MOST_ROLLS = 1024
"""Most free rolls of a goal."""
REDUNDANCY_SAMPLES = 32
"""Values of a redundant joint by default."""
MOST_TRIALS = 4096
"""Most trials of a goal, rolls times values of redundant joints: means are rounded to coarser units the more
there are."""
CALL_SECONDS, UNIT_SECONDS = 0.5, 60.0
"""Longest duration of a call and of a unit of a slow arm, about."""


def sweep(
    arm: Arm,
    positions: Grid | Shell | Surface,
    orientations: Orientations | int | ArrayLike,
    *,
    free_rolls: int = 1,
    redundancy_samples: int | None = None,
    dtype: DTypeLike | None = None,
    certify: bool = False,
    statistics: str | statistics.Custom | Iterable[str | statistics.Custom] = statistics.USUAL,
    out: str | os.PathLike | None = None,
    resume: bool = False,
    force: bool = False,
    chunk: Sequence[int] | None = None,
    title: str | None = None,
    progress: bool = False,
    stop: Stop | None = None,
) -> ReachMap:
    """Which of `positions` x `orientations` the arm reaches, in how many ways, and how safely.

    Every position is combined with every orientation; each pair is one goal, and is solved in closed form.

    In a program of several processes (`jax.distributed`) all of them call this with the same arguments, and
    share the units of a map at `out` that all can write to; each then returns the whole map.

    Args:
        arm: An arm with a family whose task is not planar.
        positions: `ikjax.maps.grid(...)`, `ikjax.maps.around(arm, spacing)`, `ikjax.maps.shell(...)` or
            `ikjax.maps.surface(...)` [m], world frame. On a surface with normals, orientations are given in
            the frame of the surface.
        orientations: A number, for that many even ones over all rotations; rotations (m, 3, 3);
            `ikjax.maps.hopf(level)` or `ikjax.maps.cone(...)`.
        free_rolls: From 1 to 1024. Where the tool may turn about its own z axis: so many turns of each
            orientation are tried, and it counts as reached if one of them is. Solutions are then those of all
            turns.
        redundancy_samples: Of an arm with redundant joints: so many values of each are tried, 32 by default,
            the middles of equal parts of its range (its limits, or a turn). A goal counts as reached if one
            of them reaches it, so what lies between two values may be missed, unless `certify` is on.
            Statistics are over all of them, as `maps.statistics` says.
        dtype: float32 or float64 of the kernel; by default the arm's.
        certify: For a float32 sweep: goals for which float32 cannot decide which solutions exist (near a
            fold, a singularity or a limit) are solved again in float64. Counts and masks then are those of a
            float64 sweep wherever the two were compared (`benchmarks/maps.py types`). Means keep the rounding
            of float32; greatest and least values are those of float32. Needs jax_enable_x64; on a CPU it
            costs about as much as float64. Where one joint is redundant, goals that none of its values
            reaches are searched between them, so that "not reached" is said of the whole range: `reachable`,
            `mask` and their twins within limits count these too, all other statistics are of the values
            alone. It is a search by the clearances at twice as many values (64 at least), and takes longer
            than the sweep: some 5,000 goals that are not reached a second on one core.
        statistics: Which to compute, by name, or as `ikjax.maps.Near(...)` or `ikjax.maps.Measure(...)`: see
            `maps.statistics`. No others are computed.
        out: A folder, or a URL that tensorstore knows, where the map is stored unit by unit. By default the
            map is in memory alone.
        resume: Resume the map at `out`: units that cannot be read are computed. Start if nothing is there.
        force: Replace a map at `out`; with `resume`, only one that cannot be resumed.
        chunk: Positions of a unit along each axis; the numbers do not depend on it. By default about a
            second of work, and at most about a minute.
        title: What tells this map from others of the arm, for pictures and pages: "long drill". The numbers
            do not depend on it.
        progress: Show a bar with rate and remaining time on stderr.
        stop: Asked after every call, and with True after every unit; returns a reason to stop, or None.

    Returns:
        A `ReachMap`: statistics of every position, exact at each goal up to rounding at folds.

    Raises:
        ValueError: An arm without a family, orientations that are no rotations, an unknown statistic, a map
            at `out` that cannot be resumed, or another process that writes to it.
        FileExistsError: Something at `out` that must not be overwritten.
        StorageError: The store cannot be written; the units before that are whole.
        SweepStoppedError: `stop` gave a reason.
    """
    kernel_dtype = _checked_dtype(arm, positions, dtype, certify)
    samples = _checked_trials(arm, free_rolls, redundancy_samples)
    # A copy, because the map keeps the arm that was swept, and the caller may write to these arrays.
    arm = jax.tree.map(lambda leaf: leaf.copy() if isinstance(leaf, np.ndarray) else leaf, arm)
    turns = as_orientations(orientations)
    plan = _plan(arm.astype(kernel_dtype), statistics, turns, (free_rolls, samples), certify)
    study = ReachMap(
        arm,
        positions,
        turns,
        free_rolls,
        kernel_dtype.name,
        plan.specs(),
        arrays={},
        seconds=0.0,
        redundancy_samples=samples,
        title=title or "",
    )
    spec, fixed = manifest.describe(study)
    kernel = kernel_of(study, plan)
    unit_chunk = _unit_chunk(chunk, positions.shape, turns.count, kernel)
    head = manifest.Head(spec, manifest.arm_spec(arm), unit_chunk, "sweeping", 0.0, study.title)

    def compute(sink: Sink, todo: list[int], done: int, log: Log) -> float:
        return run_units(sink, todo, kernel, plan, done=done, progress=progress, stop=stop, log=log)

    if out is None:
        memory = _MemorySink(head, plan)
        seconds = compute(memory, list(range(len(memory.units))), 0, Log(None))
        return dataclasses.replace(study, arrays=memory.arrays, seconds=seconds)
    begin = functools.partial(store.begin, resume=resume, force=force, chunk_given=chunk is not None)
    with _opened_store(Storage(out), head, fixed, begin) as (processes, disk, good, units, log):
        stop = processes.stop_with_others(stop)
        todo = [number for number, whole in enumerate(good) if not whole]
        seconds = disk.head.seconds
        try:
            if todo:
                seconds = compute(disk, processes.own_units(todo), sum(good), log) / processes.count
        except BaseException as error:
            processes.publish_end(f"{type(error).__name__}: {error}")
            processes.wait_for_all()  # so that nobody writes any more when the lock is released
            raise
        processes.publish_end()
        failure = processes.wait_for_all()
        if failure:
            done = sum(good) + len(processes.own_units(todo))
            raise SweepStoppedError(failure, disk.storage, done, len(good))
        if processes.is_first:
            disk.write_state("complete", seconds)
            log.line(f"complete, {seconds:.2f} s for the whole at this run's rate")
        processes.wait_for_first("complete")
    return dataclasses.replace(ReachMap.load(out), units=units)


@contextlib.contextmanager
def _opened_store(
    storage: Storage, head: manifest.Head, fixed: NamedArrays, begin: Callable[..., store.Store]
) -> Iterator[tuple[Processes, store.Store, list[bool], Units, Log]]:
    """The store of a sweep, opened by the first process and joined by the others.

    Args:
        storage: Where.
        head: The spec and chunk wanted.
        fixed: The arrays besides the statistics.
        begin: `store.begin` with its options.

    Yields:
        The processes, the store, whether each unit is stored already, what was found, and the log.
    """
    processes = Processes()
    with contextlib.ExitStack() as stack:
        log = stack.enter_context(Log(storage.folder))
        if processes.is_first:
            with processes.publishing_errors("begun"):
                stack.enter_context(Lock(storage))
                disk = begin(storage, head, fixed)
                survey = disk.survey()
            units = Units(len(disk.units), sum(survey.good), survey.missing, survey.damaged)
            log.write_start(disk.head, units)
            bits = np.packbits(survey.good).tobytes().hex()
            document = manifest.group_document(disk.head).decode()
            processes.publish("begun", {"document": document, "good": bits, "units": units})
            yield processes, disk, survey.good, units, log
            return
        begun = processes.fetch("begun")
        first_head = manifest.read_group(begun["document"].encode())
        if first_head is None or first_head.spec != head.spec:
            raise ValueError("the first process sweeps another study")
        disk, units = store.Store(storage, first_head, fixed), Units(*begun["units"])
        good = np.unpackbits(np.frombuffer(bytes.fromhex(begun["good"]), np.uint8))[: units.total]
        yield processes, disk, good.astype(bool).tolist(), units, log


def _checked_dtype(arm: Arm, positions: PositionSet, dtype: DTypeLike | None, certify: bool) -> np.dtype:
    """The kernel's floating type; raises ValueError where an argument of the sweep is out of range."""
    check_family(arm)
    if arm.task.startswith("planar"):
        raise ValueError(
            f"{arm.name} moves in a plane (task {arm.task!r}), so a map in space says nothing of it"
        )
    # A derived class may place its positions elsewhere, and a spec has nothing but the name of the class.
    if type(positions) not in (Grid, Shell, Surface):
        raise ValueError(f"positions must be a grid, a shell or a surface, got {type(positions).__name__}")
    kernel_dtype = np.dtype(arm.dtype if dtype is None else dtype)
    if kernel_dtype.name not in VALID:
        raise ValueError(f"dtype must be float32 or float64, got {kernel_dtype}")
    if positions.count > MOST_POSITIONS:
        raise ValueError(
            f"positions must be at most {MOST_POSITIONS:,} in one sweep, got {positions.count:,}"
        )
    if certify and kernel_dtype != np.float32:
        raise ValueError(f"certify is for float32 sweeps, got dtype {kernel_dtype}, which needs none")
    needed = np.dtype(np.float64) if certify else kernel_dtype
    if jnp.zeros((), needed).dtype != needed:
        raise ValueError(f"{'certify' if certify else f'dtype {kernel_dtype}'} needs jax_enable_x64")
    return kernel_dtype


def _checked_trials(arm: Arm, free_rolls: int, redundancy_samples: int | None) -> int:
    """Values of each redundant joint; raises ValueError where there are too many trials, or none."""
    if isinstance(free_rolls, bool) or not isinstance(free_rolls, int) or not 1 <= free_rolls <= MOST_ROLLS:
        raise ValueError(f"free_rolls must be a whole number from 1 to {MOST_ROLLS}, got {free_rolls}")
    samples = checked_samples(arm, redundancy_samples, REDUNDANCY_SAMPLES)
    trials = free_rolls * samples ** len(arm.locked)
    if trials > MOST_TRIALS:
        raise ValueError(
            f"free_rolls x redundancy_samples must be at most {MOST_TRIALS:,} (samples of each of "
            f"{len(arm.locked)} redundant joints), got {trials:,}"
        )
    return samples


def _plan(
    arm: Arm,
    names: str | statistics.Custom | Iterable[str | statistics.Custom],
    turns: Orientations,
    trials: tuple[int, int],
    certify: bool,
) -> statistics.Plan:
    """The statistics of a sweep, and their channels; `trials` are rolls, and values of a redundant joint."""
    # Solutions of a position are counted in 31 bits.
    most = turns.count * trials[0] * trials[1] ** len(arm.locked) * len(arm.branches)
    if most >= 2**31:
        values = " x values of redundant joints" if arm.locked else ""
        raise ValueError(f"orientations x rolls{values} x branches must be below 2^31, got {most:,}")
    wanted = [names] if isinstance(names, str | statistics.Custom) else names
    plan = statistics.plan(arm, wanted, turns.count, *trials)
    return statistics.certified(plan, len(arm.locked) == 1) if certify else plan


def _unit_chunk(
    chunk: Sequence[int] | None, shape: tuple[int, ...], orientations: int, kernel: Kernel
) -> tuple[int, ...]:
    """The chunk asked for, or one that suits the measured rate; the calls of the kernel are tuned too."""
    rate = kernel.tune_calls(CALL_SECONDS)
    if chunk is None:
        goals = min(manifest.UNIT_GOALS, 2.0 ** np.floor(np.log2(UNIT_SECONDS * rate)))
        return manifest.default_chunk(shape, orientations, goals)
    edges = np.asarray(chunk)
    if edges.shape != (len(shape),) or edges.dtype.kind not in "iu" or (edges < 1).any():
        raise ValueError(f"chunk must be {len(shape)} whole numbers above zero, got {chunk}")
    return tuple(min(int(edge), size) for edge, size in zip(edges, shape, strict=True))


class _MemorySink:
    """Where the units of a sweep without a store go: arrays in memory."""

    def __init__(self, head: manifest.Head, plan: statistics.Plan):
        self.storage, self.head = None, head
        self.units = manifest.unit_indices(head.shape, head.chunk)
        self.arrays = {
            name: np.empty((*head.shape, *(size for _, size in statistic.extra_axes)), statistic.dtype)
            for name, statistic in plan.statistics.items()
        }

    def box(self, number: int) -> tuple[slice, ...]:
        return manifest.unit_box(self.units[number], self.head.shape, self.head.chunk)

    def put(self, number: int, values: Mapping[str, np.ndarray]) -> None:
        for name, value in values.items():
            self.arrays[name][self.box(number)] = value

    def settle(self, number: int, futures: None) -> None:
        pass
