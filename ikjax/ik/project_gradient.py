"""Slopes of a nearest pose: by the condition that holds there.

At the bottom the slope of the cost is zero and stays so when the goal or the arm changes, so

    dq = -H^-1 (change of the slope at fixed joints),

H being the second derivative; joints at a limit that holds them back stand still. Steps are never
differentiated. Where no bottom was reached, nothing moves.

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
from ikjax.ik.lexicographic import wish


def with_slopes(arm: Arm, goals, q, bottom, length, converged, priority: str):
    """Joints (..., S, n), and cost and errors (..., S), with their derivatives in the arm and the goals.

    Those of the joints are taken at `bottom`, of the sum of which one error is worth little: there, and not
    where the other is gone, what holds the pose is seen in what is left of it.
    """
    known, leaves = arm.split(whole=True)
    arm = Arm.join(known, leaves)
    bottom = _bottom(priority, known, leaves, goals, bottom, jax.lax.stop_gradient(length), converged)
    q = q + (bottom - jax.lax.stop_gradient(bottom))
    goal, proper = _nearest(arm, goals)
    columns = _columns(q)
    with pinning(divider_once(columns[0])):
        found = newton.errors(arm, newton.Wish(goal, length), columns)
    names = ("cost", "position_error", "rotation_error")
    fields = {name: jnp.where(proper, x, jnp.nan) for name, x in zip(names, found, strict=True)}
    return q, {name: jnp.moveaxis(x, 0, -1) for name, x in fields.items()}


def _columns(q) -> tuple[jax.Array, ...]:
    """Starts first."""
    return tuple(jnp.moveaxis(q[..., i], -1, 0) for i in range(q.shape[-1]))


def _nearest(arm: Arm, goals) -> tuple[Pose, jax.Array]:
    """The poses nearest to the goals, one for all starts, and whether there are any.

    The derivative of the nearest rotation takes out of a change of its entries what is no rotation.
    """
    size = jax.lax.stop_gradient(jnp.asarray(reach(arm), goals.dtype))
    goal, off = nearest_pose(entries_of(goals), size)
    divide = divider(goals[..., 0, 3])
    return jax.tree.map(lambda x: divide(x)[None], goal), (off <= NEARLY_ROTATION)[None]


@functools.partial(jax.custom_jvp, nondiff_argnums=(0, 1))
def _bottom(priority: str, known: tuple, leaves: list, goals, q, length, converged):
    return q


@_bottom.defjvp
def _(priority: str, known: tuple, primals, tangents):
    leaves, goals, q, length, converged = primals
    # Called again, it moves with the goal in slopes of slopes.
    q = _bottom(priority, known, leaves, goals, q, length, converged)
    arm, columns = Arm.join(known, leaves), _columns(q)

    def slope(leaves, goals):
        moving = dataclasses.replace(Arm.join(known, leaves), limits=arm.limits)
        goal, _ = _nearest(moving, goals)
        with pinning(divider_once(columns[0])):
            return newton.standing(moving, wish(moving, goal, length, priority), columns)

    at, rate = jax.jvp(slope, (leaves, goals), tangents[:2])
    back = newton.held_back(arm, columns, at.slope)
    still = ~jnp.moveaxis(converged, -1, 0)
    fixed = [b | still for b in back]
    matrix = [
        [jnp.where(fixed[i] | fixed[j], 0, row[j]) for j in range(i)] + [jnp.where(fixed[i], 1, row[i])]
        for i, row in enumerate(at.curve)
    ]
    right = [jnp.where(f, 0, -s) for f, s in zip(fixed, rate.slope, strict=True)]
    floor = jnp.finfo(q.dtype).eps ** 0.5 * (
        1.0 if priority == "weighted" else LAST_WEIGHT[q.dtype.name] ** 0.5
    )
    steps = solve_symmetric(matrix, right, floor=jnp.asarray(floor, q.dtype))
    size = reach(arm)
    units = [size if kind == "P" else 1.0 for kind in arm.kinds]
    moves = [jnp.where(still, 0, unit * step) for unit, step in zip(units, steps, strict=True)]
    return q, jnp.stack([jnp.moveaxis(x, 0, -1) for x in moves], axis=-1)
