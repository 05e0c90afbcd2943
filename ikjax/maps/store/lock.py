"""One writer a map: a lock that names its holder, and outlives no holder on the same machine.

Beside a folder `map.zarr` it is the file `map.zarr.lock`; in another store it is the key
of that name, written only where there is none. A lock of a dead process on this machine is taken over.
"""

import json
import os
import pathlib
import socket

from ikjax.maps.store.storage import Place


class Lock:
    """A block in which no other process writes to `place`."""

    def __init__(self, place: Place):
        self.place = place
        self.file = None if place.folder is None else place.folder.with_name(f"{place.folder.name}.lock")

    def __enter__(self) -> "Lock":
        if self.file is None:
            _take_key(self.place)
        else:
            with self.place.storing(str(self.file)):
                self.file.parent.mkdir(parents=True, exist_ok=True)
            while not _take_file(self.place, self.file):
                pass
        return self

    def __exit__(self, *_) -> None:
        if self.file is not None:
            self.file.unlink(missing_ok=True)
        else:
            self.place.beside.write(".lock", None).result()


def _take_file(place: Place, path: pathlib.Path) -> bool:
    """True once it is ours, False if the file went away meanwhile."""
    import fcntl

    try:
        with place.storing(str(path)):
            handle = os.open(path, os.O_CREAT | os.O_EXCL | os.O_RDWR, 0o644)
    except OSError as error:
        if not isinstance(error.__cause__, FileExistsError):
            raise
        try:
            handle = os.open(path, os.O_RDWR)
        except FileNotFoundError:
            return False
    try:
        # Two that find one stale lock would each remove the other's new one: it is rewritten in place
        # instead, by whoever holds the file, and only if it is still the file of that name.
        fcntl.flock(handle, fcntl.LOCK_EX)
        if not _is_named(path, handle):
            return False
        _refuse_living(place, os.pread(handle, 4096, 0), f"the file {path}")
        os.ftruncate(handle, 0)
        with place.storing(str(path)):
            os.pwrite(handle, _mine(), 0)
            os.fsync(handle)
        # The last holder may have taken it away and ended since, before it was found dead.
        return _is_named(path, handle)
    finally:
        os.close(handle)


def _is_named(path: pathlib.Path, handle: int) -> bool:
    """Whether an open file is still the one of that name."""
    try:
        return os.path.samestat(os.stat(path), os.fstat(handle))
    except FileNotFoundError:
        return False


def _take_key(place: Place) -> None:
    for _ in range(3):
        found = place.beside.read(".lock").result()
        if found.state == "value":
            _refuse_living(place, found.value, f"the key {place}.lock")
        with place.storing(".lock"):
            written = place.beside.write(".lock", _mine(), if_equal=found.stamp.generation).result()
        # A write that came second carries no generation.
        if written.generation and place.beside.read(".lock").result().value == _mine():
            return
    raise ValueError(f"{place} is being written by others; nothing was touched")


def _mine() -> bytes:
    me = {"pid": os.getpid(), "host": socket.gethostname(), "began": _began(os.getpid())}
    return json.dumps(me).encode()


def _refuse_living(place: Place, holder: bytes, where: str) -> None:
    """Raise unless the lock is empty, unreadable or of a dead process of this machine."""
    try:
        name = json.loads(holder)
        pid, host, began = int(name["pid"]), str(name["host"]), name["began"]
    except (ValueError, KeyError, TypeError):
        return  # its writer died before it had said who it was
    if host != socket.gethostname():
        raise ValueError(
            f"{place} is being written by process {pid} on {host}; nothing was touched. "
            f"If that process is dead, delete {where}"
        )
    # A number is given again to another process, but not with the same birth.
    if began == _began(pid) and _lives(pid):
        raise ValueError(f"{place} is being written by process {pid} on this machine; nothing was touched")


def _lives(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except PermissionError:
        pass
    return True


def _began(pid: int) -> str | None:
    """When a process began, in ticks of this boot, where that can be asked."""
    try:
        stat = pathlib.Path(f"/proc/{pid}/stat").read_text()
    except OSError:
        return None
    # The name in parentheses may hold blanks and parentheses.
    return stat.rpartition(")")[2].split()[19]
