"""The diary of a map, `map.zarr.log` beside it: when it was begun, gone on with, stopped and finished.

For people; nothing reads it. A line that cannot be written is left out, because the map
comes first.
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
    """Lines with a time; none at all where there is no folder."""

    def __init__(self, folder: pathlib.Path | None):
        self.path = None if folder is None else folder.with_name(f"{folder.name}.log")
        self._last = time.monotonic()

    def __enter__(self) -> "Log":
        return self

    def __exit__(self, kind, error, _) -> None:
        if error is not None:
            self.line(f"ended: {kind.__name__}: {error}")

    def line(self, text: str) -> None:
        if self.path is None:
            return
        now = datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds")
        with contextlib.suppress(OSError), self.path.open("a", encoding="utf-8") as file:
            file.write(f"{now} [{os.getpid()}] {one_line(text)}\n")

    def begun(self, head: Head, units) -> None:
        """What is swept, with what, and what of it is there already."""
        device = jax.devices()[0]
        self.line(
            f"{head.spec['arm']['name']}, fingerprint {manifest.fingerprint(head.spec)}, chunk {head.chunk}, "
            f"ikjax {head.spec['ikjax']}, jax {jax.__version__}, {jax.device_count()} {device.platform}"
        )
        self.line(str(units))

    def progress(self, done: int, units: int) -> None:
        """A line now and then."""
        if time.monotonic() - self._last >= EVERY:
            self._last = time.monotonic()
            self.line(f"{done} of {units} units")
