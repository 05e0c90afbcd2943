# %% [markdown]
# # Five joints, six coordinates
#
# A pose has six coordinates, an SO-101 has five joints. `project` returns the nearest pose that the arm can
# attain within its limits, with both errors, and with the gradient norm, which is zero at a local optimum.

# %%
import time

import jax
import matplotlib.pyplot as plt
import numpy as np
from scipy.optimize import least_squares

import ikjax
from ikjax import plot

jax.config.update("jax_enable_x64", True)
arm = ikjax.robots.so101()
low, high = np.array(arm.limits).T
print(ikjax.explain(arm))

# %% [markdown]
# ## Goal and attained pose
#
# Four goals at one point are turned more and more out of the plane of the arm. `characteristic_length` is the
# weight of a radian: here 50 mm. Thick axes are the goal, thin ones the attained pose.

# %%
turns = np.array([0.0, 0.4, 0.8, 1.2])
home = np.asarray(ikjax.fk(arm, np.array([0.3, 0.2, -0.3, 0.6, 0.2])))
goals = np.broadcast_to(home, (4, 4, 4)).copy()
for k, turn in enumerate(turns):
    c, s = np.cos(turn), np.sin(turn)
    goals[k, :3, :3] = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]) @ home[:3, :3]
near = ikjax.project(arm, goals, characteristic_length=0.05)
attained = np.asarray(ikjax.fk(arm, near.q))
for turn, gap, angle, norm in zip(
    turns, near.position_error, near.rotation_error, near.gradient_norm, strict=True
):
    print(f"turned by {turn:.1f} rad: {1000 * gap:5.1f} mm and {angle:.3f} rad off; gradient {norm:.0e}")

# %%
figure = plt.figure(figsize=(13, 3.8), layout="constrained")


def triad(ax, pose, size, **style):
    for column, color in zip(pose[:3, :3].T, ("tab:red", "tab:green", "tab:blue"), strict=True):
        line = np.stack([pose[:3, 3], pose[:3, 3] + size * column])
        ax.plot(*line.T, color=color, **style)


for k in range(4):
    ax = figure.add_subplot(1, 4, k + 1, projection="3d")
    plot.arm(arm, near.q[k], ax, color="0.5")
    triad(ax, goals[k], 0.12, lw=3, alpha=0.5)
    triad(ax, attained[k], 0.12, lw=1.2)
    ax.set_aspect("equal")
    ax.locator_params(nbins=4)
    ax.tick_params(labelsize=7)
    ax.set_title(f"goal turned by {turns[k]:.1f} rad", fontsize=10)
plt.show()

# %% [markdown]
# ## The weight of a radian
#
# A small `characteristic_length` favors the position, a large one the orientation. The two ends of the curve
# are the priorities: `priority="position"` and `priority="orientation"` minimize one error first.

# %%
goal = goals[3]
lengths = np.geomspace(0.002, 2, 25)
curve = jax.vmap(lambda length: ikjax.project(arm, goal, length))(lengths)
ends = {name: ikjax.project(arm, goal, priority=name) for name in ("position", "orientation")}
figure, ax = plt.subplots(figsize=(6, 4), layout="constrained")
ax.plot(1000 * np.asarray(curve.position_error), curve.rotation_error, ".-", color="0.3")
for length in (0.1, 0.3, 0.6):
    i = int(np.abs(lengths - length).argmin())
    ax.annotate(
        f"length {lengths[i]:.2f} m",
        (1000 * float(curve.position_error[i]), float(curve.rotation_error[i])),
        xytext=(8, 6),
        textcoords="offset points",
    )
for (name, end), mark in zip(ends.items(), "os", strict=True):
    ax.plot(1000 * end.position_error, end.rotation_error, mark, ms=9, mfc="none", label=f"{name} first")
ax.set_xlabel("position error [mm]")
ax.set_ylabel("rotation error [rad]")
ax.legend()
plt.show()

