"""An arm as a stick figure, and every branch of a goal as one."""

from typing import NamedTuple

import numpy as np

from ikjax.arm.arm import Arm
from ikjax.arm.forward import fk, frames
from ikjax.core.text import picture
from ikjax.ik.select import within_limits
from ikjax.ik.solve import solve
from ikjax.plot.style import ACCENT, COLORS, INK, STYLE, TRIAD, finish, pyplot


class Sticks(NamedTuple):
    """An arm as lines and points in the world [m]."""

    line: np.ndarray
    """(m, 3) from base to tool, along each link's offset d and then its length a."""
    joints: np.ndarray
    """(n, 3) a point on each joint's axis."""
    tool: np.ndarray
    """(3,)"""


def sticks(arm: Arm, q) -> Sticks:
    """The lines and points of an arm at q, (n,)."""
    return sticks_of(arm, np.asarray(frames(arm, q), float), np.asarray(fk(arm, q), float))


def sticks_of(arm: Arm, stations: np.ndarray, tip: np.ndarray) -> Sticks:
    """The same from the poses of the links, (n + 1, 4, 4), and of the tool, (4, 4)."""
    origins, ahead = stations[:, :3, 3], stations[:, :3, 0]
    # In standard DH a link runs along its joint's axis first, and then along its own x axis.
    corners = origins[1:] - np.asarray(arm.a, float)[:, None] * ahead[1:]
    tool = tip[:3, 3]
    line = [origins[0], *np.stack([corners, origins[1:]], axis=1).reshape(-1, 3), tool]
    return Sticks(np.array(line), origins[:-1], tool)


def arm(arm: Arm, q, ax=None, *, color: str = COLORS[0], width: float = 3.0):
    """A stick figure on a 3-D axis, with its shadow on the floor of the axis.

    Args:
        arm: The arm.
        q: Joint values [rad, m], (n,).
        ax: A 3-D axis, by default of a new figure. Set its limits first: its lower z limit is the floor.
        color, width: Of the links.

    Returns:
        The axis.

    Raises:
        ImportError: Without matplotlib.
    """
    body = sticks(arm, q)
    if ax is None:
        plt = pyplot()
        with plt.rc_context(STYLE):
            ax = plt.figure(figsize=(5, 5)).add_subplot(projection="3d")
            box(ax, body.line)
    draw_3d(ax, body, color, width)
    return ax


def draw_3d(ax, body: Sticks, color: str, width: float) -> None:
    floor = ax.get_zlim()[0]
    x, y, z = body.line.T
    ax.plot(x, y, np.full_like(z, floor), color="#bbbbbb", lw=width * 0.7, alpha=0.6, zorder=1)
    line = {"solid_capstyle": "round", "solid_joinstyle": "round"}
    ax.plot(x, y, z, color=color, lw=width, zorder=3, **line)
    ax.plot(*body.line[0], "s", color=INK, ms=2.2 * width, zorder=4)
    ax.plot(*body.joints.T, "o", color="white", mec=color, mew=0.35 * width, ms=1.5 * width, zorder=5)
    ax.plot(*body.tool, "D", color=INK, ms=1.2 * width, zorder=6)


def box(ax, points: np.ndarray, zoom: float = 0.94) -> None:
    """A cube around all points, so that lengths are equal on the three axes."""
    low, high = points.min(0), points.max(0)
    center, half = (low + high) / 2, 0.55 * max(float((high - low).max()), 1e-9)
    for k, letter in enumerate("xyz"):
        getattr(ax, f"set_{letter}lim")(center[k] - half, center[k] + half)
        getattr(ax, f"set_{letter}label")(f"{letter} [m]", fontsize=7, labelpad=-7)
    ax.set_box_aspect((1, 1, 1), zoom=zoom)
    ax.tick_params(labelsize=6, pad=-3)
    ax.locator_params(nbins=5)


def draw_flat(ax, body: Sticks, axes: tuple[int, int], bold: bool) -> None:
    from matplotlib import patheffects

    width = 3.0 if bold else 1.3
    halo = [patheffects.withStroke(linewidth=width * 2, foreground="white")]
    line, joints, tool = (points[..., list(axes)].T for points in body)
    rounded = {"solid_capstyle": "round", "solid_joinstyle": "round"}
    ax.plot(*line, color=INK, lw=width, path_effects=halo, zorder=3, **rounded)
    ax.plot(*line[:, 0], "s", color=INK, mec="white", ms=3.6 * width, zorder=4)
    if bold:
        ax.plot(*joints[:, 1:], "o", color="white", mec=INK, mew=1.4, ms=6, zorder=5)
    ax.plot(*tool, "D", color=ACCENT, mec="white", ms=2.6 * width, zorder=6)


def branches(arm: Arm, goal, path=None, *, redundancy=None):
    """Every branch of one goal, each as a small stick figure; branches that do not reach it are grey.

    Args:
        arm: An arm with a family.
        goal: T_world_tool, (4, 4). Its frame is drawn as red, green and blue for x, y and z.
        path: Where to save the picture.
        redundancy: The values of the arm's redundant joints, if it has any.

    Returns:
        The figure.

    Raises:
        ImportError: Without matplotlib.
        ValueError: An arm of no family, or more than one goal; see also `solve`.
    """
    plt = pyplot()
    if np.shape(goal) != (4, 4):
        raise ValueError(f"goal must have shape (4, 4), got {np.shape(goal)}")
    sol = solve(arm, goal, redundancy=redundancy)
    inside = np.asarray(within_limits(arm, sol).valid)
    bodies = [sticks(arm, q) for q in np.asarray(sol.q)]
    points = np.concatenate([body.line for body in bodies])
    goal = np.asarray(goal, float)
    rows, columns = -(-len(bodies) // 4), min(len(bodies), 4)
    with plt.rc_context(STYLE):
        figure = plt.figure(figsize=(3.1 * columns, 3.15 * rows + 0.45), layout="constrained")
        figure.get_layout_engine().set(rect=(0, 0, 0.985, 0.995))
        for slot, body in enumerate(bodies):
            ax = figure.add_subplot(rows, columns, slot + 1, projection="3d")
            box(ax, points)
            ax.view_init(elev=22, azim=np.degrees(np.arctan2(goal[1, 3], goal[0, 3])) - 62)
            valid = bool(sol.valid[slot])
            state = "within limits" if inside[slot] else "outside limits" if valid else "does not reach"
            name = picture(arm.branches[slot])
            ax.set_title(f"{slot}  {name}\n{state}", color=INK if valid else "#999999", y=0.96)
            draw_3d(ax, body, COLORS[slot % len(COLORS)] if valid else "#b8b8b8", 2.6)
            _triad(ax, goal, 0.13 * float(np.ptp(points, axis=0).max()))
        found, share = int(np.sum(sol.valid)), int(np.sum(inside))
        title = (
            f"{picture(arm.name)}: {found} of {len(bodies)} branches reach the goal, {share} within limits"
        )
        figure.suptitle(title, fontsize=12, fontweight="bold")
    return finish(figure, path)


def _triad(ax, goal: np.ndarray, length: float) -> None:
    tail = goal[:3, 3]
    for axis, color in zip(goal[:3, :3].T, TRIAD, strict=True):
        ax.plot(*np.stack([tail, tail + length * axis]).T, color=color, lw=1.8, zorder=7)
