"""Angles counted in 32-bit integers, and rotations made of them, for numpy and for jax alike."""

import math
from types import ModuleType

import numpy as np

from ikjax.core.trig import Scalar
from ikjax.core.vector import Matrix
from ikjax.maps.sets.protocol import Index


def angle(index: Index, turns: float, xp: ModuleType, dtype: np.dtype) -> Scalar:
    """The angle (index + 1/2) * turns, in (-pi, pi] [rad], of the shape of the index.

    The step is rounded to 2^-32 turns and multiplied in integers, which wrap around as angles do. So the
    angle is exact for any index, in float32 as in float64.

    Args:
        index: Whole numbers.
        turns: The step, as a part of a whole turn.
        xp: numpy or jax.numpy.
        dtype: Floating type of the result.
    """
    step = round(turns * 2**32)
    phase = index.astype(np.uint32) * xp.uint32(step) + xp.uint32(step // 2)
    return phase.astype(np.int32).astype(dtype) * dtype.type(math.tau / 2**32)


def tilt(half: Scalar, rest: Scalar, azimuth: Scalar, xp: ModuleType) -> Matrix:
    """The rotation about a horizontal axis that turns z to a direction.

    Args:
        half: Squared sine of half the polar angle of the direction: 0 at z, 1 at -z.
        rest: Squared cosine of that half. Near -z it has digits that 1 - half has lost.
        azimuth: Of the direction [rad].
        xp: numpy or jax.numpy.
    """
    c, s = xp.cos(azimuth), xp.sin(azimuth)
    sine = 2 * xp.sqrt(half * rest)
    return (
        (1 - 2 * half * c * c, -2 * half * c * s, sine * c),
        (-2 * half * c * s, 1 - 2 * half * s * s, sine * s),
        (-sine * c, -sine * s, 1 - 2 * half),
    )


def about_z(turned: Scalar, xp: ModuleType) -> Matrix:
    """The rotation about z by an angle [rad]."""
    c, s = xp.cos(turned), xp.sin(turned)
    return ((c, -s, 0.0), (s, c, 0.0), (0.0, 0.0, 1.0))
