"""`design`: a better arm by gradient ascent from many starts, and an exact count of what it reaches.

The ascent maximizes a smooth score, whose blur shrinks from step to step; the exact score decides in the end.
The host is involved only between chunks of steps.
"""

import dataclasses
import functools
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import optax

from ikjax.arm.arm import Arm
from ikjax.arm.forward import reach
from ikjax.core.tolerances import CONSTRAINT_MET
from ikjax.ik.check import check_goals
from ikjax.ik.redundancy import checked_samples, solve_alternatives
from ikjax.ik.select import within_limits
from ikjax.ik.solve import as_goals, check_family
from ikjax.maps.sets.orientations import Orientations
from ikjax.synthesis import ascent
from ikjax.synthesis.alternatives import checked_alternatives
from ikjax.synthesis.ascent import Constraint, Objective
from ikjax.synthesis.objectives import NAMED
from ikjax.synthesis.parameters import Parameters, choose_parameters


@dataclasses.dataclass(frozen=True, eq=False)
class DesignResult:
    """The best arm of a design study, how it was found, and what it still cannot do."""

    arm: Arm
    """The best by the exact score, of all starts at their end and as they began."""
    start: Arm
    """The arm that was given."""
    values: dict[str, float]
    """What varied, by name [m, rad]; shifts and turns of base and tool from where they were."""
    score: float
    """The exact objective of `arm`."""
    start_score: float
    """That of the given arm, after it was moved into the bounds and onto the ties."""
    reached: np.ndarray
    """bool, the goals' shape: what `arm` reaches, by `solve` and, where limits count, by `within_limits`."""
    margin: np.ndarray
    """[m], the goals' shape: the margin of each goal's best branch, joint limits ignored."""
    scores: np.ndarray
    """(starts,) exact scores at the end."""
    numbers: np.ndarray
    """(starts, k) what varied, at the end, in the order of `values`."""
    history: np.ndarray
    """(steps, starts) the smooth score of each step: with its blur, over its batch of goals."""
    violation: float
    """How far the worst constraint of `arm` is above zero; -inf without constraints."""
    left_out: np.ndarray
    """Rows of the goals that are no poses."""
    goals: np.ndarray
    """The goals of `reached`: without those rows."""
    at_bounds: tuple[str, ...] = ()
    """What ended at a bound, "a2 = 0.6 (upper)": there the best arm may lie beyond."""

    def __repr__(self) -> str:
        values = ", ".join(f"{name} = {value:.5g}" for name, value in self.values.items())
        lines = [
            f"<DesignResult of {self.start.name}: score {self.start_score:.4g} -> {self.score:.4g}",
            f"  {values}",
            f"  {self.reached.sum():,} of {self.reached.size:,} goals reached",
        ]
        lines += [f"  at a bound: {', '.join(self.at_bounds)}"] if self.at_bounds else []
        return "\n".join(lines) + ">"

    def report(self, most: int = 10, *, degrees: bool = False) -> str:
        """The study in a few lines for people, with the goals that are worst out of reach.

        Args:
            most: Goals to name.
            degrees: Angles in degrees instead of radians.
        """
        lines = [
            f"{self.start.name}: score {self.start_score:.4g} -> {self.score:.4g}, the best of "
            f"{len(self.scores)} starts ({self.scores.min():.4g} to {self.scores.max():.4g}) "
            f"after {len(self.history)} steps"
        ]
        for name, value in self.values.items():
            unit, scale = "m", 1.0
            if is_angle(name):
                unit, scale = ("deg", 180 / np.pi) if degrees else ("rad", 1.0)
            lines.append(f"  {name:8} {scale * value:+.5f} {unit}")
        if self.at_bounds:
            lines.append(f"  at a bound: {', '.join(self.at_bounds)}; wider ones may give a better arm")
        if self.violation > -np.inf:
            lines.append(f"  constraints: the worst is {self.violation:+.2g}, wanted at most 0")
        lost = np.argwhere(~self.reached)
        lines.append(f"  goals: {self.reached.sum():,} of {self.reached.size:,} reached")
        if len(self.left_out):
            lines.append(
                f"  left out: {len(self.left_out)} rows that hold no pose, the first {self.left_out[0]}"
            )
        order = np.argsort(self.margin[~self.reached])[:most]
        for index in lost[order]:
            place, margin = self.goals[tuple(index)][:3, 3], self.margin[tuple(index)]
            name = ", ".join(map(str, index))
            why = "beyond the joint limits" if margin > 0 else f"{-1000 * margin:.1f} mm out of reach"
            lines.append(f"    goal {name} at ({', '.join(f'{x:.3f}' for x in place)}): {why}")
        if len(lost) > len(order):
            lines.append(f"    and {len(lost) - len(order)} more")
        return "\n".join(lines)


