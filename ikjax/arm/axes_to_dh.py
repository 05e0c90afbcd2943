"""Axes in space rewritten as a DH table, and a correction for what the table leaves out.

A file or a calibration places each axis by rounded or measured numbers. Axes that are
parallel, perpendicular or meeting within a tolerance are made so exactly in the table; the rest becomes
one small correction after each link, so that the arm is the one that was given.

Source: Denavit and Hartenberg's rule after Spong, Robot Modeling and Control, section 3.2.2.
"""

from typing import NamedTuple

import numpy as np

from ikjax.arm.dh import link_matrix
from ikjax.core.tolerances import FARTHEST_NORMAL, NEARLY_PARALLEL


class Axes(NamedTuple):
    """The joints' axes and the tool at q = 0, in the frame of the base."""

    kinds: str
    """ "R" or "P" for each joint."""
    along: np.ndarray
    """(n, 3) unit directions."""
    points: np.ndarray
    """(n, 3) a point of each [m]."""
    tip: np.ndarray
    """(4, 4) the tool."""


class Rewritten(NamedTuple):
    """A DH table with its base, tool and correction."""

    columns: dict[str, np.ndarray]
    """Standard DH: a, alpha, d, theta."""
    base: np.ndarray
    tool: np.ndarray
    correction: np.ndarray
    """(n + 1, 6) after the base and after each link: shift [m], then rotation vector [rad]."""


def rewritten(axes: Axes, tolerance: float) -> Rewritten:
    """A DH table whose axes are parallel, perpendicular or meeting where those given are to the tolerance.

    The common normal of axes that are parallel but for rounding is kilometres away. They are made parallel
    whatever the tolerance, so that the numbers of the table have the arm's own size.

    Args:
        axes: The axes as given.
        tolerance: [rad], and as a share of the arm's size.

    Returns:
        The table. With its correction its frames have the axes as given.
    """
    n = len(axes.kinds)
    size = size_of(axes)
    table = _first(axes)
    exact = table
    given = _on_axis(table, axes.along[0], axes.points[0])
    base, corrections = table, [twist_of(np.linalg.inv(table) @ given)]
    columns = {name: np.zeros(n) for name in ("a", "alpha", "d", "theta")}
    for i in range(n - 1):
        theta, d, a, alpha = _link(exact, axes, i, tolerance, size)
        for name, value in zip(("theta", "d", "a", "alpha"), (theta, d, a, alpha), strict=True):
            columns[name][i] = value
        step = link_matrix(theta, d, a, np.sin(alpha), np.cos(alpha))
        exact = exact @ step
        following = _on_axis(exact, axes.along[i + 1], _point(axes, i + 1, exact))
        # At q the link as given ends at given Rz(q) given^-1 following; with this correction the table's link
        # ends there too: given Rz(q) step correction.
        corrections.append(twist_of(np.linalg.inv(step) @ np.linalg.inv(given) @ following))
        given = following
    corrections.append(np.zeros(6))
    tool = np.linalg.inv(given) @ axes.tip
    return Rewritten(columns, base, tool, np.stack(corrections))


def size_of(axes: Axes) -> float:
    """The size of the arm [m]: from the base from axis to axis by nearest points, to the tool.

    A table may name points of an axis that are kilometres away.
    """
    ends = [np.zeros(3)]
    for along, point in zip(axes.along, axes.points, strict=True):
        ends.append(point + ((ends[-1] - point) @ along) * along)
    ends.append(axes.tip[:3, 3])
    return max(float(np.linalg.norm(np.diff(ends, axis=0), axis=1).sum()), 1e-300)


def _first(axes: Axes) -> np.ndarray:
    """A frame on axis 1: its origin is the point nearest to the base, its x is near the base's x, or y."""
    z = axes.along[0]
    point = axes.points[0] - (axes.points[0] @ z) * z
    x = np.eye(3)[0] if abs(z[0]) < 0.9 else np.eye(3)[1]
    return _frame(x, z, point)


