"""One process of `maps.py`, which sweeps and prints times and memory as JSON: `python map_child.py JSON`.

Keys of the request: "arm"; "goals", about how many; "dtype"; "outs", where each sweep is stored, null for
memory only; "warm", whether to compile before the first; "began", when the process was started [s since
1970]; "distributed", [coordinator, processes, number], where several processes share a sweep.
"""

import collections
import contextlib
import functools
import json
import os
import resource
import sys
import time
from collections.abc import Callable
from pathlib import Path

import jax

import ikjax
from ikjax.maps.runner import SweepStoppedError
from ikjax.maps.store import lock, store

ORIENTATIONS = 512

PARTS = {
    "Lock": ("__enter__", "__exit__"),
    "Store": ("__init__", "prepare", "survey", "put", "settle", "write_state"),
}
"""The store's methods that the main thread of a sweep calls."""


def grid_of(arm: ikjax.Arm, goals: float, orientations: int = ORIENTATIONS):
    """A cubic grid about the arm that has about `goals` goals with its orientations."""
    steps = max(1, round(((goals / orientations) ** (1 / 3) - 1) / 2))
    radius = -ikjax.maps.around(arm, 1e-4).origin[0] + float(arm.base[0, 3])
    return ikjax.maps.around(arm, radius / (steps - 0.5))


def warm(**sweep) -> None:
    """Compile a sweep, and stop it."""
    with contextlib.suppress(SweepStoppedError):
        ikjax.sweep(**sweep, stop=lambda ended: "warm")


def time_store(spent: dict[str, float]) -> None:
    """Add up the seconds that callers spend in the parts of a store."""
    for name, methods in PARTS.items():
        part = getattr(lock, name, None) or getattr(store, name)
        for method in methods:
            label = f"{name}.{method.strip('_')}"
            setattr(part, method, _timed(getattr(part, method), spent, label))


def _timed(call: Callable, spent: dict[str, float], label: str) -> Callable:
    @functools.wraps(call)
    def timed(*args, **more):
        started = time.perf_counter()
        try:
            return call(*args, **more)
        finally:
            spent[label] += time.perf_counter() - started

    return timed


def threads() -> collections.Counter:
    """Processor seconds of this process by the names of its threads, on Linux; the first is called "lead"."""
    seconds: collections.Counter = collections.Counter()
    for file in Path("/proc/self/task").glob("*/stat"):
        name, _, rest = file.read_text().partition("(")[2].rpartition(")")
        name = "lead" if int(file.parent.name) == os.getpid() else name
        user, system = rest.split()[11:13]
        seconds[name] += (int(user) + int(system)) / 100
    return seconds


def main(request: dict) -> dict:
    """Times of each sweep, and the greatest memory of the process."""
    jax.config.update("jax_enable_x64", request["dtype"] == "float64")
    if request.get("distributed"):
        jax.distributed.initialize(*request["distributed"])
    arm = ikjax.robots.get(request["arm"])
    sweep = {"arm": arm, "positions": grid_of(arm, request["goals"]), "orientations": ORIENTATIONS}
    sweep["dtype"] = request["dtype"]
    spent: dict[str, float] = collections.defaultdict(float)
    time_store(spent)
    if request.get("warm"):
        warm(**sweep, out=f"{request['outs'][0]}.warm") if request.get("distributed") else warm(**sweep)
    results = []
    for out in request["outs"]:
        spent.clear()
        before, begun = threads(), time.time()
        reach = ikjax.sweep(**sweep, out=out, force=True)
        ended = time.time()
        cpu = {name: after - before[name] for name, after in threads().items() if after > before[name]}
        results.append(
            {"out": out, "begun": begun, "ended": ended, "seconds": reach.seconds, "cpu": cpu}
            | {"goals": reach.goals, "parts": dict(spent)}
        )
    # ru_maxrss is in kibibytes on Linux, in bytes on macOS.
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1 if sys.platform == "darwin" else 1024)
    return {"sweeps": results, "peak": peak, "wall": time.time() - request.get("began", time.time())}


if __name__ == "__main__":
    print(json.dumps(main(json.loads(sys.argv[1]))))
