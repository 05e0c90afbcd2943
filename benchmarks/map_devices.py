"""Two devices in one process, and two processes of one device each, compared with one, on the same cores."""

import itertools
import socket
import statistics
import sys
import tempfile

import map_growth
import report

ARM, DTYPE = "puma560", "float32"
GOALS, QUICK = 1e9, 1e7
ROUNDS, SWEEPS = 3, 2
"""How often processes are started, and how often each sweeps after it has compiled."""

TWO = "--xla_force_host_platform_device_count=2"
TARGET = 0.9


def measure(given) -> str:
    """The table, as Markdown."""
    goals = QUICK if given.quick else GOALS
    kinds = {
        "1 process, 1 device": lambda place: [_start(place, goals)],
        "1 process, 2 devices": lambda place: [_start(place, goals, TWO)],
        "2 processes, 1 device each": lambda place: _start_two(place, goals),
    }
    rates: dict[str, list[float]] = {name: [] for name in kinds}
    rounds = range(1 if given.quick else ROUNDS)
    for _, (name, begin) in itertools.product(rounds, kinds.items()):
        with tempfile.TemporaryDirectory(dir="out") as folder:
            rates[name] += _rates([map_growth.result_of(each) for each in begin(f"{folder}/map.zarr")])
        print(f"{name}: {rates[name][-1]:.0f} M goals/s", file=sys.stderr, flush=True)
    first, *_ = middle = [statistics.median(found) for found in rates.values()]
    body = []
    for (name, found), rate in zip(rates.items(), middle, strict=True):
        share = rate / first
        met = "" if name == next(iter(rates)) else report.target(f">= {TARGET}", share >= TARGET)
        spread = f"{report.figure(min(found))}-{report.figure(max(found))}"
        body.append([name, str(len(found)), report.figure(rate), spread, f"{share:.2f}", met])
    head = ["what", "sweeps", "M goals/s", "slowest-fastest", "of one", "target"]
    return (
        f"## Devices and processes\n\n{ARM}, {DTYPE}, about {goals:g} goals into a store, the same cores for "
        f"all; from the call to its end in every process, without the compile.\n\n{report.table(head, body)}"
    )


def _start(place: str, goals: float, flags: str = "", distributed: list | None = None):
    outs = [f"{place}.{k}" for k in range(SWEEPS)]
    return map_growth.start(
        flags, arm=ARM, goals=goals, dtype=DTYPE, outs=outs, warm=True, distributed=distributed
    )


def _start_two(place: str, goals: float) -> list:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        coordinator = f"127.0.0.1:{free.getsockname()[1]}"
    return [_start(place, goals, distributed=[coordinator, 2, number]) for number in range(2)]


def _rates(results: list[dict]) -> list[float]:
    """Millions of goals per second of each sweep, from the first begin to the last end of all processes."""
    rates = []
    for shares in zip(*(result["sweeps"] for result in results), strict=True):
        seconds = max(share["ended"] for share in shares) - min(share["begun"] for share in shares)
        rates.append(shares[0]["goals"] / seconds / 1e6)
    return rates
