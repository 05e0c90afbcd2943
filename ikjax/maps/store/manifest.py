"""The documents of a stored map: its spec and fingerprint, its zarr v3 metadata, its work units.

Nothing is read or written here. The spec is JSON of everything that the numbers of a map depend on; maps with
equal fingerprints hold equal numbers. A work unit is one chunk of the positions, in the arrays of all
statistics. Every document is known to the byte beforehand, so that a flipped bit in one is found.

    zarr.json                 the spec, its fingerprint, the chunk, the state
    reachable/zarr.json       and so on for every statistic: the positions' shape, perhaps more axes
    reachable/c/1/0/2         its chunk of unit (1, 0, 2), with a checksum
    rotations, x, y, z        what the axes mean; other sets have other names
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
from typing import Any, NamedTuple, Protocol

import jax.numpy as jnp
import numpy as np

from ikjax.arm.arm import Arm
from ikjax.arm.recognition import recognize
from ikjax.arm.recognition.signs import named_signs
from ikjax.core.text import line
from ikjax.maps.sets.orientations import Listed, Orientations
from ikjax.maps.sets.protocol import NamedArrays, OrientationSet, PositionSet

SCHEMA = 4
"""Version of a map's layout; a reader refuses any other."""


SAMPLES = "redundancy_samples"
"""Key of a spec, there for arms with redundant joints alone."""


class Study(Protocol):
    """What the numbers of a map depend on; a `ReachMap` is one.

    The fields mean what they mean there.
    """

    @property
    def arm(self) -> Arm: ...

    @property
    def positions(self) -> PositionSet: ...

    @property
    def orientations(self) -> Orientations: ...

    @property
    def free_rolls(self) -> int: ...

    @property
    def redundancy_samples(self) -> int: ...

    @property
    def dtype(self) -> str: ...

    @property
    def statistic_specs(self) -> Mapping[str, dict[str, Any]]: ...


def describe(study: Study) -> tuple[dict[str, Any], NamedArrays]:
    """The spec of a map, and the arrays that a map stores besides its statistics.

    The size of the chunks is not in the spec: the numbers do not depend on it.

    Args:
        study: What the numbers depend on.

    Returns:
        The spec as plain JSON values, and the arrays of `fixed_arrays`, of which the spec has the hashes.

    Raises:
        ValueError: A statistic has the name of one of these arrays.
    """
    fixed = fixed_arrays(study.positions, study.orientations)
    statistics = study.statistic_specs
    if taken := [name for name in statistics if name in fixed]:
        raise ValueError(f"a map cannot keep a statistic {taken[0]!r}: its own {taken[0]} are called so")
    positions, orientations = study.positions, study.orientations
    spec = {
        "schema": SCHEMA,
        # Rooms below may not import the front door, but whoever calls this has imported it.
        "ikjax": sys.modules["ikjax"].__version__,
        # As the kernel sees it, whatever the type of its leaves.
        "arm": arm_spec(study.arm.astype("float64" if is_certified(statistics) else study.dtype)),
        "positions": {**set_spec(positions), "shape": positions.shape, "axes": positions.axes},
        "orientations": {**set_spec(orientations), "count": orientations.count},
        "free_rolls": study.free_rolls,
        "dtype": study.dtype,
        "statistics": statistics,
        "fixed": {
            name: {"shape": array.shape, "axes": axes, "sha256": array_hash(array)}
            for name, (array, axes) in fixed.items()
        },
    }
    if study.arm.locked:
        spec[SAMPLES] = study.redundancy_samples
    return json.loads(canonical_json(spec)), fixed


def check_name(name: object) -> None:
    """Raise ValueError unless it may name an array of a map: it becomes a file name and a variable name."""
    if not isinstance(name, str) or not re.fullmatch(r"[a-z][a-z0-9_]*", name):
        raise ValueError(f"name must be of small letters, digits and _, got {name!r}")


def check_stored(spec: dict) -> None:
    """Check a stored spec for what no sweep writes; anyone may have written the file.

    Raises:
        ValueError: Names that would lead out of the map's folder or into the commands of its page, or an
            impossible type or number of rolls or samples.
    """
    for name in (*spec["statistics"], *spec["fixed"]):
        check_name(name)
    for name, trials in (("free_rolls", spec["free_rolls"]), (SAMPLES, spec.get(SAMPLES, 1))):
        if type(trials) is not int or trials < 1:
            raise ValueError(f"{name} must be a whole number, got {trials!r}")
    if spec["dtype"] not in ("float32", "float64"):
        raise ValueError(f"dtype must be a type, got {spec['dtype']!r}")


