"""`free_roll`: at which rolls about its own axis an arm reaches a goal, as intervals.

Rolls are sampled, and each end between a roll that reaches and one that does not is found by bisection. The
number of intervals is that of the samples: one that is narrower than their distance may be missed.
"""

import dataclasses
import math
from typing import Any

import jax.numpy as jnp
import numpy as np

from ikjax.arm.arm import Arm
from ikjax.core.pose import HasMatrix, pose
from ikjax.core.typing import ArrayInput
from ikjax.ik.check import check_goals
from ikjax.ik.redundancy import checked_samples, solve_at_samples
from ikjax.ik.select import within_limits
from ikjax.ik.solve import as_goals, check_family

TURN = 2 * math.pi
"""[rad]"""

HALVINGS = {"float32": 14, "float64": 40}
"""Steps of the bisection of an end; after them it is known to the rounding of the type."""

REDUNDANCY_SAMPLES = 32
"""Values of a redundant joint by default."""

AT_ONCE = 2**16
"""Goals that are solved at a time, at most."""


@dataclasses.dataclass(frozen=True, eq=False)
class FreeRolls:
    """At which rolls about its tool's z axis an arm reaches each goal."""

    rolls: np.ndarray
    """(n,) the rolls that were tried [rad], from 0 up to a turn."""
    reached: np.ndarray
    """(..., n) bool: which of them are reached."""
    intervals: Any
    """The intervals of rolls that are reached, (k, 2) [rad] of one goal, an array of objects (...) of these
    for several: each from its first to its last roll, the first in [0, 2 pi), the last up to a turn beyond
    it. All rolls are the one interval (0, 2 pi)."""

    @property
    def share(self) -> np.ndarray:
        """(...) which share of a turn is reached, 0 to 1."""
        if self.reached.ndim == 1:
            return np.asarray(np.diff(self.intervals).sum() / TURN)
        flat = [np.diff(each).sum() / TURN for each in self.intervals.ravel()]
        return np.reshape(flat, self.intervals.shape)

    def __repr__(self) -> str:
        goals = self.reached.shape[:-1]
        if not goals:
            words = ", ".join(f"{math.degrees(a):.1f} to {math.degrees(b):.1f}" for a, b in self.intervals)
            return f"<FreeRolls: {words or 'no roll reaches'}{' deg' if words else ''}>"
        hit = self.reached.any(-1)
        return f"<FreeRolls of goals {goals}: {hit.sum()} of {hit.size} are reached at some roll>"


def free_roll(
    arm: Arm,
    goals: ArrayInput | HasMatrix,
    n: int = 72,
    *,
    limits: bool = True,
    redundancy_samples: int | None = None,
) -> FreeRolls:
    """Which rolls about the tool's own z axis reach a goal, as intervals. Host side.

    For a tool that works the same at any roll, such as a drill: the goal gives its point and its axis.

    Args:
        arm: An arm with a family.
        goals: T_world_tool, (..., 4, 4), float32 or float64; their own rolls count as zero.
        n: Rolls that are tried, evenly over a turn. An interval narrower than a turn divided by n, or a gap,
            may be missed.
        limits: Whether the joint limits count.
        redundancy_samples: Of an arm with redundant joints: so many values of each are tried at every roll,
            32 by default.

    Returns:
        `FreeRolls`. The ends of the intervals are found by bisection, to about 1e-11 rad in float64 and 1e-5
        rad in float32; at an end found, the goal is reached.

    Raises:
        ValueError: A goal that is no pose, an arm without a closed form, n below 2.
    """
    check_family(arm)
    if isinstance(n, bool) or not isinstance(n, int | np.integer) or n < 2:
        raise ValueError(f"n must be a whole number, at least 2, got {n!r}")
    samples = checked_samples(arm, redundancy_samples, REDUNDANCY_SAMPLES)
    given = as_goals(goals)
    check_goals(arm, given)
    flat = np.asarray(given).reshape(-1, 4, 4)
    rolls = np.arange(n) * (TURN / n)
    pairs = np.repeat(np.arange(len(flat)), n), np.tile(rolls, len(flat))

    def reaches(which: np.ndarray, angles: np.ndarray) -> np.ndarray:
        return _reaches(arm, flat, which, angles, limits, samples)

    reached = reaches(*pairs).reshape(len(flat), n)
    # An end lies between a roll that reaches and its neighbor that does not, on either side.
    where, k = np.nonzero(reached & ~np.roll(reached, 1, axis=1))
    first = _ends(reaches, where, rolls[k], rolls[k] - TURN / n, flat.dtype.name)
    until, j = np.nonzero(reached & ~np.roll(reached, -1, axis=1))
    last = _ends(reaches, until, rolls[j], rolls[j] + TURN / n, flat.dtype.name)
    found = [
        _intervals(first[where == i], last[until == i], bool(reached[i].all())) for i in range(len(flat))
    ]
    batch = given.shape[:-2]
    intervals: Any = found[0] if not batch else np.empty(batch, object)
    if batch:
        for place, each in zip(np.ndindex(batch), found, strict=True):
            intervals[place] = each
    return FreeRolls(rolls, reached.reshape(*batch, n), intervals)


def _reaches(arm: Arm, goals, which, angles, limits: bool, samples: int) -> np.ndarray:
    """Whether goals of the indices `which` (m,) are reached at angles (m,)."""
    hit = np.zeros(len(which), bool)
    zero = np.zeros_like(angles)
    turned = np.asarray(pose(rpy=np.stack([zero, zero, angles], -1)), float)
    for at in range(0, len(which), AT_ONCE):
        part = slice(at, at + AT_ONCE)
        rolled = (goals[which[part]].astype(float) @ turned[part]).astype(goals.dtype)
        sol = solve_at_samples(arm, jnp.asarray(rolled), samples)
        sol = within_limits(arm, sol) if limits else sol
        hit[part] = np.asarray(sol.valid).any(-1)
    return hit


def _ends(reaches, which: np.ndarray, inside: np.ndarray, outside: np.ndarray, dtype: str) -> np.ndarray:
    """The last roll that reaches on the way from `inside` to `outside`, (m,) each."""
    if not len(which):
        return inside
    for _ in range(HALVINGS[dtype]):
        middle = (inside + outside) / 2
        hit = reaches(which, middle)
        inside, outside = np.where(hit, middle, inside), np.where(hit, outside, middle)
    return inside


def _intervals(first: np.ndarray, last: np.ndarray, everywhere: bool) -> np.ndarray:
    """(k, 2) from the first and the last rolls of the intervals."""
    if everywhere:
        return np.array([[0.0, TURN]])
    first = np.sort(first % TURN)
    ends = np.array([a + min(((b - a) % TURN for b in last), default=0.0) for a in first])
    return np.stack([first, ends], -1).reshape(-1, 2)
