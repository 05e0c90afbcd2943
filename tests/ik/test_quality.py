"""How well an arm moves: against LAPACK and differences, at singularities, for every kind of task."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import ikjax
from ikjax.arm.forward import reach

MEASURES = (ikjax.manipulability, ikjax.inverse_condition, ikjax.sigma_min)
ARMS = ("puma560", "so101", "planar_prr", "planar_2r", "stanford", "gx4_351s")


def joints(arm, rng, count=40):
    """Anywhere, at right angles, and straight."""
    q = rng.uniform(-3, 3, (count, arm.n))
    corners = rng.integers(-2, 3, (count, arm.n)) * np.pi / 2
    return np.concatenate([q, corners, np.zeros((1, arm.n))])


def scaled_jacobian(arm, q):
    """The Jacobian in the rows of the task, lengths in reaches, by the library's own whole Jacobian."""
    arm = arm.astype(np.float64)
    whole, size = np.array(ikjax.jacobian(arm, q)), float(reach(arm))
    whole[..., :3, :] /= size
    whole[..., [kind == "P" for kind in arm.kinds]] *= size
    # These planar arms stand in the world's x, y plane.
    return whole[..., {"pose": range(6), "planar_pose": [0, 1, 5], "planar_position": [0, 1]}[arm.task], :]


@jax.jit
def measured(arm, q):
    return jnp.stack([measure(arm, q) for measure in MEASURES], axis=-1)


@pytest.mark.parametrize(
    "name", [*ARMS[:4], *(pytest.param(name, marks=pytest.mark.slow) for name in ARMS[4:])]
)
def test_measures_are_those_of_the_singular_values(name, costly_dtype, rng):
    arm = ikjax.robots.get(name).astype(costly_dtype)
    q = joints(arm, rng).astype(costly_dtype)
    values = np.linalg.svd(scaled_jacobian(arm, q), compute_uv=False)
    least, most = values.min(-1), values.max(-1)
    expected = np.stack([values.prod(-1), least / most, least], axis=-1)
    got = measured(arm, q)
    assert got.dtype == costly_dtype
    np.testing.assert_allclose(got, expected, atol=200 * np.finfo(costly_dtype).eps)


LEAVES = ("a", "alpha", "d", "theta", "base", "tool")


@jax.jit
def gradients(arm, q):
    """Of the sum of all measures, in the arm's leaves and in q."""

    def total(leaves, q):
        return measured(dataclasses.replace(arm, **leaves), q).sum()

    return jax.grad(total, (0, 1))({key: getattr(arm, key) for key in LEAVES}, q)


@jax.jit
def along(arm, q, rates, t):
    """The measures at arm + t rates, q + t rates, and their derivatives in t."""

    def moved(t):
        columns, turn = rates
        columns = {key: getattr(arm, key) + t * rate for key, rate in columns.items()}
        return measured(dataclasses.replace(arm, **columns), q + t * turn)

    return jax.jvp(moved, (t,), (jnp.ones_like(t),))


@pytest.mark.parametrize(
    "name", ["planar_prr", *(pytest.param(name, marks=pytest.mark.slow) for name in ("puma560", "stanford"))]
)
def test_gradients_are_finite_at_singularities_and_those_of_differences_elsewhere(name, costly_dtype, rng):
    arm = ikjax.robots.get(name).astype(costly_dtype)
    q = jnp.asarray(joints(arm, rng), costly_dtype)
    for gradient in jax.tree.leaves(gradients(arm, q)):
        assert np.isfinite(gradient).all()
    if costly_dtype == np.float32:
        return
    values = np.linalg.svd(scaled_jacobian(arm, q), compute_uv=False)
    regular = (values[:, -1] > 1e-3) & (values[:, -2] - values[:, -1] > 1e-3)
    assert regular.sum() > 20
    # The reach has a corner where a length is zero.
    rates = {key: rng.normal(size=arm.n) * (np.asarray(getattr(arm, key)) != 0) for key in ("a", "d")}
    rates |= {key: rng.normal(size=arm.n) for key in ("alpha", "theta")}
    rates = rates, rng.normal(size=q.shape)
    step = 1e-6
    ahead, behind = (np.asarray(along(arm, q, rates, jnp.asarray(t))[0]) for t in (step, -step))
    derivative = np.asarray(along(arm, q, rates, jnp.asarray(0.0))[1])
    np.testing.assert_allclose(derivative[regular], ((ahead - behind) / (2 * step))[regular], atol=1e-5)


