"""The sphere of directions as two discs of equal area: which ways a tool can point, and maps of shells.

Areas on the discs are proportional to areas on the sphere. Both discs are seen from above, the lower one as
if through the upper.

Source: Lambert's azimuthal equal-area projection; Snyder, Map projections, USGS 1395 (1987), section 24.
"""

import math
import textwrap
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from ikjax.arm.arm import Arm
from ikjax.core.text import picture
from ikjax.maps.sets.orientations import cone
from ikjax.maps.sets.surface import surface
from ikjax.maps.sweep import sweep
from ikjax.plot.style import INK, MAP, PALE, STYLE, finish, one_color, pyplot

PIXELS = 301


class Ball(NamedTuple):
    """Values on a sphere of directions."""

    title: str
    directions: np.ndarray
    """(m, 3) unit vectors."""
    within: np.ndarray
    """(m,) share reached within the joint limits."""
    anyhow: np.ndarray
    """(m,) bool: reached, joint limits ignored."""


def globe(arm: Arm, points, path=None, *, directions: int = 4000, turns: int = 12):
    """Which directions the tool's z axis can have at some points, and with how many turns about itself.

    White directions cannot be reached; grey ones can, but only beyond the joint limits.

    Args:
        arm: An arm whose task is a pose.
        points: (3,) or (k, 3) in the world [m]; each is a column of the picture.
        path: Where to save the picture.
        directions, turns: Number of directions, spread evenly over the sphere, and of turns about each.

    Returns:
        The figure.

    Raises:
        ImportError: Without matplotlib.
        ValueError: An arm of no family, or one whose task is not a full pose.
    """
    plt = pyplot()
    if arm.task != "pose":
        raise ValueError(f"a globe needs an arm whose task is pose, {arm.name}'s is {arm.task}")
    places = np.atleast_2d(np.asarray(points, float))
    tried = cone((0, 0, 1), math.pi, directions, turns)
    found = sweep(arm, surface(places), tried, statistics=["mask", "mask_within"])
    axes = found.rotations[::turns, :, 2]
    balls = []
    for k, place in enumerate(places):
        within, anyhow = (found.reached((k,), flag).reshape(directions, turns) for flag in (True, False))
        x, y, z = (f"{c:.2f}".replace("-", "\N{MINUS SIGN}") for c in place)
        title = f"at ({x}, {y}, {z}) m: {within.mean():.0%}"
        balls.append(Ball(title, axes, within.mean(1), np.any(anyhow, axis=1)))
    sides = ("tool's z axis points up", "tool's z axis points down")
    with plt.rc_context(STYLE):
        figure, image = pairs(balls, sides, 1.0)
        label(figure, image, f"share of {turns} turns about the tool's axis")
        caption = (
            f"Which ways the tool can point, within the joint limits. {directions:,} directions a point."
        )
        head(figure, arm.name, caption)
    return finish(figure, path)


def shell_map(reach, path=None):
    """The map of a shell: directions from its center on discs, a column for each of up to four radii."""
    plt = pyplot()
    count = len(reach.positions.radii)
    chosen = np.unique(np.linspace(0, count - 1, min(count, 4)).round().astype(int))
    unit = reach.positions.named()["direction"][0]
    top = max(0.1, math.ceil(10 * float(np.max(reach.dexterity, initial=0))) / 10)
    balls = [
        Ball(
            f"radius {reach.positions.radii[k]:.3g} m: {reach.dexterity[k].mean():.0%}",
            unit,
            reach.dexterity[k],
            reach.reachable[k] > 0,
        )
        for k in chosen
    ]
    with plt.rc_context(STYLE):
        figure, image = pairs(balls, ("above the center", "below the center"), top)
        label(figure, image, "share of orientations reachable")
        x, y, z = (f"{c:.2f}".replace("-", "\N{MINUS SIGN}") for c in reach.positions.center)
        place = f"{reach.positions.in_words()} about ({x}, {y}, {z}) m"
        caption = f"{place} × {reach.orientation_count:,} orientations."
        head(figure, reach.heading, caption)
    return finish(figure, path)


