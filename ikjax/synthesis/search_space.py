"""The search space of `place`: what moves, between which bounds, and the candidates on a grid.

A placement has six coordinates: x, y, z of the base in the world [m], and a rotation from how the arm was
given: a turn rz about the world's z axis [rad], and then a tilt by the rotation vector (rx, ry, 0) [rad]. So
a whole turn more is the same placement, whatever the tilt.
"""

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np
from scipy.spatial.transform import Rotation

from ikjax.arm.arm import Arm
from ikjax.maps.sets.positions import Grid, grid
from ikjax.synthesis.parameters import TWIST

MOVES = {"x": ("x",), "y": ("y",), "z": ("z",), "turn": ("rz",), "tilt": ("rx", "ry")}
"""The moves of a base, and the coordinates that each changes."""

DEFAULT_POSITIONS, MOST_CANDIDATES = 2**16, 2**24
"""Positions by default, and candidates at most."""

POSITIONS_PER_REACH = 16
"""Candidates along one reach by default."""

NEIGHBOR_DISTANCE = 1.01
"""Between candidates that are neighbors, in spacings, with an allowance for rounding."""


@dataclasses.dataclass(frozen=True)
class SearchSpace:
    """Placements between bounds, and which of them are tried."""

    home: np.ndarray
    """(4, 4) T_world_base of the given arm."""
    intervals: Mapping[str, tuple[float, float]]
    """Bounds of each move, by name."""
    grid: Grid
    turns: np.ndarray
    """(t,) [rad]"""
    free_coordinates: tuple[str, ...]
    """Which of the six coordinates polishing moves."""

    @property
    def spacings(self) -> np.ndarray:
        """(6,) distance from a candidate to its neighbor in each coordinate."""
        turn = self.turns[1] - self.turns[0] if len(self.turns) > 1 else 0.3
        return np.array([self.grid.spacing] * 3 + [0.3, 0.3, turn])

    def candidates(self) -> np.ndarray:
        """All candidates, (c * t, 6), the turn varying fastest."""
        points = self.grid.points().reshape(-1, 3)
        placements = np.zeros((len(points), len(self.turns), 6))
        placements[..., :3], placements[..., 5] = points[:, None], self.turns
        return placements.reshape(-1, 6)

    def base_poses(self, placements: np.ndarray) -> np.ndarray:
        """T_world_base of placements (m, 6)."""
        poses = np.broadcast_to(np.eye(4), (len(placements), 4, 4)).copy()
        tilt, turn = placements[:, 3:] * [1, 1, 0], placements[:, 3:] * [0, 0, 1]
        turned = Rotation.from_rotvec(tilt) * Rotation.from_rotvec(turn)
        poses[:, :3, :3] = turned.as_matrix() @ self.home[:3, :3]
        poses[:, :3, 3] = placements[:, :3]
        return poses

    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Lower and upper bounds of the free coordinates; a turn over a whole turn has none."""
        pairs: dict[str, tuple[float, float]] = {}
        for name, pair in self.intervals.items():
            whole = name == "turn" and pair[1] - pair[0] >= 2 * np.pi * (1 - 1e-9)
            pairs |= dict.fromkeys(MOVES[name], (-np.inf, np.inf) if whole else pair)
        ends = np.array([pairs[name] for name in self.free_coordinates])
        return ends[:, 0], ends[:, 1]

    def distinct(self, placements: np.ndarray, most: int) -> np.ndarray:
        """Indices of up to `most` placements, in order, none a neighbor of one chosen before it."""
        free = np.ones(len(placements), bool)
        chosen: list[int] = []
        columns = [0, 1, 2, 5]
        while len(chosen) < most and free.any():
            chosen.append(int(np.argmax(free)))
            gap = np.abs(placements - placements[chosen[-1]])
            gap[:, 5] = np.minimum(gap[:, 5] % (2 * np.pi), -gap[:, 5] % (2 * np.pi))
            free &= (gap[:, columns] > NEIGHBOR_DISTANCE * self.spacings[columns]).any(1)
        return np.array(chosen)


def search_space(
    arm: Arm,
    points: np.ndarray,
    size: float,
    move: Sequence[str],
    bounds: Mapping[str, tuple[float, float]],
    spacing: float | None,
    turns: int,
    limits: bool,
) -> SearchSpace:
    """Where the base of an arm may stand.

    Args:
        arm: The arm, where it was given.
        points: (g, 3) positions of the goals [m].
        size: The arm's reach [m].
        move: Names of `MOVES`.
        bounds: Of some of these; the others get the default of `place`.
        spacing: Of the candidates [m]; None for the default of `place`.
        turns: Number of candidates for the turn.
        limits: Whether the joint limits count.

    Raises:
        ValueError: An unknown move, invalid bounds, too many candidates.
    """
    names = [move] if isinstance(move, str) else list(move)
    if not names or set(names) - set(MOVES) or len(set(names)) < len(names):
        raise ValueError(
            f"move must be some of {', '.join(MOVES)}, got {', '.join(map(str, names)) or 'none'}"
        )
    if set(bounds) - set(names):
        raise ValueError(
            f"bounds must be of what moves ({', '.join(names)}), got {', '.join(map(str, bounds))}"
        )
    low, high = points.min(0) - size, points.max(0) + size
    intervals = {name: (float(low[k]), float(high[k])) for k, name in enumerate("xyz")}
    intervals |= {"turn": (-np.pi, np.pi), "tilt": (-np.pi / 2, np.pi / 2)}
    intervals |= {name: _checked_pair(name, given) for name, given in bounds.items()}
    intervals = {name: intervals[name] for name in MOVES if name in names}
    home = np.asarray(arm.base, float)
    extents = [intervals.get(name, (p, p)) for name, p in zip("xyz", home[:3, 3], strict=True)]
    positions = _candidate_grid(extents, size, spacing)
    first_range = _first_joint_range(arm, limits)
    angles = np.zeros(1)
    if "turn" in intervals and first_range < 2 * np.pi:
        lower, upper = intervals["turn"]
        angles = np.linspace(lower, upper, turns, endpoint=upper - lower < 2 * np.pi * (1 - 1e-9))
    elif "turn" in intervals:
        angles = np.clip(angles, *intervals["turn"])
    if positions.count * len(angles) > MOST_CANDIDATES:
        raise ValueError(
            f"candidates must be at most {MOST_CANDIDATES:,}, got {positions.count:,} x {len(angles)} turns: "
            "narrow the bounds or widen the spacing"
        )
    # Where its limits are two turns apart, one of the first joint's equivalent angles is at least half a turn
    # away from both.
    useless = {"rz"} if first_range >= 4 * np.pi and len(intervals) > 1 else set()
    moved = {coordinate for name in intervals for coordinate in MOVES[name]} - useless
    free = tuple(coordinate for coordinate in TWIST if coordinate in moved)
    return SearchSpace(home, intervals, positions, angles, free)


def _checked_pair(name: str, given) -> tuple[float, float]:
    pair = np.asarray(given, float)
    if pair.shape != (2,) or not np.isfinite(pair).all() or pair[0] > pair[1]:
        raise ValueError(f"bounds of {name} must be finite (lower, upper), got {given}")
    return float(pair[0]), float(pair[1])


def _candidate_grid(extents, size: float, spacing: float | None) -> Grid:
    lower, upper = np.array(extents, float).T
    if spacing is None:
        spacing = size / POSITIONS_PER_REACH
        while np.prod(np.floor((upper - lower) / spacing) + 1) > DEFAULT_POSITIONS:
            spacing *= 1.25
    return grid(lower, upper, spacing)


def _first_joint_range(arm: Arm, limits: bool) -> float:
    """Range [rad] over which the first joint turns the whole arm about the world's z axis, as the base
    would."""
    upright = abs(abs(float(arm.base[2, 2])) - 1) < 1e-6
    if arm.kinds[0] != "R" or not upright or arm.coupling is not None or arm.correction is not None:
        return 0.0
    lower, upper = (float(x) for x in arm.limits[0])
    return upper - lower if limits else np.inf
