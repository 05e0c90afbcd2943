"""Sets of positions and orientations are what they say, and sweeps over them count what `solve` answers."""

import dataclasses
import struct

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import small

import ikjax
from ikjax.maps.sets import orientations as turns
from ikjax.maps.sets.integer_angles import about_z
from ikjax.maps.sets.positions import Grid
from ikjax.maps.sets.surface import Surface
from ikjax.maps.statistics import unpacked_mask

ARM = ikjax.robots.ur5()
LIGHT = (
    "reachable", "solutions", "branches", "mask", "reachable_within", "solutions_within", "branches_within",
    "mask_within",
)  # fmt: skip
DOTS = np.ones((2, 3, 3))
REACHED = ("reachable", "reachable_within")
SETS = [turns.Even(1000), ikjax.maps.hopf(0), ikjax.maps.hopf(2), ikjax.maps.cone((1, -2, -0.5), 0.4, 50, 3)]
SETS.append(ikjax.maps.cone((0, 0, -3), np.pi, 64))


def goals_of(reach):
    """Goals (positions, orientations, rolls, 4, 4) of a map."""
    points, rotations = reach.positions.points().reshape(-1, 3), reach.rotations
    rolled = np.stack(
        [np.array(about_z(2 * np.pi * k / reach.free_rolls, np)) for k in range(reach.free_rolls)]
    )
    goals = np.zeros((len(points), len(rotations), reach.free_rolls, 4, 4))
    goals[..., :3, :3] = rotations[:, None] @ rolled
    if isinstance(reach.positions, ikjax.maps.Surface) and reach.positions.frames() is not None:
        goals[..., :3, :3] = reach.positions.frames()[:, None, None] @ goals[..., :3, :3]
    goals[..., :3, 3], goals[..., 3, 3] = points[:, None, None], 1
    return goals


def assert_counts_what_solve_answers(reach):
    names = [name for name in LIGHT[:4] if name in reach.arrays]
    sol = ikjax.solve(reach.arm, goals_of(reach))
    inside = ikjax.within_limits(reach.arm, sol)
    count = reach.positions.count
    for end, solutions in (("", sol), ("_within", inside)):
        valid = np.asarray(solutions.valid)
        arrays = {name: reach.arrays[name + end].reshape(count, -1) for name in names}
        reached = valid.any((-1, -2))
        assert (arrays["reachable"][:, 0] == reached.sum(-1)).all()
        assert 0 < reached.sum() < reached.size
        if len(names) > 1:
            assert (arrays["solutions"][:, 0] == valid.sum((1, 2, 3))).all()
            assert (arrays["branches"] == valid.any(2).sum(1)).all()
            assert (unpacked_mask(arrays["mask"], reach.orientation_count) == reached).all()
            assert (reach.reached((0, 0, 0)) == reach.reached()[0, 0, 0]).all()


@pytest.mark.slow
def test_a_sweep_over_spheres_and_a_hopf_grid_counts_what_solve_answers():
    around = ikjax.maps.shell((0, 0, 0.1), [0.3, 0.55, 0.8], 13)
    assert_counts_what_solve_answers(ikjax.sweep(ARM, around, ikjax.maps.hopf(0), statistics=REACHED))


def test_a_sweep_over_a_surface_sees_orientations_from_its_normals(rng):
    part = ikjax.maps.surface(rng.uniform(-0.7, 0.7, (40, 3)), rng.normal(size=(40, 3)))
    frames = part.frames()
    assert np.allclose(frames[:, :, 2], -part.normals)
    assert np.allclose(np.swapaxes(frames, 1, 2) @ frames, np.eye(3)) and np.linalg.det(frames).min() > 0.99
    reach = ikjax.sweep(ARM, part, ikjax.maps.cone((0, 0, 1), 0.5, 7, turns=3), statistics=REACHED)
    assert_counts_what_solve_answers(reach)
    assert "40 points of a surface" in reach.summary()


@pytest.mark.parametrize("statistics", [REACHED, pytest.param(LIGHT, marks=pytest.mark.slow)])
@pytest.mark.slow
def test_a_free_roll_counts_a_goal_once_if_it_is_reached_at_any(statistics):
    grid = ikjax.maps.grid((-0.5, -0.5, 0.2), (0.6, 0.6, 0.8), 0.3)
    tight = dataclasses.replace(ARM, limits=np.tile([-1.5, 1.5], (6, 1)))
    reach = ikjax.sweep(tight, grid, ikjax.maps.even_rotations(33), free_rolls=5, statistics=statistics)
    assert_counts_what_solve_answers(reach)
    fixed = ikjax.sweep(tight, grid, reach.rotations, statistics=REACHED)
    assert (reach.reachable_within >= fixed.reachable_within).all()
    assert reach.reachable_within.sum() > 1.5 * fixed.reachable_within.sum()
    assert "free to turn (5 tried)" in reach.summary()


