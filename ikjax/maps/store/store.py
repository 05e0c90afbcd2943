"""Maps in storage: started, resumed and read, and never wrong whatever interrupts them.

Needs the extra `sweep`. The order of writing keeps a map consistent:

    1. the group says "clearing", with the new spec; what an earlier map left is removed
    2. the arrays' documents, the axes and the rotations
    3. the group says "sweeping"; units follow, in any order, each chunk whole or not at all
    4. the group says "complete"

So every chunk below a group that says "sweeping" or "complete" belongs to its spec, and to resume a sweep is
to compute what cannot be read. A flipped bit, a truncated or a missing chunk is an error when it is read.
"""

import collections
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from ikjax.maps.sets.protocol import NamedArrays
from ikjax.maps.store import manifest
from ikjax.maps.store.manifest import Head
from ikjax.maps.store.storage import Storage

AT_ONCE = 4
"""Units that are read at once when a map is surveyed."""


class Survey(NamedTuple):
    """Which units of a map can be read."""

    good: list[bool]
    """Of each unit: every chunk of it can be read."""
    missing: int
    """Units of which at least one chunk is missing."""
    damaged: int
    """Units whose chunks are all there, but not as they were written."""


class Store:
    """A map that is being written. The caller holds the `Lock` of its storage."""

    def __init__(self, storage: Storage, head: Head, fixed: NamedArrays):
        """A map in storage; nothing is read or written yet.

        Args:
            storage: Where.
            head: What the group's document says, or will say.
            fixed: The arrays besides the statistics, from `manifest.describe`.
        """
        self.storage, self.head, self.fixed = storage, head, fixed
        self.units = manifest.unit_indices(head.shape, head.chunk)
        self.arrays = {
            name: storage.array(name, metadata) for name, metadata in manifest.array_metadata(head).items()
        }

    def box(self, number: int) -> tuple[slice, ...]:
        """The positions of the unit of that number, a slice along each axis."""
        return manifest.unit_box(self.units[number], self.head.shape, self.head.chunk)

    def write_state(self, state: str, seconds: float = 0.0) -> None:
        """Write the group's document.

        Args:
            state: As `Head.state`.
            seconds: Duration of the sweep, once it is complete.
        """
        self.head = self.head._replace(state=state, seconds=seconds)
        self.storage.write(manifest.GROUP_KEY, manifest.group_document(self.head))

    def prepare(self) -> None:
        """Steps 1 to 3 of the order above, up to the first unit."""
        self.write_state("clearing")
        # The earlier map may have had other statistics and axes. Keys that belong to no array are left alone.
        keys = self.storage.keys()
        earlier = {key.removesuffix("/zarr.json") for key in keys if key.endswith("/zarr.json")}
        for name in sorted({*earlier, *self.arrays}):
            self.storage.delete(f"{name}/")
        self.repair()

    def repair(self) -> None:
        """Write again every document and array that the spec determines and that is missing or different."""
        for key, document in manifest.array_documents(self.head).items():
            if self.storage.read(key) != document:
                self.storage.write(key, document)
        for name, (value, _) in self.fixed.items():
            if not _stores(self.arrays[name], value):
                with self.storage.writing(name):
                    self.arrays[name].write(value).result()
        if self.head.state != "complete":
            self.write_state("sweeping")

    def survey(self) -> Survey:
        """Read every chunk, and delete those of units that have to be computed again."""
        stored_keys = _chunk_keys(self.storage, self.head)
        reads: collections.deque[Any] = collections.deque()
        good: list[bool] = []
        missing = 0

        def finish_read() -> None:
            futures = reads.popleft()
            good.append(bool(futures) and all(future.exception() is None for future in futures))

        for number, unit in enumerate(self.units):
            whole = all(manifest.chunk_key(self.head, name, unit) in stored_keys for name in self.head.names)
            missing += not whole
            box = self.box(number)
            names = self.head.names if whole else []
            reads.append([self.arrays[name][box].read() for name in names])
            if len(reads) > AT_ONCE:
                finish_read()
        while reads:
            finish_read()
        for unit, whole in zip(self.units, good, strict=True):
            # tensorstore reads a chunk that reaches beyond the end of an axis before it writes it, so a
            # damaged one must not be there.
            keys = [] if whole else [manifest.chunk_key(self.head, name, unit) for name in self.head.names]
            for key in stored_keys.intersection(keys):
                self.storage.remove(key)
        return Survey(good, missing, len(good) - sum(good) - missing)

    def put(self, number: int, values: Mapping[str, np.ndarray]) -> list[Any]:
        """Begin to write a unit; `settle` waits for it.

        Args:
            number: Of the unit.
            values: By statistic, (*shape of the unit, ...).

        Returns:
            The pending writes.

        Raises:
            StorageError: The store cannot be written.
        """
        box = self.box(number)
        with self.storage.writing(f"unit {number}"):
            return [self.arrays[name][box].write(value).commit for name, value in values.items()]

    def settle(self, number: int, futures: list[Any]) -> None:
        """Wait until a unit is written and synced.

        Args:
            number: Of the unit.
            futures: From `put`.

        Raises:
            StorageError: The store cannot be written.
        """
        with self.storage.writing(f"unit {number + 1} of {len(self.units)}"):
            for future in futures:
                future.result()


