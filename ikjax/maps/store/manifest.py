"""The documents of a stored map: its spec and fingerprint, its zarr v3 metadata, its work units.

Pure: nothing is read or written here. The spec is JSON of everything that the numbers of a map depend on;
maps of equal fingerprints hold equal numbers. A work unit is one chunk of the position grid, in every
statistic's array. Each document is known to the byte beforehand, so that a flipped bit in one is seen.

    zarr.json                 the spec, its fingerprint, the chunk, the state
    reachable/zarr.json       and so on for every statistic: the positions' shape, perhaps more axes
    reachable/c/1/0/2         its chunk of unit (1, 0, 2), with a checksum
    rotations, x, y, z        what the axes mean; of other sets their own
"""

import dataclasses
import hashlib
import itertools
import json
import math
import re
import sys
import warnings
from collections.abc import Mapping
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from ikjax.arm.arm import Arm
from ikjax.arm.recognition import recognize
from ikjax.arm.recognition.signs import named_signs
from ikjax.core.text import line
from ikjax.maps.sets.orientations import Listed, Orientations

SCHEMA = 4
"""Version of a map's layout; a reader refuses any other."""


Fixed = Mapping[str, tuple[np.ndarray, tuple[str, ...]]]
"""Arrays that a map holds besides its statistics, by name, with the names of their dimensions."""