def test_statistics_are_the_same_for_more_orientations_than_one_call_takes(monkeypatch):
    upright = ikjax.maps.cone((0, 0, 1), 0, 1, turns=1600)
    options = {"orientations": upright, "statistics": ("solutions_within", "mask", "best_margin")}
    whole = small.swept(**options)
    monkeypatch.setattr("ikjax.maps.kernel.program.TILES", 2)
    monkeypatch.setattr("ikjax.maps.kernel.program._compiled", {})
    parts = small.swept(**options)
    assert whole.arrays["mask"].shape == (8, 8, 2, 50) and whole.solutions_within.max() > 100
    assert small.bits(parts) == small.bits(whole)


@pytest.mark.parametrize("chosen", SETS, ids=lambda chosen: type(chosen).__name__)
def test_a_set_is_made_of_rotations_and_the_same_in_jit(chosen, dtype):
    rotations = chosen.rotations
    assert rotations.shape == (chosen.count, 3, 3)
    assert np.abs(np.swapaxes(rotations, 1, 2) @ rotations - np.eye(3)).max() < 1e-14
    assert np.linalg.det(rotations).min() > 0.999
    index, kind = jnp.arange(chosen.count, dtype=jnp.int32), np.dtype(dtype)
    rows = jax.jit(lambda index: chosen.at((), index, jnp, kind))(index)
    for row, entries in zip(rows, np.moveaxis(rotations, 0, -1), strict=True):
        for made, wanted in zip(row, entries, strict=True):
            assert made.dtype == dtype and np.abs(np.asarray(made) - wanted).max() < 10 * np.finfo(dtype).eps


@pytest.mark.parametrize("level", [0, 1, 2])
def test_a_hopf_grid_is_even_and_finds_the_nearest_of_its_rotations(level, rng):
    grid = ikjax.maps.hopf(level)
    rotations = grid.rotations
    assert (grid.nearest(rotations) == np.arange(72 * 8**level)).all()
    some = ikjax.pose(xyz=np.zeros((2000, 3)), wxyz=_unit(rng.normal(size=(2000, 4))))[:, :3, :3]
    poles = rotations[:50] @ np.diag([1.0, -1.0, -1.0])
    asked = np.concatenate([some, poles, [np.eye(3)], [np.diag([-1.0, -1.0, 1.0])]])
    trace = np.einsum("aij,bij->ab", asked, rotations)
    found = trace[np.arange(len(asked)), grid.nearest(asked)]
    assert np.abs(found - trace.max(1)).max() < 1e-12
    assert np.degrees(np.arccos((found.min() - 1) / 2)) < 62 / 2**level
    axes = rotations[:: grid.turns, :, 2]
    assert len(np.unique(axes.round(9), axis=0)) == 12 * 4**level and np.abs(axes.mean(0)).max() < 1e-15


def _unit(rows):
    return rows / np.linalg.norm(rows, axis=1, keepdims=True)


