"""The tables [place] and [design] of a study file: arguments of `ikjax.place` and `ikjax.design`.

What a command's options say counts before what the file says.
"""

import pathlib
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from ikjax.arm.arm import Arm
from ikjax.cli import table, whole_arm
from ikjax.cli.study_file import (
    Document,
    checked_table,
    is_count,
    is_number,
    is_text,
    numbers_of,
    orientations_of,
    parsed,
    trials_of,
)
from ikjax.maps.sets.surface import surface
from ikjax.synthesis.design import is_angle
from ikjax.synthesis.objectives import NAMED

ANGLES = ("turn", "tilt")
"""Moves of a base whose bounds are angles."""


class Request(NamedTuple):
    """The arguments of `ikjax.place` or `ikjax.design`."""

    arm: Arm
    goals: np.ndarray
    """(n, 4, 4)"""
    options: dict[str, Any]
    """By name; what is not said is left out."""


def read_place(path, options) -> Request:
    """The placement that a study file asks for.

    Raises:
        ValueError, OSError: As `study_file.read`.
    """
    return parsed(path, options, lambda document: _request(document, "place", _of_place))


def read_design(path, options) -> Request:
    """The design study that a file asks for; errors as `read_place`."""
    return parsed(path, options, lambda document: _request(document, "design", _of_design))


def without_file(options, name: str) -> Request:
    """A placement or a design study that the options alone describe.

    Raises:
        ValueError: Goals or what may vary are missing.
    """
    return _request(Document({"arm": options.arm}, pathlib.Path(), options), name, _SECTIONS[name])


def _request(document: Document, name: str, read: Callable[[Document, dict], dict[str, Any]]) -> Request:
    options, section = document.options, document.section(name)
    arm = document.arm()
    free_rolls, samples = trials_of(document.entries | _given(options, ("free_rolls", "redundancy_samples")))
    said = {"free_rolls": free_rolls, "redundancy_samples": samples}
    others = document.entries.get("alternatives")
    if getattr(options, "cone", None) is not None:
        unit = whole_arm.angle_unit(options)
        cone = {"direction": [0, 0, 1], "half_angle": options.cone, "directions": CONE_DIRECTIONS}
        said["alternatives"] = orientations_of("--cone", {"cone": cone}, unit)
    elif others is not None:
        said["alternatives"] = orientations_of("alternatives", others, document.unit)
    said |= read(document, section)
    return Request(arm, _goals(document), {key: value for key, value in said.items() if value is not None})


CONE_DIRECTIONS = 24
"""Of the tool's axis that `--cone` tries."""


def _goals(document: Document) -> np.ndarray:
    """The goals that the options give, or the file."""
    options, given = document.options, document.entries.get("goals")
    if options.goals is not None:
        return table.read_goals(options.goals, whole_arm.angle_unit(options), whole_arm.turn_of(options))
    if given is None:
        raise ValueError("goals are missing: goals = in a study file, or --goals GOALS.csv")
    turn: dict[str, Any] = {}
    if isinstance(given, dict):
        turns = {"rpy": (3,), "wxyz": (4,), "xyzw": (4,), "rotvec": (3,)}
        entries = checked_table("goals", given, {"file": is_text, **turns}, needs=("file",))
        given = entries.pop("file")
        turn = {form: x * document.unit if form in ("rpy", "rotvec") else x for form, x in entries.items()}
    if not is_text(given):
        raise ValueError(f'goals must be a file or a table with one, as in "holes.csv", got {given!r}')
    return table.read_goals(str(document.folder / given), document.unit, whole_arm.turn_of(options) or turn)


def _given(options, names) -> dict[str, Any]:
    """What the options say of these names."""
    return {name: value for name in names if (value := getattr(options, name, None)) is not None}


