"""Whether users' calls are about as fast as the library's own loops: `make guard`, under three minutes.

Every figure is a ratio of two times of one process, so that it can be compared between machines: how many
times slower a user's call is than the library's own kernel, its sweep, or an empty program. A ratio above its
bound fails the run. Bounds are two to three times what was measured when they were set, on two cores without
AVX-512.

    python benchmarks/guard.py [--only WORD] [--results FILE]

Run it on an idle machine: other work slows a loop and a dispatch by different factors.
"""

import argparse
import dataclasses
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import clock
import jax
import jax.numpy as jnp
import numpy as np
import own
import projection
import report

import ikjax

GOALS = 196_608
RUNS = 3

UR5E_FILE = """<robot name="ur5e">{links}{joints}</robot>"""
# Origins of the joints in the robot's own description: xyz [m], rpy [rad].
UR5E_ORIGINS = [
    ("0 0 0.1625", "0 0 0"),
    ("0 0 0", "1.570796327 0 0"),
    ("-0.425 0 0", "0 0 0"),
    ("-0.3922 0 0.1333", "0 0 0"),
    ("0 -0.0997 -2.044881182297852e-11", "1.570796327 0 0"),
    ("0 0.0996 -2.042830148012698e-11", "1.570796326589793 3.141592653589793 3.141592653589793"),
]


@dataclasses.dataclass(frozen=True)
class Row:
    """One comparison."""

    what: str
    seconds: float
    against: str
    reference: float
    """[s]"""
    most: float
    """The largest ratio that passes."""

    @property
    def ratio(self) -> float:
        return self.seconds / self.reference

    @property
    def passes(self) -> bool:
        return self.ratio <= self.most


def ur5e_from_urdf() -> ikjax.Arm:
    links = "".join(f'<link name="l{i}"/>' for i in range(7))
    joints = "".join(
        f'<joint name="j{i}" type="revolute"><parent link="l{i}"/><child link="l{i + 1}"/>'
        f'<origin xyz="{xyz}" rpy="{rpy}"/><axis xyz="0 0 1"/><limit lower="-6.28" upper="6.28"/></joint>'
        for i, (xyz, rpy) in enumerate(UR5E_ORIGINS)
    )
    return ikjax.Arm.from_urdf(UR5E_FILE.format(links=links, joints=joints))


def seconds_of(call: Callable, runs: int = RUNS, inner: int = 1) -> float:
    return clock.measure(clock.blocking(call), runs, inner).median


def goals_of(arm: ikjax.Arm, count: int, dtype: str = "float32") -> jax.Array:
    q = np.random.default_rng(0).uniform(-3, 3, (count, arm.n))
    return jnp.asarray(jax.jit(lambda q: ikjax.fk(arm, q))(jnp.asarray(q)), dtype)


class Bounds(NamedTuple):
    """The largest ratios that pass, of calls in a user's jit."""

    count_to_sweep: float
    count_to_kernel: float
    eager: float
    joints: float | None = None
    gradient: float | None = None
    """None where it is not measured, because it compiles for long."""


def in_a_jit(name: str, bounds: Bounds) -> list[Row]:
    """Masks and joints in a user's own jit, compared with the kernel and the sweep."""
    arm = ikjax.robots.get(name)
    goals, q_now = goals_of(arm, GOALS), jnp.zeros(arm.n, jnp.float32)
    batch = own.Batch.of(arm, GOALS)
    kernel = own.kernel(batch, "float32", RUNS).timing.median * GOALS / len(batch.goals)
    swept, swept_goals = own.sweep(arm, "float32", 1e7, 3)
    sweep = swept.timing.median * GOALS / swept_goals

    def chosen(T):
        q, found = ikjax.nearest(arm, ikjax.within_limits(arm, ikjax.solve(arm, T)), q_now)
        return jnp.where(found[..., None], q * q, 0).sum()

    count = jax.jit(lambda T: ikjax.solve(arm, T).valid.any(-1).sum())
    loss, gradient = jax.jit(chosen), jax.jit(jax.grad(chosen))
    counted = seconds_of(lambda: count(goals))
    rows = [
        ("count in a jit", counted, "sweep", sweep, bounds.count_to_sweep),
        ("count in a jit", counted, "kernel", kernel, bounds.count_to_kernel),
    ]
    calls = {
        "nearest branch within limits in a jit": (lambda: loss(goals), bounds.joints),
        "its gradient": (lambda: gradient(goals), bounds.gradient),
        "solve, eager": (lambda: ikjax.solve(arm, goals), bounds.eager),
    }
    rows += [(what, seconds_of(call), "kernel", kernel, most) for what, (call, most) in calls.items() if most]
    return [Row(f"{name}: {what}", *rest) for what, *rest in rows]


def one_goal() -> list[Row]:
    """One eager goal, compared with an empty program of the same outputs."""
    arm = ikjax.robots.puma560()
    goal = goals_of(arm, 1)[0]
    sol = ikjax.solve(arm, goal)
    empty = jax.jit(lambda T: jax.tree.map(jnp.zeros_like, sol))
    reference = seconds_of(lambda: empty(goal), 9, 50)
    near = lambda: ikjax.nearest(arm, ikjax.solve(arm, goal), sol.q[0])  # noqa: E731
    five = ikjax.robots.so101()
    five_goal = jnp.asarray(projection.goals_of(five, 64)[0], jnp.float32)
    return [
        Row(
            "one goal: solve",
            seconds_of(lambda: ikjax.solve(arm, goal), 9, 50),
            "empty program",
            reference,
            30,
        ),
        Row("one goal: nearest of solve", seconds_of(near, 9, 50), "empty program", reference, 90),
        Row(
            "one goal: project, SO-101",
            seconds_of(lambda: ikjax.project(five, five_goal), 9, 5),
            "empty program",
            reference,
            450,
        ),
    ]


