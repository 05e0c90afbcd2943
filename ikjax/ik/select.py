"""Choosing among the branches: within the limits, and nearest to the arm's present joints."""

import dataclasses
import functools
import operator
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike

from ikjax.arm.arm import Arm
from ikjax.arm.forward import whole_turns
from ikjax.core.xla import as_array, divider
from ikjax.ik.inline import jit_with_arm, joints_of, mask_of, slots_as_array
from ikjax.ik.results import Solutions
from ikjax.ik.turns import checked_q_now, nearest_turn


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
    near = None if q_now is None else checked_q_now(arm, q_now, sol.q)
    origin = sol.origin
    if origin is None:
        q, valid = _within_limits(arm, sol.q, sol.valid, near)
        return dataclasses.replace(sol, q=q, valid=valid)
    slots, valid = _slots_within_limits(arm, origin.slots, sol.valid, near)
    moved, _ = _slots_within_limits(arm, joints_of(sol.q), sol.valid, near)
    narrowed = dataclasses.replace(sol, q=slots_as_array(moved), valid=valid)
    return narrowed.with_origin(origin._replace(slots=slots))


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
    near = checked_q_now(arm, q_now, sol.q)
    factors = np.ones(arm.n, sol.q.dtype) if weights is None else as_array(weights, sol.q.dtype)
    if factors.shape != (arm.n,):
        raise ValueError(f"weights must have shape ({arm.n},), got {factors.shape}")
    origin = sol.origin
    if origin is None:
        return _nearest(arm, sol.q, sol.valid, near, factors)
    q, slot, found = _nearest_slot(arm, origin.slots, sol.valid, near, factors)
    reaches = of_slot(slot, [origin.valid[..., s] for s in range(len(origin.slots))])
    return origin.differentiable(q, reaches), found


@jit_with_arm
def _within_limits(arm: Arm, q: jax.Array, valid: jax.Array, near: jax.Array | None):
    slots, valid = _slots_within_limits(arm, joints_of(q), valid, near)
    return slots_as_array(slots), valid


@jit_with_arm
def _nearest(arm: Arm, q: jax.Array, valid: jax.Array, near: jax.Array, factors: jax.Array):
    q, _, found = _nearest_slot(arm, joints_of(q), valid, near, factors)
    return q, found


# Slot by slot and joint by joint, in scalars: in the trace of `solve`, the choice is then made among the
# numbers of the kernel, and the joints of all slots are never stored as an array.


def _slots_within_limits(arm: Arm, slots: list[list[jax.Array]], valid: jax.Array, near: jax.Array | None):
    """The joints moved into the limits where that is possible, and which slots are within them and valid.

    Args:
        arm: The arm.
        slots: S lists of n numbers (...).
        valid: (..., S).
        near: (..., n) or None.

    Returns:
        Joints as S lists, and the mask (..., S).
    """
    limits, like = _limits(arm), slots[0][0]
    wanted = [None] * arm.n if near is None else _entries(near, like.shape)
    moved, inside = [], []
    for s, slot in enumerate(slots):
        turned = [nearest_turn(x, *limits[i], wanted[i]) for i, x in enumerate(slot)]
        moved.append([jnp.where(within, y, x) for x, (y, within) in zip(slot, turned, strict=True)])
        inside.append(functools.reduce(operator.and_, (within for _, within in turned), valid[..., s]))
    return moved, mask_of(inside, like)


def _nearest_slot(arm: Arm, slots: list[list[jax.Array]], valid: jax.Array, near: jax.Array, factors):
    """The joints of the chosen slot (..., n), with their turns; its number (...), and whether it is valid."""
    limits, like = _limits(arm), slots[0][0]
    pin, wanted = divider(like), _entries(near, like.shape)

    def turned(slot):
        return [nearest_turn(x, *limits[i], wanted[i])[0] for i, x in enumerate(slot)]

    chosen, least, found = jnp.zeros_like(like), None, valid[..., 0]
    for s, slot in enumerate(slots):
        moves = [
            jnp.abs(x - y) * factors[i] for i, (x, y) in enumerate(zip(turned(slot), wanted, strict=True))
        ]
        largest = pin(jnp.where(valid[..., s], functools.reduce(jnp.maximum, moves), jnp.inf))
        if least is None:
            least = largest
            continue
        chosen = jnp.where(largest < least, s, chosen)
        least = jnp.minimum(least, largest)
        found |= valid[..., s]
    chosen = pin(chosen)
    joints = [of_slot(chosen, list(numbers)) for numbers in zip(*slots, strict=True)]
    return jnp.stack([pin(x) for x in turned(joints)], axis=-1), chosen, found


def of_slot(slot: jax.Array, values: list) -> jax.Array:
    """Of values of all slots, (...) each, that of the slot with this number at each place."""
    chosen = values[0]
    for number, value in enumerate(values[1:], 1):
        chosen = jnp.where(slot == number, value, chosen)
    return jnp.broadcast_to(chosen, slot.shape)


def _entries(rows: jax.Array, shape: tuple[int, ...]) -> list[jax.Array]:
    """The numbers of rows (..., n), each an array of a shape to which (...) broadcasts."""
    return [jnp.broadcast_to(rows[..., i], shape) for i in range(rows.shape[-1])]


def _limits(arm: Arm) -> list[tuple[Any, Any, Any]]:
    """Lower and upper limit of each joint, and whether a whole turn of it leaves the pose."""
    limits = arm.limits
    return [(limits[i, 0], limits[i, 1], whole) for i, whole in enumerate(whole_turns(arm))]
