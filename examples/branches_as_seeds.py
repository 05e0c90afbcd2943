"""Every branch as a seed of a numeric problem with a collision cost, which optax then solves.

A numeric solver finds the minimum next to where it starts. From one start it may end in the obstacle; the
branches of the closed form start on every side of it. `pyroki_seeds.py` hands the same seeds to PyRoki.
"""

import jax

jax.config.update("jax_enable_x64", True)

import jax.numpy as jnp
import optax

import ikjax

arm = ikjax.load("ur5e")
goal = ikjax.pose(xyz=(0.45, 0.1, 0.3), rpy=(3.1, 0, 0))
ball, radius = jnp.array([0.2, 0.0, 0.55]), 0.25  # an obstacle


def clearance(q):
    """Least distance [m] from the ball's surface to points along the links."""
    stations = ikjax.frames(arm, q)[1:, :3, 3]
    share = jnp.linspace(0, 1, 8)[:, None, None]
    points = (1 - share) * stations[:-1] + share * stations[1:]
    return jnp.linalg.norm(points - ball, axis=-1).min() - radius


def cost(q):
    """Pose error, and how deep the arm is within 2 cm of the ball."""
    distance, angle = ikjax.pose_error(ikjax.fk(arm, q), goal)
    return distance**2 + (0.1 * angle) ** 2 + jnp.maximum(0.02 - clearance(q), 0) ** 2


def descend(q, steps=200):
    optimizer = optax.adam(0.01)

    def step(carry, _):
        q, state = carry
        update, state = optimizer.update(jax.grad(cost)(q), state)
        return (optax.apply_updates(q, update), state), None

    (q, _), _ = jax.lax.scan(step, (q, optimizer.init(q)), None, length=steps)
    return q


sol = ikjax.within_limits(arm, ikjax.solve(arm, goal))
ends = jax.jit(jax.vmap(descend))(sol.q)
costs, gaps = jax.vmap(cost)(ends), jax.vmap(clearance)(ends)
costs = jnp.where(sol.valid, costs, jnp.inf)
for name, start, end, gap in zip(arm.branches, jax.vmap(clearance)(sol.q), costs, gaps, strict=True):
    print(f"{name:18} seed {100 * start:6.1f} cm from the ball, end {100 * gap:6.1f} cm, cost {end:.1e}")
best = int(jnp.argmin(costs))
print("best:", arm.branches[best])
assert gaps[best] > 0.0 and costs[best] < 1e-6 and (costs > 1e-4).any()
