"""The processes that share one sweep: the first leads, and each computes its own units.

They are those of `jax.distributed`, and exchange JSON values through its coordinator's key-value store alone:
a collective operation would fail where one process waits long for another. jax notices a process that dies
and ends the others; what they have written is whole.
"""

import contextlib
import itertools
import json
import time
from collections.abc import Iterator
from typing import Any

import jax

from ikjax.maps.runner import Stop

POLL_SECONDS = 0.05
"""Between two looks at the key-value store while waiting."""

_runs = itertools.count()


class Processes:
    """This process among those of one sweep. All of them must begin the same sweeps in the same order.

    In a program of one process nothing is published, and nothing is waited for.
    """

    def __init__(self):
        self.index, self.count = jax.process_index(), jax.process_count()
        self._prefix = f"ikjax/{next(_runs)}/"
        self._client: Any = None
        if self.count > 1:
            # jax has no public access to the store; orbax uses this one too.
            from jax._src import distributed

            self._client = distributed.global_state.client

    @property
    def is_first(self) -> bool:
        """Whether this process leads: it alone holds the lock and writes the group's document."""
        return self.index == 0

    def own_units(self, todo: list[int]) -> list[int]:
        """The units of this process, of all that are to be computed."""
        return todo[self.index :: self.count]

    def publish(self, key: str, value: Any) -> None:
        """Make a JSON value known to the other processes, once under each key."""
        if self._client is not None:
            self._client.key_value_set(f"{self._prefix}{key}", json.dumps(value))

    def fetch(self, key: str) -> Any:
        """Wait for a value that another process publishes, and return it.

        Raises:
            ValueError: The first process published an error in its place: it could not begin.
        """
        while f"{self._prefix}{key}" not in (values := self._published(key)):
            time.sleep(POLL_SECONDS)
        value = values[f"{self._prefix}{key}"]
        if isinstance(value, dict) and "error" in value:
            raise ValueError(f"the first process could not begin: {value['error']}")
        return value

    @contextlib.contextmanager
    def publishing_errors(self, key: str) -> Iterator[None]:
        """A block whose error is published in place of the value that the others wait for."""
        try:
            yield
        except BaseException as error:
            self.publish(key, {"error": f"{type(error).__name__}: {error}"})
            raise

    def publish_end(self, why: str | None = None) -> None:
        """Publish that this process has ended.

        Args:
            why: The reason, if it ended before its units were done.
        """
        self.publish(f"ends/{self.index}", why)

    def failure(self) -> str | None:
        """Why another process has ended before its units were done; None if none has."""
        for key, why in self._published("ends/").items():
            if why is not None and not key.endswith(f"/{self.index}"):
                return f"process {key.rpartition('/')[2]} ended: {why}"
        return None

    def wait_for_all(self) -> str | None:
        """Wait until all processes have ended; then as `failure`."""
        while self._client is not None and len(self._published("ends/")) < self.count:
            time.sleep(POLL_SECONDS)
        return self.failure()

    def wait_for_first(self, point: str) -> None:
        """Wait until the first process has called this with the same name; it does not wait itself."""
        if self.is_first:
            self.publish(point, True)
        else:
            self.fetch(point)

    def stop_with_others(self, stop: Stop | None) -> Stop | None:
        """The same reasons to stop, and one more: another process has ended before its units were done."""
        if self._client is None:
            return stop
        return lambda ended: (stop and stop(ended)) or (self.failure() if ended else None)

    def _published(self, key: str) -> dict[str, Any]:
        """All values in the folder of a key, by full key; nothing in a program of one process."""
        if self._client is None:
            return {}
        prefix = f"{self._prefix}{key.rpartition('/')[0]}"
        return {k: json.loads(v) for k, v in self._client.key_value_dir_get(prefix.rstrip("/") + "/")}
