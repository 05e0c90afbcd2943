"""Where a sweep looks: grids of positions and even sets of orientations.

Storey: study. A goal is a function of two integers, its position's and its orientation's.
"""

import dataclasses
import math

import numpy as np

from ikjax.arm.arm import Arm
from ikjax.solvers.family import reach

PSI = 1.533751168755204288118041
"""The real root of psi^4 = psi + 4."""


@dataclasses.dataclass(frozen=True)
class Grid:
    """Positions on a box grid, x slowest and z fastest."""

    origin: tuple[float, ...]
    """The first position [m], world frame."""
    spacing: float
    """[m]"""
    shape: tuple[int, ...]

    @property
    def count(self) -> int:
        """Number of positions."""
        return math.prod(self.shape)

    def axis(self, k: int) -> np.ndarray:
        """The coordinates along x (0), y (1) or z (2) [m]."""
        return self.origin[k] + self.spacing * np.arange(self.shape[k])

    def points(self) -> np.ndarray:
        """All positions [m], (*shape, 3)."""
        return self.part((slice(None),) * 3)

    def part(self, box: tuple[slice, ...]) -> np.ndarray:
        """The positions of a box of the grid [m]: the same numbers as in `points()[box]`."""
        axes = [self.axis(k)[side] for k, side in enumerate(box)]
        return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)


def grid(lower, upper, spacing: float) -> Grid:
    """A grid that fills the box from `lower` to `upper` and is centred in it.

    Args:
        lower, upper: Corners (3,) [m].
        spacing: Between neighbours [m].

    Raises:
        ValueError: A wrong shape, corners out of order, a spacing that is not positive.
    """
    lower, upper = np.asarray(lower, float), np.asarray(upper, float)
    if lower.shape != (3,) or upper.shape != (3,):
        raise ValueError(f"lower and upper must have shape (3,), got {lower.shape} and {upper.shape}")
    if not (np.isfinite(lower).all() and np.isfinite(upper).all() and (lower <= upper).all()):
        raise ValueError(f"lower must not exceed upper, got {lower} and {upper}")
    _check_spacing(spacing)
    shape = np.floor((upper - lower) / spacing + 1e-9).astype(int) + 1
    origin = (lower + upper - (shape - 1) * spacing) / 2
    return Grid(tuple(map(float, origin)), float(spacing), tuple(map(int, shape)))


def _check_spacing(spacing: float) -> None:
    if not 0 < spacing < np.inf:
        raise ValueError(f"spacing must be a positive number of metres, got {spacing}")


def around(arm: Arm, spacing: float) -> Grid:
    """A cubic grid around the arm's first axis that no reachable position lies outside of.

    Args:
        arm: The arm.
        spacing: Between neighbours [m].
    """
    _check_spacing(spacing)
    baked = arm.baked()
    centre = np.asarray(baked.base, float)[:3, 3] + float(baked.d[0]) * np.asarray(baked.base, float)[:3, 2]
    radius = float(reach(baked)) - abs(float(baked.d[0]))
    radius = spacing * np.ceil(radius / spacing)
    return grid(centre - radius, centre + radius, spacing)


def even_rotations(n: int) -> np.ndarray:
    """n rotations spread evenly over all rotations, the same ones every time: (n, 3, 3).

    Source: Alexa, Super-Fibonacci spirals: fast, low-discrepancy sampling of SO(3), CVPR 2022,
    algorithm 1.

    Raises:
        ValueError: n below 1.
    """
    if n < 1:
        raise ValueError(f"n must be at least 1, got {n}")
    s = np.arange(n) + 0.5
    near, far = np.sqrt(s / n), np.sqrt(1 - s / n)
    a, b = 2 * np.pi * s / np.sqrt(2), 2 * np.pi * s / PSI
    x, y, z, w = near * np.sin(a), near * np.cos(a), far * np.sin(b), far * np.cos(b)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), -1, 0)
