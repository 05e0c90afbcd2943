"""Plans: the map of one layer or of one line of a box grid, drawn large and to scale.

A layer is one picture with everything in it: what is reached, what only the joint limits keep from it, what
is out of reach, the base, the arm, and the goals of the user. A map of one orientation says yes or no, in two
colors; a map of several has a scale.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from ikjax.core.text import picture
from ikjax.maps.reach_map import ReachMap
from ikjax.maps.sets.positions import Grid
from ikjax.plot.disc import head
from ikjax.plot.planes import place_far_out, posture_at, shown_axes, ticks_of
from ikjax.plot.stick import draw_flat, sticks
from ikjax.plot.style import ACCENT, DIVERGING, INK, MAP, finish, one_color, pyplot

REACHED, LIMITED, OUTSIDE = "#3b8f6b", "#f0c987", "#f1f1f1"
"""Of yes or no; their lightness falls in this order, so that grey print tells them apart."""

NEITHER, BOTH, GAINED, LOST = OUTSIDE, "#a8b0ba", "#2f6fde", "#d1495b"
"""Of two maps of yes or no."""


def is_plan(reach) -> bool:
    """Whether a map is of one layer or one line of a box grid."""
    return isinstance(reach.positions, Grid) and reach.positions.dimension in (1, 2)


def grid_of(reach: ReachMap) -> Grid:
    """The box grid of a plan's map."""
    assert isinstance(reach.positions, Grid)
    return reach.positions


def says_yes_or_no(reach) -> bool:
    """Whether a position is reached or not, and nothing between."""
    return reach.orientation_count == 1


def plan_axes(grid: Grid) -> tuple[int, int, int]:
    """The axes of a plan: the one across, the one up, and the one that it is normal to.

    A line is drawn along the first.
    """
    normal = next(k for k in (2, 1, 0) if grid.shape[k] == 1)
    across, up = shown_axes(normal)
    if grid.shape[across] == 1 and grid.shape[up] > 1 and grid.dimension == 1:
        across, up = up, across
    return across, up, normal


def goal_points(goals) -> np.ndarray:
    """The points (n, 3) of goals, (n, 3) or (n, 4, 4) [m]; none for None."""
    if goals is None:
        return np.empty((0, 3))
    goals = np.asarray(goals, float)
    if goals.shape[-2:] == (4, 4):
        return goals.reshape(-1, 4, 4)[:, :3, 3]
    if goals.ndim < 1 or goals.shape[-1] != 3:
        raise ValueError(f"goals must have shape (n, 3) or (n, 4, 4), got {goals.shape}")
    return goals.reshape(-1, 3)


def plan(reach: ReachMap, path=None, q=None, goals=None):
    """A map of one layer as one large plan to scale; of one line as a graph along it.

    Args:
        reach: A `ReachMap` of a box grid with an axis of one position at least.
        path: Where to save the picture.
        q: (n,) posture to draw; by default the arm reaches for a place of the layer, in an orientation of the
            map.
        goals: (n, 3) or (n, 4, 4) in the world [m]: drawn as rings, as crosses where the nearest position of
            the map is not reached.

    Returns:
        The figure.

    Raises:
        ImportError: Without matplotlib.
        ValueError: A map of something else, goals of another shape.
    """
    plt = pyplot()
    if not is_plan(reach):
        raise ValueError(f"a plan is of one layer of a box grid, got {reach.positions.in_words()}")
    points = goal_points(goals)
    with plt.rc_context(_style()):
        is_line = grid_of(reach).dimension == 1
        figure = _line(reach, points) if is_line else _layer(reach, points, q)
        head(figure, reach.heading, caption(reach))
    return finish(figure, path)


def _style() -> dict[str, Any]:
    from ikjax.plot.style import STYLE

    return {**STYLE, "font.size": 10, "axes.titlesize": 10, "xtick.labelsize": 9, "ytick.labelsize": 9}


