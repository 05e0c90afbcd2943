"""`solve`: poses in, every branch out.

Inside a caller's jit it is a plain elementwise graph (`ik.inline`), so that what is not used is never
computed. Called eagerly it works through the goals in blocks that fit the cache (`ik.batched`). They always
have one size, and the arm is always passed in the same way, so that the bits of an answer depend on its goal
alone.
"""

import dataclasses
import functools
import warnings

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike

from ikjax.arm.arm import Arm
from ikjax.arm.recognition.rules import RULES
from ikjax.core.known import as_array, is_traced, stop_gradient
from ikjax.core.warn import MOST_TURNS, warn_of_degrees
from ikjax.core.xla import not_folded
from ikjax.ik import batched
from ikjax.ik.inline import solve_inline
from ikjax.ik.refusal import refusal
from ikjax.ik.results import Solutions
from ikjax.ik.solve_gradient import with_derivatives
from ikjax.solvers.pipeline import as_solved


def solve(
    arm: Arm,
    goals: ArrayLike,
    q_now: ArrayLike | None = None,
    *,
    pose_tolerance: float | None = None,
    damping: float | None = None,
) -> Solutions:
    """Every branch of every goal.

    Args:
        arm: An arm with a family (`explain(arm)` says which).
        goals: T_world_tool, (..., 4, 4), float32 or float64; the answer has its type. A goal that is
            not finite, or whose rotation is off by more than 1e-5, is masked; other goals are not affected.
        q_now: (..., n) [rad, m], the values that joints take where they are arbitrary; zero by default. Where
            a turning one is beyond four turns, a warning asks whether these are degrees.
        pose_tolerance: How far a valid pose may be from its goal, [rad] and as a share of
            (reach + |p|); 1e-9 in float64 and 2e-5 in float32 by default.
        damping: Of the gradients near singularities (damped least squares), as a singular value of the
            Jacobian in reaches: where the least one is sigma, gradients are short by (damping / sigma)^2. By
            default 16 square roots of the type's rounding, 2.4e-7 in float64 and 5.5e-3 in float32.

    Returns:
        `Solutions`, its fields (..., S) with S = len(arm.branches). `q` and `margin` have gradients in the
        goals and in the arm's leaves. They are finite everywhere, and zero for joints of slots that are not
        valid (`ik.solve_gradient` states the rule). The other fields have none.

    Raises:
        ValueError: Wrong shapes or types, or an arm of no family.
    """
    check_family(arm)
    goals = as_goals(goals)
    arm = as_solved(arm.baked().astype(goals.dtype))
    fallback = None if q_now is None else _as_fallback(arm, goals, q_now)
    if not is_traced((arm, goals, fallback)):
        return _solve(arm, goals, fallback, pose_tolerance)
    if not is_traced(goals):
        goals = not_folded(goals)
    sol = _solve(*stop_gradient((arm, goals, fallback)), pose_tolerance)
    q, margin = with_derivatives(arm, goals, sol.q, sol.valid, sol.margin, damping)
    return dataclasses.replace(sol, q=q, margin=margin)


def _solve(arm: Arm, goals: jax.Array, q_now: jax.Array | None, pose_tolerance: float | None) -> Solutions:
    """`Solutions` without derivatives."""
    if is_traced((arm, goals, q_now)):
        # Those of the arm's numbers that are not traced become constants of the caller's jit.
        return solve_inline(arm, goals, q_now, pose_tolerance)
    batch = goals.shape[:-2]
    flat = goals.reshape(-1, 4, 4)
    flat_q = None if q_now is None else q_now.reshape(-1, arm.n)
    sol = batched.solve_blocks(arm, flat, flat_q, pose_tolerance)
    return jax.tree.map(lambda x: x.reshape(*batch, *x.shape[1:]), sol)


def _as_fallback(arm: Arm, goals: jax.Array, q_now: ArrayLike) -> jax.Array:
    """The values of arbitrary joints, (..., n), one row for each goal.

    Raises:
        ValueError: A wrong shape.
    """
    fallback = as_array(q_now, goals.dtype)
    if fallback.ndim == 0 or fallback.shape[-1] != arm.n:
        raise ValueError(f"q_now must have shape (..., {arm.n}), got {fallback.shape}")
    warn_of_degrees("q_now", fallback, MOST_TURNS, arm.kinds)
    wanted = (*goals.shape[:-2], arm.n)
    try:
        return jnp.broadcast_to(fallback, wanted)
    except ValueError as error:
        raise ValueError(f"q_now must have shape {wanted}, got {fallback.shape}") from error


def check_family(arm: Arm) -> None:
    """Raise unless a closed form is known for the arm.

    Raises:
        ValueError: With the reason, and what to do instead.
    """
    if arm.family is not None:
        if RULES[str(arm.family)].wide and jnp.result_type(float) == jnp.float32:
            _warn_once_that_float64_is_needed(str(arm.family))
        return
    raise ValueError(refusal(arm))


_ACCEPTED = (jnp.float32, jnp.float64)


def as_goals(goals) -> jax.Array:
    """Goals as an array of float32 or float64, (..., 4, 4).

    Raises:
        ValueError: Another shape or type.
    """
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
        _warn_once_that_x64_is_off()
        goals = np.asarray(goals, np.float32)
    return jnp.asarray(goals)


@functools.cache
def _warn_once_that_float64_is_needed(family: str) -> None:
    warnings.warn(
        f"{family} misses solutions in float32 (arm.complete is False); "
        'switch float64 on with jax.config.update("jax_enable_x64", True)',
        stacklevel=4,
    )


@functools.cache
def _warn_once_that_x64_is_off() -> None:
    warnings.warn(
        "float64 goals are solved in float32 because jax_enable_x64 is off; "
        'switch it on with jax.config.update("jax_enable_x64", True)',
        stacklevel=4,
    )
