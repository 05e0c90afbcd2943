"""Angles counted in 32-bit integers, and rotations made of them, for numpy and for jax alike."""

import math

import numpy as np

from ikjax.core.vector import Matrix


def angle(index, turns: float, xp, dtype):
    """(index + 1/2) times so many turns [rad], in (-pi, pi].

    The step is rounded to 2^-32 turns and multiplied in integers, which wrap around as angles do.
    """
    step = round(turns * 2**32)
    phase = index.astype(np.uint32) * xp.uint32(step) + xp.uint32(step // 2)
    return phase.astype(np.int32).astype(dtype) * dtype.type(math.tau / 2**32)


def tilt(half, rest, azimuth, xp) -> Matrix:
    """Turns z towards an azimuth by the shortest way.

    Args:
        half: The square of the sine of half the angle turned by: 0 at the pole, 1 at the other.
        rest: That of its cosine, which next to the other pole has digits that 1 - half has not.
        azimuth: [rad]
        xp: numpy or jax.numpy.
    """
    c, s = xp.cos(azimuth), xp.sin(azimuth)
    sine = 2 * xp.sqrt(half * rest)
    return (
        (1 - 2 * half * c * c, -2 * half * c * s, sine * c),
        (-2 * half * c * s, 1 - 2 * half * s * s, sine * s),
        (-sine * c, -sine * s, 1 - 2 * half),
    )


def about_z(turned, xp) -> Matrix:
    c, s = xp.cos(turned), xp.sin(turned)
    return ((c, -s, 0.0), (s, c, 0.0), (0.0, 0.0, 1.0))
