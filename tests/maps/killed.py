"""Sweep into folder/K.zarr for every step K asked for, and die by SIGKILL there, in a first run and in one
that goes on with it: `python killed.py FOLDER K K ...`. Prints how each run ended.
"""

import os
import pathlib
import signal
import sys
import time

import jax

ROOT = pathlib.Path(__file__).parent.parent.parent
sys.path[:0] = [str(ROOT), str(pathlib.Path(__file__).parent)]
jax.config.update("jax_enable_x64", True)
jax.config.update("jax_compilation_cache_dir", str(ROOT / ".pytest_cache" / "jax"))
jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)

import small  # noqa: E402

from ikjax.maps.store.storage import Storage  # noqa: E402
from ikjax.maps.store.store import Store  # noqa: E402


def deadly(last: int) -> None:
    """Make the write of that number the last: killed before it if even, after it if odd."""
    count = 0

    def step(write):
        nonlocal count
        count += 1
        if count == last and last % 2 == 0:
            os.kill(os.getpid(), signal.SIGKILL)
        done = write()
        if count == last:
            os.kill(os.getpid(), signal.SIGKILL)
        return done

    def put(store, number, values):
        for name, value in values.items():
            step(lambda n=name, v=value: store.arrays[n][store.box(number)].write(v).result())
        return []

    write, delete = Storage.write, Storage.delete
    Storage.write = lambda storage, *what: step(lambda: write(storage, *what))
    Storage.delete = lambda storage, *what: step(lambda: delete(storage, *what))
    Store.put = put


def run(out: pathlib.Path, last: int, after: float) -> str:
    """How a run in a process of its own ends."""
    child = os.fork()
    if child == 0:
        deadly(last)
        small.swept(out, resume=True)
        os._exit(0)
    if after:
        time.sleep(after)
        os.kill(child, signal.SIGKILL)
    _, status = os.waitpid(child, 0)
    return "killed" if os.WIFSIGNALED(status) else f"ended with {os.waitstatus_to_exitcode(status)}"


if __name__ == "__main__":
    folder = pathlib.Path(sys.argv[1])
    for word in sys.argv[2:]:
        # A whole number is a step, anything else a time in seconds.
        number, after = (int(word), 0.0) if word.isdigit() else (10**9, float(word))
        ends = [run(folder / f"{word}.zarr", number, after), run(folder / f"{word}.zarr", 5 + number % 7, 0)]
        print(word, *ends, sep=",", flush=True)
