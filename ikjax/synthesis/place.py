"""`place`: where an arm should stand for its goals.

The goals reached from candidates on a grid are counted, the best candidates are polished by gradient ascent,
and the result is ranked by exact counts.
"""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from ikjax.arm.arm import Arm
from ikjax.arm.forward import reach
from ikjax.ik.check import check_goals
from ikjax.ik.margins import limited_margins
from ikjax.ik.redundancy import checked_samples, solve_at_samples
from ikjax.ik.solve import as_goals, check_family
from ikjax.maps.reach_map import ReachMap
from ikjax.maps.sets.positions import Grid
from ikjax.solvers.pipeline import as_solved
from ikjax.synthesis import candidates
from ikjax.synthesis.ascent import ConstantArm, PlacementPlan, polish_placements, starts_at_a_time
from ikjax.synthesis.parameters import TWIST
from ikjax.synthesis.search_space import SearchSpace, search_space


@dataclasses.dataclass(frozen=True, eq=False)
class Placements:
    """Poses for the base of an arm, the best first, and how they were found.

    `dataclasses.replace(arm, base=bases.base[0])` is the arm at the first of them.
    """

    arm: Arm
    """The given arm, where it stood."""
    goals: np.ndarray
    """(..., 4, 4) as given."""
    base: np.ndarray
    """(k, 4, 4) T_world_base, ranked and distinct."""
    score: np.ndarray
    """(k,) which ranks them: the share of goals reached; the worst margin adds less than one goal."""
    share: np.ndarray
    """(k,) of the goals that are reached, by `solve` and, where limits count, by `within_limits`."""
    reached: np.ndarray
    """(k, ...) bool: which goals."""
    worst_margin: np.ndarray
    """(k,) [m] the least margin of all goals, each by its best branch; negative where one is out of reach.
    Where limits count, the margin includes them, see `limited_margins`."""
    start: np.ndarray
    """(k, 4, 4) each on the grid, before it was polished."""
    start_score: np.ndarray
    """(k,) score of `start`."""
    start_share: np.ndarray
    """(k,) share of `start`."""
    grid: Grid
    """Positions of the candidates."""
    turns: np.ndarray
    """(t,) [rad] about z, from how the arm was given; only zero where a turn changes nothing."""
    tried: np.ndarray
    """(*grid.shape, t) share of goals reached from every candidate: exact, or looked up in the map."""

    def __len__(self) -> int:
        return len(self.base)

    def __str__(self) -> str:
        shape = self.reached.shape[1:]
        count = int(np.prod(shape))
        lines = [
            f"{self.arm.name}: {count:,} goals, {self.tried.size:,} bases tried "
            f"({self.grid.in_words()} x {len(self.turns)} turns)"
        ]
        if not self.reached.any():
            lines.append("  no base reaches any goal; these come nearest")
        for k in range(len(self)):
            number = int(self.reached[k].sum())
            before = round(self.start_share[k] * count)
            lines.append(
                f"  {k + 1:2}  {self._in_words(k)}: {number:,} goals ({self.share[k]:.1%}), "
                f"worst margin {1000 * self.worst_margin[k]:+.1f} mm; {before:,} before polishing"
            )
        return "\n".join(lines)

    def _in_words(self, k: int) -> str:
        base = np.asarray(self.base[k], float)
        x, y, z = base[:3, 3]
        turn = base[:3, :3] @ np.asarray(self.arm.base, float)[:3, :3].T
        about = np.degrees(np.arctan2(turn[1, 0] - turn[0, 1], turn[0, 0] + turn[1, 1]))
        tilt = np.degrees(np.arctan2(np.hypot(turn[0, 2], turn[1, 2]), turn[2, 2]))
        leaning = f", tilted {tilt:.1f} deg" if tilt > 0.05 else ""
        return f"x {x:+.3f}, y {y:+.3f}, z {z:+.3f} m, turned {about:+.1f} deg{leaning}"


BATCH_SIZE = 4096
"""Goals, over all starts, that are evaluated at a time."""

