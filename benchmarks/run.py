"""Every benchmark, ours and the rivals', in one process: `python benchmarks/run.py [--quick]`.

x64 is on for the whole run and every type is given by name, so that float32 and float64 are measured in one
process; the persistent compilation cache is off. What each row means: README.md.
"""

import argparse
import dataclasses
import json
import sys
import traceback
from collections.abc import Callable
from pathlib import Path

import jax

jax.config.update("jax_enable_x64", True)
jax.config.update("jax_enable_compilation_cache", False)

import check
import clock
import own
import report
import rivals
import trig_rows

import ikjax

ARMS = ("puma560", "ur5")
DTYPES = ("float32", "float64")

TIMES_EAIK = {
    "kernel, component arrays": {"float32": 25, "float64": 8},
    "solve, eager": {"float32": 7, "float64": 3},
    "solve in jit, counted": {"float32": 40, "float64": 12},
}
SWEEP_RATE = {
    ("puma560", "float32"): 50,
    ("puma560", "float64"): 20,
    ("ur5", "float32"): 25,
    ("ur5", "float64"): 11,
}
"""Millions of goals per second."""


@dataclasses.dataclass(frozen=True)
class Sizes:
    """How many of what."""

    trig: int = 10**6
    trig_sample: int = 20_000
    goals: int = 10**6
    rival_goals: int = 10**5
    single_goals: int = 500
    """For rivals that solve one goal at a time."""
    sweep_goals: int = 2 * 10**8
    runs: int = 7


QUICK = Sizes(
    trig=10**5,
    trig_sample=500,
    goals=2 * own.BLOCK,
    rival_goals=2000,
    single_goals=50,
    sweep_goals=4 * 10**6,
    runs=3,
)


class Bench:
    """Collects rows; a row that fails is recorded and the next one is measured."""

    def __init__(self, sizes: Sizes):
        self.sizes = sizes
        self.trig: list[trig_rows.TrigRow] = []
        self.rows: list[report.Row] = []
        self.sweeps: list[report.Row] = []
        self.failures: list[report.Failure] = []

    def attempt(self, what: str, step: Callable[[], None]) -> None:
        print(f"{what} ...", file=sys.stderr, flush=True)
        try:
            step()
        except rivals.AbsentError as absent:
            self.failures.append(report.Failure(what, f"absent: {absent}"))
        except Exception as error:
            traceback.print_exc()
            self.failures.append(report.Failure(what, f"{type(error).__name__}: {error}"))

    def all(self) -> None:
        for name in trig_rows.FUNCTIONS:
            for dtype in DTYPES:
                self.attempt(f"{name} {dtype}", lambda n=name, d=dtype: self.one_trig(n, d))
        for name in ARMS:
            self.attempt(f"arm {name}", lambda name=name: self.one_arm(ikjax.robots.get(name)))

    def one_trig(self, name: str, dtype: str) -> None:
        sizes = self.sizes
        self.trig.append(trig_rows.measure(name, dtype, sizes.trig, sizes.runs, sizes.trig_sample))

    def one_arm(self, arm: ikjax.Arm) -> None:
        """The rivals first, so that our rows can be divided by them; then our rows."""
        batch = own.Batch.of(arm, self.sizes.goals)
        rates: dict[str, float] = {}
        many, few = self.sizes.rival_goals, self.sizes.single_goals
        adapters = {
            "EAIK": lambda: rivals.eaik(arm, batch.goals[:many]),
            "OPW": lambda: rivals.opw(arm, batch.goals[:many]),
            "OPW with sigma": lambda: rivals.opw(arm, batch.goals[:many], sigma=True),
            "ssik": lambda: rivals.ssik(arm, batch.goals[:few]),
        }
        for name, make in adapters.items():
            self.attempt(f"{name}, {arm.name}", lambda make=make: self.one_rival(batch, make(), rates))
        for dtype in DTYPES:
            for what in own.ROWS:
                step = lambda what=what, dtype=dtype: self.one_own(batch, what, dtype, rates)  # noqa: E731
                self.attempt(f"{what}, {arm.name} {dtype}", step)
            self.attempt(f"sweep, {arm.name} {dtype}", lambda d=dtype: self.one_sweep(arm, d, rates))

    def one_rival(self, batch: own.Batch, rival: rivals.Rival, rates: dict[str, float]) -> None:
        timing = clock.measure(rival.solve, self.sizes.runs)
        answers, given = rival.unpack(rival.solve())
        count = len(answers)
        tally = check.tally_answers(
            batch.arm, batch.goals[:count], batch.q[:count], answers, given, rivals.TOLERANCE
        )
        if rival.comparable:
            rates[rival.name] = timing.rate(count)
        self.rows.append(
            report.Row(rival.name, batch.arm.name, "float64", count, timing, tally, note=rival.how)
        )

    def one_own(self, batch: own.Batch, what: str, dtype: str, rates: dict[str, float]) -> None:
        found = own.ROWS[what](batch, dtype, self.sizes.runs)
        wanted = TIMES_EAIK[what][dtype]
        row = _row(what, batch.arm, dtype, len(batch.goals), found, rates)
        met = row.ratios["EAIK"] >= wanted if "EAIK" in row.ratios else None
        self.rows.append(dataclasses.replace(row, target=f">= {wanted}x EAIK", met=met))

    def one_sweep(self, arm: ikjax.Arm, dtype: str, rates: dict[str, float]) -> None:
        found, goals = own.sweep(arm, dtype, self.sizes.sweep_goals, self.sizes.runs)
        wanted = SWEEP_RATE[arm.name, dtype]
        row = _row("sweep", arm, dtype, goals, found, rates)
        self.sweeps.append(dataclasses.replace(row, target=f">= {wanted} M/s", met=row.rate >= wanted))


def _row(what, arm, dtype, goals, found: own.Measured, rates) -> report.Row:
    rate = found.timing.rate(goals)
    return report.Row(
        what,
        arm.name,
        dtype,
        goals,
        found.timing,
        found.tally,
        ratios={name: rate / other for name, other in rates.items()},
        compile_seconds=found.compile_seconds,
        compile_what=found.compile_what,
        note=found.note,
    )


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="small sizes: only to see that it runs")
    parser.add_argument("--out", type=Path, default=Path("out/bench.md"))
    parser.add_argument("--json", type=Path, default=Path("out/bench.json"))
    arguments = parser.parse_args()
    facts = report.environment(arguments.quick)
    bench = Bench(QUICK if arguments.quick else Sizes())
    bench.all()
    results = (facts, bench.trig, bench.rows, bench.sweeps, bench.failures)
    text = report.markdown(*results)
    for path, content in (
        (arguments.out, text),
        (arguments.json, json.dumps(report.as_json(*results), indent=1) + "\n"),
    ):
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(content)
    print(text)
    return 0


if __name__ == "__main__":
    sys.exit(main())
