"""A study as a TOML file: which arm, where, in which orientations, and what to keep.

Storey: study. A file is data: what it does not know it refuses, and a path in it is read from the file's
own folder.

    arm = "puma560"                 # of the catalogue, or a URDF file
    spacing = 0.03                  # [m]
    orientations = 512              # even ones; or { wxyz = [[1, 0, 0, 0], ...] }
    bounds = [[-1, -1, 0], [1, 1, 1]]          # corners [m]; by default all that is within reach
    limits = [[-2.8, 2.8], ...]     # [rad, m]; or false for none; by default the arm's own
    statistics = ["reachable", ...] # by default all
    chunk = [32, 32, 32]            # positions of a work unit
    dtype = "float32"               # or "float64"
"""

import dataclasses
import pathlib
import tomllib
from typing import Any, NamedTuple

import numpy as np

from ikjax.arm import dh, robots
from ikjax.arm.arm import Arm
from ikjax.core.pose import pose
from ikjax.study.goals import Grid, around, grid
from ikjax.study.statistics import USUAL as STATISTICS

KEYS = ("arm", "spacing", "orientations", "bounds", "limits", "statistics", "chunk", "dtype")
LARGEST = 2**24
"""Bytes of a file."""


class Recipe(NamedTuple):
    """Arguments of a sweep."""

    arm: Arm
    positions: Grid
    orientations: Any
    statistics: tuple[str, ...]
    chunk: tuple[int, ...] | None
    dtype: str


def read(path) -> Recipe:
    """The study in a file.

    Raises:
        ValueError: No TOML, a key that is unknown or missing, a value of another kind: the message names
            the file, the key, what was expected and what came.
        OSError: No such file.
    """
    path = pathlib.Path(path)
    if path.stat().st_size > LARGEST:
        raise ValueError(f"{path}: more than {LARGEST} bytes are no study")
    try:
        said = tomllib.loads(path.read_bytes().decode())
    except (ValueError, RecursionError) as error:
        raise ValueError(f"{path}: no TOML: {error}") from error
    try:
        return _understood(said, path.parent)
    except (ValueError, TypeError, OverflowError) as error:
        raise ValueError(f"{path}: {error}") from error


def find_arm(name: str, folder: pathlib.Path | None = None) -> Arm:
    """An arm of the catalogue, or of a URDF file."""
    if not name.endswith(".urdf"):
        return robots.get(name)
    return Arm.from_urdf(pathlib.Path(name) if folder is None else folder / name)


def _understood(said: dict, folder: pathlib.Path) -> Recipe:
    for key in said:
        if key not in KEYS:
            raise ValueError(f"no key {key!r}; the keys are {', '.join(KEYS)}")
    for key in ("arm", "spacing", "orientations"):
        if key not in said:
            raise ValueError(f"{key} is missing")
    if not isinstance(said["arm"], str):
        raise ValueError(f'arm must be a name or a file, as in "puma560", got {said["arm"]!r}')
    arm = _limited(find_arm(said["arm"], folder), said.get("limits"))
    spacing = said["spacing"]
    if not _is_number(spacing):
        raise ValueError(f"spacing must be a number of metres, got {spacing!r}")
    if "bounds" in said:
        lower, upper = _numbers("bounds", said["bounds"], (2, 3))
        positions = grid(lower, upper, spacing)
    else:
        positions = around(arm, spacing)
    statistics = said.get("statistics", list(STATISTICS))
    if not isinstance(statistics, list) or not all(name in STATISTICS for name in statistics):
        raise ValueError(f"statistics must be a list of {', '.join(STATISTICS)}, got {statistics!r}")
    dtype = said.get("dtype", "float32")
    if dtype not in ("float32", "float64"):
        raise ValueError(f'dtype must be "float32" or "float64", got {dtype!r}')
    chunk = said.get("chunk")
    if chunk is not None and not (isinstance(chunk, list) and len(chunk) == 3 and all(map(_is_count, chunk))):
        raise ValueError(f"chunk must be three whole numbers above zero, got {chunk!r}")
    chunk = None if chunk is None else tuple(chunk)
    return Recipe(arm, positions, _orientations(said["orientations"]), tuple(statistics), chunk, dtype)


def _limited(arm: Arm, limits) -> Arm:
    if limits is None:
        return arm
    if limits is False:
        limits = np.tile([-np.inf, np.inf], (arm.n, 1))
    else:
        limits = _numbers("limits", limits, (arm.n, 2))
    return dataclasses.replace(arm, limits=dh.check_limits(limits, arm.n))


def _orientations(said) -> Any:
    if _is_count(said):
        return said
    if isinstance(said, dict) and list(said) == ["wxyz"]:
        rows = said["wxyz"]
        wxyz = _numbers("orientations.wxyz", rows, (len(rows) if isinstance(rows, list) else 1, 4))
        return np.asarray(pose(np.zeros((len(wxyz), 3)), wxyz=wxyz))[:, :3, :3]
    raise ValueError(
        f"orientations must be a whole number above zero or {{ wxyz = [[1, 0, 0, 0]] }}, got {said!r}"
    )


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
