"""The bits of a map do not depend on the number of devices, or of processes that share it."""

import os
import pathlib
import signal
import socket
import subprocess
import sys

import pytest
import small

import ikjax
from ikjax.maps.runner import SweepStoppedError

pytest.importorskip("tensorstore")
HERE = pathlib.Path(__file__).parent


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """A folder with the map of one process and one device."""
    out = tmp_path_factory.mktemp("whole") / "map.zarr"
    small.swept(out)
    return out


def start(out, *arguments, devices=1):
    """Processes that share a sweep."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    flags = {"XLA_FLAGS": f"--xla_force_host_platform_device_count={devices}"}
    rest = {"JAX_COMPILATION_CACHE_DIR": str(HERE.parent.parent / ".pytest_cache" / "jax")}
    command = [
        sys.executable,
        str(HERE / "one_of_two.py"),
        str(out),
        f"127.0.0.1:{port}",
        str(len(arguments)),
    ]
    options = {"env": {**os.environ, **flags, **rest}, "text": True}
    options |= {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    return [subprocess.Popen([*command, str(i), *more], **options) for i, more in enumerate(arguments)]


def ends(processes):
    """What each printed, and how it ended."""
    printed = [process.communicate(timeout=120) for process in processes]
    return [
        (process.returncode, out.strip(), err[-2000:])
        for process, (out, err) in zip(processes, printed, strict=True)
    ]


@pytest.mark.parametrize("devices", [2, 4])
def test_more_devices_give_the_same_bits(devices, whole, tmp_path):
    ((code, printed, err),) = ends(start(tmp_path / "map.zarr", [], devices=devices))
    assert code == 0 and printed == "8 0 8 0", err
    assert small.files(tmp_path / "map.zarr") == small.files(whole)


def test_two_processes_share_the_units_and_go_on_with_those_of_one(whole, tmp_path):
    out, asked = tmp_path / "map.zarr", []
    with pytest.raises(SweepStoppedError, match="holds 3 of 8 units"):
        small.swept(out, stop=lambda ended: "tea" if ended and (asked.append(1) or len(asked) == 3) else None)
    for code, printed, err in ends(start(out, [], [])):
        assert code == 0 and printed == "8 3 5 0", err
    assert small.files(out) == small.files(whole) and not (tmp_path / "map.zarr.lock").exists()
    assert small.bits(ikjax.ReachMap.load(out)) == small.bits(ikjax.ReachMap.load(whole))
    log = (tmp_path / "map.zarr.log").read_text()
    assert log.count("complete, ") == 1


def test_a_process_that_stops_stops_the_others_and_one_goes_on(whole, tmp_path):
    out = tmp_path / "map.zarr"
    (code, printed, err), other = ends(start(out, [], ["1"]))
    assert other[0] == 3 and "stopped: tea" in other[1], other
    assert code == 3 and "process 1 ended: SweepStoppedError: stopped: tea" in printed, err
    with pytest.raises(ValueError, match="unfinished"):
        ikjax.ReachMap.load(out)
    assert small.swept(out, resume=True).units.kept >= 1
    assert small.files(out) == small.files(whole)


@pytest.mark.long
def test_a_killed_process_costs_its_unfinished_units_alone(whole, tmp_path):
    out = tmp_path / "map.zarr"
    (code, _, _), other = ends(start(out, [], ["die"]))
    assert other[0] == -signal.SIGKILL and code != 0
    again = ends(start(out, [], [], []))
    assert [end[0] for end in again] == [0, 0, 0], again
    assert int(again[0][1].split()[1]) >= 4  # those of the first, and the second's one
    assert small.files(out) == small.files(whole)


def test_a_sweep_that_cannot_begin_says_so_in_every_process(whole, tmp_path):
    (tmp_path / "map.zarr").write_text("dear")
    for code, _, err in ends(start(tmp_path / "map.zarr", [], [])):
        assert code == 1 and "is left alone" in err
