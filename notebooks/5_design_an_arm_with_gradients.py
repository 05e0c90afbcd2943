# %% [markdown]
# # Design an arm with gradients
#
# Which lengths should an arm have, and where should it stand? Every answer of `solve` has derivatives with
# respect to the arm's own numbers, so an arm can be improved by gradient ascent.

# %%
import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np

import ikjax
from ikjax import plot

arm = ikjax.robots.planar_2r(0.9, 0.3)
r, turn = np.meshgrid(np.linspace(0.3, 1.0, 8), np.linspace(0, 2 * np.pi, 24, endpoint=False))
ring = ikjax.position(r.ravel() * np.cos(turn.ravel()), r.ravel() * np.sin(turn.ravel()), 0 * r.ravel())

# %% [markdown]
# ## The margin has a gradient outside the workspace too
#
# The task is a ring of points. `best_margin` is the distance in metres of a goal from the boundary of the
# workspace: positive inside, negative outside, where no joints exist. A study follows its gradient with
# respect to the lengths.


# %%
def field(arm, x, y):
    goals = ikjax.position(x, y, 0 * x)
    return ikjax.best_margin(arm, ikjax.solve(arm, goals))


def show(arms):
    line = jnp.linspace(-1.3, 1.3, 101)
    x, y = jnp.meshgrid(line, line)
    fig, axes = plt.subplots(1, len(arms), figsize=(4.6 * len(arms), 4), layout="constrained")
    for ax, (title, arm) in zip(axes, arms.items(), strict=True):
        best = np.asarray(field(arm, x, y))
        image = ax.contourf(line, line, best, np.linspace(-0.4, 0.4, 17), cmap="RdBu", extend="both")
        ax.contour(line, line, best, [0], colors="black")
        ax.plot(ring[:, 0, 3], ring[:, 1, 3], ".", color="black", ms=3)
        ax.set(title=title, aspect="equal", xlabel="x [m]", ylabel="y [m]")
    fig.colorbar(image, ax=axes, label="best margin [m]")
    plt.show()


# %% [markdown]
# ## Two lengths
#
# Both links may be 0.1 to 1 m long, and 1.3 m together. What clearance can the worst point of the ring have?

# %%
print("free to move:", ", ".join(arm.free))
lengths = ikjax.design(
    arm, ring, {"a": (0.1, 1.0)}, "worst_margin", ties=["a1 + a2 = 1.3"], steps=200, starts=4
)
print(lengths.report())
show({"as given": arm, "designed": lengths.arm})

# %% [markdown]
# The links become equal. The hole in the middle then closes, and the clearance is the same at the outer and
# the inner rim. Every start finds this optimum:

# %%
fig, ax = plt.subplots(figsize=(7, 3))
ax.plot(1000 * lengths.history)
ax.set(xlabel="step", ylabel="worst margin [mm], blurred", title="four starts")
plt.show()

# %% [markdown]
# ## Where to stand
#
# The same arm, with a ring that is not around it. Base and tool can move by twists; here the base may shift
# in the plane.

# %%
away = ring.at[:, 0, 3].add(0.8).at[:, 1, 3].add(-0.5)
vary = {"base.x": (-1, 1), "base.y": (-1, 1)}
placed = ikjax.design(lengths.arm, away, vary, "coverage", steps=150, starts=4)
print(placed.report())

# %% [markdown]
# ## How well it moves
#
# Yoshikawa's manipulability, with a gradient that stays finite where the arm is straight.

# %%
measure = jax.jit(lambda q: ikjax.manipulability(lengths.arm, q))
bend = jnp.linspace(-np.pi, np.pi, 181)
q = jnp.stack([0 * bend, bend], -1)
gradient = jax.grad(lambda q: measure(q).sum())(q)[:, 1]
fig, ax = plt.subplots(figsize=(7, 3))
ax.plot(bend, measure(q), label="manipulability")
ax.plot(bend, gradient, label="its derivative in the elbow")
ax.set(xlabel="elbow [rad]")
ax.legend()
plt.show()

# %% [markdown]
# ## A PUMA with a metre to spend
#
# Where in the box around it does an arm of six joints reach half of all orientations, within its limits? The
# goals are 256 points in sixteen orientations each. Five lengths vary, with a sum of one metre.


