"""`ikjax place` and `ikjax design`: where an arm should stand, and what of it should change."""

import dataclasses
import sys
from typing import Any

import numpy as np

import ikjax
from ikjax.cli import sections
from ikjax.cli.info import arm_data
from ikjax.cli.output import is_study, print_result


def run_place(options) -> int:
    """Exit code 0 if some base reaches a goal, else 1."""
    if is_study(options.arm):
        arm, goals, said = sections.read_place(options.arm, options)
    else:
        arm, goals, said = sections.without_file(options, "place")
    _say_first(options, f"placing {arm.name} for {len(goals):,} goals")
    bases = ikjax.place(arm, goals, **said)
    data: dict[str, Any] = {
        "arm": arm.name,
        "goals": len(goals),
        "bases": [
            {
                "base": bases.base[k].tolist(),
                "share": float(bases.share[k]),
                "worst_margin": float(bases.worst_margin[k]),
                "reached": np.asarray(bases.reached[k]).tolist(),
            }
            for k in range(len(bases))
        ],
    }
    print_result(options, f"{bases}\n\n{_as_mount(options, bases)}", data)
    return 0 if bases.reached.any() else 1


def _as_mount(options, bases: ikjax.Placements) -> str:
    """The best base as the key and the option `mount` take it."""
    base = np.asarray(bases.base[0], float)
    unit, name = (1.0, "radians") if options.radians else (180 / np.pi, "degrees")
    rpy = unit * np.array([
        np.arctan2(base[2, 1], base[2, 2]),
        np.arctan2(-base[2, 0], np.hypot(base[2, 1], base[2, 2])),
        np.arctan2(base[1, 0], base[0, 0]),
    ])  # fmt: skip
    numbers = ", ".join(f"{round(x, 5) + 0.0:g}" for x in (*base[:3, 3], *rpy))
    return f"in a study of angles in {name}: mount = [{numbers}]"


def run_design(options) -> int:
    """Exit code 0 if the arm that is found reaches a goal, else 1."""
    if is_study(options.arm):
        arm, goals, said = sections.read_design(options.arm, options)
    else:
        arm, goals, said = sections.without_file(options, "design")
    _say_first(options, f"designing {arm.name} for {len(goals):,} goals")
    vary = said.pop("vary")
    result = ikjax.design(arm, goals, vary, **said)
    made = dataclasses.replace(result.arm, name=f"{arm.name} designed")
    data = {
        "score": result.score,
        "start_score": result.start_score,
        "values": result.values,
        "reached": np.asarray(result.reached).tolist(),
        "at_bounds": result.at_bounds,
        "arm": arm_data(made),
    }
    print_result(options, f"{result.report(degrees=not options.radians)}\n\n{made}", data)
    return 0 if result.reached.any() else 1


def _say_first(options, text: str) -> None:
    if not options.json:
        print(text, file=sys.stderr, flush=True)
