"""Pictures: the dexterity of a workspace in slices, the branches of a goal, an arm as a stick figure.

Storey: plot. Needs matplotlib (`pip install ikjax[viz]`), which is imported at the first picture.
A figure is left open for `plt.show()`, unless it is given a path: then it is saved and closed.
Metres everywhere, to one scale on all axes.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from ikjax.arm.arm import Arm
from ikjax.arm.forward import fk, frames
from ikjax.core.pose import pose
from ikjax.ik.select import within_limits
from ikjax.ik.solve import solve

Slice = tuple[str, float]
"""The axis a plane is square to, "x", "y" or "z", and where on it the plane lies [m]."""

DPI = 200
MAP = "viridis"
INK, PALE, ACCENT = "#1b1b1b", "#e3e3e3", "#d1495b"
TRIAD = ("#d1495b", "#2a9d5c", "#2f6fde")
# Okabe and Ito's colours, told apart by colour-blind readers; their yellow is too pale for lines.
COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#56b4e9", "#e69f00", "#7a4fb5", "#6b6b00")
_STYLE = {"font.size": 9, "axes.titlesize": 9, "axes.edgecolor": "#888888", "axes.linewidth": 0.6}
_STYLE |= {"xtick.color": "#555555", "ytick.color": "#555555", "xtick.labelsize": 8, "ytick.labelsize": 8}
_STYLE |= {"grid.color": "#dddddd", "grid.linewidth": 0.6}
_STYLE |= {f"axes3d.{k}axis.panecolor": (0.97, 0.97, 0.97, 0.6) for k in "xyz"}


def _pyplot() -> Any:
    try:
        import matplotlib.pyplot as plt
    except ImportError as error:
        raise ImportError("pictures need matplotlib: pip install ikjax[viz]") from error
    return plt


def _finish(figure, path):
    """The figure; saved and closed where a path is given."""
    if path is not None:
        figure.savefig(path, dpi=DPI)
        _pyplot().close(figure)
    return figure


def file_types() -> tuple[str, ...]:
    """Endings that `path` may have, without the dot."""
    plt = _pyplot()
    canvas = plt.figure().canvas
    plt.close(canvas.figure)
    return tuple(sorted(canvas.get_supported_filetypes()))


class Sticks(NamedTuple):
    """An arm as lines and points in the world [m]."""

    line: np.ndarray
    """(m, 3) base to tool, along each link's offset and then its length."""
    joints: np.ndarray
    """(n, 3) a point on each joint's axis."""
    tool: np.ndarray
    """(3,)"""


def sticks(arm: Arm, q) -> Sticks:
    """What is drawn of an arm at q, (n,)."""
    stations = np.asarray(frames(arm, q), float)
    origins, ahead = stations[:, :3, 3], stations[:, :3, 0]
    # In standard DH a link goes along its joint's axis first and along its own x axis last.
    corners = origins[1:] - np.asarray(arm.a, float)[:, None] * ahead[1:]
    tool = np.asarray(fk(arm, q), float)[:3, 3]
    line = [origins[0], *np.stack([corners, origins[1:]], axis=1).reshape(-1, 3), tool]
    return Sticks(np.array(line), origins[:-1], tool)


def arm(arm: Arm, q, ax=None, *, colour: str = COLOURS[0], width: float = 3.0):
    """A stick figure on a 3-D axis, with its shadow where the axis has a floor.

    Args:
        arm: The arm.
        q: Joint values [rad, m], (n,).
        ax: A 3-D axis; a new figure's by default. Set its limits first: the shadow falls on them.
        colour, width: Of the links.

    Returns:
        The axis.

    Raises:
        ImportError: Without matplotlib.
    """
    body = sticks(arm, q)
    if ax is None:
        plt = _pyplot()
        with plt.rc_context(_STYLE):
            ax = plt.figure(figsize=(5, 5)).add_subplot(projection="3d")
            _box(ax, body.line)
    _draw_3d(ax, body, colour, width)
    return ax


def _draw_3d(ax, body: Sticks, colour: str, width: float) -> None:
    floor = ax.get_zlim()[0]
    x, y, z = body.line.T
    ax.plot(x, y, np.full_like(z, floor), color="#bbbbbb", lw=width * 0.7, alpha=0.6, zorder=1)
    line = {"solid_capstyle": "round", "solid_joinstyle": "round"}
    ax.plot(x, y, z, color=colour, lw=width, zorder=3, **line)
    ax.plot(*body.line[0], "s", color=INK, ms=2.2 * width, zorder=4)
    ax.plot(*body.joints.T, "o", color="white", mec=colour, mew=0.35 * width, ms=1.5 * width, zorder=5)
    ax.plot(*body.tool, "D", color=INK, ms=1.2 * width, zorder=6)


