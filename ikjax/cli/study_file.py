"""A study as a TOML file: which arm, where, in which orientations, and which statistics.

A file is data: unknown keys are refused, and a path in it starts from the file's own folder. `MANUAL` lists
the keys; `ikjax study keys` prints it.
"""

import dataclasses
import math
import pathlib
import tomllib
from typing import Any, NamedTuple

import numpy as np

from ikjax.arm import dh
from ikjax.arm.arm import Arm
from ikjax.cli import whole_arm
from ikjax.core.pose import pose
from ikjax.maps.sets.hopf import hopf
from ikjax.maps.sets.orientations import cone
from ikjax.maps.sets.positions import Grid, Shell, around, grid, shell
from ikjax.maps.sets.surface import Surface, surface
from ikjax.maps.statistics import USUAL as STATISTICS
from ikjax.maps.statistics import available

MANUAL = """\
angles = "degrees"              # of all angles in this file; "radians" by default

arm = "puma560"                 # of the catalogue, or a URDF file (a path from this file's folder)
base = "base_link"              # of a file: the link it starts from, by default the root
tip = "tool0"                   # of a file: the link it ends at, by default the one leaf
axis_tolerance = 1e-3           # of a file: how far axes may be off [rad, share of its size]
fixed_joints = { joint3 = 0 }   # joints that do not move [angle, m]; joint1, joint2, ... without names
tool = [0, 0, 0.15, 0, 0, 0]    # from the tip or flange to the tool: x y z [m], roll pitch yaw [angle];
                                # or x y z alone; or { xyz = [...], rpy = [...] }, and wxyz, xyzw or rotvec
mount = [0, 0, 0.8]             # where the robot stands in the world, likewise
limits = [[-160, 160], ...]     # of the joints that move [angle, m]; or false for none; else the arm's own

spacing = 0.03                  # a grid [m] over all that is within reach, or within
bounds = [[-1, -1, 0], [1, 1, 1]]                                          # two corners [m]
shell = { center = [0, 0, 0], radii = [0.5, 0.7], directions = 500 }       # in place of spacing: spheres
surface = { file = "part.stl", scale = 0.001, spacing = 0.01 }             # or "points.csv"; likewise

orientations = 512              # even ones; or { wxyz = [[1, 0, 0, 0], ...] } or { hopf = 2 } or
                                # { cone = { direction = [0, 0, -1], half_angle = 30, directions = 64 } }
free_rolls = 8                  # turns about the tool of which one must do; 1 by default
redundancy_samples = 32         # values of redundant joints of which one must do

statistics = ["reachable", ...] # see `ikjax study statistics`
title = "long drill"            # for pictures and pages; by default the arm's name
chunk = [32, 32, 32]            # positions of a work unit
dtype = "float32"               # or "float64"
certify = true                  # goals uncertain in float32 again in float64; false by default
"""
"""Every key of a study file, each with a comment; not a study itself."""

NEW = """\
# A study of ikjax. Every key: ikjax study keys. Run it: ikjax sweep {file} --out map.zarr --picture map.png
angles = "degrees"              # of all angles in this file

# The robot, its tool and where it stands.
arm = {arm}
# tip = "tool0"                 # of a file that branches: the link where the arm ends
tool = [0, 0, 0, 0, 0, 0]       # from the tip or flange to the tool: x y z [m], roll pitch yaw
mount = [0, 0, 0, 0, 0, 0]      # of the robot in the world, likewise

# Where: one layer of a table, 0.1 m above the foot of the robot, in steps of 5 cm.
bounds = [[-1, -1, 0.1], [1, 1, 0.1]]
spacing = 0.05                  # [m]; without bounds over all that is within reach

# How: the tool points down, and may turn about its own axis.
orientations = {{ cone = {{ direction = [0, 0, -1], half_angle = 0, directions = 1 }} }}
free_rolls = 12                 # turns of which one must do; 1 where the tool must not turn
# orientations = 512            # in place of both: even over all rotations

# What is counted: those the arm reaches, within its limits too, and which limits cost some.
statistics = ["reachable", "reachable_within", "solutions", "solutions_within", "limited_by"]
"""
"""What `ikjax study new` writes, a study that runs; {{arm}} and {{file}} are filled in."""

KEYS = (
    *("angles", "arm", *whole_arm.KEYS, "limits", "spacing", "bounds", "shell", "surface", "orientations"),
    *("free_rolls", "redundancy_samples", "statistics", "title", "chunk", "dtype", "certify"),
)
RENAMED = {"tolerance": "axis_tolerance", "rolls": "free_rolls"}
"""Keys of older files, and what they are called now."""

MOST_BYTES = 2**24
"""Largest file that is read."""


