"""What a set of positions and a set of orientations offer to a sweep, written once.

A member is a function of whole numbers. `at` is written once for numpy and for jax (`xp`), so that the kernel
makes in its jit what a map says on the host. A new set is a frozen dataclass of these methods: its fields
are what a map's spec says of it, its arrays are stored beside the statistics.
"""

from typing import Any, Protocol

import numpy as np

from ikjax.core.vector import Matrix, Vector

Tables = tuple[Any, ...]
"""Arrays that `at` looks up, of the kernel's type."""


class PositionSet(Protocol):
    """Positions in the world [m], each at a whole-numbered place along some axes."""

    axes: tuple[str, ...]
    """Names of the axes of the place."""

    @property
    def shape(self) -> tuple[int, ...]:
        """Number of places along each axis."""

    @property
    def count(self) -> int:
        """Number of positions."""

    def tables(self, dtype) -> Tables:
        """What `at` looks up."""

    def at(self, tables: Tables, index: tuple[Any, ...], xp, dtype) -> Vector:
        """The position at a place: one array of whole numbers for each axis."""

    def points(self) -> np.ndarray:
        """All positions [m], (*shape, 3)."""

    def named(self) -> dict[str, tuple[np.ndarray, tuple[str, ...]]]:
        """What a map says of its axes: arrays and the names of their dimensions."""


class OrientationSet(Protocol):
    """Rotations, numbered from zero."""

    @property
    def count(self) -> int:
        """Number of rotations."""

    def tables(self, dtype) -> Tables:
        """What `at` looks up."""

    def at(self, tables: Tables, index, xp, dtype) -> Matrix:
        """The rotation of each number, in scalars."""

    @property
    def rotations(self) -> np.ndarray:
        """All of them, (m, 3, 3)."""


class ByNumber:
    """All rotations of a set whose members are made by a formula; numpy takes the set for that array."""

    @property
    def rotations(self) -> np.ndarray:
        """All of them, (m, 3, 3)."""
        given: Any = self
        dtype = np.dtype(float)
        rows = given.at(given.tables(dtype), np.arange(given.count, dtype=np.int32), np, dtype)
        return np.stack([np.stack(np.broadcast_arrays(*row), axis=-1) for row in rows], axis=-2)

    def __array__(self, dtype=None, copy=None) -> np.ndarray:
        return np.array(self.rotations, dtype)


def frozen(array) -> np.ndarray:
    """A copy that nobody can write to, so that a map keeps the numbers that its spec has the hash of."""
    copy = np.array(array, float)
    copy.setflags(write=False)
    return copy