SAMPLES = 16
"""Values of each redundant joint by default."""

BLUR = (0.05, 0.002)
"""Of the margins in the smooth score, at first and at the end, in reaches."""

RATE = 0.3
"""First step of the ascent, in spacings of the candidates; it falls to zero along a cosine."""

MARGIN_WEIGHT = 0.49
"""Goals that the worst margin counts for at most, either way: less than half, so that the count decides."""


def place(
    arm: Arm,
    goals,
    *,
    reach_map: ReachMap | None = None,
    move: Sequence[str] = ("x", "y", "turn"),
    bounds: Mapping[str, tuple[float, float]] | None = None,
    spacing: float | None = None,
    turns: int = 12,
    keep: int = 5,
    limits: bool = True,
    starts: int = 16,
    steps: int = 60,
    redundancy_samples: int | None = None,
) -> Placements:
    """Where to put the base of an arm so that it reaches the most goals, with the most to spare.

    Args:
        arm: An arm with a family. Its base pose gives the orientation of the base and what does not move.
        goals: T_world_tool, (..., 4, 4), float32 or float64. Polishing needs all of them in memory.
        reach_map: A map of this arm over a grid, in which candidates are looked up instead of solved:
            orientation by orientation with the statistic `mask_within` (`mask` without limits), else by the
            share of orientations. The returned bases are still evaluated by `solve`.
        move: Which of "x", "y", "z", "turn" (about the world's z) and "tilt" (about its x and y) may change.
            Candidates are not tilted; only polishing tilts them.
        bounds: Of some of these: x, y and z in the world [m], turn and tilt from how the arm was given [rad].
            The base is turned first and then tilted, by a rotation vector whose x and y are bounded each.
            By default x, y and z go as far as any goal can be reached from, the turn is unbounded and tilts
            are up to a quarter turn.
        spacing: Of candidates [m]; by default a sixteenth of the reach, or more so that there are at most
            65,536 positions.
        turns: Number of candidates for the turn. Where the first axis is vertical and its limits allow a
            whole turn, turning the base changes nothing, and only one is tried.
        keep: Most bases to return; no two of them are neighbors on the grid, or nearer.
        limits: Whether the joint limits count.
        starts: How many of the best candidates, distinct in the same way, are evaluated exactly and polished.
        steps: Steps of each start; 0 leaves it on the grid. They never make a base worse.
        redundancy_samples: Of an arm with redundant joints: so many values of each are tried, 16 by default,
            the middles of equal parts of its range. A goal counts as reached if one of them reaches it.

    Returns:
        `Placements`, the best first. Their text says so if none reaches any goal.

    Raises:
        ValueError: An arm of no family; no goals, or a goal that is no pose; an unknown move, bounds out of
            order, numbers out of range; a map of another arm or without the counts that are needed.
    """
    check_family(arm)
    samples = checked_samples(arm, redundancy_samples, SAMPLES)
    given = as_goals(goals)
    check_goals(arm, given)
    flat = np.asarray(given).reshape(-1, 4, 4)
    if not len(flat):
        raise ValueError(f"goals must hold at least one pose, got shape {given.shape}")
    for name, value in {"turns": turns, "keep": keep, "starts": starts, "steps": steps}.items():
        least = 0 if name == "steps" else 1
        if isinstance(value, bool) or not isinstance(value, int | np.integer) or value < least:
            raise ValueError(f"{name} must be a whole number, at least {least}, got {value!r}")
    arm = as_solved(arm.astype(given.dtype))
    size = float(reach(arm.baked()))
    space = search_space(arm, flat[:, :3, 3].astype(float), size, move, bounds or {}, spacing, turns, limits)
    points = space.grid.points().reshape(-1, 3)
    if reach_map is None:
        count, spare = candidates.count_reached(arm, flat, points, space.turns, limits, samples)
        tried = count / len(flat)
    else:
        tried = candidates.look_up_shares(reach_map, arm, flat, points, space.turns, limits)
        spare = candidates.smoothed(tried.reshape(*space.grid.shape, -1)).reshape(tried.shape)
    order = np.lexsort((-spare.reshape(-1), -tried.reshape(-1)))
    first = space.candidates()[order]
    first = first[space.distinct(first, starts)]
    polished, count, worst = _polished(arm, flat, space, first, size, limits, steps, samples)
    ranked = np.lexsort((-worst, -count))
    ranked = ranked[space.distinct(polished[ranked], keep)]
    # The returned matrices themselves are evaluated: they are rounded, and polishing moved the goals instead
    # of the base.
    ends, begins = (
        [
            _evaluate_base(arm, b.astype(given.dtype), flat, limits, samples)
            for b in space.base_poses(x[ranked])
        ]
        for x in (polished, first)
    )
    pairs = [(max(pair, key=_Evaluation.rank), pair[1]) for pair in zip(ends, begins, strict=True)]
    best, begun = zip(*sorted(pairs, key=lambda pair: pair[0].rank(), reverse=True), strict=True)

    def score(evaluations: Sequence[_Evaluation]) -> np.ndarray:
        margins = np.array([each.worst for each in evaluations])
        counts = np.array([each.reached.sum() for each in evaluations])
        return (counts + MARGIN_WEIGHT * np.clip(margins / size, -1, 1)) / len(flat)

    return Placements(
        arm=arm,
        goals=np.asarray(given),
        base=np.stack([each.base for each in best]),
        score=score(best),
        share=np.array([each.reached.mean() for each in best]),
        reached=np.stack([each.reached.reshape(given.shape[:-2]) for each in best]),
        worst_margin=np.array([each.worst for each in best]),
        start=np.stack([each.base for each in begun]),
        start_score=score(begun),
        start_share=np.array([each.reached.mean() for each in begun]),
        grid=space.grid,
        turns=space.turns,
        tried=tried.reshape(*space.grid.shape, -1),
    )


