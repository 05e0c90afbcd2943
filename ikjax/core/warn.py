"""Warnings that point at the caller's line, and the one about degrees.

Storey: core. Host side: values that are traced are not looked at.
"""

import math
import sys
import warnings

import jax
import numpy as np

MOST_LOOKED_AT = 100_000
"""Of a long array so many numbers, because a wrong unit is wrong everywhere."""


def warn(text: str) -> None:
    """A UserWarning at the nearest line outside this package."""
    level, frame = 1, sys._getframe()
    while frame.f_back is not None and frame.f_globals.get("__name__", "").split(".")[0] == "ikjax":
        level, frame = level + 1, frame.f_back
    warnings.warn(text, stacklevel=level)


def warn_of_degrees(name: str, angles, turns: float = 1, most: float = math.inf) -> None:
    """One warning where an angle [rad] is beyond so many turns, as numbers of degrees are.

    Args:
        name: The argument.
        angles: Of any shape; infinite ones are no angles.
        turns: What is still taken for radians.
        most: [rad] What is beyond stands for no limit, not for degrees.
    """
    if any(isinstance(x, jax.core.Tracer) for x in jax.tree.leaves(angles)):
        return
    if isinstance(angles, jax.Array):
        angles = angles.reshape(-1)[:MOST_LOOKED_AT]
    sizes = np.abs(np.asarray(angles, float)).reshape(-1)[:MOST_LOOKED_AT]
    suspect = np.isfinite(sizes) & (sizes > turns * 2 * math.pi * (1 + 1e-6)) & (sizes < most)
    if suspect.any():
        first = sizes[suspect][0]
        warn(f"{name} holds {first:.4g} rad, which is {first / (2 * math.pi):.3g} turns: degrees?")