class Study(NamedTuple):
    """A study: the arguments of `ikjax.sweep`."""

    arm: Arm
    positions: Grid | Shell | Surface
    orientations: Any
    free_rolls: int
    statistics: tuple[str, ...]
    chunk: tuple[int, ...] | None
    dtype: str
    certify: bool = False
    redundancy_samples: int | None = None
    title: str | None = None


def read(path) -> Study:
    """The study in a file.

    Raises:
        ValueError: No TOML, a key that is unknown or missing, a value of another kind: the message names
            the file, the key, what was expected and what came.
        OSError: No such file.
    """
    path = pathlib.Path(path)
    if path.stat().st_size > MOST_BYTES:
        raise ValueError(f"{path}: more than {MOST_BYTES} bytes are no study")
    try:
        entries = tomllib.loads(path.read_bytes().decode())
    except (ValueError, RecursionError) as error:
        raise ValueError(f"{path}: no TOML: {error}") from error
    try:
        return _parsed(entries, path.parent)
    except (ValueError, TypeError, OverflowError) as error:
        raise ValueError(f"{path}: {error}") from error


def _parsed(entries: dict, folder: pathlib.Path) -> Study:
    for key in entries:
        if key in RENAMED:
            raise ValueError(f"{key!r} is called {RENAMED[key]!r} now")
        if key not in KEYS:
            raise ValueError(f"no key {key!r}; the keys are {', '.join(KEYS)}")
    for key in ("arm", "orientations"):
        if key not in entries:
            raise ValueError(f"{key} is missing")
    if not isinstance(entries["arm"], str):
        raise ValueError(f'arm must be a name or a file, as in "puma560", got {entries["arm"]!r}')
    unit = _angle_unit(entries.get("angles", "radians"))
    arm = _arm(entries, folder, unit)
    positions = _positions(entries, arm, folder)
    statistics, known = entries.get("statistics", list(STATISTICS)), available(len(arm.locked) == 1)
    if not isinstance(statistics, list) or not all(name in known for name in statistics) or not statistics:
        raise ValueError(f"statistics must be a list of {', '.join(known)}, got {statistics!r}")
    free_rolls = entries.get("free_rolls", 1)
    if not _is_count(free_rolls):
        raise ValueError(f"free_rolls must be a whole number above zero, got {free_rolls!r}")
    samples = entries.get("redundancy_samples")
    if samples is not None and not _is_count(samples):
        raise ValueError(f"redundancy_samples must be a whole number above zero, got {samples!r}")
    dtype = entries.get("dtype", "float32")
    if dtype not in ("float32", "float64"):
        raise ValueError(f'dtype must be "float32" or "float64", got {dtype!r}')
    certify = entries.get("certify", False)
    if not isinstance(certify, bool) or (certify and dtype != "float32"):
        raise ValueError(
            f"certify must be true or false, and with float32 only, got {certify!r} with {dtype}"
        )
    chunk = entries.get("chunk")
    axes = len(positions.shape)
    if chunk is not None and not (
        isinstance(chunk, list) and len(chunk) == axes and all(map(_is_count, chunk))
    ):
        raise ValueError(f"chunk must be {axes} whole numbers above zero, got {chunk!r}")
    chunk = None if chunk is None else tuple(chunk)
    turns = _orientations(entries["orientations"], unit)
    title = entries.get("title")
    if not (title is None or _is_text(title)):
        raise ValueError(f"title must be a text, got {title!r}")
    return Study(arm, positions, turns, free_rolls, tuple(statistics), chunk, dtype, certify, samples, title)


def _angle_unit(angles) -> float:
    """One unit of the file's angles [rad]."""
    units = {"radians": 1.0, "degrees": math.pi / 180}
    if not (_is_text(angles) and angles in units):
        raise ValueError(f'angles must be "degrees" or "radians", got {angles!r}')
    return units[angles]


def _arm(entries: dict, folder: pathlib.Path, unit: float) -> Arm:
    """The arm as the file says it stands."""
    kinds = {"base": _is_text, "tip": _is_text, "axis_tolerance": _is_number, "fixed_joints": _is_values}
    for key, kind in kinds.items():
        if key in entries and not kind(entries[key]):
            raise ValueError(f"{key} is of the wrong kind: {entries[key]!r}")
    given = {key: entries.get(key) for key in kinds}
    for key in ("tool", "mount"):
        given[key] = _pose(key, entries[key], unit) if key in entries else None
    arm = whole_arm.find_arm(entries["arm"], folder, angle=unit, **given)
    return _with_limits(arm, entries.get("limits"), unit)


def _pose(key: str, value, unit: float) -> np.ndarray:
    """A pose (4, 4) from a list of numbers or a table."""
    if isinstance(value, list):
        numbers = _numbers(key, value, (3,) if len(value) == 3 else (6,))
        return whole_arm.six_numbers(key, numbers, unit)
    turns = {"rpy": (3,), "wxyz": (4,), "xyzw": (4,), "rotvec": (3,)}
    table = _table(key, value, {"xyz": (3,), **turns}, needs=())
    table |= {form: table[form] * unit for form in ("rpy", "rotvec") if form in table}
    return np.asarray(pose(table.pop("xyz", np.zeros(3)), **table), float)


