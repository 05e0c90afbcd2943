# %% [markdown]
# # Where should the robot stand?
#
# A part has to be reached all over. The arm is given, the place of its base is not. `ikjax.place` counts the
# goals that are reached from every candidate on a grid, and polishes the best ones by gradient ascent.

# %%
import dataclasses

import matplotlib.pyplot as plt
import numpy as np

import ikjax
from ikjax import plot

arm = ikjax.robots.ur5e().astype(np.float32)

# %% [markdown]
# ## The task
#
# There are two pieces on a long bench, with five and four rows of points. At each point the tool points down
# and is tilted by about 30 degrees to four sides.

# %%
ends = (0.0, 0.6, 5), (1.6, 2.1, 4)
pieces = [np.meshgrid(np.linspace(*end), np.linspace(-0.25, 0.25, 4)) for end in ends]
x, y = (np.concatenate([piece[k].ravel() for piece in pieces]) for k in (0, 1))
xyz = np.stack([x, y, np.full_like(x, 0.15)], -1)
leaning = [(np.pi + 0.5, 0, 0), (np.pi - 0.5, 0, 0), (np.pi, 0.5, 0), (np.pi, -0.5, 0)]
lean = ikjax.pose(xyz=np.zeros((4, 3)), rpy=leaning)
goals = np.broadcast_to(lean, (*x.shape, 4, 4, 4)).astype(np.float32).copy()
goals[..., :3, 3] = xyz[:, None]
print(goals.shape[:-2], "goals: points, orientations")

# %% [markdown]
# ## A place for the base
#
# The base may shift along the floor, but not into the bench: it stays 0.45 m away from its middle. Turning it
# changes nothing, because the first joint of a UR5e has a range of two turns, and `place` takes that into
# account. One program serves all candidates, because moving the base is the same as moving the goals back.

# %%
floor = {"x": (-0.5, 2.6), "y": (-1.15, -0.45)}
bases = ikjax.place(arm, goals, bounds=floor, spacing=0.1, keep=4)
print(bases)

# %% [markdown]
# ## The map
#
# The picture shows the share of the goals that is reached from each position. Crosses are points of the task,
# circles the best candidates of the grid, and numbers are the polished bases.

# %%
fig, ax = plt.subplots(figsize=(8.5, 4.6), layout="constrained")
gx, gy = bases.grid.axis(0), bases.grid.axis(1)
image = ax.pcolormesh(gx, gy, bases.tried[:, :, 0, 0].T, cmap="Blues", vmin=0)
ax.plot(x.ravel(), y.ravel(), "x", color="0.3", ms=5)
for k, (before, after) in enumerate(zip(bases.start, bases.base, strict=True)):
    ax.plot(*before[:2, 3], "o", mfc="none", color="black", ms=5)
    arrow = {"arrowstyle": "-", "color": "#d55e00"}
    ax.annotate("", after[:2, 3], before[:2, 3], arrowprops=arrow)
    ax.text(*after[:2, 3], str(k + 1), color="#d55e00", weight="bold", ha="center", va="center")
ax.set(aspect="equal", xlabel="x of the base [m]", ylabel="y of the base [m]", ylim=(-1.15, 0.35))
fig.colorbar(image, label="share of goals reached", shrink=0.8)
plt.show()

# %% [markdown]
# ## Before and after polishing
#
# A count has no useful gradient, because it is constant between its steps. Margins have one: they are the
# distance of a goal from the boundary of what is reached, in metres, outside too, and they include joint
# limits. Polishing follows their gradient and keeps the best base by the exact count. So nothing gets worse.

# %%
fig, axes = plt.subplots(1, 2, figsize=(8.5, 3), layout="constrained")
number = np.arange(1, len(bases) + 1)
count = bases.reached[0].size
for ax, before, after, what in [
    (axes[0], count * bases.start_share, count * bases.share, f"goals reached of {count}"),
    (axes[1], count * bases.start_score, count * bases.score, "score, in goals"),
]:
    ax.plot([number, number], [before, after], color="0.7", zorder=1)
    ax.plot(number, before, "o", color="0.5", label="on the grid")
    ax.plot(number, after, "o", color="#0072b2", label="polished")
    ax.set(xlabel="base", ylabel=what, xticks=number, xlim=(0.5, len(bases) + 0.5))
axes[0].legend(loc="lower left")
plt.show()

# %% [markdown]
# ## The arm where it should stand
#
# `dataclasses.replace(arm, base=...)` moves the arm, and `solve` shows which points are reached in all four
# orientations, and which in some.

# %%
best = dataclasses.replace(arm, base=bases.base[0])
sol = ikjax.within_limits(best, ikjax.solve(best, goals))
reached = np.asarray(sol.valid.any(-1))
q, found = ikjax.nearest(best, sol, np.array([0, -1.5, 1.5, -1.5, -1.5, 0], np.float32))
fig = plt.figure(figsize=(7, 5.2), layout="constrained")
ax = fig.add_subplot(projection="3d")
ax.set(xlim=(-0.3, 2.3), ylim=(-1.2, 0.6), zlim=(0, 1.0), xlabel="x [m]", ylabel="y [m]", zlabel="z [m]")
ax.set_box_aspect((2.6, 1.8, 1.0), zoom=1.1)
share = reached.mean(-1)
whole = np.flatnonzero(share == 1)
for point, color in ((whole[0], "#0072b2"), (whole[-1], "#cc79a7")):
    plot.arm(best, q[point, 0], ax, color=color)
for where, color, label in [
    (share == 1, "#009e73", "reached from all four sides"),
    ((share > 0) & (share < 1), "#e69f00", "from some"),
    (share == 0, "#d55e00", "from none"),
]:
    if where.any():
        ax.scatter(*xyz[where].T, color=color, s=14, label=label)
ax.legend(loc="upper left")
plt.show()

# %% [markdown]
# ## From a map
#
# If there is a reach map of the arm, goals are looked up in it instead of solved: inverse reachability. The
# candidates are then as accurate as the map; the returned bases are still evaluated by `solve`.

# %%
around = ikjax.maps.around(arm, spacing=0.08)
reach = ikjax.sweep(arm, around, ikjax.maps.hopf(1), statistics=("reachable_within", "mask_within"))
looked = ikjax.place(arm, goals, reach_map=reach, bounds=floor, spacing=0.1, keep=4)
print(looked)
gap = np.abs(looked.tried - bases.tried)
print(f"map against solving: {gap.mean():.1%} of goals apart in the mean, {gap.max():.1%} at most")

# %%
np.testing.assert_array_equal(reached, bases.reached[0])
assert (bases.score >= bases.start_score).all()
assert gap.mean() < 0.05
assert abs(looked.share[0] - bases.share[0]) < 0.05
