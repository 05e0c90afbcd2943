"""Downhill to the nearest pose: exact slopes, no step up, limits kept, and slopes of the answer."""

import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest
from scipy.spatial.transform import Rotation

import ikjax
from ikjax.core import pose as poses
from ikjax.core.linear import solve_symmetric
from ikjax.ik import descent
from ikjax.solvers.family import reach

LENGTH = 0.1
ARM = ikjax.robots.get("so101")
LOW, HIGH = np.array(ARM.limits).T
BOTH_TYPES = pytest.mark.parametrize(
    "dtype", [pytest.param(np.float32, marks=pytest.mark.slow), np.float64], ids=["float32", "float64"]
)


def rotations(count, seed=0):
    return Rotation.random(count, random_state=seed).as_matrix()


def wild(arm, count, seed=0):
    """Goals near the arm, turned anyhow."""
    q = np.random.default_rng(seed).uniform(-1.5, 1.5, (count, arm.n))
    goals = np.array(ikjax.fk(arm, q))
    goals[:, :3, :3] = rotations(count, seed)
    return goals


def columns(q):
    return tuple(jnp.asarray(q[..., i]) for i in range(q.shape[-1]))


def standing(arm, goals, q):
    return descent.standing(arm, descent.Wish(poses.from_matrix(jnp.asarray(goals)), LENGTH), columns(q))


@pytest.mark.parametrize("angle", [0, 1e-12, 1e-5, 1, 3, np.pi - 1e-9, np.pi])
def test_the_turn_of_a_rotation_is_right_at_every_angle(angle):
    axes = np.concatenate([np.eye(3), -np.eye(3), np.random.default_rng(0).normal(size=(20, 3))])
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    rows = Rotation.from_rotvec(angle * axes).as_matrix()
    turn = poses.turn_of(tuple(tuple(jnp.asarray(rows[:, i, j]) for j in range(3)) for i in range(3)))
    found = np.stack(turn.vector, -1)
    # At pi the axis may point either way.
    sign = np.sign(np.sum(found * axes, -1, keepdims=True)) if angle > 3.1 else 1
    np.testing.assert_allclose(found * sign, angle * axes, atol=2e-15 + 2e-15 * angle)
    assert all(np.isfinite(x).all() for x in (turn.shrink, turn.bend))


def test_a_matrix_that_is_not_positive_is_made_so():
    matrix = [[1.0], [2.0, 1.0]]
    x = solve_symmetric(jax.tree.map(jnp.asarray, matrix), [jnp.asarray(1.0), jnp.asarray(0.0)], floor=1e-6)
    # Pivots 1 and -3 become 1 and 3.
    full = np.array([[1, 0], [2, 1]]) @ np.diag([1, 3]) @ np.array([[1, 2], [0, 1]])
    np.testing.assert_allclose(x, np.linalg.solve(full, [1, 0]), rtol=1e-14)


ARMS = {
    "so101": ARM,
    "puma560": ikjax.robots.get("puma560"),
    "stanford": ikjax.robots.get("stanford"),
    "coupled": dataclasses.replace(
        ikjax.robots.get("stanford"),
        coupling=jnp.eye(6).at[2, 1].set(0.3).at[4, 3].set(-0.5),
    ),
}


@pytest.mark.parametrize("name", ARMS)
def test_slope_and_curvature_are_those_of_the_cost(name):
    arm = ARMS[name]
    q = np.random.default_rng(1).uniform(-1, 1, (3, arm.n))
    goals, h = wild(arm, 3, seed=2), 1e-5
    at = standing(arm, goals, q)
    steps = np.concatenate([np.eye(arm.n), -np.eye(arm.n)])[:, None] * h
    beside = standing(arm, goals[None], q[None] + steps)
    size = float(ikjax.solvers.family.reach(arm.baked()))
    units = np.where([kind == "P" for kind in arm.kinds], size, 1.0)[:, None]
    up, down = np.split(np.array(beside.cost), 2)
    np.testing.assert_allclose(np.array(at.slope), units * (up - down) / (4 * h), atol=1e-9)
    slopes = np.array(beside.slope)
    curve = units[None, :] * (slopes[:, : arm.n] - slopes[:, arm.n :]) / (2 * h)
    for i in range(arm.n):
        for j in range(i + 1):
            np.testing.assert_allclose(at.curve[i][j], curve[i, j], atol=1e-8)


