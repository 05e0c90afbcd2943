"""No more threads than the process may use: by its affinity, and by the quotas of its control groups."""

import os
import subprocess
import sys

import pytest

from ikjax.core import cores


def machine(root, groups, files):
    for name, text in {"proc/self/cgroup": groups, **files}.items():
        path = root / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    return root


V2 = "sys/fs/cgroup"
V1 = "sys/fs/cgroup/cpu,cpuacct"


@pytest.mark.parametrize(
    "groups, files, granted",
    [
        ("0::/\n", {f"{V2}/cpu.max": "300000 100000\n"}, 3),
        ("0::/\n", {f"{V2}/cpu.max": "150000 100000\n"}, 2),
        ("0::/\n", {f"{V2}/cpu.max": "5000 100000\n"}, 1),
        ("0::/\n", {f"{V2}/cpu.max": "max 100000\n"}, 64),
        ("0::/\n", {f"{V2}/cpu.max": "garbage"}, 64),
        ("0::/\n", {}, 64),
        ("no cgroup\n", {}, 64),
        # The group of the job above this one grants less.
        (
            "0::/job/step\n",
            {f"{V2}/job/step/cpu.max": "800000 100000", f"{V2}/job/cpu.max": "400000 100000"},
            4,
        ),
        # The path is that of the host, and the container's own group is mounted on top.
        ("0::/docker/abc\n", {f"{V2}/cpu.max": "200000 100000"}, 2),
        (
            "9:memory:/a\n4:cpuset:/a\n2:cpu,cpuacct:/a\n",
            {f"{V1}/a/cpu.cfs_quota_us": "250000\n", f"{V1}/a/cpu.cfs_period_us": "50000\n"},
            5,
        ),
        (
            "2:cpu,cpuacct:/a\n",
            {f"{V1}/a/cpu.cfs_quota_us": "-1\n", f"{V1}/a/cpu.cfs_period_us": "100000\n"},
            64,
        ),
        ("1:cpu:/\n", {"sys/fs/cgroup/cpu/cpu.cfs_quota_us": "100000"}, 64),
    ],
)
def test_a_quota_counts_wherever_it_stands(tmp_path, monkeypatch, groups, files, granted):
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: set(range(64)), raising=False)
    assert cores.usable(machine(tmp_path, groups, files)) == granted


def test_affinity_counts_and_so_does_a_system_that_has_none(tmp_path, monkeypatch):
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {3, 5}, raising=False)
    assert cores.usable(tmp_path) == 2
    monkeypatch.delattr(os, "sched_getaffinity")
    monkeypatch.setattr(os, "cpu_count", lambda: None)
    assert cores.usable(tmp_path) == 1


@pytest.mark.skipif(not hasattr(os, "sched_setaffinity"), reason="no affinity here")
def test_the_library_has_as_many_threads_as_it_may_use():
    one = "import os; os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[:1])"
    ask = f"{one}; from ikjax.ik.batched import THREADS, pool; assert THREADS == pool()._max_workers == 1"
    path = {**os.environ, "PYTHONPATH": os.pathsep.join(map(os.path.abspath, filter(None, sys.path)))}
    subprocess.run([sys.executable, "-c", ask], check=True, env=path)