def caption(reach: ReachMap) -> str:
    """How much is reached, in the unit of the grid's dimension, and of what."""
    grid = grid_of(reach)
    hit, anyhow = reach.reachable_within > 0, reach.reachable > 0
    parts = [f"{amount(grid, hit)} of {amount(grid, np.ones(grid.shape, bool))} reached"]
    if (anyhow & ~hit).any():
        parts.append(f"{amount(grid, anyhow & ~hit)} more but for the joint limits")
    rolls = f" x {reach.free_rolls} rolls" if reach.free_rolls > 1 else ""
    count = "1 orientation" if says_yes_or_no(reach) else f"{reach.orientation_count:,} orientations"
    return f"{', '.join(parts)}.   {count}{rolls}, {grid.spacing * 1000:.3g} mm apart."


def amount(grid: Grid, chosen: np.ndarray) -> str:
    """How much chosen positions are: "0.52 m²"."""
    unit = {2: " m²", 1: " m"}[grid.dimension]
    return f"{grid.size(chosen):.3g}{unit}"


def _layer(reach: ReachMap, goals: np.ndarray, q) -> Any:
    across, up, _ = plan_axes(grid_of(reach))
    body = sticks(reach.arm, posture_at(reach, place_far_out(reach, (across, up))) if q is None else q)
    span = plan_span(reach, body.line, goals)
    figure, axes = plan_figure(span[[across, up]], 1)
    (ax,) = axes
    handles, bar = draw_layer(ax, reach, span)
    draw_flat(ax, body, (across, up), bold=True)
    handles += draw_goals(ax, reach, goals)
    handles += [_mark("s", INK, "base"), _mark("D", ACCENT, "tool")]
    _finish_legend(figure, handles, bar, axes)
    return figure


def plan_span(reach, line: np.ndarray, goals: np.ndarray) -> np.ndarray:
    """(3, 2) extent of a plan [m]: the whole layer, the arm, and goals that are not far off."""
    half = grid_of(reach).spacing / 2
    ends = np.array([[ticks[0] - half, ticks[-1] + half] for ticks in ticks_of(reach)])
    points = np.concatenate([ends.T, line])
    low, high = points.min(0), points.max(0)
    near = goals[(np.abs(goals - (low + high) / 2) <= 1.5 * (high - low).max()).all(-1)]
    points = np.concatenate([points, near])
    edge = 0.03 * float(np.ptp(points, axis=0).max())
    return np.stack([points.min(0) - edge, points.max(0) + edge], axis=1)


def plan_figure(span: np.ndarray, count: int) -> tuple[Any, list]:
    """A figure of so many panels side by side that have the proportions of a span (2, 2) [m]."""
    wide, tall = np.diff(span)[:, 0]
    width = {1: 8.2, 3: 4.6}[count]
    height = float(np.clip(width * tall / wide, 2.2, 8.2 if count == 1 else 5.6))
    if count == 1 and height >= 8.2:
        width = max(height * wide / tall, 4.6)
    figure, axes = pyplot().subplots(
        1, count, figsize=(count * width + 0.9, height + 2.1), layout="constrained", squeeze=False
    )
    tall = figure.get_figheight()
    figure.get_layout_engine().set(rect=(0.005, 0.62 / tall, 0.99, 1 - (1.4 if count > 1 else 1.3) / tall))
    return figure, list(axes[0])


def draw_layer(ax, reach: ReachMap, span: np.ndarray) -> tuple[list, Any]:
    """Draw the one layer of a map; returns what the legend explains, and an image for a color bar or None."""
    within, anyhow = (layer_of(reach, x) > 0 for x in (reach.reachable_within, reach.reachable))
    settings = image_settings(reach)
    flat = np.ones(within.shape)
    ax.imshow(flat, cmap=one_color(OUTSIDE), **settings)
    ax.imshow(np.ma.masked_where(within | ~anyhow, flat), cmap=one_color(LIMITED), **settings)
    bar = None
    handles = []
    if says_yes_or_no(reach):
        ax.imshow(np.ma.masked_where(~within, flat), cmap=one_color(REACHED), **settings)
        handles.append(_patch(REACHED, "reached"))
    else:
        shown = np.ma.masked_where(~within, layer_of(reach, reach.dexterity))
        bar = ax.imshow(shown, cmap=MAP, vmin=0, vmax=top_of(reach), **settings)
    if (anyhow & ~within).any():
        handles.append(_patch(LIMITED, "beyond the joint limits alone"))
    if (~anyhow).any():
        handles.append(_patch(OUTSIDE, "out of reach"))
    frame_axes(ax, reach, span)
    return handles, bar


