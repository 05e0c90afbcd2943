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

from ikjax.arm.arm import Arm, once_for_each_arm
from ikjax.arm.recognition.rules import RULES
from ikjax.core import pose as poses
from ikjax.core.warn import MOST_TURNS, warn_of_degrees
from ikjax.core.xla import as_array, divider, is_traced, not_folded, stop_gradient
from ikjax.ik import batched
from ikjax.ik.arm_angle import at_arm_angle
from ikjax.ik.inline import in_type, solve_inline
from ikjax.ik.refusal import refusal
from ikjax.ik.results import Origin, Solutions
from ikjax.ik.solve_gradient import DerivativeRule
from ikjax.solvers.pipeline import as_solved


def solve(
    arm: Arm,
    goals: ArrayLike,
    q_now: ArrayLike | None = None,
    *,
    redundancy: ArrayLike | None = None,
    arm_angle: ArrayLike | None = None,
    reference: str = "axis1",
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
        redundancy: The value of the joint that `arm.redundant` names [rad, m], for arms of more joints than a
            pose asks for: an array (...) that broadcasts with the goals' batch, so that goals (N, 1, 4, 4)
            and 16 values give answers (N, 16). With several such joints (..., k). A value beyond the limits
            is solved as any other; one that is not finite masks its row.
        arm_angle: In place of `redundancy`, the arm angle [rad] of an arm of seven joints with a spherical
            shoulder and a spherical wrist, (...) likewise: `ikjax.arm_angle` states it. The slots are then
            those of `solvers.families.arm_angle`, eight, by the signs of joints 2, 4 and 6.
        reference: Of the arm angle: "axis1" or "stereographic", see `ikjax.arm_angle`.
        pose_tolerance: How far a valid pose may be from its goal, [rad] and as a share of
            (reach + |p|); 1e-9 in float64 and 2e-5 in float32 by default.
        damping: Of the gradients near singularities (damped least squares), as a singular value of the
            Jacobian in reaches: where the least one is sigma, gradients are short by (damping / sigma)^2. By
            default 16 square roots of the type's rounding, 2.4e-7 in float64 and 5.5e-3 in float32.

    Returns:
        `Solutions`, its fields (..., S) with S = len(arm.branches). `q` and `margin` have gradients in the
        goals, in the arm's leaves and in the redundancy or the arm angle: that of `q` is the tangent of the
        self-motion. They
        are finite everywhere, and zero for joints of slots that are not valid (`ik.solve_gradient` states the
        rule). The other fields have none.

    Raises:
        ValueError: Wrong shapes or types, an arm of no family, a redundancy that is missing or that the arm
            does not have, or an arm angle of an arm that has none.
    """
    goals = as_goals(goals)
    if arm_angle is None:
        check_family(arm)
        goals, free = _with_redundancy(arm, goals, redundancy)
    else:
        if redundancy is not None:
            raise ValueError("redundancy= and arm_angle= are two ways to say one thing: give one of them")
        arm = at_arm_angle(arm, reference)
        goals, free = _with_angle(goals, arm_angle)
    arm = _in_type(arm, goals.dtype)
    fallback = None if q_now is None else _as_fallback(arm, goals, q_now)
    # Blocks are compiled beforehand, which `jax.disable_jit`, for debugging, does not allow.
    if not jax.config.values["jax_disable_jit"] and not is_traced((arm, goals, fallback, free)):
        return batched.solve_eagerly(arm, goals, fallback, pose_tolerance, free)
    if not is_traced(goals):
        goals = not_folded(goals)
    # Those of the arm's numbers that are not traced become constants of the caller's jit.
    fixed_arm, fixed_goals, fixed_q, fixed_free = stop_gradient((arm, goals, fallback, free))
    sol, slots = solve_inline(fixed_arm, fixed_goals, fixed_q, pose_tolerance, fixed_free)
    rule = DerivativeRule.of(arm, goals, damping, free)
    differentiable = dataclasses.replace(
        sol, q=rule.joints(sol.q, sol.valid), margin=rule.margins(sol.margin, slots)
    )
    # Each number is read by several loops of whoever chooses among the slots.
    pin, shape = divider(goals[..., 0, 3]), goals.shape[:-2]
    numbers = [[pin(jnp.broadcast_to(x, shape)) for x in slot.q] for slot in slots]
    return differentiable.with_origin(Origin(numbers, sol.valid, rule.chosen_joints))


@once_for_each_arm
def _in_type(arm: Arm, dtype) -> Arm:
    """The arm that is solved for goals of a type, with constants for leaves where they are not traced."""
    return as_solved(in_type(arm, dtype))


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


def _with_redundancy(
    arm: Arm, goals: jax.Array, redundancy: ArrayLike | None
) -> tuple[jax.Array, jax.Array | None]:
    """Goals and the values of the redundant joints (..., k) with one batch shape; None of an arm without.

    Raises:
        ValueError: A missing redundancy, one that the arm does not have, or a wrong shape.
    """
    if not arm.locked:
        if redundancy is None:
            return goals, None
        raise ValueError(
            f"redundancy= is for arms with more joints than a pose asks for: {arm.name} has {arm.n}, and "
            "none is redundant"
        )
    count = len(arm.locked)
    if redundancy is None:
        raise ValueError(f"{arm.name} has {arm.n} joints: redundancy= must give the value of {_wanted(arm)}")
    free = as_array(redundancy, goals.dtype)
    if count == 1:
        free = free[..., None]
    shape = f"(..., {count})" if count > 1 else "(...)"
    if free.ndim == 0 or free.shape[-1] != count:
        raise ValueError(f"redundancy must have shape {shape} for {_wanted(arm)}, got {free.shape}")
    try:
        batch = np.broadcast_shapes(goals.shape[:-2], free.shape[:-1])
    except ValueError as error:
        raise ValueError(
            f"redundancy must have shape {shape} that broadcasts with the goals' {goals.shape[:-2]}, "
            f"got {np.shape(redundancy)}"
        ) from error
    kinds = "".join(arm.kinds[i] for i in arm.locked)
    warn_of_degrees("redundancy", free, MOST_TURNS, kinds)
    return jnp.broadcast_to(goals, (*batch, 4, 4)), jnp.broadcast_to(free, (*batch, count))


def _with_angle(goals: jax.Array, arm_angle: ArrayLike) -> tuple[jax.Array, jax.Array]:
    """Goals and the arm angle (..., 1) with one batch shape.

    Raises:
        ValueError: A shape that does not broadcast.
    """
    angle = as_array(arm_angle, goals.dtype)
    try:
        batch = np.broadcast_shapes(goals.shape[:-2], angle.shape)
    except ValueError as error:
        raise ValueError(
            f"arm_angle must have a shape that broadcasts with the goals' {goals.shape[:-2]}, "
            f"got {angle.shape}"
        ) from error
    warn_of_degrees("arm_angle", angle[..., None], MOST_TURNS, "R")
    return jnp.broadcast_to(goals, (*batch, 4, 4)), jnp.broadcast_to(angle[..., None], (*batch, 1))


def _wanted(arm: Arm) -> str:
    """The redundant joints with their units and ranges, in words."""
    words = []
    for i, name in zip(arm.locked, arm.redundant, strict=True):
        unit = "rad" if arm.kinds[i] == "R" else "m"
        words.append(f"{name} [{unit}]")
        if not is_traced(arm.limits):
            low, high = np.asarray(arm.limits)[i]
            words[-1] += f" between {low:.4g} and {high:.4g}"
    return ", ".join(words)


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
    """Goals as an array of float32 or float64, (..., 4, 4), from one or from an object that has one.

    Raises:
        ValueError: Another shape or type.
    """
    goals = goals if isinstance(goals, jax.Array) else poses.as_matrix(goals)
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
    return goals if isinstance(goals, jax.Array) else jnp.asarray(goals)


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
