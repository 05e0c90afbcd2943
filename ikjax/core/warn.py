"""Warnings at the caller's line, among them of arguments that are probably in degrees or millimetres.

They look at concrete values only; traced ones pass without a warning.
"""

import math
import sys
import warnings

import jax
import numpy as np

MOST_LOOKED_AT = 100_000
"""So many numbers of a long array are checked: a wrong unit is wrong everywhere."""

MOST_TURNS = 4
"""Joint values beyond so many turns are taken for degrees."""

LONGEST = 30
"""[m] Longer arms are taken for millimetres."""

UNIT_MISTAKE = 2e4
"""No wrong unit explains a number beyond this: it stands for "no limit", or tests a range of numbers."""


def warn(text: str) -> None:
    """A UserWarning at the nearest line outside this package."""
    level, frame = 1, sys._getframe()
    while frame.f_back is not None and frame.f_globals.get("__name__", "").split(".")[0] == "ikjax":
        level, frame = level + 1, frame.f_back
    warnings.warn(text, stacklevel=level)


def warn_of_degrees(name: str, angles, turns: float = 1, kinds: str = "") -> None:
    """One warning where an angle [rad] is beyond so many turns, as degrees are.

    Args:
        name: Of the argument, for the message.
        angles: Any shape; (..., n) joint values with `kinds`.
        turns: The largest number of whole turns without a warning.
        kinds: "R" or "P" for each of n joints: only the revolute ones are checked.
    """
    revolute = [kind == "R" for kind in kinds] if kinds else [True]
    angle = _beyond(angles, turns * 2 * math.pi, revolute)
    if angle is not None:
        warn(f"{name} holds {angle:.4g} rad, which is {angle / (2 * math.pi):.3g} turns: degrees?")


def warn_of_millimetres(name: str, length) -> None:
    """One warning where the sum of a column of a table [m] is longer than arms are."""
    total = _beyond(length, LONGEST, [True])
    if total is not None:
        warn(f"{name} adds up to {total:.4g} m: millimetres?")


def _beyond(values, most: float, columns: list[bool]) -> float | None:
    """The absolute value of the first number beyond `most` that a wrong unit explains; None without one.

    Args:
        values: Any shape, read as rows of as many entries as `columns` has.
        most: The largest number without a warning.
        columns: Which entries of a row are checked.
    """
    if any(isinstance(x, jax.core.Tracer) for x in jax.tree.leaves(values)):
        return None
    rows = values
    if isinstance(values, jax.Array) and values.size > MOST_LOOKED_AT:
        # An array that a jit captures is concrete, but a slice of it would be traced without this.
        with jax.ensure_compile_time_eval():
            rows = values.reshape(-1, len(columns))[: MOST_LOOKED_AT // len(columns)]
    rows = np.asarray(rows, float).reshape(-1, len(columns))[: MOST_LOOKED_AT // len(columns)]
    sizes = np.abs(rows)[:, columns]
    # A turn that a file has rounded up is still a turn.
    sizes = sizes[(sizes > most * (1 + 1e-6) + 1e-3) & (sizes < UNIT_MISTAKE)]
    return float(sizes[0]) if len(sizes) else None
