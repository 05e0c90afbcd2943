"""One writer for each map: a lock that names its holder.

Beside a folder `map.zarr` it is the file `map.zarr.lock`; in another store it is the key of that name,
written only where there is none. A lock of a dead process on this machine is taken over.
"""

import json
import os
import pathlib
import socket

from ikjax.maps.store.storage import Storage


class Lock:
    """A block in which no other process writes to a storage.

    To enter it raises ValueError if another process holds the lock, StorageError if it cannot be written.
    """

    def __init__(self, storage: Storage):
        self.storage = storage
        folder = storage.folder
        self.file = None if folder is None else folder.with_name(f"{folder.name}.lock")

    def __enter__(self) -> "Lock":
        if self.file is None:
            _take_key(self.storage)
        else:
            with self.storage.writing(str(self.file)):
                self.file.parent.mkdir(parents=True, exist_ok=True)
            while not _take_file(self.storage, self.file):
                pass
        return self

    def __exit__(self, *_) -> None:
        if self.file is not None:
            self.file.unlink(missing_ok=True)
        else:
            self.storage.beside.write(".lock", None).result()


def _take_file(storage: Storage, path: pathlib.Path) -> bool:
    """Write our name into the lock file; False if the file was removed meanwhile, so that it must be retried.

    Raises:
        ValueError: A living process holds it, or one on another machine.
        StorageError: It cannot be written.
    """
    import fcntl

    try:
        with storage.writing(str(path)):
            handle = os.open(path, os.O_CREAT | os.O_EXCL | os.O_RDWR, 0o644)
    except OSError as error:
        if not isinstance(error.__cause__, FileExistsError):
            raise
        try:
            handle = os.open(path, os.O_RDWR)
        except FileNotFoundError:
            return False
    try:
        # Two processes that find one stale lock would each remove the other's new one. So it is rewritten in
        # place instead, by the process that has locked the file, and only if it still has that name.
        fcntl.flock(handle, fcntl.LOCK_EX)
        if not _is_named(path, handle):
            return False
        _refuse_live_holder(storage, os.pread(handle, 4096, 0), f"the file {path}")
        os.ftruncate(handle, 0)
        with storage.writing(str(path)):
            os.pwrite(handle, _own_identity(), 0)
            os.fsync(handle)
        # The last holder may have removed the file and ended before it was found dead.
        return _is_named(path, handle)
    finally:
        os.close(handle)


def _is_named(path: pathlib.Path, handle: int) -> bool:
    """Whether an open file is still the one at that path."""
    try:
        return os.path.samestat(os.stat(path), os.fstat(handle))
    except FileNotFoundError:
        return False


def _take_key(storage: Storage) -> None:
    """Write our name under the lock's key.

    Raises:
        ValueError: A living process holds it, or one on another machine.
        StorageError: It cannot be written.
    """
    for _ in range(3):
        current = storage.beside.read(".lock").result()
        if current.state == "value":
            _refuse_live_holder(storage, current.value, f"the key {storage}.lock")
        with storage.writing(".lock"):
            written = storage.beside.write(
                ".lock", _own_identity(), if_equal=current.stamp.generation
            ).result()
        # A conditional write that lost against another carries no generation.
        if written.generation and storage.beside.read(".lock").result().value == _own_identity():
            return
    raise ValueError(f"{storage} is being written by others; nothing was touched")


def _own_identity() -> bytes:
    """This process as the text of a lock."""
    me = {"pid": os.getpid(), "host": socket.gethostname(), "began": _start_time(os.getpid())}
    return json.dumps(me).encode()


def _refuse_live_holder(storage: Storage, holder: bytes, where: str) -> None:
    """Raise ValueError unless the lock is empty, unreadable or of a dead process of this machine.

    Args:
        storage: What is locked.
        holder: The text of the lock.
        where: The lock's file or key, for the message.
    """
    try:
        name = json.loads(holder)
        pid, host, began = int(name["pid"]), str(name["host"]), name["began"]
    except (ValueError, KeyError, TypeError):
        return  # its writer died before it had written its name
    if host != socket.gethostname():
        raise ValueError(
            f"{storage} is being written by process {pid} on {host}; nothing was touched. "
            f"If that process is dead, delete {where}"
        )
    # A process number may be given to another process later, but not with the same start time.
    if began == _start_time(pid) and _is_alive(pid):
        raise ValueError(f"{storage} is being written by process {pid} on this machine; nothing was touched")


def _is_alive(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except PermissionError:
        pass
    return True


def _start_time(pid: int) -> str | None:
    """Start time of a process, in clock ticks since boot; None where there is no /proc."""
    try:
        stat = pathlib.Path(f"/proc/{pid}/stat").read_text()
    except OSError:
        return None
    # The name in parentheses may contain blanks and parentheses.
    return stat.rpartition(")")[2].split()[19]