def is_certified(statistics: Mapping[str, dict[str, Any]]) -> bool:
    """Whether doubtful goals were solved again in float64: then the spec has the arm as it was given.

    Args:
        statistics: The spec of each, by name.
    """
    return any(spec.get("certified", False) for spec in statistics.values())


def set_spec(members: PositionSet | OrientationSet) -> dict[str, Any]:
    """A set of positions or orientations as JSON, without its arrays: those are in `fixed_arrays`."""
    dataclass: Any = members
    fields = {field.name: getattr(members, field.name) for field in dataclasses.fields(dataclass)}
    plain = {name: value for name, value in fields.items() if not isinstance(value, np.ndarray)}
    return {"kind": type(members).__name__, **plain}


def array_hash(array: np.ndarray) -> str:
    """SHA-256 of the numbers as little-endian float64."""
    return hashlib.sha256(np.ascontiguousarray(array, "<f8").tobytes()).hexdigest()


def canonical_json(spec: dict) -> str:
    """JSON in one form only: equal values give equal text."""
    return json.dumps(spec, sort_keys=True, allow_nan=False)


def fingerprint(spec: dict) -> str:
    """The first 16 digits of the SHA-256 of the canonical JSON."""
    return hashlib.sha256(canonical_json(spec).encode()).hexdigest()[:16]


def differences(there: dict, here: dict) -> list[str]:
    """Where two specs differ, each as "positions.spacing: 0.1 there, 0.2 here", sorted by key.

    What people say comes first; hashes, which say only that something differs, come last and without digits.
    """
    rows = _differences(there, here, "")
    return [row for _, row in sorted(rows, key=lambda pair: pair[0])]


def _differences(there: dict, here: dict, before: str) -> list[tuple[tuple[bool, str], str]]:
    """The differences below a key, each with what they are sorted by."""
    rows = []
    for key in there.keys() | here.keys():
        name = f"{before}{line(key)}"
        a, b = there.get(key), here.get(key)
        if isinstance(a, dict) and isinstance(b, dict):
            rows += _differences(a, b, f"{name}.")
        elif a != b:
            hashed = key == "sha256"
            words = "other numbers" if hashed else _in_words(key, a, b)
            rows.append(((hashed, name), f"{name.removesuffix('.sha256')}: {words}"))
    return rows


def _in_words(key: str, there, here) -> str:
    """Two values of a key that differ."""
    if key in ("base", "tool") and _is_table(there, 4, 4) and _is_table(here, 4, 4):
        return f"{_pose_in_words(there)} there, {_pose_in_words(here)} here"
    same_length = isinstance(there, list) and isinstance(here, list) and len(there) == len(here)
    if same_length and len(there) > 3:
        pairs = [(k, a, b) for k, (a, b) in enumerate(zip(there, here, strict=True), 1) if a != b]
        if len(pairs) <= 3:
            return "; ".join(f"{_short(a)} there, {_short(b)} here (entry {k})" for k, a, b in pairs)
    return f"{_short(there)} there, {_short(here)} here"


def _is_table(value, rows: int, columns: int) -> bool:
    try:
        return np.asarray(value, float).shape == (rows, columns)
    except (TypeError, ValueError):
        return False


def _pose_in_words(matrix) -> str:
    """Position [m], and roll, pitch and yaw [deg] of a pose, where it turns."""
    T = np.asarray(matrix, float)
    rpy = np.degrees(
        [
            math.atan2(T[2, 1], T[2, 2]),
            math.atan2(-T[2, 0], math.hypot(T[2, 1], T[2, 2])),
            math.atan2(T[1, 0], T[0, 0]),
        ]
    )

    def numbers(values, digits: int) -> str:
        return ", ".join(f"{round(float(x), digits) + 0.0:g}" for x in values)

    turned = f" turned by rpy ({numbers(rpy, 3)}) deg" if np.abs(rpy).max() > 5e-4 else ""
    return f"({numbers(T[:3, 3], 6)}) m{turned}"


def _short(value) -> str:
    text = json.dumps(value)
    return text if len(text) <= 60 else f"{text[:57]}..."


_LEAVES = ("a", "alpha", "d", "theta", "base", "tool", "limits")
_OPTIONAL = ("coupling", "correction")
_FACTS = ("family", "signs", "branches", "task")


def arm_spec(arm: Arm) -> dict[str, Any]:
    """An arm as JSON: lists of the shortest decimals that round to its leaves, infinite limits as null."""
    columns: dict[str, Any] = {name: _numbers(getattr(arm, name)) for name in _LEAVES}
    columns["limits"] = [[x if math.isfinite(x) else None for x in pair] for pair in columns["limits"]]
    for name in _OPTIONAL:
        leaf = getattr(arm, name)
        columns[name] = None if leaf is None else _numbers(leaf)
    facts = {key: getattr(arm, key) for key in _FACTS}
    if arm.locked:
        facts["locked"] = arm.locked
    return {"name": arm.name, "kinds": arm.kinds, "dtype": arm.dtype.name, **facts, **columns}


