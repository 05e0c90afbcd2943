"""The nearest attainable pose: `python benchmarks/projection.py [ARM ...] [--goals N] [--general N]`.

For each arm: the rate of the closed form alone, first as a kernel (component arrays in; q, both errors and
the gradient norm of every slot out) and then as `project` returns it; the rate of the refined projection with
every branch; the share of goals where the gradient is zero; and the cost compared with the best of 64 bounded
least squares of scipy from random joints, and with the best of 64 random starts of our own refinement, which
is in turn compared with scipy. `--general N` does the last for N random arms of five joints and no family.
"""

import argparse
import time
from concurrent.futures import ThreadPoolExecutor

import clock
import jax
import jax.numpy as jnp
import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

import ikjax
from ikjax.core import cores
from ikjax.core.xla import wide_vectors
from ikjax.ik.batched import BLOCK
from ikjax.ik.multistart import closed_form

LENGTH = 0.1
CORES = cores.usable()


def goals_of(arm, count: int, seed: int = 0) -> np.ndarray:
    """Points of the arm's workspace, 0.6 to 1.2 times as far out, with uniform orientations."""
    rng = np.random.default_rng(seed)
    low, high = np.clip(np.array(arm.limits).T, -np.pi, np.pi)
    goals = np.array(ikjax.fk(arm, rng.uniform(low, high, (count, arm.n))))
    goals[:, :3, :3] = Rotation.random(count, random_state=seed).as_matrix()
    goals[:, :3, 3] *= rng.uniform(0.6, 1.2, (count, 1))
    return goals


