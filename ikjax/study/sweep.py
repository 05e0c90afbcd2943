"""The sweep: every position with every orientation, unit by unit, in memory or into a store.

Storey: study. A unit's positions are made from its number, and its statistics are integers and maxima, so
the same bits come out for any size of units, in any order, and after any number of interruptions.
"""

import contextlib
import dataclasses
import itertools
import sys
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ikjax.arm.arm import Arm
from ikjax.ik.solve import check_family
from ikjax.solvers.family import TOLERANCE
from ikjax.study import layout, log, spec, store
from ikjax.study.goals import Grid, even_rotations
from ikjax.study.kernel import CALL, statistics_of
from ikjax.study.layout import COUNTS, STATISTICS
from ikjax.study.lock import Lock
from ikjax.study.place import Place
from ikjax.study.reach import ReachMap, Units

MOST_POSITIONS = 2**31
IN_FLIGHT = 2
"""Units that are being written while the next is computed."""

Stop = Callable[[bool], str | None]
"""Asked often, with whether a unit has just ended: why to stop, or None."""


class SweepStoppedError(Exception):
    """A sweep was told to stop; what is stored is whole."""

    def __init__(self, why: str, where: Any, done: int, units: int):
        self.why, self.done, self.units = why, done, units
        rest = f"{where} holds {done} of {units} units; go on with resume=True (--resume)"
        super().__init__(f"stopped: {why}; {rest if where is not None else 'nothing was stored'}")


def sweep(
    arm: Arm,
    positions: Grid,
    orientations,
    *,
    dtype=None,
    statistics: Iterable[str] = STATISTICS,
    out=None,
    resume: bool = False,
    chunk=None,
    progress: bool = False,
    stop: Stop | None = None,
) -> ReachMap:
    """Which of `positions` x `orientations` the arm reaches, in how many ways, how safely.

    Args:
        arm: An arm with a family.
        positions: `ikjax.grid(...)` or `ikjax.around(arm, spacing)`.
        orientations: A number, for that many even ones over all rotations, or rotations (m, 3, 3).
        dtype: float32 or float64 of the kernel; by default the arm's.
        statistics: Which to keep; the four counts come together, the margin is a loop more.
        out: A folder, or a URL that tensorstore knows, where the map is stored unit by unit. A finished
            map there is replaced, an unfinished one only gone on with.
        resume: Go on with what is at `out`: what cannot be read is computed. Start if nothing is there.
        chunk: Positions (3,) of a unit along x, y, z; the numbers do not depend on it.
        progress: Show a bar with rate and time left on stderr.
        stop: Asked after every call, and with True after every unit: a reason to stop, or None.

    Returns:
        A `ReachMap`: counts for every position, exact at each goal up to rounding at folds.

    Raises:
        ValueError: An arm of no family, orientations that are no rotations, another sweep's map to go on
            with, another writer at work.
        FileExistsError: Something at `out` that must not be overwritten.
        StorageError: The store cannot be written; the units before that are whole.
        SweepStoppedError: `stop` gave a reason.
    """
    rotations, dtype, names = _checked(arm, positions, orientations, dtype, statistics)
    study = spec.of_study(arm, positions, rotations, dtype.name, names)
    wanted = _chunk(chunk, positions.shape, len(rotations))
    head = layout.Head(study, spec.of_arm(arm), wanted, "sweeping", 0.0)
    kernel = statistics_of(arm, rotations, dtype, "best_margin" in names)

    def run(sink, todo: list[int], diary: log.Log) -> float:
        return _run(sink, todo, positions, len(rotations), dtype, kernel, progress, stop, diary)

    if out is None:
        memory = _Memory(head)
        seconds = run(memory, list(range(len(memory.units))), log.Log(None))
        return ReachMap(arm, positions, rotations, dtype.name, memory.arrays, seconds)
    place = Place(out)
    fixed = layout.fixed(positions, rotations)
    with Lock(place), log.Log(place.folder) as diary:
        disk = store.begin(place, head, fixed, resume=resume, chunk_given=chunk is not None)
        survey = disk.survey()
        todo = [number for number, good in enumerate(survey.good) if not good]
        units = Units(len(disk.units), sum(survey.good), survey.missing, survey.damaged)
        diary.begun(disk.head, units)
        seconds = run(disk, todo, diary) if todo else disk.head.seconds
        disk.say("complete", seconds)
        diary.line(f"complete, {seconds:.2f} s for the whole at this run's rate")
    return dataclasses.replace(ReachMap.load(out), units=units)


