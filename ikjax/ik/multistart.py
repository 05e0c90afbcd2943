"""Where a descent starts beside the branches of the closed form.

Limits, and joints too few, make basins that no branch leads to.
"""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np

from ikjax.arm.arm import Arm
from ikjax.arm.forward import whole_turns
from ikjax.core.known import is_traced, stop_gradient
from ikjax.core.trig import Scalar
from ikjax.ik import batched
from ikjax.ik.inline import Entries, entries_of
from ikjax.ik.newton import bounds
from ikjax.ik.refine import asked
from ikjax.ik.turns import TURN
from ikjax.solvers.pipeline import proposed, proposed_at_ends, reach


def at_limits(arm: Arm, goals: jax.Array) -> jax.Array:
    """Starts with a joint at a limit by the closed form, (..., S, n), for an arm whose family has them.

    Each joint that the family may hold, at each of its limits, with every branch of the rest; and of these
    and of the branches the same with the last joint at that limit which is further off: on both sides of the
    gap in its range there is a basin.
    """
    if not is_traced((arm, goals)):
        found = batched.in_blocks(_AtLimits(), arm, goals.reshape(-1, 4, 4))
        return found.reshape(*goals.shape[:-2], *found.shape[1:])
    arm, goals = stop_gradient((arm, goals))
    rows = _at_limits(arm.baked(), entries_of(goals))
    return jnp.stack([jnp.stack(row, axis=-1) for row in rows], axis=-2)


@dataclasses.dataclass(frozen=True)
class _AtLimits:
    """A block of goals."""

    def __call__(self, arm: Arm, goals: jax.Array) -> jax.Array:
        columns = batched.columns_of(goals)
        rows = _at_limits(arm, tuple(tuple(columns[4 * i + j] for j in range(4)) for i in range(4)))
        return batched.packed([x for row in rows for x in row]).reshape(-1, len(rows), arm.n)


def _at_limits(arm: Arm, entries: Entries) -> list[tuple[jax.Array, ...]]:
    goal, _, near = asked(arm, entries)
    shape = goal.position[0].shape
    ends = proposed_at_ends(arm, goal, near)
    low, high = bounds(arm)[-1]
    rows = [*ends, *((*q[:-1], _further(q[-1], low, high)) for q in [*proposed(arm, goal, near), *ends])]
    return [tuple(near(jnp.broadcast_to(x, shape)) for x in q) for q in rows]


def _further(x: Scalar, low: Scalar, high: Scalar) -> Scalar:
    """The limit further off round the circle; without limits the opposite angle."""
    low, high = (jnp.asarray(limit, x.dtype) for limit in (low, high))
    limited = jnp.isfinite(low) & jnp.isfinite(high)
    middle = jnp.where(limited, low / 2 + high / 2, 0)
    away = x - middle - TURN * jnp.round((x - middle) * (1 / TURN))
    opposite = jnp.where(x > 0, x - TURN / 2, x + TURN / 2)
    return jnp.where(limited, jnp.where(away < 0, high, low), opposite)


def ranges(arm: Arm) -> tuple[jax.Array, jax.Array]:
    """Lower and upper end (n,) of the values from which joints are drawn, within the limits.

    All that lies between two limits, but for what turns round: there a whole turn in the middle. From one
    limit alone a whole turn on, or two reaches; without any as much about zero.
    """
    low, high = (jnp.asarray(arm.limits)[:, k] for k in (0, 1))
    size = jnp.asarray(reach(arm), arm.dtype)
    size = jnp.where(size > 0, size, 1)  # of slides alone, whose table has no lengths
    half = jnp.stack([jnp.asarray(np.pi, arm.dtype) if kind == "R" else size for kind in arm.kinds])
    below, above = jnp.isfinite(low), jnp.isfinite(high)
    middle = jnp.where(below, low + half, jnp.where(above, high - half, 0))
    middle = jnp.where(below & above, low / 2 + high / 2, middle)
    whole = jnp.stack([jnp.asarray(turns) for turns in whole_turns(arm)])
    half = jnp.where(below & above & ~whole, jnp.inf, half)
    return jnp.maximum(low, middle - half), jnp.minimum(high, middle + half)


def scattered(arm: Arm, batch: tuple[int, ...], count: int):
    """Joints spread evenly over the limits, the same for every goal, (..., S, n).

    Source: the additive recurrence R_d of Roberts, The unreasonable effectiveness of quasirandom
    sequences (2018).
    """
    root = 1.5
    for _ in range(64):
        root = (1 + root) ** (1 / (arm.n + 1))
    shares = np.outer(np.arange(1, count + 1), root ** -np.arange(1.0, arm.n + 1)) % 1
    low, high = (end[None] for end in ranges(arm))
    starts = low + (high - low) * jnp.asarray(shares, arm.dtype)
    return jnp.broadcast_to(starts, (*batch, *starts.shape))
