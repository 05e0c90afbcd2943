"""`place`: where an arm should stand for its goals.

The goals reached from candidates on a grid are counted, the best candidates are polished by gradient ascent,
and the result is ranked by exact counts.
"""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from scipy.spatial.transform import Rotation

from ikjax.arm.arm import Arm
from ikjax.arm.forward import reach
from ikjax.ik.check import check_goals
from ikjax.ik.redundancy import checked_samples
from ikjax.ik.solve import as_goals, check_family
from ikjax.maps.reach_map import ReachMap
from ikjax.maps.sets.orientations import Orientations
from ikjax.maps.sets.positions import Grid
from ikjax.maps.sets.surface import Surface
from ikjax.solvers.pipeline import as_solved
from ikjax.synthesis import candidates
from ikjax.synthesis.allowed import Allowed, allowed
from ikjax.synthesis.alternatives import checked_alternatives
from ikjax.synthesis.ascent import (
    ConstantArm,
    PlacementData,
    PlacementPlan,
    evaluate_placement,
    polish_placements,
    starts_at_a_time,
)
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
    """(*grid.shape, t) share of goals reached from every candidate: exact, or looked up in the map; zero
    where the base may not stand."""
    alternatives: np.ndarray | None = None
    """(m, 4, 4) what the tool may be turned by, of which one has to reach a goal; None where it must not."""

    def __len__(self) -> int:
        return len(self.base)

    def __repr__(self) -> str:
        lines = str(self).splitlines()
        rest = [f"  and {len(lines) - 4} more"] if len(lines) > 5 else lines[4:5]
        return "\n".join(["<" + lines[0], *lines[1:4], *rest]) + ">"

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
    bounds: Mapping[str, tuple[float, float]] | Sequence[Mapping[str, tuple[float, float]]] | None = None,
    spacing: float | None = None,
    turns: int = 12,
    keep: int = 5,
    limits: bool = True,
    starts: int = 16,
    steps: int = 60,
    redundancy_samples: int | None = None,
    free_rolls: int = 1,
    alternatives: Orientations | int | np.ndarray | None = None,
    keep_out: Sequence | np.ndarray | None = None,
    parts: np.ndarray | Surface | None = None,
    clearance: float = 0.0,
    rail: Sequence | np.ndarray | None = None,
) -> Placements:
    """Where to put the base of an arm so that it reaches the most goals, with the most to spare.

    Args:
        arm: An arm with a family. Its base pose gives the orientation of the base and what does not move.
        goals: T_world_tool, (..., 4, 4), float32 or float64. Polishing needs all of them in memory.
        reach_map: A map of this arm over a grid, in which candidates are looked up instead of solved:
            orientation by orientation with the statistic `mask_within` (`mask` without limits), else by the
            share of orientations. The returned bases are still evaluated by `solve`.
        move: Which of "x", "y", "z", "turn" (about the world's z), "tilt" (about its x and y) and "rail" may
            change. Candidates are not tilted; only polishing tilts them. "rail" stands for x, y and z.
        bounds: Of some of these: x, y and z in the world [m], turn and tilt from how the arm was given [rad].
            The base is turned first and then tilted, by a rotation vector whose x and y are bounded each.
            By default x, y and z go as far as any goal can be reached from, the turn is unbounded and tilts
            are up to a quarter turn. Several of these, each of some of x, y and z, are disjoint regions of
            which one must hold the base; a direction that one does not name is bounded as in the others.
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
        free_rolls: Where the tool may turn about its own z axis: so many rolls of each goal are tried, and it
            counts once if one of them is reached.
        alternatives: What the tool may be turned by in its own frame, of which one must do, with every free
            roll: a set or rotations (m, 3, 3) as of `sweep`. `maps.cone((0, 0, 1), half_angle, n)` for a tool
            axis within a cone, `maps.even_rotations(n)` where only the point matters.
        keep_out: Boxes (b, 2, 3) or one (2, 3), lower corner first, where the base must not stand [m].
        parts: Points of parts (p, 3), or a `maps.surface`, that it must keep away from [m].
        clearance: How far the origin of the base stays from boxes and points [m].
        rail: Two ends (2, 3) of a level rail that the base stands on [m], for the move "rail": it moves
            along the line alone. The result's `grid` then has x along the rail, from its first end.

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
    others = checked_alternatives(free_rolls, alternatives)
    size = float(reach(arm.baked()))
    world_goals, world_arm = flat, arm
    moves, ends_of_bounds, regions = _bounds_and_regions(move, bounds)
    to_world = np.eye(4)
    if rail is not None or "rail" in moves:
        to_world, moves, ends_of_bounds = _along_rail(rail, moves, ends_of_bounds)
        back = np.linalg.inv(to_world)
        flat = (back @ flat).astype(given.dtype)
        start = back @ np.asarray(arm.base, float)
        start[:3, 3] = 0  # on the rail, at its first end
        arm = dataclasses.replace(arm, base=start.astype(given.dtype))
    space = search_space(
        arm, flat[:, :3, 3].astype(float), size, moves, ends_of_bounds, spacing, turns, limits
    )
    points = space.grid.points().reshape(-1, 3)
    where = allowed(_corners(regions, points), keep_out, parts, clearance, to_world)
    good = where.at(points)
    if not good.any():
        raise ValueError(
            f"none of {len(points):,} candidates may stand where it is: widen the bounds, lessen the "
            "clearance or narrow the spacing"
        )
    tried, spare = np.zeros((2, len(points), len(space.turns)))
    spare[~good] = -np.inf
    if reach_map is None:
        count, spare[good] = candidates.count_reached(
            arm, flat, points[good], space.turns, limits, samples, others
        )
        tried[good] = count / len(flat)
    else:
        map_arm = _seen_from_rail(reach_map, to_world)
        tried = candidates.look_up_shares(map_arm, arm, flat, points, space.turns, limits, others)
        tried[~good] = 0
        spare = candidates.smoothed(tried.reshape(*space.grid.shape, -1)).reshape(tried.shape)
    order = np.lexsort((-spare.reshape(-1), -tried.reshape(-1)))
    order = order[np.repeat(good, len(space.turns))[order]]
    first = space.candidates()[order]
    first = first[space.distinct(first, starts)]
    data = _placement_data(flat, others, where)
    polished, count, worst = _polished(arm, data, space, first, size, limits, steps, samples, starts)
    # Polishing looks at some points of the parts alone; what comes nearer to another goes back to its start.
    strayed = ~where.at(polished[:, :3])
    polished[strayed] = first[strayed]
    flat, arm = world_goals, world_arm
    ranked = np.lexsort((-worst, -count))
    ranked = ranked[space.distinct(polished[ranked], keep)]
    # The returned matrices themselves are evaluated: they are rounded, and polishing moved the goals instead
    # of the base.
    ends, begins = (
        [
            _evaluate_base(arm, (to_world @ b).astype(given.dtype), data, flat, limits, samples)
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
        alternatives=others,
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


def _bounds_and_regions(move: Sequence[str], bounds) -> tuple[list[str], dict, list]:
    """The moves, the bounds around all regions, and the regions; none where there is one set of bounds."""
    moves = [move] if isinstance(move, str) else list(move)
    if bounds is None or isinstance(bounds, Mapping):
        return moves, dict(bounds or {}), []
    regions = [dict(each) for each in bounds]
    if not regions:
        raise ValueError("bounds must be a mapping, or several of them, got none")
    around: dict[str, tuple[float, float]] = {}
    for each in regions:
        for name, pair in each.items():
            if name not in "xyz":
                raise ValueError(f"bounds of several regions are of x, y and z, got {name}")
            ends = np.asarray(pair, float)
            if ends.shape != (2,) or not np.isfinite(ends).all() or ends[0] > ends[1]:
                raise ValueError(f"bounds of {name} must be finite (lower, upper), got {pair}")
            low, high = around.get(name, (np.inf, -np.inf))
            around[name] = (min(low, float(ends[0])), max(high, float(ends[1])))
    return moves, around, regions


def _corners(regions: list[Mapping], points: np.ndarray) -> list[np.ndarray]:
    """Corners (2, 3) of each region; where it names no bounds, those of all candidates."""
    around = np.stack([points.min(0), points.max(0)])
    return [
        np.stack([each.get(name, around[:, k]) for k, name in enumerate("xyz")], axis=1) for each in regions
    ]


def _along_rail(rail, moves: list[str], bounds: dict) -> tuple[np.ndarray, list[str], dict]:
    """A frame with x along a rail, and the moves and bounds seen from there."""
    if rail is None or "rail" not in moves:
        raise ValueError('rail= and the move "rail" go together')
    ends = np.asarray(rail, float)
    if ends.shape != (2, 3) or not np.isfinite(ends).all():
        raise ValueError(f"rail must be two ends (2, 3), got shape {ends.shape}")
    if taken := [name for name in (*moves, *bounds) if name in ("x", "y", "z")]:
        raise ValueError(f"a rail stands for x, y and z, got {taken[0]} beside it")
    along = ends[1] - ends[0]
    length = float(np.linalg.norm(along))
    if not length > 0 or abs(along[2]) > 1e-6 * length:
        raise ValueError("rail must be level and of some length; an upright one is the move z")
    to_world = np.eye(4)
    angle = np.arctan2(along[1], along[0])
    to_world[:3, :3] = Rotation.from_rotvec([0, 0, angle]).as_matrix()
    to_world[:3, 3] = ends[0]
    others = {name: pair for name, pair in bounds.items() if name != "rail"}
    reach_of_rail = bounds.get("rail", (0.0, length))
    return to_world, ["x" if name == "rail" else name for name in moves], {**others, "x": reach_of_rail}


def _seen_from_rail(reach_map: ReachMap, to_world: np.ndarray) -> ReachMap:
    """A map is of its own arm where that stood, whatever frame the search has."""
    if not np.array_equal(to_world, np.eye(4)):
        raise ValueError("reach_map and a rail do not go together: leave reach_map out")
    return reach_map


def _placement_data(goals: np.ndarray, others: np.ndarray | None, where: Allowed) -> PlacementData:
    """Goals, padded, and where the base may stand."""
    padded = _padded(goals)
    return PlacementData(
        jnp.asarray(padded),
        jnp.asarray(np.arange(len(padded)) < len(goals)),
        None if others is None else jnp.asarray(others.astype(goals.dtype)),
        where.for_program(goals.dtype),
    )


def _padded(goals: np.ndarray) -> np.ndarray:
    """Goals and copies of the first of them, a power of two in all, so that few programs are compiled."""
    width = max(LEAST_GOALS, 2 ** int(np.ceil(np.log2(len(goals)))))
    return np.concatenate([goals, np.repeat(goals[:1], width - len(goals), axis=0)])


LEAST_GOALS = 16
"""Fewer goals are padded to so many."""


def _evaluate_base(
    arm: Arm, base: np.ndarray, data: PlacementData, goals: np.ndarray, limits: bool, samples: int
) -> _Evaluation:
    """What is reached from a base pose; the goals are moved instead, so that all bases share a program."""
    back = np.asarray(arm.base, float) @ np.linalg.inv(np.asarray(base, float))
    seen = _padded((back @ np.asarray(goals, float)).astype(goals.dtype))
    ways = 1 if data.alternatives is None else len(data.alternatives)
    # A power of two, as the number of goals is.
    at_a_time = 2 ** max(0, int(np.log2(BATCH_SIZE / ways))) if ways < BATCH_SIZE else 1
    batch_size = starts_at_a_time(arm, min(at_a_time, len(seen)))
    plan = PlacementPlan(ConstantArm(arm), (), limits, batch_size, samples)
    found = evaluate_placement(plan, dataclasses.replace(data, goals=jnp.asarray(seen)))
    reached, margin = (np.asarray(x)[: len(goals)] for x in found)
    return _Evaluation(base, reached, float(margin.min()))


def _polished(
    arm: Arm,
    data: PlacementData,
    space: SearchSpace,
    first: np.ndarray,
    size: float,
    limits: bool,
    steps: int,
    samples: int,
    starts: int,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The best placements on the way from each of `first`, the goals they reach, their worst margins."""
    columns = [TWIST.index(name) for name in space.free_coordinates]
    home = np.concatenate([space.home[:3, 3], np.zeros(3)])
    lower, upper = space.bounds()
    goals = data.goals
    each = len(goals) * (1 if data.alternatives is None else len(data.alternatives))
    start_batch_size = starts_at_a_time(arm, BATCH_SIZE // each)
    # Fewer starts than asked for are repeated, because their number is the shape of a program.
    repeated = first[np.arange(starts) % len(first)]
    plan = PlacementPlan(ConstantArm(arm), space.free_coordinates, limits, start_batch_size, samples)
    phase = np.linspace(0, np.pi, steps + 1)
    numbers = [
        (repeated - home)[:, columns],
        data,
        space.spacings[columns],
        lower - home[columns],
        upper - home[columns],
        size * np.geomspace(*BLUR, steps + 1),
        RATE * (1 + np.cos(phase)) / 2,
    ]
    best = polish_placements(
        plan,
        *(x if x is data else jnp.asarray(x, goals.dtype) for x in numbers),  # type: ignore[arg-type]
    )
    count = len(first)
    polished = first.copy()
    polished[:, columns] = np.asarray(best.values, float)[:count] + home[columns]
    return polished, np.asarray(best.count)[:count], np.asarray(best.worst)[:count]
