"""Pictures of the measurements of maps."""

from pathlib import Path

import numpy as np

from ikjax.plot.style import COLORS, DIVERGING, MAP, STYLE, finish, pyplot


def growth(results: list[dict], path: Path) -> None:
    """Time and memory over the number of goals."""
    plt = pyplot()
    goals = [result["sweeps"][0]["goals"] for result in results]
    with plt.rc_context(STYLE):
        figure, (left, right) = plt.subplots(1, 2, figsize=(9, 3.6), layout="constrained")
        whole, swept = (
            [result["wall"] for result in results],
            [result["sweeps"][0]["seconds"] for result in results],
        )
        seconds_per_goal = swept[-1] / goals[-1]
        left.plot(
            goals, [seconds_per_goal * n for n in goals], color="#999999", lw=1, ls=(0, (5, 4)), zorder=1
        )
        left.loglog(goals, whole, "o-", color=COLORS[0], label="whole process, compile and all")
        left.loglog(goals, swept, "s-", color=COLORS[1], label="the sweep")
        left.set(xlabel="goals", ylabel="seconds", title="Time; dashed: proportional to goals")
        peak, disk = ([result[key] / 1e6 for result in results] for key in ("peak", "disk"))
        right.loglog(goals, peak, "o-", color=COLORS[0], label="greatest memory of the process")
        right.loglog(goals, disk, "s-", color=COLORS[1], label="the map on disk")
        right.axhline(1000, color="#999999", lw=1, ls=(0, (5, 4)))
        right.set(xlabel="goals", ylabel="MB", title="Memory; dashed: one gigabyte")
        for ax in (left, right):
            ax.grid(True)
            ax.legend(frameon=False, fontsize=8)
            ax.spines[["top", "right"]].set_visible(False)
    finish(figure, path)


def sampled(ours, shown: list, path: Path) -> None:
    """Vertical slices through the base: our map, sampled ones, the differences, and the errors.

    Args:
        ours: A `ReachMap` with its mask.
        shown: For each number of samples: the number, dexterity (x, y, z), errors by name.
        path: Where to save the picture.
    """
    plt = pyplot()
    layer = int(np.abs(ours.positions.axis(1) - float(ours.arm.base[1, 3])).argmin())
    truth = ours.reached().mean(-1)
    x, z = ours.positions.axis(0), ours.positions.axis(2)
    half = ours.positions.spacing / 2
    frame = [x[0] - half, x[-1] + half, z[0] - half, z[-1] + half]
    settings = {"origin": "lower", "extent": frame, "interpolation": "nearest"}
    with plt.rc_context(STYLE):
        width = 1 + len(shown)
        figure, axes = plt.subplots(2, width, figsize=(2.9 * width, 5.9), layout="constrained")
        maps = [
            ("ours: every cell solved", truth),
            *((f"{_power(n)} samples", share) for n, share, _ in shown),
        ]
        for ax, (title, share) in zip(axes[0], maps, strict=True):
            flat = share[:, layer].T
            image = ax.imshow(np.ma.masked_equal(flat, 0), cmap=MAP, vmin=0, vmax=1, **settings)
            ax.set_title(title, loc="left", fontweight="bold")
        for ax, (_, share, errors) in zip(axes[1, 1:], shown, strict=True):
            gap = (share - truth)[:, layer].T
            apart = ax.imshow(gap, cmap=DIVERGING, vmin=-1, vmax=1, **settings)
            ax.set_title("{cells missed:.1%} missed, {cells more:.1%} more".format(**errors), loc="left")
        for ax in (*axes[0], *axes[1, 1:]):
            ax.set(aspect="equal", xticks=(-0.5, 0, 0.5), yticks=(-0.5, 0, 0.5))
        axes[0, 0].set(xlabel="x [m]", ylabel="z [m]")
        figure.colorbar(image, ax=axes[0], format="{x:.0%}", label="orientations reached", pad=0.01)
        bar = figure.colorbar(apart, ax=axes[1], format="{x:+.0%}", pad=0.01)
        bar.set_label("sampled less ours")
        _errors(axes[1, 0], shown)
    finish(figure, path)


def _errors(ax, shown: list) -> None:
    for k, name in enumerate(("cells missed", "cells more", "positions more")):
        values = [100 * errors[name] for *_, errors in shown]
        ax.loglog([n for n, *_ in shown], np.maximum(values, 1e-3), "o-", ms=4, color=COLORS[k], label=name)
    ax.set(xlabel="samples", ylabel="% of what is reached", ylim=(1e-3, 300))
    ax.legend(frameon=False, fontsize=7)
    ax.grid(True)
    ax.spines[["top", "right"]].set_visible(False)


def _power(n: int) -> str:
    """A power of ten as 10^6, any other number in digits."""
    digits = str(n)
    return f"$10^{len(digits) - 1}$" if digits == "1" + "0" * (len(digits) - 1) else f"{n:,}"
