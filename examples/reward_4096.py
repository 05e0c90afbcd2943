"""A reward over 4,096 environments: how near each goal is to the arm's reach, by closed form, in one jit."""

import time

import jax
import jax.numpy as jnp

import ikjax

arm = ikjax.load("ur5e").baked()
ENVIRONMENTS = 4096


@jax.jit
def reward(goals, q_now):
    """1 where a goal is reached within limits, less where joints move far; else minus the lacking metres."""
    sol = ikjax.within_limits(arm, ikjax.solve(arm, goals))
    q, found = ikjax.nearest(arm, sol, q_now)
    move = jnp.abs(q - q_now).max(-1)
    lacking = jnp.minimum(sol.margin.max(-1), 0)
    return jnp.where(found, 1 - 0.1 * move, lacking)


keys = jax.random.split(jax.random.key(0), 3)
xyz = jax.random.uniform(keys[0], (ENVIRONMENTS, 3), minval=-1.0, maxval=1.0)
rpy = jax.random.uniform(keys[1], (ENVIRONMENTS, 3), minval=-3.0, maxval=3.0)
q_now = jax.random.uniform(keys[2], (ENVIRONMENTS, 6), minval=-3.0, maxval=3.0)
goals = ikjax.pose(xyz, rpy=rpy)
rewards = reward(goals, q_now).block_until_ready()
start = time.perf_counter()
rewards = reward(goals, q_now).block_until_ready()
seconds = time.perf_counter() - start
print(f"{(rewards > 0).mean():.0%} of {ENVIRONMENTS} goals reached, mean reward {rewards.mean():.2f}")
print(f"{1e3 * seconds:.1f} ms for all")
assert rewards.shape == (ENVIRONMENTS,) and jnp.isfinite(rewards).all()
assert 0.1 < (rewards > 0).mean() < 0.9
