"""Which error of a nearest pose comes first: neither, the position or the orientation.

With a priority, the first error is made as small as possible, and then the second as small as that allows
(lexicographic optimization). This is solved by continuation. With the second error weighted by w against the
first, the minimizer q(w) of their weighted sum moves smoothly to the wanted pose as w goes to zero. So w is
reduced stage by stage, and each stage starts where the last one ended. After the last stage, the straight
line through the last two minimizers is extrapolated to w = 0, for all joints but those at an active bound.
The error that is left in the first term is then of the order of the product of the last two weights; a
penalty alone would leave one of the order of the last weight.

At full stretch a tool point off the last axis has minima that lie close together, and either of them may be
taken. It is not proved here that the best start leads to the best of all poses.

Source: penalties and their extrapolation after Fiacco and McCormick, Nonlinear Programming (1968), chapter 5.
"""

from collections.abc import Callable

import jax
import jax.numpy as jnp

from ikjax.arm.arm import Arm
from ikjax.arm.forward import reach
from ikjax.core.pose import Pose
from ikjax.core.tolerances import CONVERGED, CURVATURE_FLOOR, LAST_WEIGHT, SAME_COST, SAME_ERROR
from ikjax.core.trig import Scalar
from ikjax.ik import newton
from ikjax.ik.newton import Evaluation, Objective, State
from ikjax.ik.results import Projection
from ikjax.solvers.pipeline import TURNING

PRIORITIES = ("weighted", "position", "orientation")


WEIGHT_RATIO = {"float32": 10.0, "float64": 100.0}
"""The weight of the second error is divided by this from stage to stage."""

STAGES = 3


def checked_priority(arm: Arm, priority: str) -> str:
    """The priority; "weighted" for an arm whose task has one error only.

    Raises:
        ValueError: An unknown priority.
    """
    if priority not in PRIORITIES:
        raise ValueError(f"priority must be one of {', '.join(PRIORITIES)}, got {priority!r}")
    return priority if arm.task in TURNING else "weighted"


def objective_of(
    arm: Arm, goal: Pose, characteristic_length: Scalar, priority: str, weight: Scalar | None = None
) -> Objective:
    """What the Newton steps minimize.

    Args:
        arm: The arm.
        goal: T_world_tool.
        characteristic_length: Used by "weighted" only; with a priority a radian counts as one reach.
        priority: One of `PRIORITIES`.
        weight: Of the square of the second error; that of the last stage by default.
    """
    if priority == "weighted":
        return Objective(goal, characteristic_length)
    dtype = goal.position[0].dtype
    weight = jnp.asarray(LAST_WEIGHT[dtype.name] if weight is None else weight, dtype)
    floor, size = CURVATURE_FLOOR * jnp.where(weight > 0, weight, 1), reach(arm)
    if priority == "position":
        return Objective(goal, size * jnp.sqrt(weight), 1.0, floor)
    return Objective(goal, size, weight, floor)


def descend(
    arm: Arm, goal: Pose, characteristic_length: Scalar, priority: str, q: jax.Array, steps, damping
) -> tuple[State, Scalar, jax.Array]:
    """Take `steps` Newton steps, or as many in each stage of a priority.

    Arguments as in `objective_of` and `newton.descend`.

    Returns:
        The last state; the gradient norm there; and the minimizer of the last weighted sum, at which
        derivatives are taken (`ik.project_gradient`).
    """
    if priority == "weighted":
        objective = objective_of(arm, goal, characteristic_length, priority)
        state = newton.descend(arm, objective, q, steps, damping)
        return state, newton.projected_gradient_norm(arm, state.q, state.evaluation), state.q

    def weighted_by(weight: Scalar) -> Objective:
        return objective_of(arm, goal, characteristic_length, priority, weight)

    return _descend_in_stages(arm, weighted_by, priority, q, steps)


def _descend_in_stages(
    arm: Arm, weighted_by: Callable[[Scalar], Objective], priority: str, q: jax.Array, steps
) -> tuple[State, Scalar, jax.Array]:
    """The stages of a priority, and one last iteration of the same loop from the extrapolated joints."""
    dtype, zero = q[0].dtype, jnp.zeros_like(q[0])
    last_weight, ratio = (jnp.asarray(x[dtype.name], dtype) for x in (LAST_WEIGHT, WEIGHT_RATIO))
    tolerance = CONVERGED[dtype.name]

    def stage(k, carried):
        q_before, q, here, gradient_norm = carried
        # The iteration after the last stage starts where the line leads, and looks at the first error alone.
        is_final, converged = k == STAGES, gradient_norm <= tolerance
        weight = last_weight * ratio ** (STAGES - 1 - k).astype(dtype)
        extrapolated = jnp.clip(q + (q - q_before) / (ratio - 1), *newton.bounds(arm, q))
        # Joints at an active bound stay there: the first error alone would move them off it.
        fixed = is_final & newton.active_bounds(arm, q, here.gradient)
        start = jnp.where(is_final & converged[None] & ~fixed, extrapolated, q)
        damping = zero + newton.FIRST_DAMPING * weight
        objective = weighted_by(jnp.where(is_final, 0, weight))
        objective = objective._replace(fixed=fixed, enough=tolerance * jnp.sqrt(weight))
        state = newton.descend(arm, objective, start, steps, damping)
        norm = newton.projected_gradient_norm(arm, state.q, state.evaluation) / jnp.sqrt(weight)
        nearer = _first_error(state.evaluation, priority) <= _first_error(here, priority)
        accepted = ~is_final | nearer
        result = newton.choose(accepted, (state.q, state.evaluation), (q, here))
        return q, *result, jnp.where(is_final, gradient_norm, norm)

    carried = jnp.zeros_like(q), q, newton.worst_evaluation(arm, zero), zero
    last_minimizer, q, here, gradient_norm = jax.lax.fori_loop(0, STAGES + 1, stage, carried)
    return State(q, here, zero + newton.FIRST_DAMPING), gradient_norm, last_minimizer


def _first_error(here: Evaluation, priority: str) -> Scalar:
    return here.distance if priority == "position" else here.angle


def best_start(arm: Arm, branches: Projection, priority: str) -> jax.Array:
    """Index (...) of the best of the starts (..., S); of starts that are equal to rounding, the first."""
    name = branches.q.dtype.name
    rounding = 16 * float(jnp.finfo(name).eps)
    if priority == "weighted":
        return jnp.argmax(_least(branches.cost, SAME_COST[name], (rounding * reach(arm)) ** 2), axis=-1)
    # A second error counts as zero below rounding times its unit: a radian, or the reach.
    first, second, first_unit, second_unit = branches.rotation_error, branches.position_error, 1, reach(arm)
    if priority == "position":
        first, second, first_unit, second_unit = second, first, second_unit, first_unit
    candidates = jnp.where(_least(first, 0, SAME_ERROR[name] * first_unit), second, jnp.inf)
    return jnp.argmax(_least(candidates, SAME_COST[name], rounding * second_unit), axis=-1)


def _least(values: jax.Array, relative: float, absolute: Scalar) -> jax.Array:
    """Which values (..., S) are the least, up to a relative and an absolute tolerance."""
    values = jnp.where(jnp.isfinite(values), values, jnp.inf)
    return values <= (1 + relative) * jnp.min(values, axis=-1, keepdims=True) + absolute
