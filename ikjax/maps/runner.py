"""The work of a sweep: units in, their statistics out. Every thread runs a call while a result is fetched.

Positions are cut into calls whatever the size of units; the bits of a position depend on nothing but the
position.
"""

import contextlib
import itertools
import sys
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future
from typing import Any, Protocol

import numpy as np

from ikjax.ik.batched import THREADS, pool
from ikjax.maps.kernel.loop import POSITIONS
from ikjax.maps.kernel.program import Kernel
from ikjax.maps.statistics import Plan
from ikjax.maps.store.log import Log
from ikjax.maps.store.manifest import Head

IN_FLIGHT = 2
"""Units that may still be being written while the next is computed."""

AHEAD = THREADS + 1
"""Calls that run or wait for a thread while the result of the first of them is fetched."""

Stop = Callable[[bool], str | None]
"""Asked often, with whether a unit has just ended; returns a reason to stop, or None."""


class Sink(Protocol):
    """Where units go: a store, or arrays in memory."""

    storage: Any
    """Its `str` names it; None in memory."""
    head: Head
    units: list[tuple[int, ...]]
    """Index of each unit among the chunks."""

    def box(self, number: int) -> tuple[slice, ...]:
        """The positions of the unit of that number, a slice along each axis."""

    def put(self, number: int, values: dict[str, np.ndarray]) -> Any:
        """Begin to write a unit's statistics, (*shape of the unit, ...) each; the result is for `settle`."""

    def settle(self, number: int, futures: Any) -> None:
        """Wait until the unit is written."""


class SweepStoppedError(Exception):
    """A sweep was told to stop; what is stored is whole.

    Its fields: `why`, the reason given; `done`, the units that are stored, of `units`.
    """

    def __init__(self, why: str, where: Any, done: int, units: int):
        self.why, self.done, self.units = why, done, units
        rest = f"{where} holds {done} of {units} units; go on with resume=True (--resume)"
        super().__init__(f"stopped: {why}; {rest if where is not None else 'nothing was stored'}")


