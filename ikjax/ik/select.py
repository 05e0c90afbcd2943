"""Choosing among the branches: within limits, and nearest to where the arm is.

Storey: ik.
"""

import dataclasses
import math

import jax
import jax.numpy as jnp

from ikjax.arm.arm import Arm
from ikjax.arm.forward import whole_turns
from ikjax.core.trig import wrap
from ikjax.core.warn import MOST_TURNS, warn_of_degrees
from ikjax.ik.solutions import Solutions

TURN = 2 * math.pi


def within_limits(arm: Arm, sol: Solutions) -> Solutions:
    """The same solutions with `q` moved by whole turns into the joint limits.

    A turning joint outside its limits is moved by as few whole turns as bring it inside. Where no
    number of turns does, or a sliding joint is outside, `q` is left as it was and `valid` is
    cleared. A motor that turns another joint by less than whole turns, or slides one, is left where it
    is, because a turn of it is another pose. A limit counts as inside, to 8 eps. The gradient passes
    through unchanged.

    Args:
        arm: The arm, with limits (n, 2); infinite ones are always kept.
        sol: From `solve(arm, ...)`.
    """
    limits = jnp.asarray(arm.limits, sol.q.dtype)
    lower, upper = (jnp.broadcast_to(limits[:, k], sol.q.shape) for k in (0, 1))
    slack = 8 * jnp.finfo(sol.q.dtype).eps * jnp.maximum(1, jnp.abs(sol.q))
    turns_up = jnp.ceil((lower - slack - sol.q) / TURN)
    turns_down = jnp.floor((upper + slack - sol.q) / TURN)
    turns = jnp.where(sol.q < lower - slack, turns_up, jnp.where(sol.q > upper + slack, turns_down, 0))
    turning = jnp.asarray(whole_turns(arm)).reshape((1,) * (sol.q.ndim - 1) + (-1,))
    shift = jnp.where(turning & jnp.isfinite(turns), turns * TURN, 0)
    moved = sol.q + jax.lax.stop_gradient(shift)
    inside = (moved >= lower - slack) & (moved <= upper + slack)
    return dataclasses.replace(sol, q=jnp.where(inside, moved, sol.q), valid=sol.valid & inside.all(-1))


def nearest(arm: Arm, sol: Solutions, q_now, weights=None) -> tuple[jax.Array, jax.Array]:
    """The valid branch whose largest joint move is least.

    The largest move, and not the length of the vector of moves, because the L2 norm trades a flip of
    the wrist for small moves elsewhere. Turning joints are compared across the seam at pi.

    Args:
        arm: The arm.
        sol: From `solve`, perhaps through `within_limits`.
        q_now: Where the arm is, (..., n); any number of turns away. Where a turning joint is beyond
            four turns, a warning asks whether these are degrees.
        weights: (n,) non-negative factors on the moves, one by default.

    Returns:
        `q` of the chosen branch as it stands in `sol`, (..., n), and whether there was a valid one,
        (...). Without one, `q` is that of the first slot.

    Raises:
        ValueError: A wrong shape.
    """
    q_now = jnp.asarray(q_now, sol.q.dtype)
    if q_now.ndim == 0 or q_now.shape[-1] != arm.n:
        raise ValueError(f"q_now must have shape (..., {arm.n}), got {q_now.shape}")
    warn_of_degrees("q_now", q_now, MOST_TURNS, arm.kinds)
    weights = jnp.ones(arm.n, sol.q.dtype) if weights is None else jnp.asarray(weights, sol.q.dtype)
    if weights.shape != (arm.n,):
        raise ValueError(f"weights must have shape ({arm.n},), got {weights.shape}")
    move = sol.q - jnp.broadcast_to(q_now, (*sol.q.shape[:-2], arm.n))[..., None, :]
    turning = jnp.asarray(whole_turns(arm))
    shape = (1,) * (move.ndim - 1) + (arm.n,)
    move = jnp.where(turning.reshape(shape), wrap(move), move)
    cost = jnp.max(jnp.abs(move) * weights.reshape(shape), axis=-1)
    cost = jnp.where(sol.valid, cost, jnp.inf)
    best = jnp.argmin(cost, axis=-1)
    q = jnp.take_along_axis(sol.q, best[..., None, None], axis=-2)[..., 0, :]
    return q, sol.valid.any(-1)
