"""Stored maps survive whatever interrupts or damages them, and are never wrong."""

import importlib.util
import json
import os
import pathlib
import re
import shutil
import socket
import subprocess
import sys
import warnings

import jax
import numpy as np
import pytest
import small

import ikjax
from ikjax.maps.sets.orientations import Listed
from ikjax.maps.statistics import USUAL, plan
from ikjax.maps.store import lock, manifest
from ikjax.maps.store.storage import Storage, StorageError
from ikjax.maps.store.store import Store
from ikjax.maps.sweep import SweepStoppedError

pytest.importorskip("tensorstore")
HERE = pathlib.Path(__file__).parent


@pytest.fixture(scope="module")
def memory():
    """The bits of the sweep that is stored nowhere."""
    reach = small.swept()
    assert 0 < reach.solutions_within.sum() < reach.solutions.sum()
    return small.bits(reach)


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """A folder with an undisturbed map."""
    out = tmp_path_factory.mktemp("whole") / "map.zarr"
    assert small.swept(out).units == (small.UNITS, 0, small.UNITS, 0)
    return out


@pytest.fixture
def copy(whole, tmp_path):
    return shutil.copytree(whole, tmp_path / "map.zarr")


def assert_whole(out, whole, memory):
    assert small.bits(ikjax.ReachMap.load(out)) == memory
    assert small.files(out) == small.files(whole)


@pytest.mark.parametrize("chunk", [None, (1, 8, 2), (3, 5, 2), (8, 1, 1), (99, 2, 3)])
def test_the_bits_do_not_depend_on_the_chunks_or_the_place(chunk, memory, tmp_path):
    assert small.bits(small.swept(chunk=chunk)) == memory
    assert small.bits(small.swept(tmp_path / "map.zarr", chunk=chunk)) == memory
    assert small.bits(small.swept(f"memory://{tmp_path.name}/map.zarr", chunk=chunk)) == memory


def test_a_finished_map_is_kept_as_it_is_when_gone_on_with(copy, whole, memory):
    before = (copy / manifest.GROUP_KEY).read_bytes()
    assert small.swept(copy, resume=True, chunk=None).units == (small.UNITS, small.UNITS, 0, 0)
    assert (copy / manifest.GROUP_KEY).read_bytes() == before
    assert_whole(copy, whole, memory)


def killed_and_resumed(words, folder, whole, memory):
    """Kill sweeps at the steps and times given, and again while they go on; then go on to the end."""
    command = [sys.executable, str(HERE / "killed.py"), str(folder), *words]
    run = subprocess.run(command, capture_output=True, text=True, env=os.environ)
    assert run.returncode == 0, run.stderr[-2000:]
    ends = [line.split(",") for line in run.stdout.splitlines()]
    assert [end[0] for end in ends] == list(words)
    kept = []
    for word in words:
        units = small.swept(folder / f"{word}.zarr", resume=True).units
        kept.append(units.kept)
        assert units.damaged == 0
        assert_whole(folder / f"{word}.zarr", whole, memory)
        assert not (folder / f"{word}.zarr.lock").exists()
    return ends, kept


def test_a_sweep_killed_at_a_write_goes_on_to_the_same_bits(whole, memory, tmp_path):
    steps = [1, 2, 3, 4, 9, 14, 19, 20, 21, 33, 48, small.STEPS - 2]
    ends, kept = killed_and_resumed([str(step) for step in steps], tmp_path, whole, memory)
    assert [end[1] for end in ends] == ["killed"] * len(steps)
    assert kept[0] < 2 and kept[-1] > 5  # what was written is not computed again


@pytest.mark.long
@pytest.mark.timeout(3600)
def test_two_hundred_kills(whole, memory, tmp_path):
    steps = [str(step) for step in range(1, small.STEPS + 3)]
    times = [f"{t:.4f}" for t in np.linspace(0.15, 0.9, 200 - len(steps))]
    ends, _ = killed_and_resumed(steps + times, tmp_path, whole, memory)
    assert sum(end[1] == "killed" for end in ends) > 150