def arm_from_file() -> list[Row]:
    """A UR5e from its URDF file, compared with the catalogue's."""
    arms = {"file": ur5e_from_urdf(), "catalogue": ikjax.robots.get("ur5e")}
    goals = goals_of(arms["catalogue"], GOALS // 4)
    swept = {what: own.sweep(arm, "float32", 4e6, 3)[0].timing.median for what, arm in arms.items()}
    eager = {what: seconds_of(lambda arm=arm: ikjax.solve(arm, goals)) for what, arm in arms.items()}
    return [
        Row("UR5e from its file: sweep", swept["file"], "catalogue's", swept["catalogue"], 3),
        Row("UR5e from its file: solve, eager", eager["file"], "catalogue's", eager["catalogue"], 3),
    ]


def projection_rows() -> list[Row]:
    """The nearest attainable pose, compared with its closed form alone."""
    arm, count = ikjax.robots.so101(), 8192
    goals = projection.goals_of(arm, count).astype("float32")
    kernel = count / (projection.kernel(arm, goals, "float32", RUNS) * 1e6)
    default = seconds_of(lambda: ikjax.project(arm, goals), 3)
    return [Row("SO-101: project", default, "closed form", kernel, 700)]


def yardstick(x):
    """A fixed program of some thousand operations in one loop, and a few loops."""
    for k in range(1, 60):
        s = x * x
        p = jnp.polyval(jnp.asarray([1e-3, -0.16, 0.3, 0.7], x.dtype), s)
        x = jnp.where(s > 0.5, x * p, jnp.sqrt(s + 1) - p / (k + s))
    return x


def compile_time() -> list[Row]:
    """Compile time, compared with that of a fixed program."""

    def once(f, *arguments) -> float:
        started = time.perf_counter()
        jax.jit(f).lower(*arguments).compile()
        return time.perf_counter() - started

    reference = once(yardstick, jnp.zeros(4096, jnp.float32))
    rows = []
    for name, most in (("puma560", 30), ("stanford", 30)):
        arm = ikjax.robots.get(name)
        goals = jnp.zeros((4096, 4, 4), jnp.float32)
        rows.append(
            Row(
                f"compile {name}: solve in a jit",
                once(lambda T, arm=arm: ikjax.solve(arm, T), goals),
                "yardstick",
                reference,
                most,
            )
        )
    started = time.perf_counter()
    jax.block_until_ready(ikjax.project(ikjax.robots.so101(), ikjax.pose(xyz=(0.2, 0.05, 0.15))).q)
    first = time.perf_counter() - started
    return [*rows, Row("compile so101: project of one goal", first, "yardstick", reference, 25)]


PARTS: dict[str, Callable[[], list[Row]]] = {
    "compile": compile_time,
    "puma": lambda: in_a_jit("puma560", Bounds(10, 0.9, 25, 10, 13)),
    "ur5": lambda: in_a_jit("ur5", Bounds(10, 1.1, 20)),
    "one": one_goal,
    "file": arm_from_file,
    "project": projection_rows,
}


def table(rows: list[Row]) -> str:
    lines = [
        "| what | time [ms] | against | its time [ms] | ratio | at most | |",
        "|---|---|---|---|---|---|---|",
    ]
    for row in rows:
        cells = row.what, f"{row.seconds * 1e3:.4g}", row.against, f"{row.reference * 1e3:.4g}"
        verdict = "" if row.passes else "**TOO SLOW**"
        lines.append(f"| {' | '.join(cells)} | {row.ratio:.3g} | {row.most:g} | {verdict} |")
    return "\n".join(lines)


SECTION = "## Where users stand: `make guard`"


def machine() -> str:
    found = report.environment(quick=False)
    return ", ".join(f"{key} {found[key]}" for key in ("date", "commit", "cpu", "jax") if key in found)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", help="one part: " + ", ".join(PARTS))
    parser.add_argument("--results", type=Path, help="a file whose last section the table becomes")
    options = parser.parse_args()
    started, rows = time.perf_counter(), []
    for name, part in PARTS.items():
        if options.only in (None, name):
            rows += part()
            print(f"{name}: {time.perf_counter() - started:.0f} s", flush=True)
    text = table(rows)
    print(text)
    if options.results:
        before = options.results.read_text(encoding="utf-8").partition(SECTION)[0].rstrip()
        options.results.write_text(f"{before}\n\n{SECTION}\n\n{machine()}\n\n{text}\n", encoding="utf-8")
    slow = [row for row in rows if not row.passes]
    for row in slow:
        print(
            f"too slow: {row.what} takes {row.ratio:.3g} times {row.against}, at most {row.most:g}",
            file=sys.stderr,
        )
    return 1 if slow else 0


if __name__ == "__main__":
    sys.exit(main())