@functools.cache
def refined():
    goals = wild(ARM, 300)
    q0 = np.random.default_rng(3).uniform(-2, 2, (300, 2, 5))
    return goals, q0, ikjax.refine(ARM, goals, q0, LENGTH)


def cost_of(arm, goals, q):
    gap, angle = ikjax.pose_error(ikjax.fk(arm, q), goals)
    return np.array(gap) ** 2 + (LENGTH * np.array(angle)) ** 2


def test_it_ends_where_no_small_move_improves_and_never_above_its_start():
    goals, q0, near = refined()
    assert near.converged.mean() > 0.99
    assert near.branches.q.shape == (300, 2, 5) and near.q.shape == (300, 5)
    q = np.array(near.branches.q)
    assert (q >= LOW).all() and (q <= HIGH).all()
    np.testing.assert_allclose(near.branches.cost, cost_of(ARM, goals[:, None], q), rtol=1e-9, atol=1e-20)
    begun = cost_of(ARM, goals[:, None], np.clip(q0, LOW, HIGH))
    assert (np.array(near.branches.cost) <= begun * (1 + 1e-12)).all()
    # The first of those that are level.
    np.testing.assert_allclose(near.cost, near.branches.cost.min(-1), rtol=1e-10, atol=1e-28)
    rng = np.random.default_rng(4)
    for size in (1e-3, 1e-2):
        beside = np.clip(np.array(near.q) + size * rng.normal(size=(40, 300, 5)), LOW, HIGH)
        ahead = cost_of(ARM, goals, beside) - np.array(near.cost)
        assert (ahead[:, np.array(near.converged)] > -1e-15).all()


@pytest.mark.slow
def test_a_loss_of_ones_own_is_minimised_within_limits():
    goals = wild(ARM, 4)

    def posture(arm, goal, q):
        gap = ikjax.fk(arm, q)[:3, 3] - goal[:3, 3]
        return jnp.sum(gap * gap) + 1e-3 * jnp.sum(q * q)

    q0 = np.full((4, 5), 0.3)
    near = ikjax.refine(ARM, goals, q0, loss=posture, optimizer=optax.adam(0.03), steps=300)
    begun = jax.vmap(lambda g, q: posture(ARM, g, q))(jnp.asarray(goals), jnp.asarray(q0))
    assert (near.cost < begun).all() and near.gradient_norm.max() < 1e-2
    q = np.array(near.q)
    assert ((q >= LOW) & (q <= HIGH)).all()


def test_a_goal_that_is_no_pose_is_not_converged_and_leaves_its_neighbours():
    goals, q0, near = refined()
    bad = goals.copy()
    bad[7, 0, 3] = np.nan
    bad[8, :3, :3] = 2
    again = ikjax.refine(ARM, bad, q0, LENGTH)
    rest = ~np.isin(np.arange(300), (7, 8))
    assert not again.converged[7:9].any() and np.isfinite(again.q).all()
    np.testing.assert_array_equal(np.array(again.q)[rest], np.array(near.q)[rest])


@pytest.mark.parametrize(
    ("call", "text"),
    [
        (lambda: ikjax.refine(ARM, np.eye(4), np.zeros(4)), r"q0 must have shape \(5,\)"),
        (lambda: ikjax.refine(ARM, np.eye(4), np.zeros(5), 0.0), "length must be a positive number"),
        (lambda: ikjax.refine(ARM, np.eye(3), np.zeros(5)), "goals must have shape"),
    ],
)
def test_a_wrong_argument_is_named(call, text):
    with pytest.raises(ValueError, match=text):
        call()


