"""A study as a TOML file: which arm, where, in which orientations, and which statistics.

A file is data: unknown keys are refused, and a path in it starts from the file's own folder. `MANUAL` lists
the keys; `ikjax study keys` prints it. What a command's options say counts before what the file says.
`sections` reads the tables [place] and [design].
"""

import dataclasses
import math
import pathlib
import tomllib
from collections.abc import Callable
from typing import Any, NamedTuple, TypeVar

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

# For `ikjax place` and `ikjax design`, which need neither positions nor orientations:
goals = "holes.csv"             # poses of the tool; of a file of positions alone
                                # { file = "holes.csv", rpy = [180, 0, 0] }, or wxyz, xyzw, rotvec
alternatives = { cone = { direction = [0, 0, 1], half_angle = 20, directions = 16 } }
                                # what the tool may be turned by, of which one must do: here a tool axis that
                                # may lean; a number for even rotations, where only the point matters

[place]                         # where the robot should stand; every key may be left out
move = ["x", "y", "turn"]       # and z, tilt, rail
bounds = { x = [-1, 1], turn = [-90, 90] }       # [m, angle]; or several regions [{ x = ... }, { x = ... }]
spacing = 0.1                   # of the candidates [m]
turns = 12                      # candidates of the turn
keep = 5                        # most places to list
keep_out = [[[-1, -1, 0], [0, 1, 1]]]            # boxes, lower corner first [m]
parts = "part.stl"              # what to keep away from, or "points.csv"
clearance = 0.1                 # so far [m]
rail = [[0, 0, 0], [3, 0, 0]]   # two ends of a level rail [m]
limits = true                   # whether joint limits count
starts = 16                     # best candidates that are polished
steps = 60                      # of each; 0 for none

[design]                        # what of the arm should change; vary is needed
vary = { a2 = [0.2, 0.6], "tool.z" = [0, 0.3] }  # between which bounds [m, angle]
objective = "coverage"          # or dexterous_share, worst_margin, mean_manipulability
ties = ["a2 + d4 = 0.8"]        # equations that always hold
constraints = ["a2 + d4 <= 0.8"]
limits = true
starts = 8
steps = 200
local_search = 0                # arms near the best that are tried at the end
seed = 0
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
    *("goals", "alternatives", "place", "design"),
)
RENAMED = {"tolerance": "axis_tolerance", "rolls": "free_rolls"}
"""Keys of older files, and what they are called now."""

MOST_BYTES = 2**24
"""Largest file that is read."""


Parsed = TypeVar("Parsed")


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


OPTIONS = ("spacing", "orientations", "free_rolls", "redundancy_samples", "statistics", "title", "certify")
"""Options of a command that stand for the key of the same name."""


class Document(NamedTuple):
    """A study file, read but for what its keys say, and the options of a command beside it."""

    entries: dict[str, Any]
    folder: pathlib.Path
    """Where paths start."""
    options: Any
    """Of the command, or None; they count before the entries."""

    @property
    def unit(self) -> float:
        """One unit of the file's angles [rad]."""
        return _angle_unit(self.entries.get("angles", "radians"))

    def arm(self) -> Arm:
        """The arm as it stands.

        Raises:
            ValueError, OSError: As `read`.
        """
        return _arm(self.entries, self.folder, self.unit, self.options)

    def section(self, name: str) -> dict[str, Any]:
        """The table of that name; empty where there is none."""
        table = self.entries.get(name, {})
        if not isinstance(table, dict):
            raise ValueError(f"{name} must be a table, got {table!r}")
        return table


def read(path, options=None) -> Study:
    """The study in a file.

    Args:
        path: Of the file.
        options: Of a command, which count before what the file says.

    Raises:
        ValueError: No TOML, a key that is unknown or missing, a value of another kind: the message names
            the file, the key, what was expected and what came.
        OSError: No such file.
    """
    return parsed(path, options, _study)


def arm_of(path, options=None) -> Arm:
    """The arm of a study file; arguments and errors as `read`."""
    return parsed(path, options, Document.arm)


