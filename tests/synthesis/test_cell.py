"""A base among regions, boxes and parts, on a rail, and goals that may be met in several ways."""

import dataclasses
from typing import ClassVar

import jax
import numpy as np
import pytest

import ikjax
from ikjax.synthesis.allowed import allowed
from ikjax.synthesis.alternatives import checked_alternatives

ARM = ikjax.robots.planar_2r(0.6, 0.3)
SCARA = ikjax.robots.gx4_351s()


def ring(center=(2.0, -1.0), count=12, radius=0.6):
    turn = np.linspace(0, 6, count)
    return np.asarray(
        ikjax.position(center[0] + radius * np.cos(turn), center[1] + radius * np.sin(turn), 0 * turn)
    )


def reached_by_hand(arm, base, goals, alternatives):
    there = dataclasses.replace(arm, base=base)
    turned = goals[:, None] @ (np.eye(4)[None] if alternatives is None else alternatives)
    sol = ikjax.within_limits(there, ikjax.solve(there, turned.astype(arm.dtype)))
    return np.asarray(sol.valid).any((-1, -2))


QUICK = {"steps": 10, "starts": 3, "spacing": 0.1}


@pytest.mark.slow
def test_a_base_stays_out_of_boxes_and_away_from_parts():
    """The best place is the middle of the ring, which is taken."""
    goals = ring()
    box = np.array([[1.8, -1.2, -1], [2.2, -0.8, 1]])
    free = ikjax.place(ARM, goals, **QUICK)
    assert np.abs(free.base[0][:2, 3] - (2, -1)).max() < 0.1
    bases = ikjax.place(ARM, goals, keep_out=box, clearance=0.05, **QUICK)
    for base in bases.base:
        off = np.maximum(np.maximum(box[0] - base[:3, 3], base[:3, 3] - box[1]), 0)
        assert np.linalg.norm(off) >= 0.05 - 1e-9
    np.testing.assert_array_equal(bases.reached[0], reached_by_hand(ARM, bases.base[0], goals, None))
    away = ikjax.place(ARM, goals, parts=np.array([[2.0, -1.0, 0.0]]), clearance=0.25, **QUICK)
    gaps = np.linalg.norm(away.base[:, :3, 3] - (2, -1, 0), axis=-1)
    assert (gaps >= 0.25 - 1e-6).all() and (bases.tried == 0).any()


def test_one_of_several_regions_holds_the_base():
    goals = ring()
    regions = [{"x": (1.0, 1.4), "y": (-1.2, -0.8)}, {"x": (2.5, 2.9), "y": (-1.5, -1.3)}]
    bases = ikjax.place(ARM, goals, bounds=regions, keep=4, **QUICK)

    def holds(base, region):
        return all(low - 1e-6 <= base["xyz".index(k), 3] <= high + 1e-6 for k, (low, high) in region.items())

    assert all(any(holds(base, region) for region in regions) for base in bases.base)
    with pytest.raises(ValueError, match="bounds of several regions are of x, y and z"):
        ikjax.place(ARM, goals, bounds=[{"turn": (0, 1)}])


def test_a_base_moves_along_a_rail_alone():
    goals = ring(center=(1.0, 1.0))
    rail = np.array([[0.0, 0.0, 0.0], [2.0, 2.0, 0.0]])
    bases = ikjax.place(ARM, goals, move=["rail"], rail=rail, **QUICK)
    at = bases.base[0][:3, 3]
    assert abs(at[0] - at[1]) < 1e-6 and np.abs(at[:2] - 1).max() < 0.1 and bases.share[0] == 1
    np.testing.assert_allclose(bases.base[0][:3, :3], np.eye(3), atol=1e-9)
    np.testing.assert_array_equal(bases.reached[0], reached_by_hand(ARM, bases.base[0], goals, None))
    for words, says in (
        ({"move": ["rail"]}, "go together"),
        ({"move": ["rail", "x"], "rail": rail}, "stands for x, y and z"),
        ({"move": ["rail"], "rail": [[0, 0, 0], [0, 0, 1]]}, "must be level"),
    ):
        with pytest.raises(ValueError, match=says):
            ikjax.place(ARM, goals, **words)


