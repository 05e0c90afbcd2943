"""What a set of positions and a set of orientations offer to a sweep.

A member of a set is a function of whole numbers. `at` is written once for numpy and for jax (`xp`), so that
the kernel makes inside its jit what a map says on the host. A new set is a frozen dataclass with these
methods: its fields are what a map's spec says of it, its arrays are stored beside the statistics.
"""

from types import ModuleType
from typing import Any, Protocol

import numpy as np

from ikjax.core.vector import Matrix, Vector

Tables = tuple[Any, ...]
"""Arrays that `at` looks up, of the kernel's type."""

NamedArrays = dict[str, tuple[np.ndarray, tuple[str, ...]]]
"""Arrays by name, each with the names of its dimensions."""

Index = Any
"""An int32 array of numpy or jax, of any shape."""


class PositionSet(Protocol):
    """Positions in the world [m], each at a place: one whole number along each axis."""

    @property
    def axes(self) -> tuple[str, ...]:
        """Names of the axes."""

    @property
    def shape(self) -> tuple[int, ...]:
        """Number of places along each axis: the shape of every statistic."""

    @property
    def count(self) -> int:
        """Number of positions."""

    def tables(self, dtype: np.dtype) -> Tables:
        """Arrays that `at` looks up, of the kernel's type."""

    def at(self, tables: Tables, index: tuple[Index, ...], xp: ModuleType, dtype: np.dtype) -> Vector:
        """The positions of places.

        Args:
            tables: From `tables`, or traced arrays of the same shapes.
            index: One array of whole numbers for each axis; they broadcast.
            xp: numpy or jax.numpy.
            dtype: Floating type of the result.

        Returns:
            (x, y, z) [m], each of the shape of the indices.
        """

    def points(self) -> np.ndarray:
        """All positions [m], (*shape, 3)."""

    def named(self) -> NamedArrays:
        """The coordinates along the axes, as a map stores them."""

    def in_words(self) -> str:
        """The set in a few words for people."""


class OrientationSet(Protocol):
    """Rotations, numbered from zero."""

    @property
    def count(self) -> int:
        """Number of rotations."""

    def tables(self, dtype: np.dtype) -> Tables:
        """Arrays that `at` looks up, of the kernel's type."""

    def at(self, tables: Tables, index: Index, xp: ModuleType, dtype: np.dtype) -> Matrix:
        """The rotations of whole numbers.

        Args:
            tables: From `tables`, or traced arrays of the same shapes.
            index: Whole numbers from 0 to `count` - 1.
            xp: numpy or jax.numpy.
            dtype: Floating type of the result.

        Returns:
            Three rows of three scalars, each of the shape of the index, or a number.
        """

    @property
    def rotations(self) -> np.ndarray:
        """All of them, (m, 3, 3)."""


class FormulaRotations:
    """Rotations of a set whose members are made by a formula; numpy takes the set for an array of them."""

    @property
    def rotations(self) -> np.ndarray:
        """All of them, (m, 3, 3)."""
        members: Any = self
        dtype = np.dtype(float)
        rows = members.at(members.tables(dtype), np.arange(members.count, dtype=np.int32), np, dtype)
        return np.stack([np.stack(np.broadcast_arrays(*row), axis=-1) for row in rows], axis=-2)

    def __array__(self, dtype=None, copy=None) -> np.ndarray:
        return np.array(self.rotations, dtype)


def read_only(array) -> np.ndarray:
    """A float64 copy that nobody can write to, so that a map keeps the numbers whose hash its spec has."""
    copy = np.array(array, float)
    copy.setflags(write=False)
    return copy
