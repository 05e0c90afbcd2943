"""Two maps of the same positions compared: of two arms, or of one arm in two places."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from ikjax.core.text import picture
from ikjax.maps.sets.positions import Grid
from ikjax.plot.disc import head, label
from ikjax.plot.plan import compared_plans, is_plan, says_yes_or_no
from ikjax.plot.planes import Plane, Slice, default_slices, plane_of, shown_axes, ticks_of
from ikjax.plot.points import facing, scatter
from ikjax.plot.slices import draw_plane, span_of
from ikjax.plot.stick import box
from ikjax.plot.style import DIVERGING, INK, MAP, STYLE, finish, pyplot


class Change(NamedTuple):
    """Numbers of positions by the change of their dexterity."""

    gained: int
    """Reached in the second map only."""
    better: int
    same: int
    worse: int
    lost: int
    """Reached in the first map only."""

    def in_words(self, yes_or_no: bool) -> str:
        """As `str`, without what cannot be where a position is reached or not."""
        if not yes_or_no:
            return str(self)
        return f"{self.gained:,} positions gained, {self.same:,} the same, {self.lost:,} lost"

    def __str__(self) -> str:
        return (
            f"{self.gained:,} positions gained, {self.better:,} better, {self.same:,} the same, "
            f"{self.worse:,} worse, {self.lost:,} lost"
        )


def change(then, now) -> Change:
    """The change at each position that either map reaches within the joint limits.

    Raises:
        ValueError: Maps of other positions.
    """
    if then.positions != now.positions:
        raise ValueError(
            "maps must have the same positions, "
            f"got {then.positions.in_words()} and {now.positions.in_words()}"
        )
    a, b = np.asarray(then.dexterity), np.asarray(now.dexterity)
    both = (a > 0) & (b > 0)
    kinds = ((a == 0) & (b > 0), both & (b > a), both & (a == b), both & (b < a), (a > 0) & (b == 0))
    return Change(*(int(kind.sum()) for kind in kinds))


def names_of(then, now) -> tuple[str, str]:
    """What tells two maps apart: their titles, their arms, their tools or mounts, else first and second."""
    pairs = [(then.title, now.title), (then.arm.name, now.arm.name)]
    pairs += [(_pose_in_words(key, then), _pose_in_words(key, now)) for key in ("tool", "base")]
    for a, b in pairs:
        if a != b and a and b:
            return a, b
    return "first", "second"


def _pose_in_words(key: str, reach) -> str:
    T = np.asarray(getattr(reach.arm, key), float)
    place = ", ".join(f"{round(1000 * x, 1) + 0.0:g}" for x in T[:3, 3])
    angle = np.degrees(np.arccos(np.clip((np.trace(T[:3, :3]) - 1) / 2, -1, 1)))
    turned = f", turned by {angle:.3g}°" if angle > 1e-3 else ""
    return f"{key} at ({place}) mm{turned}"


def comparison(then, now, path=None, slices: Sequence[Slice] | None = None, goals=None):
    """Two maps side by side, and where the second has more or less dexterity than the first.

    Positions that only one map reaches are hatched, dots for gained and strokes for lost, so that they are
    seen in black and white too.

    Args:
        then, now: `ReachMap`s of the same positions.
        path: Where to save the picture.
        slices: Planes of a box grid, a row each; by default a vertical and a horizontal one.
        goals: (n, 3) or (n, 4, 4) [m], drawn into plans of one layer.

    Returns:
        The figure.

    Raises:
        ImportError: Without matplotlib.
        ValueError: Maps of other positions, slices of a map that is no box grid.
    """
    plt = pyplot()
    changes = change(then, now)
    if not isinstance(then.positions, Grid) and slices is not None:
        raise ValueError(f"slices are of a box grid, got {then.positions.in_words()}")
    names = names_of(then, now)
    title = f"{names[0]} and {names[1]}" if "first" not in names else "first and second map"
    if then.arm.name == now.arm.name:
        title = f"{now.arm.name}: {title}"
    if slices is None and is_plan(then):
        with plt.rc_context(STYLE):
            figure = compared_plans(then, now, names, goals)
            head(figure, title, f"{changes.in_words(says_yes_or_no(now))}.")
        return finish(figure, path)
    highest = max(float(np.max(reach.dexterity, initial=0)) for reach in (then, now))
    top = max(0.1, np.ceil(10 * highest) / 10)
    with plt.rc_context(STYLE):
        draw = _in_slices if isinstance(then.positions, Grid) else _in_points
        figure, sides, middle = draw(then, now, names, top, slices)
        axes = list(figure.axes)
        label(
            figure, sides, "share of orientations reachable", [ax for k, ax in enumerate(axes) if k % 3 < 2]
        )
        label(figure, middle, "change of the share", axes[2::3])
        note = "Dots: gained, strokes: lost." if isinstance(then.positions, Grid) else ""
        head(figure, title, f"{changes}.   {note}")
    return finish(figure, path)


def _in_slices(then, now, names: tuple[str, str], top: float, slices) -> tuple[Any, Any, Any]:
    vertical, _, _, horizontal, _ = default_slices(now)
    chosen = [vertical, horizontal] if slices is None else slices
    planes = [plane_of(now, piece) for piece in chosen]
    spans = [span_of(reach, np.asarray(reach.arm.base, float)[None, :3, 3]) for reach in (then, now)]
    span = np.stack([np.minimum(*spans)[:, 0], np.maximum(*spans)[:, 1]], axis=1)
    figure, axes = pyplot().subplots(
        len(planes), 3, figsize=(13, 0.8 + 3.6 * len(planes)), layout="constrained", squeeze=False
    )
    figure.get_layout_engine().set(rect=(0.005, 0.005, 0.99, 0.99 - 0.75 / figure.get_figheight()))
    most = max(0.05, float(np.abs(now.dexterity - then.dexterity).max()))
    for row, plane in zip(axes, planes, strict=True):
        for ax, reach, name in zip(row, (then, now), map(picture, names), strict=False):
            sides = draw_plane(ax, reach, plane, span, top)
            ax.set_title(f"{name}, {ax.get_title(loc='left')}", loc="left", fontweight="bold", color=INK)
        middle = _draw_change(row[2], then, now, plane, span, most)
    return figure, sides, middle


def _draw_change(ax, then, now, plane: Plane, span: np.ndarray, most: float) -> Any:
    across, up = shown_axes(plane.axis)
    ticks, half = ticks_of(now), now.positions.spacing / 2
    frame = (ticks[across][0] - half, ticks[across][-1] + half, ticks[up][0] - half, ticks[up][-1] + half)
    a, b = (np.asarray(reach.dexterity).take(plane.layer, plane.axis).T for reach in (then, now))
    shown = np.ma.masked_where((a == 0) & (b == 0), b - a)
    settings: dict[str, Any] = {"origin": "lower", "extent": frame, "interpolation": "nearest"}
    image = ax.imshow(shown, cmap=DIVERGING, vmin=-most, vmax=most, **settings)
    for part, hatch in (((a == 0) & (b > 0), "...."), ((a > 0) & (b == 0), "////")):
        if part.any() and min(part.shape) > 1:
            sheet = ax.contourf(
                ticks[across], ticks[up], part.astype(float), [0.5, 1.5], hatches=[hatch], colors="none"
            )
            sheet.set_edgecolor("#444444")
            sheet.set_linewidth(0)
    ax.set(xlim=span[across], ylim=span[up], aspect="equal")
    ax.set(xlabel=f"{'xyz'[across]} [m]", ylabel=f"{'xyz'[up]} [m]")
    ax.set_title("second \N{MINUS SIGN} first", loc="left", fontweight="bold", color=INK)
    ax.spines[["top", "right"]].set_visible(False)
    return image


def _in_points(then, now, names: tuple[str, str], top: float, _) -> tuple[Any, Any, Any]:
    figure = pyplot().figure(figsize=(14, 5.2), layout="constrained")
    figure.get_layout_engine().set(rect=(0.005, 0.0, 0.985, 0.86), w_pad=0.14)
    axes = [figure.add_subplot(1, 3, k + 1, projection="3d") for k in range(3)]
    points = then.positions.points().reshape(-1, 3)
    for ax, name in zip(axes, (*map(picture, names), "second \N{MINUS SIGN} first"), strict=True):
        box(ax, points)
        ax.view_init(elev=24, azim=-52)
        ax.set_title(name, fontweight="bold", color=INK, y=0.98)
    for ax, reach in zip(axes, (then, now), strict=False):
        sides = scatter(ax, reach, reach.dexterity, {"cmap": MAP, "vmin": 0, "vmax": top})
    difference = now.dexterity - then.dexterity
    most = max(0.05, float(np.abs(difference).max()))
    size = float(np.clip(14000 / len(points), 2, 40))
    visible = facing(axes[2], now)
    middle = axes[2].scatter(
        *points[visible].T,
        s=size,
        c=np.ravel(difference)[visible],
        cmap=DIVERGING,
        vmin=-most,
        vmax=most,
        depthshade=False,
    )
    return figure, sides, middle