def _checked(arm: Arm, positions: Grid, orientations, dtype, statistics):
    check_family(arm)
    if arm.task.startswith("planar"):
        raise ValueError(
            f"{arm.name} moves in a plane (task {arm.task!r}), so a map in space says nothing of it"
        )
    rotations = _rotations(orientations)
    dtype = np.dtype(arm.dtype if dtype is None else dtype)
    if dtype.name not in TOLERANCE:
        raise ValueError(f"dtype must be float32 or float64, got {dtype}")
    if positions.count > MOST_POSITIONS:
        raise ValueError(
            f"positions must be at most {MOST_POSITIONS:,} in one sweep, got {positions.count:,}"
        )
    if jnp.zeros((), dtype).dtype != dtype:
        raise ValueError(f"dtype {dtype} needs jax_enable_x64")
    statistics = [statistics] if isinstance(statistics, str) else list(statistics)
    if not set(COUNTS) <= set(statistics) <= set(STATISTICS):
        raise ValueError(
            f"statistics must be {', '.join(COUNTS)} and, if wanted, best_margin, got {', '.join(statistics)}"
        )
    return rotations, dtype, tuple(name for name in STATISTICS if name in statistics)


def _rotations(orientations) -> np.ndarray:
    if np.ndim(orientations) == 0:
        return even_rotations(int(orientations))
    rotations = np.asarray(orientations, float)
    if rotations.ndim != 3 or rotations.shape[1:] != (3, 3) or len(rotations) == 0:
        raise ValueError(f"orientations must be a number or rotations (m, 3, 3), got {rotations.shape}")
    gap = np.linalg.norm(np.swapaxes(rotations, 1, 2) @ rotations - np.eye(3), axis=(1, 2))
    bad = ~(gap <= 1e-5) | (np.linalg.det(rotations) < 0)
    if bad.any():
        i = int(np.argmax(bad))
        raise ValueError(f"orientations[{i}] must be a rotation, its R^T R - I has norm {gap[i]:.1g}")
    return rotations


def _chunk(chunk, shape: tuple[int, ...], orientations: int) -> tuple[int, ...]:
    if chunk is None:
        return layout.default_chunk(shape, orientations)
    edges = np.asarray(chunk)
    if edges.shape != (len(shape),) or edges.dtype.kind not in "iu" or (edges < 1).any():
        raise ValueError(f"chunk must be {len(shape)} whole numbers above zero, got {chunk}")
    return tuple(min(int(edge), size) for edge, size in zip(edges, shape, strict=True))


class _Memory:
    """Where the units of a sweep without a store go."""

    def __init__(self, head: layout.Head):
        self.place, self.head = None, head
        self.units = layout.units(head.shape, head.chunk)
        types = {name: np.int32 if name in COUNTS else np.float32 for name in head.spec["statistics"]}
        self.arrays = {name: np.empty(head.shape, kind) for name, kind in types.items()}

    def box(self, number: int) -> tuple[slice, ...]:
        return layout.box(self.units[number], self.head.shape, self.head.chunk)

    def put(self, number: int, values: Mapping[str, np.ndarray]) -> None:
        for name, value in values.items():
            self.arrays[name][self.box(number)] = value

    def settle(self, number: int, futures: None) -> None:
        pass


