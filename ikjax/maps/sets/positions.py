"""Positions of a sweep: box grids and spherical shells.

The methods of a set are described in `maps.sets.protocol`.
"""

import dataclasses
import math
from types import ModuleType

import numpy as np
from numpy.typing import ArrayLike

from ikjax.arm.arm import Arm
from ikjax.arm.forward import reach
from ikjax.core.vector import Vector
from ikjax.maps.sets.orientations import spiral
from ikjax.maps.sets.protocol import Index, NamedArrays, Tables


@dataclasses.dataclass(frozen=True)
class Grid:
    """Positions on a box grid, x slowest and z fastest."""

    origin: tuple[float, ...]
    """The first position [m], world frame."""
    spacing: float
    """Between neighbors [m]."""
    shape: tuple[int, ...]
    """Positions along x, y and z."""

    @property
    def count(self) -> int:
        """Number of positions."""
        return math.prod(self.shape)

    def axis(self, k: int) -> np.ndarray:
        """The coordinates along x (0), y (1) or z (2) [m], (shape[k],)."""
        return self.origin[k] + self.spacing * np.arange(self.shape[k])

    def points(self) -> np.ndarray:
        """All positions [m], (*shape, 3)."""
        return self.part((slice(None),) * 3)

    def part(self, box: tuple[slice, ...]) -> np.ndarray:
        """The positions of a box of the grid [m], (..., 3): the same numbers as in `points()[box]`.

        Args:
            box: A slice along each axis.
        """
        axes = [self.axis(k)[side] for k, side in enumerate(box)]
        return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)

    axes = ("x", "y", "z")

    def named(self) -> NamedArrays:
        """The coordinates along the axes, as a map stores them."""
        return {name: (self.axis(k), (name,)) for k, name in enumerate(self.axes)}

    def tables(self, dtype: np.dtype) -> Tables:
        """Arrays that `at` looks up, of the kernel's type."""
        return tuple(self.axis(k).astype(dtype) for k in range(3))

    def at(self, tables: Tables, index: tuple[Index, ...], xp: ModuleType, dtype: np.dtype) -> Vector:
        """The positions [m] of whole numbers along each axis."""
        return tuple(table[i] for table, i in zip(tables, index, strict=True))

    def volume(self, chosen: np.ndarray) -> float:
        """The volume of chosen positions [m^3]: each stands for one cell.

        Args:
            chosen: bool, of the grid's shape.
        """
        return float(chosen.sum() * self.spacing**3)

    @property
    def dimension(self) -> int:
        """Axes with more than one position: 3 of a box, 2 of a layer, 1 of a line, 0 of one position."""
        return sum(side > 1 for side in self.shape)

    def size(self, chosen: np.ndarray) -> float:
        """How much chosen positions are, in the unit of the dimension [m^3, m^2, m, or a number].

        Args:
            chosen: bool, of the grid's shape.
        """
        return float(chosen.sum() * self.spacing**self.dimension)

    def in_words(self) -> str:
        """The set in a few words for people."""
        return f"{self.count:,} positions ({self.spacing * 1000:g} mm apart)"


def grid(lower: ArrayLike, upper: ArrayLike, spacing: float) -> Grid:
    """A grid that fills the box from `lower` to `upper` and is centered in it.

    Where an edge of the box is no multiple of the spacing, a margin of less than half a spacing is left at
    both ends. An edge of length zero has one position.

    Args:
        lower, upper: Corners (3,) [m].
        spacing: Between neighbors [m], positive.

    Raises:
        ValueError: A wrong shape, corners out of order or not finite, a spacing that is not positive.
    """
    lower, upper = np.asarray(lower, float), np.asarray(upper, float)
    if lower.shape != (3,) or upper.shape != (3,):
        raise ValueError(f"lower and upper must have shape (3,), got {lower.shape} and {upper.shape}")
    if not (np.isfinite(lower).all() and np.isfinite(upper).all() and (lower <= upper).all()):
        raise ValueError(f"lower must not exceed upper, got {lower} and {upper}")
    _check_spacing(spacing)
    # An edge that is a multiple of the spacing up to rounding keeps its last position.
    shape = np.floor((upper - lower) / spacing + 1e-9).astype(int) + 1
    origin = (lower + upper - (shape - 1) * spacing) / 2
    return Grid(tuple(map(float, origin)), float(spacing), tuple(map(int, shape)))


def _check_spacing(spacing: float) -> None:
    if not 0 < spacing < np.inf:
        raise ValueError(f"spacing must be a positive number of meters, got {spacing}")


