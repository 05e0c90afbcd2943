"""The range of the redundant joints, and values spread over it."""

import itertools
from typing import Any

import jax.numpy as jnp
import numpy as np

from ikjax.arm.arm import Arm
from ikjax.arm.forward import reach
from ikjax.core.xla import is_traced

Array = Any
"""Of numpy where the arm's limits are known: they stay known in a jit."""


def redundant_range(arm: Arm, joint: int, dtype) -> tuple[Array, Array]:
    """The least and the greatest value of a redundant joint [rad, m]: its limits.

    Of a turning joint with a range of more than a turn, or without limits, a turn in its middle; of a slide
    without a limit, two reaches.

    Args:
        arm: The arm, baked.
        joint: One of `Arm.locked`.
        dtype: Of the values.
    """
    size = np.pi if arm.kinds[joint] == "R" else reach(arm)
    xp: Any = jnp if is_traced((arm.limits, size)) else np
    low, high = xp.asarray(arm.limits, dtype)[joint]
    half = xp.asarray(size, dtype)
    below, above = xp.isfinite(low), xp.isfinite(high)
    one_sided = xp.where(below, low + half, xp.where(above, high - half, 0))
    with np.errstate(invalid="ignore"):  # of infinite limits
        middle = xp.where(below & above, low / 2 + high / 2, one_sided)
    width = half if arm.kinds[joint] == "R" else xp.where(below & above, xp.inf, half)
    ends = xp.maximum(low, middle - width), xp.minimum(high, middle + width)
    return tuple(xp.asarray(end, dtype) for end in ends)


def with_ends(arm: Arm, samples: int, dtype) -> Array:
    """Values of the one redundant joint, (samples,), evenly from the least to the greatest."""
    low, high = redundant_range(arm, arm.locked[0], dtype)
    return low + (high - low) * np.linspace(0, 1, samples).astype(dtype)


def middles(arm: Arm, samples: int, dtype) -> Array:
    """Values of all redundant joints, (samples^k, k): the middles of so many equal parts of each range.

    Each stands for its part, so no value is tried twice where a range is a whole turn.

    Args:
        arm: The arm, baked.
        samples: Values of each joint.
        dtype: Of the values.
    """
    share = ((np.arange(samples) + 0.5) / samples).astype(dtype)
    columns = []
    for joint in arm.locked:
        low, high = redundant_range(arm, joint, dtype)
        columns.append(low + (high - low) * share)
    places = np.array(list(itertools.product(range(samples), repeat=len(columns))), int)
    rows = places.reshape(-1, len(columns)).T
    xp: Any = jnp if is_traced(columns) else np
    return xp.stack([column[row] for column, row in zip(columns, rows, strict=True)], axis=-1)