def begin(
    storage: Storage, head: Head, fixed: NamedArrays, *, resume: bool, force: bool = False, chunk_given: bool
) -> Store:
    """The store of a sweep: a new one, or one to resume.

    Args:
        storage: Where. The caller has locked it.
        head: The spec and chunk wanted.
        fixed: The arrays besides the statistics, from `manifest.describe`.
        resume: Resume the map that is there; start if nothing is there.
        force: Replace a map that is there; with `resume`, only one that cannot be resumed.
        chunk_given: Whether the user asked for the chunk; a default gives way to that of the map.

    Raises:
        ValueError: The map to resume has another spec, chunk or schema.
        FileExistsError: Something else than a map is there; or a map, with neither `resume` nor `force`.
    """
    document = storage.read(manifest.GROUP_KEY)
    stored = manifest.read_group(document)
    recovered = _head_from_arrays(storage, head) if stored is None else None
    schema = manifest.schema_of(document)
    if stored is None and recovered is None:
        if document is None and not storage.keys():
            return _new_store(storage, head, fixed)
        if schema is None:
            raise FileExistsError(f"{storage} exists and is no map; it is left alone")
    if stored is not None and stored.state == "clearing":
        return _new_store(storage, head, fixed)
    if not resume:
        if force:
            return _new_store(storage, head, fixed)
        kind = (
            "a damaged" if stored is None else "a finished" if stored.state == "complete" else "an unfinished"
        )
        raise FileExistsError(
            f"{storage} holds {kind} map; go on with resume=True (--resume), "
            "or replace it with force=True (--force)"
        )
    resumable, why = _resumable(storage, head, stored or recovered, schema, chunk_given)
    if resumable is None:
        if force:
            return _new_store(storage, head, fixed)
        raise ValueError(f"{why}; replace it with force=True (--force)")
    store = Store(storage, resumable, fixed)
    store.repair()
    if document != manifest.group_document(store.head):
        store.write_state(store.head.state, store.head.seconds)
    return store


def _resumable(
    storage: Storage, head: Head, stored: Head | None, schema: int | None, chunk_given: bool
) -> tuple[Head | None, str]:
    """The head of a map that can be resumed, or None and why it cannot."""
    if stored is None:
        if schema != manifest.SCHEMA:
            return None, f"{storage} has schema {schema}, this version writes schema {manifest.SCHEMA}"
        return None, f"{storage} is a map damaged beyond repair, or of another spec"
    if stored.spec != head.spec:
        rows = manifest.differences(stored.spec, head.spec)
        return None, (
            f"{storage} holds a map of another study: {'; '.join(rows)} (fingerprints "
            f"{manifest.fingerprint(stored.spec)} and {manifest.fingerprint(head.spec)})"
        )
    if chunk_given and stored.chunk != head.chunk:
        return None, f"{storage} has chunk {stored.chunk}, got chunk {head.chunk}"
    return stored._replace(title=head.title), ""


