"""How many cores this process may use, which is often fewer than the machine has.


Source: Linux, Documentation/admin-guide/cgroup-v2.rst, "cpu.max"; scheduler/sched-bwc.rst for version 1.
"""

import math
import os
import pathlib

_ROOT = pathlib.Path("/")


def usable(root: pathlib.Path = _ROOT) -> int:
    """Cores that this process may run on, at least 1: by its affinity and by the quotas of its cgroups.

    A quota of one and a half cores is two: the rest of a thread's time is lost, but not of the core.

    Args:
        root: Where `proc` and `sys` lie.
    """
    there = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return max(1, math.ceil(min(there, _quota(root))))


def _quota(root: pathlib.Path) -> float:
    """The least number of cores that a cgroup of this process, or one above it, grants; inf without any."""
    try:
        rows = [row.split(":", 2) for row in (root / "proc/self/cgroup").read_text().splitlines()]
    except OSError:
        return math.inf  # no Linux
    least = math.inf
    for _, controllers, own in (row for row in rows if len(row) == 3):
        if controllers and "cpu" not in controllers.split(","):
            continue
        mounts = ("cpu", "cpu,cpuacct", "cpuacct,cpu") if controllers else ("", "unified")
        for mount in mounts:
            top = root / "sys/fs/cgroup" / mount
            # In a container the path may be that of the host, of which only the top is mounted.
            below = top / own.strip("/")
            for folder in (below, *below.parents):
                least = min(least, _granted(folder))
                if folder == top:
                    break
    return least


def _granted(folder: pathlib.Path) -> float:
    """Cores that one cgroup grants."""
    for names in (("cpu.max",), ("cpu.cfs_quota_us", "cpu.cfs_period_us")):
        try:
            words = " ".join((folder / name).read_text() for name in names).split()
            quota, period = int(words[0]), int(words[1])
        except (OSError, ValueError, IndexError):
            continue  # not there, or "max"
        if quota > 0 and period > 0:
            return quota / period
    return math.inf