def parsed(path, options, parse: Callable[[Document], Parsed]) -> Parsed:
    """What `parse` makes of a file; its errors name the file."""
    path = pathlib.Path(path)
    if path.stat().st_size > MOST_BYTES:
        raise ValueError(f"{path}: more than {MOST_BYTES} bytes are no study")
    try:
        entries = tomllib.loads(path.read_bytes().decode())
    except (ValueError, RecursionError) as error:
        raise ValueError(f"{path}: no TOML: {error}") from error
    try:
        _check_keys(entries)
        for key in OPTIONS:
            if getattr(options, key, None) not in (None, False):
                entries[key] = getattr(options, key)
        if getattr(options, "other_dtype", False):
            entries["dtype"] = "float64"
        return parse(Document(entries, path.parent, options))
    except (ValueError, TypeError, OverflowError) as error:
        raise ValueError(f"{path}: {error}") from error


def _check_keys(entries: dict) -> None:
    for key in entries:
        if key in RENAMED:
            raise ValueError(f"{key!r} is called {RENAMED[key]!r} now")
        if key not in KEYS:
            raise ValueError(f"no key {key!r}; the keys are {', '.join(KEYS)}")
    if "arm" not in entries:
        raise ValueError("arm is missing")
    if not isinstance(entries["arm"], str):
        raise ValueError(f'arm must be a name or a file, as in "puma560", got {entries["arm"]!r}')


def _study(document: Document) -> Study:
    entries, folder, unit = document.entries, document.folder, document.unit
    if "orientations" not in entries:
        raise ValueError("orientations is missing")
    arm = document.arm()
    positions = _positions(entries, arm, folder)
    statistics, known = entries.get("statistics", list(STATISTICS)), available(len(arm.locked) == 1)
    if not isinstance(statistics, list) or not all(name in known for name in statistics) or not statistics:
        raise ValueError(f"statistics must be a list of {', '.join(known)}, got {statistics!r}")
    free_rolls, samples = trials_of(entries)
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
        isinstance(chunk, list) and len(chunk) == axes and all(map(is_count, chunk))
    ):
        raise ValueError(f"chunk must be {axes} whole numbers above zero, got {chunk!r}")
    chunk = None if chunk is None else tuple(chunk)
    turns = orientations_of("orientations", entries["orientations"], unit)
    title = entries.get("title")
    if not (title is None or is_text(title)):
        raise ValueError(f"title must be a text, got {title!r}")
    return Study(arm, positions, turns, free_rolls, tuple(statistics), chunk, dtype, certify, samples, title)


def trials_of(entries: dict) -> tuple[int, int | None]:
    """Free rolls, and values of redundant joints."""
    free_rolls = entries.get("free_rolls", 1)
    if not is_count(free_rolls):
        raise ValueError(f"free_rolls must be a whole number above zero, got {free_rolls!r}")
    samples = entries.get("redundancy_samples")
    if samples is not None and not is_count(samples):
        raise ValueError(f"redundancy_samples must be a whole number above zero, got {samples!r}")
    return free_rolls, samples


def _angle_unit(angles) -> float:
    """One unit of the file's angles [rad]."""
    units = {"radians": 1.0, "degrees": math.pi / 180}
    if not (is_text(angles) and angles in units):
        raise ValueError(f'angles must be "degrees" or "radians", got {angles!r}')
    return units[angles]


def _arm(entries: dict, folder: pathlib.Path, unit: float, options=None) -> Arm:
    """The arm as the file says it stands, but for what the options say."""
    kinds = {"base": is_text, "tip": is_text, "axis_tolerance": is_number, "fixed_joints": _is_values}
    for key, kind in kinds.items():
        if key in entries and not kind(entries[key]):
            raise ValueError(f"{key} is of the wrong kind: {entries[key]!r}")
    given = {key: entries.get(key) for key in kinds}
    for key in ("tool", "mount"):
        given[key] = pose_from(key, entries[key], unit) if key in entries else None
    said = {} if options is None else whole_arm.given_by(options)
    # Angles of fixed joints are in the unit of whoever says them.
    angle = whole_arm.angle_unit(options) if "fixed_joints" in said else unit
    arm = whole_arm.find_arm(entries["arm"], folder, angle=angle, **{**given, **said})
    return _with_limits(arm, entries.get("limits"), unit)