def top_of(*reaches: ReachMap) -> float:
    """The end of the color scale: the greatest dexterity, to the next tenth."""
    best = max(float(np.max(reach.dexterity, initial=0)) for reach in reaches)
    return max(0.1, float(np.ceil(10 * best - 1e-9)) / 10)


def layer_of(reach: ReachMap, values) -> np.ndarray:
    """Values of the positions as rows of an image."""
    across, up, normal = plan_axes(grid_of(reach))
    values = np.asarray(values).take(0, normal)
    return values.T if across < up else values


def image_settings(reach: ReachMap) -> dict[str, Any]:
    """How an image of the layer is placed."""
    across, up, _ = plan_axes(grid_of(reach))
    ticks, half = ticks_of(reach), grid_of(reach).spacing / 2
    frame = [ticks[across][0] - half, ticks[across][-1] + half, ticks[up][0] - half, ticks[up][-1] + half]
    return {"origin": "lower", "extent": frame, "interpolation": "nearest"}


def frame_axes(ax, reach: ReachMap, span: np.ndarray) -> None:
    """Limits, names and a light grid."""
    across, up, normal = plan_axes(grid_of(reach))
    at = f"{ticks_of(reach)[normal][0]:.3g}".replace("-", "\N{MINUS SIGN}")
    ax.set(xlim=span[across], ylim=span[up], aspect="equal")
    ax.set(xlabel=f"{'xyz'[across]} [m]", ylabel=f"{'xyz'[up]} [m]")
    ax.set_title(f"{'xyz'[normal]} = {at} m", loc="left", fontweight="bold", color=INK)
    ax.grid(color="#000000", alpha=0.09, lw=0.6)
    ax.spines[["top", "right"]].set_visible(False)


def draw_goals(ax, reach: ReachMap, goals: np.ndarray) -> list:
    """Draw goals by what the nearest position of the map says; returns what the legend explains."""
    if not len(goals):
        return []
    across, up, _ = plan_axes(grid_of(reach))
    hit = reached_at(reach, goals)
    handles = []
    for chosen, marker, text in ((hit, "o", "goal"), (~hit, "X", "goal not reached")):
        if chosen.any():
            face, edge = ("white", INK) if marker == "o" else ("#b00020", "white")
            style = {"ls": "", "marker": marker, "ms": 7, "mew": 1.2, "mfc": face, "mec": edge}
            ax.plot(*goals[chosen][:, [across, up]].T, zorder=7, **style)
            handles.append(_mark(marker, face, f"{text} ({chosen.sum()})", edge))
    return handles


def reached_at(reach: ReachMap, points: np.ndarray) -> np.ndarray:
    """Whether the position of the grid nearest to each point is reached; not beyond the grid."""
    grid = grid_of(reach)
    place = np.rint((points - np.asarray(grid.origin)) / grid.spacing).astype(int)
    flat = np.asarray(grid.shape) == 1
    inside = ((place >= 0) & (place < np.asarray(grid.shape)) | flat).all(-1)
    place = np.where(flat, 0, np.clip(place, 0, np.asarray(grid.shape) - 1))
    return inside & (np.asarray(reach.reachable_within)[tuple(place.T)] > 0)


def _patch(color: str, text: str) -> Any:
    from matplotlib.patches import Patch

    return Patch(facecolor=color, edgecolor="#999999", linewidth=0.5, label=text)


def _mark(marker: str, face: str, text: str, edge: str = "white") -> Any:
    from matplotlib.lines import Line2D

    return Line2D([], [], ls="", marker=marker, mfc=face, mec=edge, ms=8, label=text)