def _numbers(leaf) -> list:
    shortest = [float(str(x)) for x in np.asarray(leaf).ravel()]
    return np.reshape(shortest, np.shape(leaf)).tolist()


def arm_from_spec(spec: dict) -> Arm:
    """The arm that `arm_spec` describes, leaf by leaf.

    Raises:
        ValueError: Numbers that make no arm, an unknown family, or not the task of the family.
    """
    tasks: dict[str | None, str] = {name: rule.task for name, rule in recognize.RULES.items()}
    tasks[None] = "pose"
    if tasks.get(spec["family"]) != spec["task"]:
        raise ValueError(f"there is no family {spec['family']!r} with the task {spec['task']!r}")
    limits = [[-math.inf if lo is None else lo, math.inf if hi is None else hi] for lo, hi in spec["limits"]]
    table = {name: spec[name] for name in (*_LEAVES, *_OPTIONAL)} | {"limits": limits}
    # Leaves that were rounded to float32 are recognized with the tolerances of float32.
    dtype = np.float32 if spec["dtype"] == "float32" else None
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # about twists that were rounded to a type
        arm = Arm.from_dh(**table, kinds=spec["kinds"], name=spec["name"], convention="standard", dtype=dtype)
    locked = tuple(spec.get("locked", ()))
    # The numbers and the family as they were stored, whatever family such a table would be recognized as.
    stored: dict[str, Any] = {key: spec[key] for key in ("a", "alpha", "d", "theta", "correction")}
    stored = {key: None if value is None else jnp.asarray(value, arm.dtype) for key, value in stored.items()}
    return dataclasses.replace(
        arm,
        **stored,
        family=spec["family"],
        signs=named_signs(spec["family"], spec["signs"]),
        branches=tuple(spec["branches"]),
        task=spec["task"],
        locked=locked,
    )


MOST_ROTATIONS = 2**16
"""Rotations made by a formula are stored up to so many, for readers that do not know the formula."""

GROUP_KEY = "zarr.json"
"""Key of the document of the zarr group: the map's own."""
UNIT_GOALS = 2**26
"""About so many goals make a work unit: less than a second of a fast arm."""


class Head(NamedTuple):
    """What the group's document says."""

    spec: dict[str, Any]
    """From `describe`."""
    arm: dict[str, Any]
    """The arm as it was given; the spec has it rounded to the kernel's type."""
    chunk: tuple[int, ...]
    """Positions of a unit along each axis."""
    state: str
    """"clearing" (an earlier map is being removed), "sweeping" or "complete"."""
    seconds: float
    """Duration of the sweep; 0 until it is complete."""
    title: str = ""
    """What tells the map from others; in no spec, and not written where it is empty."""

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the positions."""
        return tuple(self.spec["positions"]["shape"])

    @property
    def axes(self) -> list[str]:
        """Names of the positions' axes."""
        return list(self.spec["positions"]["axes"])

    @property
    def names(self) -> list[str]:
        """Names of the statistics."""
        return list(self.spec["statistics"])


def default_chunk(shape: tuple[int, ...], orientations: int, goals: float = UNIT_GOALS) -> tuple[int, ...]:
    """A chunk of about so many goals: edges in powers of two, as equal as the shape allows.

    It has at least 512 positions and at most 2^21. If fewer than `UNIT_GOALS` are asked for, because the arm
    is slow, it has at least one position.

    Args:
        shape: Of the positions.
        orientations: Goals at each position.
        goals: Wanted for one chunk.
    """
    least = 512 if goals >= UNIT_GOALS else 1
    left = min(max(goals / orientations, least), 2**21)
    chunk = [0] * len(shape)
    # The shortest axes first: what they do not use is left to the others.
    for rank, axis in enumerate(sorted(range(len(shape)), key=lambda k: shape[k])):
        edge = 2 ** math.floor(math.log2(left) / (len(shape) - rank) + 1e-9)
        chunk[axis] = min(edge, shape[axis])
        left = max(left / chunk[axis], 1)
    return tuple(chunk)


