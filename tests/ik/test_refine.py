"""Descent to the nearest pose: exact derivatives, no step up, limits kept, and gradients of the answer."""

import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest
from scipy.spatial.transform import Rotation

import ikjax
from ikjax.arm.forward import reach
from ikjax.core import pose as poses
from ikjax.core.linear import solve_symmetric
from ikjax.ik import newton

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


def evaluate(arm, goals, q):
    objective = newton.Objective(poses.from_matrix(jnp.asarray(goals)), LENGTH)
    return newton.evaluate(arm, objective, jnp.moveaxis(jnp.asarray(q), -1, 0))


@pytest.mark.parametrize("angle", [0, 1e-12, 1e-5, 1, 3, np.pi - 1e-9, np.pi])
def test_the_turn_of_a_rotation_is_right_at_every_angle(angle):
    axes = np.concatenate([np.eye(3), -np.eye(3), np.random.default_rng(0).normal(size=(20, 3))])
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    rows = Rotation.from_rotvec(angle * axes).as_matrix()
    turn = poses.rotation_vector(tuple(tuple(jnp.asarray(rows[:, i, j]) for j in range(3)) for i in range(3)))
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
def test_gradient_and_hessian_are_those_of_the_cost(name):
    arm = ARMS[name]
    q = np.random.default_rng(1).uniform(-1, 1, (3, arm.n))
    goals, h = wild(arm, 3, seed=2), 1e-5
    here = evaluate(arm, goals, q)
    steps = np.concatenate([np.eye(arm.n), -np.eye(arm.n)])[:, None] * h
    beside = evaluate(arm, goals[None], q[None] + steps)
    size = float(ikjax.solvers.pipeline.reach(arm.baked()))
    units = np.where([kind == "P" for kind in arm.kinds], size, 1.0)[:, None]
    up, down = np.split(np.array(beside.cost), 2)
    np.testing.assert_allclose(np.array(here.gradient), units * (up - down) / (4 * h), atol=1e-9)
    gradients = np.array(beside.gradient)
    hessian = units[None, :] * (gradients[:, : arm.n] - gradients[:, arm.n :]) / (2 * h)
    for i in range(arm.n):
        for j in range(i + 1):
            np.testing.assert_allclose(here.hessian[i][j], hessian[i, j], atol=1e-8)


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
def test_a_custom_loss_is_minimized_within_limits():
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


def test_a_goal_that_is_no_pose_is_not_converged_and_leaves_its_neighbors():
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
        (
            lambda: ikjax.refine(ARM, np.eye(4), np.zeros(5), 0.0),
            "characteristic_length must be a positive number",
        ),
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
    near = ikjax.refine(arm, goals, np.clip(q + 0.05, low, high), characteristic_length=float(reach(arm)))
    gap, turn = ikjax.pose_error(ikjax.fk(arm, near.q), goals)
    np.testing.assert_allclose(near.position_error, gap, atol=1e-9)
    assert near.converged.all() and gap.max() < 1e-6 and turn.max() < 1e-6


@BOTH_TYPES
def test_a_saddle_is_left(dtype):
    """At full stretch the gradient of a goal straight ahead is zero, and the pose is not a minimum."""
    arm = ikjax.robots.planar_2r().astype(dtype)
    x = np.array([0.4, 0.8, 0.8991, 0.899595], dtype)
    goals = ikjax.position(x, np.zeros_like(x), np.zeros_like(x))
    found = ikjax.refine(arm, goals, np.zeros((4, 2), dtype))
    # So near to full stretch a gradient norm of zero, in float32, leaves a tenth of a millimetre.
    assert found.converged.all() and np.max(found.position_error) < (1e-10 if dtype == np.float64 else 2e-4)
    path = ikjax.track(arm, goals[::-1], np.zeros(2, dtype))
    assert path.reached.all() and path.followed[:2].all()


