"""Downhill on a loss of the caller's own, by an optax optimiser."""

import jax
import jax.numpy as jnp
import optax

from ikjax.arm.arm import Arm
from ikjax.arm.forward import fk
from ikjax.core.pose import pose_error, to_matrix
from ikjax.ik import newton
from ikjax.ik.inline import entries_of
from ikjax.ik.projection import Projection
from ikjax.solvers.pipeline import NEARLY_ROTATION, nearest_pose, reach


def minimised(arm: Arm, goals: jax.Array, starts: jax.Array, loss, optimizer, steps: int) -> Projection:
    """The best of all steps from each start (..., S, n), fields (..., S); arguments as in `refine`.

    The loss is handed the pose nearest to each goal, or the goal as it is where there is none.
    """
    optimizer = optax.adam(0.02) if optimizer is None else optimizer
    columns = newton.into_limits(arm, tuple(starts[..., i] for i in range(arm.n)))
    starts, size = jnp.stack(columns, axis=-1), jnp.asarray(reach(arm), goals.dtype)
    low, high = arm.limits[:, 0], arm.limits[:, 1]

    def one(goal, q0):
        slope = jax.value_and_grad(lambda q: loss(arm, goal, q))

        def look(q, best):
            value, grad = slope(q)
            # A loss that is no number is no best, and its slope leads nowhere.
            grad = jnp.where(jnp.isfinite(grad), grad, 0)
            free = jnp.where(((q <= low) & (grad > 0)) | ((q >= high) & (grad < 0)), 0, grad)
            now = q, value, jnp.sqrt(jnp.sum(free * free))
            return grad, jax.tree.map(lambda new, old: jnp.where(value < best[1], new, old), now, best)

        def step(carry, _):
            q, inner, best = carry
            grad, best = look(q, best)
            # Optax mixes types as the caller's settings may forbid.
            with jax.numpy_dtype_promotion("standard"):
                moves, inner = optimizer.update(grad, inner, q)
            return (jnp.clip(optax.apply_updates(q, moves), low, high), inner, best), None

        none = q0, jnp.full((), jnp.inf, q0.dtype), jnp.zeros((), q0.dtype)
        (q, _, best), _ = jax.lax.scan(step, (q0, optimizer.init(q0), none), length=steps)
        return look(q, best)[1]

    pose, off = nearest_pose(entries_of(goals), jax.lax.stop_gradient(size))
    proper = off <= NEARLY_ROTATION
    goals = jnp.where(proper[..., None, None], to_matrix(pose), goals)
    flat = starts.reshape(-1, *starts.shape[-2:])
    found = jax.vmap(jax.vmap(one, (None, 0)))(goals.reshape(-1, 4, 4), flat)
    q, value, steep = (x.reshape(*starts.shape[:-1], *x.shape[2:]) for x in found)
    proper = proper[..., None]
    errors = pose_error(fk(arm, q), goals[..., None, :, :])
    gap, angle = (jnp.where(proper, x, jnp.nan) for x in errors)
    down = proper & jnp.isfinite(value) & (steep <= newton.CONVERGED[q.dtype.name])
    return Projection(q, value, gap, angle, steep, down)