def pairs(balls: list[Ball], sides: tuple[str, str], top: float) -> tuple[Any, Any]:
    """Two discs, one below the other, for every ball; the figure and an image for the color bar."""
    plt = pyplot()
    size = (max(3.1 * len(balls) + 1.2, 5.2), 6.9)
    figure, axes = plt.subplots(2, len(balls), figsize=size, layout="constrained", squeeze=False)
    figure.get_layout_engine().set(rect=(0.005, 0.005, 0.99, 0.87))
    for column, ball in enumerate(balls):
        for row, up in enumerate((True, False)):
            image = _disc(axes[row, column], ball, up, top)
            if column == 0:
                axes[row, 0].set_ylabel(sides[row], fontsize=9, labelpad=14)
        axes[0, column].set_title(ball.title, fontweight="bold", color=INK, pad=14)
    return figure, image


def _disc(ax, ball: Ball, up: bool, top: float):
    """One half of a sphere: each pixel has the value of the nearest direction."""
    x, y = np.meshgrid(*[np.linspace(-1, 1, PIXELS)] * 2)
    r = np.hypot(x, y)
    height = 1 - r**2
    level = np.sqrt(np.maximum(2 - r**2, 0))
    rays = np.stack([x * level, y * level, height if up else -height], axis=-1)
    nearest = cKDTree(ball.directions).query(rays)[1]
    within, anyhow, outside = ball.within[nearest], ball.anyhow[nearest], r > 1
    settings: dict[str, Any] = {"origin": "lower", "extent": (-1, 1, -1, 1)}
    ring = pyplot().Circle((0, 0), 1, fill=False, ec="#888888", lw=0.8)
    ax.imshow(np.ma.masked_where(outside | ~anyhow, r), cmap=one_color(PALE), **settings).set_clip_path(ring)
    shown = np.ma.masked_where(outside | (within == 0), within)
    image = ax.imshow(shown, cmap=MAP, vmin=0, vmax=top, **settings)
    ax.add_patch(ring)
    for tilt in (30, 60):
        radius = math.sqrt(1 - math.cos(math.radians(tilt)))
        ax.add_patch(pyplot().Circle((0, 0), radius, fill=False, ec="white", lw=1.6, alpha=0.7))
        ax.add_patch(pyplot().Circle((0, 0), radius, fill=False, ec="#555555", lw=0.5, ls=(0, (4, 4))))
        where = radius * math.sqrt(0.5)
        box = {"boxstyle": "round,pad=0.15", "fc": "white", "ec": "none", "alpha": 0.8}
        ax.text(where, where, f"{tilt}°", fontsize=6.5, ha="center", va="center", color="#444444", bbox=box)
    for text, place in (("+x", (1.09, 0)), ("+y", (0, 1.09))):
        ax.text(*place, text, fontsize=8, ha="center", va="center", color="#555555")
    ax.set(xlim=(-1.16, 1.16), ylim=(-1.04, 1.16), aspect="equal", xticks=[], yticks=[])
    ax.spines[:].set_visible(False)
    return image


def label(figure, image, text: str, axes=None) -> None:
    """A color bar with its label, beside some axes or all."""
    bar = figure.colorbar(
        image, ax=figure.axes if axes is None else axes, shrink=0.8, aspect=32, pad=0.02, format="{x:.0%}"
    )
    bar.set_label(text, fontsize=9)
    bar.outline.set_visible(False)


def head(figure, name: str, caption: str) -> None:
    """The arm's name as the title, and below it what is shown."""
    left = {"x": 0.012, "ha": "left", "va": "top"}
    figure.suptitle(picture(name), y=0.985, fontsize=15, fontweight="bold", **left)
    # At nine points about thirteen letters are an inch wide.
    caption = "\n".join(textwrap.wrap(caption, int(14 * figure.get_figwidth())))
    figure.text(y=0.985 - 0.36 / figure.get_figheight(), s=caption, fontsize=9, color="#444444", **left)
