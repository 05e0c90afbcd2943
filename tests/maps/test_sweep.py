"""Sweeps count what `solve` answers, goal by goal, and maps come back from disk as they went."""

import dataclasses
import json

import numpy as np
import pytest

import ikjax
from ikjax.maps.store import manifest


@pytest.fixture(scope="module")
def arm():
    return ikjax.robots.ur5()


@pytest.fixture(scope="module")
def reach(arm):
    # 45 orientations do not fill a tile, 7 x 7 x 7 positions do not fill a block.
    return ikjax.sweep(arm, ikjax.maps.around(arm, 0.4), 45, dtype="float64")


@pytest.mark.parametrize(
    "name", ["puma560", *(pytest.param(name, marks=pytest.mark.slow) for name in ("ur5", "kr6_r900"))]
)
def test_a_sweep_counts_what_solve_answers(name):
    arm = ikjax.robots.get(name)
    reach = ikjax.sweep(arm, ikjax.maps.around(arm, 0.4), 45, dtype="float64")
    goals = np.zeros((*reach.positions.shape, 45, 4, 4))
    goals[..., :3, :3], goals[..., 3, 3] = reach.rotations, 1
    goals[..., :3, 3] = reach.positions.points()[..., None, :]
    sol = ikjax.solve(arm, goals)
    inside = ikjax.within_limits(arm, sol)
    assert (reach.reachable == np.asarray(sol.valid).any(-1).sum(-1)).all()
    assert (reach.solutions == np.asarray(sol.valid).sum((-1, -2))).all()
    assert (reach.reachable_within == np.asarray(inside.valid).any(-1).sum(-1)).all()
    assert (reach.solutions_within == np.asarray(inside.valid).sum((-1, -2))).all()
    assert np.allclose(reach.best_margin, np.asarray(sol.margin).max((-1, -2)), atol=1e-6)
    assert 0 < reach.reachable.sum() < reach.goals and reach.solutions.max() > 8


def test_limits_of_every_width_are_told_by_sines_and_cosines(rng):
    arm = ikjax.robots.puma560()
    for widths in ([7.0, 4.0, 7.0, 6.2, 7.0, 0.5], [3.0, 7.0, 4.0, 7.0, 3.0, 7.0]):
        lower = rng.uniform(-4, 4, 6)
        tight = dataclasses.replace(arm, limits=np.stack([lower, lower + widths], -1))
        reach = ikjax.sweep(tight, ikjax.maps.grid((0.3, 0, 0), (0.6, 0.3, 0.3), 0.1), 40, dtype="float64")
        goals = np.zeros((*reach.positions.shape, 40, 4, 4))
        goals[..., :3, :3], goals[..., 3, 3] = reach.rotations, 1
        goals[..., :3, 3] = reach.positions.points()[..., None, :]
        inside = ikjax.within_limits(tight, ikjax.solve(tight, goals))
        assert (reach.solutions_within == np.asarray(inside.valid).sum((-1, -2))).all()
        assert 0 < reach.solutions_within.sum() < reach.solutions.sum() / 2


def test_a_map_comes_back_from_disk_as_it_went(reach, tmp_path):
    pytest.importorskip("tensorstore")
    reach.save(tmp_path / "map.zarr")
    back = ikjax.ReachMap.load(tmp_path / "map.zarr")
    for name in (
        "reachable",
        "solutions",
        "reachable_within",
        "solutions_within",
        "best_margin",
        "rotations",
    ):
        assert np.array_equal(getattr(back, name), getattr(reach, name))
    assert back.summary() == reach.summary() and back.positions == reach.positions
    assert str(back.arm) == str(reach.arm) and back.arm.family == reach.arm.family


def test_a_damaged_map_is_refused_never_read(reach, tmp_path):
    pytest.importorskip("tensorstore")
    path = tmp_path / "map.zarr"
    chunk = path / "reachable" / "c" / "0" / "0" / "0"
    reach.save(path)
    data = bytearray(chunk.read_bytes())
    data[7] ^= 1
    chunk.write_bytes(data)
    with pytest.raises(ValueError, match="reachable is damaged"):
        ikjax.ReachMap.load(path).summary()
    chunk.unlink()
    with pytest.raises(ValueError, match="1 of 1 units are missing"):
        ikjax.ReachMap.load(path)


def test_a_map_of_another_schema_or_changed_by_hand_is_refused(reach, tmp_path):
    pytest.importorskip("tensorstore")
    path = tmp_path / "map.zarr"
    reach.save(path)
    group = json.loads((path / "zarr.json").read_text())
    group["attributes"]["spec"]["positions"]["spacing"] = 0.1
    (path / "zarr.json").write_text(json.dumps(group))
    with pytest.raises(ValueError, match="changed by hand or damaged"):
        ikjax.ReachMap.load(path)
    group["attributes"]["ikjax_schema"] = manifest.SCHEMA + 1
    (path / "zarr.json").write_text(json.dumps(group))
    with pytest.raises(ValueError, match=r"has schema 5, this version reads schema 4"):
        ikjax.ReachMap.load(path)


def test_saving_leaves_a_folder_that_is_no_map_alone(reach, tmp_path):
    pytest.importorskip("tensorstore")
    (tmp_path / "thesis.tex").write_text("years of work")
    with pytest.raises(FileExistsError, match="is no map"):
        reach.save(tmp_path)
    assert (tmp_path / "thesis.tex").exists()


def test_even_rotations_are_rotations_and_even():
    rotations = ikjax.maps.even_rotations(1000).rotations
    gap = np.swapaxes(rotations, 1, 2) @ rotations - np.eye(3)
    assert np.abs(gap).max() < 1e-14 and np.linalg.det(rotations).min() > 0.999
    # The nearest neighbor of each: random ones come as close as 2 degrees, even ones do not.
    cosine = (np.einsum("aij,bij->ab", rotations, rotations) - 1) / 2
    np.fill_diagonal(cosine, -1)
    assert np.degrees(np.arccos(cosine.max(1))).min() > 8
    assert np.abs(rotations.mean(0)).max() < 0.01


def test_a_grid_fills_its_box_and_is_centered():
    grid = ikjax.maps.grid((0, 0, 0), (1, 0.55, 0), 0.25)
    assert grid.shape == (5, 3, 1) and grid.count == 15
    assert np.allclose(grid.points()[0, 0, 0], (0, 0.025, 0))
    assert np.allclose(grid.points()[-1, -1, -1], (1, 0.525, 0))


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda arm: ikjax.maps.grid((0, 0), (1, 1), 0.1), r"shape \(3,\), got \(2,\)"),
        (lambda arm: ikjax.maps.grid((1, 0, 0), (0, 1, 1), 0.1), "lower must not exceed upper"),
        (lambda arm: ikjax.sweep(arm, ikjax.maps.around(arm, 1), np.ones((2, 3))), r"rotations \(m, 3, 3\)"),
        (
            lambda arm: ikjax.sweep(arm, ikjax.maps.around(arm, 1), -np.eye(3)[None]),
            r"orientations\[0\] must be",
        ),
        (lambda arm: ikjax.sweep(arm, ikjax.maps.around(arm, 1), 5, dtype="float16"), "float32 or float64"),
    ],
)
def test_bad_sweeps_are_refused_by_name(arm, call, message):
    with pytest.raises(ValueError, match=message):
        call(arm)