def run_units(
    sink: Sink,
    todo: list[int],
    kernel: Kernel,
    plan: Plan,
    *,
    done: int = 0,
    progress: bool = False,
    stop: Stop | None = None,
    log: Log,
) -> float:
    """Compute units of a sweep.

    Args:
        sink: Where they go.
        todo: Numbers of the units to compute.
        kernel: The compiled loop.
        plan: The statistics.
        done: Units that the sink has already.
        progress: Show a bar on stderr.
        stop: Asked after every call, and with True after every unit but the last.
        log: Gets a line now and then.

    Returns:
        Duration [s] that all units of the sweep, also those done before, would take at this run's rate.

    Raises:
        SweepStoppedError: `stop` gave a reason.
        StorageError: The sink cannot be written.
    """
    boxes = [sink.box(number) for number in todo]
    shapes = [tuple(side.stop - side.start for side in box) for box in boxes]
    sizes = [int(np.prod(shape)) for shape in shapes]
    positions = int(np.prod(sink.head.shape))
    writing: deque[tuple[int, Any]] = deque()
    started = time.perf_counter()

    def settle_until(left: int) -> None:
        nonlocal done
        while len(writing) > left:
            sink.settle(*writing.popleft())
            done += 1

    def check_stop(unit_ended: bool) -> None:
        why = None if stop is None else stop(unit_ended)
        if why is not None:
            settle_until(0)
            raise SweepStoppedError(why, sink.storage, done, len(sink.units))

    places = (_places_of(box) for box in boxes)
    try:
        with _progress_bar(positions, sum(sizes), kernel.orientations, progress) as advance:
            # Two calls for each thread in a small sweep too, of whole blocks: part of a block costs as much.
            most = POSITIONS * max(-(-sum(sizes) // (2 * THREADS * POSITIONS)), 1)
            units = _recut(_computed_records(kernel, plan, places, most, check_stop), sizes)
            for number, shape, size, records in zip(todo, shapes, sizes, units, strict=True):
                values = {
                    name: np.ascontiguousarray(records[name]).reshape(*shape, *records[name].shape[1:])
                    for name in plan.statistics
                }
                writing.append((number, sink.put(number, values)))
                settle_until(IN_FLIGHT)
                advance(size * kernel.orientations)
                log.write_progress(done, len(sink.units))
                if number != todo[-1]:
                    check_stop(True)
    except BaseException:
        # Pending writes are settled, so that nothing is written any more when the lock is released.
        with contextlib.suppress(OSError):
            settle_until(0)
        raise
    settle_until(0)
    return (time.perf_counter() - started) * positions / max(sum(sizes), 1)


def _places_of(box: tuple[slice, ...]) -> np.ndarray:
    """The places of a box, (n, axes) int32, the last axis fastest."""
    sides = [np.arange(side.start, side.stop, dtype=np.int32) for side in box]
    return np.stack(np.meshgrid(*sides, indexing="ij"), axis=-1).reshape(-1, len(box))


def _computed_records(
    kernel: Kernel,
    plan: Plan,
    places: Iterable[np.ndarray],
    most: int,
    check_stop: Callable[[bool], None],
) -> Iterator[np.ndarray]:
    """Statistics as record arrays, a record for each position, in the order of the places.

    Args:
        kernel: The compiled loop.
        plan: The statistics.
        places: (n, axes) each.
        most: Positions in one call, at most.
        check_stop: Called while a result is waited for; it may raise.
    """
    batches = _recut(places, itertools.repeat(min(most, kernel.positions)))
    calls = ((batch, first) for batch in batches for first in kernel.first_orientations())
    waiting: deque[tuple[np.ndarray, int, Future]] = deque()
    results: dict[str, np.ndarray] = {}
    try:
        # The Nones at the end take the last calls out of the queue.
        for call in itertools.chain(calls, [None] * AHEAD):
            if call is not None:
                waiting.append((*call, pool().submit(kernel.accumulate, *call)))
            if not waiting or (call is not None and len(waiting) <= AHEAD):
                continue
            batch, first, future = waiting.popleft()
            while not future.done():
                check_stop(False)
                time.sleep(0.001)
            results = future.result() if first == 0 else kernel.join_calls(results, future.result())
            if first == kernel.first_orientations()[-1]:
                yield _records(plan, results, len(batch))
    finally:
        for *_, future in waiting:
            future.cancel()


def _records(plan: Plan, results: dict[str, np.ndarray], count: int) -> np.ndarray:
    """Statistics of `count` positions, of the results of their channels."""
    fields: list[Any] = [
        (name, statistic.dtype, tuple(size for _, size in statistic.extra_axes))
        for name, statistic in plan.statistics.items()
    ]
    records = np.empty(count, fields)
    for name, statistic in plan.statistics.items():
        records[name] = statistic.finish(*(results[channel] for channel in statistic.channels))
    return records


def _recut(stream: Iterable[np.ndarray], sizes: Iterable[int]) -> Iterator[np.ndarray]:
    """The rows of a stream of arrays, cut into pieces of `sizes`; the last piece may be shorter."""
    stream, buffered, count = iter(stream), [], 0
    for size in sizes:
        while count < size and (piece := next(stream, None)) is not None:
            buffered.append(piece)
            count += len(piece)
        if count == 0:
            return
        whole = buffered[0] if len(buffered) == 1 else np.concatenate(buffered)
        yield whole[:size]
        buffered, count = [whole[size:]], max(count - size, 0)


@contextlib.contextmanager
def _progress_bar(positions: int, left: int, orientations: int, show: bool) -> Iterator[Callable[[int], Any]]:
    """A function that advances a progress bar by so many goals.

    Args:
        positions: Of the whole sweep.
        left: Positions that are still to be computed.
        orientations: Goals at each position.
        show: Without it, there is no bar.
    """
    if not show:
        yield lambda _: None
        return
    from tqdm import tqdm

    options: dict[str, Any] = {"unit": " goals", "unit_scale": True, "file": sys.stderr, "mininterval": 0.5}
    total, begun = positions * orientations, (positions - left) * orientations
    with tqdm(total=total, initial=begun, **options) as bar:
        yield bar.update
