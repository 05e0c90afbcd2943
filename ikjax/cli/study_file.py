"""A study as a TOML file: which arm, where, in which orientations, and which statistics.

A file is data: unknown keys are refused, and a path in it starts from the file's own folder.

    arm = "puma560"                 # of the catalogue, or a URDF file, and for a file
    base = "base_link"              # the link it starts from, by default the root
    tip = "tool0"                   # the link it ends at, by default the one leaf
    axis_tolerance = 1e-3           # see `Arm.from_urdf`
    spacing = 0.03                  # [m]
    orientations = 512              # even ones; or { wxyz = [[1, 0, 0, 0], ...] } or { hopf = 2 } or
                                    # { cone = { direction = [0, 0, -1], half_angle = 0.5, directions = 64 } }
    redundancy_samples = 32         # values of redundant joints of which one must do
    free_rolls = 8                  # turns about the tool of which one must do; 1 by default
    bounds = [[-1, -1, 0], [1, 1, 1]]          # corners [m]; by default all that is within reach
    shell = { center = [0, 0, 0], radii = [0.5, 0.7], directions = 500 }       # in place of spacing
    surface = { file = "part.stl", scale = 0.001, spacing = 0.01 }             # or "points.csv"; likewise
    limits = [[-2.8, 2.8], ...]     # [rad, m]; or false for none; by default the arm's own
    statistics = ["reachable", ...] # see `statistics`
    chunk = [32, 32, 32]            # positions of a work unit
    dtype = "float32"               # or "float64"
    certify = true                  # goals uncertain in float32 again in float64; false by default
"""

import dataclasses
import os
import pathlib
import tomllib
from typing import Any, NamedTuple

import numpy as np

from ikjax.arm import dh, robots
from ikjax.arm.arm import Arm
from ikjax.core.pose import pose
from ikjax.maps.sets.hopf import hopf
from ikjax.maps.sets.orientations import cone
from ikjax.maps.sets.positions import Grid, Shell, around, grid, shell
from ikjax.maps.sets.surface import Surface, surface
from ikjax.maps.statistics import USUAL as STATISTICS
from ikjax.maps.statistics import available

KEYS = (
    *("arm", "base", "tip", "axis_tolerance", "spacing", "orientations", "free_rolls", "bounds", "shell"),
    *("surface", "limits", "statistics", "chunk", "dtype", "certify", "redundancy_samples"),
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


def find_arm(
    name: str,
    folder: pathlib.Path | None = None,
    *,
    base: str | None = None,
    tip: str | None = None,
    axis_tolerance: float | None = None,
) -> Arm:
    """An arm of the catalogue, or of a URDF file.

    A name that is not in the catalogue is a file's name if the file exists or the name ends in .urdf or .xml.

    Args:
        name: Of the arm, or the path of the file.
        folder: Where a relative path starts.
        base, tip, axis_tolerance: As in `Arm.from_urdf`.

    Raises:
        ValueError: Neither a file nor a name of the catalogue; an option of files given with such a name.
        OSError: The file cannot be read.
    """
    options: dict[str, Any] = {"base": base, "tip": tip, "axis_tolerance": axis_tolerance}
    options = {key: value for key, value in options.items() if value is not None}
    path = pathlib.Path(name) if folder is None else folder / name
    known = name in robots.names()
    if not known and (name.lower().endswith((".urdf", ".xml")) or os.path.isfile(path)):
        return Arm.from_urdf(path, **options)
    if known and options:
        raise ValueError(f"{'= and '.join(options)}= goes with a URDF file, {name} is of the catalogue")
    try:
        return robots.get(name)
    except ValueError as error:
        raise ValueError(f"no such file, and {error}") from None


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
    for key, kind in {"base": _is_text, "tip": _is_text, "axis_tolerance": _is_number}.items():
        if key in entries and not kind(entries[key]):
            raise ValueError(f"{key} is of the wrong kind: {entries[key]!r}")
    ends = {key: entries.get(key) for key in ("base", "tip", "axis_tolerance")}
    arm = _with_limits(find_arm(entries["arm"], folder, **ends), entries.get("limits"))
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
    turns = _orientations(entries["orientations"])
    return Study(arm, positions, turns, free_rolls, tuple(statistics), chunk, dtype, certify, samples)


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


def _with_limits(arm: Arm, limits) -> Arm:
    if limits is None:
        return arm
    if limits is False:
        limits = np.tile([-np.inf, np.inf], (arm.n, 1))
    else:
        limits = _numbers("limits", limits, (arm.n, 2))
    return dataclasses.replace(arm, limits=dh.check_limits(limits, arm.kinds))


def _orientations(entries) -> Any:
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
        return cone(**_table("orientations.cone", entries["cone"], kinds, needs=tuple(kinds)[:3]))
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