def test_a_measure_for_every_branch_under_vmap_and_jit():
    arm = ikjax.robots.planar_3r()
    sol = ikjax.solve(arm, ikjax.fk(arm, jnp.asarray(np.random.default_rng(1).uniform(-2, 2, (5, 3)))))
    got = ikjax.manipulability(arm, sol.q)
    assert got.shape == (5, 2)
    one = jax.jit(jax.vmap(lambda q: ikjax.manipulability(arm, q)))(sol.q[2])
    np.testing.assert_allclose(one, got[2], atol=1e-14)
    assert ikjax.sigma_min(arm, sol.q[0, 0]).shape == ()


def test_scaling_an_arm_changes_no_measure_and_a_length_of_ones_own_does():
    arm = ikjax.robots.puma560()
    double = dataclasses.replace(arm, a=2 * arm.a, d=2 * arm.d)
    q = np.full(6, 0.4)
    np.testing.assert_allclose(measured(double, q), measured(arm, q), rtol=1e-12)
    whole = np.asarray(ikjax.jacobian(arm, q))
    np.testing.assert_allclose(
        ikjax.manipulability(arm, q, characteristic_length=1.0), abs(np.linalg.det(whole)), rtol=1e-10
    )


def test_seven_joints_have_measures_too(rng):
    seven = ikjax.Arm.from_dh(
        a=[0] * 7,
        alpha=np.array([-1, 1, 1, -1, -1, 1, 0]) * np.pi / 2,
        d=[0.3, 0, 0.4, 0, 0.4, 0, 0.1],
        convention="standard",
    )
    q = rng.uniform(-2, 2, (5, 7))
    expected = np.linalg.svd(scaled_jacobian(seven, q), compute_uv=False)
    np.testing.assert_allclose(ikjax.manipulability(seven, q), expected.prod(-1), rtol=1e-9)


def test_limits_are_as_far_as_the_nearest_whatever_the_turns(dtype):
    arm = ikjax.robots.planar_rpr().astype(dtype)
    arm = dataclasses.replace(arm, limits=jnp.array([[-1, 2], [0.1, 0.5], [-jnp.inf, jnp.inf]], dtype))
    size = float(reach(arm))
    q = np.array([[0.5, 0.3, 3], [0.5 + 2 * np.pi, 0.3, 0], [1.9, 0.3, 0], [-1.25, 0.3, 0], [0.5, 0.6, 0]])
    middle = 0.2 / size
    expected = [min(1.5, middle), min(1.5, middle), 0.1, -0.25, -0.1 / size]
    np.testing.assert_allclose(ikjax.limit_clearance(arm, q.astype(dtype)), expected, atol=1e-6)
    free = dataclasses.replace(arm, limits=jnp.array([[-jnp.inf, jnp.inf]] * 3, dtype))
    np.testing.assert_allclose(ikjax.limit_clearance(free, q.astype(dtype)), np.pi, rtol=1e-6)
    gradients = jax.grad(lambda arm, q: ikjax.limit_clearance(arm, q).sum(), (0, 1))(free, q.astype(dtype))
    assert all(np.isfinite(x).all() for x in jax.tree.leaves(gradients))


def test_a_limit_distance_is_positive_just_where_a_branch_is_within_limits():
    arm = ikjax.robots.planar_3r()
    arm = dataclasses.replace(arm, limits=jnp.array([[-1.0, 2.0], [-2.5, 2.5], [-5.0, -1.0]]))
    q = np.random.default_rng(3).uniform(-np.pi, np.pi, (300, 3))
    sol = ikjax.solve(arm, ikjax.fk(arm, q))
    inside = np.asarray(ikjax.within_limits(arm, sol).valid)
    distance = np.asarray(ikjax.limit_clearance(arm, sol.q))
    clear = np.asarray(sol.valid) & (np.abs(distance) > 1e-9)
    np.testing.assert_array_equal((distance > 0)[clear], inside[clear])
    assert 0 < inside.sum() < clear.sum()


