"""`design`: a better arm by gradient, many starts at once, and an exact count of what it reaches.

A score is climbed while its blur shrinks; what decides in the end is the exact score. Only
between chunks of steps does the host look in.
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
from ikjax.ik.select import within_limits
from ikjax.ik.solve import as_goals, check_family, solve
from ikjax.synthesis import ascent
from ikjax.synthesis.ascent import Constraint, Objective
from ikjax.synthesis.objectives import NAMED
from ikjax.synthesis.parameters import chosen


@dataclasses.dataclass(frozen=True, eq=False)
class DesignResult:
    """The best arm of a design study, how it was found, and what it still cannot do."""

    arm: Arm
    """The best of all starts, by the exact score; the first one as it began is among them."""
    start: Arm
    """The arm that was given."""
    values: dict[str, float]
    """What moved, by name [m, rad]; shifts and turns of base and tool from where they were."""
    score: float
    """The objective of `arm`, exact."""
    start_score: float
    """That of the given arm, moved between the bounds and tied where it was not."""
    reached: np.ndarray
    """bool, the goals' shape: what `arm` reaches, by `solve` and, where limits count, `within_limits`."""
    margin: np.ndarray
    """[m], the goals' shape: of each goal's best branch, joint limits left out."""
    scores: np.ndarray
    """(starts,) exact scores in the end."""
    numbers: np.ndarray
    """(starts, k) what moved, in the end, in the order of `values`."""
    history: np.ndarray
    """(steps, starts) the score as it was climbed: with its blur, and over the batch of the step."""
    violation: float
    """How far the worst constraint of `arm` is above zero; -inf without constraints."""
    left_out: np.ndarray
    """Rows of the goals that hold what is no pose."""
    goals: np.ndarray
    """The goals of `reached`: without those rows."""

    def report(self, most: int = 10) -> str:
        """The study in a few lines for people, with the goals that are worst out of reach."""
        lines = [
            f"{self.start.name}: score {self.start_score:.4g} -> {self.score:.4g}, the best of "
            f"{len(self.scores)} starts ({self.scores.min():.4g} to {self.scores.max():.4g}) "
            f"after {len(self.history)} steps"
        ]
        for name, value in self.values.items():
            unit = "rad" if name.rpartition(".")[2].startswith("r") or name[:2] in ("al", "th") else "m"
            lines.append(f"  {name:8} {value:+.5f} {unit}")
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
"""Steps between two looks of the host; multipliers of constraints change there."""

BLOCK = 4096
"""Goals, over all starts, that are worked on at a time."""

PULL = 10.0
"""Weight of a constraint's square at first; it doubles with every chunk, up to a thousandfold."""

NEAR, AT = 4.0, 20.0
"""Logistic coordinates two hundredths of the way from a bound, and at it but for a billionth."""