# %%
def dexterous(points, seed):
    goals = np.tile(np.eye(4), (points, 16, 1, 1))
    goals[:, :, :3, 3] = np.random.default_rng(seed).uniform(-1, 1, (points, 3))[:, None]
    goals[:, :, :3, :3] = ikjax.maps.even_rotations(16)
    return jnp.asarray(goals, jnp.float32)


puma = ikjax.robots.puma560()
vary = {"a1": (-0.02, 0.3), "a2": (0.1, 0.7), "a3": (0.005, 0.2), "d3": (0.005, 0.3), "d4": (0.1, 0.7)}
metre = ikjax.design(
    puma,
    dexterous(256, 1),
    vary,
    "dexterous_share",
    ties=["a1 + a2 + a3 + d3 + d4 = 1"],
    steps=60,
    starts=4,
    limits=True,
    blur=(0.1, 0.01),
)
print(metre.report(most=3))

# %% [markdown]
# The score counts the points that the study was optimized for. A sweep counts others: a grid over the same
# box, with 64 orientations.

# %%
box = ikjax.maps.grid((-1, -1, -1), (1, 1, 1), 0.1)
before, after = (ikjax.sweep(each, box, 64) for each in (puma, metre.arm))
half = [float((each.reachable_within >= 32).mean()) for each in (before, after)]
print(f"half of all orientations: {half[0]:.1%} of the box before, {half[1]:.1%} after")
plot.comparison(before, after)
plt.show()

# %% [markdown]
# ## Before a workpiece
#
# A UR5e cannot reach all of a barrel two metres long. Where should it stand, and how should the tool be
# mounted? 10,000 goals point at the barrel's side; base and tool have six coordinates each.

# %%
along, around = (x.ravel() for x in np.meshgrid(np.linspace(-1, 1, 100), np.linspace(-1.2, 1.2, 100)))
out = np.stack([-np.cos(around), 0 * around, np.sin(around)], -1)
barrel = np.tile(np.eye(4), (len(along), 1, 1))
barrel[:, :3, 3] = np.array([1.0, 0, 0.4]) + 0.5 * out + np.stack([0 * along, along, 0 * along], -1)
barrel[:, :3, 2], barrel[:, :3, 1] = -out, [0, 1, 0]
barrel[:, :3, 0] = np.cross(barrel[:, :3, 1], barrel[:, :3, 2])
barrel = jnp.asarray(barrel, jnp.float32)
vary = {
    "base.xyz": (-0.5, 0.5), "base.turn": (-1.5, 1.5), "tool.xyz": (-0.15, 0.15), "tool.turn": (-1, 1),
}  # fmt: skip
ur5e = ikjax.robots.ur5e()
stood = ikjax.design(ur5e, barrel, vary, "coverage", steps=60, starts=4, batch=2500, blur=(0.2, 0.005))
reached = [np.asarray(ikjax.solve(each, barrel).valid.any(-1)) for each in (ur5e, stood.arm)]
print(f"{reached[0].mean():.1%} of the barrel as given, {reached[1].mean():.1%} as placed")
fig, axes = plt.subplots(1, 2, figsize=(8, 3), sharey=True)
for ax, flag, title in zip(axes, reached, ("as given", "as placed"), strict=True):
    ax.imshow(
        flag.reshape(100, 100), extent=(-1, 1, -1.2, 1.2), origin="lower", aspect="auto", cmap="cividis"
    )
    ax.set(title=f"{title}: {flag.mean():.0%}", xlabel="along the barrel [m]")
axes[0].set_ylabel("around it [rad]")
plt.show()

# %% [markdown]
# `python benchmarks/design.py` compares these studies with random search and differential evolution.

# %%
assert np.abs(np.array(list(lengths.values.values())) - 0.65).max() < 5e-3
assert lengths.reached.all() and lengths.score > 0.29
assert placed.start_score < 0.7 and placed.reached.all()
assert np.isfinite(gradient).all()
assert half[1] > 1.2 * half[0]
assert reached[1].mean() > reached[0].mean() + 0.2
