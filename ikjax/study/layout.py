"""How a map is laid out: the documents of a zarr v3 group, and its work units.

Storey: study. Pure: nothing is read or written here. A unit is one chunk of the position grid, in every
statistic's array. Each document is known to the byte beforehand, so that a flipped bit in one is seen.

    zarr.json                 the spec, its fingerprint, the chunk, the state
    reachable/zarr.json       and so on for every statistic, int32 or float32, the grid's shape
    reachable/c/1/0/2         its chunk of unit (1, 0, 2), with a checksum
    rotations, x, y, z        what the axes mean
"""

import hashlib
import itertools
import json
import math
from typing import NamedTuple

import numpy as np

from ikjax.study import spec as specs
from ikjax.study.goals import Grid

COUNTS = ("reachable", "solutions", "reachable_within", "solutions_within")
STATISTICS = (*COUNTS, "best_margin")
AXES = ("x", "y", "z")
FIXED = ("rotations", *AXES)

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
        """Of every statistic."""
        return tuple(self.spec["grid"]["shape"])


def default_chunk(shape: tuple[int, ...], orientations: int) -> tuple[int, ...]:
    """A cube of 8 to 128 positions along an edge, in powers of two, cut to the grid."""
    edge = min(max((GOALS / orientations) ** (1 / 3), 8), 128)
    edge = 2 ** math.floor(math.log2(edge) + 1e-9)
    return tuple(min(edge, size) for size in shape)


def units(shape: tuple[int, ...], chunk: tuple[int, ...]) -> list[tuple[int, ...]]:
    """The place of every unit among the chunks, the last axis fastest."""
    counts = [-(-size // edge) for size, edge in zip(shape, chunk, strict=True)]
    return list(itertools.product(*map(range, counts)))


def box(unit: tuple[int, ...], shape: tuple[int, ...], chunk: tuple[int, ...]) -> tuple[slice, ...]:
    """The positions of a unit."""
    return tuple(
        slice(i * edge, min((i + 1) * edge, size)) for i, edge, size in zip(unit, chunk, shape, strict=True)
    )


def key(name: str, unit: tuple[int, ...]) -> str:
    """Where a unit's chunk of a statistic lies."""
    return "/".join([name, "c", *map(str, unit)])


def fixed(grid: Grid, rotations: np.ndarray) -> dict[str, np.ndarray]:
    """The arrays that the spec determines."""
    return {"rotations": rotations, **{name: grid.axis(k) for k, name in enumerate(AXES)}}


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
    count = head.spec["rotations"]["count"]
    shapes = {"rotations": (count, 3, 3), **{a: (n,) for a, n in zip(AXES, head.shape, strict=True)}}
    names = {"rotations": ("orientation", "row", "column"), **{axis: (axis,) for axis in AXES}}
    table = {}
    for name in (*head.spec["statistics"], *FIXED):
        given = name in FIXED
        shape = shapes[name] if given else head.shape
        kind = "float64" if given else "int32" if name in COUNTS else "float32"
        table[name] = {
            "zarr_format": 3,
            "node_type": "array",
            "shape": list(shape),
            "data_type": kind,
            "chunk_grid": {
                "name": "regular",
                "configuration": {"chunk_shape": list(shape if given else head.chunk)},
            },
            "chunk_key_encoding": {"name": "default", "configuration": {"separator": "/"}},
            # A reader that takes a missing chunk for the fill value shall see that it is none.
            "fill_value": -1 if kind == "int32" else "NaN",
            "codecs": [{"name": "bytes", "configuration": {"endian": "little"}}, {"name": "crc32c"}],
            "dimension_names": list(names[name] if given else AXES),
            # So that every document says which map it is of, if the group's own is lost.
            "attributes": {"fingerprint": specs.fingerprint(head.spec)},
        }
    return table


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