SEARCH, LONGER, SHORTER = 0.2, 1.5, 0.8
"""Steps of the search at the end: at first, and how they change."""


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
    seed: int = 0,
    progress: Callable[[int, np.ndarray], Any] | None = None,
) -> DesignResult:
    """Move some numbers of an arm so that it serves its goals better.

    Args:
        arm: Where to start; an arm with a family, which it keeps.
        goals: T_world_tool, (..., 4, 4), in whatever shape the objective looks for. Rows along the first
            axis that hold what is no pose are left out, and counted in the report.
        vary: What may move and between which bounds: {"a2": (0.2, 0.6), "base.xyz": (-0.3, 0.3)}; see
            `synthesis.parameters.chosen`. Base and tool count from where they are.
        objective: "coverage", "dexterous_share", "worst_margin", "mean_manipulability", or a function
            (arm, sol, blur) -> score, to be made as great as can be; see `synthesis.objectives`. Functions
            must be the same object from call to call for a compiled program to be used again.
        ties: Linear equations that hold throughout: "a2 + d4 = 0.8".
        constraints: What must hold in the end: linear inequalities between what varies, "a2 + d4 <= 0.8", or
            functions of the arm that return numbers, met where these are not above zero.
        starts: How many arms climb: the given one, and others anywhere between the bounds.
        steps: Of each.
        optimizer: Any of optax; adam by default, its rate 0.1 falling to zero along a cosine. What it moves
            are logistic coordinates, one unit of which is up to a quarter of the way between bounds.
        blur: Of the score at first and in the end, as a share of the arm's reach.
        limits: Whether the joint limits count.
        batch: So many rows of goals, picked at random, for each step; all by default.
        local_search: So many arms near the best, in whole rounds of twice `starts`, are judged by the exact
            score in the end, and the best of them is taken. A share of goals has steps that no slope sees,
            and a bound is only neared by climbing.
        seed: Of the other starts, and of the picking.
        progress: Called with the steps done and the scores (starts,) after every chunk.

    Returns:
        A `DesignResult`: the best arm, its numbers, the history, and an exact count by `solve`.

    Raises:
        ValueError: As `synthesis.parameters.chosen` says; an arm of no family, goals of a wrong shape or none
            that is a pose, an unknown objective, a constraint that returns no number (a comparison, say).
    """
    check_family(arm)
    goals = as_goals(goals)
    goals = goals[None] if goals.ndim == 2 else goals
    arm, kept = arm.astype(goals.dtype), _poses(arm, goals)
    if not kept.any():
        raise ValueError("goals must hold a pose, none of them is one")
    goals = goals if kept.all() else goals[np.flatnonzero(kept)]
    _check(starts, steps, blur, batch, local_search)
    rules, functions = _constraints(arm, constraints)
    if isinstance(objective, str):
        if objective not in NAMED:
            raise ValueError(f"objective must be a function or one of {', '.join(NAMED)}, got {objective!r}")
        objective = NAMED[objective]
    parameters = chosen(arm, vary, [ties] if isinstance(ties, str) else ties, rules)
    batch = batch if batch is not None and batch < len(goals) else None
    size = float(reach(arm.baked()))
    plan = ascent.Plan(
        ascent.Known(arm),
        parameters,
        objective,
        functions,
        _usual(steps) if optimizer is None else optimizer,
        limits,
        batch,
        max(1, BLOCK // ((batch or len(goals)) * int(np.prod(goals.shape[1:-2])))),
    )
    first = parameters.coordinates(parameters.of(arm))
    rest = parameters.random(np.random.default_rng(seed), starts - 1)
    z = jnp.asarray(np.concatenate([first[None], rest]), goals.dtype)
    state = ascent.started(plan, z)
    blurs = size * np.geomspace(*blur, max(steps, 1))
    scores = []
    for at in range(0, steps, CHUNK):
        some = min(CHUNK, steps - at)
        keys = jax.random.split(jax.random.fold_in(jax.random.key(seed), at), some)
        pull = min(PULL * 2.0 ** (at // CHUNK), 1000 * PULL)
        state, score = ascent.chunk(
            plan, state, goals, keys, jnp.asarray(blurs[at : at + some], z.dtype), jnp.asarray(pull, z.dtype)
        )
        scores.append(np.asarray(score))
        if progress is not None:
            progress(at + some, scores[-1][-1])
    everyone = np.concatenate([z, state.z])
    judge = functools.partial(ascent.judged, plan, goals=goals)
    values, exact, over = (np.asarray(x) for x in judge(jnp.asarray(everyone, z.dtype)))
    if np.isnan(exact).all():
        raise ValueError(
            "objective must give a number for some arm, got nan for the given one and all starts"
        )
    best = _best(exact, over, np.arange(len(exact)) < starts)
    number, score, violation = values[best], exact[best], over[best]
    if local_search:
        number, score, violation = _searched(
            judge, everyone[best], (number, score, violation), local_search, seed, len(everyone)
        )
    made = parameters.put(arm, jnp.asarray(number, goals.dtype))
    sol = solve(made, goals)
    sol = within_limits(made, sol) if limits else sol
    return DesignResult(
        arm=made,
        start=arm,
        values=dict(zip(parameters.names, number.tolist(), strict=True)),
        score=float(score),
        start_score=float(exact[0]),
        reached=np.asarray(sol.valid.any(-1)),
        margin=np.asarray(sol.margin.max(-1)),
        scores=exact[starts:],
        numbers=values[starts:],
        history=np.concatenate(scores) if scores else np.zeros((0, starts)),
        violation=float(violation),
        left_out=np.flatnonzero(~kept),
        goals=np.asarray(goals),
    )


def _best(exact: np.ndarray, over: np.ndarray, given: np.ndarray) -> int:
    """The greatest exact score among those that meet the constraints; a start where nothing is better."""
    return int(np.lexsort((given, -np.nan_to_num(exact, nan=-np.inf), over > CONSTRAINT_MET))[0])


def _searched(judge, z: np.ndarray, best: tuple, count: int, seed: int, together: int) -> tuple:
    """Numbers, exact score and violation after judging `count` arms about z, `together` at a time.

    Steps are normal in half of the logistic coordinates, longer after a round that found better, shorter
    after one that did not; arms as good are gone on from too, for a score may be level. Where something is
    near a bound, one arm of a round has it there.
    """
    rng, size = np.random.default_rng(seed), SEARCH
    for _ in range(-(-count // together)):
        some = rng.integers(0, 2, (together, len(z)))
        beside = z + size * some * rng.normal(size=(together, len(z)))
        near = (np.abs(z) > NEAR) & (np.abs(z) < AT)
        if near.any():
            beside[0] = np.where(near, AT * np.sign(z), z)
        values, exact, over = (np.asarray(x) for x in judge(jnp.asarray(beside, best[0].dtype)))
        i = _best(np.append(exact, best[1]), np.append(over, best[2]), np.arange(together + 1) == together)
        better = i < together and (exact[i] != best[1] or over[i] <= CONSTRAINT_MET < best[2])
        if i < together:
            z, best = beside[i], (values[i], exact[i], over[i])
        size *= LONGER if better else SHORTER
    return best


def _check(starts: int, steps: int, blur, batch: int | None, local_search: int) -> None:
    if starts < 1 or min(steps, local_search) < 0:
        raise ValueError(
            "starts must be at least 1, steps and local_search not negative, "
            f"got {starts}, {steps} and {local_search}"
        )
    if batch is not None and batch < 1:
        raise ValueError(f"batch must be at least 1, or None for all goals, got {batch}")
    if min(blur) <= 0:
        raise ValueError(f"blur must be two positive numbers, got {blur}")


def _constraints(arm: Arm, given) -> tuple[list[str], tuple[Constraint, ...]]:
    """Inequalities as text, and functions that return numbers."""
    if callable(given):
        raise ValueError("constraints must be a sequence of functions or inequalities, got a function")
    every = [given] if isinstance(given, str) else list(given)
    functions = tuple(each for each in every if not isinstance(each, str))
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
    return [each for each in every if isinstance(each, str)], functions


def _poses(arm: Arm, goals: jax.Array) -> np.ndarray:
    """Which rows along the first axis hold poses only."""
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
def _usual(steps: int) -> optax.GradientTransformation:
    return optax.adam(optax.cosine_decay_schedule(0.1, max(steps, 1)))