class _Evaluation(NamedTuple):
    """A base pose, and what `solve` finds for the arm there."""

    base: np.ndarray
    """(4, 4)"""
    reached: np.ndarray
    """(g,) bool"""
    worst: float
    """[m]"""

    def rank(self) -> tuple[int, float]:
        return int(self.reached.sum()), self.worst


def _evaluate_base(arm: Arm, base: np.ndarray, goals: np.ndarray, limits: bool, samples: int) -> _Evaluation:
    moved = dataclasses.replace(arm, base=base)
    sol = solve_at_samples(moved, jnp.asarray(goals), samples)
    sol = limited_margins(moved, sol) if limits else sol
    return _Evaluation(base, np.asarray(sol.valid.any(-1)), float(sol.margin.max(-1).min()))


def _polished(
    arm: Arm,
    goals: np.ndarray,
    space: SearchSpace,
    first: np.ndarray,
    size: float,
    limits: bool,
    steps: int,
    samples: int,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The best placements on the way from each of `first`, the goals they reach, their worst margins."""
    columns = [TWIST.index(name) for name in space.free_coordinates]
    home = np.concatenate([space.home[:3, 3], np.zeros(3)])
    lower, upper = space.bounds()
    start_batch_size = starts_at_a_time(arm, BATCH_SIZE // len(goals))
    plan = PlacementPlan(ConstantArm(arm), space.free_coordinates, limits, start_batch_size, samples)
    phase = np.linspace(0, np.pi, steps + 1)
    numbers = [
        (first - home)[:, columns],
        goals,
        space.spacings[columns],
        lower - home[columns],
        upper - home[columns],
        size * np.geomspace(*BLUR, steps + 1),
        RATE * (1 + np.cos(phase)) / 2,
    ]
    best = polish_placements(plan, *(jnp.asarray(x, goals.dtype) for x in numbers))
    polished = first.copy()
    polished[:, columns] = np.asarray(best.values, float) + home[columns]
    return polished, np.asarray(best.count), np.asarray(best.worst)
