"""The histogram of a statistic over the positions that are reached."""

import numpy as np

from ikjax.arm.recognition import lock
from ikjax.core.text import line, picture
from ikjax.maps.sets.positions import Grid
from ikjax.maps.sets.surface import Surface
from ikjax.maps.statistics import LIMITED_BY, WIDEST
from ikjax.plot.disc import head
from ikjax.plot.style import ACCENT, MAP, STYLE, finish, pyplot

UNITS = {
    "best_margin": "[m]",
    "reachable": "[orientations]",
    "solutions": "[solutions]",
    "best_manipulability": "[no unit, lengths in reaches]",
    "mean_manipulability": "[no unit, lengths in reaches]",
    "best_sigma_min": "[no unit, lengths in reaches]",
    "mean_sigma_min": "[no unit, lengths in reaches]",
    "best_limit_share": "[share of half the range]",
}
"""Of statistics, and of their twins within the limits."""


def _unit(reach, name: str) -> str:
    """The unit of a statistic, for the axis; empty where only its maker knows it."""
    base = name.removesuffix("_within")
    if base == WIDEST:
        return "[rad]" if reach.arm.kinds[reach.arm.locked[0]] == "R" else "[m]"
    if "near" in reach.statistic_specs.get(name, {}):
        return "[orientations]"
    return UNITS.get(base, "")


def histogram(reach, name: str = "dexterity", path=None, bins: int = 25):
    """A statistic's histogram over positions reached within the joint limits, by volume or by points.

    Args:
        reach: A `ReachMap`.
        name: "dexterity", or a statistic of the map with one number a position.
        path: Where to save the picture.
        bins: Number of bars.

    Returns:
        The figure.

    Raises:
        ImportError: Without matplotlib.
        ValueError: A statistic that the map does not have, or that has several numbers a position.
    """
    plt = pyplot()
    values = np.asarray(reach.dexterity if name == "dexterity" else reach.to_numpy().get(name, ()), float)
    if values.shape != tuple(reach.positions.shape):
        scalars = (line(key) for key, spec in reach.statistic_specs.items() if not spec["axes"])
        raise ValueError(f"name must be one of {', '.join(['dexterity', *scalars])}, got {name!r}")
    inside = (reach.reachable_within > 0) & np.isfinite(values)
    reached = values[inside]
    constant = not len(reached) or reached.min() == reached.max()
    low, high = (0.0, 1.0) if name == "dexterity" or constant else (reached.min(), reached.max())
    edges = np.linspace(low, high, bins + 1)
    bar_index = np.clip(np.searchsorted(edges, values, "right") - 1, 0, bins - 1)
    is_surface = isinstance(reach.positions, Surface)
    size = [
        np.sum(mask) if is_surface else _size(reach.positions, mask)
        for mask in _bar_masks(bar_index, inside, bins)
    ]
    words = "share of orientations reachable" if name == "dexterity" else picture(name.replace("_", " "))
    with plt.rc_context(STYLE):
        figure, ax = plt.subplots(figsize=(7.2, 3.9), layout="constrained")
        figure.get_layout_engine().set(rect=(0.01, 0.01, 0.98, 0.84))
        colors = plt.get_cmap(MAP)(np.linspace(0, 1, bins))
        ax.bar(edges[:-1], size, np.diff(edges), align="edge", color=colors, edgecolor="white", linewidth=0.5)
        if len(reached):
            middle = float(np.median(reached))
            ax.axvline(middle, color=ACCENT, lw=1.4)
            side, gap = ("right", -5) if middle > (low + high) / 2 else ("left", 5)
            text = f"half are below {middle:.0%}" if name == "dexterity" else f"half are below {middle:.3g}"
            where = {"xycoords": ("data", "axes fraction"), "textcoords": "offset points"}
            ax.annotate(text, (middle, 0.94), xytext=(gap, 0), ha=side, color=ACCENT, **where)
        ax.set(xlabel=f"{words} {_unit(reach, name)}".rstrip(), ylabel=_measure(reach.positions))
        if name == "dexterity":
            ax.xaxis.set_major_formatter("{x:.0%}")
        ax.set(xlim=(low, high), ylim=(0, 1.15 * max(*size, 1e-12)))
        ax.grid(axis="y")
        ax.set_axisbelow(True)
        ax.spines[["top", "right"]].set_visible(False)
        head(figure, reach.heading, f"{int(inside.sum()):,} positions reached within the joint limits.")
    return finish(figure, path)


def limit_costs(reach, path=None):
    """Bars of the goals that each joint's limits cost alone: the map's statistic `limited_by`.

    Args:
        reach: A `ReachMap` with that statistic.
        path: Where to save the picture.

    Returns:
        The figure.

    Raises:
        ImportError: Without matplotlib.
        ValueError: A map without it.
    """
    plt = pyplot()
    if LIMITED_BY not in reach.arrays:
        raise ValueError(f"this map was made without {LIMITED_BY}, it has {', '.join(reach.arrays)}")
    shares = np.array(reach.numbers()[LIMITED_BY])
    names = [picture(name) for name in reach.arm.joint_names or lock.numbered(reach.arm.n)]
    with plt.rc_context(STYLE):
        figure, ax = plt.subplots(figsize=(7.2, 1.5 + 0.32 * len(names)), layout="constrained")
        figure.get_layout_engine().set(rect=(0.01, 0.01, 0.98, 1 - 0.8 / figure.get_figheight()))
        ax.barh(range(len(names)), shares, color=ACCENT, height=0.62)
        for k, share in enumerate(shares):
            text = {"textcoords": "offset points", "va": "center", "color": "#444444"}
            ax.annotate(f"{share:.2%}", (share, k), xytext=(4, 0), **text)
        ax.set(yticks=range(len(names)), yticklabels=names, xlim=(0, 1.18 * max(float(shares.max()), 1e-2)))
        ax.invert_yaxis()
        ax.set_xlabel("share of all goals lost to the limits of this joint alone")
        ax.xaxis.set_major_formatter("{x:.1%}")
        ax.spines[["top", "right"]].set_visible(False)
        n = reach.numbers()
        words = f"{reach.goals:,} goals"
        anyhow, within = n.get("goals_reachable"), n.get("goals_reachable_within")
        if anyhow is not None and within is not None:
            words += f": {anyhow:.1%} reached without limits, {within:.1%} within"
        head(figure, reach.heading, f"{words}.")
    return finish(figure, path)


def _measure(positions) -> str:
    """What positions are measured by, for the axis."""
    if isinstance(positions, Surface):
        return "points"
    flat = {2: "area [m²]", 1: "length [m]", 0: "positions"}
    return flat.get(positions.dimension, "volume [m³]") if isinstance(positions, Grid) else "volume [m³]"


def _size(positions, chosen: np.ndarray) -> float:
    return positions.size(chosen) if isinstance(positions, Grid) else positions.volume(chosen)


def _bar_masks(bar_index: np.ndarray, inside: np.ndarray, bins: int):
    return ((bar_index == k) & inside for k in range(bins))