def _finish_legend(figure, handles: list, bar, axes: Sequence) -> None:
    """The legend below the panels, and the color bar beside them."""
    if bar is not None:
        add_bar(figure, bar, axes, "share of orientations reached")
    columns = max(1, int(figure.get_figwidth() / 2.1))
    settings = {"frameon": False, "fontsize": 9, "handlelength": 1.1, "columnspacing": 1.4}
    place = {"loc": "lower left", "bbox_to_anchor": (0.012, 0.005), "ncols": columns}
    figure.legend(handles=handles, **place, **settings)


def add_bar(figure, image, axes, text: str) -> None:
    scale = figure.colorbar(image, ax=list(axes), shrink=0.85, aspect=32, pad=0.015, format="{x:.0%}")
    scale.set_label(text, fontsize=9)
    scale.outline.set_visible(False)


def _line(reach: ReachMap, goals: np.ndarray) -> Any:
    """The shares along a line of positions, as bars that touch."""
    grid = grid_of(reach)
    across, *others = plan_axes(grid)
    others = sorted(others)
    ticks = ticks_of(reach)[across]
    within, anyhow = (np.ravel(np.asarray(x)) for x in (reach.reachable_within, reach.reachable))
    figure, ax = pyplot().subplots(figsize=(9.1, 3.9), layout="constrained")
    figure.get_layout_engine().set(rect=(0.005, 0.11, 0.99, 0.68))
    edges = np.append(ticks - grid.spacing / 2, ticks[-1] + grid.spacing / 2)
    count = reach.orientation_count
    ax.axhspan(0, 1, color=OUTSIDE, lw=0)
    ax.stairs(anyhow / count, edges, fill=True, color=LIMITED, lw=0)
    ax.stairs(within / count, edges, fill=True, color=REACHED, lw=0)
    base = np.asarray(reach.arm.base, float)[:3, 3]
    handles = [_patch(REACHED, "reached"), _patch(LIMITED, "beyond the joint limits alone")]
    handles.append(_patch(OUTSIDE, "out of reach"))
    if edges[0] <= base[across] <= edges[-1]:
        ax.plot(base[across], 0, "s", color=INK, ms=9, clip_on=False, zorder=5)
        handles.append(_mark("s", INK, "base, seen along the line"))
    for goal in goals:
        ax.axvline(goal[across], color=INK, lw=0.8, ls=(0, (4, 3)))
    if len(goals):
        from matplotlib.lines import Line2D

        handles.append(Line2D([], [], color=INK, lw=0.8, ls=(0, (4, 3)), label=f"goals ({len(goals)})"))
    ax.set(xlim=(edges[0], edges[-1]), ylim=(0, 1), xlabel=f"{'xyz'[across]} [m]")
    if says_yes_or_no(reach):
        ax.set(yticks=[])
    else:
        ax.set(ylabel="share of orientations")
        ax.yaxis.set_major_formatter(lambda share, _: f"{share:.0%}")
    places = ", ".join(f"{'xyz'[k]} = {ticks_of(reach)[k][0]:.3g} m" for k in others)
    ax.set_title(places.replace("-", "\N{MINUS SIGN}"), loc="left", fontweight="bold", color=INK)
    ax.spines[["top", "right"]].set_visible(False)
    _finish_legend(figure, handles, None, [ax])
    return figure


