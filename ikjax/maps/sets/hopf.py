"""A grid of rotations with equal cells, and a look-up of the nearest one.

Directions of the tool are the pixels of HEALPix in ring order, and each has the same turns about itself.
Index i stands for pixel i // turns at turn i % turns. The methods of a set are described in
`maps.sets.protocol`.
Source: Yershova, Jain, LaValle and Mitchell, Generating uniform incremental grids on SO(3) using the Hopf
fibration, IJRR 2010; Gorski et al., HEALPix, ApJ 622 (2005), equations (4)-(9).
"""

import dataclasses
import math
from collections.abc import Iterator
from types import ModuleType

import numpy as np
from numpy.typing import ArrayLike

from ikjax.core import vector
from ikjax.core.trig import Scalar
from ikjax.core.vector import Matrix
from ikjax.maps.sets.integer_angles import about_z, tilt
from ikjax.maps.sets.protocol import FormulaRotations, Index, Tables

DEEPEST = 8
"""The last level whose rotations 32-bit integers can count."""


@dataclasses.dataclass(frozen=True)
class Hopf(FormulaRotations):
    """72 * 8^level rotations; neighbors are about 60 degrees / 2^level apart."""

    level: int
    """0 to 8."""

    @property
    def side(self) -> int:
        """Pixels along a side of HEALPix's twelve diamonds."""
        return 2**self.level

    @property
    def turns(self) -> int:
        """Turns about each direction."""
        return 6 * self.side

    @property
    def count(self) -> int:
        """Number of rotations."""
        return 12 * self.side**2 * self.turns

    def tables(self, dtype: np.dtype) -> Tables:
        return ()

    def at(self, tables: Tables, index: Index, xp: ModuleType, dtype: np.dtype) -> Matrix:
        """The rotations of whole numbers."""
        pixel, turn = index // self.turns, index % self.turns
        half, rest, azimuth = self._pixel(pixel, xp, dtype)
        roll = turn.astype(dtype) * dtype.type(math.tau / self.turns)
        return vector.matmul(tilt(half, rest, azimuth, xp), about_z(roll, xp))

    def _pixel(self, pixel: Index, xp: ModuleType, dtype: np.dtype) -> tuple[Scalar, Scalar, Scalar]:
        """Directions of pixels: squared sine and cosine of half the polar angle, and the azimuth [rad]."""
        n, last = self.side, 12 * self.side**2 - 1
        cap = 2 * n * (n - 1)
        # The southern cap is the northern one mirrored.
        south = pixel > last - cap
        mirrored = xp.where(south, last - pixel, pixel)
        ring = (1 + _root(1 + 2 * mirrored, xp)) // 2
        place = mirrored - 2 * ring * (ring - 1)
        place = xp.where(south, 4 * ring - 1 - place, place)
        belt = (mirrored >= cap) & ~south
        band = (pixel - cap) // (4 * n) + n
        ring = xp.where(belt, n, ring)
        place = xp.where(belt, (pixel - cap) % (4 * n), place)
        # Every second ring of the belt is turned by half a pixel.
        offset = xp.where(belt & ((band - n) % 2 == 1), dtype.type(0), dtype.type(0.5))
        azimuth = (place.astype(dtype) + offset) * dtype.type(math.tau / 4) / ring.astype(dtype)
        in_cap = ring.astype(dtype) ** 2 / dtype.type(6 * n**2)
        in_belt = (band.astype(dtype) - dtype.type(0.5 * n)) / dtype.type(3 * n)
        half = xp.where(belt, in_belt, in_cap)
        return xp.where(south, 1 - half, half), xp.where(south, half, 1 - half), azimuth

    def nearest(self, rotations: ArrayLike) -> np.ndarray:
        """Indices of the rotations of the grid with the least angle to given rotations.

        Args:
            rotations: (..., 3, 3)

        Returns:
            (...) int64.

        Raises:
            ValueError: A wrong shape.
        """
        given = np.asarray(rotations, float)
        if given.ndim < 2 or given.shape[-2:] != (3, 3):
            raise ValueError(f"rotations must have shape (..., 3, 3), got {given.shape}")
        best, index = np.full(given.shape[:-2], -np.inf), np.zeros(given.shape[:-2], np.int64)
        for pixel in self._pixels_near(given[..., :, 2]):
            half, rest, azimuth = self._pixel(pixel, np, np.dtype(float))
            rows = tilt(half, rest, azimuth, np)
            tilted = np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)
            left = np.swapaxes(tilted, -1, -2) @ given
            along, across = left[..., 0, 0] + left[..., 1, 1], left[..., 1, 0] - left[..., 0, 1]
            turn = np.rint(np.arctan2(across, along) * self.turns / math.tau).astype(np.int64) % self.turns
            roll = turn * (math.tau / self.turns)
            trace = along * np.cos(roll) + across * np.sin(roll) + left[..., 2, 2]
            index = np.where(trace > best, pixel * self.turns + turn, index)
            best = np.maximum(best, trace)
        return index

    def _pixels_near(self, axis: np.ndarray) -> Iterator[np.ndarray]:
        """Pixels (...) around tool axes (..., 3), one array after the other.

        The pixel of the nearest rotation is among them: they reach two rings and two pixels to each side.
        """
        n, z = self.side, axis[..., 2]
        # Squared sines of half the angles to both poles. Near a pole 1 - z has lost its digits, so they are
        # computed from the other components.
        across = np.hypot(axis[..., 0], axis[..., 1])
        half = np.where(z > 0, across**2 / (2 * (1 + np.abs(z))), (1 - z) / 2)
        other = np.where(z < 0, across**2 / (2 * (1 + np.abs(z))), (1 + z) / 2)
        north, south = n * np.sqrt(6 * half), 4 * n - n * np.sqrt(6 * other)
        ring = np.where(half < 1 / 6, north, np.where(other < 1 / 6, south, n * (3 * half + 0.5)))
        azimuth = np.arctan2(axis[..., 1], axis[..., 0])
        for up in range(-2, 3):
            row = np.clip(np.rint(ring).astype(np.int64) + up, 1, 4 * n - 1)
            size = 4 * np.minimum(np.minimum(row, n), 4 * n - row)
            first = np.where(row <= n, 2 * row * (row - 1), 2 * n * (n - 1) + 4 * n * (row - n))
            mirrored = 4 * n - row
            first = np.where(row > 3 * n, 12 * n**2 - 2 * mirrored * (mirrored + 1), first)
            place = np.floor(azimuth * size / math.tau).astype(np.int64)
            for aside in range(-2, 3):
                yield first + (place + aside) % size


def hopf(level: int) -> Hopf:
    """72 * 8^level rotations with equal cells; `.nearest(rotations)` looks up their indices.

    Args:
        level: 0 to 8: 72, 576, 4,608, 36,864 and so on.

    Raises:
        ValueError: No whole number, or one out of range.
    """
    if isinstance(level, bool) or not isinstance(level, int | np.integer) or not 0 <= level <= DEEPEST:
        raise ValueError(f"level must be a whole number from 0 to {DEEPEST}, got {level}")
    return Hopf(int(level))


def _root(value: Index, xp: ModuleType) -> Index:
    """The integer square root, rounded down, of numbers below 2^31."""
    guess = xp.sqrt(value.astype(np.float32)).astype(value.dtype)
    # The square root in float32 is off by one at most.
    guess = xp.where(guess * guess > value, guess - 1, guess)
    return xp.where((guess + 1) * (guess + 1) <= value, guess + 1, guess)