def damage(path: pathlib.Path, how: str, rng) -> None:
    data = bytearray(path.read_bytes())
    place = int(rng.integers(len(data)))
    if how == "flip":
        data[place] ^= 1 << int(rng.integers(8))
    elif how == "cut":
        del data[place:]
    if how == "delete":
        path.unlink()
    else:
        path.write_bytes(data)


@pytest.mark.parametrize("how", ["flip", "cut", "delete"])
def test_damage_anywhere_is_found_and_mended(how, copy, whole, memory, rng):
    paths = sorted(path.relative_to(whole) for path in whole.rglob("*") if path.is_file())
    documents = [path for path in paths if path.name == "zarr.json"]
    chunks = [path for path in paths if path.name != "zarr.json"]
    for path in [*documents, *rng.permutation(np.array(chunks, object))[:12]]:
        damage(copy / path, how, rng)
        with pytest.raises(ValueError, match=r"map\.zarr"):
            small.bits(ikjax.ReachMap.load(copy))
        units = small.swept(copy, resume=True).units
        if path in chunks and path.parts[0] in USUAL:
            assert units == (8, 7, how == "delete", how != "delete")
        else:
            assert units == (8, 8, 0, 0)
        assert_whole(copy, whole, memory)


@pytest.mark.parametrize("how", ["flip", "cut"])
def test_a_damaged_chunk_at_the_end_of_an_axis_is_mended(how, memory, tmp_path, rng):
    out = tmp_path / "map.zarr"
    small.swept(out, chunk=(5, 5, 2))
    for name in ("c/1/1/0", "c/0/1/0"):
        damage(out / "reachable" / name, how, rng)
    assert small.swept(out, chunk=(5, 5, 2), resume=True).units == (4, 2, 0, 2)
    assert small.bits(ikjax.ReachMap.load(out)) == memory


def test_an_unfinished_map_says_so_and_is_not_swept_over(copy, whole, memory):
    shutil.rmtree(copy / "solutions" / "c" / "0")
    with pytest.raises(ValueError, match=r"unfinished: 4 of 8 units are missing; go on .*--resume"):
        ikjax.ReachMap.load(copy)
    (copy / manifest.GROUP_KEY).write_bytes(manifest.group_document(head_of(copy)._replace(state="sweeping")))
    with pytest.raises(FileExistsError, match=r"an unfinished map; go on with resume=True .*--force"):
        small.swept(copy)
    assert small.swept(copy, resume=True).units == (8, 4, 4, 0)
    assert_whole(copy, whole, memory)


def head_of(out) -> manifest.Head:
    head = manifest.read_group((out / manifest.GROUP_KEY).read_bytes())
    assert head is not None
    return head


def test_another_spec_is_refused_with_both_fingerprints(copy, whole):
    with pytest.raises(ValueError) as caught:
        small.swept(copy, resume=True, dtype="float64", positions=ikjax.maps.grid((0, 0, 0), (1, 1, 1), 0.25))
    message = str(caught.value)
    assert manifest.fingerprint(head_of(whole).spec) in message and message.count("fingerprint") == 1
    assert (
        'dtype: "float32" there, "float64" here' in message
        and "positions.spacing: 0.1 there, 0.25 here" in message
    )
    with pytest.raises(ValueError, match=r"has chunk \(4, 4, 1\), got chunk \(2, 2, 2\)"):
        small.swept(copy, resume=True, chunk=(2, 2, 2))
    assert small.files(copy) == small.files(whole)


