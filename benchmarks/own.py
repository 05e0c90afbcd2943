"""Our own rows: the kernel alone, `solve` eager, `solve` inside a user's jit, and the sweep."""

import dataclasses
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import check
import clock
import jax
import jax.numpy as jnp
import numpy as np

import ikjax
from ikjax.core import cores
from ikjax.core.pose import Pose
from ikjax.core.tolerances import VALID
from ikjax.core.xla import pinning, wide_vectors
from ikjax.solvers.pipeline import solve_scalars

BLOCK = 4096
"""Goals in a block of the kernel row, as in `ikjax.solve`."""

CORES = cores.usable()
THREADS = ThreadPoolExecutor(CORES)


@dataclasses.dataclass(frozen=True)
class Measured:
    """One of our rows: its time, its compile time, and the check of its answers."""

    timing: clock.Timing
    compile_seconds: float
    compile_what: str
    tally: check.Tally | None
    note: str = ""


@dataclasses.dataclass(frozen=True)
class Batch:
    """Goals of one arm, made by forward kinematics of random joints; a whole number of blocks."""

    arm: ikjax.Arm
    q: np.ndarray
    goals: np.ndarray
    """(N, 4, 4) float64."""

    @staticmethod
    def of(arm: ikjax.Arm, count: int) -> "Batch":
        unit = BLOCK * CORES
        return Batch(arm, *check.random_goals(arm, -(-count // unit) * unit))

    def tally(self, goals, answers, given) -> check.Tally:
        tolerance = VALID[np.dtype(goals.dtype).name]
        return check.tally_answers(self.arm, goals, self.q, answers, given, tolerance)


def kernel(batch: Batch, dtype: str, runs: int) -> Measured:
    """(b) Twelve component arrays in; q and valid of every slot out, one array per component.

    One program runs on as many threads as there are cores, each with its part of the goals, as in
    `ikjax.solve`.
    """
    arm = batch.arm.astype(dtype).baked()
    goals = batch.goals.astype(dtype)
    entries = [goals[:, i, j] for i in range(3) for j in range(4)]
    parts = [
        tuple(jnp.asarray(half.reshape(-1, BLOCK)) for half in part)
        for part in zip(*(np.split(entry, CORES) for entry in entries), strict=True)
    ]
    one, numbers = jnp.ones((), dtype), parts[0]

    def every_slot(numbers, one):
        def block(n):
            goal = Pose((n[0:3], n[4:7], n[8:11]), (n[3], n[7], n[11]))
            # Values that many outputs share are pinned, as `ikjax.solve` does; see ikjax.core.xla.
            with pinning(lambda x: x / one):
                slots = solve_scalars(arm, goal)
            return jax.tree.map(lambda x: jnp.broadcast_to(x, BLOCK), [(s.q, s.valid) for s in slots])

        return jax.lax.map(block, numbers)

    jitted = jax.jit(every_slot, compiler_options=wide_vectors())
    compiled, compile_seconds = clock.once(lambda: jitted.lower(numbers, one).compile())

    def call():
        return list(THREADS.map(lambda part: jax.block_until_ready(compiled(part, one)), parts))

    call()
    timing = clock.measure(call, runs)
    whole = jax.tree.map(lambda *halves: np.concatenate([np.ravel(x) for x in halves]), *call())
    answers = np.stack([np.stack(q, -1) for q, _ in whole], 1)
    given = np.stack([valid for _, valid in whole], 1)
    return Measured(timing, compile_seconds, "lower and compile", batch.tally(goals, answers, given))


def eager(batch: Batch, dtype: str, runs: int) -> Measured:
    """(c) `ikjax.solve`, eager: (N, 4, 4) in, every field of every slot out."""
    arm = batch.arm.astype(dtype)
    goals = jnp.asarray(batch.goals, dtype)
    call = clock.blocking(lambda: ikjax.solve(arm, goals))
    _, first = clock.once(call)
    timing = clock.measure(call, runs)
    sol = call()
    tally = batch.tally(np.asarray(goals), np.asarray(sol.q), np.asarray(sol.valid))
    return Measured(timing, max(0, first - timing.median), "first call less a later one", tally)


def counted(batch: Batch, dtype: str, runs: int) -> Measured:
    """(d) How many goals have a solution, `solve` inside a user's plain jit."""
    arm = batch.arm.astype(dtype)
    goals = jnp.asarray(batch.goals, dtype)
    jitted = jax.jit(lambda T: ikjax.solve(arm, T).valid.any(-1).sum())
    compiled, compile_seconds = clock.once(lambda: jitted.lower(goals).compile())
    call = clock.blocking(lambda: compiled(goals))
    timing = clock.measure(call, runs)
    solved = int(call())
    # A count has no joints to check; row (c) checks the same goals.
    tally = check.Tally(solved, 0, len(goals) - solved, 0, 0, float("nan"), float("nan"))
    return Measured(timing, compile_seconds, "lower and compile", tally, "counted, not checked")


ROWS: dict[str, Callable[[Batch, str, int], Measured]] = {
    "kernel, component arrays": kernel,
    "solve, eager": eager,
    "solve in jit, counted": counted,
}

ORIENTATIONS = 512
SAMPLE = 32
"""Positions of a sweep that are solved again in every orientation, and checked."""


def sweep(arm: ikjax.Arm, dtype: str, goals: int, runs: int) -> tuple[Measured, int]:
    """(f) `ikjax.sweep` over about `goals` goals; the row, and the exact number."""
    coarse = check.reach(arm) / 10
    count = ikjax.maps.around(arm, coarse).count
    spacing = coarse * (count * ORIENTATIONS / goals) ** (1 / 3)
    grid = ikjax.maps.around(arm, spacing)

    def call():
        return ikjax.sweep(arm, grid, ORIENTATIONS, dtype=dtype, progress=False)

    found, first = clock.once(call)
    timing = clock.Timing(tuple(call().seconds for _ in range(runs)))
    differ, tally = _solve_again(arm, found, dtype)
    note = f"of {SAMPLE} positions solved again, {differ} have other counts"
    return Measured(timing, max(0, first - found.seconds), "all but its seconds", tally, note), found.goals


def _solve_again(arm: ikjax.Arm, found, dtype: str) -> tuple[int, check.Tally]:
    """How many positions have other counts than `solve`, and the check of its answers there."""
    rng = np.random.default_rng(2)
    # Half of them where the map says that goals are reached, half anywhere.
    reached = np.flatnonzero(np.asarray(found.reachable).reshape(-1))
    chosen = [rng.choice(among, SAMPLE // 2) for among in (reached, found.positions.count)]
    chosen = np.concatenate(chosen)
    goals = np.broadcast_to(np.eye(4), (len(chosen), found.orientation_count, 4, 4)).copy()
    goals[..., :3, :3] = found.rotations
    goals[..., :3, 3] = found.positions.points().reshape(-1, 3)[chosen][:, None]
    goals = goals.astype(dtype)
    sol = ikjax.solve(arm.astype(dtype), jnp.asarray(goals))
    valid = np.asarray(sol.valid)
    same = valid.any(-1).sum(-1) == np.asarray(found.reachable).reshape(-1)[chosen]
    same &= valid.sum((-1, -2)) == np.asarray(found.solutions).reshape(-1)[chosen]
    # Here a goal without a solution is no failure: the grid is larger than the workspace.
    has = valid.any(-1)
    tally = check.tally_answers(arm, goals[has], None, np.asarray(sol.q)[has], valid[has], VALID[dtype])
    return int((~same).sum()), tally
