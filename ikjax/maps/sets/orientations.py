"""Which way the tool points in a sweep: sets of rotations, each a function of an integer.

A formula is written once for numpy and for jax (`xp`), so that the kernel makes in its jit
what a map says on the host. Angles are whole multiples of 2^-32 turns, counted in 32-bit integers:
exact for any index, in float32 as in float64.
"""

import dataclasses
import math

import numpy as np

from ikjax.core import vector
from ikjax.core.vector import Matrix
from ikjax.maps.sets.hopf import Hopf
from ikjax.maps.sets.integer_angles import about_z, angle, tilt
from ikjax.maps.sets.protocol import ByNumber, Tables, frozen

MOST = 2**31 - 2**16
"""Orientations, each with its rolls, that 32-bit integers can count over."""

PSI = 1.533751168755204288118041
"""The real root of psi^4 = psi + 4."""


@dataclasses.dataclass(frozen=True)
class Even(ByNumber):
    """`count` rotations spread evenly over all rotations.

    Source: Alexa, Super-Fibonacci spirals: fast, low-discrepancy sampling of SO(3), CVPR 2022,
    algorithm 1, its two steps rounded to 2^-32 turns.
    """

    count: int

    def tables(self, dtype) -> Tables:
        return ()

    def at(self, tables: Tables, index, xp, dtype) -> Matrix:
        """The rotations of whole numbers."""
        n = dtype.type(self.count)
        near = xp.sqrt((index.astype(dtype) + dtype.type(0.5)) / n)
        far = xp.sqrt(((self.count - 1 - index).astype(dtype) + dtype.type(0.5)) / n)
        a, b = (angle(index, step, xp, dtype) for step in (1 / math.sqrt(2), 1 / PSI))
        x, y, z, w = near * xp.sin(a), near * xp.cos(a), far * xp.sin(b), far * xp.cos(b)
        return (
            (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
            (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
            (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
        )


@dataclasses.dataclass(frozen=True)
class Cone(ByNumber):
    """Tool axes spread evenly over a cap of the sphere, each with `turns` turns about itself.

    Index i stands for direction i // turns at turn i % turns. Without a roll a tool is turned from the
    middle of the cone by the shortest way.
    """

    direction: tuple[float, float, float]
    """Unit vector in the world: the middle of the cone."""
    half_angle: float
    """[rad]; pi is all directions."""
    directions: int
    turns: int = 1

    @property
    def count(self) -> int:
        """Number of rotations."""
        return self.directions * self.turns

    def tables(self, dtype) -> Tables:
        return ()

    def at(self, tables: Tables, index, xp, dtype) -> Matrix:
        """The rotations of whole numbers."""
        place, roll = index // self.turns, index % self.turns
        tilted = spiral(place, self.directions, math.sin(self.half_angle / 2) ** 2, xp, dtype)
        turned = vector.matmul(tilted, about_z(roll.astype(dtype) * dtype.type(math.tau / self.turns), xp))
        return vector.matmul(_middle(self.direction), turned)


def spiral(index, count: int, part: float, xp, dtype) -> Matrix:
    """Turns z to points of a Fibonacci spiral over a part of the sphere: 1 is all of it.

    A cap's area grows with the square of the sine of half its half angle, so that is what is even.
    """
    half, size = dtype.type(0.5), dtype.type(count)
    near, far = (index.astype(dtype) + half) / size, ((count - 1 - index).astype(dtype) + half) / size
    golden = angle(index, (math.sqrt(5) - 1) / 2, xp, dtype)
    return tilt(dtype.type(part) * near, dtype.type(1 - part) + dtype.type(part) * far, golden, xp)


def _middle(direction: tuple[float, float, float]) -> Matrix:
    """Turns z to the direction by the shortest way."""
    x, y, z = direction
    small = (x * x + y * y) / (2 * (1 + abs(z)))
    half, rest = (small, 1 - small) if z > 0 else (1 - small, small)
    rows = tilt(half, rest, math.atan2(y, x), np)
    return tuple(tuple(float(entry) for entry in row) for row in rows)


@dataclasses.dataclass(frozen=True, eq=False)
class Listed:
    """Rotations of a list."""

    rotations: np.ndarray
    """(m, 3, 3), read-only."""

    def __post_init__(self):
        object.__setattr__(self, "rotations", frozen(self.rotations))

    @property
    def count(self) -> int:
        """Number of rotations."""
        return len(self.rotations)

    def tables(self, dtype) -> Tables:
        return (self.rotations.reshape(-1, 9).astype(dtype),)

    def at(self, tables: Tables, index, xp, dtype) -> Matrix:
        """The rotations of whole numbers."""
        rows = tables[0][index]
        return tuple(tuple(rows[..., 3 * i + j] for j in range(3)) for i in range(3))


Orientations = Even | Cone | Hopf | Listed


def cone(direction, half_angle: float, directions: int, turns: int = 1) -> Cone:
    """Tool axes within an angle of a direction, spread evenly, each at some rolls about itself.

    Args:
        direction: (3,) of the tool's z axis in the world, of any length but zero. On a surface with
            normals it is seen from the surface, whose z axis points into it.
        half_angle: [rad], at most pi; 0 is the direction alone, pi is all directions.
        directions: Number of tool axes.
        turns: Turns about each, a whole turn divided by so many.

    Raises:
        ValueError: No direction, an angle or a number out of range.
    """
    vectors = np.asarray(direction, float)
    size = np.linalg.norm(vectors)
    if vectors.shape != (3,) or not 0 < size < np.inf:
        raise ValueError(f"direction must be a vector (3,) that is not zero, got {direction}")
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

    Returns:
        The set that `sweep(arm, positions, n)` sweeps; `.rotations`, or numpy's `asarray`, makes (n, 3, 3)
        of it.

    Raises:
        ValueError: n below 1.
    """
    _check_count("n", n)
    return Even(int(n))


def as_orientations(given) -> Orientations:
    """A set, from a set, a number for so many even ones, or rotations (m, 3, 3).

    Raises:
        ValueError: None of these, or more than 32 bits can count.
    """
    # Not of a class derived from these: a spec says which formula it was by the name of the class.
    if type(given) in (Even, Cone, Hopf, Listed):
        found: Orientations = given
    elif np.ndim(given) == 0:
        _check_count("n", given)
        found = Even(int(given))
    else:
        found = Listed(_checked(np.asarray(given, float)))
    if found.count > MOST:
        raise ValueError(f"orientations must be at most {MOST:,}, got {found.count:,}")
    return found


def _checked(rotations: np.ndarray) -> np.ndarray:
    if rotations.ndim != 3 or rotations.shape[1:] != (3, 3) or len(rotations) == 0:
        raise ValueError(f"orientations must be a number or rotations (m, 3, 3), got {rotations.shape}")
    gap = np.linalg.norm(np.swapaxes(rotations, 1, 2) @ rotations - np.eye(3), axis=(1, 2))
    bad = ~(gap <= 1e-5) | (np.linalg.det(rotations) < 0)
    if bad.any():
        i = int(np.argmax(bad))
        raise ValueError(f"orientations[{i}] must be a rotation, its R^T R - I has norm {gap[i]:.1g}")
    return rotations


def from_spec(said: dict, rotations: np.ndarray | None) -> Orientations:
    """The set that a spec describes; a list needs its rotations."""
    if said["kind"] == "Even":
        return Even(said["count"])
    if said["kind"] == "Hopf":
        return Hopf(said["level"])
    if said["kind"] == "Cone":
        x, y, z = said["direction"]
        return Cone((x, y, z), said["half_angle"], said["directions"], said["turns"])
    assert rotations is not None
    return Listed(rotations)