def test_a_finished_map_gives_way_to_a_new_one_only_by_force(copy, whole):
    coarse = ikjax.maps.grid((-0.3, -0.3, -0.1), (0.3, 0.3, 0), 0.3)
    for options in ({}, {"positions": coarse}):
        with pytest.raises(FileExistsError, match=r"a finished map; go on with resume=True .*--force"):
            small.swept(copy, **options)
    with pytest.raises(FileExistsError, match=r"a finished map; .*--force"):
        ikjax.ReachMap.load(copy).save(copy)
    with pytest.raises(ValueError, match=r"positions\.spacing: 0.1 there, 0.3 here.*--force"):
        small.swept(copy, positions=coarse, resume=True, chunk=None)
    assert small.files(copy) == small.files(whole)
    assert small.swept(copy, resume=True, force=True).units.kept == small.UNITS
    (copy / "c" / "notes").mkdir(parents=True)
    back = small.swept(copy, positions=coarse, resume=True, force=True)
    assert (copy / "c" / "notes").exists()
    assert small.bits(small.swept(copy, positions=coarse, force=True)) == small.bits(back)
    assert back.positions == coarse and back.units.missing == back.units.total
    assert small.bits(back) == small.bits(small.swept(positions=coarse))
    assert len(list((copy / "reachable" / "c").rglob("*/*/*"))) == back.units.total


def test_a_second_writer_is_refused(copy, whole):
    inner = {}

    def stop(ended):
        if not inner:
            for options in ({"resume": True}, {}):
                with pytest.raises(ValueError, match=r"is being written by process \d+ on this machine"):
                    small.swept(copy, **options)
            inner["tried"] = True

    for chunk in ("0/0/0", "1/1/1"):  # between two units it is always asked
        (copy / "reachable" / "c" / chunk).unlink()
    small.swept(copy, resume=True, stop=stop)
    assert inner and small.files(copy) == small.files(whole)


def test_a_sweep_that_is_told_to_stop_keeps_its_units(tmp_path, whole, memory):
    out = tmp_path / "map.zarr"
    ends = []
    with pytest.raises(
        SweepStoppedError, match=r"stopped: tea; .* holds 3 of 8 units; go on with resume=True"
    ):
        small.swept(out, stop=lambda ended: "tea" if ended and (ends.append(1) or len(ends) == 3) else None)
    assert not (tmp_path / "map.zarr.lock").exists()
    assert small.swept(out, resume=True).units == (8, 3, 5, 0)
    assert_whole(out, whole, memory)


def test_a_full_disk_is_named_and_leaves_earlier_units_whole(tmp_path, whole, memory):
    # A limit on the size of a file is what a full disk looks like to a write: part of it arrives.
    code = f"""
import resource, signal, sys
sys.path[:0] = [{str(HERE.parent.parent)!r}, {str(HERE)!r}]
import small
from ikjax.maps.store.store import Store
whole = Store.put
def put(store, number, values):
    if number == 4:
        resource.setrlimit(resource.RLIMIT_FSIZE, (50, resource.RLIM_INFINITY))
    return whole(store, number, values)
Store.put = put
small.swept({str(tmp_path / "map.zarr")!r})
"""
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert run.returncode == 1 and "File too large" in run.stderr
    last = run.stderr.strip().splitlines()[-1]
    # Two units may be on their way when the disk fills.
    assert last.startswith("ikjax.maps.store.storage.StorageError") and "cannot write unit" in last
    units = small.swept(tmp_path / "map.zarr", resume=True).units
    assert units.damaged == 0 and 2 <= units.kept <= 4
    assert_whole(tmp_path / "map.zarr", whole, memory)


@pytest.fixture
def mounted(tmp_path):
    """A file system of its own, and a way to mount it anew with other options."""
    folder = tmp_path / "disk"
    folder.mkdir()

    def mount(options):
        return subprocess.run(
            ["mount", "-t", "tmpfs", "-o", options, "tmpfs", str(folder)], capture_output=True
        )

    # Room for the documents and some of the units, a page for each file.
    if shutil.which("mount") is None or mount("size=160k").returncode:
        pytest.skip("only who may mount can fill a disk")
    yield folder, lambda options: mount(f"remount,{options}").check_returncode()
    subprocess.run(["umount", str(folder)], check=True)


