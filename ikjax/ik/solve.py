"""`solve`: poses in, every branch out.

Inside a caller's jit it is a plain elementwise graph, so what is not used is never
computed. Called eagerly it works through the goals in blocks that fit the cache, always of one
size and with the arm passed the same way, so that the bits of an answer depend on its goal alone.
"""

import dataclasses
import functools
import warnings

import jax
import jax.numpy as jnp
import numpy as np

from ikjax.arm.arm import Arm
from ikjax.core.known import as_array, is_traced, stop_gradient
from ikjax.core.warn import MOST_TURNS, warn_of_degrees
from ikjax.core.xla import not_folded
from ikjax.ik import batched
from ikjax.ik.inline import solve_here
from ikjax.ik.refusal import refusal
from ikjax.ik.results import Solutions
from ikjax.ik.solve_gradient import with_slopes
from ikjax.solvers.pipeline import as_solved


def solve(
    arm: Arm, goals, q_now=None, *, pose_tolerance: float | None = None, damping: float | None = None
) -> Solutions:
    """Every branch of every goal.

    Args:
        arm: An arm with a family (`explain(arm)` says which).
        goals: T_world_tool, (..., 4, 4), float32 or float64; the answer has its type. A goal that is
            not finite, or whose rotation is off by more than 1e-5, is masked; its neighbors are not
            touched.
        q_now: (..., n) joint values that a joint follows where it is arbitrary; zero by default. Where a
            turning one is beyond four turns, a warning asks whether these are degrees.
        pose_tolerance: How far a valid pose may be from its goal, [rad] and as a share of
            (reach + |p|); 1e-9 in float64 and 2e-5 in float32 by default.
        damping: Of slopes near singularities, as a singular value of the Jacobian in reaches: where the
            least one is sigma, slopes are short by (damping / sigma)^2; 16 square roots of the type's
            rounding by default, 2.4e-7 in float64 and 5.5e-3 in float32.

    Returns:
        `Solutions`, its fields (..., S) with S = len(arm.branches). `q` and `margin` have slopes in
        the goals and in the arm's leaves, finite everywhere and zero for joints of slots that are not
        valid (`ik.solve_gradient` states the rule); the other fields have none.

    Raises:
        ValueError: Wrong shapes or types, or an arm of no family.
    """
    check_family(arm)
    goals = as_goals(goals)
    arm = as_solved(arm.baked().astype(goals.dtype))
    batch = goals.shape[:-2]
    if q_now is not None:
        q_now = as_array(q_now, goals.dtype)
        if q_now.ndim == 0 or q_now.shape[-1] != arm.n:
            raise ValueError(f"q_now must have shape (..., {arm.n}), got {q_now.shape}")
        warn_of_degrees("q_now", q_now, MOST_TURNS, arm.kinds)
        try:
            q_now = jnp.broadcast_to(q_now, (*batch, arm.n))
        except ValueError as error:
            raise ValueError(f"q_now must have shape {(*batch, arm.n)}, got {q_now.shape}") from error
    if not is_traced((arm, goals, q_now)):
        return _solved(arm, goals, q_now, pose_tolerance)
    if not is_traced(goals):
        goals = not_folded(goals)
    sol = _solved(*stop_gradient((arm, goals, q_now)), pose_tolerance)
    q, margin = with_slopes(arm, goals, sol.q, sol.valid, sol.margin, damping)
    return dataclasses.replace(sol, q=q, margin=margin)


def _solved(arm: Arm, goals: jax.Array, q_now, pose_tolerance) -> Solutions:
    """`Solutions` without slopes."""
    if is_traced((arm, goals, q_now)):
        # What of the arm is not traced itself becomes constants of the caller's jit.
        return solve_here(arm, goals, q_now, pose_tolerance)
    batch = goals.shape[:-2]
    flat = goals.reshape(-1, 4, 4)
    now = None if q_now is None else q_now.reshape(-1, arm.n)
    packed = batched.solve_blocks(arm, flat, now, pose_tolerance)
    return jax.tree.map(lambda x: x.reshape(*batch, *x.shape[1:]), packed)


def check_family(arm: Arm) -> None:
    """Raise unless a closed form is known for the arm."""
    if arm.family is not None:
        return
    raise ValueError(refusal(arm))


_ACCEPTED = (jnp.float32, jnp.float64)


def as_goals(goals) -> jax.Array:
    """Goals as an array of float32 or float64, (..., 4, 4)."""
    if not isinstance(goals, jax.Array):
        try:
            goals = np.asarray(goals)
        except ValueError as error:
            raise ValueError(f"goals must be one array (..., 4, 4): {error}") from error
        if goals.dtype == object or goals.dtype.kind in "USV":
            raise ValueError(f"goals must hold real numbers, got {goals.dtype}")
    if goals.dtype.kind == "c":
        raise ValueError(f"goals must hold real numbers, got {goals.dtype}")
    if goals.dtype.kind in "iub":
        goals = jnp.asarray(goals, jnp.result_type(float))
    if goals.dtype not in _ACCEPTED:
        raise ValueError(f"goals must be float32 or float64, got {goals.dtype}: use float32 or float64")
    if goals.ndim < 2 or goals.shape[-2:] != (4, 4):
        raise ValueError(f"goals must have shape (..., 4, 4), got {goals.shape}")
    if goals.dtype == np.float64 and jnp.result_type(float) == jnp.float32:
        _say_once_that_x64_is_off()
        goals = np.asarray(goals, np.float32)
    return jnp.asarray(goals)


@functools.cache
def _say_once_that_x64_is_off() -> None:
    warnings.warn(
        "float64 goals are solved in float32 because jax_enable_x64 is off; "
        'switch it on with jax.config.update("jax_enable_x64", True)',
        stacklevel=4,
    )