# %% [markdown]
# ## Against many starts of a local solver
#
# Fifty goals are spread around the arm. The rival is the best result of scipy's bounded least squares from
# sixteen random starts for each goal.

# %%
rng = np.random.default_rng(0)
wild = np.array(ikjax.fk(arm, rng.uniform(low, high, (50, 5))))
wild[:, :3, 3] += 0.05 * rng.normal(size=(50, 3))
spin = ikjax.pose(xyz=np.zeros((50, 3)), rpy=rng.normal(0, 0.4, (50, 3)))
wild[:, :3, :3] = np.asarray(spin)[:, :3, :3] @ wild[:, :3, :3]
ours = jax.block_until_ready(ikjax.project(arm, wild, characteristic_length=0.05))
started = time.perf_counter()
jax.block_until_ready(ikjax.project(arm, wild, characteristic_length=0.05).cost)
seconds = time.perf_counter() - started


@jax.jit
def residual(q, goal):
    pose = ikjax.fk(arm, q)
    return jax.numpy.concatenate([pose[:3, 3] - goal[:3, 3], 0.05 * turn_between(pose, goal)])


def turn_between(pose, goal):
    """The rotation vector from goal to pose."""
    turn = pose[:3, :3] @ goal[:3, :3].T
    sine = jax.numpy.stack([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]]) / 2
    size = jax.numpy.linalg.norm(sine) + 1e-300
    return sine / size * jax.numpy.arctan2(size, (jax.numpy.trace(turn) - 1) / 2)


jacobian = jax.jit(jax.jacfwd(residual))
starts = rng.uniform(low, high, (16, 5))
started = time.perf_counter()
theirs = [
    min(2 * least_squares(residual, q, jacobian, bounds=(low, high), args=(goal,)).cost for q in starts)
    for goal in wild
]
rival = time.perf_counter() - started
gain = np.asarray(ours.cost) / np.array(theirs) - 1
print(f"project: {1e3 * seconds / 50:.2f} ms a goal; scipy: {1e3 * rival / 50:.0f} ms a goal")
print(f"farther than scipy's best: {(gain > 1e-6).sum()} of 50; nearer: {(gain < -1e-6).sum()} of 50")
assert np.asarray(ours.converged).all()

# %% [markdown]
# ## A path
#
# The tool draws a horizontal circle with its first orientation, as nearly as five joints can. `track` stays
# on one branch from step to step, and reports where it had to jump to another or could not follow.

# %%
angle = np.linspace(0, 2 * np.pi, 120)
start = np.array([0, 0, 0, 0.8, 0])
path = np.broadcast_to(np.asarray(ikjax.fk(arm, start)), (120, 4, 4)).copy()
path[:, :3, 3] += 0.04 * np.stack([np.cos(angle) - 1, np.sin(angle), 0 * angle], -1)
drawn = ikjax.track(arm, path, start, characteristic_length=0.005)
print(f"{int(drawn.jumped.sum())} jumps; off by {1000 * float(drawn.position_error.max()):.2f} mm at most,")
print(f"and turned by up to {np.rad2deg(float(drawn.rotation_error.max())):.1f} degrees")
pen = np.asarray(ikjax.fk(arm, drawn.q))[:, :3, 3]

# %%
figure, (left, right) = plt.subplots(1, 2, figsize=(10, 3.6), layout="constrained")
left.plot(*path[:, :2, 3].T, color="0.7", lw=4, label="goal")
left.plot(*pen[:, :2].T, color="tab:blue", lw=1.2, label="drawn")
left.set_aspect("equal")
left.set_xlabel("x [m]")
left.set_ylabel("y [m]")
left.legend()
for joint, row in enumerate(np.asarray(drawn.q).T):
    right.plot(np.arange(120), row, label=f"joint {joint + 1}")
right.set_xlabel("step")
right.set_ylabel("angle [rad]")
right.legend(ncols=3, fontsize=8)
plt.show()
assert not drawn.jumped.any() and float(drawn.position_error.max()) < 1e-3
