"""Derivatives of a nearest pose, by the implicit function theorem.

At a minimum the gradient of the cost is zero, and it stays zero when the goal or the arm changes. So

    dq = -H^-1 (change of the gradient at fixed joints),

where H is the Hessian. Joints at an active bound do not move. The Newton steps are never differentiated. A
start that has not converged has zero derivatives.

Source: the implicit function theorem.
"""

import dataclasses
import functools

import jax
import jax.numpy as jnp

from ikjax.arm.arm import Arm
from ikjax.arm.forward import reach
from ikjax.core.linear import solve_symmetric
from ikjax.core.pose import Pose, nearest_pose
from ikjax.core.tolerances import LAST_WEIGHT, NEARLY_ROTATION
from ikjax.core.xla import divider, divider_once, pinning
from ikjax.ik import newton
from ikjax.ik.inline import entries_of
from ikjax.ik.lexicographic import objective_of


def with_derivatives(
    arm: Arm,
    goals: jax.Array,
    q: jax.Array,
    minimizer: jax.Array,
    characteristic_length: jax.Array,
    converged: jax.Array,
    priority: str,
) -> tuple[jax.Array, dict[str, jax.Array]]:
    """Joints as they are, and cost and errors, with their derivatives in the arm and the goals.

    With a priority, derivatives of the joints are taken at the minimizer of a sum in which the second error
    has a small weight. There, and not where the first error is gone, what is left of that error tells what
    holds the pose.

    Args:
        arm: Its leaves may be traced.
        goals: T_world_tool, (..., 4, 4).
        q: Joints (..., S, n), without derivatives.
        minimizer: Joints (..., S, n) at which derivatives are taken: q, or with a priority the minimizer of
            the last weighted sum.
        characteristic_length: Length that counts as much as one radian [m].
        converged: (..., S); elsewhere the joints have no derivatives.
        priority: See `refine`.

    Returns:
        q, and "cost", "position_error" and "rotation_error", (..., S).
    """
    known, leaves = arm.split(whole=True)
    arm = Arm.join(known, leaves)
    minimizer = _implicit(
        priority, known, leaves, goals, minimizer, jax.lax.stop_gradient(characteristic_length), converged
    )
    q = q + (minimizer - jax.lax.stop_gradient(minimizer))
    goal, proper = _nearest_goal(arm, goals)
    columns = _columns(q)
    with pinning(divider_once(columns[0])):
        errors = newton.pose_errors(arm, newton.Objective(goal, characteristic_length), columns)
    names = ("cost", "position_error", "rotation_error")
    fields = {name: jnp.where(proper, x, jnp.nan) for name, x in zip(names, errors, strict=True)}
    return q, {name: jnp.moveaxis(x, 0, -1) for name, x in fields.items()}


def _columns(q: jax.Array) -> tuple[jax.Array, ...]:
    """One array (S, ...) for each joint, starts first."""
    return tuple(jnp.moveaxis(q[..., i], -1, 0) for i in range(q.shape[-1]))


def _nearest_goal(arm: Arm, goals: jax.Array) -> tuple[Pose, jax.Array]:
    """The poses nearest to the goals, with an axis for the starts, and whether there are any.

    The derivative of the nearest rotation removes from a change of its entries what is no rotation.
    """
    size = jax.lax.stop_gradient(jnp.asarray(reach(arm), goals.dtype))
    goal, off = nearest_pose(entries_of(goals), size)
    divide = divider(goals[..., 0, 3])
    return jax.tree.map(lambda x: divide(x)[None], goal), (off <= NEARLY_ROTATION)[None]


@functools.partial(jax.custom_jvp, nondiff_argnums=(0, 1))
def _implicit(priority: str, known: tuple, leaves: list, goals, q, characteristic_length, converged):
    """The joints q as they are; their derivatives are those of the rule below."""
    return q


@_implicit.defjvp
def _implicit_jvp(priority: str, known: tuple, primals, tangents):
    leaves, goals, q, length, converged = primals
    # Applied again, so that q moves with the goal in derivatives of second order.
    q = _implicit(priority, known, leaves, goals, q, length, converged)
    arm, joints = Arm.join(known, leaves), jnp.moveaxis(q, -1, 0)
    joints = jnp.moveaxis(joints, -1, 1)

    def evaluate(leaves, goals):
        varied = dataclasses.replace(Arm.join(known, leaves), limits=arm.limits)
        goal, _ = _nearest_goal(varied, goals)
        with pinning(divider_once(joints[:1])):
            return newton.evaluate(varied, objective_of(varied, goal, length, priority), joints)

    here, rate = jax.jvp(evaluate, (leaves, goals), tangents[:2])
    unconverged = ~jnp.moveaxis(converged, -1, 0)
    fixed = newton.active_bounds(arm, joints, here.gradient) | unconverged[None]
    # Rows and columns of fixed joints become those of the identity.
    matrix = [
        [jnp.where(fixed[i] | fixed[j], 0, row[j]) for j in range(i)] + [jnp.where(fixed[i], 1, row[i])]
        for i, row in enumerate(here.hessian)
    ]
    right = list(jnp.where(fixed, 0, -rate.gradient))
    floor = jnp.finfo(q.dtype).eps ** 0.5 * (
        1.0 if priority == "weighted" else LAST_WEIGHT[q.dtype.name] ** 0.5
    )
    steps = solve_symmetric(matrix, right, floor=jnp.asarray(floor, q.dtype))
    size = reach(arm)
    units = [size if kind == "P" else 1.0 for kind in arm.kinds]
    moves = [jnp.where(unconverged, 0, unit * step) for unit, step in zip(units, steps, strict=True)]
    return q, jnp.stack([jnp.moveaxis(x, 0, -1) for x in moves], axis=-1)
