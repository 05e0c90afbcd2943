"""How many CPU cores this process may use, which is often fewer than the machine has.

`usable` is what eager calls choose their number of threads by, and what benchmarks report. In containers and
on clusters the limit is a quota of the process's cgroup, which `os.cpu_count` does not know.

Source: Linux, Documentation/admin-guide/cgroup-v2.rst, "cpu.max"; scheduler/sched-bwc.rst for version 1.
"""

import math
import os
import pathlib

_ROOT = pathlib.Path("/")


def usable(root: pathlib.Path = _ROOT) -> int:
    """CPU cores that this process may run on, at least 1: by its affinity and by the quotas of its cgroups.

    A quota is rounded up, one and a half cores to two: a second thread uses the half.

    Args:
        root: The folder that holds `proc` and `sys`.
    """
    allowed = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return max(1, math.ceil(min(allowed, _quota(root))))


def _quota(root: pathlib.Path) -> float:
    """The least quota, in cores, of the cgroups of this process and all above them; inf without any."""
    try:
        rows = [row.split(":", 2) for row in (root / "proc/self/cgroup").read_text().splitlines()]
    except OSError:
        return math.inf  # not Linux
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
    """The quota of one cgroup, in cores; inf without one."""
    for names in (("cpu.max",), ("cpu.cfs_quota_us", "cpu.cfs_period_us")):
        try:
            words = " ".join((folder / name).read_text() for name in names).split()
            quota, period = int(words[0]), int(words[1])
        except (OSError, ValueError, IndexError):
            continue  # not there, or "max"
        if quota > 0 and period > 0:
            return quota / period
    return math.inf