@pytest.mark.slow
def test_a_goal_with_a_free_roll_counts_once():
    """A SCARA whose last joint turns by little reaches few rolls, and with a free roll all of them."""
    limits = np.array(SCARA.limits)
    limits[3] = -0.3, 0.3
    arm = dataclasses.replace(SCARA, limits=limits)
    angles = np.linspace(0, 2 * np.pi, 8, endpoint=False)
    zero = 0 * angles
    xyz = np.stack([0.25 + 0.02 * np.cos(3 * angles), 0.1 * np.sin(angles), zero - 0.05], -1)
    goals = np.asarray(ikjax.pose(xyz, rpy=np.stack([zero, zero, angles], -1)))
    options = {"move": ["x", "y"], "bounds": {"x": (-0.1, 0.1), "y": (-0.1, 0.1)}, **QUICK}
    options |= {"spacing": 0.05, "steps": 0}
    tight = ikjax.place(arm, goals, **options)
    free = ikjax.place(arm, goals, free_rolls=12, **options)
    assert tight.share[0] < 1 and free.share[0] == 1 and free.reached.shape[1:] == (8,)
    others = checked_alternatives(12, None)
    np.testing.assert_array_equal(free.reached[0], reached_by_hand(arm, free.base[0], goals, others))
    there = dataclasses.replace(arm, base=free.base[-1])
    grid = free.grid.points().reshape(-1, 3)
    k = len(grid) // 3
    moved = np.array(arm.base)
    moved[:3, 3] = grid[k]
    by_hand = reached_by_hand(arm, moved, goals, others).mean()
    assert free.tried.reshape(len(grid), -1)[k, 0] == pytest.approx(by_hand)
    assert there.family == arm.family


@pytest.mark.slow
def test_a_design_counts_a_goal_with_a_free_roll_once():
    limits = np.array(SCARA.limits)
    limits[3] = -1.0, 1.0
    arm = dataclasses.replace(SCARA, limits=limits)
    angles = np.linspace(0, 2 * np.pi, 6, endpoint=False)
    zero = 0 * angles
    goals = np.asarray(
        ikjax.pose(np.stack([0.25 + zero, zero, zero - 0.05], -1), rpy=np.stack([zero, zero, angles], -1))
    )
    vary = {"base.x": (-0.05, 0.05)}
    one, four = (ikjax.design(arm, goals, vary, starts=2, steps=2, free_rolls=k).reached for k in (1, 4))
    assert one.sum() < four.sum() == 6 and four.size == 6


@pytest.mark.slow
def test_a_cone_and_a_point_alone_are_alternatives():
    """Of a SCARA's goals that lean, some alternative stands upright."""
    xyz = np.array([[0.25, 0.1, -0.05], [0.2, -0.1, -0.05]])
    goals = np.asarray(ikjax.pose(xyz, rpy=np.zeros((2, 3))))
    options = {"move": ["x"], "bounds": {"x": (-0.1, 0.1)}, "spacing": 0.1, "starts": 2, "steps": 0}
    turned = np.asarray(ikjax.pose(rpy=np.array([[0.5, 0, 0], [0, 0, 2.0], [0, 0, 4.0]])))[:, :3, :3]
    for alternatives in (ikjax.maps.cone((0, 0, 1), 0.0, 1), turned):
        found = ikjax.place(SCARA, goals, alternatives=alternatives, **options)
        others = checked_alternatives(1, alternatives)
        np.testing.assert_array_equal(found.reached[0], reached_by_hand(SCARA, found.base[0], goals, others))
    assert found.share[0] == 1
    with pytest.raises(ValueError, match="at most 1024"):
        ikjax.place(SCARA, goals, alternatives=1000, free_rolls=2)


def test_boxes_regions_and_points_are_measured_as_by_hand(rng):
    box, region = np.array([[0, 0, 0], [1, 1, 1.0]]), np.array([[-1, -1, -1], [3, 3, 3.0]])
    points = rng.uniform(-2, 2, (50, 3))
    turn = np.asarray(ikjax.pose((0.3, 0, 0), rpy=(0, 0, 0.5)))
    rule = allowed([region], box, points, 0.3, turn)
    places = rng.uniform(-2, 3, (400, 3))
    world = places @ turn[:3, :3].T + turn[:3, 3]
    off = np.linalg.norm(np.maximum(np.maximum(box[0] - world, world - box[1]), 0), axis=-1)
    good = ((world >= region[0]) & (world <= region[1])).all(-1) & (off >= 0.3)
    good &= np.linalg.norm(world[:, None] - points, axis=-1).min(-1) >= 0.3
    assert 20 < good.sum() < 380
    np.testing.assert_array_equal(rule.at(places), good)
    traced = jax.jit(jax.vmap(rule.for_program(np.float64).at_one))(places)
    np.testing.assert_array_equal(traced, good)
    for words, says in (
        ((box[::-1], None, 0.0), "keep_out must be boxes"),
        ((None, np.zeros((3, 2)), 0.1), "parts must be points"),
        ((None, points, 0.0), "need a clearance"),
        ((None, None, -1.0), "clearance must be a length"),
    ):
        with pytest.raises(ValueError, match=says):
            allowed([], *words, np.eye(4))


class Compilations:
    """Counts the programs that jax compiles, or fetches from its cache, while it is entered."""

    entered: ClassVar["list[Compilations]"] = []

    def __enter__(self):
        if not hasattr(Compilations, "hears"):
            jax.monitoring.register_event_duration_secs_listener(_hear)
            Compilations.hears = True
        self.count = 0
        self.entered.append(self)
        return self

    def __exit__(self, *_):
        self.entered.remove(self)


def _hear(name, *_, **__):
    for each in Compilations.entered:
        each.count += name == "/jax/core/compile/backend_compile_duration"


