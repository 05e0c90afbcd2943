"""The range of the redundant joints, and values spread over it."""

import dataclasses
import itertools
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ikjax.arm.arm import Arm
from ikjax.arm.forward import reach
from ikjax.core import pose as poses
from ikjax.core.xla import is_traced
from ikjax.ik.results import Solutions
from ikjax.ik.solve import solve

Judge = Callable[[Solutions], Solutions]
"""What is done with the solutions of each trial, such as `within_limits`: before they are joined, because
its program grows with the number of slots."""

Array = Any
"""Of numpy where the arm's limits are known: they stay known in a jit."""


def redundant_range(arm: Arm, joint: int, dtype) -> tuple[Array, Array]:
    """The least and the greatest value of a redundant joint [rad, m]: its limits.

    Of a turning joint with a range of more than a turn, or without limits, a turn in its middle; of a slide
    without a limit, two reaches.

    Args:
        arm: The arm, baked.
        joint: One of `Arm.locked`.
        dtype: Of the values.
    """
    size = np.pi if arm.kinds[joint] == "R" else reach(arm)
    xp: Any = jnp if is_traced((arm.limits, size)) else np
    low, high = xp.asarray(arm.limits, dtype)[joint]
    half = xp.asarray(size, dtype)
    below, above = xp.isfinite(low), xp.isfinite(high)
    one_sided = xp.where(below, low + half, xp.where(above, high - half, 0))
    with np.errstate(invalid="ignore"):  # of infinite limits
        middle = xp.where(below & above, low / 2 + high / 2, one_sided)
    width = half if arm.kinds[joint] == "R" else xp.where(below & above, xp.inf, half)
    ends = xp.maximum(low, middle - width), xp.minimum(high, middle + width)
    return tuple(xp.asarray(end, dtype) for end in ends)


def with_ends(arm: Arm, samples: int, dtype) -> Array:
    """Values of the one redundant joint, (samples,), evenly from the least to the greatest."""
    low, high = redundant_range(arm, arm.locked[0], dtype)
    return low + (high - low) * np.linspace(0, 1, samples).astype(dtype)


def middles(arm: Arm, samples: int, dtype) -> Array:
    """Values of all redundant joints, (samples^k, k): the middles of so many equal parts of each range.

    Each stands for its part, so no value is tried twice where a range is a whole turn.

    Args:
        arm: The arm, baked.
        samples: Values of each joint.
        dtype: Of the values.
    """
    share = ((np.arange(samples) + 0.5) / samples).astype(dtype)
    columns = []
    for joint in arm.locked:
        low, high = redundant_range(arm, joint, dtype)
        columns.append(low + (high - low) * share)
    places = np.array(list(itertools.product(range(samples), repeat=len(columns))), int)
    rows = places.reshape(-1, len(columns)).T
    xp: Any = jnp if is_traced(columns) else np
    return xp.stack([column[row] for column, row in zip(columns, rows, strict=True)], axis=-1)


def checked_samples(arm: Arm, samples: int | None, default: int) -> int:
    """How many values of each redundant joint are tried; 1 of an arm without.

    Raises:
        ValueError: No whole number above zero, or a number for an arm that has no redundant joint.
    """
    if not arm.locked:
        if samples is not None:
            raise ValueError(f"redundancy_samples is for arms with redundant joints, {arm.name} has none")
        return 1
    samples = default if samples is None else samples
    if isinstance(samples, bool) or not isinstance(samples, int) or samples < 1:
        raise ValueError(f"redundancy_samples must be a whole number above zero, got {samples!r}")
    return samples


def solve_alternatives(
    arm: Arm,
    goals: jax.Array,
    alternatives: jax.Array | np.ndarray | None,
    samples: int,
    judge: Judge | None = None,
) -> Solutions:
    """`solve_at_samples` of goals of which each may be met in several ways.

    Args:
        arm: The arm.
        goals: (..., 4, 4).
        alternatives: (m, 4, 4) what the tool may be turned by in its own frame; None for the goal alone.
        samples: Values of each redundant joint.
        judge: Of the solutions at each value, before they are joined.

    Returns:
        `Solutions` (...) with m times as many slots: those of the first alternative come first.
    """
    if alternatives is None:
        return solve_at_samples(arm, goals, samples, judge)
    return joined_alternatives(solve_at_samples(arm, turned_goals(goals, alternatives), samples, judge))


def turned_goals(goals: jax.Array, alternatives: jax.Array | np.ndarray) -> jax.Array:
    """Goals (..., m, 4, 4): each of (..., 4, 4) turned by each of the alternatives (m, 4, 4) in its frame."""
    return pose_product(goals[..., None, :, :], jnp.asarray(alternatives, goals.dtype))


def joined_alternatives(sol: Solutions) -> Solutions:
    """Solutions (..., m) of `turned_goals` as those of the goals, (...), with m times as many slots."""
    *batch, count, slots, n = sol.q.shape
    fields = {field.name: getattr(sol, field.name) for field in dataclasses.fields(sol)}
    is_pose, q = fields.pop("is_pose"), fields.pop("q")
    flat = {name: value.reshape(*batch, count * slots) for name, value in fields.items()}
    return Solutions(q=q.reshape(*batch, count * slots, n), is_pose=is_pose[..., 0], **flat)


def pose_product(first: jax.Array, second: jax.Array) -> jax.Array:
    """T_a_c (..., 4, 4) of T_a_b and T_b_c, whose leading shapes broadcast; without a matrix product."""
    shape = jnp.broadcast_shapes(first.shape, second.shape)
    a, b = (poses.from_matrix(jnp.broadcast_to(x, shape)) for x in (first, second))
    return poses.to_matrix(poses.compose(a, b))


def solve_at_samples(arm: Arm, goals: jax.Array, samples: int, judge: Judge | None = None) -> Solutions:
    """`solve`, at `middles` of the redundant joints if there are any.

    Args:
        arm: The arm.
        goals: (..., 4, 4).
        samples: Values of each redundant joint.
        judge: Of the solutions at each value, before they are joined.

    Returns:
        `Solutions` with as many slots as there are branches at all values: those of the first value come
        first. Derivatives are those at fixed values.
    """

    def judged(arm: Arm, goals: jax.Array, **redundancy) -> Solutions:
        sol = solve(arm, goals, **redundancy)
        return sol if judge is None else judge(sol)

    if not arm.locked:
        return judged(arm, goals)
    values = jnp.asarray(middles(arm.baked(), samples, goals.dtype))
    values = values if len(arm.locked) > 1 else values[:, 0]
    if is_traced((arm, goals)):
        # In a loop, because the stack of all slots at all values would be computed number by number.
        sol = jax.lax.map(lambda value: judged(arm, goals, redundancy=value), values)
        sol = jax.tree.map(lambda x: jnp.moveaxis(x, 0, goals.ndim - 2), sol)
    else:
        sol = judged(arm, goals[..., None, :, :], redundancy=values)
    batch = goals.shape[:-2]
    fields = {field.name: getattr(sol, field.name) for field in dataclasses.fields(sol)}
    is_pose, q = fields.pop("is_pose"), fields.pop("q")
    flat = {name: value.reshape(*batch, -1) for name, value in fields.items()}
    return Solutions(q=q.reshape(*batch, -1, arm.n), is_pose=is_pose[..., 0], **flat)
