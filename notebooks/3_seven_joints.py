# %% [markdown]
# # Seven joints: the elbow that is free
#
# A pose asks for six numbers, a Franka has seven joints. So it reaches a goal in a family of postures, its
# self-motion. `solve` is given the value of one joint and returns every branch at it.

# %%
import dataclasses

import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np

import ikjax
from ikjax import maps, plot

jax.config.update("jax_enable_x64", True)
arm = ikjax.robots.fer()
q = np.array([0.2, -0.4, 0.1, -1.9, 0.3, 1.8, 0.5])
goal = ikjax.fk(arm, q)
sol = ikjax.solve(arm, goal, redundancy=q[6])
inside = ikjax.within_limits(arm, sol)
print(
    f"{arm.redundant[0]} given: {int(sol.valid.sum())} of 8 branches, {int(inside.valid.sum())} within limits"
)

# %% [markdown]
# ## The self-motion
#
# Thick lines are within the joint limits. The ends of these parts are found by bisection, not by samples.

# %%
curve = ikjax.self_motion(arm, goal, samples=256)
print(curve)
figure = plot.self_motion(arm, curve)
plt.show()

# %% [markdown]
# Some postures of one part, from one end to the other: the hand stands still, the elbow moves.

# %%
slot = 2
low, high = np.asarray(curve.parts)[slot, 0]
part = np.flatnonzero(np.asarray(curve.within)[slot])
postures = np.asarray(curve.q)[slot, part[:: len(part) // 5]]
figure = plt.figure(figsize=(6, 5), layout="constrained")
ax = figure.add_subplot(projection="3d")
for posture, color in zip(postures, plt.get_cmap("viridis")(np.linspace(0, 1, len(postures))), strict=True):
    plot.arm(arm, posture, ax, color=color)
ax.set_aspect("equal")
plt.show()

# %% [markdown]
# ## A gradient that moves the elbow
#
# `solve` has a derivative by the redundant joint: the tangent of the self-motion. Here it raises the elbow,
# the origin of the frame after joint 4, as far as the limits allow.


# %%
@jax.jit
def along(r):
    """The joints at a value of joint 7, and their rate along the self-motion."""
    return jax.jvp(lambda r: ikjax.solve(arm, goal, redundancy=r).q[slot], (r,), (jnp.ones_like(r),))


def elbow_height(q):
    return ikjax.frames(arm, q)[..., 4, 2, 3]


slope = jax.jit(jax.grad(elbow_height))
r, heights = jnp.asarray(low + 0.1), []
for _ in range(60):
    joints, rate = along(r)
    heights.append(float(elbow_height(joints)))
    r = jnp.clip(r + 0.1 * slope(joints) @ rate, low + 1e-3, high - 1e-3)
best = float(elbow_height(curve.q[slot, part]).max())
print(f"elbow from {heights[0]:.4f} m to {heights[-1]:.4f} m; the highest sample of the curve: {best:.4f} m")
still = ikjax.jacobian(arm, joints) @ rate
print(f"the hand moves by {float(jnp.abs(still).max()):.0e} a radian of joint 7")

# %% [markdown]
# ## A map, and the same arm with joint 7 at zero
#
# A goal counts where one of 32 values of joint 7 reaches it within the limits. With joint 7 fixed at zero, as
# on an arm of six joints, many orientations are lost.

# %%
spacing = 0.1
box = maps.grid((-0.8, 0.0, -0.3), (0.8, 0.0, 1.1), spacing)
one = np.array(arm.limits)
one[6] = -1e-3, 1e-3  # one value, the middle, is tried
options = {"dtype": "float32", "statistics": ["reachable_within", "mask_within"]}
free = ikjax.sweep(arm, box, 128, **options)
stuck = ikjax.sweep(dataclasses.replace(arm, limits=one), box, 128, redundancy_samples=1, **options)
figure, axes = plt.subplots(1, 2, figsize=(9, 4), layout="constrained", sharey=True)
for ax, reach, name in zip(axes, (free, stuck), ("32 values of joint 7", "joint 7 at zero"), strict=True):
    shown = ax.imshow(
        reach.dexterity[:, 0].T, origin="lower", vmin=0, vmax=1, extent=(-0.85, 0.85, -0.35, 1.15)
    )
    ax.set(title=name, xlabel="x [m]", ylabel="z [m]")
figure.colorbar(shown, ax=axes, label="share of orientations within limits")
plt.show()
shares = free.reached().mean(), stuck.reached().mean()
print(f"{shares[0]:.1%} of all goals with joint 7 free, {shares[1]:.1%} with joint 7 at zero")

# %%
assert curve.is_part[slot].any() and heights[-1] > heights[0] + 1e-3
assert float(jnp.abs(still).max()) < 1e-8
assert shares[0] > 1.5 * shares[1] > 0
