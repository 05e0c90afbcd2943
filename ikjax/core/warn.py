"""Warnings at the caller's line: of arguments that are probably in degrees or millimetres.

Host side: values that are traced are not looked at.
"""

import math
import sys
import warnings

import jax
import numpy as np

MOST_LOOKED_AT = 100_000
"""Of a long array so many numbers, because a wrong unit is wrong everywhere."""

MOST_TURNS = 4
"""Joints that stand further are taken for degrees."""

LONGEST = 30
"""[m] Longer arms are taken for millimetres."""

UNIT_MISTAKE = 2e4
"""What is so large is in no unit of its kind: it stands for no limit, or tests a range of numbers."""


def warn(text: str) -> None:
    """A UserWarning at the nearest line outside this package."""
    level, frame = 1, sys._getframe()
    while frame.f_back is not None and frame.f_globals.get("__name__", "").split(".")[0] == "ikjax":
        level, frame = level + 1, frame.f_back
    warnings.warn(text, stacklevel=level)


def warn_of_degrees(name: str, angles, turns: float = 1, kinds: str = "") -> None:
    """One warning where an angle [rad] is beyond so many turns, as degrees are.

    Of values (..., n) with the kinds of n joints, "R" or "P" each, only the turning ones are looked at.
    """
    turning = [kind == "R" for kind in kinds] if kinds else [True]
    found = _beyond(angles, turns * 2 * math.pi, turning)
    if found is not None:
        warn(f"{name} holds {found:.4g} rad, which is {found / (2 * math.pi):.3g} turns: degrees?")


def warn_of_millimetres(name: str, length) -> None:
    """One warning where a column of a table adds up to more metres than arms are long."""
    found = _beyond(length, LONGEST, [True])
    if found is not None:
        warn(f"{name} adds up to {found:.4g} m: millimetres?")


def _beyond(values, most: float, columns: list[bool]) -> float | None:
    """The size of the first number of some columns that is too large, and that another unit explains."""
    if any(isinstance(x, jax.core.Tracer) for x in jax.tree.leaves(values)):
        return None
    array = values if isinstance(values, jax.Array) else np.asarray(values, float)
    with jax.ensure_compile_time_eval():  # what a jit captures has a value, what is cut from it has none
        rows = array.reshape(-1, len(columns))[: MOST_LOOKED_AT // len(columns)]
    sizes = np.abs(np.asarray(rows, float))[:, columns]
    # Files round a turn up.
    sizes = sizes[(sizes > most * (1 + 1e-6) + 1e-3) & (sizes < UNIT_MISTAKE)]
    return float(sizes[0]) if len(sizes) else None
