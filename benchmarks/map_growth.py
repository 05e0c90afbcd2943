"""How time and memory grow with the number of goals, and how much time storing costs.

Each size has a process of its own: the time is that of the whole process, the memory its peak. Then one
process sweeps the largest size alternately in memory and into a store.
"""

import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import map_pictures
import report

ARM, DTYPE = "puma560", "float32"
SIZES, QUICK = (1e6, 1e7, 1e8, 1e9), (1e6, 3e6, 1e7, 3e7)
PAIRS = 5


def measure(given) -> str:
    """Both tables, as Markdown; a picture is written too."""
    sizes = QUICK if given.quick else SIZES
    with tempfile.TemporaryDirectory(dir="out") as folder:
        results = []
        for goals in sizes:
            place = str(Path(folder) / f"{goals:g}.zarr")
            result = child(arm=ARM, goals=goals, dtype=DTYPE, outs=[place])
            result["disk"] = sum(file.stat().st_size for file in Path(place).rglob("*") if file.is_file())
            results.append(result)
            print(f"{goals:g} goals: {result['wall']:.1f} s", file=sys.stderr, flush=True)
        outs = [x for k in range(PAIRS) for x in (None, f"{place}.{k}")]
        alternated = child(arm=ARM, goals=sizes[-1], dtype=DTYPE, outs=outs, warm=True)
    map_pictures.growth(results, given.pictures / "maps_growth.png")
    return (
        f"## Time and memory\n\n{ARM}, {DTYPE}, into a store; a process each.\n\n"
        f"{_growth(results)}\n\n![Time and memory against goals](../docs/maps_growth.png)\n\n"
        f"## Storing\n\n{_storing(alternated['sweeps'])}"
    )


def child(**request) -> dict:
    """The result of `map_child.py`, whose errors go to stderr."""
    return result_of(start(**request))


def start(flags: str = "", **request) -> subprocess.Popen:
    """Start `map_child.py`, with flags for XLA."""
    script = Path(__file__).with_name("map_child.py")
    command = [sys.executable, str(script), json.dumps({"began": time.time(), **request})]
    environment = {**os.environ, "XLA_FLAGS": f"{os.environ.get('XLA_FLAGS', '')} {flags}".strip()}
    return subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=environment)


def result_of(process: subprocess.Popen) -> dict:
    """The result that a process prints at its end."""
    output, _ = process.communicate(timeout=600)
    if process.returncode:
        raise RuntimeError(f"{' '.join(map(str, process.args))} ended with {process.returncode}")
    return json.loads(output)


def _growth(results: list[dict]) -> str:
    head = ["goals", "whole process [s]", "sweep [s]", "M goals/s", "peak memory [MB]", "map on disk [MB]"]
    body = []
    for result in results:
        (sweep,) = result["sweeps"]
        line = [result["wall"], sweep["seconds"], sweep["goals"] / sweep["seconds"] / 1e6]
        line += [result["peak"] / 1e6, result["disk"] / 1e6]
        body.append([f"{sweep['goals']:,}", *(report.figure(x) for x in line)])
    return report.table(head, body)


def _storing(sweeps: list[dict]) -> str:
    """In memory compared with in a store, pair by pair, and where the time is spent."""
    took = [sweep["ended"] - sweep["begun"] for sweep in sweeps]
    plain, stored = sweeps[::2], sweeps[1::2]
    ratios = [b / a - 1 for a, b in zip(took[::2], took[1::2], strict=True)]
    names = sorted({name for sweep in sweeps for name in sweep["cpu"]})
    cpu = {
        name: [statistics.median(s["cpu"].get(name, 0) for s in kind) for kind in (plain, stored)]
        for name in names
    }
    parts = sorted({part for sweep in stored for part in sweep["parts"]})
    waited = {part: statistics.median(sweep["parts"].get(part, 0) for sweep in stored) for part in parts}
    summary = (
        f"{sweeps[0]['goals']:,} goals in one process, {len(ratios)} times in memory and into a store "
        f"alternately. Storing made the whole call longer by {statistics.median(ratios):.1%} "
        f"(median of the pairs; {min(ratios):.1%} to {max(ratios):.1%}); "
        f"{statistics.median(took[::2]):.2f} s in memory, {statistics.median(took[1::2]):.2f} s stored."
    )
    total = [sum(kind) for kind in zip(*cpu.values(), strict=True)]
    body = [[name, f"{a:.2f}", f"{b:.2f}", f"{(b - a) / total[0]:+.1%}"] for name, (a, b) in cpu.items()]
    body.append(["all", f"{total[0]:.2f}", f"{total[1]:.2f}", f"{total[1] / total[0] - 1:+.1%}"])
    head = ["threads", "processor [s] in memory", "stored", "of all"]
    waits = [[part, f"{1000 * seconds:.1f}"] for part, seconds in waited.items()]
    waits.append(["all", f"{1000 * sum(waited.values()):.1f}"])
    return "\n\n".join([summary, report.table(head, body), report.table(["part", "sweep waits [ms]"], waits)])
