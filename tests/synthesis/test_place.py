"""Where to stand: against brute force, known optima, symmetries, maps and mistakes."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import ikjax
from ikjax.synthesis.ascent import ConstantArm, PlacementPlan
from ikjax.synthesis.search_space import search_space

UPPER, FORE = 0.6, 0.3
ARM = ikjax.robots.planar_2r(UPPER, FORE)
BASIC = {"spacing": 0.1, "steps": 40, "starts": 4}
"""The same shapes in all tests, so that few programs are compiled."""


def points(xy, dtype=np.float64):
    xy = np.asarray(xy, float)
    return np.asarray(ikjax.position(xy[..., 0], xy[..., 1], 0 * xy[..., 0])).astype(dtype)


def ring(center=(0, 0), count=24):
    angle = np.linspace(0, 2 * np.pi, count, endpoint=False)
    return points(np.stack([np.cos(angle), np.sin(angle)], -1) * (UPPER + FORE) / 1.5 + center)


def scattered(seed=0, count=24):
    return np.random.default_rng(seed).uniform(-0.9, 0.9, (count, 2))


def about_z(angle, shift=(0, 0, 0)):
    moved = np.eye(4)
    moved[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
    moved[:3, 3] = shift
    return moved


def test_every_candidate_is_counted_as_by_hand():
    xy = scattered()
    found = ikjax.place(ARM, points(xy), **BASIC)
    away = np.linalg.norm(found.grid.points()[..., None, :2] - xy, axis=-1)
    by_hand = ((away <= UPPER + FORE) & (away >= UPPER - FORE)).mean(-1)
    np.testing.assert_array_equal(found.tried[..., 0], by_hand)
    assert 0.3 < by_hand.max() < 1
    assert found.share[0] >= by_hand.max()
    # No place on a much finer grid is better by more than one goal.
    fine = np.stack(np.meshgrid(*[np.linspace(-1.5, 1.5, 301)] * 2), -1)
    away = np.linalg.norm(fine[..., None, :] - xy, axis=-1)
    best = ((away <= UPPER + FORE) & (away >= UPPER - FORE)).mean(-1).max()
    assert found.share[0] >= best - 1 / 24


def test_what_is_returned_is_what_solve_says():
    goals = points(scattered()).reshape(4, 6, 4, 4)
    found = ikjax.place(ARM, goals, **BASIC)
    assert found.reached.shape == (len(found), 4, 6)
    for base, reached, worst, share in zip(
        found.base[:1], found.reached, found.worst_margin, found.share, strict=False
    ):
        there = dataclasses.replace(ARM, base=base)
        sol = ikjax.solve(there, goals)
        np.testing.assert_array_equal(ikjax.within_limits(there, sol).valid.any(-1), reached)
        np.testing.assert_allclose(ikjax.best_margin(there, sol).min(), worst, atol=1e-9)
        assert share == reached.mean()


def test_an_arm_stands_in_the_middle_of_a_ring():
    # Bounds whose grid misses the middle.
    found = ikjax.place(ARM, ring((2.03, -1.04)), bounds={"x": (1, 3.1), "y": (-2.1, 0)}, **BASIC)
    np.testing.assert_allclose(found.base[0][:3, 3], (2.03, -1.04, 0), atol=2e-3)
    assert found.share[0] == 1 and found.worst_margin[0] > 0.297
    assert found.start_score[0] < found.score[0] - 1e-3
    assert "24 goals (100.0%), worst margin +2" in str(found)


@pytest.mark.parametrize("rate", [0.3, 30.0])
def test_polishing_never_makes_a_base_worse(rate, monkeypatch):
    # At the greater rate the ascent is unstable, and its end is no better than its start.
    monkeypatch.setattr("ikjax.synthesis.place.RATE", rate)
    for seed in range(4):
        found = ikjax.place(ARM, points(scattered(seed)), **BASIC)
        assert (found.score >= found.start_score).all() and (found.share >= found.start_share).all()
        assert (np.diff(found.score) <= 1e-12).all()


def test_bases_are_distinct_and_at_most_as_many_as_wanted():
    found = ikjax.place(ARM, points(scattered()), keep=2, **BASIC)
    gap = np.abs(found.base[:, None, :2, 3] - found.base[None, :, :2, 3]).max(-1)
    assert len(found) == 2 and gap[0, 1] > 0.1


def test_moved_goals_move_the_bases():
    here = ikjax.place(ARM, points(scattered()), **BASIC)
    moved = about_z(np.pi / 2, (0.7, -3, 0))
    there = ikjax.place(ARM, moved @ points(scattered()), **BASIC)
    np.testing.assert_allclose(np.sort(there.tried.ravel()), np.sort(here.tried.ravel()), atol=1e-12)
    np.testing.assert_allclose(there.share, here.share)
    np.testing.assert_allclose(there.base[0][:3, 3], (moved @ here.base[0])[:3, 3], atol=1e-3)


@pytest.mark.slow
def test_a_turn_matters_where_the_first_joint_has_limits():
    arm = dataclasses.replace(ARM, limits=np.array([[-0.5, 0.5], [0.1, 3]]))
    goals = points([[0.7, 0], [0.75, 0.1], [0.75, -0.1], [0.8, 0]] * 6)
    fixed = {"bounds": {"x": (0, 0), "y": (0, 0)}, "turns": 8, **BASIC}
    ahead = ikjax.place(arm, goals, **fixed)
    assert ahead.turns.shape == (8,) and 0 < (ahead.tried > 0).sum() < 4
    behind = ikjax.place(arm, about_z(2.2) @ goals, **fixed)
    assert ahead.share[0] == behind.share[0] == 1
    # The distance of the goals from the fold is the same for a range of turns.
    np.testing.assert_allclose([ahead.worst_margin[0], behind.worst_margin[0]], 0.1, atol=1e-3)
    turn = ahead.base[0][:2, :2].T @ behind.base[0][:2, :2]
    assert abs(np.arctan2(turn[1, 0], turn[0, 0]) - 2.2) < 0.3


def test_where_nothing_is_reached_the_result_says_so():
    far = ikjax.place(ARM, ring(), bounds={"x": (5, 6), "y": (0, 1)}, **BASIC)
    assert not far.reached.any() and far.share[0] == 0 and far.worst_margin[0] < -3
    assert "no base reaches any goal" in str(far)
    # The nearest corner comes first, and polishing stays within bounds.
    np.testing.assert_allclose(far.base[0][:2, 3], (5, 0), atol=0.1)
    assert (far.base[:, 0, 3] >= 5).all()


def test_float32_stands_where_float64_does():
    unpolished = BASIC | {"steps": 0}
    wide, narrow = (ikjax.place(ARM, ring((1, 0)).astype(t), **unpolished) for t in (np.float64, np.float32))
    assert narrow.base.dtype == np.float32
    np.testing.assert_array_equal(narrow.tried, wide.tried)
    np.testing.assert_allclose(narrow.base[0], wide.base[0], atol=5e-3)


@pytest.fixture(scope="module")
def scara():
    """An arm in space, whose first and last joints have limits, and a map with one orientation a goal."""
    arm = ikjax.robots.gx4_351s()
    arm = dataclasses.replace(arm, limits=np.array([*arm.limits[:3], (-1.2, 1.5)]))
    turned = np.stack([about_z(k * np.pi / 2)[:3, :3] for k in range(4)])
    grid = ikjax.maps.grid((-0.4, -0.4, -0.1), (0.4, 0.4, 0.0), 0.1)
    return arm, ikjax.sweep(arm, grid, turned, statistics=("reachable_within", "mask_within", "mask"))


@pytest.mark.parametrize("limits", [True, pytest.param(False, marks=pytest.mark.slow)])
def test_a_map_agrees_with_solving_where_the_goals_lie_on_it(scara, limits):
    arm, reach = scara
    rng = np.random.default_rng(1)
    goals = np.broadcast_to(np.eye(4), (24, 4, 4)).copy()
    goals[:, :3, :3] = reach.rotations[rng.integers(0, 4, 24)]
    goals[:, :3, 3] = rng.integers((-3, -3, -1), (4, 4, 1), (24, 3)) * 0.1
    options = {"bounds": {"x": (-0.5, 0.5), "y": (-0.5, 0.5)}, "turns": 4, "limits": limits}
    options |= BASIC | {"steps": 0}
    solved, looked = ikjax.place(arm, goals, **options), ikjax.place(arm, goals, reach_map=reach, **options)
    assert solved.tried.shape == (11, 11, 1, 4 if limits else 1)
    # Positions on the very fold may fall either way.
    assert np.abs(solved.tried - looked.tried).max() <= 1 / 24
    assert (solved.tried == looked.tried).mean() > 0.95 and solved.tried.max() > 0.2
    assert looked.share[0] >= looked.tried.max() - 1 / 24
    if limits:
        counted = dataclasses.replace(reach, arrays={"reachable_within": reach.arrays["reachable_within"]})
        rough = ikjax.place(arm, goals, reach_map=counted, **options)
        assert np.corrcoef(rough.tried.ravel(), solved.tried.ravel())[0, 1] > 0.9


def test_a_map_that_does_not_serve_is_refused_by_name(scara):
    arm, reach = scara
    goal = np.asarray(ikjax.fk(arm, np.zeros(4)))
    longer = dataclasses.replace(arm, a=arm.a + 0.01)
    for wrong, given, message in [
        (reach, longer, "a map of gx4_351s, got one of another arm"),
        (dataclasses.replace(reach, free_rolls=2), arm, "a map of 1 roll"),
        (dataclasses.replace(reach, arrays={}), arm, "must have reachable_within or its mask"),
        (dataclasses.replace(reach, positions=ikjax.maps.shell((0, 0, 0), 1, 9)), arm, "over a grid"),
        ("map.zarr", arm, "must be a ReachMap"),
    ]:
        with pytest.raises(ValueError, match=message):
            ikjax.place(given, goal, reach_map=wrong)


@pytest.mark.parametrize(
    "change, message",
    [
        ({"goals": ring() * np.nan}, r"goals\[0\] \(and 23 more: .*\) must hold finite"),
        ({"goals": np.zeros((0, 4, 4))}, r"at least one pose, got shape \(0, 4, 4\)"),
        ({"goals": np.zeros(3)}, r"shape \(..., 4, 4\)"),
        ({"move": ()}, "move must be some of x, y, z, turn, tilt, got none"),
        ({"move": ("x", "roll")}, "got x, roll"),
        ({"bounds": {"z": (0, 1)}}, r"bounds must be of what moves \(x, y, turn\), got z"),
        ({"bounds": {"x": (1, 0)}}, r"bounds of x must be finite \(lower, upper\)"),
        ({"keep": 0}, "keep must be a whole number, at least 1, got 0"),
        ({"spacing": 0.0}, "spacing must be a positive"),
        ({"spacing": 1e-5}, "candidates must be at most"),
    ],
)
def test_mistakes_are_named(change, message):
    with pytest.raises(ValueError, match=message):
        ikjax.place(ARM, change.pop("goals", ring()), **change)


TURN_AND_TILT = {"bounds": {"tilt": (-0.6, 0.6)}, "turns": 6, "starts": 4, "steps": 30}


@pytest.mark.slow
@pytest.mark.parametrize("move", [("turn", "tilt"), ("x", "z", "turn", "tilt")])
def test_a_tilted_base_is_the_one_that_was_evaluated(move, costly_dtype):
    arm = ikjax.robots.gx4_351s()
    # The first joint has limits, so that the turn counts, and goes on from half a turn.
    arm = dataclasses.replace(arm, limits=np.array([(-0.7, 0.7), *arm.limits[1:3], (-1.2, 1.5)]))
    lower, upper = np.asarray(arm.limits).T
    q = np.random.default_rng(0).uniform(lower, upper, (24, 4))
    stand = np.eye(4)
    stand[:3, :3] = Rotation.from_rotvec([0.35, 0.1, 0]).as_matrix() @ about_z(3.1)[:3, :3]
    goals = np.asarray(ikjax.fk(dataclasses.replace(arm, base=stand @ np.asarray(arm.base)), q))
    options = TURN_AND_TILT | ({"spacing": 0.3} if "x" in move else {})
    found = ikjax.place(arm, goals.astype(costly_dtype), move=move, **options)
    for bases, shares in ((found.base, found.share), (found.start, found.start_share)):
        for base, share in zip(bases, shares, strict=True):
            there = dataclasses.replace(arm.astype(costly_dtype), base=base)
            sol = ikjax.limited_margins(there, ikjax.solve(there, goals.astype(costly_dtype)))
            assert np.asarray(sol.valid.any(-1)).mean() == share
    for base, share, worst, reached in zip(
        found.base, found.share, found.worst_margin, found.reached, strict=True
    ):
        there = dataclasses.replace(arm.astype(costly_dtype), base=base)
        sol = ikjax.limited_margins(there, ikjax.solve(there, goals.astype(costly_dtype)))
        np.testing.assert_array_equal(sol.valid.any(-1), reached)
        assert sol.margin.max(-1).min() == pytest.approx(worst) and reached.mean() == share
        lean = Rotation.from_matrix(base[:3, :3] @ np.asarray(arm.base)[:3, :3].T).as_quat()
        assert 2 * np.arctan2(np.hypot(*lean[:2]), np.hypot(*lean[2:])) <= 0.6 * 2**0.5 + 1e-6


def test_a_whole_turn_more_is_the_same_place_whatever_the_tilt():
    space = search_space(ARM, np.zeros((1, 3)), 1.0, ("x", "turn", "tilt"), {}, None, 12, True)
    places = np.array([[0.1, 0, 0, 0.4, -0.2, 3.0], [0.1, 0, 0, 0.4, -0.2, 3.0 - 2 * np.pi]])
    one, other = space.base_poses(places)
    np.testing.assert_allclose(one, other, atol=1e-14)
    assert list(space.distinct(places, 2)) == [0]
    # As polishing has it.
    plan = PlacementPlan(ConstantArm(ARM), ("x", "rx", "ry", "rz"), True, 1, 1)
    polished = plan.moved_base(jnp.asarray(ARM.base), jnp.array([0.1, 0.4, -0.2, 3.0 + 2 * np.pi]))
    np.testing.assert_allclose(polished, one, atol=1e-14)