def test_the_last_rotations_of_the_largest_sets_are_made_exactly():
    for chosen in (ikjax.maps.hopf(8), turns.Even(turns.MOST)):
        index = np.array([0, 1, chosen.count // 3, chosen.count // 2, chosen.count - 1], np.int32)
        wanted = chosen.at((), index, np, np.dtype(float))
        made = jax.jit(lambda index, chosen=chosen: chosen.at((), index, jnp, np.dtype("float32")))(index)
        for row, exact in zip(made, wanted, strict=True):
            assert max(np.abs(np.asarray(a) - b).max() for a, b in zip(row, exact, strict=True)) < 2e-6


def test_a_cone_fills_its_cap_evenly():
    cone = ikjax.maps.cone((0, 3, 4), 0.6, 2000, turns=2)
    rotations = cone.rotations
    cosine = rotations[:, :, 2] @ (0, 0.6, 0.8)
    assert np.arccos(cosine).max() < 0.6
    # Heights are uniform on a sphere, so on a cap too.
    assert np.isclose(cosine.mean(), (1 + np.cos(0.6)) / 2, atol=1e-4)
    assert np.allclose(rotations[1::2] @ np.diag([-1.0, -1.0, 1.0]), rotations[::2])
    straight = ikjax.maps.cone((0, 0, -1), 0, 1).rotations[0]
    assert np.allclose(straight[:, 2], (0, 0, -1), atol=0)
    assert np.abs(straight @ straight.T - np.eye(3)).max() < 1e-15


def test_a_shell_is_made_of_spheres_and_knows_its_volume():
    shell = ikjax.maps.shell((0.1, 0.2, 0.3), [0.5, 0.7, 1.0], 500)
    points = shell.points()
    assert points.shape == (3, 500, 3)
    assert np.allclose(np.linalg.norm(points - shell.center, axis=-1), np.array(shell.radii)[:, None])
    assert np.abs(points.mean(1) - shell.center).max() < 0.01
    assert np.isclose(shell.volume(np.ones(shell.shape, bool)), 4 / 3 * np.pi * (1 - 0.5**3))


def stl(triangles, text: bool) -> bytes:
    if text:
        rows = ["  vertex " + " ".join(map(str, corner)) for t in triangles for corner in t]
        return "\n".join(["solid part", *rows, "endsolid part"]).encode()
    record = b"".join(struct.pack("<12fH", 0, 0, 0, *np.ravel(t), 0) for t in triangles)
    return b"solid but binary".ljust(80) + struct.pack("<I", len(triangles)) + record


@pytest.mark.parametrize("text", [False, True])
def test_a_mesh_gives_middles_and_outer_normals(text, tmp_path):
    flat = [[0, 0, 0], [1, 0, 0], [2, 0, 0]]  # no area, no normal
    triangles = np.array([[[0, 0, 0], [3, 0, 0], [0, 3, 0]], flat, [[0, 0, 0], [0, 0, 3], [0, 3, 0]]], float)
    (tmp_path / "part.STL").write_bytes(stl(triangles, text))
    part = ikjax.maps.surface(tmp_path / "part.STL", scale=0.1)
    assert np.allclose(part.xyz, [[0.1, 0.1, 0], [0, 0.1, 0.1]])
    assert np.allclose(part.normals, [[0, 0, 1], [-1, 0, 0]])
    fine = ikjax.maps.surface(tmp_path / "part.STL", scale=0.1, spacing=0.1)
    assert fine.count > 30 and np.allclose(fine.xyz.mean(0), part.xyz.mean(0))
    gap = np.linalg.norm(fine.xyz[:, None] - fine.xyz, axis=-1) + np.eye(fine.count)
    assert 0.02 < gap.min() < 0.1 and gap.min(1).max() < 0.1


def test_a_table_gives_points_with_or_without_normals(tmp_path):
    (tmp_path / "points.csv").write_text("# x, y, z\n1, 2, 3\n\n4, 5, 6\n")
    part = ikjax.maps.surface(tmp_path / "points.csv")
    assert part == ikjax.maps.surface([[1, 2, 3], [4, 5, 6]]) and part.frames() is None
    (tmp_path / "points.csv").write_text("x,y,z\n1, 2, 3\n4, 5, 6\n")
    assert ikjax.maps.surface(tmp_path / "points.csv") == part
    (tmp_path / "points.csv").write_text("x, Y, z, nx, ny, nz\n1, 2, 3, 0, 0, 2\n")
    assert ikjax.maps.surface(tmp_path / "points.csv") == ikjax.maps.surface([[1, 2, 3]], [[0, 0, 1]])
    (tmp_path / "points.csv").write_text("1, 2, 3, 0, 0, 2\n")
    assert ikjax.maps.surface(tmp_path / "points.csv") == ikjax.maps.surface([[1, 2, 3]], [[0, 0, 1]])


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda path: ikjax.maps.surface(path("a.csv", b"1, x, 3")), "a.csv: no table of numbers"),
        (lambda path: ikjax.maps.surface(path("a.csv", b"1, 2")), "a.csv: must have 3 or 6 columns"),
        (lambda path: ikjax.maps.surface(path("a.csv", b"")), "a.csv: must have 3 or 6 columns"),
        (lambda path: ikjax.maps.surface(path("a.csv", b"\xff\xfe")), "a.csv: no table of numbers"),
        (lambda path: ikjax.maps.surface(path("a.csv", b"1, 2, 1e999")), r"points\[0\] is not finite"),
        (lambda path: ikjax.maps.surface(path("a.obj", b"v 1 2 3")), "read from .csv and .stl"),
        (
            lambda path: ikjax.maps.surface(path("a.stl", b"solid\nvertex 1 2")),
            "neither a binary nor a text STL",
        ),
        (
            lambda path: ikjax.maps.surface(path("a.stl", stl(DOTS, False)[:-1])),
            "neither a binary nor a text STL",
        ),
        (lambda path: ikjax.maps.surface(path("a.stl", stl(DOTS, False))), "no triangle has an area"),
        (
            lambda path: ikjax.maps.surface(path("a.csv", b"1, 2, 3"), [[0, 0, 1]]),
            "normals come from the file",
        ),
        (lambda path: ikjax.maps.surface(np.ones((0, 3))), r"shape \(n, 3\), got \(0, 3\)"),
        (lambda path: ikjax.maps.surface(np.ones((1, 3)), np.zeros((1, 3))), "must have a direction"),
        (lambda path: ikjax.maps.surface(np.ones((2, 3)), spacing=0), "spacing must be a positive"),
        (lambda path: ikjax.maps.surface(np.ones((2, 3)), scale=-1), "scale must be a positive"),
        (lambda path: ikjax.maps.shell((0, 0), 1, 5), r"center must be a point"),
        (lambda path: ikjax.maps.shell((0, 0, 0), [1, 0.5], 5), "radii must ascend"),
        (lambda path: ikjax.maps.shell((0, 0, 0), 0, 5), "radii must be positive"),
        (lambda path: ikjax.maps.shell((0, 0, 0), 1, 0), "directions must be at least 1"),
        (lambda path: ikjax.maps.cone((0, 0, 0), 1, 5), "direction must be a vector"),
        (lambda path: ikjax.maps.cone((0, 0, 1), 4, 5), "half_angle must be from 0 to pi"),
        (lambda path: ikjax.maps.cone((0, 0, 1), 1, 5, turns=0), "turns must be at least 1"),
        (lambda path: ikjax.maps.hopf(9), "level must be a whole number from 0 to 8"),
        (lambda path: ikjax.maps.hopf(1).nearest(np.eye(4)), r"rotations must have shape \(..., 3, 3\)"),
        (lambda path: ikjax.sweep(ARM, ikjax.maps.around(ARM, 1), 2**31), "orientations must be at most"),
        (lambda path: ikjax.sweep(ARM, ikjax.maps.around(ARM, 1), 2**30), "below 2\\^31"),
        (
            lambda path: ikjax.sweep(ARM, ikjax.maps.around(ARM, 1), 5, free_rolls=0),
            "rolls must be a whole number",
        ),
        (lambda path: ikjax.sweep(ARM, np.ones((5, 3)), 5), "positions must be a grid, a shell or a surface"),
        (lambda path: ikjax.sweep(ARM, ikjax.maps.around(ARM, 1), 5, statistics=[]), "got none"),
    ],
)
def test_what_is_no_set_is_refused_by_name(call, message, tmp_path):
    def path(name, data):
        (tmp_path / name).write_bytes(data)
        return tmp_path / name

    with pytest.raises(ValueError, match=message):
        call(path)


