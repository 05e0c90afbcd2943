"""The report of a benchmark: machine, versions and results, as markdown and as JSON."""

import dataclasses
import datetime
import math
import os
import platform
import subprocess
from importlib import metadata
from pathlib import Path

import check
import clock
import trig_rows

import ikjax
from ikjax.core import cores

PACKAGES = ("jax", "jaxlib", "numpy", "eaik", "py-opw-kinematics", "ssik", "mpmath")


@dataclasses.dataclass(frozen=True)
class Row:
    """One solver on one batch of goals."""

    what: str
    arm: str
    dtype: str
    goals: int
    timing: clock.Timing
    tally: check.Tally | None
    ratios: dict[str, float] = dataclasses.field(default_factory=dict)
    """Our rate divided by the rival's, by the rival's name."""
    target: str = ""
    met: bool | None = None
    compile_seconds: float | None = None
    compile_what: str = ""
    note: str = ""

    @property
    def rate(self) -> float:
        return self.timing.rate(self.goals)


@dataclasses.dataclass(frozen=True)
class Failure:
    """A row that could not be measured, and why."""

    what: str
    why: str


def environment(quick: bool) -> dict[str, str]:
    """The machine, the versions and the commit."""
    model, flags = _cpu()
    found = {
        "date": datetime.datetime.now(datetime.UTC).strftime("%Y-%m-%d %H:%M UTC"),
        "commit": _commit(),
        "sizes": "quick, not for quoting" if quick else "full",
        "cpu": f"{model}, {cores.usable()} cores, {'AVX-512' if 'avx512f' in flags else 'no AVX-512'}",
        "load at the start": f"{os.getloadavg()[0]:.2f}",
        "python": platform.python_version(),
        "ikjax": ikjax.__version__,
    }
    for package in PACKAGES:
        try:
            found[package] = metadata.version(package)
        except metadata.PackageNotFoundError:
            found[package] = "absent"
    return found


def _cpu() -> tuple[str, list[str]]:
    info = Path("/proc/cpuinfo")
    lines = info.read_text().splitlines() if info.exists() else []
    parts = (line.partition(":") for line in lines)
    facts = {key.strip(): value.strip() for key, _, value in parts}
    return facts.get("model name", platform.processor()), facts.get("flags", "").split()


def _commit() -> str:
    def git(*words: str) -> str:
        here = Path(__file__).parent
        return subprocess.run(["git", *words], cwd=here, capture_output=True, text=True).stdout.strip()

    changed = git("status", "--porcelain", "--", "../ikjax", "../benchmarks/*.py")
    return f"{git('rev-parse', '--short', 'HEAD') or 'unknown'}{' with changes' if changed else ''}"


def table(head: list[str], rows: list[list[str]]) -> str:
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def figure(x: float | None, unit: str = "") -> str:
    """Three significant digits, never with an exponent."""
    if x is None or not math.isfinite(x):
        return ""
    digits = max(0, 2 - math.floor(math.log10(abs(x)))) if x else 0
    return f"{x:,.{digits}f}{unit}"


def target(text: str, met: bool | None) -> str:
    return text if met is None else f"{text}: {'met' if met else '**missed**'}"


def _trig(rows: list[trig_rows.TrigRow]) -> str:
    head = ["function", "type", "ikjax M/s", "jnp M/s", "ratio", "target", "ikjax error", "jnp error"]
    return table(
        head,
        [
            [
                row.name,
                row.dtype,
                figure(row.ours),
                figure(row.theirs),
                figure(row.ratio, "x"),
                target(f">= {row.target:g}x", row.ratio >= row.target),
                f"{row.our_error:.1e}",
                f"{row.their_error:.1e}",
            ]
            for row in rows
        ],
    )


def _goals(rows: list[Row]) -> str:
    rivals = list(dict.fromkeys(name for row in rows for name in row.ratios))
    head = ["what", "arm", "type", "goals", "M goals/s", "slowest-fastest", *(f"x {name}" for name in rivals)]
    head += ["target", "success", "wrong", "none", "missing", "worst error", "note"]
    body = []
    for row in rows:
        slow, fast = row.timing.rates(row.goals)
        line = [row.what, row.arm, row.dtype, f"{row.goals:,}", figure(row.rate)]
        line += [f"{figure(slow)}-{figure(fast)}"]
        line += [figure(row.ratios.get(name), "x") for name in rivals]
        line += [target(row.target, row.met), *_counts(row.tally), row.note]
        body.append(line)
    return table(head, body)


def _counts(tally: check.Tally | None) -> list[str]:
    if tally is None:
        return [""] * 5
    counts = [f"{n:,}" for n in (tally.success, tally.wrong, tally.none, tally.missing)]
    worst = f"{tally.position_error:.0e} m, {tally.rotation_error:.0e} rad" if tally.answers else ""
    return [*counts, worst]


def _compile(rows: list[Row]) -> str:
    lines = [
        [row.what, row.arm, row.dtype, f"{row.compile_seconds:.2f}", row.compile_what]
        for row in rows
        if row.compile_seconds is not None
    ]
    return table(["what", "arm", "type", "seconds", "of what"], lines)


def markdown(facts, trig, rows, sweeps, failures) -> str:
    """The whole report."""
    parts = ["# Benchmark results", "Made by `python benchmarks/run.py`; what each row means: README.md."]
    parts.append("\n".join(f"- {key}: {value}" for key, value in facts.items()))
    parts += ["## Trigonometry", _trig(trig)] if trig else []
    parts += ["## Solvers", _goals(rows)] if rows else []
    parts += ["## Sweeps", _goals(sweeps)] if sweeps else []
    if rows or sweeps:
        parts += ["## Compile time, persistent cache off", _compile([*rows, *sweeps])]
    if failures:
        parts += ["## Not measured", "\n".join(f"- {fail.what}: {fail.why}" for fail in failures)]
    return "\n\n".join(parts) + "\n"


def as_json(facts, trig, rows, sweeps, failures) -> dict:
    """The same, with the seconds of every run."""

    def plain(row):
        return {**dataclasses.asdict(row), **({"rate": row.rate} if isinstance(row, Row) else {})}

    return {
        "environment": facts,
        "trig": [plain(row) for row in trig],
        "solvers": [plain(row) for row in rows],
        "sweeps": [plain(row) for row in sweeps],
        "not_measured": [plain(fail) for fail in failures],
    }