def test_a_disk_that_is_full_is_named_and_gone_on_with_when_there_is_room(mounted, whole, memory):
    folder, mount = mounted
    with pytest.raises(StorageError, match="No space left on device"):
        small.swept(folder / "map.zarr")
    with pytest.raises(ValueError, match="unfinished"):
        ikjax.ReachMap.load(folder / "map.zarr")
    with pytest.raises(StorageError, match="No space left on device"):
        small.swept(folder / "map.zarr", resume=True)
    mount("size=4m")
    units = small.swept(folder / "map.zarr", resume=True).units
    assert 0 < units.kept < small.UNITS and units.damaged == 0
    assert_whole(folder / "map.zarr", whole, memory)


def test_a_folder_that_is_read_only_is_named_and_a_map_in_it_is_read(mounted, whole, memory):
    folder, mount = mounted
    mount("size=4m")
    shutil.copytree(whole, folder / "map.zarr")
    mount("ro")
    for out, options in (("map.zarr", {"resume": True}), ("map.zarr", {"force": True}), ("new.zarr", {})):
        with pytest.raises(StorageError, match=r"cannot write .*zarr\.lock: .*Read-only file system"):
            small.swept(folder / out, **options)
    assert_whole(folder / "map.zarr", whole, memory)


def test_a_lock_that_is_taken_away_while_its_holder_is_found_dead_is_not_held(tmp_path, monkeypatch):
    path = tmp_path / "map.zarr.lock"
    path.write_bytes(json.dumps({"pid": 2**22 + 1, "host": socket.gethostname(), "began": "1"}).encode())
    refuse = lock._refuse_live_holder

    def ended(storage, holder, where):
        monkeypatch.setattr(lock, "_refuse_live_holder", refuse)
        path.unlink()
        refuse(storage, holder, where)

    monkeypatch.setattr(lock, "_refuse_live_holder", ended)
    storage = Storage(tmp_path / "map.zarr")
    wanted = pytest.raises(ValueError, match="is being written by process")
    with lock.Lock(storage), wanted, lock.Lock(storage):
        pass
    assert not path.exists()


def test_of_many_who_find_a_dead_writers_lock_one_takes_it(tmp_path):
    code = f"""
import json, os, sys, time
sys.path.insert(0, {str(HERE.parent.parent)!r})
from ikjax.maps.store.lock import Lock, _own_identity
from ikjax.maps.store.storage import Storage
storage = Storage(sys.argv[1])
lock = Lock(storage)
for trial in range(10):
    dead = json.loads(_own_identity()) | {{"began": "1"}}
    # Some find what a writer left that died before it had said who it was.
    lock.file.write_bytes(json.dumps(dead).encode() if trial % 5 else b"")
    go, tell = time.time() + 0.03, os.pipe()
    children = []
    for _ in range(8):
        children.append(os.fork())
        if not children[-1]:
            while time.time() < go:
                pass
            try:
                with Lock(storage):
                    inside = os.open(sys.argv[1] + ".inside", os.O_CREAT | os.O_EXCL)
                    time.sleep(0.02)
                    os.unlink(sys.argv[1] + ".inside")
                    os.write(tell[1], b"w")
            except FileExistsError:
                os.write(tell[1], b"!")
            except ValueError as error:
                os.write(tell[1], b"l" if "being written by process" in str(error) else b"?")
            os._exit(0)
    for child in children:
        os.waitpid(child, 0)
    print("".join(sorted(os.read(tell[0], 100).decode())), lock.file.exists())
"""
    run = subprocess.run(
        [sys.executable, "-c", code, str(tmp_path / "map.zarr")], capture_output=True, text=True
    )
    # Who comes late may find the lock free again; two at once never hold it.
    rows = run.stdout.splitlines()
    assert len(rows) == 10 and all(re.fullmatch("l*w+ False", row) for row in rows), run.stdout + run.stderr
    assert "l" in run.stdout


