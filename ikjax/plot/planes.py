"""Layers of a box grid: which are shown, where they lie, and a posture that shows the arm well in one."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from ikjax.arm.arm import Arm
from ikjax.core.pose import pose
from ikjax.ik.redundancy import middles
from ikjax.ik.select import within_limits
from ikjax.ik.solve import solve
from ikjax.maps.sets.hopf import Hopf
from ikjax.maps.sets.orientations import Even
from ikjax.plot.stick import sticks

Slice = tuple[str, float]
"""The axis normal to a plane, "x", "y" or "z", and the plane's coordinate on it [m]."""


class Plane(NamedTuple):
    """One layer of the grid."""

    axis: int
    layer: int
    at: float
    """Coordinate of the layer [m]."""


def ticks_of(reach) -> tuple[np.ndarray, ...]:
    """The grid's coordinates along x, y and z [m]."""
    grid = reach.positions
    return tuple(float(o) + grid.spacing * np.arange(n) for o, n in zip(grid.origin, grid.shape, strict=True))


def plane_of(reach, piece: Slice) -> Plane:
    """The layer of the grid nearest to a slice."""
    try:
        letter, value = piece
        axis, value = ("x", "y", "z").index(letter), float(value)
    except (TypeError, ValueError) as error:
        raise ValueError(f'a slice must be ("x", "y" or "z", metres), got {piece!r}') from error
    ticks = ticks_of(reach)[axis]
    layer = int(np.argmin(np.abs(ticks - value)))
    return Plane(axis, layer, float(ticks[layer]))


def default_slices(reach) -> list[Slice]:
    """Both vertical planes through the base, and three horizontal ones where most dexterity is."""
    base = np.asarray(reach.arm.base, float)[:3, 3]
    weight = np.asarray(reach.dexterity, float).sum((0, 1))
    share = np.cumsum(weight) / max(float(weight.sum()), 1e-30)
    heights = ticks_of(reach)[2][[int(np.argmax(share >= part)) for part in (0.8, 0.5, 0.2)]]
    level: list[Slice] = [("z", float(z)) for z in heights]
    return [("y", float(base[1])), ("x", float(base[0])), *level]


def shown_axes(axis: int) -> tuple[int, int]:
    """The axes that a plane shows, the horizontal one first."""
    across, up = (k for k in range(3) if k != axis)
    return across, up


def posture(reach, plane: Plane) -> np.ndarray:
    """The arm at a dexterous position far out in the plane, elbow up and as much in the plane as possible."""
    place, across = _place_for_the_tool(reach, plane), shown_axes(plane.axis)[0]

    def quality(q) -> float:
        line = sticks(reach.arm, q).line
        behind = min(0.0, float(line[1:-1, across].min() - line[0, across]))
        return line[:, 2].mean() + behind - 2 * np.ptp(line[:, plane.axis])

    return best_posture(reach.arm, place, quality, tried=orientations_to_try(reach))


def posture_at(reach, place) -> np.ndarray:
    """The arm at a place in an orientation of the map, its links as high as possible."""

    def quality(q) -> float:
        return float(sticks(reach.arm, q).line[:, 2].mean())

    return best_posture(reach.arm, place, quality, tried=orientations_to_try(reach))