def test_a_set_is_as_it_was_given_whatever_becomes_of_the_array():
    points, rotations = np.array([[0.2, 0.0, 0.1]]), np.eye(3)[None].copy()
    surface, listed = Surface(points, points / 0.5), turns.as_orientations(rotations)
    points += 1
    rotations *= -1
    np.testing.assert_array_equal(surface.xyz, [[0.2, 0, 0.1]])
    np.testing.assert_array_equal(listed.rotations, np.eye(3)[None])
    for array in (surface.xyz, surface.normals, listed.rotations):
        with pytest.raises(ValueError, match="read-only"):
            array[:] = 0


def test_a_map_cannot_say_what_a_set_of_another_class_was():
    class Shifted(Grid):
        def axis(self, k):
            return super().axis(k) + 0.1

    class Turned(turns.Even):
        pass

    with pytest.raises(ValueError, match="must be a grid, a shell or a surface, got Shifted"):
        ikjax.sweep(ARM, Shifted((0.0, 0.0, 0.0), 0.1, (2, 2, 2)), 1)
    # Its rotations are kept one by one.
    assert isinstance(turns.as_orientations(Turned(4)), turns.Listed)


def test_a_number_and_even_rotations_are_one_set():
    assert turns.as_orientations(40) == turns.as_orientations(ikjax.maps.even_rotations(40))
    assert np.asarray(ikjax.maps.even_rotations(40)).shape == (40, 3, 3)
