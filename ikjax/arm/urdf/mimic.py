"""Joints that one motor drives together, rewritten as one joint for each motor where that is exact.

Angles about parallel axes in a row add up: a link turns by the sum of the angles before it. Links that turn
by the same sum can be placed end to end, in any order, and then need one joint. The usual case is a
parallelogram, which keeps the tool level: there the sum is the angle of the first joint.
"""

import numpy as np

from ikjax.arm.axes_to_dh import Axes
from ikjax.core.tolerances import MIMIC_PARALLEL

Joint = tuple[np.ndarray, np.ndarray]
"""A point of its axis, and its row: how far each motor moves it."""


def one_joint_a_motor(given: Axes, rows: np.ndarray) -> tuple[Axes, np.ndarray]:
    """The same motion with parallel neighbors combined.

    Args:
        given: The joints' axes.
        rows: (joints, motors) from motor values to joint values.

    Returns:
        The axes, with as few joints as the rule finds, and their rows. The caller checks whether these
        are as many as the motors.
    """
    kinds, along, combined = "", [], []
    for first, last in _runs(given):
        part = slice(first, last)
        joints = list(zip(given.points[part], rows[part], strict=True))
        directions = [*given.along[part]]
        if len(joints) > rows[part].any(0).sum():
            # Axes of opposite directions count with the opposite sign.
            signs = np.sign(given.along[part] @ directions[0])[:, None]
            combine = _slides if given.kinds[first] == "P" else _turns
            fewer = combine(given.points[part], signs * rows[part], directions[0])
            if len(fewer) < len(joints):
                joints, directions = fewer, [directions[0]] * len(fewer)
        kinds += given.kinds[first] * len(joints)
        along += directions
        combined += joints
    points, combined_rows = ([joint[k] for joint in combined] for k in (0, 1))
    return Axes(kinds, np.array(along), np.array(points), given.tip), np.array(combined_rows)


def _runs(given: Axes) -> list[tuple[int, int]]:
    """First and one past the last of the joints in a row that are of one kind and parallel."""
    runs: list[tuple[int, int]] = []
    for i, kind in enumerate(given.kinds):
        start = runs[-1][0] if runs else -1
        same = runs and given.kinds[start] == kind
        if same and np.linalg.norm(np.cross(given.along[start], given.along[i])) <= MIMIC_PARALLEL:
            runs[-1] = start, i + 1
        else:
            runs.append((i, i + 1))
    return runs


def _slides(points: np.ndarray, rows: np.ndarray, axis: np.ndarray) -> list[Joint]:
    """One prismatic joint for each motor that moves any of them."""
    total = rows.sum(0)
    return [(points[0], np.where(np.arange(len(total)) == k, total, 0)) for k in np.flatnonzero(total)]


def _turns(points: np.ndarray, rows: np.ndarray, axis: np.ndarray) -> list[Joint]:
    """One revolute joint for each sum of angles that a link turns by; the sum of the last link comes last."""
    sums = np.cumsum(rows, axis=0)
    names = [tuple(total.round(12) + 0.0) for total in sums]
    exact = dict(zip(names, sums, strict=True))
    steps = {name: np.zeros(3) for name in names}
    for name, step in zip(names, np.diff(points, axis=0), strict=False):
        steps[name] += step
    end, fixed = names[-1], tuple(np.zeros(len(rows[0])))
    # A link that never turns shifts all that comes after it. The angle of one without length does not matter.
    point = points[0] + steps.pop(fixed, np.zeros(3))
    least = 1e-12 * float(np.abs(points).max())
    order = [name for name, step in steps.items() if name != end and _length(axis, step) > least]
    before, joints = np.zeros(len(fixed)), []
    for name in [*order, end] if order or end != fixed else []:
        # A joint adds what its link turns by more than the link before it.
        joints.append((point, exact[name] - before))
        point, before = point + steps.get(name, np.zeros(3)), exact[name]
    return joints


def _length(axis: np.ndarray, step: np.ndarray) -> float:
    """The length of a step across an axis."""
    return float(np.linalg.norm(np.cross(axis, step)))
