# %% [markdown]
# # Eight ways to touch a point
#
# A six-joint arm can usually put its tool at a pose in eight ways. `ikjax` returns all of them, in slots that
# always mean the same branch, with a mask of the valid ones.

# %%
import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np

import ikjax
from ikjax import plot

puma = ikjax.robots.puma560()
print(puma)

# %% [markdown]
# The arm is a DH table. The closed form that solves it is chosen once, when the arm is built:

# %%
print(ikjax.explain(puma))

# %% [markdown]
# ## One goal, eight branches

# %%
goal = ikjax.pose(xyz=(0.4, 0.2, 0.3), rpy=(3.14, 0, 0.6))
sol = ikjax.solve(puma, goal)
for name, q, valid, margin in zip(puma.branches, sol.q, sol.valid, sol.margin, strict=True):
    print(f"{name:18} valid {bool(valid)!s:5}  margin {1000 * margin:4.0f} mm  {np.degrees(q).round(1)}")

# %%
plot.branches(puma, goal)
plt.show()

# %% [markdown]
# `valid` is measured by forward kinematics, never assumed. `margin` is the distance in metres to the fold
# where the branch ends. As the goal moves away, it shrinks, reaches zero and becomes negative.

# %%
away = jnp.linspace(0.3, 1.1, 161)
line = ikjax.pose(xyz=jnp.stack([away, 0.2 + 0 * away, 0.3 + 0 * away], -1), rpy=(3.14, 0, 0.6))
along = ikjax.solve(puma, line)
fig, ax = plt.subplots(figsize=(7, 3.2))
ax.axhline(0, color="0.6", lw=1)
best, reached = np.asarray(along.margin.max(-1)), np.asarray(along.valid.any(-1))
ax.plot(away, best, color="0.75", lw=3)
ax.plot(away[reached], best[reached], color="#0072b2", lw=3)
ax.set(xlabel="x of the goal [m]", ylabel="best margin [m]", title="blue: reached")
plt.show()
assert (reached == (best >= -1e-4)).all()

# %% [markdown]
# ## A UR5: another family, the same call
#
# It has three parallel axes instead of a spherical wrist. Nothing changes for the user.

# %%
ur5 = ikjax.robots.ur5()
plot.branches(ur5, goal)
plt.show()
print("valid:", np.asarray(ikjax.solve(ur5, goal).valid))

# %% [markdown]
# ## Joint limits, and the branch that moves least

# %%
inside = ikjax.within_limits(puma, sol)
print(int(sol.valid.sum()), "branches,", int(inside.valid.sum()), "of them within the joint limits")
q, found = ikjax.nearest(puma, inside, q_now=jnp.radians(jnp.array([0, 90, -90, 0, 45, 0.0])))
print("nearest:", np.degrees(q).round(1), "found:", bool(found))

# %% [markdown]
# ## Many goals, in jit
#
# Inside a jit `solve` is a plain elementwise graph: results that are not used are never computed.

# %%
count = jax.jit(lambda goals: ikjax.solve(puma, goals).valid.sum(-1))
q = jax.random.uniform(jax.random.key(0), (20_000, 6), minval=-jnp.pi, maxval=jnp.pi)
solutions = np.bincount(count(ikjax.fk(puma, q)), minlength=9)
print("goals by number of solutions:", solutions)

# %% [markdown]
# ## A singularity has an answer
#
# With the fifth joint at zero, joints four and six turn about the same line, and one of them is arbitrary.
# The slot says so (`continuum`), and `q_now` chooses the value.

# %%
straight = ikjax.fk(puma, jnp.array([0.3, 0.5, -0.8, 0.7, 0.0, 0.2]))
for q4 in (0.0, 0.7):
    one = ikjax.solve(puma, straight, q_now=jnp.array([0, 0, 0, q4, 0, 0.0]))
    print("asked for q4 =", q4, "got", np.asarray(one.q[one.continuum & one.valid][:, 3]).round(3))

# %%
assert bool(sol.valid.all()) and puma.branches[0] == "front/up/noflip"
assert solutions[1:].sum() >= 19_990  # float32 may miss a goal that lies on a fold
assert bool(one.continuum.any())