def test_a_slow_arm_gets_small_units_and_calls_and_the_same_bits(memory, monkeypatch):
    from ikjax.maps.kernel.program import Kernel

    tune_calls, seen = Kernel.tune_calls, []

    def slow(kernel, seconds):
        tune_calls(kernel, 0.0)
        seen.append((kernel.blocks, kernel.tiles))
        return 10.0

    monkeypatch.setattr(Kernel, "tune_calls", slow)
    asked = []
    assert (
        small.bits(small.swept(chunk=None, stop=lambda ended: asked.append(ended) if ended else None))
        == memory
    )
    # 48 orientations at ten goals a second: a position takes five seconds, so a unit has eight.
    assert seen == [(1, 1)] and len(asked) == 128 // 8 - 1
    assert manifest.default_chunk((100, 100, 100), 1000, 2000.0) == (1, 1, 2)
    assert manifest.default_chunk((3, 10**6), 32) == (3, 2**19) and manifest.default_chunk((10**7,), 2) == (
        2**21,
    )


def test_a_storage_that_cannot_be_written_is_named(tmp_path):
    # Whoever runs this may write anywhere, so a file stands where a folder is wanted.
    (tmp_path / "file").write_text("dear")
    with pytest.raises(StorageError, match=r"cannot write .*file/map\.zarr\.lock"):
        small.swept(tmp_path / "file" / "map.zarr")
    with pytest.raises(FileExistsError, match="is left alone"):
        small.swept(tmp_path / "file")
    assert (tmp_path / "file").read_text() == "dear"
    with pytest.raises(ValueError, match="no place that tensorstore can open"):
        small.swept("carrier-pigeon://map")


def test_an_error_of_the_store_ends_a_sweep_that_can_go_on(monkeypatch, tmp_path, whole, memory):
    put = Store.put

    def failing(store, number, values):
        futures = put(store, number, values)

        class Failed:
            def result(self):
                raise ValueError("RESOURCE_EXHAUSTED: No space left on device")

        return [*futures, Failed()] if number == 2 else futures

    with monkeypatch.context() as patch:
        patch.setattr(Store, "put", failing)
        with pytest.raises(StorageError, match="unit 3 of 8: RESOURCE_EXHAUSTED: No space left on device"):
            small.swept(tmp_path / "map.zarr")
    small.swept(tmp_path / "map.zarr", resume=True)
    assert_whole(tmp_path / "map.zarr", whole, memory)


def test_a_stored_map_is_read_when_it_is_asked_for(copy, memory):
    reach = ikjax.ReachMap.load(copy)
    shape = reach.positions.shape
    data = np.frombuffer(memory["solutions"], np.int32).reshape(shape)
    (copy / "solutions" / "c" / "1" / "1" / "1").write_bytes(b"")
    assert (reach.arrays["solutions"][:4, 2] == data[:4, 2]).all()
    with pytest.raises(ValueError, match="solutions is damaged"):
        reach.solutions  # noqa: B018


def test_the_arm_in_a_map_is_the_arm_that_was_given(tmp_path):
    arm = ikjax.robots.ur5()
    reach = ikjax.sweep(arm, ikjax.maps.around(arm, 0.5), 4, dtype="float32", out=tmp_path / "map.zarr")
    assert np.array_equal(reach.arm.alpha, arm.alpha) and reach.arm.dtype == arm.dtype


def test_a_map_becomes_a_dataset_or_says_what_to_install(copy, memory):
    reach = ikjax.ReachMap.load(copy)
    if importlib.util.find_spec("xarray") is None:
        with pytest.raises(ImportError, match=r"pip install 'ikjax\[xarray\]'"):
            reach.to_xarray()
        return
    data = reach.to_xarray()
    assert {name: data[name].values.tobytes() for name in USUAL} == memory
    assert data.sizes == {"x": 8, "y": 8, "z": 2} and np.array_equal(data.x, reach.positions.axis(0))
    assert data.attrs["orientations"] == 48


