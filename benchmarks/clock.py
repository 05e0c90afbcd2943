"""Medians of run times, without compile time."""

import dataclasses
import statistics
import time
from collections.abc import Callable

import jax


@dataclasses.dataclass(frozen=True)
class Timing:
    """Seconds of every run of a call, after a first run that is not counted."""

    seconds: tuple[float, ...]

    @property
    def median(self) -> float:
        return statistics.median(self.seconds)

    def rate(self, count: int) -> float:
        """Millions per second of the median run."""
        return count / self.median / 1e6

    def rates(self, count: int) -> tuple[float, float]:
        """Millions per second of the slowest and the fastest run."""
        return count / max(self.seconds) / 1e6, count / min(self.seconds) / 1e6


def blocking(call: Callable) -> Callable:
    """A call of jax that returns only when its results are ready."""
    return lambda: jax.block_until_ready(call())


def measure(call: Callable, runs: int, inner: int = 1) -> Timing:
    """Time `runs` runs of a blocking call, after a first one that is not timed; a run is `inner` calls."""
    call()
    seconds = []
    for _ in range(runs):
        started = time.perf_counter()
        for _ in range(inner):
            result = call()
        seconds.append((time.perf_counter() - started) / inner)
        del result  # outside the timed part, and before the next run needs the memory
    return Timing(tuple(seconds))


def once(call: Callable) -> tuple[object, float]:
    """What a blocking call returns, and its seconds."""
    started = time.perf_counter()
    result = call()
    return result, time.perf_counter() - started