def test_joints_of_another_number_are_refused():
    with pytest.raises(ValueError, match=r"q must have shape \(..., 6\)"):
        ikjax.manipulability(ikjax.robots.puma560(), np.zeros(5))


@pytest.mark.parametrize(
    "name",
    [pytest.param("planar_3r", marks=pytest.mark.slow), pytest.param("puma560", marks=pytest.mark.long)],
)
def test_second_derivatives_through_solve_are_those_of_differences_and_finite_at_singularities(name, rng):
    arm = ikjax.robots.get(name)
    arm = dataclasses.replace(arm, limits=jnp.asarray([[-2.5, 2.9]] * arm.n))
    corners = np.concatenate([np.zeros((1, arm.n)), rng.integers(-2, 3, (8, arm.n)) * np.pi / 2])
    goals = ikjax.fk(arm, np.concatenate([rng.uniform(-2.4, 2.4, (12, arm.n)), corners]))
    edge = jnp.stack([goals[0].at[:3, 3].multiply(20), jnp.full((4, 4), jnp.nan)])
    goals = jnp.concatenate([goals, edge])
    # Shifts in the plane, a turn about z, and two lengths.
    zero = jnp.zeros(5)

    def measures(t, goal):
        turn = jnp.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 0]])
        # A row of NaN would have rates of NaN, which no derivative of ours can mend.
        proper = jnp.where(jnp.isfinite(goal[:3, :3]), goal[:3, :3], 0)
        rotation = goal[:3, :3] + (t[2] * turn + t[2] ** 2 / 2 * turn @ turn) @ proper
        goal = goal.at[:3, :3].set(rotation).at[:2, 3].add(t[:2])
        other = dataclasses.replace(arm, a=arm.a.at[1:3].add(t[3:]))
        q = ikjax.solve(other, goal).q
        return jnp.stack([*(measure(other, q) for measure in MEASURES), ikjax.limit_clearance(other, q)])

    first = jax.jit(jax.vmap(jax.jacfwd(measures), (None, 0)))
    second = np.asarray(jax.jit(jax.vmap(jax.hessian(measures), (None, 0)))(zero, goals))
    assert np.isfinite(second).all()
    step = 1e-5
    rows = [np.asarray(first(step * e, goals) - first(-step * e, goals)) for e in np.eye(5)]
    rough = np.stack(rows, -1) / (2 * step)
    sol = ikjax.solve(arm, goals)
    values = np.linalg.svd(scaled_jacobian(arm, sol.q), compute_uv=False)
    regular = np.asarray(sol.valid) & (values[..., -1] > 0.05) & (values[..., -2] - values[..., -1] > 0.02)
    regular[12:] = False
    # A limit distance has corners where another limit is the nearest: there the derivative itself jumps.
    smooth = regular[:, None] & (np.abs(rows).max((0, -1)) < 1e-2)
    assert regular.sum() > 10 and smooth.sum() > 0.95 * 4 * regular.sum()
    size = 1 + np.abs(rough).max((-1, -2), keepdims=True)
    assert (np.abs(second - rough) / size)[smooth].max() < 1e-5


def test_manipulability_bends_where_the_arm_moves_all_ways_alike():
    """A 2R has a1 a2 sin q2, in shares of its reach: smooth, also where its two singular values are one."""
    arm = ikjax.robots.planar_2r(np.sqrt(2), 1.0)
    for q2 in (3 * np.pi / 4, 3 * np.pi / 4 + 1e-12, 0.5):
        bend = jax.hessian(lambda q: ikjax.manipulability(arm, q))(jnp.array([0.3, q2]))
        wanted = -np.sqrt(2) / (1 + np.sqrt(2)) ** 2 * np.sin(q2)
        np.testing.assert_allclose(bend, [[0, 0], [0, wanted]], atol=1e-12)