def _frame(x: np.ndarray, z: np.ndarray, origin: np.ndarray) -> np.ndarray:
    """(4, 4) a frame with this z, and an x that is made perpendicular to it."""
    x = x - (x @ z) * z
    x = x / np.linalg.norm(x)
    frame = np.eye(4)
    frame[:3, :3] = np.stack([x, np.cross(z, x), z], axis=1)
    frame[:3, 3] = origin
    return frame


def _on_axis(frame: np.ndarray, along: np.ndarray, point: np.ndarray) -> np.ndarray:
    """The frame on an axis that is nearest to another frame."""
    origin = point + ((frame[:3, 3] - point) @ along) * along
    return _frame(frame[:3, 0], along, origin)


def _point(axes: Axes, i: int, exact: np.ndarray) -> np.ndarray:
    """A point of an axis. A prismatic axis has only a direction: it goes through the table's origin."""
    return axes.points[i] if axes.kinds[i] == "R" else exact[:3, 3]


def _link(frame: np.ndarray, axes: Axes, i: int, tolerance: float, size: float):
    """theta, d, a, alpha from a frame on axis i to one on axis i + 1.

    Source: Spong, Robot Modeling and Control, section 3.2.2.
    """
    along, least = axes.along[i + 1], tolerance * size
    origin, z = frame[:3, 3], frame[:3, 2]
    point = axes.points[i + 1] if axes.kinds[i + 1] == "R" else origin
    cross = np.cross(z, along)
    sine, cosine = float(np.linalg.norm(cross)), float(z @ along)
    gap = point - origin
    far = abs(float(np.cross(gap, along) @ cross)) > FARTHEST_NORMAL * size * sine**2
    if sine <= tolerance or (far and sine <= NEARLY_PARALLEL):
        # Parallel axes have many common normals: that through the frame's own origin has d = 0.
        gap = gap - (gap @ along) * along
        normal = gap - (gap @ z) * z
        a, d = float(np.linalg.norm(normal)), 0.0
        x = normal / a if a > least else frame[:3, 0]
        a = a if a > least else 0.0
        alpha = 0.0 if cosine > 0 else np.pi
    else:
        x = cross / sine
        d = float(np.cross(gap, along) @ cross) / sine**2
        a = float(gap @ x)
        if a < 0:
            x, a = -x, -a
        alpha = float(np.arctan2(np.cross(z, along) @ x, cosine))
        if abs(cosine) <= tolerance:
            alpha = np.copysign(np.pi / 2, alpha)
        a = a if a > least else 0.0
        d = d if abs(d) > least else 0.0
    theta = float(np.arctan2(x @ frame[:3, 1], x @ frame[:3, 0]))
    if a == 0 and abs(theta) > np.pi / 2:
        # The normal of meeting axes may point either way; the smaller theta is easier to read.
        theta, alpha = theta - np.copysign(np.pi, theta), -alpha
    if axes.kinds[i] == "P":
        quarter = np.round(theta / (np.pi / 2)) * np.pi / 2
        theta = quarter if abs(theta - quarter) <= tolerance else theta
    return theta, d, a, alpha


def small_pose(twist: np.ndarray) -> np.ndarray:
    """(4, 4) the pose of a shift and a rotation vector, (6,).

    Source: Rodrigues' formula.
    """
    pose, angle = np.eye(4), float(np.linalg.norm(twist[3:]))
    x, y, z = twist[3:]
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    # sin(t) / t and (1 - cos(t)) / t^2, with their limits at zero.
    first, second = np.sinc(angle / np.pi), np.sinc(angle / (2 * np.pi)) ** 2 / 2
    pose[:3, :3] += first * cross + second * cross @ cross
    pose[:3, 3] = twist[:3]
    return pose


def twist_of(pose: np.ndarray) -> np.ndarray:
    """(6,) the shift and the rotation vector of a pose near the identity; the inverse of `small_pose`."""
    r = pose[:3, :3]
    axial = np.array([r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1]]) / 2
    sine = float(np.linalg.norm(axial))
    angle = np.arctan2(sine, (np.trace(r) - 1) / 2)
    return np.concatenate([pose[:3, 3], axial * (angle / sine if sine > 1e-12 else 1.0)])
