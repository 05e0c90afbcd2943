"""Whole turns of joints: which of them the limits allow, and which is nearest to a given joint value.

A turning joint gives the same pose at x + 2 pi k for every whole k. Everything here is elementwise, and the
derivative of a joint value by itself is one.
"""

import dataclasses
import math

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike

from ikjax.arm.arm import Arm
from ikjax.arm.forward import whole_turns
from ikjax.core.trig import Scalar, with_turns
from ikjax.core.warn import MOST_TURNS, warn_of_degrees
from ikjax.core.xla import as_array
from ikjax.ik.results import Solutions

TURN = 2 * math.pi
"""[rad]"""

UNLIMITED = 3
"""Values of a joint with an infinite limit, unless the caller says how many."""


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True, eq=False)
class Turns:
    """Every joint value of every branch that whole turns bring within the limits."""

    q: jax.Array
    """(..., S, n, K) values of each joint [rad, m], increasing along K where `within`; always finite."""
    within: jax.Array
    """(..., S, n, K) bool: the branch is valid and the value within the limits."""


def turns(arm: Arm, sol: Solutions, q_now: ArrayLike | None = None, *, most: int | None = None) -> Turns:
    """All values of each joint that give the same pose, within the limits.

    The joints turn independently of each other: any value of one goes with any of the others. So a branch
    stands for `within.sum(-1).prod(-1)` configurations. A KUKA KR16 (axes 4 and 6 within 350 degrees either
    way, the others within less than a turn) has K = 2 and up to 4 configurations a branch; a Universal Robot
    (six axes within 360 degrees either way) has K = 3, mostly two values a joint, the third only where a
    joint can stand at both of its limits, and so 64 configurations a branch. Those of branch s are

        itertools.product(*(q[within] for q, within in zip(t.q[s], t.within[s])))

    Args:
        arm: The arm, with limits (n, 2).
        sol: From `solve`.
        q_now: The arm's present joints, (..., n) [rad, m]: if there are more than K values, the K around
            these are returned; by default those around the values of `sol`.
        most: K, positive. By default as many as the widest range holds; 3 if a limit of a turning joint is
            infinite.

    Returns:
        `Turns`. A slide, or a motor whose whole turn gives another pose, has its one value. The derivative of
        each value by that of `sol` is one.

    Raises:
        ValueError: A wrong `most` or shape, or traced limits without `most`.
    """
    count = _most(arm) if most is None else most
    if not isinstance(count, int | np.integer) or count < 1:
        raise ValueError(f"most must be a whole number, 1 or more, got {most}")
    x = sol.q
    low, high, whole = limits_like(arm, x)
    first, last = _allowed(x, low, high)
    middle = jnp.clip(_wanted(x, None if q_now is None else q_now_like(arm, q_now, x)), first, last)
    start = jnp.clip(middle - (count - 1) // 2, first, jnp.maximum(first, last - count + 1))
    counts = [start + i for i in range(count)]
    values = [jnp.where(whole, with_turns(x, k), x) for k in counts]
    inside = _inside(x, low, high)
    flags = [jnp.where(whole, (first <= k) & (k <= last), inside & (i == 0)) for i, k in enumerate(counts)]
    return Turns(jnp.stack(values, -1), jnp.stack(flags, -1) & sol.valid[..., None, None])


def _most(arm: Arm) -> int:
    """The largest number of values that the limits allow a joint."""
    if isinstance(arm.limits, jax.core.Tracer):
        raise ValueError("turns: say most=, because the limits are traced and do not tell how many there are")
    low, high = np.asarray(arm.limits, float).T
    widths = (high - low)[[whole is not False for whole in whole_turns(arm)]]
    # A range of exactly two turns holds three values. One value too many, by rounding, is masked.
    return max([1, *(int(w / TURN + 1e-5) + 1 if math.isfinite(w) else UNLIMITED for w in widths)])


def limits_like(arm: Arm, q: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Lower and upper limits, and whether a whole turn leaves the pose, each of the shape of q (..., n)."""
    arm = arm.baked()
    limits = jnp.asarray(arm.limits, q.dtype)
    whole = jnp.stack([jnp.asarray(x, bool) for x in whole_turns(arm)])
    low, high, whole = (jnp.broadcast_to(x, q.shape) for x in (limits[:, 0], limits[:, 1], whole))
    return low, high, whole


def checked_q_now(arm: Arm, q_now: ArrayLike, q: jax.Array) -> jax.Array:
    """The arm's present joints, in the type of q (..., S, n), of a shape that broadcasts to (..., n).

    Raises:
        ValueError: A wrong shape.
    """
    present = as_array(q_now, q.dtype)
    wanted = (*q.shape[:-2], arm.n)
    # Not `np.broadcast_shapes`: a q_now of more axes than the solutions would broadcast with them too.
    fits = present.ndim <= len(wanted) and present.shape[-1:] == wanted[-1:]
    pairs = zip(present.shape[::-1], wanted[::-1], strict=False)
    if not fits or not all(size in (1, needed) for size, needed in pairs):
        raise ValueError(f"q_now must have shape (..., {arm.n}), got {present.shape}")
    warn_of_degrees("q_now", present, MOST_TURNS, arm.kinds)
    return present


def q_now_like(arm: Arm, q_now: ArrayLike, q: jax.Array) -> jax.Array:
    """The arm's present joints, repeated for the slots of q (..., S, n); raises as `checked_q_now`."""
    present = jnp.broadcast_to(checked_q_now(arm, q_now, q), (*q.shape[:-2], arm.n))
    return jnp.broadcast_to(present[..., None, :], q.shape)


def nearest_turn(x: jax.Array, low: Scalar, high: Scalar, whole, near=None) -> tuple[jax.Array, jax.Array]:
    """Joint values moved by whole turns into the limits, as near to given values as possible.

    All arguments broadcast to the shape of x.

    Args:
        x: Joint values [rad, m].
        low, high: Their limits.
        whole: Whether a whole turn leaves the pose; where not, x stays.
        near: The values to be near to; by default x itself, which gives as few turns as suffice.

    Returns:
        The values, and whether they are within the limits. Where no number of turns brings a joint inside,
        it gets the value nearest to `near` without regard to the limits.
    """
    low, high = (jnp.asarray(limit, x.dtype) for limit in (low, high))
    first, last = _allowed(x, low, high)
    wanted = _wanted(x, near)
    count = jnp.where(first <= last, jnp.clip(wanted, first, last), wanted)
    moved = jnp.where(whole, with_turns(x, count), x)
    return moved, jnp.where(whole, first <= last, _inside(x, low, high))


def _allowed(x: jax.Array, low: jax.Array, high: jax.Array) -> tuple[jax.Array, jax.Array]:
    """The least and the greatest number of turns within the limits; least > greatest where there is none."""
    x = jax.lax.stop_gradient(x)
    return jnp.ceil((low - _slack(x, low) - x) / TURN), jnp.floor((high + _slack(x, high) - x) / TURN)


def _wanted(x: jax.Array, near) -> jax.Array:
    """The number of turns that brings x nearest to `near`; zero where that is None or not finite."""
    if near is None:
        return jnp.zeros_like(x)
    wanted = jnp.round(jax.lax.stop_gradient(near - x) / TURN)
    return jnp.where(jnp.isfinite(wanted), wanted, 0)


def _inside(x: jax.Array, low: jax.Array, high: jax.Array) -> jax.Array:
    """Whether x is within the limits, to rounding."""
    return (x >= low - _slack(x, low)) & (x <= high + _slack(x, high))


def _slack(x: jax.Array, limit: jax.Array) -> jax.Array:
    """Tolerance of a limit: 8 eps of the larger of the two numbers, or of 1."""
    size = jnp.maximum(jnp.abs(x), jnp.where(jnp.isfinite(limit), jnp.abs(limit), 0))
    return 8 * float(jnp.finfo(x.dtype).eps) * jnp.maximum(1, size)