def kernel(arm, goals: np.ndarray, dtype: str, runs: int = 9) -> float:
    """Millions of goals per second of the closed form, on as many threads as there are cores."""
    arm, goals = arm.astype(dtype).baked(), goals[: len(goals) // (BLOCK * CORES) * BLOCK * CORES]
    entries = [goals[:, i, j].astype(dtype) for i in range(4) for j in range(4)]
    parts = [
        tuple(jnp.asarray(half.reshape(-1, BLOCK)) for half in part)
        for part in zip(*(np.split(entry, CORES) for entry in entries), strict=True)
    ]
    length = jnp.asarray(LENGTH, dtype)

    def every_slot(numbers, length):
        def block(n):
            slots = closed_form(arm, tuple(n[4 * i : 4 * i + 4] for i in range(4)), length)
            return [(slot.q, slot.position_error, slot.rotation_error, slot.gradient_norm) for slot in slots]

        return jax.lax.map(block, numbers)

    jitted = jax.jit(every_slot, compiler_options=wide_vectors())
    compiled = jitted.lower(parts[0], length).compile()
    with ThreadPoolExecutor(CORES) as threads:
        run = lambda part: jax.block_until_ready(compiled(part, length))  # noqa: E731
        return clock.measure(lambda: list(threads.map(run, parts)), runs).rate(len(goals))


class Table:
    """The arm in numpy, for the thousands of single calls that scipy makes."""

    def __init__(self, arm):
        self.a, self.alpha, self.d, self.theta = (np.array(x) for x in (arm.a, arm.alpha, arm.d, arm.theta))
        self.base, self.tool, self.limits = np.array(arm.base), np.array(arm.tool), np.array(arm.limits).T

    def fk(self, q):
        T = self.base
        for a, alpha, d, angle in zip(self.a, self.alpha, self.d, self.theta + q, strict=True):
            c, s, ca, sa = np.cos(angle), np.sin(angle), np.cos(alpha), np.sin(alpha)
            rows = [[c, -s * ca, s * sa, a * c], [s, c * ca, -c * sa, a * s], [0, sa, ca, d], [0, 0, 0, 1]]
            T = T @ np.array(rows)
        return T @ self.tool


def best_of_starts(table: Table, goal: np.ndarray, starts: int, rng) -> float:
    """The least cost that scipy finds from random starts."""

    def residual(q):
        T = table.fk(q)
        turn = Rotation.from_matrix(T[:3, :3] @ goal[:3, :3].T).as_rotvec()
        return np.concatenate([T[:3, 3] - goal[:3, 3], LENGTH * turn])

    low, high = table.limits
    costs = []
    for _ in range(starts):
        start = rng.uniform(np.clip(low, -np.pi, None), np.clip(high, None, np.pi))
        found = least_squares(residual, start, bounds=(low, high), xtol=1e-15, ftol=1e-15, gtol=1e-12)
        costs.append(2 * found.cost)
    return min(costs)


def costs_of(arm, goals: np.ndarray, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """The cost of `project`, and the best cost of `refine` from 64 random starts."""
    low, high = np.clip(np.array(arm.limits).T, -np.pi, np.pi)
    rng, costs = np.random.default_rng(1000 + seed), []
    for batch in np.array_split(goals, -(-len(goals) // 2000)):
        starts = rng.uniform(low, high, (len(batch), 64, arm.n))
        own = ikjax.refine(arm, batch, starts, LENGTH)
        costs.append((ikjax.project(arm, batch, LENGTH).cost, own.cost))
    return tuple(np.concatenate(x) for x in zip(*costs, strict=True))


def excess(ours: np.ndarray, theirs: np.ndarray) -> np.ndarray:
    """By how much ours costs more, relative; zero where both costs are rounding."""
    return np.where(np.maximum(ours, theirs) < 1e-20, 0, np.asarray(ours) / theirs - 1)


def in_words(ours: np.ndarray) -> str:
    return f"ours worse by 1e-8 for {np.sum(ours > 1e-8)}, better for {np.sum(ours < -1e-8)} of {ours.size}"


def compare_general(count: int, goals: int, rivals: int) -> None:
    """The comparison for random arms of no family."""
    ours, against_scipy = [], []
    for seed in range(count):
        rng = np.random.default_rng(seed)
        a, d = rng.uniform(0.02, 0.4, (2, 5))
        arm = ikjax.Arm.from_dh(a=a, alpha=rng.uniform(-1.6, 1.6, 5), d=d, convention="standard")
        batch = goals_of(arm, goals, seed)
        near, own = costs_of(arm, batch, seed)
        ours.append(excess(near, own))
        table = Table(arm)
        theirs = np.array([best_of_starts(table, goal, 16, rng) for goal in batch[:rivals]])
        against_scipy.append(excess(near[:rivals], theirs))
        print(f"arm {seed}, against 64 starts of our own: {in_words(ours[-1])}", flush=True)
    print(f"{count} random 5R arms, {goals} goals each, float64, against 64 random starts of our own:")
    print(f"  {in_words(np.array(ours))}; of one arm worse for {(np.array(ours) > 1e-8).sum(-1).max()}")
    print(f"  against 16 of scipy: {in_words(np.array(against_scipy))}", flush=True)


def main() -> None:
    """Print a table."""
    parser = argparse.ArgumentParser()
    parser.add_argument("arms", nargs="*", default=["so101", "motoman_l3"])
    parser.add_argument("--goals", type=int, default=200_000)
    parser.add_argument("--rivals", type=int, default=200)
    parser.add_argument("--starts", type=int, default=64)
    parser.add_argument("--own", type=int, default=10_000, help="goals for starts of our own")
    parser.add_argument("--general", type=int, default=0)
    given = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    if given.general:
        return compare_general(given.general, given.own, min(given.rivals, 4))
    for name in given.arms:
        arm = ikjax.robots.get(name)
        goals = goals_of(arm, given.goals)
        for dtype in ("float32", "float64"):
            batch = jnp.asarray(goals, dtype)
            print(f"{name} {dtype} kernel: {kernel(arm, goals, dtype):.2f} M goals/s", flush=True)
            for what, steps, extra_starts in (
                ("closed form", 0, 0),
                ("branches", 60, 0),
                ("default", 60, None),
            ):
                options = {"steps": steps, "extra_starts": extra_starts}
                call = clock.blocking(lambda b=batch, o=options, a=arm: ikjax.project(a, b, LENGTH, **o).q)
                _, first = clock.once(call)
                rate = clock.measure(call, 3).rate(given.goals)
                print(f"{name} {dtype} {what}: {rate:.3f} M goals/s (first call {first:.1f} s)", flush=True)
            near = ikjax.project(arm, batch, LENGTH)
            print(f"{name} {dtype} gradient zero: {float(near.converged.mean()):.6f} of goals", flush=True)
        few = goals[: given.rivals]
        near = ikjax.project(arm, few, LENGTH)
        table, rng, started = Table(arm), np.random.default_rng(1), time.perf_counter()
        theirs = np.array([best_of_starts(table, goal, given.starts, rng) for goal in few])
        seconds = (time.perf_counter() - started) / len(few)
        print(f"{name}, against the best of {given.starts} scipy starts, {seconds:.2f} s a goal:")
        print(f"  {in_words(excess(np.array(near.cost), theirs))}", flush=True)
        near, own = costs_of(arm, goals[: given.own], 0)
        print(f"{name}, against the best of 64 starts of our own: {in_words(excess(near, own))}")
        print(f"  those against scipy's: {in_words(excess(own[: given.rivals], theirs))}", flush=True)


if __name__ == "__main__":
    main()
