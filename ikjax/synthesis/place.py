"""`place`: where an arm should stand for its goals.

Candidates on a grid are counted, the best of them are polished by gradient, and what is
returned is ranked by exact counts.
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
from ikjax.ik.solve import as_goals, check_family, solve
from ikjax.maps.reach_map import ReachMap
from ikjax.maps.sets.positions import Grid
from ikjax.solvers.pipeline import as_solved
from ikjax.synthesis import candidates
from ikjax.synthesis.ascent import Hill, Known, nudged
from ikjax.synthesis.parameters import TWIST
from ikjax.synthesis.search_space import Room, room


@dataclasses.dataclass(frozen=True, eq=False)
class Placements:
    """Places for the base of an arm, the best first, and how they were found.

    `dataclasses.replace(arm, base=bases.base[0])` is the arm at the first of them.
    """

    arm: Arm
    """The arm that was given, where it stood."""
    goals: np.ndarray
    """(..., 4, 4) as they were given."""
    base: np.ndarray
    """(k, 4, 4) T_world_base, ranked and distinct."""
    score: np.ndarray
    """(k,) what ranks them: the share of goals reached, and the worst margin as less than one goal."""
    share: np.ndarray
    """(k,) of the goals that are reached, by `solve` and, where limits count, `within_limits`."""
    reached: np.ndarray
    """(k, ...) bool: which goals."""
    worst_margin: np.ndarray
    """(k,) [m] of the goal that is worst off, by its best branch; negative where one is out of reach.
    Where limits count it ends at them too, see `limited_margins`."""
    start: np.ndarray
    """(k, 4, 4) where on the grid each was before it was polished."""
    start_score: np.ndarray
    """(k,) there."""
    start_share: np.ndarray
    """(k,) there."""
    grid: Grid
    """Positions of the candidates."""
    turns: np.ndarray
    """(t,) [rad] about z, from how the arm was given; zero alone where a turn changes nothing."""
    tried: np.ndarray
    """(*grid.shape, t) share of goals reached from every candidate: exact, or as the map has it."""

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
                f"  {k + 1:2}  {self._place(k)}: {number:,} goals ({self.share[k]:.1%}), "
                f"worst margin {1000 * self.worst_margin[k]:+.1f} mm; {before:,} before polishing"
            )
        return "\n".join(lines)

    def _place(self, k: int) -> str:
        base = np.asarray(self.base[k], float)
        x, y, z = base[:3, 3]
        turn = base[:3, :3] @ np.asarray(self.arm.base, float)[:3, :3].T
        about = np.degrees(np.arctan2(turn[1, 0] - turn[0, 1], turn[0, 0] + turn[1, 1]))
        tilt = np.degrees(np.arctan2(np.hypot(turn[0, 2], turn[1, 2]), turn[2, 2]))
        leaning = f", tilted {tilt:.1f} deg" if tilt > 0.05 else ""
        return f"x {x:+.3f}, y {y:+.3f}, z {z:+.3f} m, turned {about:+.1f} deg{leaning}"


TOGETHER = 4096
"""Goals, over all starts, that are worked on at a time."""

BLUR = (0.05, 0.002)
"""Of the margins that are climbed, at first and in the end, in reaches."""

RATE = 0.3
"""Of a step at first, in distances between candidates; it falls to zero along a cosine."""

LESS = 0.49
"""Goals that the worst margin counts for at most, either way."""


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
) -> Placements:
    """Where to put the base of an arm so that it reaches the most goals, with the most to spare.

    Args:
        arm: An arm with a family; where it stands says how the base is turned and what does not move.
        goals: T_world_tool, (..., 4, 4), float32 or float64. Polishing holds all of them in memory.
        reach_map: A map of this arm over a grid, where candidates are looked up instead of solved:
            orientation by orientation with the statistic `mask_within` (`mask` without limits), else by the
            share of them. What is returned is judged by `solve` all the same.
        move: Which of "x", "y", "z", "turn" (about the world's z) and "tilt" (about its x and y) may change.
            Candidates are not tilted, polishing does that.
        bounds: Of some of these: x, y and z in the world [m], turn and tilt from how the arm was given [rad].
            It is turned first and then tilted, by a rotation vector whose x and y are bounded each.
            By default x, y and z go as far as any goal can be reached from, turns go round and tilts are
            up to a quarter turn.
        spacing: Of candidates [m]; by default a sixteenth of the reach, or what makes 65,536 positions.
        turns: Candidates for the turn. Where the first axis stands upright and its limits leave it a whole
            turn, turning the base changes nothing, and one is tried.
        keep: How many to return at most; no two of them are neighbors on the grid, or nearer.
        limits: Whether the joint limits count.
        starts: How many of the best candidates, distinct likewise, are judged exactly and polished.
        steps: Of each; 0 leaves them on the grid. A base never gets worse by them.

    Returns:
        `Placements`, the best first. Where none reaches anything it says so.

    Raises:
        ValueError: An arm of no family; no goals, or what is no pose, by name; an unknown move, bounds out of
            order, numbers out of range; a map of another arm or without the counts that are needed.
    """
    check_family(arm)
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
    where = room(arm, flat[:, :3, 3].astype(float), size, move, bounds or {}, spacing, turns, limits)
    points = where.grid.points().reshape(-1, 3)
    if reach_map is None:
        count, spare = candidates.solved(arm, flat, points, where.turns, limits)
        tried = count / len(flat)
    else:
        tried = candidates.looked_up(reach_map, arm, flat, points, where.turns, limits)
        spare = candidates.amid(tried.reshape(*where.grid.shape, -1)).reshape(tried.shape)
    order = np.lexsort((-spare.reshape(-1), -tried.reshape(-1)))
    first = where.places()[order]
    first = first[where.distinct(first, starts)]
    found, count, worst = _polished(arm, flat, where, first, size, limits, steps)
    ranked = np.lexsort((-worst, -count))
    ranked = ranked[where.distinct(found[ranked], keep)]
    # What is returned is judged as it is returned: a place is rounded to a matrix, and polishing moved the
    # goals in the place of the base.
    ends, begins = (
        [_stand(arm, base, flat, limits) for base in where.bases(places[ranked]).astype(given.dtype)]
        for places in (found, first)
    )
    pairs = [(max(pair, key=_Stand.rank), pair[1]) for pair in zip(ends, begins, strict=True)]
    best, begun = zip(*sorted(pairs, key=lambda pair: pair[0].rank(), reverse=True), strict=True)

    def score(stands: Sequence[_Stand]) -> np.ndarray:
        margins = np.array([stand.worst for stand in stands])
        counts = np.array([stand.reached.sum() for stand in stands])
        return (counts + LESS * np.clip(margins / size, -1, 1)) / len(flat)

    return Placements(
        arm=arm,
        goals=np.asarray(given),
        base=np.stack([stand.base for stand in best]),
        score=score(best),
        share=np.array([stand.reached.mean() for stand in best]),
        reached=np.stack([stand.reached.reshape(given.shape[:-2]) for stand in best]),
        worst_margin=np.array([stand.worst for stand in best]),
        start=np.stack([stand.base for stand in begun]),
        start_score=score(begun),
        start_share=np.array([stand.reached.mean() for stand in begun]),
        grid=where.grid,
        turns=where.turns,
        tried=tried.reshape(*where.grid.shape, -1),
    )


class _Stand(NamedTuple):
    """A base, and what `solve` says of the arm there."""

    base: np.ndarray
    """(4, 4)"""
    reached: np.ndarray
    """(g,) bool"""
    worst: float
    """[m]"""

    def rank(self) -> tuple[int, float]:
        return int(self.reached.sum()), self.worst


def _stand(arm: Arm, base: np.ndarray, goals: np.ndarray, limits: bool) -> _Stand:
    there = dataclasses.replace(arm, base=base)
    sol = solve(there, goals)
    sol = limited_margins(there, sol) if limits else sol
    return _Stand(base, np.asarray(sol.valid.any(-1)), float(sol.margin.max(-1).min()))


def _polished(
    arm: Arm, goals: np.ndarray, where: Room, first: np.ndarray, size: float, limits: bool, steps: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The best places that `first` come by, how many goals they reach, their worst margins."""
    columns = [TWIST.index(name) for name in where.climbs]
    home = np.concatenate([where.home[:3, 3], np.zeros(3)])
    lower, upper = where.bounds()
    hill = Hill(Known(arm), where.climbs, limits, max(1, TOGETHER // len(goals)))
    phase = np.linspace(0, np.pi, steps + 1)
    numbers = [
        (first - home)[:, columns],
        goals,
        where.steps[columns],
        lower - home[columns],
        upper - home[columns],
        size * np.geomspace(*BLUR, steps + 1),
        RATE * (1 + np.cos(phase)) / 2,
    ]
    best = nudged(hill, *(jnp.asarray(x, goals.dtype) for x in numbers))
    found = first.copy()
    found[:, columns] = np.asarray(best.values, float) + home[columns]
    return found, np.asarray(best.count), np.asarray(best.worst)
