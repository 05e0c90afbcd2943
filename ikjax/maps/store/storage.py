"""Where maps are stored: a folder, or any key-value store that tensorstore reaches by URL.

Needs the extra `sweep`. This is the only file that knows key-value stores: `file://`, `memory://`, `s3://`,
`gs://` and whatever else tensorstore offers. A value is written whole or not at all, and on a file system it
is synced before the write counts as done.
"""

import contextlib
import functools
import os
import pathlib
import urllib.parse
from collections.abc import Iterator
from typing import Any


class StorageError(OSError):
    """The store could not be written: a full disk, a read-only folder, a lost connection."""


def tensorstore() -> Any:
    """The module, imported at first use: `import ikjax` does not need it.

    Raises:
        ImportError: It is not installed; the message says how to install it.
    """
    try:
        import tensorstore
    except ImportError as error:
        raise ImportError("maps on disk need tensorstore: pip install 'ikjax[sweep]'") from error
    return tensorstore


@functools.cache
def _context() -> Any:
    # One for the whole process, because values in memory:// belong to their context.
    return tensorstore().Context({"file_io_sync": True})


class Storage:
    """Keys and values below one path or URL."""

    def __init__(self, where: str | os.PathLike):
        """Open a storage; nothing is written yet.

        Args:
            where: A folder, which need not exist, or a URL that tensorstore knows.

        Raises:
            FileExistsError: There is a file of that name.
            ValueError: Nothing that tensorstore can open.
        """
        ts = tensorstore()
        self.name = str(where).rstrip("/")
        self.folder: pathlib.Path | None = None
        """The folder; None of other stores."""
        if "://" not in self.name or self.name.startswith("file://"):
            path = urllib.parse.unquote(urllib.parse.urlsplit(self.name).path)
            self.folder = pathlib.Path(path if "://" in self.name else self.name).absolute()
            if self.folder.exists() and not self.folder.is_dir():
                raise FileExistsError(f"{self.folder} exists and is no map; it is left alone")
        self.beside: Any
        """The tensorstore view whose keys begin with the name itself, as the key of the lock does."""
        spec = self.name if self.folder is None else {"driver": "file", "path": str(self.folder)}
        try:
            self.beside = ts.KvStore.open(spec, context=_context()).result()
        except ValueError as error:
            raise ValueError(f"{self.name} is no place that tensorstore can open: {_short(error)}") from error
        self._inside = self.beside / "/"

    def __str__(self) -> str:
        return self.name

    def read(self, key: str) -> bytes | None:
        """The value; None if there is none.

        Raises:
            StorageError: The store cannot be read.
        """
        try:
            result = self._inside.read(key).result()
        except (ValueError, OSError) as error:
            raise StorageError(f"{self}: cannot read {key}: {_short(error)}") from error
        return result.value if result.state == "value" else None

    def write(self, key: str, value: bytes) -> None:
        """Write one value, and wait until it is stored."""
        with self.writing(key):
            self._inside.write(key, value).result()

    def keys(self, prefix: str = "") -> set[str]:
        """Every key that begins with `prefix`.

        Raises:
            StorageError: The store cannot be listed.
        """
        try:
            names = (self._inside / prefix).list().result() if prefix else self._inside.list().result()
        except (ValueError, OSError) as error:
            raise StorageError(f"{self}: cannot list {prefix or 'it'}: {_short(error)}") from error
        return {prefix + key.decode() for key in names}

    def delete(self, prefix: str) -> None:
        """Delete every key that begins with `prefix`."""
        with self.writing(prefix):
            (self._inside / prefix).delete_range(tensorstore().KvStore.KeyRange()).result()

    def remove(self, key: str) -> None:
        """Delete one key."""
        with self.writing(key):
            self._inside.write(key, None).result()

    def array(self, name: str, metadata: dict[str, Any]) -> Any:
        """The tensorstore array of that name with the metadata given; its own zarr.json is not read."""
        spec = {
            "driver": "zarr3",
            "open": True,
            "metadata": metadata,
            "assume_metadata": True,
            # A missing chunk is lost data here, not a block of the fill value.
            "fill_missing_data_reads": False,
            "store_data_equal_to_fill_value": True,
        }
        kvstore = self._inside / f"{name}/"
        return tensorstore().open(spec, kvstore=kvstore, context=_context()).result()

    @contextlib.contextmanager
    def writing(self, what: str) -> Iterator[None]:
        """A block in which an error of the store becomes a `StorageError` that names `what`."""
        try:
            yield
        except (ValueError, OSError) as error:
            raise StorageError(f"{self}: cannot write {what}: {_short(error)}") from error


def _short(error: BaseException) -> str:
    text = " ".join(str(error).split())
    # What the operating system says stands at the end, after long paths.
    return text if len(text) <= 300 else f"{text[:120]} ... {text[-175:]}"