def _new_store(storage: Storage, head: Head, fixed: NamedArrays) -> Store:
    store = Store(storage, head, fixed)
    store.prepare()
    return store


def _head_from_arrays(storage: Storage, head: Head) -> Head | None:
    """The head of a map whose group document is lost, if the document of every array has this spec."""
    chunk = manifest.chunk_of(storage.read(f"{head.names[0]}/zarr.json"))
    if chunk is None or len(chunk) < len(head.shape) or min(chunk) < 1:
        return None
    head = head._replace(chunk=chunk[: len(head.shape)], state="sweeping")
    documents = manifest.array_documents(head)
    return head if all(storage.read(key) == document for key, document in documents.items()) else None


def read(storage: Storage) -> tuple[Head, dict[str, "StoredArray"]]:
    """The head of a finished map, and its arrays by name, which are read when they are indexed.

    Raises:
        ValueError: There is no map, or it has another schema, is damaged or unfinished: the message says
            which, and how to resume it.
    """
    document = storage.read(manifest.GROUP_KEY)
    head = manifest.read_group(document)
    if head is None:
        schema = manifest.schema_of(document)
        if schema is None:
            raise ValueError(f"{storage} holds no ikjax map")
        if schema != manifest.SCHEMA:
            raise ValueError(f"{storage} has schema {schema}, this version reads schema {manifest.SCHEMA}")
        raise ValueError(f"{storage}: zarr.json was changed by hand or damaged; {_REPAIR}")
    try:
        manifest.check_stored(head.spec)
    except ValueError as error:
        raise ValueError(f"{storage} is no map that a sweep has written: {error}") from error
    units = manifest.unit_indices(head.shape, head.chunk)
    if head.state == "clearing":
        raise ValueError(
            f"{storage} is unfinished: {len(units)} of {len(units)} units are missing; {_RESUME}"
        )
    for key, wanted in manifest.array_documents(head).items():
        if storage.read(key) != wanted:
            raise ValueError(f"{storage}: {key} is damaged or missing; {_REPAIR}")
    keys = _chunk_keys(storage, head)
    missing = sum(
        any(manifest.chunk_key(head, name, unit) not in keys for name in head.names) for unit in units
    )
    if missing:
        raise ValueError(f"{storage} is unfinished: {missing} of {len(units)} units are missing; {_RESUME}")
    metadata = manifest.array_metadata(head)
    return head, {name: StoredArray(storage, name, storage.array(name, metadata[name])) for name in metadata}


_REPAIR = "the sweep that made it mends it, with resume=True (--resume)"
_RESUME = "go on with the sweep that made it, with resume=True (--resume)"


class StoredArray:
    """An array of a map, read when it is indexed: `stored[:, :, 3]` reads one slice."""

    def __init__(self, storage: Storage, name: str, array: Any):
        self.storage, self.name, self._array = storage, name, array
        self.shape: tuple[int, ...] = tuple(array.shape)
        self.dtype: np.dtype = array.dtype.numpy_dtype

    def __getitem__(self, index) -> np.ndarray:
        try:
            return np.asarray(self._array[index].read().result())
        except ValueError as error:  # tensorstore raises it for lost and for damaged data
            text = " ".join(str(error).split())[:200]
            raise ValueError(f"{self.storage}: {self.name} is damaged; {_REPAIR}: {text}") from error

    def __array__(self, dtype=None, copy=None) -> np.ndarray:
        return np.asarray(self[...], dtype)


def _stores(array: Any, value: np.ndarray) -> bool:
    """Whether a tensorstore array can be read and has these numbers."""
    read = array.read()
    return read.exception() is None and np.array_equal(read.result(), value)


def _chunk_keys(storage: Storage, head: Head) -> set[str]:
    """The keys of all chunks of all statistics that are stored."""
    return set().union(*(storage.keys(f"{name}/c/") for name in head.names))