def pose_from(key: str, value, unit: float) -> np.ndarray:
    """A pose (4, 4) from a list of numbers or a table."""
    if isinstance(value, list):
        numbers = numbers_of(key, value, (3,) if len(value) == 3 else (6,))
        return whole_arm.six_numbers(key, numbers, unit)
    turns = {"rpy": (3,), "wxyz": (4,), "xyzw": (4,), "rotvec": (3,)}
    table = checked_table(key, value, {"xyz": (3,), **turns}, needs=())
    table |= {form: table[form] * unit for form in ("rpy", "rotvec") if form in table}
    return np.asarray(pose(table.pop("xyz", np.zeros(3)), **table), float)


def _is_values(value) -> bool:
    return isinstance(value, dict) and bool(value) and all(map(is_number, value.values()))


def _positions(entries: dict, arm: Arm, folder: pathlib.Path) -> Grid | Shell | Surface:
    given = [key for key in ("spacing", "shell", "surface") if key in entries]
    if len(given) != 1:
        raise ValueError(f"one of spacing, shell and surface is wanted, got {', '.join(given) or 'none'}")
    if "bounds" in entries and given != ["spacing"]:
        raise ValueError(f"bounds go with spacing, not with {given[0]}")
    if given == ["shell"]:
        kinds = {"center": (3,), "radii": None, "directions": is_count}
        table = checked_table("shell", entries["shell"], kinds, needs=("center", "radii", "directions"))
        return shell(table["center"], table["radii"], table["directions"])
    if given == ["surface"]:
        kinds = {"file": is_text, "scale": is_number, "spacing": is_number}
        table = checked_table("surface", entries["surface"], kinds, needs=("file",))
        return surface(folder / table.pop("file"), **table)
    spacing = entries["spacing"]
    if not is_number(spacing):
        raise ValueError(f"spacing must be a number of metres, got {spacing!r}")
    if "bounds" not in entries:
        return around(arm, spacing)
    lower, upper = numbers_of("bounds", entries["bounds"], (2, 3))
    return grid(lower, upper, spacing)


def checked_table(name: str, entries, kinds: dict[str, Any], needs: tuple[str, ...]) -> dict[str, Any]:
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
            checked[key] = numbers_of(f"{name}.{key}", value, shape)
    return checked


def _with_limits(arm: Arm, limits, unit: float) -> Arm:
    if limits is None:
        return arm
    if limits is False:
        limits = np.tile([-np.inf, np.inf], (arm.n, 1))
    else:
        limits = numbers_of("limits", limits, (arm.n, 2))
        limits = limits * np.where([kind == "R" for kind in arm.kinds], unit, 1.0)[:, None]
    return dataclasses.replace(arm, limits=dh.check_limits(limits, arm.kinds))


def orientations_of(key: str, entries, unit: float) -> Any:
    """A set of orientations from the value of a key."""
    if is_count(entries):
        return entries
    if isinstance(entries, dict) and list(entries) == ["wxyz"]:
        rows = entries["wxyz"]
        wxyz = numbers_of(f"{key}.wxyz", rows, (len(rows) if isinstance(rows, list) else 1, 4))
        return np.asarray(pose(np.zeros((len(wxyz), 3)), wxyz=wxyz))[:, :3, :3]
    if isinstance(entries, dict) and list(entries) == ["hopf"]:
        return hopf(entries["hopf"])
    if isinstance(entries, dict) and list(entries) == ["cone"]:
        kinds = {"direction": (3,), "half_angle": is_number, "directions": is_count, "turns": is_count}
        table = checked_table(f"{key}.cone", entries["cone"], kinds, needs=tuple(kinds)[:3])
        return cone(**{**table, "half_angle": table["half_angle"] * unit})
    raise ValueError(
        f"{key} must be a whole number above zero or a table such as {{ wxyz = [[1, 0, 0, 0]] }}, "
        f"{{ hopf = 2 }} or {{ cone = {{ ... }} }}, got {entries!r}"
    )


def is_text(value) -> bool:
    return isinstance(value, str)


def is_number(value) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def is_count(value) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and value > 0


def numbers_of(key: str, value, shape: tuple[int, ...]) -> np.ndarray:
    try:
        array = np.array(value)
    except ValueError:
        array = np.array(None)
    if array.dtype.kind not in "iuf" or array.shape != shape:
        raise ValueError(f"{key} must be {' x '.join(map(str, shape))} numbers, got {value!r}")
    return array.astype(float)