def unit_indices(shape: tuple[int, ...], chunk: tuple[int, ...]) -> list[tuple[int, ...]]:
    """The index of every unit among the chunks along each axis, the last axis fastest."""
    counts = [-(-size // edge) for size, edge in zip(shape, chunk, strict=True)]
    return list(itertools.product(*map(range, counts)))


def unit_box(unit: tuple[int, ...], shape: tuple[int, ...], chunk: tuple[int, ...]) -> tuple[slice, ...]:
    """The positions of a unit, a slice along each axis."""
    return tuple(
        slice(i * edge, min((i + 1) * edge, size)) for i, edge, size in zip(unit, chunk, shape, strict=True)
    )


def chunk_key(head: Head, name: str, unit: tuple[int, ...]) -> str:
    """The key of a unit's chunk of a statistic."""
    extra_axes = head.spec["statistics"][name]["shape"]
    return "/".join([name, "c", *map(str, unit), *("0" for _ in extra_axes)])


def fixed_arrays(positions: PositionSet, orientations: Orientations) -> NamedArrays:
    """The arrays that a map stores besides its statistics: coordinates of positions, and rotations."""
    arrays = dict(positions.named())
    if isinstance(orientations, Listed) or orientations.count <= MOST_ROTATIONS:
        arrays["rotations"] = (orientations.rotations, ("orientation", "row", "column"))
    return arrays


def group_document(head: Head) -> bytes:
    """The document of the zarr group, with a checksum of its attributes."""
    attributes = {
        "ikjax_schema": SCHEMA,
        "fingerprint": fingerprint(head.spec),
        "chunk": list(head.chunk),
        "state": head.state,
        "seconds": head.seconds,
        "spec": head.spec,
        "arm": head.arm,
    }
    if head.title:
        attributes["title"] = head.title
    attributes["checksum"] = hashlib.sha256(canonical_json(attributes).encode()).hexdigest()
    return _document({"zarr_format": 3, "node_type": "group", "attributes": attributes})


def read_group(document: bytes | None) -> Head | None:
    """What a group's document says; None if it is missing, of another schema, or not as it was written."""
    try:
        stored = json.loads(document or b"")["attributes"]
        head = Head(
            *(stored["spec"], stored["arm"], tuple(stored["chunk"]), stored["state"], stored["seconds"]),
            stored.get("title", ""),
        )
        return head if group_document(head) == document else None
    except (ValueError, KeyError, TypeError, RecursionError):
        return None


def schema_of(document: bytes | None) -> int | None:
    """The schema that a group's document names; None if it names none."""
    try:
        return int(json.loads(document or b"")["attributes"]["ikjax_schema"])
    except (ValueError, KeyError, TypeError, RecursionError):
        return None


def array_metadata(head: Head) -> dict[str, dict[str, Any]]:
    """The zarr metadata of every array, by name."""
    attributes = {"fingerprint": fingerprint(head.spec)}
    metadata = {}
    for name, spec in head.spec["statistics"].items():
        shape, chunk = [*head.shape, *spec["shape"]], [*head.chunk, *spec["shape"]]
        metadata[name] = _zarr_array(spec["dtype"], shape, chunk, [*head.axes, *spec["axes"]], attributes)
    for name, spec in head.spec["fixed"].items():
        metadata[name] = _zarr_array("float64", spec["shape"], spec["shape"], spec["axes"], attributes)
    return metadata


def _zarr_array(dtype: str, shape: list, chunk: list, axes: list, attributes: dict) -> dict[str, Any]:
    return {
        "zarr_format": 3,
        "node_type": "array",
        "shape": shape,
        "data_type": dtype,
        "chunk_grid": {"name": "regular", "configuration": {"chunk_shape": chunk}},
        "chunk_key_encoding": {"name": "default", "configuration": {"separator": "/"}},
        # Not zero: readers that fill in missing chunks must not show them as positions out of reach.
        "fill_value": {"int32": -1, "uint32": 2**32 - 1}.get(dtype, "NaN"),
        "codecs": [{"name": "bytes", "configuration": {"endian": "little"}}, {"name": "crc32c"}],
        "dimension_names": axes,
        # Every document says which map it belongs to, in case the group's own is lost.
        "attributes": attributes,
    }


def array_documents(head: Head) -> dict[str, bytes]:
    """The documents of all arrays, by key."""
    return {f"{name}/zarr.json": _document(metadata) for name, metadata in array_metadata(head).items()}


def chunk_of(document: bytes | None) -> tuple[int, ...] | None:
    """The chunk that an array's document names; None if it names none."""
    try:
        return tuple(map(int, json.loads(document or b"")["chunk_grid"]["configuration"]["chunk_shape"]))
    except (ValueError, KeyError, TypeError, RecursionError):
        return None


def _document(content: dict) -> bytes:
    return json.dumps(content, indent=1, sort_keys=True).encode()
