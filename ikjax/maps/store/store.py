"""Maps on disk: begun, gone on with and read, and never wrong whatever interrupts them.

Needs the extra `sweep`. The order of writing is what keeps a map true:

    1. the group says "clearing", with the new spec; what an earlier map left is removed
    2. the arrays' documents, the axes and the rotations
    3. the group says "sweeping"; units follow, in any order, each chunk whole or not at all
    4. the group says "complete"

So whatever chunk is found below a group that says "sweeping" or "complete" is of its spec, and going on is
computing what cannot be read. A flipped bit, a cut or a missing chunk is an error when it is read.
"""

import collections
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from ikjax.maps.store import manifest
from ikjax.maps.store import manifest as specs
from ikjax.maps.store.manifest import Head
from ikjax.maps.store.storage import Place

AT_ONCE = 4
"""Units that are read at once when a map is surveyed."""


class Survey(NamedTuple):
    """Which units of a map can be read."""

    good: list[bool]
    missing: int
    """Units of which a chunk is not there."""
    damaged: int
    """Units whose chunks are all there, but not as they were written."""


class Store:
    """A map that is being written. Hold a `Lock` meanwhile."""

    def __init__(self, place: Place, head: Head, fixed: specs.Fixed):
        self.place, self.head, self.fixed = place, head, fixed
        self.units = manifest.units(head.shape, head.chunk)
        table = manifest.arrays(head)
        self.arrays = {name: place.array(name, table[name]) for name in table}

    def box(self, number: int) -> tuple[slice, ...]:
        """The positions of a unit."""
        return manifest.box(self.units[number], self.head.shape, self.head.chunk)

    def say(self, state: str, seconds: float = 0.0) -> None:
        """Write the group's document."""
        self.head = self.head._replace(state=state, seconds=seconds)
        self.place.write(manifest.GROUP, manifest.group(self.head))

    def prepare(self) -> None:
        """Steps 1 to 3, up to the first unit."""
        self.say("clearing")
        # The earlier map may have had other statistics and axes; what is no array is not ours.
        there = self.place.keys()
        earlier = {key.removesuffix("/zarr.json") for key in there if key.endswith("/zarr.json")}
        for name in sorted({*earlier, *self.arrays}):
            self.place.delete(f"{name}/")
        self.repair()

    def repair(self) -> None:
        """Write again whatever the spec determines and is not there as it should be."""
        for key, document in manifest.array_documents(self.head).items():
            if self.place.read(key) != document:
                self.place.write(key, document)
        for name, (value, _) in self.fixed.items():
            if not _holds(self.arrays[name], value):
                with self.place.storing(name):
                    self.arrays[name].write(value).result()
        if self.head.state != "complete":
            self.say("sweeping")

    def survey(self) -> Survey:
        """Read every chunk, and clear away those of units that have to be made again."""
        there = _there(self.place, self.head)
        reads: collections.deque[Any] = collections.deque()
        good: list[bool] = []
        missing = 0

        def take():
            futures = reads.popleft()
            good.append(bool(futures) and all(future.exception() is None for future in futures))

        for number, unit in enumerate(self.units):
            whole = all(manifest.key(self.head, name, unit) in there for name in self.head.names)
            missing += not whole
            box = self.box(number)
            names = self.head.names if whole else []
            reads.append([self.arrays[name][box].read() for name in names])
            if len(reads) > AT_ONCE:
                take()
        while reads:
            take()
        for unit, whole in zip(self.units, good, strict=True):
            # A chunk that is larger than what it holds, at the end of an axis, is read before it is written.
            keys = [] if whole else [manifest.key(self.head, name, unit) for name in self.head.names]
            for key in there.intersection(keys):
                self.place.remove(key)
        return Survey(good, missing, len(good) - sum(good) - missing)

    def put(self, number: int, values: Mapping[str, np.ndarray]) -> list[Any]:
        """Begin to write a unit; `settle` waits for it."""
        box = self.box(number)
        with self.place.storing(f"unit {number}"):
            return [self.arrays[name][box].write(value).commit for name, value in values.items()]

    def settle(self, number: int, futures: list[Any]) -> None:
        """Wait until a unit is written and synced."""
        with self.place.storing(f"unit {number + 1} of {len(self.units)}"):
            for future in futures:
                future.result()


def begin(
    place: Place, head: Head, fixed: specs.Fixed, *, resume: bool, force: bool = False, chunk_given: bool
) -> Store:
    """The store of a sweep: a new one, or one to go on with.

    Args:
        place: Where. It is locked by the caller.
        head: The spec and chunk wanted.
        fixed: The arrays that the spec determines.
        resume: Go on with what is there; start if there is nothing.
        force: Replace a map that is there; with `resume`, one that cannot be gone on with.
        chunk_given: Whether the chunk was asked for, and not only the default.

    Raises:
        ValueError: To go on with a map of another spec, chunk or schema.
        FileExistsError: Something else than a map is there; or a map, with neither `resume` nor `force`.
    """
    document = place.read(manifest.GROUP)
    found = manifest.read_group(document)
    told = _told_by_arrays(place, head) if found is None else None
    schema = manifest.schema_of(document)
    if found is None and told is None:
        if document is None and not place.keys():
            return _new(place, head, fixed)
        if schema is None:
            raise FileExistsError(f"{place} exists and is no map; it is left alone")
    if found is not None and found.state == "clearing":
        return _new(place, head, fixed)
    if not resume:
        if force:
            return _new(place, head, fixed)
        kind = (
            "a damaged" if found is None else "a finished" if found.state == "complete" else "an unfinished"
        )
        raise FileExistsError(
            f"{place} holds {kind} map; go on with resume=True (--resume), "
            "or replace it with force=True (--force)"
        )
    found, why = _fits(place, head, found or told, schema, chunk_given)
    if found is None:
        if force:
            return _new(place, head, fixed)
        raise ValueError(f"{why}; replace it with force=True (--force)")
    store = Store(place, found, fixed)
    store.repair()
    if document != manifest.group(store.head):
        store.say(store.head.state, store.head.seconds)
    return store