@pytest.mark.slow
def test_second_derivatives_follow_the_minimum():
    arm = ikjax.robots.planar_3r()

    def near(t):
        found = ikjax.refine(arm, ikjax.planar_pose(1.32 + t, 0.3, 2.0), jnp.array([0.3, 0.2, 0.1]), 1.0)
        return jnp.concatenate([jnp.stack([found.cost, found.position_error, found.rotation_error]), found.q])

    derivative, h = jax.jit(jax.jacfwd(near)), 1e-4
    wanted = (derivative(h) - derivative(-h)) / (2 * h)
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
        ({"characteristic_length": np.ones(2)}, "characteristic_length must be a positive number"),
        ({"q0": np.zeros((0, 5))}, "q0 must hold at least one start"),
        ({"steps": -1}, "steps must be a whole number, not negative, got -1"),
    ],
)
def test_options_that_do_not_go_together_are_named(options, message):
    with pytest.raises(ValueError, match=message):
        ikjax.refine(ARM, wild(ARM, 1)[0], **{"q0": np.zeros(5), **options})


def typed(arm, q, decimals=3):
    """Goals with so many decimals, and the poses meant."""
    meant = np.array(ikjax.fk(arm, q))
    goals = meant.copy()
    goals[:, :3, :3] = goals[:, :3, :3].round(decimals)
    return goals, meant


NO_POSES = {
    "off by more than a hundredth": np.diag([1.02, 1, 1, 1.0]),
    "a reflection": np.diag([1, 1, -1, 1.0]),
    "not finite": np.diag([1, 1, np.inf, 1.0]),
    "another bottom row": np.diag([1, 1, 1, 2.0]),
    "transposed": np.eye(4) + np.diag([0.3], -3),
}


def test_typed_decimals_are_taken_for_the_nearest_rotation_and_said(dtype):
    q = np.random.default_rng(5).uniform(-1, 1, (30, 5))
    goals, meant = typed(ARM, q)
    norm = np.linalg.norm(np.swapaxes(goals[:, :3, :3], 1, 2) @ goals[:, :3, :3] - np.eye(3), axis=(1, 2))
    assert 1e-4 < norm.max() < 5e-3
    u, _, v = np.linalg.svd(goals[:, :3, :3])
    nearest = goals.copy()
    nearest[:, :3, :3] = u @ v
    near = ikjax.refine(ARM, goals.astype(dtype), (q + 0.05).astype(dtype))
    np.testing.assert_allclose(near.goal_error, norm, atol=8 * np.finfo(dtype).eps)
    assert near.branches.goal_error is None
    # Measured against the nearest rotation, and so as near to what was meant as it was typed.
    gap, angle = ikjax.pose_error(ikjax.fk(ARM, np.asarray(near.q, float)), nearest)
    close = 1e-6 if dtype == np.float64 else 2e-3
    np.testing.assert_allclose(near.rotation_error, angle, atol=close)
    np.testing.assert_allclose(near.position_error, gap, atol=close)
    assert near.converged.all() and (np.asarray(gap) < 2e-3).all() and (np.asarray(angle) < 5e-3).all()
    assert ikjax.pose_error(ikjax.fk(ARM, np.asarray(near.q, float)), meant)[1].max() < 5e-3


@pytest.mark.parametrize("case", NO_POSES)
def test_nothing_is_measured_against_what_stands_for_a_goal_that_is_no_pose(case):
    goals, q0 = np.stack([wild(ARM, 1)[0], NO_POSES[case]]), np.array([0.3, -0.2, 0.4, 0.1, 0.2])
    for call in (ikjax.refine, jax.jit(ikjax.refine)):
        near = call(ARM, goals, q0)
        assert near.converged.tolist() == [True, False]
        for field in ("cost", "position_error", "rotation_error", "gradient_norm"):
            assert np.isnan(getattr(near, field)).tolist() == [False, True], field
        np.testing.assert_array_equal(near.q[1], q0)
        assert near.goal_error[0] < 1e-14 and near.goal_error[1] > 1e-2

    def total(goals):
        near = ikjax.refine(ARM, goals, q0)
        return jnp.where(near.converged, near.cost, 0).sum() + near.q.sum()

    gradient = np.asarray(jax.jit(jax.grad(total))(goals))
    assert np.isfinite(gradient).all() and gradient[0].any() and not gradient[1].any()