@pytest.mark.parametrize("name", ["planar_prr", pytest.param("planar_3r", marks=pytest.mark.slow)])
def test_an_arm_that_moves_in_a_plane_is_asked_for_what_lies_in_its_own(name):
    """Of a PRR, whose slide runs along the base's z, that is not the plane of the base's x and y."""
    arm = ikjax.robots.get(name)
    low, high = np.clip(np.array(arm.limits).T, -3, 10)
    q = np.random.default_rng(2).uniform(low, high, (40, 3))
    goals = ikjax.fk(arm, q)
    near = ikjax.refine(arm, goals, np.clip(q + 0.05, low, high), length=float(reach(arm)))
    gap, turn = ikjax.pose_error(ikjax.fk(arm, near.q), goals)
    np.testing.assert_allclose(near.position_error, gap, atol=1e-9)
    assert near.converged.all() and gap.max() < 1e-6 and turn.max() < 1e-6


@BOTH_TYPES
def test_a_saddle_is_left(dtype):
    """At full stretch the slope of a goal straight ahead is zero, and no pose of a bottom is."""
    arm = ikjax.robots.planar_2r().astype(dtype)
    x = np.array([0.4, 0.8, 0.8991, 0.899595], dtype)
    goals = ikjax.position(x, np.zeros_like(x), np.zeros_like(x))
    found = ikjax.refine(arm, goals, np.zeros((4, 2), dtype))
    # So near to full stretch a slope of nothing, in float32, leaves a tenth of a millimetre.
    assert found.converged.all() and np.max(found.position_error) < (1e-10 if dtype == np.float64 else 2e-4)
    path = ikjax.track(arm, goals[::-1], np.zeros(2, dtype))
    assert path.reached.all() and path.followed[:2].all()


@pytest.mark.slow
def test_slopes_of_slopes_follow_the_bottom():
    arm = ikjax.robots.planar_3r()

    def near(t):
        found = ikjax.refine(arm, ikjax.planar_pose(1.32 + t, 0.3, 2.0), jnp.array([0.3, 0.2, 0.1]), 1.0)
        return jnp.concatenate([jnp.stack([found.cost, found.position_error, found.rotation_error]), found.q])

    slope, h = jax.jit(jax.jacfwd(near)), 1e-4
    wanted = (slope(h) - slope(-h)) / (2 * h)
    for outer in (jax.jacfwd, jax.jacrev):
        np.testing.assert_allclose(outer(jax.jacfwd(near))(0.0), wanted, atol=1e-7)


@BOTH_TYPES
def test_branches_that_are_level_do_not_take_turns(dtype):
    """An L-3 stands in each pose in two ways, whose costs differ by rounding."""
    arm = ikjax.robots.motoman_l3()
    x = np.linspace(0.3, 0.6, 100)
    goals = jax.vmap(lambda x: ikjax.pose(xyz=jnp.stack([x, 0.1, 0.2]), rpy=(3, 0.1, 0.5)))(x)
    found = np.asarray(ikjax.project(arm, goals.astype(dtype)).q)
    assert np.abs(np.diff(found, axis=0)).max() < 0.1


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"optimizer": optax.sgd(0.1)}, "optimizer is of a loss"),
        ({"loss": lambda arm, goal, q: q[0], "priority": "position"}, "priority is of the errors"),
        ({"length": np.ones(2)}, "length must be a positive number"),
        ({"q0": np.zeros((0, 5))}, "q0 must hold at least one start"),
        ({"steps": -1}, "steps must be a whole number, not negative, got -1"),
    ],
)
def test_options_that_do_not_go_together_are_named(options, message):
    with pytest.raises(ValueError, match=message):
        ikjax.refine(ARM, wild(ARM, 1)[0], **{"q0": np.zeros(5), **options})
