"""Orientations of a sweep: sets of rotations, each a function of an integer.

The methods of a set are described in `maps.sets.protocol`. Angles are whole multiples of 2^-32 turns, counted
in 32-bit integers: exact for any index, in float32 as in float64.
"""

import dataclasses
import math
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ikjax.core import vector
from ikjax.core.trig import Scalar
from ikjax.core.vector import Matrix
from ikjax.maps.sets.hopf import Hopf
from ikjax.maps.sets.integer_angles import about_z, angle, tilt
from ikjax.maps.sets.protocol import FormulaRotations, Index, Tables, read_only

MOST = 2**31 - 2**16
"""Most orientations, turns included: 32-bit integers count them, with room for the last tile."""

PSI = 1.533751168755204288118041
"""The positive root of psi^4 = psi + 4; its inverse is the second step of the spiral."""


@dataclasses.dataclass(frozen=True)
class Even(FormulaRotations):
    """`count` rotations spread evenly over all rotations.

    Source: Alexa, Super-Fibonacci spirals: fast, low-discrepancy sampling of SO(3), CVPR 2022,
    algorithm 1, its two steps rounded to 2^-32 turns.
    """

    count: int

    def tables(self, dtype: np.dtype) -> Tables:
        return ()

    def at(self, tables: Tables, index: Index, xp: ModuleType, dtype: np.dtype) -> Matrix:
        """The rotations of whole numbers."""
        n = dtype.type(self.count)
        inner = xp.sqrt((index.astype(dtype) + dtype.type(0.5)) / n)
        # The square root of 1 - inner^2, from integers: the difference would lose digits.
        outer = xp.sqrt(((self.count - 1 - index).astype(dtype) + dtype.type(0.5)) / n)
        a, b = (angle(index, step, xp, dtype) for step in (1 / math.sqrt(2), 1 / PSI))
        x, y, z, w = inner * xp.sin(a), inner * xp.cos(a), outer * xp.sin(b), outer * xp.cos(b)
        return (
            (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
            (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
            (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
        )


@dataclasses.dataclass(frozen=True)
class Cone(FormulaRotations):
    """Tool axes spread evenly over a cap of the sphere, each with `turns` turns about itself.

    Index i stands for direction i // turns at turn i % turns. At turn 0 the orientation is that of the middle
    of the cone, turned by the shortest way.
    """

    direction: tuple[float, float, float]
    """Unit vector in the world: the middle of the cone."""
    half_angle: float
    """[rad]; pi is all directions."""
    directions: int
    """Number of tool axes."""
    turns: int = 1
    """Turns about each tool axis."""

    @property
    def count(self) -> int:
        """Number of rotations."""
        return self.directions * self.turns

    def tables(self, dtype: np.dtype) -> Tables:
        return ()

    def at(self, tables: Tables, index: Index, xp: ModuleType, dtype: np.dtype) -> Matrix:
        """The rotations of whole numbers."""
        place, roll = index // self.turns, index % self.turns
        tilted = spiral(place, self.directions, math.sin(self.half_angle / 2) ** 2, xp, dtype)
        turned = vector.matmul(tilted, about_z(roll.astype(dtype) * dtype.type(math.tau / self.turns), xp))
        return vector.matmul(_middle(self.direction), turned)


def spiral(index: Index, count: int, part: float, xp: ModuleType, dtype: np.dtype) -> Matrix:
    """Rotations that turn z to the points of a spherical Fibonacci spiral over a cap about z.

    The area of a cap grows with the squared sine of half its half angle, so points are evenly spaced in it.

    Args:
        index: Whole numbers from 0 to `count` - 1.
        count: Number of points.
        part: Area of the cap, as a part of the sphere: 1 is all of it.
        xp: numpy or jax.numpy.
        dtype: Floating type of the result.
    """
    half, size = dtype.type(0.5), dtype.type(count)
    from_start = (index.astype(dtype) + half) / size
    from_end = ((count - 1 - index).astype(dtype) + half) / size
    golden = angle(index, (math.sqrt(5) - 1) / 2, xp, dtype)
    rest: Scalar = dtype.type(1 - part) + dtype.type(part) * from_end
    return tilt(dtype.type(part) * from_start, rest, golden, xp)


def _middle(direction: tuple[float, float, float]) -> Matrix:
    """The rotation that turns z to a direction by the shortest way, as numbers."""
    x, y, z = direction
    small = (x * x + y * y) / (2 * (1 + abs(z)))
    half, rest = (small, 1 - small) if z > 0 else (1 - small, small)
    rows = tilt(half, rest, math.atan2(y, x), np)
    return tuple(tuple(float(entry) for entry in row) for row in rows)


@dataclasses.dataclass(frozen=True, eq=False)
class Listed:
    """Rotations given one by one."""

    rotations: np.ndarray
    """(m, 3, 3), read-only."""

    def __post_init__(self):
        object.__setattr__(self, "rotations", read_only(self.rotations))

    @property
    def count(self) -> int:
        """Number of rotations."""
        return len(self.rotations)

    def tables(self, dtype: np.dtype) -> Tables:
        return (self.rotations.reshape(-1, 9).astype(dtype),)

    def at(self, tables: Tables, index: Index, xp: ModuleType, dtype: np.dtype) -> Matrix:
        """The rotations of whole numbers."""
        rows = tables[0][index]
        return tuple(tuple(rows[..., 3 * i + j] for j in range(3)) for i in range(3))


Orientations = Even | Cone | Hopf | Listed


def cone(direction: ArrayLike, half_angle: float, directions: int, turns: int = 1) -> Cone:
    """Tool axes within an angle of a direction, spread evenly, each with some turns about itself.

    Args:
        direction: (3,) the tool's z axis in the world, of any length but zero. On a surface with normals it
            is given in the frame of the surface, whose z axis points into it.
        half_angle: [rad], from 0, the direction alone, to pi, all directions.
        directions: Number of tool axes, at least 1.
        turns: Turns about each tool axis, a whole turn divided by so many; at least 1.

    Raises:
        ValueError: A direction of length zero, or an angle or a number out of range.
    """
    vectors = np.asarray(direction, float)
    size = np.linalg.norm(vectors)
    if vectors.shape != (3,) or not 0 < size < np.inf:
        raise ValueError(f"direction must be a vector (3,) that is not zero, got {vectors.tolist()}")
    if not 0 <= half_angle <= math.pi:
        raise ValueError(f"half_angle must be from 0 to pi, got {half_angle}")
    _check_count("directions", directions)
    _check_count("turns", turns)
    x, y, z = (float(c) for c in vectors / size)
    return Cone((x, y, z), float(half_angle), int(directions), int(turns))


def _check_count(name: str, number) -> None:
    if isinstance(number, bool) or not isinstance(number, int | np.integer) or number < 1:
        raise ValueError(f"{name} must be at least 1, got {number}")


def even_rotations(n: int) -> Even:
    """n rotations spread evenly over all rotations, the same ones every time.

    Args:
        n: At least 1.

    Returns:
        The set that `sweep(arm, positions, n)` sweeps. `.rotations`, or numpy's `asarray`, makes an array
        (n, 3, 3) of it.

    Raises:
        ValueError: n below 1.
    """
    _check_count("n", n)
    return Even(int(n))


def as_orientations(given: Any) -> Orientations:
    """The set that a set, a number or an array stands for.

    Args:
        given: A set; a number, for that many even rotations; or rotations (m, 3, 3), as an array or as
            anything that numpy makes one of.

    Raises:
        ValueError: None of these, matrices that are no rotations, or more than `MOST`.
    """
    # A derived class may have another formula, and a spec has nothing but the name of the class: rotations of
    # such a set are taken one by one instead.
    if type(given) in (Even, Cone, Hopf, Listed):
        chosen: Orientations = given
    elif np.ndim(given) == 0:
        _check_count("n", given)
        chosen = Even(int(given))
    else:
        chosen = Listed(_checked(np.asarray(given, float)))
    if chosen.count > MOST:
        raise ValueError(f"orientations must be at most {MOST:,}, got {chosen.count:,}")
    return chosen


def _checked(rotations: np.ndarray) -> np.ndarray:
    """The same (m, 3, 3), if all of them are rotations; else ValueError names the first that is none."""
    if rotations.ndim != 3 or rotations.shape[1:] != (3, 3) or len(rotations) == 0:
        raise ValueError(f"orientations must be a number or rotations (m, 3, 3), got {rotations.shape}")
    gap = np.linalg.norm(np.swapaxes(rotations, 1, 2) @ rotations - np.eye(3), axis=(1, 2))
    bad = ~(gap <= 1e-5) | (np.linalg.det(rotations) < 0)
    if bad.any():
        i = int(np.argmax(bad))
        raise ValueError(f"orientations[{i}] must be a rotation, its R^T R - I has norm {gap[i]:.1g}")
    return rotations


def from_spec(spec: dict[str, Any], rotations: np.ndarray | None) -> Orientations:
    """The set that a spec describes.

    Args:
        spec: From `manifest.set_spec`.
        rotations: (m, 3, 3), which `Listed` needs.
    """
    if spec["kind"] == "Even":
        return Even(spec["count"])
    if spec["kind"] == "Hopf":
        return Hopf(spec["level"])
    if spec["kind"] == "Cone":
        x, y, z = spec["direction"]
        return Cone((x, y, z), spec["half_angle"], spec["directions"], spec["turns"])
    assert rotations is not None
    return Listed(rotations)
