# %% [markdown]
# # Fifty holes and a longer tool
#
# A UR5e stands on a table and drills. Which holes are within its reach, straight down and at any roll? What
# does a drill that is 20 cm longer change, and which joint's limits cost something? Where should the robot
# stand? The same questions are answered by study files and the command alone in `docs/how-to/cell.md`.

# %%
import dataclasses

import matplotlib.pyplot as plt
import numpy as np

import ikjax
from ikjax import plot

# %% [markdown]
# ## The cell
#
# A tool is one more transform behind the flange. Hoses along the arm let its first joint turn by 120 degrees
# either way and its shoulder lean to level; these are limits like any others.

# %%
bare = ikjax.robots.ur5e().astype(np.float32)
ranges = [(-120, 120), (-180, 0), (-150, 150), (-170, 170), (-170, 170), (-170, 170)]
bare = dataclasses.replace(bare, limits=np.radians(ranges, dtype=np.float32))


def with_drill(length):
    """The arm with a drill straight out of its flange, its tip `length` away [m]."""
    tool = np.asarray(bare.tool) @ np.asarray(ikjax.pose(xyz=(0, 0, length)), np.float32)
    return dataclasses.replace(bare, tool=tool)


short, long = with_drill(0.15), with_drill(0.35)

x, y = np.meshgrid(np.linspace(0.4, 0.95, 10), np.linspace(-0.3, 0.3, 5), indexing="ij")
holes = np.stack([x, y, np.full_like(x, 0.05)], -1).reshape(-1, 3)
goals = np.asarray(ikjax.pose(xyz=holes, rpy=np.tile((np.pi, 0, 0), (50, 1))), np.float32)

# %% [markdown]
# ## What of the table is within reach
#
# A sweep of one layer: the tool points down, and of twelve rolls one must do. `limited_by` counts per joint
# what is lost to its limits alone.

# %%
table = ikjax.maps.grid((-1, -1, 0.05), (1, 1, 0.05), 0.04)
down = ikjax.maps.cone((0, 0, -1), 0.0, 1)
counted = ["reachable", "reachable_within", "limited_by"]
study = {"free_rolls": 12, "statistics": counted}
maps = [
    ikjax.sweep(arm, table, down, **study, title=title)
    for arm, title in ((short, "drill of 15 cm"), (long, "drill of 35 cm"))
]
plot.plan(maps[0], goals=goals)
plt.show()

# %% [markdown]
# The second sweep compiled nothing: where an arm stands, its tool and its limits are data of the program.
# Both maps in one picture:

# %%
plot.comparison(*maps, goals=goals)
plt.show()
areas = [float((reach.reachable_within > 0).sum() * 0.04**2) for reach in maps]
print(f"{areas[0]:.2f} m^2 with the short drill, {areas[1]:.2f} m^2 with the long one")

# %% [markdown]
# ## Hole by hole
#
# `free_roll` says at which rolls a goal is reached. A hole needs one of them.

# %%
drillable = []
for arm in (short, long):
    share = ikjax.free_roll(arm, goals, 24).reached.any(-1)
    drillable.append(share)
    print(f"{share.sum()} of 50 holes")
lost = int(np.flatnonzero(drillable[0] & ~drillable[1])[0])
print(f"hole {lost} at {holes[lost].round(2)} is lost to the longer drill:")
print(ikjax.explain(long, goals[lost]))

# %% [markdown]
# ## Which joint's limits cost something
#
# Positions that are reached but for one joint's limits.

# %%
plot.limit_costs(maps[1])
plt.show()

# %% [markdown]
# ## Where should the robot stand?
#
# The long drill, all fifty holes, any of six rolls, and 15 cm away from every hole. Candidates are counted on
# a grid; notebook 6 polishes them by gradient ascent.

# %%
bases = ikjax.place(
    long,
    goals,
    bounds={"x": (-0.4, 1.6), "y": (-1.0, 1.0)},
    parts=holes,
    clearance=0.15,
    free_rolls=6,
    spacing=0.1,
    turns=6,
    starts=4,
    steps=0,
    keep=3,
)
print(bases)
placed = dataclasses.replace(long, base=bases.base[0])

# %%
print(f"{drillable[1].sum()} holes before, {int(bases.reached[0].sum())} after")
assert areas[0] > areas[1] > 0.5
assert drillable[0].sum() > drillable[1].sum() > 10
assert bases.reached[0].sum() > drillable[1].sum()
sol = ikjax.solve(placed, goals[bases.reached[0]] @ np.asarray(bases.alternatives, np.float32)[:, None])
assert np.asarray(ikjax.within_limits(placed, sol).valid).any((0, -1)).all()
