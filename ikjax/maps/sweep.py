"""The sweep: every position with every orientation, unit by unit, in memory or into a store.

A unit's positions are made from its number, and its statistics are integers and maxima, so
the same bits come out for any size of units, in any order, and after any number of interruptions.
"""

import contextlib
import dataclasses
import functools
from collections.abc import Callable, Iterable, Mapping

import jax
import jax.numpy as jnp
import numpy as np

from ikjax.arm.arm import Arm
from ikjax.core.tolerances import VALID
from ikjax.ik.solve import check_family
from ikjax.maps import statistics
from ikjax.maps.kernel.program import Kernel, kernel_of
from ikjax.maps.processes import Crew
from ikjax.maps.reach_map import ReachMap, Units
from ikjax.maps.runner import Stop, SweepStoppedError, run
from ikjax.maps.sets.orientations import Orientations, as_orientations
from ikjax.maps.sets.positions import Grid, Shell
from ikjax.maps.sets.surface import Surface
from ikjax.maps.store import log, manifest, store
from ikjax.maps.store.lock import Lock
from ikjax.maps.store.storage import Place

__all__ = ["SweepStoppedError", "sweep"]

MOST_POSITIONS = 2**31
MOST_ROLLS = 1024
CALL_SECONDS, UNIT_SECONDS = 0.5, 60.0
"""About so long a call and a unit of a slow arm take."""


def sweep(
    arm: Arm,
    positions: Grid | Shell | Surface,
    orientations,
    *,
    free_rolls: int = 1,
    dtype=None,
    certify: bool = False,
    statistics: Iterable[str | statistics.Own] = statistics.USUAL,
    out=None,
    resume: bool = False,
    force: bool = False,
    chunk=None,
    progress: bool = False,
    stop: Stop | None = None,
) -> ReachMap:
    """Which of `positions` x `orientations` the arm reaches, in how many ways, how safely.

    Args:
        arm: An arm with a family.
        positions: `ikjax.maps.grid(...)`, `ikjax.maps.around(arm, spacing)`, `ikjax.maps.shell(...)` or
            `ikjax.maps.surface(...)`; on a surface with normals orientations are seen from it.
        orientations: A number, for that many even ones over all rotations; rotations (m, 3, 3);
            `ikjax.maps.hopf(level)` or `ikjax.maps.cone(...)`.
        free_rolls: Where the tool may turn about its own z axis: so many turns of each orientation are tried,
            and it counts as reached if one of them is. Solutions are then those of all turns.
        dtype: float32 or float64 of the kernel; by default the arm's.
        certify: Of a float32 sweep: solve those goals again in float64 of which float32 cannot say for sure
            which solutions there are: near a fold, a singularity or a limit. Counts and masks then are those
            of a float64 sweep wherever the two were compared (`benchmarks/maps.py types`). Means keep the
            rounding of float32, greatest and least values are its own. Needs jax_enable_x64; on a CPU it
            costs about what float64 costs.
        statistics: Which to keep, by name, or as `ikjax.maps.Near(...)` or `ikjax.maps.Measure(...)`: see
            `maps.statistics`. What is not asked for is not computed.
        out: A folder, or a URL that tensorstore knows, where the map is stored unit by unit.
        resume: Go on with what is at `out`: what cannot be read is computed. Start if nothing is there.
        force: Replace a map at `out`; with `resume`, one of another study only.
        chunk: Positions of a unit along each axis; the numbers do not depend on it. By default about a
            second of work, and at most about a minute.
        progress: Show a bar with rate and time left on stderr.
        stop: Asked after every call, and with True after every unit: a reason to stop, or None.

    Returns:
        A `ReachMap`: statistics of every position, exact at each goal up to rounding at folds.

    In a program of several processes (`jax.distributed`) all of them call this with the same arguments, and
    share the units of a map at `out` that all can write to; each then returns the whole map.

    Raises:
        ValueError: An arm of no family, orientations that are no rotations, a statistic of no such name,
            another sweep's map to go on with, another writer at work.
        FileExistsError: Something at `out` that must not be overwritten.
        StorageError: The store cannot be written; the units before that are whole.
        SweepStoppedError: `stop` gave a reason.
    """
    dtype = _checked(arm, positions, free_rolls, dtype, certify)
    # The map keeps the arm that was swept, whatever becomes of arrays that the caller may write to.
    arm = jax.tree.map(lambda leaf: leaf.copy() if isinstance(leaf, np.ndarray) else leaf, arm)
    turns = as_orientations(orientations)
    plan = _plan(arm.astype(dtype), statistics, turns, free_rolls, certify)
    fixed = manifest.fixed(positions, turns)
    study = manifest.of_study(arm, positions, turns, free_rolls, dtype.name, plan.told(), fixed)
    kernel = kernel_of(arm, positions, turns, free_rolls, dtype, plan)
    wanted = _chunk(chunk, positions.shape, turns.count, kernel)
    head = manifest.Head(study, manifest.of_arm(arm), wanted, "sweeping", 0.0)

    def work(sink, todo: list[int], done: int, diary: log.Log) -> float:
        return run(sink, todo, kernel, plan, done=done, progress=progress, stop=stop, diary=diary)

    if out is None:
        memory = _Memory(head, plan)
        seconds = work(memory, list(range(len(memory.units))), 0, log.Log(None))
        return ReachMap(arm, positions, turns, free_rolls, dtype.name, plan.told(), memory.arrays, seconds)
    begin = functools.partial(store.begin, resume=resume, force=force, chunk_given=chunk is not None)
    with _opened(Place(out), head, fixed, begin) as (crew, disk, good, units, diary):
        stop = crew.heeding(stop)
        todo = [number for number, whole in enumerate(good) if not whole]
        seconds = disk.head.seconds
        try:
            if todo:
                seconds = work(disk, crew.share(todo), sum(good), diary) / crew.count
        except BaseException as error:
            crew.end(f"{type(error).__name__}: {error}")
            crew.wait()  # so that nobody writes any more when the lock goes
            raise
        crew.end()
        broken = crew.wait()
        if broken:
            raise SweepStoppedError(broken, disk.place, sum(good) + len(crew.share(todo)), len(good))
        if crew.leads:
            disk.say("complete", seconds)
            diary.line(f"complete, {seconds:.2f} s for the whole at this run's rate")
        crew.meet("complete")
    return dataclasses.replace(ReachMap.load(out), units=units)


