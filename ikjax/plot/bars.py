"""The histogram of a statistic over the positions that are reached."""

import numpy as np

from ikjax.core.text import line, picture
from ikjax.maps.sets.surface import Surface
from ikjax.plot.disc import head
from ikjax.plot.style import ACCENT, MAP, STYLE, finish, pyplot

UNITS = {"best_margin": "[m]", "best_margin_within": "[m]", "dexterity": ""}


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
        np.sum(mask) if is_surface else reach.positions.volume(mask)
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
        ax.set(
            xlabel=f"{words} {UNITS.get(name, '')}".rstrip(), ylabel="points" if is_surface else "volume [m³]"
        )
        if name == "dexterity":
            ax.xaxis.set_major_formatter("{x:.0%}")
        ax.set(xlim=(low, high), ylim=(0, 1.15 * max(*size, 1e-12)))
        ax.grid(axis="y")
        ax.set_axisbelow(True)
        ax.spines[["top", "right"]].set_visible(False)
        head(figure, reach.arm.name, f"{int(inside.sum()):,} positions reached within the joint limits.")
    return finish(figure, path)


def _bar_masks(bar_index: np.ndarray, inside: np.ndarray, bins: int):
    return ((bar_index == k) & inside for k in range(bins))
