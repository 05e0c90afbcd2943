"""The map of a box grid in slices, colored by dexterity, with the arm."""

from collections.abc import Sequence

import numpy as np

from ikjax.core.text import picture
from ikjax.maps.sets.positions import Grid, Shell
from ikjax.plot.disc import shell_map
from ikjax.plot.plan import is_plan, plan
from ikjax.plot.planes import Plane, Slice, default_slices, plane_of, posture, shown_axes, ticks_of
from ikjax.plot.points import point_map
from ikjax.plot.stick import draw_flat, sticks
from ikjax.plot.style import INK, MAP, PALE, STYLE, finish, one_color, pyplot


def reach_map(reach, path=None, q=None, slices: Sequence[Slice] | None = None, goals=None):
    """A workspace colored by dexterity: a box grid in slices with the arm in the largest, one layer as a
    plan, a shell as discs of equal area, a surface or a list as points beside the arm.

    White positions cannot be reached; grey ones can, but only beyond the joint limits.

    Args:
        reach: A `ReachMap`, from `ikjax.sweep`.
        path: Where to save the picture.
        q: (n,) posture to draw; by default the arm reaches for its most dexterous place.
        slices: Planes, the largest picture first; by default the two vertical planes through the base and
            three horizontal ones. Each shows the nearest layer of the grid.
        goals: (n, 3) or (n, 4, 4) [m], drawn into a plan; see `plan`.

    Returns:
        The figure.

    Raises:
        ImportError: Without matplotlib.
        ValueError: A slice that is not ("x", "y" or "z", metres), or slices of a map that is no box grid.
    """
    plt = pyplot()
    if slices is None and is_plan(reach):
        return plan(reach, path, q, goals)
    if not isinstance(reach.positions, Grid) or (slices is None and reach.positions.count == 1):
        if slices is not None:
            raise ValueError(f"slices are of a box grid, got {reach.positions.in_words()}")
        return shell_map(reach, path) if isinstance(reach.positions, Shell) else point_map(reach, path, q)
    planes = [plane_of(reach, piece) for piece in (default_slices(reach) if slices is None else slices)]
    body = sticks(reach.arm, posture(reach, planes[0]) if q is None else q)
    span = span_of(reach, body.line)
    top = max(0.1, np.ceil(10 * float(np.max(reach.dexterity, initial=0))) / 10)
    with plt.rc_context(STYLE):
        figure = plt.figure(figsize=(13, 6.7), layout="constrained")
        axes = panels(figure, len(planes))
        images = [draw_plane(ax, reach, plane, span, top) for ax, plane in zip(axes, planes, strict=True)]
        for ax, plane in zip(axes, planes, strict=True):
            draw_flat(ax, body, shown_axes(plane.axis), bold=ax is axes[0])
        _draw_cuts(axes[0], planes)
        bar = figure.colorbar(images[0], ax=axes, shrink=0.9, aspect=34, pad=0.012, format="{x:.0%}")
        bar.set_label("share of orientations reachable", fontsize=10)
        bar.outline.set_visible(False)
        _head(figure, reach)
    return finish(figure, path)


def span_of(reach, line: np.ndarray) -> np.ndarray:
    """(3, 2) extent of the panels [m]: all that can be reached, and the points of a line."""
    cells = np.argwhere(np.asarray(reach.reachable) > 0)
    corners = np.asarray(reach.positions.origin, float) + reach.positions.spacing * np.array(
        [cells.min(0), cells.max(0)] if len(cells) else [np.zeros(3), np.subtract(reach.positions.shape, 1)]
    )
    points = np.concatenate([corners, line])
    return np.stack([points.min(0), points.max(0)], axis=1) + np.array([-1.5, 1.5]) * reach.positions.spacing


def panels(figure, count: int) -> list:
    """One large axis on the left, the others in two columns on the right."""
    rows = max(1, count // 2)
    columns = 2 if count > 2 else max(0, count - 1)
    figure.get_layout_engine().set(rect=(0.005, 0.005, 0.99, 0.885), w_pad=0.08, h_pad=0.1)
    ratios = [1.08 * rows] + [1] * columns
    grid = figure.add_gridspec(rows, 1 + columns, width_ratios=ratios)
    axes = [figure.add_subplot(grid[:, 0])]
    for k in range(count - 1):
        axes.append(figure.add_subplot(grid[k // 2, 1 + k % 2]))
    return axes


def draw_plane(ax, reach, plane: Plane, span: np.ndarray, top: float):
    """Draw one layer's dexterity; returns the image, for the color bar."""
    across, up = shown_axes(plane.axis)
    ticks, half = ticks_of(reach), reach.positions.spacing / 2
    frame = [ticks[across][0] - half, ticks[across][-1] + half, ticks[up][0] - half, ticks[up][-1] + half]

    def layer(values) -> np.ndarray:
        return np.asarray(values).take(plane.layer, plane.axis).T

    within, anyhow = layer(reach.reachable_within) > 0, layer(reach.reachable) > 0
    settings = {"origin": "lower", "extent": frame, "interpolation": "nearest"}
    grey = np.ma.masked_where(within | ~anyhow, np.ones(within.shape))
    ax.imshow(grey, cmap=one_color(PALE), **settings)
    shown = np.ma.masked_where(~within, layer(reach.dexterity))
    image = ax.imshow(shown, cmap=MAP, vmin=0, vmax=top, **settings)
    ax.set(xlim=span[across], ylim=span[up], aspect="equal")
    ax.set(xlabel=f"{'xyz'[across]} [m]", ylabel=f"{'xyz'[up]} [m]")
    at = f"{plane.at:.2f}".replace("-0.00", "0.00").replace("-", "\N{MINUS SIGN}")
    ax.set_title(f"{'xyz'[plane.axis]} = {at} m", loc="left", fontweight="bold", color=INK)
    ax.spines[["top", "right"]].set_visible(False)
    return image


def _draw_cuts(ax, planes: list[Plane]) -> None:
    """Thin lines in the first panel where the other planes cut it."""
    across, up = shown_axes(planes[0].axis)
    for plane in planes[1:]:
        draw = {across: ax.axvline, up: ax.axhline}.get(plane.axis)
        if draw:
            draw(plane.at, color="#666666", lw=0.8, ls=(0, (5, 4)), zorder=2)


def _head(figure, reach) -> None:
    """The arm's name, the main numbers of the map, and the meaning of grey."""
    volume = float((np.asarray(reach.reachable_within) > 0).sum() * reach.positions.spacing**3)
    best = float(np.max(reach.dexterity, initial=0))
    caption = (
        f"{volume:.3g} m³ within reach and joint limits; at best {best:.0%} of orientations.   "
        f"{reach.goals:,} goals: {reach.positions.count:,} positions "
        f"{reach.positions.spacing * 1000:.3g} mm apart "
        f"× {reach.orientation_count:,} orientations."
    )
    left = {"x": 0.012, "ha": "left", "va": "top"}
    figure.suptitle(picture(reach.heading), y=0.985, fontsize=16, fontweight="bold", **left)
    figure.text(y=0.925, s=caption, fontsize=10, color="#444444", **left)
    if (np.asarray(reach.reachable) > reach.reachable_within).any():
        from matplotlib.patches import Patch

        grey = Patch(color=PALE, label="within reach, beyond the joint limits")
        where = {"loc": "upper right", "bbox_to_anchor": (0.995, 0.945)}
        figure.legend(handles=[grey], frameon=False, handlelength=1, handleheight=1, **where)
