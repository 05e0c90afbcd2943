"""Statistics beyond the named ones: a function of the user's own, and goals that are nearly reached."""

import dataclasses
import functools
import math
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ikjax.arm.arm import Arm
from ikjax.ik.inline import FIELDS
from ikjax.ik.multistart import closed_form
from ikjax.ik.results import Solutions
from ikjax.maps.fingerprint import traced
from ikjax.maps.kernel.sample import Goal, Lane
from ikjax.maps.store.manifest import check_name

MOST = 2**25
"""Units: so many a goal's number may have, over all its rolls, where numbers are summed up."""


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
        return Lane("count", self._any, any_roll=True, pinned=True)

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
    slots = closed_form(goal.arm, (*rows, (zero, zero, zero, zero + 1)), zero + 1)
    return [(slot.position_error, slot.rotation_error) for slot in slots]


@dataclasses.dataclass(frozen=True)
class Measure:
    """A statistic of one's own: a number of each goal, and how those of all orientations become one.

    The function is handed `Solutions` as from `solve`, its fields (..., S) and `q` (..., S, n), and returns
    (...) numbers. It must be elementwise: a goal's number may depend on that goal's solutions alone, and
    be made by jax alone. `within_limits` and `nearest` are elementwise too. Its name and its program, as jax
    traces it when the sweep begins, with every number that it holds, are part of a map's spec.
    """

    name: str
    function: Callable[[Solutions], Any]
    reduce: str
    """"sum", "max" or "min" over orientations, and over free rolls."""
    unit: float = 1.0
    """Of a sum: each number is rounded to whole units, so that sums come out the same in any order."""

    def __post_init__(self):
        check_name(self.name)
        if self.reduce not in ("sum", "max", "min"):
            raise ValueError(f'reduce must be "sum", "max" or "min", got {self.reduce!r}')
        if not 0 < self.unit < math.inf:
            raise ValueError(f"unit must be a positive number, got {self.unit}")

    def facts(self, arm: Arm) -> dict[str, Any]:
        """What tells it from another of its name.

        Raises:
            ValueError: The function does not return a number for each goal, or its program cannot be told.
        """
        code, shapes = traced(self.name, self.function, _blank(arm, (2, 3)))
        if shapes != [(2, 3)]:
            raise ValueError(f"{self.name} must return one number a goal, (2, 3) for (2, 3), got {shapes}")
        return {"reduce": self.reduce, "unit": float(self.unit), "code": code}

    def lanes(self, arm: Arm, rolls: int) -> dict[str, Lane]:
        """What the loop does for it."""
        if self.reduce != "sum":
            return {self.name: Lane(self.reduce, lambda goal: self._value(goal), pinned=True)}
        most = MOST // rolls

        def units(goal: Goal) -> jax.Array:
            value = jnp.round(self._value(goal) / self.unit)
            return jnp.where(_sane(value, most), value, 0).astype(jnp.int32)

        def wild(goal: Goal) -> jax.Array:
            return (~_sane(jnp.round(self._value(goal) / self.unit), most)).astype(jnp.int32)

        return {
            self.name: Lane("sum", units, pinned=True),
            f"{self.name}.wild": Lane("count", wild, any_roll=True, pinned=True),
        }

    def finish(self, total: np.ndarray, wild: np.ndarray | None = None) -> np.ndarray:
        """What is stored."""
        if wild is None:
            return total[:, 0]
        if wild.any():
            raise ValueError(
                f"{self.name} gave numbers that are not finite or of more than {MOST:,} units of {self.unit}"
            )
        return total[:, 0] * self.unit

    def _value(self, goal: Goal) -> jax.Array:
        value = self.function(_solutions(goal))
        return jnp.asarray(value).astype(goal.slots[0].margin.dtype)


def _sane(value: jax.Array, most: int) -> jax.Array:
    return jnp.abs(value) <= most


def _blank(arm: Arm, shape: tuple[int, ...]) -> Solutions:
    slots = (*shape, len(arm.branches))
    number, flag = jnp.zeros(slots, arm.dtype), jnp.zeros(slots, bool)
    q, is_pose = jnp.zeros((*slots, arm.n), arm.dtype), jnp.ones(shape, bool)
    return Solutions(q, flag, number, flag, number, number, is_pose)


def _solutions(goal: Goal) -> Solutions:
    def packed(values) -> jax.Array:
        return jnp.stack([jnp.broadcast_to(x, goal.shape) for x in values], axis=-1)

    q = jnp.stack([packed(slot.q) for slot in goal.slots], axis=-2)
    rest = {name: packed([getattr(slot, name) for slot in goal.slots]) for name in FIELDS}
    return Solutions(q=q, is_pose=jnp.ones(goal.shape, bool), **rest)
