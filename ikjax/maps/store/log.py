"""The log of a map, the file `map.zarr.log` beside it: when it was started, resumed, stopped and finished.

It is for people; no program reads it. A line that cannot be written is left out, because the map is more
important.
"""

import contextlib
import datetime
import os
import pathlib
import time

import jax

from ikjax.core.text import one_line
from ikjax.maps.store import manifest
from ikjax.maps.store.manifest import Head

EVERY = 60.0
"""Seconds between two lines of progress."""


class Log:
    """Lines with the time. An error that leaves its block is the last line."""

    def __init__(self, folder: pathlib.Path | None):
        """The log beside a map's folder; without a folder, nothing is written."""
        self.path = None if folder is None else folder.with_name(f"{folder.name}.log")
        self._last = time.monotonic()

    def __enter__(self) -> "Log":
        return self

    def __exit__(self, kind, error, _) -> None:
        if error is not None:
            self.line(f"ended: {kind.__name__}: {error}")

    def line(self, text: str) -> None:
        """Append a line with the time and the number of this process."""
        if self.path is None:
            return
        now = datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds")
        with contextlib.suppress(OSError), self.path.open("a", encoding="utf-8") as file:
            file.write(f"{now} [{os.getpid()}] {one_line(text)}\n")

    def write_start(self, head: Head, units: object) -> None:
        """What is swept, by which versions on which devices, and how much of it is stored already.

        Args:
            head: Of the map.
            units: Its `str` says what was found.
        """
        device = jax.devices()[0]
        self.line(
            f"{head.spec['arm']['name']}, fingerprint {manifest.fingerprint(head.spec)}, chunk {head.chunk}, "
            f"ikjax {head.spec['ikjax']}, jax {jax.__version__}, {jax.device_count()} {device.platform}"
        )
        self.line(str(units))

    def write_progress(self, done: int, units: int) -> None:
        """How many of all units are stored; a line at most every `EVERY` seconds."""
        if time.monotonic() - self._last >= EVERY:
            self._last = time.monotonic()
            self.line(f"{done} of {units} units")