def orientations_to_try(reach) -> np.ndarray | None:
    """Rotations (m, 3, 3) that the map was made for, some of them; None where it was made for all."""
    if isinstance(reach.orientations, Even | Hopf):
        return None
    rotations = reach.rotations
    chosen = np.linspace(0, len(rotations) - 1, min(len(rotations), TRIED)).round().astype(int)
    rolls = max(1, min(reach.free_rolls, TRIED // len(chosen)))
    turned = rolled(np.arange(rolls) * (2 * np.pi / rolls))
    return (rotations[chosen][:, None] @ turned).reshape(-1, 3, 3)


def rolled(angles: np.ndarray) -> np.ndarray:
    """Rotations (m, 3, 3) about z by angles (m,) [rad]."""
    zero = np.zeros_like(angles)
    return np.asarray(pose(rpy=np.stack([zero, zero, angles], -1)))[:, :3, :3]


TRIED = 48
"""Orientations of a map that are tried for a posture."""


def place_far_out(reach, axes: tuple[int, int]) -> np.ndarray | None:
    """A reached place of a flat map for the tool: well reached, about two thirds as far out as any."""
    weight = np.asarray(reach.dexterity, float)
    if not weight.any():
        return None
    points = reach.positions.points()
    base = np.asarray(reach.arm.base, float)[:3, 3]
    away = points - base
    distance = np.linalg.norm(away[..., list(axes)], axis=-1)
    wanted = 0.7 * float(distance[weight > 0].max())
    # Forward and to the left, where neither the base nor the legend is.
    side = (away[..., axes[0]] + 0.35 * away[..., axes[1]]) / np.maximum(distance, 1e-9)
    score = weight * np.exp(-(((distance - wanted) / (0.3 * wanted + 1e-9)) ** 2)) * (1.5 + side)
    return points[np.unravel_index(np.argmax(score), score.shape)]


def best_posture(
    arm: Arm, place, quality: Callable[[np.ndarray], float], frame=None, tried: np.ndarray | None = None
) -> np.ndarray:
    """Of the solutions at a place, within the limits if possible, the one of greatest `quality`.

    The tool is tried turned about y, upright and upside down in the world; with a frame (3, 3), turned about
    the frame's z axis only; or with the rotations `tried`, (m, 3, 3), seen from the frame if there is one.
    Without a place, the joints are at zero or as near to it as the limits allow.
    """
    if place is None or arm.family is None:
        return np.clip(0.0, *np.asarray(arm.limits, float).T)
    turns = np.linspace(0, 2 * np.pi, 24, endpoint=False)
    tilt = np.zeros((2, len(turns), 3))
    tilt[:, :, 1], tilt[1, :, 2] = turns, np.pi
    if frame is not None:
        tilt[:, :, 1], tilt[:, :, 2] = 0, turns
    goals = np.array(pose(np.broadcast_to(place, tilt.shape), rpy=tilt, dtype=arm.dtype))
    if tried is not None:
        goals = np.zeros((len(tried), 4, 4), goals.dtype)
        goals[:, :3, :3], goals[:, :3, 3], goals[:, 3, 3] = tried, place, 1
    if frame is not None:
        goals[..., :3, :3] = frame @ goals[..., :3, :3]
    # Several values of a redundant joint are more goals to choose from.
    sol = solve(arm, goals[..., None, :, :], redundancy=redundant_values(arm) if arm.locked else None)
    inside = within_limits(arm, sol)
    valid = np.asarray(inside.valid)
    found = np.asarray(inside.q)[valid if valid.any() else np.asarray(sol.valid)]
    return max(found, key=quality) if len(found) else best_posture(arm, None, quality)


def redundant_values(arm: Arm) -> np.ndarray:
    """Some values of an arm's redundant joints, as `solve` takes them."""
    values = np.asarray(middles(arm.baked(), VALUES, arm.dtype))
    return values[:, 0] if len(arm.locked) == 1 else values


VALUES = 8
"""Of each redundant joint."""


def _place_for_the_tool(reach, plane: Plane) -> np.ndarray | None:
    """A place in the plane for the tool: dexterous, in front of the base and far from it."""
    layer = np.asarray(reach.dexterity).take(plane.layer, plane.axis)
    if not layer.any():
        return None
    across, up = shown_axes(plane.axis)
    ticks, base = ticks_of(reach), np.asarray(reach.arm.base, float)[:3, 3]
    forward = np.maximum(ticks[across] - base[across], 1e-6)[:, None]
    rise = np.maximum(ticks[up] - base[up], 1e-6)[None, :]
    # The square gives dexterity most weight; the root of the height keeps the tool above the floor.
    i, j = np.unravel_index(np.argmax(layer**2 * forward * np.sqrt(rise)), layer.shape)
    place = np.zeros(3)
    place[[across, up, plane.axis]] = ticks[across][i], ticks[up][j], plane.at
    return place
