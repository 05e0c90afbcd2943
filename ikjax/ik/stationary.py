"""Slopes of a nearest pose: by the condition that holds there.

Storey: ik. At the bottom the slope of the cost is zero and stays so when the goal or the arm changes, so

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
from ikjax.core import pose as poses
from ikjax.core import vector
from ikjax.core.linear import solve_symmetric
from ikjax.core.pose import Pose
from ikjax.core.xla import holder
from ikjax.ik import descent
from ikjax.ik.priority import SHARE, wish
from ikjax.solvers.family import clean, reach


def with_slopes(arm: Arm, goals, q, bottom, length, converged, priority: str):
    """Joints (..., S, n), and cost and errors (..., S), with their derivatives in the arm and the goals.

    Those of the joints are taken at `bottom`, of the sum of which one error is worth little: there, and not
    where the other is gone, what holds the pose is seen in what is left of it.
    """
    bottom = _bottom(priority, arm, goals, bottom, jax.lax.stop_gradient(length), converged)
    q = q + (bottom - jax.lax.stop_gradient(bottom))
    goal = _as_moved(goals, reach(arm))
    asked = descent.Wish(jax.tree.map(lambda x: x[None], goal), length)
    columns = _columns(q)
    cost, gap, angle = descent.errors(arm, asked, columns, _hold(columns))
    fields = {"cost": cost, "position_error": gap, "rotation_error": angle}
    return q, {name: jnp.moveaxis(x, 0, -1) for name, x in fields.items()}


def _columns(q) -> tuple[jax.Array, ...]:
    """Starts first."""
    return tuple(jnp.moveaxis(q[..., i], -1, 0) for i in range(q.shape[-1]))


def _hold(columns):
    return descent.held_once(holder(columns[0]))


def _as_moved(goals, size) -> Pose:
    """The goals cleaned, their tangents read as those of rigid bodies."""
    still, _ = clean(poses.from_matrix(jax.lax.stop_gradient(goals)), jax.lax.stop_gradient(size))
    # At a rotation itself a change of its entries that is no rotation is taken out: R (1 + skew(R^T dR)).
    turn = vector.matmul(vector.transpose(still.rotation), poses.from_matrix(goals).rotation)
    skew = tuple(
        tuple(_slope_only((turn[i][j] - turn[j][i]) / 2) + (1.0 if i == j else 0.0) for j in range(3))
        for i in range(3)
    )
    position = tuple(
        x + _slope_only(y) for x, y in zip(still.position, poses.from_matrix(goals).position, strict=True)
    )
    return Pose(vector.matmul(still.rotation, skew), position)


def _slope_only(x):
    """Zero, with the slope of x; also where x is not finite."""
    good = jnp.isfinite(x)
    x = jnp.where(good, x, 0)
    return x - jax.lax.stop_gradient(x)


@functools.partial(jax.custom_jvp, nondiff_argnums=(0,))
def _bottom(priority: str, arm: Arm, goals, q, length, converged):
    return q


@_bottom.defjvp
def _(priority: str, primals, tangents):
    arm, goals, q, length, converged = primals
    # Called again, it moves with the goal in slopes of slopes.
    q = _bottom(priority, arm, goals, q, length, converged)
    columns = _columns(q)

    def slope(arm, goals):
        goal = jax.tree.map(lambda x: x[None], _as_moved(goals, reach(arm)))
        return descent.standing(arm, wish(arm, goal, length, priority), columns, _hold(columns))

    moved_arm = dataclasses.replace(tangents[0], limits=jnp.zeros_like(arm.limits))
    at, rate = jax.jvp(slope, (arm, goals), (moved_arm, tangents[1]))
    back = descent.held_back(arm, columns, at.slope)
    still = ~jnp.moveaxis(converged, -1, 0)
    fixed = [b | still for b in back]
    matrix = [
        [jnp.where(fixed[i] | fixed[j], 0, row[j]) for j in range(i)] + [jnp.where(fixed[i], 1, row[i])]
        for i, row in enumerate(at.curve)
    ]
    right = [jnp.where(f, 0, -s) for f, s in zip(fixed, rate.slope, strict=True)]
    floor = jnp.finfo(q.dtype).eps ** 0.5 * (1.0 if priority == "weighted" else SHARE[q.dtype.name] ** 0.5)
    steps = solve_symmetric(matrix, right, floor=jnp.asarray(floor, q.dtype))
    size = reach(arm)
    units = [size if kind == "P" else 1.0 for kind in arm.kinds]
    moves = [jnp.where(still, 0, unit * step) for unit, step in zip(units, steps, strict=True)]
    return q, jnp.stack([jnp.moveaxis(x, 0, -1) for x in moves], axis=-1)
