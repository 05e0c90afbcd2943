"""Where maps lie: a folder, or any key-value store that tensorstore reaches by URL.

Needs the extra `sweep`. The one file that knows of key-value stores: `file://`,
`memory://`, `s3://`, `gs://` and whatever else tensorstore names. A value is written whole or not at
all, and on a file system it is synced before the write counts as done.
"""

import functools
import pathlib
import urllib.parse
from typing import Any


class StorageError(OSError):
    """The store could not be written: a full disk, a read-only folder, a lost connection."""


def tensorstore() -> Any:
    try:
        import tensorstore
    except ImportError as error:
        raise ImportError("maps on disk need tensorstore: pip install 'ikjax[sweep]'") from error
    return tensorstore


@functools.cache
def _context() -> Any:
    # One for the process: what is in memory:// belongs to its context.
    return tensorstore().Context({"file_io_sync": True})


class Place:
    """Keys and values below one path or URL."""

    def __init__(self, where):
        ts = tensorstore()
        self.name = str(where).rstrip("/")
        self.folder: pathlib.Path | None = None
        """The folder, where it is one."""
        if "://" not in self.name or self.name.startswith("file://"):
            path = urllib.parse.unquote(urllib.parse.urlsplit(self.name).path)
            self.folder = pathlib.Path(path if "://" in self.name else self.name).absolute()
            if self.folder.exists() and not self.folder.is_dir():
                raise FileExistsError(f"{self.folder} exists and is no map; it is left alone")
        spec = self.name if self.folder is None else {"driver": "file", "path": str(self.folder)}
        try:
            self.beside = ts.KvStore.open(spec, context=_context()).result()
        except ValueError as error:
            raise ValueError(f"{self.name} is no place that tensorstore can open: {_short(error)}") from error
        self._inside = self.beside / "/"

    def __str__(self) -> str:
        return self.name

    def read(self, key: str) -> bytes | None:
        """The value, or None where there is none."""
        try:
            found = self._inside.read(key).result()
        except (ValueError, OSError) as error:
            raise StorageError(f"{self}: cannot read {key}: {_short(error)}") from error
        return found.value if found.state == "value" else None

    def write(self, key: str, value: bytes) -> None:
        with self.storing(key):
            self._inside.write(key, value).result()

    def keys(self, prefix: str = "") -> set[str]:
        """Every key that begins with `prefix`."""
        try:
            found = (self._inside / prefix).list().result() if prefix else self._inside.list().result()
        except (ValueError, OSError) as error:
            raise StorageError(f"{self}: cannot list {prefix or 'it'}: {_short(error)}") from error
        return {prefix + key.decode() for key in found}

    def delete(self, prefix: str) -> None:
        """Everything below `prefix`."""
        with self.storing(prefix):
            (self._inside / prefix).delete_range(tensorstore().KvStore.KeyRange()).result()

    def remove(self, key: str) -> None:
        """One value."""
        with self.storing(key):
            self._inside.write(key, None).result()

    def array(self, name: str, metadata: dict) -> Any:
        """A tensorstore array of stated metadata; what its own zarr.json says is not asked."""
        spec = {
            "driver": "zarr3",
            "open": True,
            "metadata": metadata,
            "assume_metadata": True,
            # A chunk that is not there is lost data here, not a block of the fill value.
            "fill_missing_data_reads": False,
            "store_data_equal_to_fill_value": True,
        }
        kvstore = self._inside / f"{name}/"
        return tensorstore().open(spec, kvstore=kvstore, context=_context()).result()

    def storing(self, what: str) -> "_Storing":
        """A block in which an error of the store becomes a `StorageError` that names `what`."""
        return _Storing(self, what)


class _Storing:
    def __init__(self, place: Place, what: str):
        self.place, self.what = place, what

    def __enter__(self) -> None:
        pass

    def __exit__(self, kind, error, _) -> None:
        if isinstance(error, (ValueError, OSError)):
            raise StorageError(f"{self.place}: cannot write {self.what}: {_short(error)}") from error


def _short(error: BaseException) -> str:
    text = " ".join(str(error).split())
    # What the operating system says stands at the end, after long paths.
    return text if len(text) <= 300 else f"{text[:120]} ... {text[-175:]}"
