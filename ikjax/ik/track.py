"""`track`: a path of goals, followed on one branch.

One `lax.scan` along the path. At each goal the descent starts from the arm's joints, which keeps it on its
branch. Descents from the branches of the closed form tell whether another branch would now be better.
"""

import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike

from ikjax.arm.arm import Arm
from ikjax.arm.forward import reach
from ikjax.core.tolerances import TRACK_SLACK, VALID
from ikjax.core.xla import as_array, stop_gradient
from ikjax.ik import newton
from ikjax.ik.inline import entries_of, jit_with_arm
from ikjax.ik.multistart import (
    checked_arguments,
    closed_form_starts,
    descend_starts,
    goal_error,
    nearest_goal,
)
from ikjax.ik.results import Trajectory
from ikjax.ik.solve import check_family

STEPS = 24
"""Newton steps at each goal."""

MAX_JOINT_STEP = 0.5
"""[rad, m]"""


def track(
    arm: Arm,
    goals: ArrayLike,
    q0: ArrayLike,
    characteristic_length: ArrayLike = 0.1,
    *,
    steps: int = STEPS,
    max_joint_step: ArrayLike = MAX_JOINT_STEP,
    slack: ArrayLike | None = None,
) -> Trajectory:
    """Follow a path of goals from given joints, on the branch that they are on.

    An arm that can reach a goal reaches it; otherwise it takes the pose of its branch that is nearest in the
    sense of `project`. It leaves its branch where another one is nearer to the goal by more than `slack`, and
    takes the one that moves the joints least. A redundant joint moves no more than the descent from where it
    is moves it; the other branches are those at its present value.

    Args:
        arm: An arm with a family.
        goals: T_world_tool along the path, (..., T, 4, 4), float32 or float64. Where rotations are off by up
            to 1e-2, the nearest ones are the goals.
        q0: (..., n) joint values before the first goal [rad, m]; moved into the limits.
        characteristic_length: Length that counts as much as one radian [m], (); positive.
        steps: Newton steps at each goal.
        max_joint_step: A larger move of a joint in one step of the path counts as a jump [rad, m], ().
        slack: By how much the root of the cost may be larger on the arm's own branch than on the best [m],
            (); a thousandth of the reach by default.

    Returns:
        `Trajectory`, fields (..., T). It has no gradients.

    Raises:
        ValueError: Wrong shapes or types, or an arm of no family.
    """
    check_family(arm)
    goals, arm = checked_arguments(arm, goals, characteristic_length, steps)
    if goals.ndim < 3:
        raise ValueError(f"goals must have shape (..., T, 4, 4), got {goals.shape}")
    start = as_array(q0, goals.dtype)
    batch = goals.shape[:-3]
    if start.ndim not in (1, len(batch) + 1) or start.shape[-1] != arm.n:
        raise ValueError(f"q0 must have shape {(*batch, arm.n)}, got {start.shape}")
    start = jnp.broadcast_to(start, (*batch, arm.n))
    if slack is None:
        slack = TRACK_SLACK * reach(arm)
    numbers = tuple(as_array(x, goals.dtype) for x in (characteristic_length, max_joint_step, slack))
    arm, goals, start, numbers = stop_gradient((arm, goals, start, numbers))
    return _follow(arm, goals, start, *numbers, np.int32(steps))


@functools.partial(jit_with_arm, quick=True)
def _follow(arm: Arm, goals, q0, characteristic_length, max_joint_step, slack, steps) -> Trajectory:
    """`track` of goals (..., T, 4, 4), all arguments arrays."""

    def follow(q, goal):
        result = _follow_one(arm, goal, q, characteristic_length, max_joint_step, slack, steps)
        return result.q, result

    first = newton.into_limits(arm, tuple(q0[..., i] for i in range(arm.n)))
    _, path = jax.lax.scan(follow, jnp.stack(first, axis=-1), jnp.moveaxis(goals, -3, 0))
    axis = goals.ndim - 3
    path = jax.tree.map(lambda x: jnp.moveaxis(x, 0, axis), path)
    return dataclasses.replace(path, goal_error=goal_error(goals))


def _follow_one(
    arm: Arm, goal: jax.Array, q: jax.Array, characteristic_length, max_joint_step, slack, steps
) -> Trajectory:
    """From joints (..., n) to the next goal (..., 4, 4)."""
    pose, proper, policy = nearest_goal(arm, entries_of(goal))
    columns = tuple(q[..., i] for i in range(arm.n))
    starts = closed_form_starts(arm, pose, policy, tuple(columns[i] for i in arm.locked))
    own_start = tuple(x[None] for x in columns)
    inside = newton.into_limits(arm, starts, own_start)
    # The first start is the arm's own joints.
    starts = tuple(jnp.concatenate([x, y]) for x, y in zip(own_start, inside, strict=True))
    ends = descend_starts(arm, pose, proper, starts, characteristic_length, steps, None)
    values = newton.into_limits(arm, ends.q, own_start)
    moves = functools.reduce(jnp.maximum, [abs(x - y) for x, y in zip(values, own_start, strict=True)])
    root_cost = jnp.sqrt(ends.cost)
    near_enough = root_cost <= root_cost.min(0, keepdims=True) + slack
    stays = near_enough[0]
    best = jnp.where(stays, 0, jnp.argmin(jnp.where(near_enough, moves, jnp.inf), axis=0))

    def pick(x):
        return jnp.take_along_axis(x, best[None], axis=0)[0]

    moved = jnp.where(proper[..., None], jnp.stack([pick(x) for x in values], axis=-1), q)
    jumped = proper & (~stays | (pick(moves) > max_joint_step))
    tolerance = VALID[goal.dtype.name]
    size = reach(arm) + jnp.sqrt(sum(x * x for x in pose.position))
    distance, angle = pick(ends.position_error), pick(ends.rotation_error)
    reached = proper & (distance <= tolerance * size) & (angle <= tolerance)
    return Trajectory(moved, proper & ~jumped, jumped, reached, pick(ends.cost), distance, angle)
