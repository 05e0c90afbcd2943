"""A mask of one's own over branches: here a wall, checked on every joint of every branch."""

import jax

jax.config.update("jax_enable_x64", True)

import jax.numpy as jnp

import ikjax

arm = ikjax.load("ur5e")
goal = ikjax.pose(xyz=(0.35, 0.25, 0.2), rpy=(3.1, 0, 0.6))
sol = ikjax.within_limits(arm, ikjax.solve(arm, goal))


def clear_of_the_wall(q):  # any checker that takes joints: (..., n) -> (...) bool
    """Whether elbow and wrists stay in front of a wall at x = 0.45 m, and above the table."""
    points = ikjax.frames(arm, q)[..., 2:, :3, 3]
    return ((points[..., 0] < 0.45) & (points[..., 2] > 0.02)).all(-1)


free = sol.where(clear_of_the_wall(sol.q))
q, found = ikjax.nearest(arm, free, q_now=jnp.zeros(6))
print(f"{sol.valid.sum()} branches, {free.valid.sum()} of them clear of the wall; found: {found}")
print(q.round(3))
assert found and 0 < free.valid.sum() < sol.valid.sum() and clear_of_the_wall(q)
