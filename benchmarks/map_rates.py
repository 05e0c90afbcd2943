"""How fast sweeps are: five arms, both types, the default statistics, joint limits included.

The SO-101 has a second row, in which every goal is projected in closed form and statistic if the result is
near.
"""

import sys

import clock
import map_child
import numpy as np
import report

import ikjax

RUNS = 5
NEAR = ikjax.maps.Near(position=0.001, rotation=0.2)
GOALS = {
    "puma560": 3e8,
    "ur5": 6e7,
    "ur5e": 4e7,
    "quartic": 1e7,
    "so101": 3e7,
    "so101, near": 1e7,
}
QUICK = 2e6
TARGETS = {
    ("puma560", "float32"): 80,
    ("puma560", "float64"): 30,
    ("ur5", "float32"): 25,
    ("quartic", "float32"): 8,
    ("so101, near", "float32"): 3,
}
"""Millions of goals per second, on two cores."""


def arm_of(name: str) -> ikjax.Arm:
    """An arm of the catalogue; "quartic" has three joints of general twists before a wrist of perpendicular
    axes."""
    if name != "quartic":
        return ikjax.robots.get(name.partition(",")[0])
    return ikjax.Arm.from_dh(
        a=(0.12, 0.4, 0.07, 0, 0, 0.03),
        alpha=np.radians((70, 25, -80, 90, -90, 20)),
        d=(0.3, 0.11, 0.06, 0.4, 0, 0.1),
        convention="standard",
        limits=np.tile(np.radians((-150.0, 150.0)), (6, 1)),
        name="quartic",
    )


def measure(given) -> str:
    """The table, as Markdown."""
    body = []
    for name, goals in GOALS.items():
        if given.only in (None, name):
            for dtype in ("float32", "float64"):
                body.append(_row(name, dtype, QUICK if given.quick else goals))
                print(" | ".join(body[-1]), file=sys.stderr, flush=True)
    if not body:
        raise SystemExit(f"--only must be one of {', '.join(GOALS)}, got {given.only}")
    head = [
        "arm",
        "family",
        "type",
        "goals",
        "M goals/s",
        "slowest-fastest",
        "target",
        "reached",
        "compile [s]",
        "10^12 [h]",
    ]
    return "## Rates\n\n" + report.table(head, body)


def _row(name: str, dtype: str, goals: float) -> list[str]:
    arm = arm_of(name)
    statistic, more = "reachable_within", {}
    if name.endswith("near"):
        statistic, more = NEAR.name, {"statistics": [NEAR]}
    sweep = {
        "arm": arm.astype(dtype),
        "positions": map_child.grid_of(arm, goals),
        "orientations": map_child.ORIENTATIONS,
        "dtype": dtype,
        **more,
    }
    _, compile_seconds = clock.once(lambda: map_child.warm(**sweep))
    maps = [ikjax.sweep(**sweep) for _ in range(RUNS)]
    timing = clock.Timing(tuple(reach.seconds for reach in maps))
    rate, (slow, fast) = timing.rate(maps[0].goals), timing.rates(maps[0].goals)
    target = TARGETS.get((name, dtype))
    return [
        name,
        arm.family,
        dtype,
        f"{maps[0].goals:,}",
        report.figure(rate),
        f"{report.figure(slow)}-{report.figure(fast)}",
        "" if target is None else report.target(f">= {target}", rate >= target),
        f"{np.sum(maps[0].arrays[statistic]) / maps[0].goals:.2%}",
        f"{compile_seconds:.1f}",
        report.figure(1e6 / rate / 3600),
    ]