def test_another_grid_compiles_nothing_of_sweep():
    first = ikjax.maps.grid((-0.3, -0.3, -0.1), (0.3, 0.3, 0.0), 0.05)
    second = ikjax.maps.grid((-0.2, -0.3, -0.05), (0.35, 0.3, -0.05), 0.02)
    ikjax.sweep(SCARA, first, 4)
    with Compilations() as none:
        found = ikjax.sweep(SCARA, second, 4)
    assert none.count == 0
    with Compilations() as some:
        again = ikjax.sweep(dataclasses.replace(SCARA, tool=np.asarray(SCARA.tool) + 0.0), second, 4)
        ikjax.sweep(SCARA, second, 5)
    assert some.count > 0
    np.testing.assert_array_equal(found.reachable, again.reachable)


def test_another_tool_mount_or_limit_compiles_nothing_of_sweep():
    arm, grid = ikjax.robots.ur5e(), ikjax.maps.grid((0.2, -0.3, 0.1), (0.6, 0.3, 0.3), 0.1)

    def swept(length, shift, most):
        tool = np.asarray(arm.tool) @ np.asarray(ikjax.pose((0, 0.02, length), rpy=(0.2, 0, 0)))
        mount = np.asarray(ikjax.pose((0, shift, 0.1), rpy=(0, 0, shift)))
        limits = np.tile([-most, most], (6, 1))
        cell = dataclasses.replace(arm, tool=tool, base=mount @ np.asarray(arm.base), limits=limits)
        return cell, ikjax.sweep(cell, grid, 4, statistics=["reachable", "reachable_within"])

    swept(0.1, 0.0, 2.5)
    with Compilations() as none:
        cell, found = swept(0.25, 0.3, 1.8)
    assert none.count == 0
    goals = np.zeros((*grid.shape, 4, 4, 4))
    goals[..., :3, :3], goals[..., 3, 3] = found.rotations, 1
    goals[..., :3, 3] = grid.points()[..., None, :]
    sol = ikjax.solve(cell, goals)
    assert (found.reachable == np.asarray(sol.valid).any(-1).sum(-1)).all()
    inside = np.asarray(ikjax.within_limits(cell, sol).valid)
    assert (found.reachable_within == inside.any(-1).sum(-1)).all()
    assert 0 < found.reachable_within.sum() < found.reachable.sum()


@pytest.mark.slow
def test_sixty_alternatives_are_one_program_of_place():
    arm = ikjax.robots.gx4_351s()
    goals = ikjax.pose((0.2, 0.1, -0.1), rpy=np.linspace(0, 3, 5)[:, None] * (0, 0, 1))
    bases = ikjax.place(arm, goals, free_rolls=60, starts=2, steps=3, spacing=0.2)
    assert bases.share[0] == 1 and bases.alternatives.shape == (60, 4, 4)


def test_other_points_and_bounds_compile_nothing_of_place():
    options = {"move": ["x", "y"], "steps": 5, "starts": 3, "spacing": 0.1}
    ikjax.place(ARM, ring(count=9), keep_out=[[[5, 5, 5], [6, 6, 6]]], **options)
    other = ring(center=(1.03, 0.47), count=14)
    with Compilations() as none:
        ikjax.place(
            ARM,
            other,
            keep_out=[[[7, 7, 7], [8, 8, 8]]],
            bounds={"x": (0.23, 1.81), "y": (-0.52, 1.54)},
            **options,
        )
    # jax makes a program for the copy of an array of another shape, and none for what is done with it.
    assert none.count <= 1
    with Compilations() as some:
        ikjax.place(ARM, ring(count=9), free_rolls=2, **options)
    assert some.count >= 3  # the count counts


def test_other_bounds_compile_nothing_of_design():
    goals = ring(center=(0.5, 0.1), count=6, radius=0.2)
    options = {"starts": 3, "steps": 4, "ties": "a1 + a2 = 0.9"}
    ikjax.design(ARM, goals, {"a1": (0.4, 0.8), "a2": (0.1, 0.5)}, **options)
    with Compilations() as none:
        result = ikjax.design(ARM, goals, {"a1": (0.3, 0.7), "a2": (0.15, 0.6)}, **options)
    # `solve` of the arm that was found is another program only where the numbers 0 and 1 stand elsewhere.
    assert none.count == 0
    assert 0.3 <= result.values["a1"] <= 0.7 and result.values["a1"] + result.values["a2"] == pytest.approx(
        0.9
    )


def test_a_design_names_the_bounds_that_it_met():
    goals = np.asarray(ikjax.position(np.array([1.6, 1.7]), np.zeros(2), np.zeros(2)))
    result = ikjax.design(ARM, goals, {"a1": (0.5, 0.7)}, "worst_margin", starts=1, steps=200)
    assert result.at_bounds == ("a1 = 0.7 (upper)",)
    assert "at a bound: a1 = 0.7 (upper); wider ones may give a better arm" in result.report()