def _fits(
    place: Place, head: Head, found: Head | None, schema: int | None, chunk_given: bool
) -> tuple[Head | None, str]:
    """The head of a map that can be gone on with, or None and why it cannot."""
    if found is None:
        if schema != specs.SCHEMA:
            return None, f"{place} has schema {schema}, this version writes schema {specs.SCHEMA}"
        return None, f"{place} is a map damaged beyond repair, or of another spec"
    if found.spec != head.spec:
        rows = specs.differences(found.spec, head.spec)
        return None, (
            f"{place} holds a map with fingerprint {specs.fingerprint(found.spec)}, this sweep's is "
            f"{specs.fingerprint(head.spec)}: {'; '.join(rows)}"
        )
    if chunk_given and found.chunk != head.chunk:
        return None, f"{place} has chunk {found.chunk}, got chunk {head.chunk}"
    return found, ""


def _new(place: Place, head: Head, fixed: specs.Fixed) -> Store:
    store = Store(place, head, fixed)
    store.prepare()
    return store


def _told_by_arrays(place: Place, head: Head) -> Head | None:
    """The head, where the group's document is lost but every array's says that it is of this spec."""
    chunk = manifest.chunk_of(place.read(f"{head.names[0]}/zarr.json"))
    if chunk is None or len(chunk) < len(head.shape) or min(chunk) < 1:
        return None
    head = head._replace(chunk=chunk[: len(head.shape)], state="sweeping")
    documents = manifest.array_documents(head)
    return head if all(place.read(key) == document for key, document in documents.items()) else None


def read(place: Place) -> tuple[Head, dict[str, "Stored"]]:
    """What a finished map says, and its arrays, which are read when they are asked for.

    Raises:
        ValueError: No map there, of another schema, damaged, or unfinished: the message says how to go on.
    """
    document = place.read(manifest.GROUP)
    head = manifest.read_group(document)
    if head is None:
        schema = manifest.schema_of(document)
        if schema is None:
            raise ValueError(f"{place} holds no ikjax map")
        if schema != specs.SCHEMA:
            raise ValueError(f"{place} has schema {schema}, this version reads schema {specs.SCHEMA}")
        raise ValueError(f"{place}: zarr.json was changed by hand or damaged; {_MEND}")
    try:
        specs.check_stored(head.spec)
    except ValueError as error:
        raise ValueError(f"{place} is no map that a sweep has written: {error}") from error
    units = manifest.units(head.shape, head.chunk)
    if head.state == "clearing":
        raise ValueError(f"{place} is unfinished: {len(units)} of {len(units)} units are missing; {_GO_ON}")
    for key, wanted in manifest.array_documents(head).items():
        if place.read(key) != wanted:
            raise ValueError(f"{place}: {key} is damaged or missing; {_MEND}")
    there = _there(place, head)
    missing = sum(any(manifest.key(head, name, unit) not in there for name in head.names) for unit in units)
    if missing:
        raise ValueError(f"{place} is unfinished: {missing} of {len(units)} units are missing; {_GO_ON}")
    table = manifest.arrays(head)
    return head, {name: Stored(place, name, place.array(name, table[name])) for name in table}


_MEND = "the sweep that made it mends it, with resume=True (--resume)"
_GO_ON = "go on with the sweep that made it, with resume=True (--resume)"


class Stored:
    """An array of a map, read when it is indexed: `stored[:, :, 3]` reads one slice."""

    def __init__(self, place: Place, name: str, array: Any):
        self.place, self.name, self._array = place, name, array
        self.shape: tuple[int, ...] = tuple(array.shape)
        self.dtype: np.dtype = array.dtype.numpy_dtype

    def __getitem__(self, index) -> np.ndarray:
        try:
            return np.asarray(self._array[index].read().result())
        except ValueError as error:  # tensorstore raises it for lost and for damaged data
            text = " ".join(str(error).split())[:200]
            raise ValueError(f"{self.place}: {self.name} is damaged; {_MEND}: {text}") from error

    def __array__(self, dtype=None, copy=None) -> np.ndarray:
        return np.asarray(self[...], dtype)


def _holds(array: Any, value: np.ndarray) -> bool:
    read = array.read()
    return read.exception() is None and np.array_equal(read.result(), value)


def _there(place: Place, head: Head) -> set[str]:
    return set().union(*(place.keys(f"{name}/c/") for name in head.names))
