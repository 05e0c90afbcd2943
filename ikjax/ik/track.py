"""`track`: a path of goals, followed on one branch.

One `lax.scan` along the path. At each goal the arm goes downhill from where it is, which keeps
it on its branch; the closed form's branches say whether another one would now do better.
"""

import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np

from ikjax.arm.arm import Arm
from ikjax.arm.forward import reach
from ikjax.core.known import as_array, stop_gradient
from ikjax.core.tolerances import TRACK_SLACK, VALID
from ikjax.ik import newton
from ikjax.ik.inline import entries_of, jit_with_arm
from ikjax.ik.multistart import asked, checked, from_starts, goal_error, proposals
from ikjax.ik.results import Trajectory
from ikjax.ik.solve import check_family

STEPS = 24

MAX_JOINT_STEP = 0.5
"""[rad]"""


def track(
    arm: Arm,
    goals,
    q0,
    characteristic_length: float = 0.1,
    *,
    steps: int = STEPS,
    max_joint_step: float = MAX_JOINT_STEP,
    slack: float | None = None,
) -> Trajectory:
    """Follow a path of goals from given joints, on the branch that they are on.

    An arm that can reach a goal reaches it; else it takes the nearest pose of its branch, as `project` means
    it. It leaves its branch where another is nearer to the goal by more than `slack`, and then for the one
    that moves the joints least.

    Args:
        arm: An arm with a family.
        goals: T_world_tool along the path, (..., T, 4, 4), float32 or float64. Of rotations that are off by
            up to 1e-2, the nearest ones are the goals.
        q0: (..., n) joint values before the first goal; moved into the limits.
        characteristic_length: What a radian is worth [m]; positive.
        steps: Newton steps at each goal.
        max_joint_step: A joint that moves further in one step of the path counts as a jump [rad, m].
        slack: By how much the root of the cost may be larger on the arm's own branch than on the best [m];
            a thousandth of the reach by default.

    Returns:
        `Trajectory`. It has no slopes.

    Raises:
        ValueError: Wrong shapes or types, or an arm of no family.
    """
    check_family(arm)
    goals, arm = checked(arm, goals, characteristic_length, steps)
    if goals.ndim < 3:
        raise ValueError(f"goals must have shape (..., T, 4, 4), got {goals.shape}")
    q0 = as_array(q0, goals.dtype)
    batch = goals.shape[:-3]
    if q0.ndim not in (1, len(batch) + 1) or q0.shape[-1] != arm.n:
        raise ValueError(f"q0 must have shape {(*batch, arm.n)}, got {q0.shape}")
    q0 = jnp.broadcast_to(q0, (*batch, arm.n))
    if slack is None:
        slack = TRACK_SLACK * reach(arm)
    numbers = tuple(as_array(x, goals.dtype) for x in (characteristic_length, max_joint_step, slack))
    arm, goals, q0, numbers = stop_gradient((arm, goals, q0, numbers))
    return _tracked(arm, goals, q0, *numbers, np.int32(steps))


@jit_with_arm
def _tracked(arm: Arm, goals, q0, characteristic_length, max_joint_step, slack, steps) -> Trajectory:

    def onward(q, goal):
        at = _next(arm, goal, q, characteristic_length, max_joint_step, slack, steps)
        return at.q, at

    first = newton.into_limits(arm, tuple(q0[..., i] for i in range(arm.n)))
    _, path = jax.lax.scan(onward, jnp.stack(first, axis=-1), jnp.moveaxis(goals, -3, 0))
    axis = goals.ndim - 3
    path = jax.tree.map(lambda x: jnp.moveaxis(x, 0, axis), path)
    return dataclasses.replace(path, goal_error=goal_error(goals))


def _next(arm: Arm, goal, q, characteristic_length, max_joint_step, slack, steps: int) -> Trajectory:
    """From joints (..., n) to the next goal (..., 4, 4)."""
    pose, proper, policy = asked(arm, entries_of(goal))
    now = tuple(q[..., i] for i in range(arm.n))
    starts = proposals(arm, pose, policy)
    here = tuple(x[None] for x in now)
    starts = newton.into_limits(arm, starts, here)
    starts = tuple(jnp.concatenate([x, y]) for x, y in zip(here, starts, strict=True))
    found = from_starts(arm, pose, proper, starts, characteristic_length, steps, None)
    values = newton.into_limits(arm, found.q, here)
    moves = functools.reduce(jnp.maximum, [abs(x - y) for x, y in zip(values, here, strict=True)])
    far = jnp.sqrt(found.cost)
    near_enough = far <= far.min(0, keepdims=True) + slack
    stays = near_enough[0]
    best = jnp.where(stays, 0, jnp.argmin(jnp.where(near_enough, moves, jnp.inf), axis=0))

    def pick(x):
        return jnp.take_along_axis(x, best[None], axis=0)[0]

    moved = jnp.where(proper[..., None], jnp.stack([pick(x) for x in values], axis=-1), q)
    jumped = proper & (~stays | (pick(moves) > max_joint_step))
    tolerance = VALID[goal.dtype.name]
    size = reach(arm) + jnp.sqrt(sum(x * x for x in pose.position))
    gap, angle = pick(found.position_error), pick(found.rotation_error)
    reached = proper & (gap <= tolerance * size) & (angle <= tolerance)
    return Trajectory(moved, proper & ~jumped, jumped, reached, pick(found.cost), gap, angle)
