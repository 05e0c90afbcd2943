"""The nearest attainable pose: closed form against brute force, and the minima that Newton reaches."""

import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

import ikjax

LENGTH = 0.1
L3 = ikjax.robots.get("motoman_l3")


def wild(arm, count, seed=0, share=(0.5, 1.3)):
    """Goals about the arm's workspace, some beyond it, turned anyhow."""
    rng = np.random.default_rng(seed)
    low, high = np.clip(np.array(arm.limits).T, -np.pi, np.pi)
    goals = np.array(ikjax.fk(arm, rng.uniform(low, high, (count, arm.n))))
    goals[:, :3, :3] = Rotation.random(count, random_state=seed).as_matrix()
    goals[:, :3, 3] *= rng.uniform(*share, (count, 1))
    return goals


@functools.cache
def projected(steps=60):
    goals = wild(L3, 500)
    return goals, ikjax.project(L3, goals, LENGTH, steps=steps)


def reachable():
    goals, _ = projected()
    distance = np.linalg.norm(goals[:, :3, 3], axis=1)
    return (distance > 0.11) & (distance < 0.69)


def test_the_closed_form_holds_the_point_with_the_nearest_orientation():
    goals, near = projected(0)
    inside = reachable()
    assert 100 < inside.sum() < 500
    assert near.branches.position_error[inside].min(-1).max() < 1e-12
    # No other roll does better at the pitch that was taken.
    some = np.flatnonzero(inside)[:40]
    turns = np.linspace(-np.pi, np.pi, 181)[:, None, None] * (np.arange(5) == 4)
    for slot in range(4):
        _, angle = ikjax.pose_error(ikjax.fk(L3, np.array(near.branches.q)[some, slot] + turns), goals[some])
        held = np.array(near.branches.position_error)[some, slot] < 1e-12
        assert held.sum() > 10
        least = np.array(near.branches.rotation_error)[some, slot]
        assert (np.array(angle).min(0) >= least - 1e-12)[held].all()


def test_it_is_craigs_projection_where_his_applies():
    """Craig, section 4.7: the tool's axis is turned into the plane that the arm and the point allow."""
    goals, near = projected(0)
    point, axis = goals[:, :3, 3], goals[:, :3, 2]
    square = np.stack([-point[:, 1], point[:, 0], 0 * point[:, 0]], -1)
    square /= np.linalg.norm(square, axis=1, keepdims=True)
    into = axis - np.sum(axis * square, -1, keepdims=True) * square
    into /= np.linalg.norm(into, axis=1, keepdims=True)
    inside = reachable()
    mine = np.array(ikjax.fk(L3, near.branches.q))[:, :, :3, 2]
    np.testing.assert_allclose(
        mine[inside], np.broadcast_to(into[inside, None], mine[inside].shape), atol=1e-9
    )


def test_a_point_out_of_reach_is_approached_along_its_direction():
    goals, near = projected(0)
    distance = np.linalg.norm(goals[:, :3, 3], axis=1)
    beyond = distance > 0.71
    assert beyond.sum() > 20
    np.testing.assert_allclose(
        near.branches.position_error[beyond].min(-1), distance[beyond] - 0.7, atol=1e-9
    )


def test_refinement_ends_at_a_bottom_and_only_gains():
    _, near = projected()
    _, closed = projected(0)
    assert near.converged.mean() >= 0.999 and near.gradient_norm[near.converged].max() <= 1e-8
    assert (near.branches.cost <= closed.branches.cost * (1 + 1e-12) + 1e-30).all()
    assert (near.cost < 0.9 * closed.cost).mean() > 0.2