def compared_plans(then: ReachMap, now: ReachMap, names: tuple[str, str], goals=None) -> Any:
    """Two maps of one layer, and where they differ, side by side; the figure without its title."""
    points = goal_points(goals)
    across, up, _ = plan_axes(grid_of(now))
    if grid_of(now).dimension < 2:
        return _compared_lines(then, now, names, points)
    bases = np.stack([np.asarray(reach.arm.base, float)[:3, 3] for reach in (then, now)])
    bodies = [
        sticks(reach.arm, posture_at(reach, place_far_out(reach, (across, up)))) for reach in (then, now)
    ]
    span = plan_span(now, np.concatenate([bases, *(body.line for body in bodies)]), points)
    figure, axes = plan_figure(span[[across, up]], 3)
    handles: list = []
    bar = None
    for ax, reach, name, body in zip(axes, (then, now), names, bodies, strict=False):
        found, bar = draw_layer(ax, reach, span)
        if bar is not None:
            bar.set_clim(0, top_of(then, now))
        handles += found
        draw_flat(ax, body, (across, up), bold=False)
        draw_goals(ax, reach, points)
        ax.set_title(f"{picture(name)}\n{amount(grid_of(reach), reach.reachable_within > 0)} reached",
                     loc="left", fontweight="bold", color=INK)  # fmt: skip
    handles += _draw_difference(axes[2], then, now, span)
    unique = {handle.get_label(): handle for handle in handles}
    if bar is not None:
        add_bar(figure, bar, axes[:2], "share of orientations reached")
    _finish_legend(figure, list(unique.values()), None, axes)
    return figure


def _draw_difference(ax, then: ReachMap, now: ReachMap, span: np.ndarray) -> list:
    """Where the second map reaches more or less than the first; returns what the legend explains.

    Of maps of several orientations, where both reach something the color is the change of the share.
    """
    a, b = (layer_of(reach, reach.reachable_within) > 0 for reach in (then, now))
    settings = image_settings(now)
    flat = np.ones(a.shape)
    handles = []
    for part, color, text in (
        (~a & ~b, NEITHER, ""),
        (a & b, BOTH, "reached by both"),
        (b & ~a, GAINED, "gained"),
        (a & ~b, LOST, "lost"),
    ):
        ax.imshow(np.ma.masked_where(~part, flat), cmap=one_color(color), **settings)
        if part.any() and text:
            handles.append(_patch(color, text))
    if not says_yes_or_no(now):
        handles = [handle for handle in handles if handle.get_label() != "reached by both"]
        change = layer_of(now, now.dexterity) - layer_of(then, then.dexterity)
        most = max(0.05, float(np.abs(change[a & b]).max(initial=0)))
        shown = np.ma.masked_where(~(a & b), change)
        image = ax.imshow(shown, cmap=DIVERGING, vmin=-most, vmax=most, **settings)
        add_bar(ax.figure, image, [ax], "change of the share")
    frame_axes(ax, now, span)
    gained, lost = (amount(grid_of(now), x) for x in (
        (now.reachable_within > 0) & (then.reachable_within == 0),
        (then.reachable_within > 0) & (now.reachable_within == 0),
    ))  # fmt: skip
    ax.set_title(
        f"second against first\n{gained} gained, {lost} lost", loc="left", fontweight="bold", color=INK
    )
    return handles


def _compared_lines(then: ReachMap, now: ReachMap, names: tuple[str, str], goals: np.ndarray) -> Any:
    grid = grid_of(now)
    across, _, _ = plan_axes(grid)
    ticks = ticks_of(now)[across]
    edges = np.append(ticks - grid.spacing / 2, ticks[-1] + grid.spacing / 2)
    figure, ax = pyplot().subplots(figsize=(9.1, 3.9), layout="constrained")
    figure.get_layout_engine().set(rect=(0.005, 0.02, 0.99, 0.77))
    for reach, name, color, style in zip((then, now), names, (LOST, GAINED), ("--", "-"), strict=True):
        ax.stairs(
            np.ravel(reach.dexterity), edges, color=color, lw=2, ls=style, label=picture(name), baseline=None
        )
    for goal in goals:
        ax.axvline(goal[across], color=INK, lw=0.8, ls=(0, (4, 3)))
    ax.set(xlim=(edges[0], edges[-1]), ylim=(-0.02, 1.05), xlabel=f"{'xyz'[across]} [m]")
    ax.set(ylabel="share of orientations")
    ax.yaxis.set_major_formatter(lambda share, _: f"{share:.0%}")
    ax.legend(frameon=False, loc="best")
    ax.spines[["top", "right"]].set_visible(False)
    return figure
