"""Whether a change of names or files changed a program: hashes of the text that goes to XLA.

    python benchmarks/lowered.py --out before.json
    python benchmarks/lowered.py --check before.json

For three families in both types: `solve` (an eager block, and in a jit), `project`, a gradient, a step of a
sweep and a step of a design; for other families some of these. None of them is compiled. Names of functions
are numbered in the order in which they appear, so that a rename does not count.
"""

import argparse
import dataclasses
import hashlib
import json
import re
import sys
from collections.abc import Callable
from pathlib import Path
from unittest import mock

import jax
import jax.numpy as jnp
import numpy as np

import ikjax
from ikjax.synthesis import ascent

ARMS = {"puma560": "a2", "ur5": "a2", "so101": "a2"}
"""What a design of each varies."""

FURTHER = ("stanford", "gx4_351s", "planar_prr", "ur5 with a correction")
"""Other families in float32, with fewer programs each."""


class LoweredError(Exception):
    """Carries the text of the program that was to be compiled."""


def hash_of(text: str) -> str:
    """Of a program whose functions are numbered."""
    numbers: dict[str, str] = {}
    text = re.sub(r"@[\w.]+", lambda name: numbers.setdefault(name[0], f"@{len(numbers)}"), text)
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def first_compiled(call: Callable) -> str:
    """The first program that a call lowers and compiles by itself."""

    def stop(lowered, *_, **__):
        raise LoweredError(lowered.as_text())

    with mock.patch("jax.stages.Lowered.compile", stop):
        try:
            call()
        except LoweredError as lowered:
            return lowered.args[0]
    raise RuntimeError("nothing was compiled")


def design_step(arm: ikjax.Arm, goals: jax.Array, varied: str) -> str:
    take_steps = ascent.take_steps

    def stop(*arguments):
        raise LoweredError(take_steps.lower(*arguments).as_text())

    with mock.patch.object(ascent, "take_steps", stop):
        try:
            ikjax.design(arm, goals, {varied: (0.1, 0.6)}, starts=2, steps=2)
        except LoweredError as lowered:
            return lowered.args[0]
    raise RuntimeError("design took no step")


def programs(name: str, varied: str, dtype: str) -> dict[str, Callable[[], str]]:
    arm = ikjax.robots.get(name).astype(dtype)
    q = np.random.default_rng(0).uniform(-1, 1, (6, arm.n))
    goals = ikjax.fk(arm, jnp.asarray(q, dtype))

    def in_jit(f: Callable) -> Callable[[], str]:
        return lambda: jax.jit(f).lower(goals).as_text()

    return {
        "solve, eager block": lambda: first_compiled(lambda: ikjax.solve(arm, goals)),
        "solve in a jit": in_jit(lambda T: ikjax.solve(arm, T)),
        "project, eager block": lambda: first_compiled(lambda: ikjax.project(arm, goals)),
        "project in a jit": in_jit(lambda T: ikjax.project(arm, T)),
        "gradient of solve": in_jit(jax.grad(lambda T: ikjax.solve(arm, T).q.sum())),
        "gradient of project": in_jit(jax.grad(lambda T: ikjax.project(arm, T).q.sum())),
        "sweep step": lambda: first_compiled(
            lambda: ikjax.sweep(arm, ikjax.maps.around(arm, 0.3), 64, dtype=dtype)
        ),
        "design step": lambda: design_step(arm, goals, varied),
    }


def further(name: str) -> dict[str, Callable[[], str]]:
    arm = ikjax.robots.get(name.split()[0]).astype("float32")
    if "correction" in name:
        twist = jnp.asarray(np.random.default_rng(1).normal(scale=1e-3, size=(arm.n + 1, 6)), "float32")
        arm = dataclasses.replace(arm, correction=twist)
    q = jnp.asarray(np.random.default_rng(0).uniform(-1, 1, (6, arm.n)), "float32")
    goals = ikjax.fk(arm, q)
    found: dict[str, Callable[[], str]] = {
        "solve, eager block": lambda: first_compiled(lambda: ikjax.solve(arm, goals)),
        "solve in a jit": lambda: jax.jit(lambda T: ikjax.solve(arm, T)).lower(goals).as_text(),
        "refine in a jit": lambda: jax.jit(lambda T: ikjax.refine(arm, T, q)).lower(goals).as_text(),
        "quality": lambda: (
            jax.jit(jax.grad(lambda q: (ikjax.manipulability(arm, q) + ikjax.sigma_min(arm, q)).sum()))
            .lower(q)
            .as_text()
        ),
    }
    if not arm.task.startswith("planar"):
        names = ["mean_manipulability", "best_sigma_min", "reachable_within"]
        positions = ikjax.maps.around(arm, 0.3)
        found["sweep step"] = lambda: first_compiled(
            lambda: ikjax.sweep(arm, positions, 64, dtype="float32", statistics=names)
        )
    return found


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path)
    parser.add_argument("--check", type=Path, help="hashes that these must equal")
    options = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    found = {
        f"{name}, {dtype}: {what}": hash_of(text())
        for name, varied in ARMS.items()
        for dtype in ("float32", "float64")
        for what, text in programs(name, varied, dtype).items()
    }
    found |= {f"{name}: {what}": hash_of(text()) for name in FURTHER for what, text in further(name).items()}
    if options.out:
        options.out.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    if not options.check:
        print(json.dumps(found, indent=1))
        return 0
    before = json.loads(options.check.read_text(encoding="utf-8"))
    other = [what for what in sorted({*before, *found}) if before.get(what) != found.get(what)]
    print("\n".join(f"changed: {what}" for what in other) or f"{len(found)} programs are the same")
    return 1 if other else 0


if __name__ == "__main__":
    sys.exit(main())
