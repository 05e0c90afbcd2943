"""Lanes that need the joints of solutions: how well an arm moves there, how far limits are, a user's own.

They run in a loop whose values are held, many times slower than one of masks alone.
"""

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
from ikjax.ik.results import Solutions
from ikjax.maps.fingerprint import traced
from ikjax.maps.kernel import joint_measures
from ikjax.maps.kernel.flags import distance
from ikjax.maps.kernel.sample import Goal, Lane
from ikjax.maps.store.manifest import check_name
from ikjax.solvers.context import Slide

LARGEST = 8.0
"""Manipulabilities beyond are averaged as this."""

MOST = 2**25
"""Units: so many a goal's number may have, over all its rolls, where numbers are summed up."""


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
            return {self.name: Lane(self.reduce, lambda goal: self._value(goal), held=True)}
        most = MOST // rolls

        def units(goal: Goal) -> jax.Array:
            value = jnp.round(self._value(goal) / self.unit)
            return jnp.where(_sane(value, most), value, 0).astype(jnp.int32)

        def wild(goal: Goal) -> jax.Array:
            return (~_sane(jnp.round(self._value(goal) / self.unit), most)).astype(jnp.int32)

        return {
            self.name: Lane("sum", units, held=True),
            f"{self.name}.wild": Lane("count", wild, any_roll=True, held=True),
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


def unit_of_mean(slots: int, rolls: int) -> float:
    """What numbers are rounded to that are summed up for a mean: those of 32 goals fit 31 bits."""
    return 2.0 ** -min(20, 23 - math.ceil(math.log2(slots * rolls)))


def best(goal: Goal, what: str, inside: bool) -> jax.Array:
    """The greatest of a goal's solutions; 0 without one."""
    values = zip(_of_slots(goal, what), goal.flags(inside), strict=True)
    return functools.reduce(jnp.maximum, [jnp.where(flag, value, 0) for value, flag in values])


def total(goal: Goal, what: str, inside: bool, unit: float) -> jax.Array:
    """The sum over a goal's solutions, in whole units."""
    found = jnp.zeros(goal.shape, jnp.int32)
    for value, flag in zip(_of_slots(goal, what), goal.flags(inside), strict=True):
        units = jnp.round(jnp.minimum(value, LARGEST) / unit)
        found = found + jnp.where(flag, units, 0).astype(jnp.int32)
    return found


def _of_slots(goal: Goal, what: str) -> list[jax.Array]:
    """How well the arm moves at each slot, valid or not; computed once a goal."""

    # A loop, because eight of these would compile for half a minute.
    def row(slot) -> list[jax.Array]:
        pairs = [(j.value,) if isinstance(j, Slide) else (j.sin, j.cos) for j in slot.joints]
        return [jnp.broadcast_to(x, goal.shape) for pair in pairs for x in pair]

    def measure(numbers: jax.Array) -> jax.Array:
        left = list(numbers)
        joints: list[Any] = []
        for joint in goal.slots[0].joints:
            if isinstance(joint, Slide):
                joints.append(Slide(left.pop(0)))
            else:
                joints.append(type(joint)(left.pop(0), left.pop(0), ()))
        columns = joint_measures.jacobian_columns(goal.arm, tuple(joints), goal.hold)
        return getattr(joint_measures, what)(columns, goal.hold)

    if what not in goal.kept:
        goal.kept[what] = list(jax.lax.map(measure, jnp.stack([jnp.stack(row(slot)) for slot in goal.slots])))
    return goal.kept[what]


def best_limit_distance(goal: Goal) -> jax.Array:
    """The greatest of a goal's solutions; -inf without one."""
    found = jnp.full(goal.shape, -jnp.inf, goal.slots[0].margin.dtype)
    for slot in goal.slots:
        found = jnp.where(slot.valid, jnp.maximum(found, distance(goal.arm, slot)), found)
    return found
