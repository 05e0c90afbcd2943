# %% [markdown]
# # A million goals before coffee
#
# Where does an arm reach, and in how many orientations? A sweep answers this for every position of a grid and
# every orientation of a set. It is stored while it runs, and it can be continued after a crash.

# %%
import importlib.util
import os
import pathlib
import subprocess
import sys
import tempfile

import matplotlib.pyplot as plt
import numpy as np

import ikjax
from ikjax import plot

arm = ikjax.robots.puma560().astype(np.float32)
grid = ikjax.maps.around(arm, spacing=0.1)
print(f"{grid.in_words()} x 96 orientations = {grid.count * 96:,} goals")

# %% [markdown]
# ## The sweep
#
# Goals are made from their index inside the compiled loop, solved there and counted there. Only the counts
# leave the loop.

# %%
reach = ikjax.sweep(arm, grid, orientations=96)
print(reach.summary())

# %% [markdown]
# ## Kill it
#
# The same sweep is stored in a folder, in small units, by a process of its own. When it has computed a third
# of them, it is killed by SIGKILL, which no handler can catch.

# %%
folder = pathlib.Path(tempfile.mkdtemp())
out = folder / "reach.zarr"
code = f"""
import os, signal
import numpy as np
import ikjax

units = 0
def kill(unit_done):
    global units
    units += unit_done
    if units == 9:
        os.kill(os.getpid(), signal.SIGKILL)

arm = ikjax.robots.puma560().astype(np.float32)
ikjax.sweep(arm, ikjax.maps.around(arm, spacing=0.1), 96, chunk=(8, 8, 8), out={str(out)!r}, stop=kill)
"""
root = str(pathlib.Path(ikjax.__file__).parent.parent)
child = subprocess.run([sys.executable, "-c", code], env={**os.environ, "PYTHONPATH": root})
print("the process ended with", child.returncode, "(minus nine is SIGKILL)")

# %% [markdown]
# What is stored is intact, and the map says that it is incomplete:

# %%
try:
    ikjax.ReachMap.load(out)
except ValueError as error:
    refusal = str(error).replace(str(folder), "...")
    print(refusal)

# %% [markdown]
# ## Continue
#
# Units that can be read are kept, all others are computed.

# %%
resumed = ikjax.sweep(arm, grid, 96, chunk=(8, 8, 8), out=out, resume=True)
print(resumed.units)

# %% [markdown]
# ## The same bits
#
# Every statistic is equal to that of the undisturbed sweep, bit by bit. A damaged chunk is found by its
# checksum and computed again.

# %%
undisturbed, gone_on = reach.to_numpy(), resumed.to_numpy()
identical = {name: undisturbed[name].tobytes() == gone_on[name].tobytes() for name in undisturbed}
print(identical)

chunk = max((out / "reachable").rglob("c/*/*/*"), key=lambda path: path.stat().st_size)
broken = bytearray(chunk.read_bytes())
broken[len(broken) // 2] ^= 1
chunk.write_bytes(broken)
mended = ikjax.sweep(arm, grid, 96, chunk=(8, 8, 8), out=out, resume=True)
print(mended.units)

# %% [markdown]
# ## Pictures
#
# Slices are colored by the share of orientations that are reached within the joint limits. Grey positions are
# reached only beyond the limits.

# %%
plot.reach_map(mended)
plt.show()

# %%
plot.reach_map(mended, slices=[("z", 0.6), ("z", 0.2), ("z", -0.2), ("x", 0.0)])
plt.show()

# %% [markdown]
# ## In xarray
#
# A map is a table of arrays with axes in metres (`pip install "ikjax[xarray]"`).

# %%
if importlib.util.find_spec("xarray"):
    data = mended.to_xarray()
    print(data)
    share = data.reachable_within / mended.orientation_count
    fig, axes = plt.subplots(1, 2, figsize=(9, 3.6), layout="constrained")
    bar = {"label": "best share at any height"}
    share.max("z").T.plot(ax=axes[0], cmap="viridis", cbar_kwargs=bar)
    middle, bar = data.best_margin.sel(y=0, method="nearest"), {"label": "best margin [m]"}
    middle.where(middle > 0).T.plot(ax=axes[1], cmap="viridis", cbar_kwargs=bar)
    for ax, title in zip(axes, ("from above", "the plane y = 0"), strict=True):
        ax.set(title=title, aspect="equal")
    plt.show()

# %%
assert reach.goals > 1_000_000
assert child.returncode == -9
assert 0 < resumed.units.kept < 10 and resumed.units.damaged == 0
assert all(identical.values()) and len(identical) == 5
assert mended.units.damaged == 1 and mended.units.kept == mended.units.total - 1
assert all(undisturbed[name].tobytes() == value.tobytes() for name, value in mended.to_numpy().items())