def of_study(
    arm: Arm,
    positions,
    orientations,
    free_rolls: int,
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
        # No file below may import the front door, but whoever calls has come through it.
        "ikjax": sys.modules["ikjax"].__version__,
        # As the kernel sees it, whatever type its leaves have where it is swept.
        "arm": of_arm(arm.astype("float64" if is_certified(statistics) else dtype)),
        "positions": {**of_set(positions), "shape": positions.shape, "axes": positions.axes},
        "orientations": {**of_set(orientations), "count": orientations.count},
        "free_rolls": free_rolls,
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
    rolls, dtype = spec["free_rolls"], spec["dtype"]
    if type(rolls) is not int or rolls < 1 or dtype not in ("float32", "float64"):
        raise ValueError(
            f"free_rolls and dtype must be a whole number and a type, got {rolls!r} and {dtype!r}"
        )


def is_certified(statistics: Mapping[str, dict[str, Any]]) -> bool:
    """Whether doubtful goals were solved again in float64: there the arm counts as it was given."""
    return any(told.get("certified", False) for told in statistics.values())


def of_set(chosen) -> dict:
    """A set of positions or orientations as JSON; arrays are left to `fixed`."""
    fields = {field.name: getattr(chosen, field.name) for field in dataclasses.fields(chosen)}
    plain = {name: value for name, value in fields.items() if not isinstance(value, np.ndarray)}
    return {"kind": type(chosen).__name__, **plain}


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
    """Where two specs differ, as "positions.spacing: 0.1 there, 0.2 here"."""
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
    # The numbers as they were stored, whatever a table of such numbers would be recognized as.
    stored: dict[str, Any] = {key: spec[key] for key in ("a", "alpha", "d", "theta", "correction")}
    stored = {key: None if value is None else jnp.asarray(value, arm.dtype) for key, value in stored.items()}
    return dataclasses.replace(
        arm,
        **stored,
        family=spec["family"],
        signs=named_signs(spec["family"], spec["signs"]),
        branches=tuple(spec["branches"]),
        task=spec["task"],
    )


MOST_ROTATIONS = 2**16
"""Of a formula: so many are written out for readers who do not know it."""

GROUP = "zarr.json"
STATES = ("clearing", "sweeping", "complete")
GOALS = 2**26
"""About so many goals make a work unit: less than a second of a fast arm."""


class Head(NamedTuple):
    """What the group's document says."""

    spec: dict
    arm: dict
    """As it was given: the spec has it rounded to the kernel's type."""
    chunk: tuple[int, ...]
    state: str
    """"clearing" (what is there is being removed), "sweeping" or "complete"."""
    seconds: float
    """What the sweep took; 0 until it is complete."""

    @property
    def shape(self) -> tuple[int, ...]:
        """Of the positions."""
        return tuple(self.spec["positions"]["shape"])

    @property
    def axes(self) -> list[str]:
        """Names of the positions' axes."""
        return list(self.spec["positions"]["axes"])

    @property
    def names(self) -> list[str]:
        """Of the statistics."""
        return list(self.spec["statistics"])


def default_chunk(shape: tuple[int, ...], orientations: int, goals: float = GOALS) -> tuple[int, ...]:
    """About so many goals, as near a cube as the positions allow, in powers of two.

    At least 512 positions and at most 2^21, unless the arm is slower than `GOALS` takes for granted.
    """
    least = 512 if goals >= GOALS else 1
    left = min(max(goals / orientations, least), 2**21)
    chunk = [0] * len(shape)
    # The shortest axes first: what they do not use is left to the others.
    for rank, axis in enumerate(sorted(range(len(shape)), key=lambda k: shape[k])):
        edge = 2 ** math.floor(math.log2(left) / (len(shape) - rank) + 1e-9)
        chunk[axis] = min(edge, shape[axis])
        left = max(left / chunk[axis], 1)
    return tuple(chunk)


def units(shape: tuple[int, ...], chunk: tuple[int, ...]) -> list[tuple[int, ...]]:
    """The place of every unit among the chunks, the last axis fastest."""
    counts = [-(-size // edge) for size, edge in zip(shape, chunk, strict=True)]
    return list(itertools.product(*map(range, counts)))


def box(unit: tuple[int, ...], shape: tuple[int, ...], chunk: tuple[int, ...]) -> tuple[slice, ...]:
    """The positions of a unit."""
    return tuple(
        slice(i * edge, min((i + 1) * edge, size)) for i, edge, size in zip(unit, chunk, shape, strict=True)
    )


def key(head: Head, name: str, unit: tuple[int, ...]) -> str:
    """Where a unit's chunk of a statistic lies."""
    more = head.spec["statistics"][name]["shape"]
    return "/".join([name, "c", *map(str, unit), *("0" for _ in more)])


def fixed(positions, orientations: Orientations) -> dict[str, tuple[np.ndarray, tuple[str, ...]]]:
    """The arrays that the spec determines, with the names of their dimensions."""
    arrays = dict(positions.named())
    if isinstance(orientations, Listed) or orientations.count <= MOST_ROTATIONS:
        arrays["rotations"] = (orientations.rotations, ("orientation", "row", "column"))
    return arrays


def group(head: Head) -> bytes:
    """The document of the group."""
    attributes = {
        "ikjax_schema": SCHEMA,
        "fingerprint": fingerprint(head.spec),
        "chunk": list(head.chunk),
        "state": head.state,
        "seconds": head.seconds,
        "spec": head.spec,
        "arm": head.arm,
    }
    attributes["checksum"] = hashlib.sha256(canonical(attributes).encode()).hexdigest()
    return _document({"zarr_format": 3, "node_type": "group", "attributes": attributes})


def read_group(document: bytes | None) -> Head | None:
    """What a group's document says, or None if it is none of this schema or not as it was written."""
    try:
        said = json.loads(document or b"")["attributes"]
        head = Head(said["spec"], said["arm"], tuple(said["chunk"]), said["state"], said["seconds"])
        return head if group(head) == document else None
    except (ValueError, KeyError, TypeError, RecursionError):
        return None


def schema_of(document: bytes | None) -> int | None:
    """The schema that a group's document names, if it names any."""
    try:
        return int(json.loads(document or b"")["attributes"]["ikjax_schema"])
    except (ValueError, KeyError, TypeError, RecursionError):
        return None


def arrays(head: Head) -> dict[str, dict]:
    """The metadata of every array, by name."""
    mark = {"fingerprint": fingerprint(head.spec)}
    table = {}
    for name, said in head.spec["statistics"].items():
        shape, chunk = [*head.shape, *said["shape"]], [*head.chunk, *said["shape"]]
        table[name] = _array(said["dtype"], shape, chunk, [*head.axes, *said["axes"]], mark)
    for name, said in head.spec["fixed"].items():
        table[name] = _array("float64", said["shape"], said["shape"], said["axes"], mark)
    return table


def _array(kind: str, shape: list, chunk: list, axes: list, mark: dict) -> dict:
    return {
        "zarr_format": 3,
        "node_type": "array",
        "shape": shape,
        "data_type": kind,
        "chunk_grid": {"name": "regular", "configuration": {"chunk_shape": chunk}},
        "chunk_key_encoding": {"name": "default", "configuration": {"separator": "/"}},
        # A reader that takes a missing chunk for the fill value shall see that it is none.
        "fill_value": {"int32": -1, "uint32": 2**32 - 1}.get(kind, "NaN"),
        "codecs": [{"name": "bytes", "configuration": {"endian": "little"}}, {"name": "crc32c"}],
        "dimension_names": axes,
        # So that every document says which map it is of, if the group's own is lost.
        "attributes": mark,
    }


def array_documents(head: Head) -> dict[str, bytes]:
    """The documents of all arrays, by key."""
    return {f"{name}/zarr.json": _document(metadata) for name, metadata in arrays(head).items()}


def chunk_of(document: bytes | None) -> tuple[int, ...] | None:
    """The chunk that an array's document names, if it names any."""
    try:
        return tuple(map(int, json.loads(document or b"")["chunk_grid"]["configuration"]["chunk_shape"]))
    except (ValueError, KeyError, TypeError, RecursionError):
        return None


def _document(content: dict) -> bytes:
    return json.dumps(content, indent=1, sort_keys=True).encode()
