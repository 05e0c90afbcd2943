"""Three design studies against random search and differential evolution.

`python benchmarks/design.py [--seeds 10] [--studies abc]`. A value with its gradient counts as six
evaluations. All methods vary the same coordinates between the same bounds, with the same ties; the rivals get
the exact score itself, compiled in the same way. Times are processor seconds of all threads, without compile
time, because wall-clock time means little on a machine that is shared.
"""

import argparse
import functools
import time
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax
from scipy.optimize import differential_evolution

import ikjax
from ikjax.synthesis import ascent
from ikjax.synthesis.parameters import choose_parameters

EVALUATIONS, COST, FINISH = 1200, 6, 300
"""Evaluations of all goals; a gradient over a batch of them counts as its share of six."""
MANY = {"starts": 2, "batch": 1}
INNER, OUTER, LEAST = 0.3, 1.0, 0.1


class Study(NamedTuple):
    title: str
    arm: ikjax.Arm
    goals: jax.Array
    vary: dict
    objective: object
    ties: tuple = ()
    limits: bool = False
    blur: tuple = (0.1, 0.005)
    best: np.ndarray | None = None
    """The known optimum."""
    starts: int = 1
    batch: int = 1
    """Number of batches that make up all goals."""

    @property
    def steps(self) -> int:
        return (EVALUATIONS - FINISH) // COST * self.batch // self.starts

    @property
    def optimizer(self):
        return _adam(self.steps)


@functools.cache
def _adam(steps: int):
    # A short average of squares: near a bound, gradients shrink with the distance.
    return optax.adam(optax.cosine_decay_schedule(0.2, steps), b2=0.9)


def clearance_for_length(arm, sol, blur):
    """Clearance to both rims of the ring, minus half of the total length."""
    return ikjax.objectives.worst_margin(arm, sol, blur) - 0.5 * arm.a.sum()


def ring_2r() -> Study:
    """Every point of a ring, clear of its rims: the best length of both links is the mean of the radii."""
    r = np.linspace(INNER, OUTER, 64)
    best = np.full(2, (INNER + OUTER) / 2)
    goals, arm = ikjax.position(r, 0 * r, 0 * r, dtype=np.float64), ikjax.robots.planar_2r(0.9, 0.3)
    vary = {"a": (LEAST, 2.0)}
    return Study("a, 2R ring", arm, goals, vary, clearance_for_length, blur=(0.1, 1e-4), best=best)


def ring_3r() -> Study:
    """The same with every heading: the last link is best at its lower bound, the others as before."""
    r, phi = np.meshgrid(np.linspace(INNER, OUTER, 16), np.linspace(-np.pi, np.pi, 17))
    best = np.array([(INNER + OUTER) / 2] * 2 + [LEAST])
    goals = ikjax.planar_pose(r.ravel(), 0 * r.ravel(), phi.ravel(), dtype=np.float64)
    arm, vary = ikjax.robots.planar_3r(0.9, 0.5, 0.3), {"a": (LEAST, 2.0)}
    return Study("a, 3R ring", arm, goals, vary, clearance_for_length, blur=(0.1, 1e-4), best=best)


def puma() -> Study:
    """The share of positions with half of all orientations within the limits; lengths of a metre together."""
    rng = np.random.default_rng(1)
    goals = np.tile(np.eye(4), (512, 16, 1, 1))
    goals[:, :, :3, 3] = rng.uniform(-1, 1, (512, 3))[:, None]
    goals[:, :, :3, :3] = ikjax.maps.even_rotations(16)
    vary = {"a1": (-0.02, 0.3), "a2": (0.1, 0.7), "a3": (0.005, 0.2), "d3": (0.005, 0.3), "d4": (0.1, 0.7)}
    arm = ikjax.robots.puma560()
    goals = jnp.asarray(goals, jnp.float32)
    tie = ("a1 + a2 + a3 + d3 + d4 = 1",)
    dexterity = ikjax.objectives.dexterous_share
    return Study("b, PUMA dexterity", arm, goals, vary, dexterity, tie, limits=True, blur=(0.1, 0.01), **MANY)


