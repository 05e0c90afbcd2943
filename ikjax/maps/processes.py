"""The processes that share one sweep: the first leads, and each has its own units.

They are those of `jax.distributed`, and speak through its coordinator's key-value store
alone: a collective would fail where one waits long for another. A process that dies is noticed by jax, which
ends the others; what they have written is whole.
"""

import contextlib
import itertools
import json
import time
from collections.abc import Iterator
from typing import Any

import jax

from ikjax.maps.runner import Stop

_runs = itertools.count()


class Crew:
    """This process among those of one sweep. All of them must begin the same sweeps in the same order."""

    def __init__(self):
        self.index, self.count = jax.process_index(), jax.process_count()
        self._prefix = f"ikjax/{next(_runs)}/"
        self._client: Any = None
        if self.count > 1:
            # There is no public way to the store; orbax goes this one too.
            from jax._src import distributed

            self._client = distributed.global_state.client

    @property
    def leads(self) -> bool:
        return self.index == 0

    def share(self, todo: list[int]) -> list[int]:
        """The units of this process."""
        return todo[self.index :: self.count]

    def tell(self, key: str, value: Any) -> None:
        """Say something to the others, once."""
        if self._client is not None:
            self._client.key_value_set(f"{self._prefix}{key}", json.dumps(value))

    def hear(self, key: str) -> Any:
        """Wait for what is told.

        Raises:
            ValueError: The first process could not begin, and why.
        """
        while f"{self._prefix}{key}" not in (said := self._said(key)):
            time.sleep(0.05)
        value = said[f"{self._prefix}{key}"]
        if isinstance(value, dict) and "error" in value:
            raise ValueError(f"the first process could not begin: {value['error']}")
        return value

    @contextlib.contextmanager
    def excuse(self, key: str) -> Iterator[None]:
        """A block whose error is told in the place of what the others wait for."""
        try:
            yield
        except BaseException as error:
            self.tell(key, {"error": f"{type(error).__name__}: {error}"})
            raise

    def end(self, why: str | None = None) -> None:
        """Say that this process has ended, and why, if before its units were done."""
        self.tell(f"ends/{self.index}", why)

    def broken(self) -> str | None:
        """Why another process has ended before its units were done."""
        for key, why in self._said("ends/").items():
            if why is not None and not key.endswith(f"/{self.index}"):
                return f"process {key.rpartition('/')[2]} ended: {why}"
        return None

    def wait(self) -> str | None:
        """Wait until all have ended; why one of the others did before its units were done."""
        while self._client is not None and len(self._said("ends/")) < self.count:
            time.sleep(0.05)
        return self.broken()

    def meet(self, where: str) -> None:
        """Wait for the first process to get so far."""
        if self.leads:
            self.tell(where, True)
        else:
            self.hear(where)

    def heeding(self, stop: Stop | None) -> Stop | None:
        """The reasons to stop, and that another process has ended."""
        if self._client is None:
            return stop
        return lambda ended: (stop and stop(ended)) or (self.broken() if ended else None)

    def _said(self, key: str) -> dict[str, Any]:
        if self._client is None:
            return {}
        prefix = f"{self._prefix}{key.rpartition('/')[0]}"
        return {k: json.loads(v) for k, v in self._client.key_value_dir_get(prefix.rstrip("/") + "/")}