def _box(ax, points: np.ndarray) -> None:
    """A cube around all points, so that lengths are equal on the three axes."""
    low, high = points.min(0), points.max(0)
    centre, half = (low + high) / 2, 0.55 * max(float((high - low).max()), 1e-9)
    for k, letter in enumerate("xyz"):
        getattr(ax, f"set_{letter}lim")(centre[k] - half, centre[k] + half)
        getattr(ax, f"set_{letter}label")(f"{letter} [m]", fontsize=7, labelpad=-7)
    ax.set_box_aspect((1, 1, 1), zoom=0.94)
    ax.tick_params(labelsize=6, pad=-3)
    ax.locator_params(nbins=5)


def branches(arm: Arm, goal, path=None):
    """Every branch of one goal, a small stick figure each; those that do not reach it are grey.

    Args:
        arm: An arm with a family.
        goal: T_world_tool, (4, 4). Its frame is drawn as red, green and blue for x, y and z.
        path: Where to save the picture.

    Returns:
        The figure.

    Raises:
        ImportError: Without matplotlib.
        ValueError: An arm of no family, or more than one goal.
    """
    plt = _pyplot()
    if np.shape(goal) != (4, 4):
        raise ValueError(f"goal must have shape (4, 4), got {np.shape(goal)}")
    sol = solve(arm, goal)
    inside = np.asarray(within_limits(arm, sol).valid)
    bodies = [sticks(arm, q) for q in np.asarray(sol.q)]
    points = np.concatenate([body.line for body in bodies])
    goal = np.asarray(goal, float)
    rows, columns = -(-len(bodies) // 4), min(len(bodies), 4)
    with plt.rc_context(_STYLE):
        figure = plt.figure(figsize=(3.1 * columns, 3.15 * rows + 0.45), layout="constrained")
        figure.get_layout_engine().set(rect=(0, 0, 0.985, 0.995))
        for slot, body in enumerate(bodies):
            ax = figure.add_subplot(rows, columns, slot + 1, projection="3d")
            _box(ax, points)
            ax.view_init(elev=22, azim=np.degrees(np.arctan2(goal[1, 3], goal[0, 3])) - 62)
            valid = bool(sol.valid[slot])
            state = "within limits" if inside[slot] else "outside limits" if valid else "does not reach"
            ax.set_title(f"{slot}  {arm.branches[slot]}\n{state}", color=INK if valid else "#999999", y=0.96)
            _draw_3d(ax, body, COLOURS[slot % len(COLOURS)] if valid else "#b8b8b8", 2.6)
            _triad(ax, goal, 0.13 * float(np.ptp(points, axis=0).max()))
        found, share = int(np.sum(sol.valid)), int(np.sum(inside))
        title = f"{arm.name}: {found} of {len(bodies)} branches reach the goal, {share} within limits"
        figure.suptitle(title, fontsize=12, fontweight="bold", parse_math=False)
    return _finish(figure, path)


def _triad(ax, goal: np.ndarray, length: float) -> None:
    tail = goal[:3, 3]
    for axis, colour in zip(goal[:3, :3].T, TRIAD, strict=True):
        ax.plot(*np.stack([tail, tail + length * axis]).T, color=colour, lw=1.8, zorder=7)


def reach_map(reach, path=None, q=None, slices: Sequence[Slice] | None = None):
    """A workspace in slices, coloured by dexterity, with the arm in the largest.

    White cannot be reached; grey can, but not within the joint limits.

    Args:
        reach: A `ReachMap`, from `ikjax.sweep`.
        path: Where to save the picture.
        q: (n,) posture to draw; by default the arm reaches for its most dexterous place.
        slices: Planes, the largest picture first; by default one upright plane through the base each
            way, and three level ones. Each shows the layer of the grid that is nearest.

    Returns:
        The figure.

    Raises:
        ImportError: Without matplotlib.
        ValueError: A slice that is not ("x", "y" or "z", metres).
    """
    plt = _pyplot()
    planes = [_plane(reach, piece) for piece in (_usual(reach) if slices is None else slices)]
    body = sticks(reach.arm, _posture(reach, planes[0]) if q is None else q)
    span = _span(reach, body)
    top = max(0.1, np.ceil(10 * float(np.max(reach.dexterity, initial=0))) / 10)
    with plt.rc_context(_STYLE):
        figure = plt.figure(figsize=(13, 6.7), layout="constrained")
        axes = _panels(figure, len(planes))
        images = [_draw_plane(ax, reach, plane, span, top) for ax, plane in zip(axes, planes, strict=True)]
        for ax, plane in zip(axes, planes, strict=True):
            _draw_arm(ax, body, _kept(plane.axis), bold=ax is axes[0])
        _mark(axes[0], planes)
        bar = figure.colorbar(images[0], ax=axes, shrink=0.9, aspect=34, pad=0.012, format="{x:.0%}")
        bar.set_label("share of orientations reachable", fontsize=10)
        bar.outline.set_visible(False)
        _head(figure, reach)
    return _finish(figure, path)


class Plane(NamedTuple):
    """One layer of the grid."""

    axis: int
    layer: int
    at: float
    """Where the layer really lies [m]."""


def _ticks(reach) -> tuple[np.ndarray, ...]:
    """The grid's coordinates along x, y and z [m]."""
    grid = reach.grid
    return tuple(float(o) + grid.spacing * np.arange(n) for o, n in zip(grid.origin, grid.shape, strict=True))


def _plane(reach, piece: Slice) -> Plane:
    try:
        letter, value = piece
        axis, value = ("x", "y", "z").index(letter), float(value)
    except (TypeError, ValueError) as error:
        raise ValueError(f'a slice must be ("x", "y" or "z", metres), got {piece!r}') from error
    ticks = _ticks(reach)[axis]
    layer = int(np.argmin(np.abs(ticks - value)))
    return Plane(axis, layer, float(ticks[layer]))


def _usual(reach) -> list[Slice]:
    """Both upright planes through the base, and level ones where the dexterity lies."""
    base = np.asarray(reach.arm.base, float)[:3, 3]
    weight = np.asarray(reach.dexterity, float).sum((0, 1))
    share = np.cumsum(weight) / max(float(weight.sum()), 1e-30)
    heights = _ticks(reach)[2][[int(np.argmax(share >= part)) for part in (0.8, 0.5, 0.2)]]
    level: list[Slice] = [("z", float(z)) for z in heights]
    return [("y", float(base[1])), ("x", float(base[0])), *level]


def _kept(axis: int) -> tuple[int, int]:
    """The axes that a plane shows, level first."""
    across, up = (k for k in range(3) if k != axis)
    return across, up


def _posture(reach, plane: Plane) -> np.ndarray:
    """The arm at a dexterous cell well out in the plane, elbow up and as flat in it as can be."""
    arm = reach.arm
    place = _place_to_touch(reach, plane)
    if place is None or arm.family is None:
        return np.clip(0.0, *np.asarray(arm.limits, float).T)
    turns = np.linspace(0, 2 * np.pi, 24, endpoint=False)
    tilt = np.zeros((2, len(turns), 3))
    tilt[:, :, 1], tilt[1, :, 2] = turns, np.pi
    sol = solve(arm, pose(np.broadcast_to(place, tilt.shape), rpy=tilt, dtype=arm.dtype))
    valid = np.asarray(within_limits(arm, sol).valid)
    found = np.asarray(within_limits(arm, sol).q)[valid if valid.any() else np.asarray(sol.valid)]
    across = _kept(plane.axis)[0]

    def looks(q) -> float:
        line = sticks(arm, q).line
        behind = min(0.0, float(line[1:-1, across].min() - line[0, across]))
        return line[:, 2].mean() + behind - 2 * np.ptp(line[:, plane.axis])

    return max(found, key=looks)


def _place_to_touch(reach, plane: Plane) -> np.ndarray | None:
    """Where in the plane a tool shows the arm well: dexterous, in front of the base, far from it."""
    layer = np.asarray(reach.dexterity).take(plane.layer, plane.axis)
    if not layer.any():
        return None
    across, up = _kept(plane.axis)
    ticks, base = _ticks(reach), np.asarray(reach.arm.base, float)[:3, 3]
    ahead = np.maximum(ticks[across] - base[across], 1e-6)[:, None]
    rise = np.maximum(ticks[up] - base[up], 1e-6)[None, :]
    # The square asks for dexterity first; the root of the height keeps the tool off the floor.
    i, j = np.unravel_index(np.argmax(layer**2 * ahead * np.sqrt(rise)), layer.shape)
    place = np.zeros(3)
    place[[across, up, plane.axis]] = ticks[across][i], ticks[up][j], plane.at
    return place


def _span(reach, body: Sticks) -> np.ndarray:
    """(3, 2) what the panels show [m]: all that can be reached, the base and the arm."""
    cells = np.argwhere(np.asarray(reach.reachable) > 0)
    corners = np.asarray(reach.grid.origin, float) + reach.grid.spacing * np.array(
        [cells.min(0), cells.max(0)] if len(cells) else [np.zeros(3), np.subtract(reach.grid.shape, 1)]
    )
    points = np.concatenate([corners, body.line])
    return np.stack([points.min(0), points.max(0)], axis=1) + np.array([-1.5, 1.5]) * reach.grid.spacing


def _panels(figure, count: int) -> list:
    """One large axis on the left, the others two abreast on the right."""
    rows = max(1, count // 2)
    columns = 2 if count > 2 else max(0, count - 1)
    figure.get_layout_engine().set(rect=(0.005, 0.005, 0.99, 0.885), w_pad=0.08, h_pad=0.1)
    ratios = [1.08 * rows] + [1] * columns
    grid = figure.add_gridspec(rows, 1 + columns, width_ratios=ratios)
    axes = [figure.add_subplot(grid[:, 0])]
    for k in range(count - 1):
        axes.append(figure.add_subplot(grid[k // 2, 1 + k % 2]))
    return axes


def _draw_plane(ax, reach, plane: Plane, span: np.ndarray, top: float):
    """One layer's dexterity; the image, for the colour bar."""
    across, up = _kept(plane.axis)
    ticks, half = _ticks(reach), reach.grid.spacing / 2
    frame = [ticks[across][0] - half, ticks[across][-1] + half, ticks[up][0] - half, ticks[up][-1] + half]

    def layer(values) -> np.ndarray:
        return np.asarray(values).take(plane.layer, plane.axis).T

    within, anyhow = layer(reach.reachable_within) > 0, layer(reach.reachable) > 0
    settings = {"origin": "lower", "extent": frame, "interpolation": "nearest"}
    grey = np.ma.masked_where(within | ~anyhow, np.ones(within.shape))
    ax.imshow(grey, cmap=_flat(PALE), **settings)
    shown = np.ma.masked_where(~within, layer(reach.dexterity))
    image = ax.imshow(shown, cmap=MAP, vmin=0, vmax=top, **settings)
    ax.set(xlim=span[across], ylim=span[up], aspect="equal")
    ax.set(xlabel=f"{'xyz'[across]} [m]", ylabel=f"{'xyz'[up]} [m]")
    at = f"{plane.at:.2f}".replace("-0.00", "0.00").replace("-", "\N{MINUS SIGN}")
    ax.set_title(f"{'xyz'[plane.axis]} = {at} m", loc="left", fontweight="bold", color=INK)
    ax.spines[["top", "right"]].set_visible(False)
    return image


def _flat(colour: str):
    from matplotlib.colors import ListedColormap

    return ListedColormap([colour])


def _draw_arm(ax, body: Sticks, kept: tuple[int, int], bold: bool) -> None:
    from matplotlib import patheffects

    width = 3.0 if bold else 1.3
    halo = [patheffects.withStroke(linewidth=width * 2, foreground="white")]
    line, joints, tool = (points[..., list(kept)].T for points in body)
    rounded = {"solid_capstyle": "round", "solid_joinstyle": "round"}
    ax.plot(*line, color=INK, lw=width, path_effects=halo, zorder=3, **rounded)
    ax.plot(*line[:, 0], "s", color=INK, mec="white", ms=3.6 * width, zorder=4)
    if bold:
        ax.plot(*joints[:, 1:], "o", color="white", mec=INK, mew=1.4, ms=6, zorder=5)
    ax.plot(*tool, "D", color=ACCENT, mec="white", ms=2.6 * width, zorder=6)


def _mark(ax, planes: list[Plane]) -> None:
    """Thin lines in the first panel where the others cut it."""
    across, up = _kept(planes[0].axis)
    for plane in planes[1:]:
        draw = {across: ax.axvline, up: ax.axhline}.get(plane.axis)
        if draw:
            draw(plane.at, color="#666666", lw=0.8, ls=(0, (5, 4)), zorder=2)


def _head(figure, reach) -> None:
    """The arm's name, what the map says in numbers, and what grey means."""
    volume = float((np.asarray(reach.reachable_within) > 0).sum() * reach.grid.spacing**3)
    best = float(np.max(reach.dexterity, initial=0))
    said = (
        f"{volume:.3g} m³ within reach and joint limits; at best {best:.0%} of orientations.   "
        f"{reach.goals:,} goals: {reach.grid.count:,} positions {reach.grid.spacing * 1000:.3g} mm apart "
        f"× {reach.orientations:,} orientations."
    )
    left = {"x": 0.012, "ha": "left", "va": "top"}
    figure.suptitle(reach.arm.name, y=0.985, fontsize=16, fontweight="bold", parse_math=False, **left)
    figure.text(y=0.925, s=said, fontsize=10, color="#444444", **left)
    if (np.asarray(reach.reachable) > reach.reachable_within).any():
        from matplotlib.patches import Patch

        grey = Patch(color=PALE, label="within reach, beyond the joint limits")
        where = {"loc": "upper right", "bbox_to_anchor": (0.995, 0.945)}
        figure.legend(handles=[grey], frameon=False, handlelength=1, handleheight=1, **where)