def workpiece() -> Study:
    """A UR5e in front of a barrel 2 m long, which it cannot reach completely: base and tool are varied."""
    along, around = np.meshgrid(np.linspace(-1, 1, 100), np.linspace(-1.2, 1.2, 100))
    along, around = along.ravel(), around.ravel()
    out = np.stack([-np.cos(around), 0 * around, np.sin(around)], -1)
    goals = np.tile(np.eye(4), (len(along), 1, 1))
    goals[:, :3, 3] = np.array([1.0, 0, 0.4]) + 0.5 * out + np.stack([0 * along, along, 0 * along], -1)
    goals[:, :3, 2], goals[:, :3, 1] = -out, [0, 1, 0]
    goals[:, :3, 0] = np.cross(goals[:, :3, 1], goals[:, :3, 2])
    vary = {
        "base.xyz": (-0.5, 0.5),
        "base.turn": (-1.5, 1.5),
        "tool.xyz": (-0.15, 0.15),
        "tool.turn": (-1, 1),
    }
    arm = ikjax.robots.ur5e()
    goals = jnp.asarray(goals, jnp.float32)
    return Study(
        "c, UR5e and a barrel", arm, goals, vary, ikjax.objectives.coverage, blur=(0.2, 0.005), **MANY
    )


def by_gradient(study: Study, seed: int):
    """The result of `design`, and its processor seconds, the choice among starts included."""
    started = time.process_time()
    found = ikjax.design(
        study.arm,
        study.goals,
        study.vary,
        study.objective,
        ties=study.ties,
        starts=study.starts,
        steps=study.steps,
        optimizer=study.optimizer,
        batch=len(study.goals) // study.batch,
        local_search=FINISH,
        blur=study.blur,
        limits=study.limits,
        seed=seed,
    )
    return found, time.process_time() - started


class Counter:
    """The exact score of coordinates (0 to 1 between the bounds), with a log of the best so far."""

    def __init__(self, score, enough):
        self.score, self.enough, self.log = score, enough, []
        self.best, self.where, self.started = -np.inf, None, time.process_time()

    def __call__(self, share) -> float:
        share = np.clip(share, 1e-4, 1 - 1e-4)
        value = float(self.score(np.log(share) - np.log1p(-share)))
        if value > self.best:
            self.best, self.where = value, share
        self.log.append((time.process_time() - self.started, self.best))
        if self.enough(len(self.log), self.log[-1][0]):
            raise StopIteration
        return -value

    def best_after(self, count: int | None = None, seconds: float | None = None) -> float:
        rows = self.log[:count] if count else [row for row in self.log if row[0] <= seconds]
        return rows[-1][1] if rows else -np.inf


