"""The geometric Jacobian.


Source: Spong, Robot Modeling and Control, equations (4.56)-(4.57).
"""

import jax
import jax.numpy as jnp

from ikjax.arm.arm import Arm
from ikjax.arm.forward import fk, frames


def jacobian(arm: Arm, q) -> jax.Array:
    """Velocity of the tool for unit joint rates.

    Args:
        arm: The arm.
        q: Joint values [rad, m], (..., n).

    Returns:
        (..., 6, n) in the world frame: three linear rows [m/s] for the tool point, then three
        angular rows [rad/s].
    """
    before = frames(arm, q)[..., :-1, :, :]
    axis, origin = before[..., :3, 2], before[..., :3, 3]
    tip = fk(arm, q)[..., None, :3, 3]
    turning = jnp.concatenate([jnp.cross(axis, tip - origin), axis], axis=-1)
    sliding = jnp.concatenate([axis, jnp.zeros_like(axis)], axis=-1)
    revolute = jnp.asarray([[kind == "R"] for kind in arm.kinds])
    columns = jnp.where(jnp.broadcast_to(revolute, turning.shape), turning, sliding)
    columns = jnp.swapaxes(columns, -1, -2)
    return columns if arm.coupling is None else jnp.matmul(columns, jnp.asarray(arm.coupling))