def _run(
    sink,
    todo: list[int],
    positions: Grid,
    orientations: int,
    dtype: np.dtype,
    kernel: Callable,
    progress: bool,
    stop: Stop | None,
    diary: log.Log,
) -> float:
    """Compute the units `todo` into `sink`; seconds for all units, at the rate of these."""
    boxes = [sink.box(number) for number in todo]
    shapes = [tuple(side.stop - side.start for side in box) for box in boxes]
    sizes = [int(np.prod(shape)) for shape in shapes]
    names = sink.head.spec["statistics"]
    done = len(sink.units) - len(todo)
    writing: deque[tuple[int, Any]] = deque()
    started = time.perf_counter()

    def finish(keep: int) -> None:
        nonlocal done
        while len(writing) > keep:
            sink.settle(*writing.popleft())
            done += 1

    def ask(ended: bool) -> None:
        why = None if stop is None else stop(ended)
        if why is not None:
            finish(0)
            raise SweepStoppedError(why, sink.place, done, len(sink.units))

    points = (positions.part(box).reshape(-1, 3).astype(dtype) for box in boxes)
    try:
        with _bar(positions.count * orientations, sum(sizes) * orientations, progress) as advance:
            rows = _recut(_computed(kernel, points, ask), sizes)
            for number, shape, size, row in zip(todo, shapes, sizes, rows, strict=True):
                columns = dict(zip(STATISTICS, row.T, strict=False))
                if "best_margin" in columns:
                    columns["best_margin"] = np.ascontiguousarray(columns["best_margin"]).view(np.float32)
                values = {name: columns[name].reshape(shape) for name in names}
                writing.append((number, sink.put(number, values)))
                finish(IN_FLIGHT)
                advance(size * orientations)
                diary.progress(done, len(sink.units))
                if number != todo[-1]:
                    ask(True)
    except BaseException:
        # What is under way is settled, so that nothing is written any more when the lock goes.
        with contextlib.suppress(OSError):
            finish(0)
        raise
    finish(0)
    return (time.perf_counter() - started) * positions.count / max(sum(sizes), 1)


def _computed(kernel: Callable, points: Iterable[np.ndarray], ask: Callable) -> Iterator[np.ndarray]:
    """Statistics as one row of 32-bit numbers a position, margins by their bits, call by call."""
    waiting = None
    for batch in _recut(points, itertools.repeat(CALL)):
        # The last call is filled up; what is computed past the end is never looked at.
        full = batch if len(batch) == CALL else np.resize(batch, (CALL, 3))
        # One call is always under way while the one before it is fetched.
        ready, waiting = waiting, kernel(full)
        if ready is not None:
            yield _fetched(ready, ask)
    if waiting is not None:
        yield _fetched(waiting, ask)


def _fetched(result: tuple[Any, ...], ask: Callable) -> np.ndarray:
    while not all(array.is_ready() for array in result):
        ask(False)
        time.sleep(0.001)
    counts, *margin = jax.device_get(result)
    columns = [np.asarray(m, np.float32).view(np.int32)[:, None] for m in margin]
    return np.concatenate([counts, *columns], axis=1)


def _recut(stream: Iterable[np.ndarray], sizes: Iterable[int]) -> Iterator[np.ndarray]:
    """The rows of a stream of arrays, cut anew to `sizes`; the last piece may be short."""
    stream, held, count = iter(stream), [], 0
    for size in sizes:
        while count < size and (piece := next(stream, None)) is not None:
            held.append(piece)
            count += len(piece)
        if count == 0:
            return
        whole = held[0] if len(held) == 1 else np.concatenate(held)
        yield whole[:size]
        held, count = [whole[size:]], max(count - size, 0)


@contextlib.contextmanager
def _bar(goals: int, left: int, show: bool) -> Iterator[Callable[[int], Any]]:
    """A function that moves a bar on."""
    if not show:
        yield lambda _: None
        return
    from tqdm import tqdm

    options: dict[str, Any] = {"unit": " goals", "unit_scale": True, "file": sys.stderr, "mininterval": 0.5}
    with tqdm(total=goals, initial=goals - left, **options) as bar:
        yield bar.update
