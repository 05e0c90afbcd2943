"""Robots as tables of data: TOML files in `tables/`, a file for each maker or kind, a table for each robot.

    [kr6_r900]
    title = "..."           # the robot, and the frame that is its tool
    maker = "..."
    source = "..."          # of the lengths and limits
    pose_source = "..."     # of the named poses
    note = "..."            # what a user must know: optional
    units = "mm deg"        # or "m rad": of lengths and angles below; "mm deg" by default
    kinds = "RRPR"          # all revolute by default
    limits = [[-170, 170], ...]     # or limits_rad, in m and rad whatever the units
    poses = { zero = [0, 0, ...] }  # or poses_rad
    base, tool = [0, 0, 107, 0, 0, 0]  # x, y, z, roll, pitch, yaw: the identity by default
    axis_tolerance = 1e-3   # as in `Arm.from_dh`: optional
    family = "..."          # likewise, where rounded lengths look like those of another

and one of

    convention = "standard"  # or "modified"
    dh = [[0, -90, 290, 0], ...]       # a, alpha, d, theta of each row
    turns = [1, -1, ...]               # joints that turn about the table's axis the other way: optional

    joints = [[0, 0, 290, 0, 0, 0, "z"], ...]  # x, y, z, roll, pitch, yaw in the joint before, the axis there
"""

import functools
import tomllib
from importlib import resources
from typing import Any

import numpy as np

from ikjax.arm import dh
from ikjax.arm.arm import Arm
from ikjax.arm.axes_to_dh import Axes, rewritten
from ikjax.arm.urdf.reader import rotation_of
from ikjax.core.tolerances import FACT

MM, DEG = 1e-3, np.pi / 180
AXES = {
    sign + name: (-1.0 if sign else 1.0) * np.eye(3)[i] for i, name in enumerate("xyz") for sign in ("", "-")
}


@functools.cache
def tables() -> dict[str, dict[str, Any]]:
    """Every robot of the files by name, as it stands there."""
    found: dict[str, dict[str, Any]] = {}
    for file in sorted(
        resources.files("ikjax.arm.robots").joinpath("tables").iterdir(), key=lambda x: x.name
    ):
        if file.name.endswith(".toml"):
            for name, table in tomllib.loads(file.read_text(encoding="utf-8")).items():
                if name in found:
                    raise ValueError(f"two robots are called {name!r}, the second in {file.name}")
                found[name] = table
    return found


def build(name: str) -> Arm:
    """The arm of a robot's table."""
    table = tables()[name]
    kinds = _kinds(table)
    length, angle = _units(table)
    base, tool = (_pose(table.get(key, [0] * 6), length, angle) for key in ("base", "tool"))
    limits = _values(table, "limits", kinds)
    options: dict[str, Any] = {"limits": limits, "kinds": kinds, "name": name, "family": table.get("family")}
    if "dh" in table and "turns" not in table:
        return Arm.from_dh(
            **_columns(table["dh"], length, angle),
            **options,
            base=base,
            tool=tool,
            convention=table["convention"],
            axis_tolerance=table.get("axis_tolerance"),
        )
    axes = _axes(table, kinds, base, tool, length, angle)
    exact = rewritten(axes, FACT)
    columns: dict[str, Any] = exact.columns
    return Arm.from_dh(**columns, **options, base=exact.base, tool=exact.tool, convention="standard")


def poses(name: str) -> dict[str, tuple[float, ...]]:
    """The named poses of a robot's table [rad, m]."""
    table = tables()[name]
    kinds = _kinds(table)
    named = table.get("poses_rad", table.get("poses", {}))
    scale = np.ones(len(kinds)) if "poses_rad" in table else _scale(table, kinds)
    return {pose: tuple(float(x) for x in scale * q) for pose, q in named.items()}


def _kinds(table: dict) -> str:
    rows = table["dh"] if "dh" in table else table["joints"]
    return table.get("kinds", "R" * len(rows))


def _units(table: dict) -> tuple[float, float]:
    """What a length and an angle of the table are in m and rad."""
    units = table.get("units", "mm deg")
    if units not in ("mm deg", "m rad"):
        raise ValueError(f'units must be "mm deg" or "m rad", got {units!r}')
    return (MM, DEG) if units == "mm deg" else (1.0, 1.0)


def _scale(table: dict, kinds: str) -> np.ndarray:
    length, angle = _units(table)
    return np.array([angle if kind == "R" else length for kind in kinds])


def _values(table: dict, key: str, kinds: str) -> np.ndarray:
    """(n, 2) the limits [rad, m]."""
    if f"{key}_rad" in table:
        return np.array(table[f"{key}_rad"], float)
    return np.array(table[key], float) * _scale(table, kinds)[:, None]


def _columns(rows: list, length: float, angle: float) -> dict[str, Any]:
    a, alpha, d, theta = np.array(rows, float).T
    # Divided, so that 89.159 mm are the number nearest to 0.089159 m.
    lengths = (lambda x: x / 1000) if length == MM else (lambda x: x)
    return {"a": lengths(a), "alpha": alpha * angle, "d": lengths(d), "theta": theta * angle}


def _pose(six: list, length: float, angle: float) -> np.ndarray:
    pose = np.eye(4)
    pose[:3, 3] = np.array(six[:3], float) / (1000 if length == MM else 1)
    if any(six[3:6]):
        rotation = rotation_of(*(angle * np.array(six[3:6], float)))
        # Quarter turns are exact.
        quarters = angle == DEG and not np.any(np.array(six[3:6]) % 90)
        pose[:3, :3] = rotation.round() + 0.0 if quarters else rotation
    return pose


def _axes(table: dict, kinds: str, base: np.ndarray, tool: np.ndarray, length: float, angle: float) -> Axes:
    """The axes at zero of a table of joint frames, or of DH parameters with joints turned round."""
    frame, along, points = base, [], []
    if "joints" in table:
        for row in table["joints"]:
            frame = frame @ _pose(row[:6], length, angle)
            along.append(frame[:3, :3] @ AXES[row[6]])
            points.append(frame[:3, 3])
        return Axes(kinds, np.array(along), np.array(points), frame @ tool)
    columns, foot, _ = dh.to_standard(table["convention"], _columns(table["dh"], length, angle), base)
    frames = foot @ dh.frames(columns)
    along = [turn * z for turn, z in zip(table["turns"], frames[:-1, :3, 2], strict=True)]
    return Axes(kinds, np.array(along), frames[:-1, :3, 3], frames[-1] @ tool)
