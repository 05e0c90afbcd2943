"""Where a base may stand: what moves, between which bounds, and the candidates on a grid.

A place is six numbers: x, y, z of the base in the world [m]; and from how the arm was given a
turn rz about the world's z axis [rad], after which the rotation vector (rx, ry, 0) [rad] tilts it. So a whole
turn more is the same place, whatever the tilt.
"""

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np
from scipy.spatial.transform import Rotation

from ikjax.arm.arm import Arm
from ikjax.maps.sets.positions import Grid, grid
from ikjax.synthesis.parameters import TWIST

MOVES = {"x": ("x",), "y": ("y",), "z": ("z",), "turn": ("rz",), "tilt": ("rx", "ry")}
"""What a base may do, and the numbers that it changes."""

USUAL, MOST = 2**16, 2**24
"""Candidates by default, and at most."""

FINE = 16
"""Candidates along one reach by default."""

NEIGHBOR = 1.01
"""Distances between candidates that are neighbors, rounding included."""


@dataclasses.dataclass(frozen=True)
class Room:
    """Places, and which of them are tried."""

    home: np.ndarray
    """(4, 4) where the arm was given."""
    sides: Mapping[str, tuple[float, float]]
    """Bounds of what moves, by name."""
    grid: Grid
    turns: np.ndarray
    """(t,) [rad]"""
    climbs: tuple[str, ...]
    """Which of the six numbers polishing moves."""

    @property
    def steps(self) -> np.ndarray:
        """(6,) from a candidate to its neighbor."""
        turn = self.turns[1] - self.turns[0] if len(self.turns) > 1 else 0.3
        return np.array([self.grid.spacing] * 3 + [0.3, 0.3, turn])

    def places(self) -> np.ndarray:
        """All candidates, (c * t, 6), turns fastest."""
        points = self.grid.points().reshape(-1, 3)
        made = np.zeros((len(points), len(self.turns), 6))
        made[..., :3], made[..., 5] = points[:, None], self.turns
        return made.reshape(-1, 6)

    def bases(self, places: np.ndarray) -> np.ndarray:
        """T_world_base of places (m, 6)."""
        made = np.broadcast_to(np.eye(4), (len(places), 4, 4)).copy()
        tilt, turn = places[:, 3:] * [1, 1, 0], places[:, 3:] * [0, 0, 1]
        turned = Rotation.from_rotvec(tilt) * Rotation.from_rotvec(turn)
        made[:, :3, :3] = turned.as_matrix() @ self.home[:3, :3]
        made[:, :3, 3] = places[:, :3]
        return made

    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Of the numbers that polishing moves; a turn that may go round has none."""
        pairs: dict[str, tuple[float, float]] = {}
        for name, pair in self.sides.items():
            whole = name == "turn" and pair[1] - pair[0] >= 2 * np.pi * (1 - 1e-9)
            pairs |= dict.fromkeys(MOVES[name], (-np.inf, np.inf) if whole else pair)
        ends = np.array([pairs[name] for name in self.climbs])
        return ends[:, 0], ends[:, 1]

    def distinct(self, places: np.ndarray, most: int) -> np.ndarray:
        """Indices of the first places that are no neighbors of one before them."""
        free = np.ones(len(places), bool)
        chosen: list[int] = []
        columns = [0, 1, 2, 5]
        while len(chosen) < most and free.any():
            chosen.append(int(np.argmax(free)))
            gap = np.abs(places - places[chosen[-1]])
            gap[:, 5] = np.minimum(gap[:, 5] % (2 * np.pi), -gap[:, 5] % (2 * np.pi))
            free &= (gap[:, columns] > NEIGHBOR * self.steps[columns]).any(1)
        return np.array(chosen)


def room(
    arm: Arm,
    points: np.ndarray,
    size: float,
    move: Sequence[str],
    bounds: Mapping[str, tuple[float, float]],
    spacing: float | None,
    turns: int,
    limits: bool,
) -> Room:
    """Where the base of an arm of a size [m] may stand to reach points (g, 3).

    Raises:
        ValueError: An unknown move, bounds that are none, too many candidates.
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
    sides = {name: (float(low[k]), float(high[k])) for k, name in enumerate("xyz")}
    sides |= {"turn": (-np.pi, np.pi), "tilt": (-np.pi / 2, np.pi / 2)}
    sides |= {name: _pair(name, given) for name, given in bounds.items()}
    sides = {name: sides[name] for name in MOVES if name in names}
    home = np.asarray(arm.base, float)
    where = _grid(
        [sides.get(name, (p, p)) for name, p in zip("xyz", home[:3, 3], strict=True)], size, spacing
    )
    wide = _first_axis(arm, limits)
    angles = np.zeros(1)
    if "turn" in sides and wide < 2 * np.pi:
        lower, upper = sides["turn"]
        angles = np.linspace(lower, upper, turns, endpoint=upper - lower < 2 * np.pi * (1 - 1e-9))
    elif "turn" in sides:
        angles = np.clip(angles, *sides["turn"])
    if where.count * len(angles) > MOST:
        raise ValueError(
            f"candidates must be at most {MOST:,}, got {where.count:,} x {len(angles)} turns: "
            "narrow the bounds or widen the spacing"
        )
    # With two turns of its limits, the first joint is never nearer to them than half a turn.
    idle = {"rz"} if wide >= 4 * np.pi and len(sides) > 1 else set()
    climbs = tuple(x for x in TWIST if x in {y for name in sides for y in MOVES[name]} - idle)
    return Room(home, sides, where, angles, climbs)


def _pair(name: str, given) -> tuple[float, float]:
    pair = np.asarray(given, float)
    if pair.shape != (2,) or not np.isfinite(pair).all() or pair[0] > pair[1]:
        raise ValueError(f"bounds of {name} must be finite (lower, upper), got {given}")
    return float(pair[0]), float(pair[1])


def _grid(sides, size: float, spacing: float | None) -> Grid:
    lower, upper = np.array(sides, float).T
    if spacing is None:
        spacing = size / FINE
        while np.prod(np.floor((upper - lower) / spacing) + 1) > USUAL:
            spacing *= 1.25
    return grid(lower, upper, spacing)


def _first_axis(arm: Arm, limits: bool) -> float:
    """How far [rad] the first joint turns all of the arm about the world's z, as turning the base does."""
    upright = abs(abs(float(arm.base[2, 2])) - 1) < 1e-6
    if arm.kinds[0] != "R" or not upright or arm.coupling is not None or arm.correction is not None:
        return 0.0
    lower, upper = (float(x) for x in arm.limits[0])
    return upper - lower if limits else np.inf
