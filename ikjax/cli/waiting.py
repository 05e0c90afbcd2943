"""One line for a person who waits: a first call compiles, and nothing else is seen of that."""

import contextlib
import sys
import threading
from collections.abc import Iterator

PATIENCE = 2.0
"""[s]"""


@contextlib.contextmanager
def saying_so_when_it_takes_long(wanted: bool, patience: float = PATIENCE) -> Iterator[None]:
    """Within this context, a line on stderr once that much time has passed; only for a terminal.

    Args:
        wanted: Whether people read the output.
        patience: [s]
    """
    if not (wanted and sys.stderr.isatty()):
        yield
        return
    done = threading.Event()

    def say() -> None:
        if not done.wait(patience):
            text = "at work; a program that is new is compiled first, and kept for the next time"
            print(f"ikjax: {text}", file=sys.stderr, flush=True)

    thread = threading.Thread(target=say, daemon=True)
    thread.start()
    try:
        yield
    finally:
        done.set()
        thread.join()
