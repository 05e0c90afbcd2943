"""Time of gradients: `python benchmarks/gradients.py [ARM]`, of a loss summed over every branch.

Each row is a plain jit of the user's: the loss, and the loss with its gradient in the goals, in the link
lengths, in every leaf of the arm; the same scanned in blocks that fit the cache, a thread for each core; then
1,000 designs with 1,000 goals each, in one program. Processor time is that of all threads per goal, because
wall-clock time means little on a machine that is shared.
"""

import dataclasses
import sys
import time
from concurrent.futures import ThreadPoolExecutor

import clock
import jax
import jax.numpy as jnp

import ikjax
from ikjax.core import cores

GOALS, DESIGNS, RUNS = 100_000, 1_000, 7
BLOCK, CORES = 2_000, cores.usable()
THREADS = ThreadPoolExecutor(CORES)


def loss(arm, goals):
    """Smooth in all joints of all slots."""
    return jnp.sin(ikjax.solve(arm, goals).q).sum()


def scanned(value_and_gradient):
    """Value and gradient in the first argument, summed over blocks of goals; also that in the goals."""

    def summed(first, goals):
        def add(total, block):
            value, found = value_and_gradient(first, block)
            ours, theirs = found if isinstance(found, tuple) else (found, ())
            return jax.tree.map(jnp.add, total, (value, ours)), theirs

        zero = jax.tree.map(jnp.zeros_like, (goals[0, 0, 0], first))
        return jax.lax.scan(add, zero, goals.reshape(-1, BLOCK, 4, 4))

    return summed


def main(name: str = "puma560") -> None:
    """Print a table of rates and compile times."""
    arm = ikjax.robots.get(name).astype("float32")
    # Infinite limits have no gradient to speak of.
    arm = dataclasses.replace(arm, limits=jnp.zeros_like(arm.limits))
    q = jax.random.uniform(jax.random.key(0), (GOALS, arm.n), minval=-3, maxval=3)
    goals = ikjax.fk(arm, q)
    few = goals[:DESIGNS]
    sizes = jax.random.uniform(jax.random.key(1), (DESIGNS, 1), minval=0.9, maxval=1.1) * arm.a

    def designed(a, goals):
        return loss(dataclasses.replace(arm, a=a), goals)

    rows = {
        "loss": (lambda g: loss(arm, g), (goals,)),
        "loss and gradient in the goals": (jax.value_and_grad(lambda g: loss(arm, g)), (goals,)),
        "loss of a traced arm": (loss, (arm, goals)),
        "loss and gradient in a": (jax.value_and_grad(designed), (arm.a, goals)),
        "loss and gradient in every leaf and the goals": (jax.value_and_grad(loss, (0, 1)), (arm, goals)),
        "gradient in a, scanned": (scanned(jax.value_and_grad(designed)), (arm.a, goals)),
        "gradient in every leaf and the goals, scanned": (
            scanned(jax.value_and_grad(loss, (0, 1))),
            (arm, goals),
        ),
        f"{DESIGNS} designs x {DESIGNS} goals, loss": (
            lambda a, g: jax.lax.map(lambda one: designed(one, g), a),
            (sizes, few),
        ),
        f"{DESIGNS} designs x {DESIGNS} goals, loss and gradient in a": (
            lambda a, g: jax.lax.map(lambda one: jax.value_and_grad(designed)(one, g), a),
            (sizes, few),
        ),
    }
    print(f"{name}, float32, {GOALS:,} goals; medians of {RUNS} runs; jax {jax.__version__}")
    print("| row | M goals/s: median, best | processor [us] | compile [s] | seconds / those of the loss |")
    print("|---|---|---|---|---|")
    first = None
    for what, (function, arguments) in rows.items():
        parts = [arguments]
        if "scanned" in what:
            parts = [(arguments[0], part) for part in jnp.split(goals, CORES)]
        compiled, seconds = clock.once(lambda f=function, x=parts[0]: jax.jit(f).lower(*x).compile())
        call = clock.blocking(lambda f=compiled, x=parts: [*THREADS.map(f, *zip(*x, strict=True))])
        runs = RUNS if "designs" not in what else 3
        spent = time.process_time()
        timing = clock.measure(call, runs)
        spent = (time.process_time() - spent) / (runs + 1)
        count = GOALS if "designs" not in what else DESIGNS * DESIGNS
        each = timing.median / count
        first = first or each
        rates = f"{timing.rate(count):.2f}, {timing.rates(count)[1]:.2f}"
        spent = f"{spent / count * 1e6:.2f}"
        print(f"| {what} | {rates} | {spent} | {seconds:.1f} | {each / first:.1f} |", flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
