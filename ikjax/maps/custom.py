"""How many goals an arm comes near, where it has too few joints to reach them.

Every goal is projected in closed form, as `project` does without steps.
"""

import dataclasses
import functools
import math
from typing import Any

import jax
import jax.numpy as jnp

from ikjax.ik.refine import closed
from ikjax.maps.kernel.sample import Goal, Lane
from ikjax.maps.store.manifest import check_name

CLOSED = "closed"
"""What `Goal.kept` has of the closed form, for all that look at it."""


@dataclasses.dataclass(frozen=True)
class Near:
    """A statistic: orientations of which some branch of `project(..., steps=0)` is within both tolerances.

    A branch is within the joint limits: one that was outside has been put on them, and its errors say what
    that cost. It is the closed form alone, which holds the point as well as it can and then turns as near as
    that allows; a pose that gives up some of the point for the orientation may be within the tolerances where
    none of these is, so that the count is a lower bound. Goals on the edge of a tolerance are decided by
    rounding.
    """

    position: float
    """Distance from the goal's point that is near enough [m]."""
    rotation: float
    """Angle from the goal's orientation that is near enough [rad]."""
    name: str = "near"
    """What the map calls it."""

    def __post_init__(self):
        check_name(self.name)
        for field in ("position", "rotation"):
            if not 0 <= getattr(self, field) < math.inf:
                raise ValueError(f"{field} must be a tolerance, zero or more, got {getattr(self, field)}")

    def facts(self) -> dict[str, Any]:
        """What tells it from another of its name."""
        return {"near": [float(self.position), float(self.rotation)]}

    def lane(self) -> Lane:
        """What the loop does for it."""
        return Lane("count", self._any, any_roll=True, held=True)

    def _any(self, goal: Goal) -> jax.Array:
        if CLOSED not in goal.kept:
            goal.kept[CLOSED] = _errors(goal)
        near = [(gap <= self.position) & (angle <= self.rotation) for gap, angle in goal.kept[CLOSED]]
        return functools.reduce(jnp.logical_or, near).astype(jnp.int32)


def _errors(goal: Goal) -> list[tuple[jax.Array, jax.Array]]:
    """Of every branch, [m] and [rad]."""
    assert goal.pose is not None
    # What is held has the shape of one number of the goal.
    position = [jnp.broadcast_to(x, goal.shape) for x in goal.pose.position]
    zero = jnp.zeros_like(position[0])
    rows = [(*row, x) for row, x in zip(goal.pose.rotation, position, strict=True)]
    slots = closed(goal.arm, (*rows, (zero, zero, zero, zero + 1)), zero + 1)
    return [(slot.position_error, slot.rotation_error) for slot in slots]