def _of_place(document: Document, section: dict) -> dict[str, Any]:
    """Arguments of `place`, of the section and of the options."""
    counts = dict.fromkeys(("turns", "keep", "starts", "steps"), _is_whole)
    kinds: dict[str, Any] = {
        **{"move": _is_texts, "bounds": _is_any, "spacing": is_number, "keep_out": _is_any},
        **{"parts": is_text, "clearance": is_number, "rail": (2, 3), "limits": _is_flag, **counts},
    }
    said = checked_table("place", section, kinds, needs=())
    options, unit = document.options, document.unit
    if "bounds" in said:
        bounds = said["bounds"]
        regions = [_bounds("place.bounds", each, unit) for each in bounds] if isinstance(bounds, list) else []
        said["bounds"] = regions or _bounds("place.bounds", bounds, unit)
    if "keep_out" in said:
        boxes = said["keep_out"]
        count = len(boxes) if isinstance(boxes, list) else 1
        said["keep_out"] = numbers_of("place.keep_out", boxes, (count, 2, 3))
    said |= _given(options, ("move", "spacing", "turns", "keep", "starts", "steps", "clearance"))
    if options.bounds is not None:
        said["bounds"] = dict(_named_bounds(text, whole_arm.angle_unit(options)) for text in options.bounds)
    if options.keep_out is not None:
        said["keep_out"] = np.reshape(options.keep_out, (-1, 2, 3))
    if options.rail is not None:
        said["rail"] = np.reshape(options.rail, (2, 3))
    if options.no_limits:
        said["limits"] = False
    if options.parts is not None:
        said["parts"] = surface(options.parts).points()
    elif "parts" in said:
        said["parts"] = surface(document.folder / said["parts"]).points()
    return said


def _of_design(document: Document, section: dict) -> dict[str, Any]:
    """Arguments of `design`, of the section and of the options."""
    counts = dict.fromkeys(("starts", "steps", "local_search", "seed"), _is_whole)
    kinds: dict[str, Any] = {
        **{"vary": _is_any, "objective": is_text, "ties": _is_texts, "constraints": _is_texts},
        **{"limits": _is_flag, **counts},
    }
    said = checked_table("design", section, kinds, needs=())
    options, unit = document.options, document.unit
    if "vary" in said:
        if not isinstance(said["vary"], dict):
            raise ValueError(f"design.vary must be a table of bounds, got {said['vary']!r}")
        pairs = {name: numbers_of(f"design.vary.{name}", x, (2,)) for name, x in said["vary"].items()}
        said["vary"] = {name: _scaled(name, pair, unit) for name, pair in pairs.items()}
    said |= _given(options, ("objective", "ties", "constraints", "starts", "steps", "local_search", "seed"))
    if options.vary is not None:
        pairs = dict(map(_pair, options.vary))
        angle = whole_arm.angle_unit(options)
        said["vary"] = {name: _scaled(name, pair, angle) for name, pair in pairs.items()}
    if options.no_limits:
        said["limits"] = False
    if "vary" not in said:
        raise ValueError("what may vary is missing: [design] vary = in a study file, or --vary a2=0.2:0.6")
    if said.get("objective", "coverage") not in NAMED:
        raise ValueError(f"objective must be one of {', '.join(NAMED)}, got {said['objective']!r}")
    return said


_SECTIONS = {"place": _of_place, "design": _of_design}


def _scaled(name: str, pair: np.ndarray, unit: float) -> tuple[float, float]:
    """Bounds of a number of the arm; `unit` is one of its angles [rad]."""
    low, high = (float(x) * (unit if is_angle(name) else 1.0) for x in pair)
    return low, high


def _bounds(key: str, entries, unit: float) -> dict[str, tuple[float, float]]:
    if not isinstance(entries, dict):
        raise ValueError(f"{key} must be a table such as {{ x = [-1, 1] }}, or several, got {entries!r}")
    pairs = {name: numbers_of(f"{key}.{name}", pair, (2,)) for name, pair in entries.items()}
    return {name: tuple(pair * (unit if name in ANGLES else 1.0)) for name, pair in pairs.items()}


def _named_bounds(text: str, unit: float) -> tuple[str, tuple[float, float]]:
    name, pair = _pair(text)
    low, high = (float(x) * (unit if name in ANGLES else 1.0) for x in pair)
    return name, (low, high)


def _pair(text: str) -> tuple[str, np.ndarray]:
    """A name and two numbers from NAME=LOW:HIGH."""
    name, equals, ends = text.partition("=")
    try:
        pair = np.array([float(x) for x in ends.split(":")])
    except ValueError:
        pair = np.zeros(0)
    if not equals or pair.shape != (2,):
        raise ValueError(f"bounds are NAME=LOW:HIGH, as in x=-1:1, got {text!r}")
    return name, pair


def _is_any(value) -> bool:
    return True


def _is_flag(value) -> bool:
    return isinstance(value, bool)


def _is_whole(value) -> bool:
    return (value == 0 and not isinstance(value, bool | float)) or is_count(value)


def _is_texts(value) -> bool:
    return is_text(value) or (isinstance(value, list) and all(map(is_text, value)))
