"""`track`: a path of goals, followed on one branch.

Storey: ik. One `lax.scan` along the path. At each goal the arm goes downhill from where it is, which keeps
it on its branch; the closed form's branches say whether another one would now do better.
"""

import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np

from ikjax.arm.arm import Arm
from ikjax.arm.forward import whole_turns
from ikjax.ik import descent
from ikjax.ik.graph import entries_of
from ikjax.ik.refine import asked, checked, from_starts, proposals
from ikjax.ik.solve import check_family
from ikjax.solvers.family import TOLERANCE, reach

STEPS = 24

LEAP = 0.5
"""[rad]"""

SLACK = 1e-3
"""As a share of the reach."""


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True, eq=False)
class Path:
    """Where the arm stands along a path of T goals."""

    q: jax.Array
    """(..., T, n) joint values [rad, m], within the limits, turns counted on from q0."""
    followed: jax.Array
    """(..., T) bool: on the branch it was on, without a leap. Where neither followed nor jumped, the goal
    is no pose, and the arm waits."""
    jumped: jax.Array
    """(..., T) bool: another branch was taken, or a joint moved by more than `leap`."""
    reached: jax.Array
    """(..., T) bool: the goal itself is attained, to the tolerance of `solve`."""
    cost: jax.Array
    """(..., T) |dp|^2 + (length * angle)^2 [m^2]."""
    position_error: jax.Array
    """(..., T) [m]"""
    rotation_error: jax.Array
    """(..., T) [rad]"""


def track(
    arm: Arm,
    goals,
    q0,
    length: float = 0.1,
    *,
    steps: int = STEPS,
    leap: float = LEAP,
    slack: float | None = None,
) -> Path:
    """Follow a path of goals from given joints, on the branch that they are on.

    An arm that can reach a goal reaches it; else it takes the nearest pose of its branch, as `project` means
    it. It leaves its branch where another is nearer to the goal by more than `slack`, and then for the one
    that moves the joints least.

    Args:
        arm: An arm with a family.
        goals: T_world_tool along the path, (..., T, 4, 4), float32 or float64.
        q0: (..., n) joint values before the first goal; moved into the limits.
        length: What a radian is worth [m]; positive.
        steps: Newton steps at each goal.
        leap: A joint that moves further in one step of the path counts as a jump [rad, m].
        slack: By how much the root of the cost may be larger on the arm's own branch than on the best [m];
            a thousandth of the reach by default.

    Returns:
        `Path`. It has no slopes.

    Raises:
        ValueError: Wrong shapes or types, or an arm of no family.
    """
    check_family(arm)
    goals, arm = checked(arm, goals, length, steps)
    if goals.ndim < 3:
        raise ValueError(f"goals must have shape (..., T, 4, 4), got {goals.shape}")
    q0 = jnp.asarray(q0, goals.dtype)
    batch = goals.shape[:-3]
    if q0.ndim not in (1, len(batch) + 1) or q0.shape[-1] != arm.n:
        raise ValueError(f"q0 must have shape {(*batch, arm.n)}, got {q0.shape}")
    q0 = jnp.broadcast_to(q0, (*batch, arm.n))
    if slack is None:
        slack = SLACK * reach(arm)
    numbers = jnp.stack([jnp.asarray(x, goals.dtype) for x in (length, leap, slack)])
    arm, goals, q0, numbers = jax.lax.stop_gradient((arm, goals, q0, numbers))
    if any(isinstance(x, jax.core.Tracer) for x in jax.tree.leaves((arm, goals, q0))):
        return _tracked(arm, goals, q0, numbers, steps)
    known, rest = dataclasses.replace(arm, name="").split()
    return _compiled(known, [jnp.asarray(x) for x in rest], goals, q0, numbers, steps)


@functools.partial(jax.jit, static_argnums=(0, 5))
def _compiled(known, rest, goals, q0, numbers, steps: int) -> Path:
    return _tracked(Arm.join(known, rest), goals, q0, numbers, steps)


def _tracked(arm: Arm, goals, q0, numbers, steps: int) -> Path:
    length, leap, slack = numbers

    def onward(q, goal):
        at = _next(arm, goal, q, length, leap, slack, steps)
        return at.q, at

    first = descent.into_limits(arm, tuple(q0[..., i] for i in range(arm.n)))
    _, path = jax.lax.scan(onward, jnp.stack(first, axis=-1), jnp.moveaxis(goals, -3, 0))
    axis = goals.ndim - 3
    return jax.tree.map(lambda x: jnp.moveaxis(x, 0, axis), path)


def _next(arm: Arm, goal, q, length, leap, slack, steps: int) -> Path:
    """From joints (..., n) to the next goal (..., 4, 4)."""
    pose, proper, near = asked(arm, entries_of(goal))
    now = tuple(q[..., i] for i in range(arm.n))
    starts = proposals(arm, pose, near)
    starts = tuple(jnp.concatenate([x[None], y]) for x, y in zip(now, starts, strict=True))
    found = from_starts(arm, pose, proper, starts, length, steps, None)
    values = tuple(
        jnp.where(whole, _turned_near(x, here[None], low, high), x)
        for x, here, whole, (low, high) in zip(
            found.q, now, whole_turns(arm), descent.bounds(arm), strict=True
        )
    )
    moves = functools.reduce(jnp.maximum, [abs(x - here[None]) for x, here in zip(values, now, strict=True)])
    far = jnp.sqrt(found.cost)
    near_enough = far <= far.min(0, keepdims=True) + slack
    stays = near_enough[0]
    best = jnp.where(stays, 0, jnp.argmin(jnp.where(near_enough, moves, jnp.inf), axis=0))

    def pick(x):
        return jnp.take_along_axis(x, best[None], axis=0)[0]

    moved = jnp.where(proper[..., None], jnp.stack([pick(x) for x in values], axis=-1), q)
    jumped = proper & (~stays | (pick(moves) > leap))
    tolerance = TOLERANCE[goal.dtype.name]
    size = reach(arm) + jnp.sqrt(sum(x * x for x in pose.position))
    gap, angle = pick(found.position_error), pick(found.rotation_error)
    reached = proper & (gap <= tolerance * size) & (angle <= tolerance)
    return Path(moved, proper & ~jumped, jumped, reached, pick(found.cost), gap, angle)


def _turned_near(x, here, low, high):
    """The same angle with the turns that bring it nearest to where the joint is, if the limits allow them."""
    other = x + descent.TURN * jnp.round((here - x) / np.asarray(descent.TURN, x.dtype))
    return jnp.where((other >= low) & (other <= high), other, x)