@contextlib.contextmanager
def _opened(place: Place, head: manifest.Head, fixed: manifest.Fixed, begin: Callable[..., store.Store]):
    """The store of a sweep, opened by the first process and joined by the others."""
    crew = Crew()
    with contextlib.ExitStack() as stack:
        diary = stack.enter_context(log.Log(place.folder))
        if crew.leads:
            with crew.excuse("begun"):
                stack.enter_context(Lock(place))
                disk = begin(place, head, fixed)
                survey = disk.survey()
            units = Units(len(disk.units), sum(survey.good), survey.missing, survey.damaged)
            diary.begun(disk.head, units)
            bits = np.packbits(survey.good).tobytes().hex()
            crew.tell("begun", {"document": manifest.group(disk.head).decode(), "good": bits, "units": units})
            yield crew, disk, survey.good, units, diary
            return
        said = crew.hear("begun")
        found = manifest.read_group(said["document"].encode())
        if found is None or found.spec != head.spec:
            raise ValueError("the first process sweeps another study")
        disk, units = store.Store(place, found, fixed), Units(*said["units"])
        flags = np.unpackbits(np.frombuffer(bytes.fromhex(said["good"]), np.uint8))[: units.total]
        yield crew, disk, flags.astype(bool).tolist(), units, diary


def _checked(arm: Arm, positions, free_rolls: int, dtype, certify: bool) -> np.dtype:
    check_family(arm)
    if arm.task.startswith("planar"):
        raise ValueError(
            f"{arm.name} moves in a plane (task {arm.task!r}), so a map in space says nothing of it"
        )
    # A class of one's own may place them anyhow, and a map says nothing but the name of the class.
    if type(positions) not in (Grid, Shell, Surface):
        raise ValueError(f"positions must be a grid, a shell or a surface, got {type(positions).__name__}")
    dtype = np.dtype(arm.dtype if dtype is None else dtype)
    if dtype.name not in VALID:
        raise ValueError(f"dtype must be float32 or float64, got {dtype}")
    if positions.count > MOST_POSITIONS:
        raise ValueError(
            f"positions must be at most {MOST_POSITIONS:,} in one sweep, got {positions.count:,}"
        )
    if isinstance(free_rolls, bool) or not isinstance(free_rolls, int) or not 1 <= free_rolls <= MOST_ROLLS:
        raise ValueError(f"free_rolls must be a whole number from 1 to {MOST_ROLLS}, got {free_rolls}")
    if certify and dtype != np.float32:
        raise ValueError(f"certify is for float32 sweeps, got dtype {dtype}, which needs none")
    needed = np.dtype(np.float64) if certify else dtype
    if jnp.zeros((), needed).dtype != needed:
        raise ValueError(f"{'certify' if certify else f'dtype {dtype}'} needs jax_enable_x64")
    return dtype


def _plan(
    arm: Arm, names: Iterable[str | statistics.Own], turns: Orientations, free_rolls: int, certify: bool
) -> statistics.Plan:
    # Solutions of a position are counted in 31 bits.
    most = turns.count * free_rolls * len(arm.branches)
    if most >= 2**31:
        raise ValueError(f"orientations x rolls x branches must be below 2^31, got {most:,}")
    given = [names] if isinstance(names, str | statistics.Own) else names
    plan = statistics.plan(arm, given, turns.count, free_rolls)
    return statistics.certified(plan) if certify else plan


def _chunk(chunk, shape: tuple[int, ...], orientations: int, kernel: Kernel) -> tuple[int, ...]:
    rate = kernel.suit(CALL_SECONDS)
    if chunk is None:
        goals = min(manifest.GOALS, 2.0 ** np.floor(np.log2(UNIT_SECONDS * rate)))
        return manifest.default_chunk(shape, orientations, goals)
    edges = np.asarray(chunk)
    if edges.shape != (len(shape),) or edges.dtype.kind not in "iu" or (edges < 1).any():
        raise ValueError(f"chunk must be {len(shape)} whole numbers above zero, got {chunk}")
    return tuple(min(int(edge), size) for edge, size in zip(edges, shape, strict=True))


class _Memory:
    """Where the units of a sweep without a store go."""

    def __init__(self, head: manifest.Head, plan: statistics.Plan):
        self.place, self.head = None, head
        self.units = manifest.units(head.shape, head.chunk)
        self.arrays = {
            name: np.empty((*head.shape, *(size for _, size in statistic.more)), statistic.dtype)
            for name, statistic in plan.statistics.items()
        }

    def box(self, number: int) -> tuple[slice, ...]:
        return manifest.box(self.units[number], self.head.shape, self.head.chunk)

    def put(self, number: int, values: Mapping[str, np.ndarray]) -> None:
        for name, value in values.items():
            self.arrays[name][self.box(number)] = value

    def settle(self, number: int, futures: None) -> None:
        pass