def _is_values(value) -> bool:
    return isinstance(value, dict) and bool(value) and all(map(_is_number, value.values()))


def _positions(entries: dict, arm: Arm, folder: pathlib.Path) -> Grid | Shell | Surface:
    given = [key for key in ("spacing", "shell", "surface") if key in entries]
    if len(given) != 1:
        raise ValueError(f"one of spacing, shell and surface is wanted, got {', '.join(given) or 'none'}")
    if "bounds" in entries and given != ["spacing"]:
        raise ValueError(f"bounds go with spacing, not with {given[0]}")
    if given == ["shell"]:
        kinds = {"center": (3,), "radii": None, "directions": _is_count}
        table = _table("shell", entries["shell"], kinds, needs=("center", "radii", "directions"))
        return shell(table["center"], table["radii"], table["directions"])
    if given == ["surface"]:
        kinds = {"file": _is_text, "scale": _is_number, "spacing": _is_number}
        table = _table("surface", entries["surface"], kinds, needs=("file",))
        return surface(folder / table.pop("file"), **table)
    spacing = entries["spacing"]
    if not _is_number(spacing):
        raise ValueError(f"spacing must be a number of metres, got {spacing!r}")
    if "bounds" not in entries:
        return around(arm, spacing)
    lower, upper = _numbers("bounds", entries["bounds"], (2, 3))
    return grid(lower, upper, spacing)


def _table(name: str, entries, kinds: dict[str, Any], needs: tuple[str, ...]) -> dict[str, Any]:
    """A table's entries, checked: a kind is a test of a value, or an array's shape, None for any."""
    for old, new in (("centre", "center"), ("rolls", "turns")):
        if isinstance(entries, dict) and old in entries and new in kinds:
            raise ValueError(f"{name}.{old} is called {name}.{new} now")
    if not isinstance(entries, dict) or not set(needs) <= entries.keys() <= kinds.keys():
        raise ValueError(f"{name} must have the keys {', '.join(kinds)}, got {entries!r}")
    checked = {}
    for key, value in entries.items():
        kind = kinds[key]
        if callable(kind):
            if not kind(value):
                raise ValueError(f"{name}.{key} is of the wrong kind: {value!r}")
            checked[key] = value
        else:
            shape = (len(value) if isinstance(value, list) else 1,) if kind is None else kind
            checked[key] = _numbers(f"{name}.{key}", value, shape)
    return checked


def _with_limits(arm: Arm, limits, unit: float) -> Arm:
    if limits is None:
        return arm
    if limits is False:
        limits = np.tile([-np.inf, np.inf], (arm.n, 1))
    else:
        limits = _numbers("limits", limits, (arm.n, 2))
        limits = limits * np.where([kind == "R" for kind in arm.kinds], unit, 1.0)[:, None]
    return dataclasses.replace(arm, limits=dh.check_limits(limits, arm.kinds))


def _orientations(entries, unit: float) -> Any:
    if _is_count(entries):
        return entries
    if isinstance(entries, dict) and list(entries) == ["wxyz"]:
        rows = entries["wxyz"]
        wxyz = _numbers("orientations.wxyz", rows, (len(rows) if isinstance(rows, list) else 1, 4))
        return np.asarray(pose(np.zeros((len(wxyz), 3)), wxyz=wxyz))[:, :3, :3]
    if isinstance(entries, dict) and list(entries) == ["hopf"]:
        return hopf(entries["hopf"])
    if isinstance(entries, dict) and list(entries) == ["cone"]:
        kinds = {"direction": (3,), "half_angle": _is_number, "directions": _is_count, "turns": _is_count}
        table = _table("orientations.cone", entries["cone"], kinds, needs=tuple(kinds)[:3])
        return cone(**{**table, "half_angle": table["half_angle"] * unit})
    raise ValueError(
        f"orientations must be a whole number above zero or a table such as {{ wxyz = [[1, 0, 0, 0]] }}, "
        f"{{ hopf = 2 }} or {{ cone = {{ ... }} }}, got {entries!r}"
    )


def _is_text(value) -> bool:
    return isinstance(value, str)


def _is_number(value) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _is_count(value) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and value > 0


def _numbers(key: str, value, shape: tuple[int, ...]) -> np.ndarray:
    try:
        array = np.array(value)
    except ValueError:
        array = np.array(None)
    if array.dtype.kind not in "iuf" or array.shape != shape:
        raise ValueError(f"{key} must be {' x '.join(map(str, shape))} numbers, got {value!r}")
    return array.astype(float)
