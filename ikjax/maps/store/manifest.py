"""What tells one study from another, as JSON, and the fingerprint of it."""

import dataclasses
import hashlib
import json
import math
import re
import sys
import warnings
from collections.abc import Mapping
from typing import Any

import jax.numpy as jnp
import numpy as np

from ikjax.arm.arm import Arm
from ikjax.arm.recognition import recognize
from ikjax.core.text import line

SCHEMA = 3
"""Version of a map's layout; a reader refuses any other."""


Fixed = Mapping[str, tuple[np.ndarray, tuple[str, ...]]]
"""Arrays that a map holds besides its statistics, by name, with the names of their dimensions."""


def of_study(
    arm: Arm,
    positions,
    orientations,
    rolls: int,
    dtype: str,
    statistics: Mapping[str, dict[str, Any]],
    fixed: Fixed,
) -> dict:
    """Everything that a map's numbers depend on. The size of its chunks is not among it.

    Raises:
        ValueError: A statistic of the name of one of the arrays that the map holds besides.
    """
    if taken := [name for name in statistics if name in fixed]:
        raise ValueError(f"a map cannot keep a statistic {taken[0]!r}: its own {taken[0]} are called so")
    study = {
        "schema": SCHEMA,
        # The front door is in no storey, but whoever calls has come through it.
        "ikjax": sys.modules["ikjax"].__version__,
        # As the kernel sees it, whatever type its leaves have where it is swept.
        "arm": of_arm(arm.astype("float64" if is_certified(statistics) else dtype)),
        "grid": {**of_set(positions), "shape": positions.shape, "axes": positions.axes},
        "orientations": {**of_set(orientations), "count": orientations.count},
        "rolls": rolls,
        "dtype": dtype,
        "statistics": statistics,
        "fixed": {
            name: {"shape": array.shape, "axes": axes, "sha256": hash_of(array)}
            for name, (array, axes) in fixed.items()
        },
    }
    return json.loads(canonical(study))


def check_name(name: object) -> None:
    """Raise unless it may name an array of a map: what names a file and a variable is nothing else."""
    if not isinstance(name, str) or not re.fullmatch(r"[a-z][a-z0-9_]*", name):
        raise ValueError(f"name must be of small letters, digits and _, got {name!r}")


def check_stored(spec: dict) -> None:
    """Raise where a stored spec says what no sweep writes; anyone may have written the file.

    Raises:
        ValueError: Names that would lead out of the map or into the commands of its page, or no such type or
            number of rolls.
    """
    for name in (*spec["statistics"], *spec["fixed"]):
        check_name(name)
    rolls, dtype = spec["rolls"], spec["dtype"]
    if type(rolls) is not int or rolls < 1 or dtype not in ("float32", "float64"):
        raise ValueError(f"rolls and dtype must be a whole number and a type, got {rolls!r} and {dtype!r}")


def is_certified(statistics: Mapping[str, dict[str, Any]]) -> bool:
    """Whether doubtful goals were solved again in float64: there the arm counts as it was given."""
    return any(told.get("certified", False) for told in statistics.values())


def of_set(chosen) -> dict:
    """A set of positions or orientations as JSON; arrays are left to `fixed`."""
    fields = {field.name: getattr(chosen, field.name) for field in dataclasses.fields(chosen)}
    plain = {name: value for name, value in fields.items() if not isinstance(value, np.ndarray)}
    return {"kind": type(chosen).__name__, **plain}


def frozen(array) -> np.ndarray:
    """A copy that nobody can write to, so that a map keeps the numbers that its spec has the hash of."""
    copy = np.array(array, float)
    copy.setflags(write=False)
    return copy


def hash_of(array: np.ndarray) -> str:
    """SHA-256 of the numbers as little-endian float64."""
    return hashlib.sha256(np.ascontiguousarray(array, "<f8").tobytes()).hexdigest()


def canonical(spec: dict) -> str:
    """JSON of one form only: what is equal is spelt equally."""
    return json.dumps(spec, sort_keys=True, allow_nan=False)


def fingerprint(spec: dict) -> str:
    """A hash of the canonical JSON."""
    return hashlib.sha256(canonical(spec).encode()).hexdigest()[:16]


def differences(there: dict, here: dict) -> list[str]:
    """Where two specs differ, as "grid.spacing: 0.1 there, 0.2 here"."""
    rows = []
    for key in sorted(there.keys() | here.keys()):
        a, b = there.get(key), here.get(key)
        if isinstance(a, dict) and isinstance(b, dict):
            rows += [f"{line(key)}.{row}" for row in differences(a, b)]
        elif a != b:
            rows.append(f"{line(key)}: {_short(a)} there, {_short(b)} here")
    return rows


def _short(value) -> str:
    text = json.dumps(value)
    return text if len(text) <= 60 else f"{text[:57]}..."


_LEAVES = ("a", "alpha", "d", "theta", "base", "tool", "limits")
_OPTIONAL = ("coupling", "correction")
_FACTS = ("family", "signs", "branches", "task")


def of_arm(arm: Arm) -> dict:
    """An arm as JSON: lists of the shortest numbers that round to its leaves, infinities as null."""
    columns: dict[str, Any] = {name: _numbers(getattr(arm, name)) for name in _LEAVES}
    columns["limits"] = [[x if math.isfinite(x) else None for x in pair] for pair in columns["limits"]]
    for name in _OPTIONAL:
        leaf = getattr(arm, name)
        columns[name] = None if leaf is None else _numbers(leaf)
    facts = {key: getattr(arm, key) for key in _FACTS}
    return {"name": arm.name, "kinds": arm.kinds, "dtype": arm.dtype.name, **facts, **columns}


def _numbers(leaf) -> list:
    shortest = [float(str(x)) for x in np.asarray(leaf).ravel()]
    return np.reshape(shortest, np.shape(leaf)).tolist()


def to_arm(spec: dict) -> Arm:
    """The arm of `of_arm`.

    Raises:
        ValueError: Numbers that make no arm, a family or a task that is none.
    """
    tasks: dict[str | None, str] = {name: rule.task for name, rule in recognize.RULES.items()}
    tasks[None] = "pose"
    if tasks.get(spec["family"]) != spec["task"]:
        raise ValueError(f"there is no family {spec['family']!r} with the task {spec['task']!r}")
    limits = [[-math.inf if lo is None else lo, math.inf if hi is None else hi] for lo, hi in spec["limits"]]
    table = {name: spec[name] for name in (*_LEAVES, *_OPTIONAL)} | {"limits": limits}
    # Leaves that were rounded to float32 are judged as such: the family is the one that was stored.
    dtype = np.float32 if spec["dtype"] == "float32" else None
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of twists that were rounded to a type
        arm = Arm.from_dh(**table, kinds=spec["kinds"], name=spec["name"], convention="standard", dtype=dtype)
    # The numbers as they were stored, whatever a table of such numbers would be recognised as.
    stored: dict[str, Any] = {key: spec[key] for key in ("a", "alpha", "d", "theta", "correction")}
    stored = {key: None if value is None else jnp.asarray(value, arm.dtype) for key, value in stored.items()}
    return dataclasses.replace(
        arm,
        **stored,
        family=spec["family"],
        signs=tuple(spec["signs"]),
        branches=tuple(spec["branches"]),
        task=spec["task"],
    )
