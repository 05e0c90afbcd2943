# %% [markdown]
# # Design an arm with gradients
#
# Which lengths should an arm have, and where should it stand? Every answer of `solve` has slopes in the
# arm's own numbers, so a better arm can be climbed to.

# %%
import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np

import ikjax

arm = ikjax.robots.planar_2r(0.9, 0.3)
r, turn = np.meshgrid(np.linspace(0.3, 1.0, 8), np.linspace(0, 2 * np.pi, 24, endpoint=False))
ring = ikjax.position(r.ravel() * np.cos(turn.ravel()), r.ravel() * np.sin(turn.ravel()), 0 * r.ravel())

# %% [markdown]
# ## A margin that shows the way in
#
# The task is a ring of points. `best_margin` says in metres how far a goal is from the edge of what the
# arm reaches: positive inside, negative outside, where no joints exist. Its slope in the lengths is what a
# study climbs.


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
# Equal links: then the hole in the middle closes, and 1.3 m is as far from the outer rim as the centre is
# from the inner one. Every start finds it:

# %%
fig, ax = plt.subplots(figsize=(7, 3))
ax.plot(1000 * lengths.history)
ax.set(xlabel="step", ylabel="worst margin [mm], blurred", title="four starts")
plt.show()

# %% [markdown]
# ## Where to stand
#
# The same arm, and a ring that is not around it. Base and tool move by twists; here the base may shift in the
# plane.

# %%
away = ring.at[:, 0, 3].add(0.8).at[:, 1, 3].add(-0.5)
vary = {"base.x": (-1, 1), "base.y": (-1, 1)}
placed = ikjax.design(lengths.arm, away, vary, "coverage", steps=150, starts=4)
print(placed.report())

# %% [markdown]
# ## How well it moves
#
# Yoshikawa's measure of every branch, with slopes that stay finite where the arm is straight.

# %%
measure = jax.jit(lambda q: ikjax.manipulability(lengths.arm, q))
bend = jnp.linspace(-np.pi, np.pi, 181)
q = jnp.stack([0 * bend, bend], -1)
slope = jax.grad(lambda q: measure(q).sum())(q)[:, 1]
fig, ax = plt.subplots(figsize=(7, 3))
ax.plot(bend, measure(q), label="manipulability")
ax.plot(bend, slope, label="its slope in the elbow")
ax.set(xlabel="elbow [rad]")
ax.legend()
plt.show()

# %%
assert np.abs(np.array(list(lengths.values.values())) - 0.65).max() < 5e-3
assert lengths.reached.all() and lengths.score > 0.29
assert placed.start_score < 0.7 and placed.reached.all()
assert np.isfinite(slope).all()
