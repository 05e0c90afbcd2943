"""Goals of which float32 cannot say for sure which slots hold.

Near a fold a rounding decides whether two answers are there or none, and near a limit whether
a joint is within it. Both are told by how near, with room to spare: of random goals some thousandths are
doubtful, of which one in a hundred comes out otherwise in float64.
"""

import jax
import jax.numpy as jnp

from ikjax.arm.arm import Arm
from ikjax.maps.kernel.flags import within
from ikjax.solvers.pipeline import TOLERANCE, Slot, reach

FOLD = 64
"""Tolerances from the fold [reach], within which a slot is doubtful."""

MISSES = 1 / 16, 8.0
"""Pose errors, in tolerances, between which a slot is doubtful."""

LIMIT = 1e-3
"""Distance from a joint's limit within which a slot is doubtful [rad, m]: rounding times a thousand or more,
as much as a joint near a singularity makes of it."""

FREEDOMS = {"pose": 6, "position": 3, "planar_pose": 3, "planar_position": 2}
"""Numbers that a task asks for. An arm of fewer joints meets them on a surface, never for sure off a grid."""


def doubtful(arm: Arm, slot: Slot) -> jax.Array:
    """Whether another rounding may decide otherwise.

    Args:
        arm: A baked arm.
        slot: One of its slots.
    """
    least, most = MISSES
    close = slot.miss_squared <= most * most
    fold = slot.margin <= FOLD * TOLERANCE[slot.margin.dtype.name] * reach(arm)
    unsure = fold | (slot.miss_squared >= least * least) | slot.continuum
    if FREEDOMS[arm.task] > arm.n:
        return close
    at_limit = within(arm, slot, LIMIT) != within(arm, slot, -LIMIT)
    return close & (unsure | at_limit)


def any_doubtful(arm: Arm, slots: tuple[Slot, ...]) -> jax.Array:
    """Whether any slot of a goal is."""
    found = jnp.zeros((), bool)
    for slot in slots:
        found = found | doubtful(arm, slot)
    return found
