"""How a map is laid out: the documents of a zarr v3 group, and its work units.

Pure: nothing is read or written here. A unit is one chunk of the position grid, in every
statistic's array. Each document is known to the byte beforehand, so that a flipped bit in one is seen.

    zarr.json                 the spec, its fingerprint, the chunk, the state
    reachable/zarr.json       and so on for every statistic: the positions' shape, perhaps more axes
    reachable/c/1/0/2         its chunk of unit (1, 0, 2), with a checksum
    rotations, x, y, z        what the axes mean; of other sets their own
"""

import hashlib
import itertools
import json
import math
from typing import NamedTuple

import numpy as np

from ikjax.maps.sets.orientations import Listed, Orientations, rotations_of
from ikjax.maps.store import manifest as specs

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
        return tuple(self.spec["grid"]["shape"])

    @property
    def axes(self) -> list[str]:
        """Names of the positions' axes."""
        return list(self.spec["grid"]["axes"])

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
        arrays["rotations"] = (rotations_of(orientations), ("orientation", "row", "column"))
    return arrays


def group(head: Head) -> bytes:
    """The document of the group."""
    attributes = {
        "ikjax_schema": specs.SCHEMA,
        "fingerprint": specs.fingerprint(head.spec),
        "chunk": list(head.chunk),
        "state": head.state,
        "seconds": head.seconds,
        "spec": head.spec,
        "arm": head.arm,
    }
    attributes["checksum"] = hashlib.sha256(specs.canonical(attributes).encode()).hexdigest()
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
    mark = {"fingerprint": specs.fingerprint(head.spec)}
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