@pytest.mark.parametrize("name", ["zarr", "xarray"])
def test_a_stored_map_opens_in_other_readers(name, copy, memory):
    reader = pytest.importorskip(name)
    pytest.importorskip("zarr")
    data = reader.open_group(copy, mode="r") if name == "zarr" else reader.open_zarr(copy, consolidated=False)
    assert {key: np.asarray(data[key]).tobytes() for key in USUAL} == memory


def test_a_map_without_the_margin(tmp_path, memory):
    reach = small.swept(tmp_path / "map.zarr", statistics=USUAL[:4])
    assert small.bits(reach) == {name: memory[name] for name in USUAL[:4]}
    assert reach.summary() and not (tmp_path / "map.zarr" / "best_margin").exists()
    with pytest.raises(ValueError, match="made without best_margin"):
        reach.best_margin  # noqa: B018
    with pytest.raises(ValueError, match=r"statistics must be some of reachable, .*, got height"):
        small.swept(statistics=["height"])


def test_an_arm_in_a_map_keeps_its_coupling_and_correction(tmp_path, rng):
    correction = np.zeros((5, 6))
    correction[1] = 1e-4 * rng.normal(size=6)
    arm = ikjax.Arm.from_dh(
        a=[0.3, 0.2, 0, 0], alpha=[0, 0, 0, 0], d=[0.1, 0, 0, 0], kinds="RRPR", convention="standard",
        coupling=np.eye(4) + np.eye(4, k=1), correction=correction,
    )  # fmt: skip
    back = manifest.arm_from_spec(manifest.arm_spec(arm))
    assert np.array_equal(back.coupling, arm.coupling) and np.array_equal(back.correction, arm.correction)
    assert manifest.arm_spec(back) == manifest.arm_spec(arm)
    plain = manifest.arm_spec(ikjax.robots.gx4_351s())
    assert manifest.fingerprint(plain) != manifest.fingerprint({**plain, "coupling": np.eye(4).tolist()})


def test_a_spec_does_not_depend_on_the_type_that_an_arm_comes_in():
    arm = ikjax.robots.puma560()
    around, turns = ikjax.maps.around(arm, 1), Listed(np.eye(3)[None])
    rest = around, turns, 1, "float32", plan(arm, USUAL, 1).specs(), {}, 0.0
    spec, _ = manifest.describe(ikjax.ReachMap(arm, *rest))
    assert spec == manifest.describe(ikjax.ReachMap(arm.astype(np.float32), *rest))[0]
    assert spec["arm"]["a"][1] == 0.4318
    back = manifest.arm_from_spec(spec["arm"])
    assert back.dtype == np.float32 and back.family == arm.family
    assert np.array_equal(back.alpha, arm.astype(np.float32).alpha)


def test_default_chunks_are_about_a_second_of_work():
    for orientations in (1, 48, 512, 10**4, 10**7):
        for shape in ((71, 71, 71), (2000, 2000, 2000), (3, 500, 1)):
            chunk = manifest.default_chunk(shape, orientations)
            assert all(1 <= edge <= size for edge, size in zip(chunk, shape, strict=True))
            assert np.prod(chunk) * orientations <= max(manifest.UNIT_GOALS * 1.01, 512 * orientations)


def test_keys_beside_a_storage_are_not_in_it(tmp_path):
    Storage(tmp_path / "map.zarr.old").write("a", b"1")
    assert Storage(tmp_path / "map.zarr").keys() == set()


def test_an_arm_is_stored_as_it_is_and_read_in_silence():
    """Also one whose rounded twist would be made exact if its table were built anew."""
    table = {"a": [0.3, 0.2, 0.4], "alpha": [np.pi / 2, 0.7, 0.3], "d": [0.1, 0.2, 0.1], "kinds": "RPR"}
    arm = ikjax.Arm.from_dh(**table, convention="standard").astype(np.float32)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        back = manifest.arm_from_spec(manifest.arm_spec(arm))
    for one, other in zip(jax.tree.leaves(back), jax.tree.leaves(arm), strict=True):
        np.testing.assert_array_equal(one, other)
    assert back.signs == arm.signs and back.correction is None
