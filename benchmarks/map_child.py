"""One process of `maps.py` that sweeps and says what it took: `python map_child.py JSON`, told in JSON.

Asked for: "arm", "goals" (about so many), "dtype"; "outs", where each sweep goes, null for memory alone;
"warm", whether to compile before the first; "began", when the process was started [s since 1970]; "crew",
[coordinator, processes, number], where several share a sweep.
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
"""What the thread that leads a sweep does for the store."""


def grid_of(arm: ikjax.Arm, goals: float, orientations: int = ORIENTATIONS):
    """A cubic grid about the arm, with its orientations of about so many goals."""
    steps = max(1, round(((goals / orientations) ** (1 / 3) - 1) / 2))
    radius = -ikjax.maps.around(arm, 1e-4).origin[0] + float(arm.base[0, 3])
    return ikjax.maps.around(arm, radius / (steps - 0.5))


def warm(**sweep) -> None:
    """Compile a sweep, and do no more of it."""
    with contextlib.suppress(SweepStoppedError):
        ikjax.sweep(**sweep, stop=lambda ended: "warm")


def clocked(spent: dict[str, float]) -> None:
    """Let the parts of a store say how long they kept whoever called them."""
    for name, methods in PARTS.items():
        part = getattr(lock, name, None) or getattr(store, name)
        for method in methods:
            label = f"{name}.{method.strip('_')}"
            setattr(part, method, _clocked(getattr(part, method), spent, label))


def _clocked(call: Callable, spent: dict[str, float], label: str) -> Callable:
    @functools.wraps(call)
    def timed(*args, **more):
        started = time.perf_counter()
        try:
            return call(*args, **more)
        finally:
            spent[label] += time.perf_counter() - started

    return timed


def threads() -> collections.Counter:
    """Processor seconds of this process by the names of its threads, on Linux; "lead" is the first."""
    seconds: collections.Counter = collections.Counter()
    for file in Path("/proc/self/task").glob("*/stat"):
        name, _, rest = file.read_text().partition("(")[2].rpartition(")")
        name = "lead" if int(file.parent.name) == os.getpid() else name
        user, system = rest.split()[11:13]
        seconds[name] += (int(user) + int(system)) / 100
    return seconds


def main(asked: dict) -> dict:
    """What each sweep took, and the greatest memory of the process."""
    jax.config.update("jax_enable_x64", asked["dtype"] == "float64")
    if asked.get("crew"):
        jax.distributed.initialize(*asked["crew"])
    arm = ikjax.robots.get(asked["arm"])
    sweep = {"arm": arm, "positions": grid_of(arm, asked["goals"]), "orientations": ORIENTATIONS}
    sweep["dtype"] = asked["dtype"]
    spent: dict[str, float] = collections.defaultdict(float)
    clocked(spent)
    if asked.get("warm"):
        warm(**sweep, out=f"{asked['outs'][0]}.warm") if asked.get("crew") else warm(**sweep)
    told = []
    for out in asked["outs"]:
        spent.clear()
        before, begun = threads(), time.time()
        reach = ikjax.sweep(**sweep, out=out, force=True)
        ended = time.time()
        cpu = {name: after - before[name] for name, after in threads().items() if after > before[name]}
        told.append(
            {"out": out, "begun": begun, "ended": ended, "seconds": reach.seconds, "cpu": cpu}
            | {"goals": reach.goals, "parts": dict(spent)}
        )
    # Linux says kibibytes, macOS bytes.
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1 if sys.platform == "darwin" else 1024)
    return {"sweeps": told, "peak": peak, "wall": time.time() - asked.get("began", time.time())}


if __name__ == "__main__":
    print(json.dumps(main(json.loads(sys.argv[1]))))