def multi_start(arm, goal, count, seed):
    """The best of `count` bounded least squares from random joints."""
    rng = np.random.default_rng(seed)
    low, high = np.array(arm.limits).T

    def residual(q):
        T = numpy_fk(q)
        turn = Rotation.from_matrix(T[:3, :3] @ goal[:3, :3].T).as_rotvec()
        return np.concatenate([T[:3, 3] - goal[:3, 3], LENGTH * turn])

    table = [np.array(getattr(arm, name)) for name in ("a", "alpha", "d", "theta", "base", "tool")]

    def numpy_fk(q):
        a, alpha, d, theta, base, tool = table
        T = base
        for i, kind in enumerate(arm.kinds):
            turn, slide = (theta[i] + q[i], d[i]) if kind == "R" else (theta[i], d[i] + q[i])
            c, s = np.cos(turn), np.sin(turn)
            ca, sa = np.cos(alpha[i]), np.sin(alpha[i])
            rows = [[c, -s * ca, s * sa, a[i] * c], [s, c * ca, -c * sa, a[i] * s]]
            T = T @ np.array([*rows, [0, sa, ca, slide], [0, 0, 0, 1]])
        return T @ tool

    best = np.inf
    for _ in range(count):
        start = rng.uniform(np.clip(low, -np.pi, None), np.clip(high, None, np.pi))
        found = least_squares(residual, start, bounds=(low, high), xtol=1e-15, ftol=1e-15, gtol=1e-12)
        best = min(best, 2 * found.cost)
    return best


@pytest.mark.parametrize("name", ["motoman_l3"])
def test_no_multi_start_finds_a_nearer_pose(name):
    goals, near = projected()
    for k in range(4):
        best = multi_start(L3, goals[k], 8, k)
        assert near.cost[k] <= best * (1 + 1e-8)


def test_goals_that_the_arm_reaches_are_reached():
    q = np.random.default_rng(5).uniform(-3, 3, (500, 5))
    near = ikjax.project(L3, ikjax.fk(L3, q), LENGTH)
    assert near.cost.max() < 1e-20 and near.converged.all()
    off = np.abs((near.branches.q - q[:, None] + np.pi) % (2 * np.pi) - np.pi).max(-1).min(-1)
    assert np.quantile(off, 0.99) < 1e-7


@pytest.mark.slow
def test_derivatives_of_every_branch_are_those_of_differences_and_zero_where_there_is_no_goal():
    goals = jnp.asarray(np.concatenate([wild(L3, 8), np.full((1, 4, 4), np.nan)]))
    x, y, z = 0.7, -0.4, 0.5
    spin = jnp.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])

    @jax.jit
    def both(t):
        def answer(t):
            a = L3.a + t * jnp.array([0, 0.3, -0.2, 0, 0])
            alpha = L3.alpha + t * jnp.array([0, 0.2, -0.1, 0, 0.3])
            turn = jnp.eye(3) + t * spin + t * t * spin @ spin / 2 + t**3 * spin @ spin @ spin / 6
            moved = goals.at[:, :3, :3].set(turn @ goals[:, :3, :3]).at[:, :3, 3].add(0.3 * t)
            near = ikjax.project(
                dataclasses.replace(L3, a=a, alpha=alpha), moved, LENGTH, extra_starts=0
            ).branches
            return near.q, near.cost, near.position_error, near.rotation_error

        return jax.jvp(answer, (t,), (jnp.ones_like(t),))

    derivatives, step = both(0.0)[1], 1e-4
    near, far = ([both(sign * k * step)[0] for sign in (1, -1)] for k in (1, 2))
    for derivative, ahead, behind, further, before in zip(derivatives, *near, *far, strict=True):
        rough = (8 * (ahead - behind) - (further - before)) / (12 * step)
        np.testing.assert_allclose(derivative[:-1], rough[:-1], atol=2e-4 * (1 + np.abs(rough[:-1]).max()))
        assert np.isfinite(derivative).all()
    assert not derivatives[0][-1].any() and np.abs(derivatives[0][:-1]).max() > 0.1


TURRET = ikjax.Arm.from_dh(
    a=[0.05, 0.3, 0.25, 0.1], alpha=[np.pi / 2, 0, 0, 0], d=[0.3, 0, 0, 0], convention="standard"
)


