"""Statistics beyond the named ones: a user's own function, and goals that are nearly reached."""

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
from ikjax.maps.fingerprint import program_hash
from ikjax.maps.kernel.sample import Channel, Goal
from ikjax.maps.store.manifest import check_name

MAX_UNITS = 2**25
"""Largest number of a goal, in units, over all its trials, where numbers are summed."""

CLOSED = "closed"
"""Key of the errors of the closed form in `Goal.cache`, for all statistics `Near`."""


@dataclasses.dataclass(frozen=True)
class Near:
    """A statistic: orientations for which a branch of `project(..., steps=0)` is within both tolerances.

    The branches are within the joint limits: one that was outside has been moved to them, and its errors say
    what that cost. They come from the closed form alone, which meets the point as well as it can and then the
    orientation as nearly as that allows. A pose that gives up some of the point for the orientation may be
    within the tolerances where no branch is, so the count is a lower bound. Goals at the edge of a tolerance
    are decided by rounding.
    """

    position: float
    """Tolerated distance from the goal's point [m], zero or more."""
    rotation: float
    """Tolerated angle from the goal's orientation [rad], zero or more."""
    name: str = "near"
    """Its name in the map: small letters, digits and _."""

    def __post_init__(self):
        check_name(self.name)
        for field in ("position", "rotation"):
            if not 0 <= getattr(self, field) < math.inf:
                raise ValueError(f"{field} must be a tolerance, zero or more, got {getattr(self, field)}")

    def facts(self) -> dict[str, Any]:
        """What tells it from another of its name, for the map's spec."""
        return {"near": [float(self.position), float(self.rotation)]}

    def channel(self) -> Channel:
        """Its channel in the loop."""
        return Channel("count", self._is_near, any_trial=True, pinned=True, needs_whole_arm=True)

    def _is_near(self, goal: Goal) -> jax.Array:
        """Whether some branch is within both tolerances, int32 (positions, orientations)."""
        if CLOSED not in goal.cache:
            goal.cache[CLOSED] = _branch_errors(goal)
        within = [(gap <= self.position) & (angle <= self.rotation) for gap, angle in goal.cache[CLOSED]]
        return functools.reduce(jnp.logical_or, within).astype(jnp.int32)


def _branch_errors(goal: Goal) -> list[tuple[jax.Array, jax.Array]]:
    """Position error [m] and rotation error [rad] of every branch of the closed form."""
    assert goal.pose is not None
    # Pinned values must have the shape of one number of the goal.
    position = [jnp.broadcast_to(x, goal.shape) for x in goal.pose.position]
    zero = jnp.zeros_like(position[0])
    rows = [(*row, x) for row, x in zip(goal.pose.rotation, position, strict=True)]
    slots = closed_form(goal.arm, (*rows, (zero, zero, zero, zero + 1)), zero + 1, goal.free)
    return [(slot.position_error, slot.rotation_error) for slot in slots]


@dataclasses.dataclass(frozen=True)
class Measure:
    """A user's own statistic: a number of each goal, and its reduction over orientations.

    The function must be elementwise: a goal's number may depend on that goal's solutions alone. It must be
    made of jax operations alone. `within_limits` and `nearest` are elementwise too. The name, and the program
    as jax traces it when the sweep begins, with all its constants, are part of a map's spec.
    """

    name: str
    """Its name in the map: small letters, digits and _."""
    function: Callable[[Solutions], Any]
    """From `Solutions` as of `solve`, with fields (..., S) and `q` (..., S, n), to numbers (...)."""
    reduce: str
    """"sum", "max" or "min" over orientations, free rolls and values of the redundant joint."""
    unit: float = 1.0
    """Of a sum: each number is rounded to whole units, so that sums have the same bits in any order."""

    def __post_init__(self):
        check_name(self.name)
        if self.reduce not in ("sum", "max", "min"):
            raise ValueError(f'reduce must be "sum", "max" or "min", got {self.reduce!r}')
        if not 0 < self.unit < math.inf:
            raise ValueError(f"unit must be a positive number, got {self.unit}")

    def facts(self, arm: Arm) -> dict[str, Any]:
        """What tells it from another of its name, for the map's spec.

        Args:
            arm: The arm that is swept, of the kernel's type.

        Raises:
            ValueError: The function does not return one number for each goal, or its program cannot be
                hashed.
        """
        code, shapes = program_hash(self.name, self.function, _example_solutions(arm, (2, 3)))
        if shapes != [(2, 3)]:
            raise ValueError(f"{self.name} must return one number a goal, (2, 3) for (2, 3), got {shapes}")
        return {"reduce": self.reduce, "unit": float(self.unit), "code": code}

    def channels(self, trials: int) -> dict[str, Channel]:
        """Its channels in the loop, by name.

        Args:
            trials: Of each goal.
        """
        if self.reduce != "sum":
            return {self.name: Channel(self.reduce, lambda goal: self._value(goal), pinned=True)}
        most = MAX_UNITS // trials

        def units(goal: Goal) -> jax.Array:
            value = jnp.round(self._value(goal) / self.unit)
            return jnp.where(_fits(value, most), value, 0).astype(jnp.int32)

        def too_large(goal: Goal) -> jax.Array:
            return (~_fits(jnp.round(self._value(goal) / self.unit), most)).astype(jnp.int32)

        return {
            self.name: Channel("sum", units, pinned=True),
            f"{self.name}.too_large": Channel("count", too_large, any_trial=True, pinned=True),
        }

    def finish(self, result: np.ndarray, too_large: np.ndarray | None = None) -> np.ndarray:
        """The numbers that are stored, (positions,).

        Args:
            result: (positions, 1) of the channel of numbers.
            too_large: (positions, 1) of a sum: goals whose number is not finite or too large.

        Raises:
            ValueError: There is such a goal.
        """
        if too_large is None:
            return result[:, 0]
        if too_large.any():
            raise ValueError(
                f"{self.name} gave numbers that are not finite or "
                f"of more than {MAX_UNITS:,} units of {self.unit}"
            )
        return result[:, 0] * self.unit

    def _value(self, goal: Goal) -> jax.Array:
        """The function's numbers (positions, orientations), in the kernel's type."""
        value = self.function(_stacked_solutions(goal))
        return jnp.asarray(value).astype(goal.slots[0].margin.dtype)


def _fits(value: jax.Array, most: int) -> jax.Array:
    """Whether a number of units is finite and small enough to be summed exactly."""
    return jnp.abs(value) <= most


def _example_solutions(arm: Arm, shape: tuple[int, ...]) -> Solutions:
    """Solutions of goals of that shape, all zero, to trace a function with."""
    slots = (*shape, len(arm.branches))
    number, flag = jnp.zeros(slots, arm.dtype), jnp.zeros(slots, bool)
    q, is_pose = jnp.zeros((*slots, arm.n), arm.dtype), jnp.ones(shape, bool)
    return Solutions(q, flag, number, flag, number, number, is_pose)


def _stacked_solutions(goal: Goal) -> Solutions:
    """The goals' slots as `solve` returns them: fields (positions, orientations, S)."""

    def packed(values) -> jax.Array:
        return jnp.stack([jnp.broadcast_to(x, goal.shape) for x in values], axis=-1)

    q = jnp.stack([packed(slot.q) for slot in goal.slots], axis=-2)
    rest = {name: packed([getattr(slot, name) for slot in goal.slots]) for name in FIELDS}
    return Solutions(q=q, is_pose=jnp.ones(goal.shape, bool), **rest)
