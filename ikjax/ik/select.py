"""Choosing among the branches: within the limits, and nearest to the arm's present joints."""

import dataclasses

import jax
import jax.numpy as jnp
from jax.typing import ArrayLike

from ikjax.arm.arm import Arm
from ikjax.ik.results import Solutions
from ikjax.ik.turns import limits_like, nearest_turn, q_now_like


def within_limits(arm: Arm, sol: Solutions, q_now: ArrayLike | None = None) -> Solutions:
    """The same solutions with `q` moved by whole turns into the joint limits.

    Where no number of turns brings a joint inside, or a sliding joint is outside, `q` is left as it was and
    `valid` is cleared. A motor that turns another joint by less than whole turns, or moves a slide, is left
    as it is, because a turn of it gives another pose. A limit counts as inside, to 8 eps. The gradient passes
    through unchanged.

    Args:
        arm: The arm, with limits (n, 2); an infinite limit is never exceeded.
        sol: From `solve(arm, ...)`.
        q_now: The arm's present joints, (..., n) [rad, m]: each turning joint gets the turns within its
            limits that are nearest to it. By default a joint gets as few turns as bring it inside, and none
            if it is inside.

    Returns:
        `Solutions` of the same shape; only `q` and `valid` differ.

    Raises:
        ValueError: A wrong shape.
    """
    near = None if q_now is None else q_now_like(arm, q_now, sol.q)
    moved, inside = nearest_turn(sol.q, *limits_like(arm, sol.q), near)
    return dataclasses.replace(sol, q=jnp.where(inside, moved, sol.q), valid=sol.valid & inside.all(-1))


def nearest(
    arm: Arm, sol: Solutions, q_now: ArrayLike, weights: ArrayLike | None = None
) -> tuple[jax.Array, jax.Array]:
    """The valid branch whose largest joint move is least, with the turns that make it so.

    Each turning joint of each branch gets the whole turns within its limits that are nearest to `q_now`. A
    joint that no turns bring within its limits gets those that are nearest without regard to them;
    `within_limits` tells which branches those are. Moves are compared by their largest entry (the infinity
    norm), because the L2 norm trades a flip of the wrist for small moves elsewhere.

    Args:
        arm: The arm, with limits (n, 2); with infinite ones, any turns are allowed.
        sol: From `solve`, perhaps through `within_limits`.
        q_now: The arm's present joints, (..., n) [rad, m], any number of turns away. Where a turning joint is
            beyond four turns, a warning asks whether these are degrees.
        weights: (n,) non-negative factors on the moves, one by default.

    Returns:
        `q` of the chosen branch with those turns, (..., n), and whether there was a valid one, (...). Without
        one, `q` is that of the first slot. The derivative of `q` by the chosen entries of `sol.q` is one.

    Raises:
        ValueError: A wrong shape.
    """
    near = q_now_like(arm, q_now, sol.q)
    factors = jnp.ones(arm.n, sol.q.dtype) if weights is None else jnp.asarray(weights, sol.q.dtype)
    if factors.shape != (arm.n,):
        raise ValueError(f"weights must have shape ({arm.n},), got {factors.shape}")
    moved, _ = nearest_turn(sol.q, *limits_like(arm, sol.q), near)
    cost = jnp.max(jnp.abs(moved - near) * jnp.broadcast_to(factors, moved.shape), axis=-1)
    cost = jnp.where(sol.valid, cost, jnp.inf)
    best = jnp.argmin(cost, axis=-1)
    q = jnp.take_along_axis(moved, best[..., None, None], axis=-2)[..., 0, :]
    return q, sol.valid.any(-1)