def test_an_arm_of_few_joints_starts_beside_its_branches_too():
    """Two branches led a tenth of such goals astray."""
    near = jax.eval_shape(lambda goals: ikjax.project(TURRET, goals), jnp.zeros((3, 4, 4)))
    assert near.branches.cost.shape == (3, 2 + 28)


OTHERS = {
    "turret": TURRET,
    "scara": ikjax.robots.get("gx4_351s"),
    "puma560": ikjax.robots.get("puma560"),
    "stanford": ikjax.robots.get("stanford"),
    "none": ikjax.Arm.from_dh(
        a=[0.1, 0.3, 0.2, 0.05, 0],
        alpha=[1.0, 0.7, -1.1, 1.3, 0],
        d=[0.2, 0.05, 0.1, 0.1, 0.1],
        convention="standard",
    ),
}


@pytest.mark.long
@pytest.mark.parametrize("name", OTHERS)
def test_other_arms_are_projected_likewise(name):
    arm = OTHERS[name]
    goals = wild(arm, 100, share=(0.9, 1.5))
    near = ikjax.project(arm, goals, LENGTH)
    assert near.converged.mean() > 0.99
    low, high = np.array(arm.limits).T
    q = np.array(near.q)
    assert ((q >= low) & (q <= high)).all()
    for k in range(3):
        assert near.cost[k] <= multi_start(arm, goals[k], 8, k) * (1 + 1e-8)


def test_a_bare_wrist_meets_every_orientation(costly_dtype):
    """Three axes through a point, and no length to take for a unit."""
    turns = np.array([-1, 1, 0]) * np.pi / 2
    arm = ikjax.Arm.from_dh(a=[0] * 3, alpha=turns, d=[0] * 3, convention="standard", dtype=costly_dtype)
    goals = np.asarray(ikjax.pose(rpy=np.random.default_rng(0).uniform(-1, 1, (5, 3))), costly_dtype)
    ikjax.check_goals(arm, goals)
    # A gradient of `CONVERGED` in units of 1 m, where a radian counts as 0.1 m.
    flat = 2e-3 if costly_dtype == np.float32 else 1e-6
    start = np.full(3, 0.1, costly_dtype)
    # Eagerly the arm's zeros are known, inside jit they are not.
    for call in (ikjax.refine, jax.jit(ikjax.refine)):
        near = call(arm, goals, start)
        assert near.converged.all() and near.rotation_error.max() <= flat
        assert near.position_error.max() == 0
    assert ikjax.project(arm, goals).rotation_error.max() < 200 * np.finfo(costly_dtype).eps
    moves = ikjax.manipulability(arm, near.q)
    np.testing.assert_allclose(moves, abs(np.sin(near.q[:, 1])), rtol=1e-5)
    gradient = jax.grad(lambda a: ikjax.refine(dataclasses.replace(arm, a=a), goals, start).cost.sum())(arm.a)
    assert np.isfinite(gradient).all()


def test_a_gantry_without_lengths_is_solved_tracked_and_projected(dtype):
    arm = ikjax.Arm.from_dh(a=[0] * 2, alpha=[np.pi / 2, 0], d=[0] * 2, kinds="PP", convention="standard")
    arm = arm.astype(dtype)
    q = np.array([[0.3, -2.0], [4.0, 0.1]], dtype)
    goals = ikjax.fk(arm, q)
    sol = ikjax.solve(arm, goals).require()
    np.testing.assert_allclose(sol.q[:, 0], q, atol=1e-5)
    assert (np.asarray(sol.margin) > 0).all()
    path = ikjax.track(arm, goals, q[0])
    assert path.reached.all()
    np.testing.assert_allclose(ikjax.project(arm, goals, extra_starts=0).q, q, atol=1e-5)
    far = ikjax.solve(arm, jnp.asarray(goals).at[:, :3, 3].add(1))
    assert np.isfinite(far.margin).all() and np.isfinite(ikjax.limit_clearance(arm, q)).all()
