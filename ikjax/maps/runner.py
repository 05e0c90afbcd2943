"""The work of a sweep: units in, their statistics out, a call on every thread while another is fetched.

Positions stream through calls whatever the size of units; the bits of a position depend
on nothing but the position.
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
from ikjax.maps.store import log
from ikjax.maps.store.manifest import Head

IN_FLIGHT = 2
"""Units that are being written while the next is computed."""

AHEAD = THREADS + 1
"""Calls that are under way or wait for a thread while the first of them is fetched."""

Stop = Callable[[bool], str | None]
"""Asked often, with whether a unit has just ended: why to stop, or None."""


class Sink(Protocol):
    """Where units go."""

    place: Any
    head: Head
    units: list[tuple[int, ...]]

    def box(self, number: int) -> tuple[slice, ...]: ...

    def put(self, number: int, values: dict[str, np.ndarray]) -> Any: ...

    def settle(self, number: int, futures: Any) -> None: ...


class SweepStoppedError(Exception):
    """A sweep was told to stop; what is stored is whole."""

    def __init__(self, why: str, where: Any, done: int, units: int):
        self.why, self.done, self.units = why, done, units
        rest = f"{where} holds {done} of {units} units; go on with resume=True (--resume)"
        super().__init__(f"stopped: {why}; {rest if where is not None else 'nothing was stored'}")


def run(
    sink: Sink,
    todo: list[int],
    kernel: Kernel,
    plan: Plan,
    *,
    done: int = 0,
    progress: bool = False,
    stop: Stop | None = None,
    diary: log.Log,
) -> float:
    """Compute the units `todo` into `sink`, which holds `done`; seconds for all units at their rate."""
    boxes = [sink.box(number) for number in todo]
    shapes = [tuple(side.stop - side.start for side in box) for box in boxes]
    sizes = [int(np.prod(shape)) for shape in shapes]
    positions = int(np.prod(sink.head.shape))
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

    places = (_places(box) for box in boxes)
    try:
        with _bar(positions, sum(sizes), kernel.orientations, progress) as advance:
            # Every thread has something to do in a small sweep too, in whole blocks: a part costs as much.
            most = POSITIONS * max(-(-sum(sizes) // (2 * THREADS * POSITIONS)), 1)
            rows = _recut(_computed(kernel, plan, places, most, ask), sizes)
            for number, shape, size, row in zip(todo, shapes, sizes, rows, strict=True):
                values = {
                    name: np.ascontiguousarray(row[name]).reshape(*shape, *row[name].shape[1:])
                    for name in plan.statistics
                }
                writing.append((number, sink.put(number, values)))
                finish(IN_FLIGHT)
                advance(size * kernel.orientations)
                diary.progress(done, len(sink.units))
                if number != todo[-1]:
                    ask(True)
    except BaseException:
        # What is under way is settled, so that nothing is written any more when the lock goes.
        with contextlib.suppress(OSError):
            finish(0)
        raise
    finish(0)
    return (time.perf_counter() - started) * positions / max(sum(sizes), 1)


def _places(box: tuple[slice, ...]) -> np.ndarray:
    """The places of a box, (n, axes), the last axis fastest."""
    sides = [np.arange(side.start, side.stop, dtype=np.int32) for side in box]
    return np.stack(np.meshgrid(*sides, indexing="ij"), axis=-1).reshape(-1, len(box))


def _computed(
    kernel: Kernel, plan: Plan, places: Iterable[np.ndarray], most: int, ask: Callable
) -> Iterator[np.ndarray]:
    """Statistics as records, one a position, of at most so many positions a call."""
    batches = _recut(places, itertools.repeat(min(most, kernel.positions)))
    calls = ((batch, first) for batch in batches for first in kernel.firsts())
    waiting: deque[tuple[np.ndarray, int, Future]] = deque()
    totals: dict[str, np.ndarray] = {}
    try:
        for call in itertools.chain(calls, [None] * AHEAD):
            if call is not None:
                waiting.append((*call, pool().submit(kernel.totals, *call)))
            if not waiting or (call is not None and len(waiting) <= AHEAD):
                continue
            batch, first, found = waiting.popleft()
            while not found.done():
                ask(False)
                time.sleep(0.001)
            totals = found.result() if first == 0 else kernel.together(totals, found.result())
            if first == kernel.firsts()[-1]:
                yield _records(plan, totals, len(batch))
    finally:
        for *_, found in waiting:
            found.cancel()


def _records(plan: Plan, totals: dict[str, np.ndarray], count: int) -> np.ndarray:
    kinds: list[Any] = [
        (name, statistic.dtype, tuple(size for _, size in statistic.more))
        for name, statistic in plan.statistics.items()
    ]
    records = np.empty(count, kinds)
    for name, statistic in plan.statistics.items():
        records[name] = statistic.finish(*(totals[lane] for lane in statistic.lanes))
    return records


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
def _bar(positions: int, left: int, orientations: int, show: bool) -> Iterator[Callable[[int], Any]]:
    """A function that moves a bar on."""
    if not show:
        yield lambda _: None
        return
    from tqdm import tqdm

    options: dict[str, Any] = {"unit": " goals", "unit_scale": True, "file": sys.stderr, "mininterval": 0.5}
    total, begun = positions * orientations, (positions - left) * orientations
    with tqdm(total=total, initial=begun, **options) as bar:
        yield bar.update
