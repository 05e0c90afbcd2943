"""One of several processes that share the small sweep: `python one_of_two.py OUT COORDINATOR N I [UNITS]`.

With UNITS it stops after so many of its own; with "die" it is killed by SIGKILL after its first.
"""

import os
import pathlib
import signal
import sys

import jax

ROOT = pathlib.Path(__file__).parent.parent.parent
sys.path[:0] = [str(ROOT), str(pathlib.Path(__file__).parent)]
jax.config.update("jax_enable_x64", True)

import small  # noqa: E402

if __name__ == "__main__":
    out, coordinator, count, index, *units = sys.argv[1:]
    jax.distributed.initialize(coordinator, int(count), int(index), heartbeat_timeout_seconds=10)
    ended = []

    def stop(is_unit):
        ended.extend([1] * is_unit)
        if units == ["die"] and ended:
            os.kill(os.getpid(), signal.SIGKILL)
        return "tea" if units and len(ended) >= int(units[0]) else None

    try:
        print(*small.swept(out, resume=True, stop=stop).units)
    except small.SweepStoppedError as stopped:
        print(stopped)
        sys.exit(3)