def test_a_loss_gets_the_nearest_rotation_and_goals_that_have_none_as_they_are():
    goals = np.stack([typed(ARM, np.zeros((1, 5)) + 0.3)[0][0], NO_POSES["a reflection"]])
    seen = ikjax.refine(ARM, goals, np.zeros(5), loss=lambda arm, T, q: jnp.linalg.det(T[:3, :3]), steps=1)
    np.testing.assert_allclose(seen.cost, [1, -1], atol=1e-14)
    assert np.isnan(seen.rotation_error).tolist() == [False, True] and not seen.converged[1]


def test_the_derivative_at_a_typed_goal_is_that_of_its_nearest_rotation():
    goal = jnp.asarray(typed(ARM, np.full((1, 5), 0.4))[0][0]).at[0, 3].add(0.3)
    change, h = np.random.default_rng(1).normal(size=(4, 4)) * np.array([[1]] * 3 + [[0]]), 1e-5

    @jax.jit
    def near(t):
        found = ikjax.refine(ARM, goal + t * change, jnp.full(5, 0.4))
        return jnp.concatenate([found.q, jnp.stack([found.cost, found.rotation_error])])

    _, derivative = jax.jvp(near, (0.0,), (1.0,))
    np.testing.assert_allclose(derivative, (near(h) - near(-h)) / (2 * h), rtol=1e-4, atol=1e-6)


def test_converged_is_not_said_where_rounding_decides():
    """Far from the world's origin float32 has steps of centimetres."""
    q = np.random.default_rng(2).uniform(-1, 1, (5, 5)).astype(np.float32)
    for distance, wanted in ((0.0, True), (10.0, True), (1e5, False)):
        arm = dataclasses.replace(ARM, base=ARM.base.at[0, 3].set(distance)).astype(np.float32)
        near = ikjax.refine(arm, ikjax.fk(arm, q), q)
        assert near.converged.tolist() == [wanted] * 5


def test_converged_is_not_said_where_kilometres_in_the_table_hide_the_arm():
    """Axes 2 and 3 are parallel but for 1e-5 rad, and their offsets of 40 km make up for each other.

    `from_dh` rewrites such a table; `replace` takes the numbers as they are.
    """
    built = ikjax.Arm.from_dh(
        a=[0, 0.3, 0.2, 0, 0, 0],
        alpha=[1.4, 1e-5, 1.2, -1.3, 1.1, 0],
        d=[0.2, 0.1, -0.1, 0.3, 0.1, 0.1],
        convention="standard",
    )
    assert built.family is None
    q = np.random.default_rng(2).uniform(-1, 1, (5, 6))
    assert ikjax.refine(built, ikjax.fk(built, q), q + 0.3).converged.all()
    hidden = dataclasses.replace(built, d=jnp.array([0.2, 4e4, -4e4, 0.3, 0.1, 0.1]))
    assert not ikjax.refine(hidden, ikjax.fk(hidden, q), q + 0.3).converged.any()


def test_a_start_outside_the_limits_takes_as_few_turns_as_will_do():
    arm = dataclasses.replace(
        ARM, limits=jnp.asarray([[-6.2, 6.2], [1.0, 2.0], [-20, 20], [4, 100], [-1, 0.5]])
    )
    q = columns(np.array([7.0, 9.0, 15.0, 1.0, 2.5]))
    inside = np.stack(newton.into_limits(arm, q))
    turn = 2 * np.pi
    # The last fits at no turn: it stands at the end that it passes by less.
    np.testing.assert_allclose(inside, [7 - turn, 2.0, 15.0, 1 + turn, 0.5], rtol=1e-15)
    near = columns(np.array([-5.0, 0, -18.0, 50.0, 0]))
    inside = np.stack(newton.into_limits(arm, q, near))
    wanted = [7 - 2 * turn, 2.0, 15 - 5 * turn, 1 + 8 * turn, 0.5]
    np.testing.assert_allclose(inside, wanted, rtol=1e-14)