CHUNK = 25
"""Steps of one compiled call; the multipliers of constraints are updated after each."""

BATCH_SIZE = 4096
"""Goals, over all starts, that are evaluated at a time."""

SAMPLES = 16
"""Values of each redundant joint by default."""

PENALTY = 10.0
"""Weight of a constraint's square at first; it doubles with every chunk, up to a thousandfold."""

NEAR_BOUND, AT_BOUND = 4.0, 20.0
"""Logistic coordinates: 0.02 of the width from a bound, and 2e-9 of it."""

SEARCH_STEP, STEP_GROWTH, STEP_SHRINKAGE = 0.2, 1.5, 0.8
"""Of the local search: its first step, and the factors after a round that improved and one that did not."""


def design(
    arm: Arm,
    goals,
    vary: Mapping[str, Any],
    objective: str | Objective = "coverage",
    *,
    ties: str | Sequence[str] = (),
    constraints: str | Sequence[Constraint | str] = (),
    starts: int = 8,
    steps: int = 200,
    optimizer: optax.GradientTransformation | None = None,
    blur: tuple[float, float] = (0.1, 0.002),
    limits: bool = True,
    batch: int | None = None,
    local_search: int = 0,
    redundancy_samples: int | None = None,
    free_rolls: int = 1,
    alternatives: Orientations | int | np.ndarray | None = None,
    seed: int = 0,
    progress: Callable[[int, np.ndarray], Any] | None = None,
) -> DesignResult:
    """Vary some numbers of an arm so that it serves its goals better.

    Args:
        arm: Where to start: an arm with a family, which it keeps.
        goals: T_world_tool, (..., 4, 4), in the shape that the objective expects. Rows along the first axis
            that are no poses are left out, and counted in the report.
        vary: What may vary and between which bounds: {"a2": (0.2, 0.6), "base.xyz": (-0.3, 0.3)}; see
            `synthesis.parameters.choose_parameters`. Base and tool count from where they are.
        objective: "coverage", "dexterous_share", "worst_margin", "mean_manipulability", or a function
            (arm, sol, blur) -> score, which is maximized; see `synthesis.objectives`. A compiled program is
            used again only if the function is the same object in both calls.
        ties: Linear equations that always hold: "a2 + d4 = 0.8".
        constraints: What must hold at the end: linear inequalities between what varies, "a2 + d4 <= 0.8", or
            functions of the arm that return numbers, met where these are not above zero.
        starts: Number of starts: the given arm, and random ones between the bounds.
        steps: Steps of each start.
        optimizer: Any of optax; by default adam, with a rate that falls from 0.1 to zero along a cosine. It
            moves logistic coordinates, of which one unit is up to a quarter of the width between the bounds.
        blur: Of the score at first and at the end, as a share of the arm's reach.
        limits: Whether the joint limits count.
        batch: Number of rows of goals, drawn at random, for each step; all by default.
        local_search: Number of arms near the best, in whole rounds of twice `starts`, that are evaluated by
            the exact score at the end; the best of them is taken. A share of goals has steps where its
            gradient is zero, and gradient ascent only approaches a bound.
        redundancy_samples: Of an arm with redundant joints: so many values of each are tried, 16 by default,
            the middles of equal parts of its range; the branches at all of them are those of a goal. `sol`
            then has them as its slots, those of the first value first.
        free_rolls, alternatives: Where the tool may turn about its axis, may lean, or only the point matters,
            as in `place`: a goal counts once, and `sol` has the slots of all that is tried.
        seed: Of the random starts and of the drawn goals.
        progress: Called with the steps done and the scores (starts,) after every chunk.

    Returns:
        A `DesignResult`: the best arm, its numbers, the history, and an exact count by `solve`.

    Raises:
        ValueError: As `synthesis.parameters.choose_parameters` says; an arm of no family, goals of a wrong
            shape or without any pose, an unknown objective, a constraint that returns no number (but a
            comparison, for example).
    """
    check_family(arm)
    others = checked_alternatives(free_rolls, alternatives)
    samples = checked_samples(arm, redundancy_samples, SAMPLES)
    goals = as_goals(goals)
    goals = goals[None] if goals.ndim == 2 else goals
    arm, is_pose = arm.astype(goals.dtype), _rows_of_poses(arm, goals)
    if not is_pose.any():
        raise ValueError("goals must hold a pose, none of them is one")
    goals = goals if is_pose.all() else goals[np.flatnonzero(is_pose)]
    _check_options(starts, steps, blur, batch, local_search)
    inequalities, functions = _split_constraints(arm, constraints)
    if isinstance(objective, str):
        if objective not in NAMED:
            raise ValueError(f"objective must be a function or one of {', '.join(NAMED)}, got {objective!r}")
        objective = NAMED[objective]
    ties = [ties] if isinstance(ties, str) else ties
    parameters = choose_parameters(arm, vary, ties, inequalities)
    batch = batch if batch is not None and batch < len(goals) else None
    size = float(reach(arm.baked()))
    rows = (batch or len(goals)) * int(np.prod(goals.shape[1:-2]))
    plan = ascent.DesignPlan(
        ascent.ConstantArm(arm),
        parameters.with_bounds(()),
        objective,
        functions,
        _default_optimizer(steps) if optimizer is None else optimizer,
        limits,
        batch,
        ascent.starts_at_a_time(arm, BATCH_SIZE // (rows * (1 if others is None else len(others)))),
        samples,
        None if others is None else tuple(map(tuple, others.reshape(-1, 16).tolist())),
    )
    ends = jnp.asarray([parameters.lower, parameters.upper], goals.dtype)
    first = parameters.coordinates(parameters.of(arm))
    rest = parameters.random(np.random.default_rng(seed), starts - 1)
    z = jnp.asarray(np.concatenate([first[None], rest]), goals.dtype)
    state = ascent.initial_state(plan, z, ends)
    blurs = size * np.geomspace(*blur, max(steps, 1))
    scores = []
    for at in range(0, steps, CHUNK):
        count = min(CHUNK, steps - at)
        keys = jax.random.split(jax.random.fold_in(jax.random.key(seed), at), count)
        penalty = min(PENALTY * 2.0 ** (at // CHUNK), 1000 * PENALTY)
        weights = (jnp.asarray(blurs[at : at + count], z.dtype), jnp.asarray(penalty, z.dtype))
        state, score = ascent.take_steps(plan, state, goals, keys, *weights, ends)
        scores.append(np.asarray(score))
        if progress is not None:
            progress(at + count, scores[-1][-1])
    candidates = np.concatenate([z, state.z])
    evaluate = functools.partial(ascent.evaluate_exactly, plan, goals=goals, bounds=ends)
    numbers, exact, violations = (np.asarray(x) for x in evaluate(jnp.asarray(candidates, z.dtype)))
    if np.isnan(exact).all():
        raise ValueError(
            "objective must give a number for some arm, got nan for the given one and all starts"
        )
    i = _best_index(exact, violations, np.arange(len(exact)) < starts)
    best = numbers[i], exact[i], violations[i]
    if local_search:
        best = _search_locally(evaluate, candidates[i], best, local_search, seed, len(candidates))
    number, score, violation = best
    made = parameters.put(arm, jnp.asarray(number, goals.dtype))
    judge = functools.partial(within_limits, made) if limits else None
    sol = solve_alternatives(made, goals, others, samples, judge)
    return DesignResult(
        arm=made,
        start=arm,
        values=dict(zip(parameters.names, number.tolist(), strict=True)),
        score=float(score),
        start_score=float(exact[0]),
        reached=np.asarray(sol.valid.any(-1)),
        margin=np.asarray(sol.margin.max(-1)),
        scores=exact[starts:],
        numbers=numbers[starts:],
        history=np.concatenate(scores) if scores else np.zeros((0, starts)),
        violation=float(violation),
        left_out=np.flatnonzero(~is_pose),
        goals=np.asarray(goals),
        at_bounds=_met_bounds(parameters, number),
    )


def is_angle(name: str) -> bool:
    """Whether what varies is an angle [rad]: a twist, a joint angle, a turn of base or tool."""
    return name.rpartition(".")[2].startswith("r") or name[:2] in ("al", "th")


def _met_bounds(parameters: Parameters, values: np.ndarray) -> tuple[str, ...]:
    """Names of what is at a bound, to a fiftieth of the width between its bounds."""
    met = []
    for name, low, high, value in zip(
        parameters.names, parameters.lower, parameters.upper, values.tolist(), strict=True
    ):
        for bound, side in ((low, "lower"), (high, "upper")):
            if abs(value - bound) <= MET_BOUND * (high - low):
                met.append(f"{name} = {bound:g} ({side})")
    return tuple(met)


MET_BOUND = 0.02
"""So near to a bound, in widths between the bounds, counts as at it: ascent only approaches a bound, and the
local search tries the bound itself from there."""


def _best_index(exact: np.ndarray, violations: np.ndarray, is_start: np.ndarray) -> int:
    """The greatest exact score among those that meet the constraints; a start only where nothing is
    better."""
    return int(np.lexsort((is_start, -np.nan_to_num(exact, nan=-np.inf), violations > CONSTRAINT_MET))[0])


def _search_locally(evaluate, z: np.ndarray, best: tuple, count: int, seed: int, batch_size: int) -> tuple:
    """Random local search: `count` arms about z are evaluated exactly, `batch_size` in a round.

    A step is normal in a random half of the logistic coordinates. Its size grows after a round that improved
    and shrinks after one that did not. The search moves to arms of equal score too, because a score may be
    level. Where a number is near a bound, one arm of a round has it at the bound.

    Args:
        evaluate: Numbers, exact scores and violations of coordinates (batch_size, k).
        z: (k,) coordinates of the best arm.
        best: Its numbers (k,), exact score and violation.
        count: Arms to evaluate, rounded up to whole rounds.
        seed: Of the random steps.
        batch_size: Arms of a round.

    Returns:
        Numbers, exact score and violation of the best arm found.
    """
    rng, size = np.random.default_rng(seed), SEARCH_STEP
    for _ in range(-(-count // batch_size)):
        moving = rng.integers(0, 2, (batch_size, len(z)))
        tried = z + size * moving * rng.normal(size=(batch_size, len(z)))
        near = (np.abs(z) > NEAR_BOUND) & (np.abs(z) < AT_BOUND)
        if near.any():
            tried[0] = np.where(near, AT_BOUND * np.sign(z), z)
        values, exact, violations = (np.asarray(x) for x in evaluate(jnp.asarray(tried, best[0].dtype)))
        scores, over = np.append(exact, best[1]), np.append(violations, best[2])
        i = _best_index(scores, over, np.arange(batch_size + 1) == batch_size)
        moved = i < batch_size
        better = moved and (exact[i] != best[1] or violations[i] <= CONSTRAINT_MET < best[2])
        if moved:
            z, best = tried[i], (values[i], exact[i], violations[i])
        size *= STEP_GROWTH if better else STEP_SHRINKAGE
    return best


def _check_options(starts: int, steps: int, blur, batch: int | None, local_search: int) -> None:
    if starts < 1 or min(steps, local_search) < 0:
        raise ValueError(
            "starts must be at least 1, steps and local_search not negative, "
            f"got {starts}, {steps} and {local_search}"
        )
    if batch is not None and batch < 1:
        raise ValueError(f"batch must be at least 1, or None for all goals, got {batch}")
    if min(blur) <= 0:
        raise ValueError(f"blur must be two positive numbers, got {blur}")


def _split_constraints(arm: Arm, given) -> tuple[list[str], tuple[Constraint, ...]]:
    """Constraints as inequalities in text, and as functions that return numbers."""
    if callable(given):
        raise ValueError("constraints must be a sequence of functions or inequalities, got a function")
    constraints = [given] if isinstance(given, str) else list(given)
    functions = tuple(each for each in constraints if not isinstance(each, str))
    for each in functions:
        if not callable(each):
            raise ValueError(
                f"a constraint must be a function or an inequality such as 'a2 <= 1', got {each!r}"
            )
        kind = jax.eval_shape(lambda arm, each=each: jnp.asarray(each(arm)), arm).dtype
        if not jnp.issubdtype(kind, jnp.floating) and not jnp.issubdtype(kind, jnp.integer):
            raise ValueError(
                "a constraint must return numbers that are at most zero where it is met, not whether it is: "
                f"arm.a[1] - 0.5, not arm.a[1] <= 0.5; {getattr(each, '__name__', each)} returns {kind}"
            )
    return [each for each in constraints if isinstance(each, str)], functions


def _rows_of_poses(arm: Arm, goals: jax.Array) -> np.ndarray:
    """Which rows along the first axis are poses throughout, (rows,) bool."""
    rows = np.asarray(goals)
    good = np.ones(len(rows), bool)
    try:
        check_goals(arm, rows)
    except ValueError:
        for i, row in enumerate(rows):
            try:
                check_goals(arm, row)
            except ValueError:
                good[i] = False
    return good


@functools.cache
def _default_optimizer(steps: int) -> optax.GradientTransformation:
    return optax.adam(optax.cosine_decay_schedule(0.1, max(steps, 1)))
