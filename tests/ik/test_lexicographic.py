"""One error first and the other second, against constrained and bounded optimizers of scipy."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import least_squares, minimize
from scipy.spatial.transform import Rotation

import ikjax

ARM = ikjax.robots.get("so101")
LOW, HIGH = np.array(ARM.limits).T


def wild(arm, count, low, high, seed=0):
    """Goals that the arm's point reaches, then as many beyond it, turned anyhow."""
    q = np.random.default_rng(seed).uniform(low, high, (2 * count, arm.n))
    goals = np.array(ikjax.fk(arm, q))
    goals[:, :3, :3] = Rotation.random(2 * count, random_state=seed).as_matrix()
    goals[count:, :3, 3] *= 0.7 / np.linalg.norm(goals[count:, :3, 3], axis=1, keepdims=True)
    return goals


@functools.cache
def projected(priority="position"):
    goals = wild(ARM, 100, 0.6 * LOW, 0.6 * HIGH)
    # The steps of an eager call that every start takes: one program.
    return goals, ikjax.project(ARM, goals, priority=priority, steps=8, extra_starts=0)


def numpy_fk(arm):
    a, alpha, d, theta, base, tool = (
        np.array(getattr(arm, k)) for k in ("a", "alpha", "d", "theta", "base", "tool")
    )

    def fk(q):
        T = base
        for i in range(len(a)):
            c, s = np.cos(theta[i] + q[i]), np.sin(theta[i] + q[i])
            ca, sa = np.cos(alpha[i]), np.sin(alpha[i])
            rows = [[c, -s * ca, s * sa, a[i] * c], [s, c * ca, -c * sa, a[i] * s]]
            T = T @ np.array([*rows, [0, sa, ca, d[i]], [0, 0, 0, 1]])
        return T @ tool

    return fk


@pytest.mark.slow
def test_the_point_is_held_where_it_can_be_with_the_nearest_orientation():
    goals, near = projected()
    fk, q = numpy_fk(ARM), np.array(near.q)
    assert ((q >= LOW) & (q <= HIGH)).all()
    # A joint that its limit holds back stands on it, not where the point alone would rather have it.
    room = np.minimum(q - LOW, HIGH - q)[np.array(near.converged)]
    assert (room == 0).sum() > 10 and not ((room > 0) & (room < 1e-4)).any()
    inside = np.array(near.position_error)[:100]
    # From the four branches alone: limits keep some of them away from where they led.
    held = inside < 1e-12
    assert held.mean() > 0.85
    some = np.flatnonzero(held & np.array(near.converged)[:100])[:5]
    for k in some:
        goal = goals[k]

        def turned(q, goal=goal):
            return Rotation.from_matrix(fk(q)[:3, :3] @ goal[:3, :3].T).magnitude()

        on_point = {"type": "eq", "fun": lambda q, goal=goal: 10 * (fk(q)[:3, 3] - goal[:3, 3])}
        found = minimize(
            lambda q, turned=turned: turned(q) ** 2,
            q[k],
            bounds=list(zip(LOW, HIGH, strict=True)),
            constraints=on_point,
            method="SLSQP",
            options={"ftol": 1e-14, "maxiter": 300},
        )
        assert np.linalg.norm(fk(found.x)[:3, 3] - goal[:3, 3]) < 1e-8
        assert near.rotation_error[k] <= turned(found.x) + 1e-6


@pytest.mark.slow
def test_a_point_out_of_reach_is_approached_as_near_as_it_can_be():
    goals, near = projected()
    fk, rng = numpy_fk(ARM), np.random.default_rng(1)
    for k in range(100, 105):
        starts = rng.uniform(LOW, HIGH, (8, 5))
        gaps = [
            least_squares(
                lambda q, k=k: fk(q)[:3, 3] - goals[k, :3, 3], q0, bounds=(LOW, HIGH), xtol=1e-15, ftol=1e-15
            ).fun
            for q0 in starts
        ]
        least = min(map(np.linalg.norm, gaps))
        assert least > 0.05
        # The point is off the last axis: at full stretch two rolls are alike to 2e-5 m, each a minimum.
        assert abs(near.position_error[k] - least) < 1e-4


def test_one_error_first_starts_from_spread_joints_beside_the_branches():
    for priority, starts in (("weighted", 4 + 36), ("position", 4 + 64)):
        project = functools.partial(ikjax.project, ARM, priority=priority)
        assert jax.eval_shape(project, jnp.eye(4)).branches.cost.shape == (starts,)


def test_an_unknown_priority_is_named():
    with pytest.raises(ValueError, match="priority must be one of weighted"):
        ikjax.project(ARM, np.eye(4), priority="tool")


@pytest.mark.slow
def test_the_orientation_is_held_where_it_can_be():
    _, near = projected("orientation")
    _, point = projected("position")
    held = np.array(near.rotation_error) < 1e-12
    assert held.mean() > 0.5
    assert (near.position_error >= point.position_error - 1e-9).all()


@pytest.mark.slow
def test_it_means_what_the_closed_form_means():
    """Of an arm whose tool point is on its last axis: nothing is left to improve with the point held."""
    arm = ikjax.robots.get("motoman_l3")
    goals = wild(arm, 100, -2, 2)[:100]
    closed = ikjax.project(arm, goals, priority="position", steps=0)
    near = ikjax.project(arm, goals, priority="position")
    held = np.array(closed.position_error) < 1e-12
    assert held.mean() > 0.9 and near.position_error[held].max() < 1e-12
    np.testing.assert_allclose(near.rotation_error[held], closed.rotation_error[held], atol=2e-6)


@pytest.mark.slow
@pytest.mark.parametrize("priority", ["position", "orientation"])
def test_derivatives_are_those_of_differences(priority):
    goals = jnp.asarray(wild(ARM, 6, 0.6 * LOW, 0.6 * HIGH, seed=3)[:6])

    @jax.jit
    def answer(t):
        moved = goals.at[:, :3, 3].add(t * jnp.array([0.3, -0.2, 0.1]))
        near = ikjax.refine(ARM, moved, jnp.zeros(5), priority=priority)
        return near.q, near.converged

    _, derivative = jax.jvp(lambda t: answer(t)[0], (0.0,), (1.0,))
    h = 1e-4
    rough = (answer(h)[0] - answer(-h)[0]) / (2 * h)
    down = np.array(answer(0.0)[1] & answer(h)[1] & answer(-h)[1])
    assert down.sum() >= 3
    np.testing.assert_allclose(derivative[down], rough[down], atol=2e-3 * (1 + np.abs(rough[down]).max()))
