"""A map of points, of a surface or from a list, with the arm."""

import math
from typing import Any

import numpy as np

from ikjax.plot.disc import head, label
from ikjax.plot.planes import best_posture, orientations_to_try
from ikjax.plot.stick import box, draw_3d, sticks
from ikjax.plot.style import INK, MAP, PALE, STYLE, finish, pyplot

VIEWS = (("seen from +x, \N{MINUS SIGN}y", -52), ("seen from \N{MINUS SIGN}x, +y", 128))


def point_map(reach, path=None, q=None):
    """The points colored by dexterity, seen from two sides, with the arm at the most dexterous one."""
    plt = pyplot()
    top = max(0.1, math.ceil(10 * float(np.max(reach.dexterity, initial=0))) / 10)
    body = sticks(reach.arm, _posture(reach) if q is None else q)
    with plt.rc_context(STYLE):
        figure = plt.figure(figsize=(11.2, 5.6), layout="constrained")
        figure.get_layout_engine().set(rect=(0.005, 0.0, 0.985, 0.88))
        for k, (name, azimuth) in enumerate(VIEWS):
            ax = figure.add_subplot(1, 2, k + 1, projection="3d", computed_zorder=False)
            box(ax, np.concatenate([reach.positions.points().reshape(-1, 3), body.line]), 1.05)
            ax.view_init(elev=24, azim=azimuth)
            ax.set_title(name, fontweight="bold", color=INK, y=0.98)
            image = scatter(ax, reach, reach.dexterity, {"cmap": MAP, "vmin": 0, "vmax": top})
            draw_3d(ax, body, INK, 2.6)
        label(figure, image, "share of orientations reachable")
        hit = float((reach.dexterity > 0).mean())
        seen = ", seen from the surface" if getattr(reach.positions, "normals", None) is not None else ""
        caption = (
            f"{hit:.0%} of {reach.positions.in_words()} reached within the joint limits, in "
            f"{float(reach.dexterity.mean()):.0%} of {reach.orientation_count:,} orientations{seen}, "
            "on average."
        )
        head(figure, reach.heading, caption)
        from matplotlib.lines import Line2D

        rings = [
            Line2D([], [], ls="", marker="o", mfc=face, mec=edge, label=text)
            for face, edge, text in (
                (PALE, "#9a9a9a", "beyond the joint limits"),
                ("white", INK, "out of reach"),
            )
        ]
        figure.legend(handles=rings, loc="lower center", ncols=2, frameon=False, bbox_to_anchor=(0.46, 0.0))
    return finish(figure, path)


def scatter(ax, reach, values: np.ndarray, colors: dict[str, Any]) -> Any:
    """Reached points in colors, others as rings; returns the colored ones, for a color bar.

    Of a surface with normals only the points that face the viewer are drawn.
    """
    points = reach.positions.points().reshape(-1, 3)
    size = float(np.clip(14000 / len(points), 2, 40))
    visible = facing(ax, reach)
    points, values = points[visible], np.ravel(values)[visible]
    within, anyhow = (np.ravel(np.asarray(x))[visible] > 0 for x in (reach.reachable_within, reach.reachable))
    ring = {"depthshade": False, "linewidths": 0.6, "zorder": 1}
    ax.scatter(*points[~anyhow].T, s=size, c="white", edgecolors=INK, **ring)
    ax.scatter(*points[anyhow & ~within].T, s=size, c=PALE, edgecolors="#9a9a9a", **ring)
    plain = {"depthshade": False, "linewidths": 0, "zorder": 2}
    return ax.scatter(*points[within].T, s=size, c=values[within], **plain, **colors)


def facing(ax, reach) -> np.ndarray:
    """Which points face the viewer, (n,) bool; all where there are no normals."""
    normals = getattr(reach.positions, "normals", None)
    if normals is None:
        return np.ones(reach.positions.count, bool)
    up, around = np.radians([ax.elev, ax.azim])
    return normals @ [np.cos(up) * np.cos(around), np.cos(up) * np.sin(around), np.sin(up)] > 0


def _posture(reach) -> np.ndarray:
    """The arm at its most dexterous point, its links as high as possible."""
    arm, dexterity = reach.arm, np.ravel(reach.dexterity)
    k = int(np.argmax(dexterity))
    frames = getattr(reach.positions, "frames", lambda: None)()
    place = reach.positions.points().reshape(-1, 3)[k] if dexterity[k] > 0 else None
    frame = None if frames is None else frames[k]
    tried = orientations_to_try(reach)
    return best_posture(arm, place, lambda q: float(sticks(arm, q).line[:, 2].mean()), frame, tried)
