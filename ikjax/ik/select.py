"""Choosing among the branches: within limits, and nearest to where the arm is."""

import dataclasses

import jax
import jax.numpy as jnp

from ikjax.arm.arm import Arm
from ikjax.ik.results import Solutions
from ikjax.ik.turns import limits_like, nearest_turn, place_like


def within_limits(arm: Arm, sol: Solutions, q_now=None) -> Solutions:
    """The same solutions with `q` moved by whole turns into the joint limits.

    Where no number of turns brings a joint inside, or a sliding joint is outside, `q` is left as it was and
    `valid` is cleared. A motor that turns another joint by less than whole turns, or slides one, is left
    where it is, because a turn of it is another pose. A limit counts as inside, to 8 eps. The gradient passes
    through unchanged.

    Args:
        arm: The arm, with limits (n, 2); infinite ones are always kept.
        sol: From `solve(arm, ...)`.
        q_now: (..., n) where the arm is [rad, m]: each turning joint gets the turns within its limits that
            are nearest to it. By default a joint gets as few turns as bring it inside, none where it is.

    Raises:
        ValueError: A wrong shape.
    """
    near = None if q_now is None else place_like(arm, q_now, sol.q)
    moved, inside = nearest_turn(sol.q, *limits_like(arm, sol.q), near)
    return dataclasses.replace(sol, q=jnp.where(inside, moved, sol.q), valid=sol.valid & inside.all(-1))


def nearest(arm: Arm, sol: Solutions, q_now, weights=None) -> tuple[jax.Array, jax.Array]:
    """The valid branch whose largest joint move is least, with the turns that make it so.

    Each turning joint of each branch is taken with the whole turns within its limits that are nearest to
    where the arm is; a joint that no turns bring within its limits, with those that are nearest without
    them: `within_limits` says which branches those are. The largest move counts, and not the length of the
    vector of moves, because the L2 norm trades a flip of the wrist for small moves elsewhere.

    Args:
        arm: The arm, with limits (n, 2); with infinite ones, all turns will do.
        sol: From `solve`, perhaps through `within_limits`.
        q_now: Where the arm is, (..., n) [rad, m]; any number of turns away. Where a turning joint is beyond
            four turns, a warning asks whether these are degrees.
        weights: (n,) non-negative factors on the moves, one by default.

    Returns:
        `q` of the chosen branch with those turns, (..., n), and whether there was a valid one, (...). Without
        one, `q` is that of the first slot. The derivative of `q` in that of `sol` is one.

    Raises:
        ValueError: A wrong shape.
    """
    near = place_like(arm, q_now, sol.q)
    weights = jnp.ones(arm.n, sol.q.dtype) if weights is None else jnp.asarray(weights, sol.q.dtype)
    if weights.shape != (arm.n,):
        raise ValueError(f"weights must have shape ({arm.n},), got {weights.shape}")
    moved, _ = nearest_turn(sol.q, *limits_like(arm, sol.q), near)
    cost = jnp.max(jnp.abs(moved - near) * jnp.broadcast_to(weights, moved.shape), axis=-1)
    cost = jnp.where(sol.valid, cost, jnp.inf)
    best = jnp.argmin(cost, axis=-1)
    q = jnp.take_along_axis(moved, best[..., None, None], axis=-2)[..., 0, :]
    return q, sol.valid.any(-1)