def by_rival(name: str, score, size: int, seed: int, enough) -> Counter:
    """Run random search or differential evolution until `enough` evaluations and seconds have passed."""
    counter, rng = Counter(score, enough), np.random.default_rng(seed)
    try:
        if name == "random":
            while True:
                counter(rng.uniform(0, 1, size))
        settings = {"popsize": max(2, 40 // size), "maxiter": 10**6, "tol": 0, "polish": False}
        differential_evolution(counter, [(0, 1)] * size, rng=rng, **settings)
    except StopIteration:
        pass
    return counter


def plan_of(study: Study):
    """The plan that `design` compiles, so that the rivals' score is compiled from the same parts."""
    arm = study.arm.astype(study.goals.dtype)
    parameters = choose_parameters(arm, study.vary, study.ties)
    constant = ascent.ConstantArm(arm)
    return ascent.DesignPlan(
        constant, parameters, study.objective, (), study.optimizer, study.limits, None, 1, 1
    )


def gradient_error(study: Study, values: np.ndarray) -> float:
    """Relative error of the smooth score's gradient, against differences in float64, halfway to the
    optimum."""
    with jax.enable_x64(True):
        goals = jnp.asarray(study.goals, jnp.float64)[::16]
        plan = plan_of(study._replace(goals=goals))
        made = plan.parameters
        z = jnp.asarray(made.coordinates((values + made.of(study.arm)) / 2))
        score = jax.jit(lambda z: plan.score(z, goals, 0.1))
        gradient = np.asarray(jax.jit(jax.grad(lambda z: plan.score(z, goals, 0.1)))(z))
        differences = [float(score(z + 1e-5 * e) - score(z - 1e-5 * e)) / 2e-5 for e in np.eye(len(z))]
        return float(np.abs(gradient - differences).max() / np.abs(differences).max())


def confirmation(study: Study, found) -> str:
    """An independent check of the arms: a sweep over other goals, or the same goals in float64."""
    if study.objective is ikjax.objectives.dexterous_share:
        volumes = []
        for arm in (found.start, found.arm):
            arm = arm.astype(np.float64)
            reach = ikjax.sweep(arm, ikjax.maps.grid((-1, -1, -1), (1, 1, 1), 0.08), 128, dtype="float32")
            volumes.append((reach.reachable_within >= 64).mean())
        return "share of a grid of 15,625 positions with half of 128 orientations by `sweep`: " + (
            f"{volumes[0]:.4f} given, {volumes[1]:.4f} found"
        )
    with jax.enable_x64(True):
        arm, goals = found.arm.astype(np.float64), jnp.asarray(study.goals, jnp.float64)
        sol = ikjax.solve(arm, goals)
        sol = ikjax.within_limits(arm, sol) if study.limits else sol
        return f"reached by `solve` in float64: {np.asarray(sol.valid).any(-1).mean():.2%}"


def run(study: Study, seeds: int) -> list[str]:
    """Rows of the table, and a note on the study."""
    plan = plan_of(study)
    goals = study.goals
    compiled = jax.jit(lambda z, goals: plan.score(z, goals, 0))

    def score(z):
        return compiled(jnp.asarray(z, goals.dtype), goals)

    score(np.zeros(len(plan.parameters.names)))
    by_gradient(study, 0)  # compiles
    rows, far = [], []
    # At equal evaluations, and at equal time: lost, won, equal.
    wins = {name: ([0, 0, 0], [0, 0, 0]) for name in ("random", "evolution")}
    scores = {"gradient": [], "random": [], "evolution": [], "random, time": [], "evolution, time": []}
    for seed in range(seeds):
        found, seconds = by_gradient(study, seed)
        scores["gradient"].append(found.score)
        for name in wins:
            one = by_rival(
                name,
                score,
                len(found.values),
                seed,
                lambda n, t, s=seconds: n >= EVALUATIONS and t >= s,
            )
            both = one.best_after(count=EVALUATIONS), one.best_after(seconds=seconds)
            scores[name].append(both[0])
            scores[f"{name}, time"].append(both[1])
            for tally, b in zip(wins[name], both, strict=True):
                tally[int(found.score > b) + 2 * int(found.score == b)] += 1
            calls = sum(t <= seconds for t, _ in one.log)
            print(
                f"  seed {seed} {seconds:.1f} s gradient {found.score:.6f} {name} {both[0]:.6f}, "
                f"{both[1]:.6f} after {calls} calls in that time",
                flush=True,
            )
        if study.best is not None:
            far.append(float(np.abs(np.array(list(found.values.values())) - study.best).max()))
    best = np.array(list(found.values.values()))

    def summary(name):
        return f"{np.mean(scores[name]):.4f} ({np.min(scores[name]):.4f} to {np.max(scores[name]):.4f})"

    def wins_in_words(tally):
        lost, won, equal = tally
        return f"{won}, {equal}, {lost}"

    for name in wins:
        equal_evaluations = f"{summary(name)} | {wins_in_words(wins[name][0])}"
        equal_time = f"{summary(name + ', time')} | {wins_in_words(wins[name][1])}"
        rows.append(
            f"| {study.title} | {name} | {summary('gradient')} | {equal_evaluations} | {equal_time} |"
        )
    note = f"{study.title}: the given arm {found.start_score:.4f}"
    note += f"; gradient against differences {gradient_error(study, best):.1e}"
    note += f"; {confirmation(study, found)}; {seconds:.1f} s a study"
    if far:
        note += f"; farthest from the known optimum over seeds {max(far):.1e} m"
    note += "; " + ", ".join(f"{k} {v:.3f}" for k, v in found.values.items())
    return [*rows, note]


def main() -> None:
    reader = argparse.ArgumentParser(description=__doc__)
    reader.add_argument("--seeds", type=int, default=10)
    reader.add_argument("--studies", default="abc")
    wanted = reader.parse_args()
    jax.config.update("jax_enable_x64", True)
    every = {"a": [ring_2r, ring_3r], "b": [puma], "c": [workpiece]}
    print(
        f"{EVALUATIONS} evaluations; jax {jax.__version__}",
        flush=True,
    )
    head = "| study | rival | gradient: mean (worst to best) | rival, equal evaluations | won, equal, lost "
    head += "| rival, equal time | won, equal, lost |"
    rows = [row for letter in wanted.studies for make in every[letter] for row in run(make(), wanted.seeds)]
    print(head, "|---|---|---|---|---|---|---|", *(row for row in rows if row[0] == "|"), sep="\n")
    print(*(f"\n{row}" for row in rows if row[0] != "|"), sep="\n")


if __name__ == "__main__":
    main()