def around(arm: Arm, spacing: float) -> Grid:
    """A cubic grid around the arm's first axis that contains every reachable position.

    Args:
        arm: The arm.
        spacing: Between neighbors [m], positive.

    Raises:
        ValueError: A spacing that is not positive.
    """
    _check_spacing(spacing)
    baked = arm.baked()
    center = np.asarray(baked.base, float)[:3, 3] + float(baked.d[0]) * np.asarray(baked.base, float)[:3, 2]
    radius = float(reach(baked)) - abs(float(baked.d[0]))
    radius = spacing * np.ceil(radius / spacing)
    return grid(center - radius, center + radius, spacing)


@dataclasses.dataclass(frozen=True)
class Shell:
    """Positions on concentric spheres, the same directions on each; the last axis is the direction."""

    center: tuple[float, float, float]
    """World frame [m]."""
    radii: tuple[float, ...]
    """[m], positive and ascending."""
    directions: int
    """Number on each sphere, spread evenly on a spherical Fibonacci spiral."""

    axes = ("radius", "direction")

    @property
    def shape(self) -> tuple[int, ...]:
        """Number of spheres and of directions."""
        return (len(self.radii), self.directions)

    @property
    def count(self) -> int:
        """Number of positions."""
        return math.prod(self.shape)

    def points(self) -> np.ndarray:
        """All positions [m], (*shape, 3)."""
        dtype = np.dtype(float)
        index = tuple(np.indices(self.shape, np.int32))
        return np.stack(self.at(self.tables(dtype), index, np, dtype), axis=-1)

    def named(self) -> NamedArrays:
        """The coordinates along the axes, as a map stores them."""
        unit = dataclasses.replace(self, center=(0.0, 0.0, 0.0), radii=(1.0,)).points()[0]
        return {"radius": (np.array(self.radii), ("radius",)), "direction": (unit, ("direction", "xyz"))}

    def tables(self, dtype: np.dtype) -> Tables:
        """Arrays that `at` looks up, of the kernel's type."""
        return (np.array(self.radii, dtype),)

    def at(self, tables: Tables, index: tuple[Index, ...], xp: ModuleType, dtype: np.dtype) -> Vector:
        """The positions [m] of whole numbers along each axis."""
        layer, place = index
        unit = (row[2] for row in spiral(place, self.directions, 1, xp, dtype))
        return tuple(dtype.type(c) + tables[0][layer] * u for c, u in zip(self.center, unit, strict=True))

    def volume(self, chosen: np.ndarray) -> float:
        """The volume of chosen positions [m^3].

        Layers meet half way between two spheres; the innermost and the outermost end at their spheres.

        Args:
            chosen: bool, of the shell's shape.
        """
        radii = np.array(self.radii)
        middle = (radii[1:] + radii[:-1]) / 2
        between = np.concatenate([radii[:1], middle, radii[-1:]])
        layers = 4 / 3 * math.pi * np.diff(between**3) / self.directions
        return float((chosen.sum(1) * layers).sum())

    def in_words(self) -> str:
        """The set in a few words for people."""
        return f"{self.count:,} positions ({len(self.radii)} spheres of {self.directions:,})"


def shell(center: ArrayLike, radii: ArrayLike, directions: int) -> Shell:
    """Positions on spheres about a center.

    Args:
        center: (3,) [m], world frame.
        radii: One radius or several (k,) [m], positive and ascending.
        directions: Number on each sphere, at least 1.

    Raises:
        ValueError: A wrong shape, radii that do not ascend, no directions.
    """
    middle, layers = np.asarray(center, float), np.atleast_1d(np.asarray(radii, float))
    if middle.shape != (3,) or not np.isfinite(middle).all():
        raise ValueError(f"center must be a point (3,), got {middle.tolist()}")
    if layers.ndim != 1 or len(layers) == 0 or not (np.isfinite(layers).all() and layers[0] > 0):
        raise ValueError(f"radii must be positive numbers of meters, got {layers.tolist()}")
    if (np.diff(layers) <= 0).any():
        raise ValueError(f"radii must ascend, got {layers.tolist()}")
    if isinstance(directions, bool) or not isinstance(directions, int | np.integer) or directions < 1:
        raise ValueError(f"directions must be at least 1, got {directions}")
    x, y, z = (float(c) for c in middle)
    return Shell((x, y, z), tuple(map(float, layers)), int(directions))
