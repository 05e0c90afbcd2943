"""Why a sweep should stop: a signal, or the end of its time.

A signal is only recorded, and the sweep asks for it; a write that has begun is finished.
The second signal of a kind ends the process at once, as it would any other; a stored map survives that too.
"""

import signal
import threading
import time

TIME_IS_UP = 4
"""Exit code of a sweep whose time is over."""

OTHERS_ENDED = 5
"""Exit code of a sweep of which another process ended before its units were done."""


class Stop:
    """A context that records SIGINT and SIGTERM; call it to ask for a reason to stop.

    Args:
        hours: Time to run; None for no limit.
    """

    def __init__(self, hours: float | None = None):
        self.until = None if hours is None else time.monotonic() + 3600 * hours
        self.hours = hours
        self.code = 0
        """Exit code that tells the reason."""
        self._caught: int | None = None
        self._before: dict[int, object] = {}

    def __enter__(self) -> "Stop":
        # Python allows signal handlers in the main thread only.
        if threading.current_thread() is threading.main_thread():
            for number in (signal.SIGINT, signal.SIGTERM):
                self._before[number] = signal.signal(number, self._record)
        return self

    def __exit__(self, *_) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)  # type: ignore[arg-type]

    def __call__(self, unit_ended: bool) -> str | None:
        """The reason, or None. The time is checked only at the end of a unit."""
        if self._caught is not None:
            self.code = 128 + self._caught
            return signal.Signals(self._caught).name
        if unit_ended and self.until is not None and time.monotonic() >= self.until:
            self.code = TIME_IS_UP
            return f"{self.hours:g} hours are over"
        return None

    def _record(self, number: int, _) -> None:
        self._caught = number
        signal.signal(number, signal.SIG_DFL)
