"""The textbooks' systems with the answers they print."""

import arms
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import ikjax
from ikjax.core.trig import Angle
from ikjax.solvers.context import Setting
from ikjax.solvers.families.planar import elbow_algebraic
from ikjax.solvers.steps.triangle import triangle

DEG = np.pi / 180


def _sets(arm, goal, inside: bool = False) -> set:
    """Valid joint values of one goal, rounded to 1e-9, each once."""
    sol = ikjax.solve(arm, jnp.asarray(goal, jnp.float64))
    sol = ikjax.within_limits(arm, sol) if inside else sol
    rows = np.asarray(sol.q)[np.asarray(sol.valid)]
    return {tuple(np.round(row, 9) + 0.0) for row in rows}


@pytest.mark.parametrize(
    ("point", "wanted"),
    [
        ((-1, 3**0.5, 5), [(90, 90, 1), (90, -90, -1), (-30, -90, 1), (-30, 90, -1)]),
        ((3**0.5, 1, 5), [(0, 90, 1), (0, -90, -1), (-120, -90, 1), (-120, 90, -1)]),
    ],
)
def test_the_first_three_joints_of_the_stanford_arm_give_the_printed_answers(point, wanted):
    """CS 4733 notes, with d1 = 5 and d2 = 1."""
    alpha = np.multiply([-90, 90, 0], DEG)
    arm = ikjax.Arm.from_dh(a=[0, 0, 0], alpha=alpha, d=[5, 1, 0], kinds="RRP", convention="standard")
    assert arm.family == "position" and len(arm.branches) == 4
    printed = {tuple(np.round([a * DEG, b * DEG, s * 3**0.5], 9) + 0.0) for a, b, s in wanted}
    assert _sets(arm, ikjax.pose(xyz=np.array(point, float))) == printed


def test_the_stanford_arm_has_eight_answers_and_limits_take_those_behind():
    arm = ikjax.robots.stanford()
    q = np.array([0.4, 1.2, 0.6, 0.3, -0.7, 0.9])
    goal = np.asarray(ikjax.fk(arm, q))
    every = ikjax.solve(arm, goal)
    assert np.asarray(every.valid).all()
    assert (np.asarray(every.q)[:, 2] > 0).sum() == 4
    inside = np.asarray(ikjax.within_limits(arm, every).valid)
    assert not inside[np.asarray(every.q)[:, 2] < 0].any()
    assert inside.any()
    np.testing.assert_allclose(
        ikjax.fk(arm, [0, np.pi / 2, 0.5, 0, 0, 0])[:3, 3], [0.763, 0.154, 0.412], atol=1e-12
    )


class TestTwoLinks:
    """Spong (1.5)-(1.8)."""

    def test_two_answers_inside_one_at_full_stretch_none_beyond(self):
        arm = ikjax.robots.planar_2r()
        points = np.array([[0.5, 0.3, 0], [0.9, 0, 0], [0.91, 0, 0], [0.05, 0, 0]])
        sol = ikjax.solve(arm, ikjax.pose(xyz=points))
        assert np.asarray(sol.valid).tolist() == [[True, True], [True, True], [False, False], [False, False]]
        np.testing.assert_allclose(sol.q[1], 0, atol=1e-7)
        assert np.abs(np.asarray(sol.q[0, 0] - sol.q[0, 1])).max() > 0.1
        np.testing.assert_allclose(np.asarray(sol.margin)[:, 0][[1, 2, 3]], [0, -0.01, -0.05], atol=1e-12)

    def test_a_continuum_at_the_origin_when_the_links_are_equal(self):
        arm = ikjax.robots.planar_2r(0.4, 0.4)
        sol = ikjax.solve(arm, ikjax.pose(xyz=np.zeros(3)), [0.7, 0.0])
        assert np.asarray(sol.valid).all() and np.asarray(sol.continuum).all()
        np.testing.assert_allclose(sol.q[:, 0], 0.7, atol=1e-12)

    def test_the_determinant_of_the_jacobian_is_that_of_the_lecture(self):
        arm = ikjax.robots.planar_2r()
        for q in np.random.default_rng(0).uniform(-3, 3, (10, 2)):
            J = np.asarray(ikjax.jacobian(arm, q))[:2]
            np.testing.assert_allclose(np.linalg.det(J), 0.5 * 0.4 * np.sin(q[1]), atol=1e-12)


def test_the_algebraic_and_the_geometric_solution_agree_on_a_million_goals():
    upper, fore = 0.5, 0.4
    rng = np.random.default_rng(1)
    t, bend = rng.uniform(-np.pi, np.pi, (2, 10**6))
    x = upper * np.cos(t) + fore * np.cos(t + bend)
    y = upper * np.sin(t) + fore * np.sin(t + bend)
    zero = Angle(0.0, 1.0, 0.0)
    setting = Setting((zero, zero), (0.0, 0.0, 0.0), 1e-14, 0.0, 0.0)

    @jax.jit
    def both(x, y):
        by_angles = triangle(x, y, upper, fore, 1, setting)
        shoulder, elbow = elbow_algebraic(x, y, upper, fore, 1)
        return jnp.stack(by_angles[:4]), jnp.stack([*shoulder, *elbow])

    first, second = both(jnp.asarray(x), jnp.asarray(y))
    # Both know cos(elbow) to rounding over the product of the links, and its sine to that over itself.
    allowed = 40 * np.finfo(float).eps / np.maximum(np.abs(np.sin(bend)), 1e-8) / np.hypot(x, y)
    assert (np.abs(np.asarray(first - second)).max(0) <= allowed).all()


class TestRPR:
    def test_both_lengths_are_answers(self):
        arm = ikjax.robots.planar_rpr(5.0)
        q = np.array([0.4, 7.0, 0.5])
        x, y = 7 * np.cos(0.4) + 5 * np.cos(0.9), 7 * np.sin(0.4) + 5 * np.sin(0.9)
        goal = ikjax.pose(xyz=[x, y, 0], rpy=[0, 0, 0.9])
        np.testing.assert_allclose(ikjax.fk(arm, q), goal, atol=1e-12)
        behind = (0.4 - np.pi, -7.0, 0.5 + np.pi - 2 * np.pi)
        assert _sets(arm, goal) == {tuple(np.round(q, 9)), tuple(np.round(behind, 9))}

    def test_a_link_that_always_points_up_is_a_coupled_prr(self):
        """The slides' second form: x = 7 c1 + 5 c3, y = 7 s1 + s + 5 s3, angles from the horizontal."""
        absolute = np.array([[1.0, 0, 0], [0, 1, 0], [0, -1, 1]])
        plain = ikjax.robots.planar_prr()
        arm = ikjax.Arm.from_dh(
            **{key: np.asarray(getattr(plain, key)) for key in ("a", "alpha", "d", "base")},
            kinds="PRR",
            coupling=absolute,
            convention="standard",
        )
        s, t1, t3 = 2.0, 0.4, 1.3
        x, y = 7 * np.cos(t1) + 5 * np.cos(t3), 7 * np.sin(t1) + s + 5 * np.sin(t3)
        goal = ikjax.pose(xyz=[x, y, 0], rpy=[0, 0, t3])
        np.testing.assert_allclose(ikjax.fk(arm, [s, t1, t3]), goal, atol=1e-12)
        found = _sets(arm, goal)
        assert found == {
            tuple(np.round((s, t1, t3), 9)),
            tuple(np.round((s + 14 * np.sin(t1), -t1, t3), 9)),
        }


class TestPRR:
    def test_forward_kinematics_are_those_of_the_slide_with_its_sign_mended(self):
        arm = ikjax.robots.planar_prr()
        s, t2, t3 = 6.0, 0.5, 0.8
        T = np.asarray(ikjax.fk(arm, [s, t2, t3]))
        x = -7 * np.sin(t2) - 5 * np.sin(t2 + t3)
        y = s + 7 * np.cos(t2) + 5 * np.cos(t2 + t3)
        np.testing.assert_allclose(T, ikjax.pose(xyz=[x, y, 0], rpy=[0, 0, t2 + t3 + np.pi / 2]), atol=1e-12)

    def _within(self, x, y, headings):
        arm = ikjax.robots.planar_prr()
        goals = np.stack([np.asarray(ikjax.pose(xyz=[x, y, 0.0], rpy=[0.0, 0.0, h])) for h in headings])
        sol = ikjax.within_limits(arm, ikjax.solve(arm, goals))
        return np.asarray(sol.q)[np.asarray(sol.valid)]

    def test_one_configuration_at_the_top_and_none_at_the_side(self):
        headings = np.arange(-180, 180) * DEG
        top = self._within(0.0, 22.0, headings)
        assert len(top) >= 1
        np.testing.assert_allclose(top, np.tile([10, 0, 0], (len(top), 1)), atol=1e-6)
        assert len(self._within(7.0, 1.0, headings)) == 0


def test_the_three_link_arm_takes_craigs_goal():
    arm = ikjax.robots.planar_3r()
    q = np.array([0.3, -0.8, 1.1])
    found = _sets(arm, np.asarray(ikjax.fk(arm, q)))
    assert tuple(np.round(q, 9)) in found and len(found) == 2


OTHERS = ("planar_2r", "planar_3r", "planar_rpr", "planar_prr", "gx4_351s", "stanford")


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
@pytest.mark.parametrize("name", OTHERS)
def test_the_catalogue_recovers_its_joints(name, dtype):
    arm = ikjax.robots.get(name)
    low, high = np.asarray(arm.limits).T
    turning = np.array([kind == "R" for kind in arm.kinds])
    low, high = np.where(np.isfinite(low), low, -1), np.where(np.isfinite(high), high, 1)
    low, high = np.where(turning, np.maximum(low, -3), low), np.where(turning, np.minimum(high, 3), high)
    q = np.random.default_rng(2).uniform(low, high, (200, arm.n))
    goals = arms.numpy_fk(arm, q)
    sol = arms.solve_by_hand(arm, goals, dtype=dtype)
    off = np.abs(sol.q - q[:, None])
    off = np.where(turning, np.abs(arms.wrapped(off)), off).max(-1)
    near = np.where(sol.valid, off, np.inf).min(-1)
    assert np.quantile(near, 0.97) < (1e-8 if dtype == np.float64 else 5e-3)


@pytest.mark.parametrize("name", ["planar_prr", "stanford"])
def test_margins_of_the_catalogue_have_finite_gradients(name):
    arm = ikjax.robots.get(name).astype(np.float64)
    goals = arms.numpy_fk(arm, np.random.default_rng(2).uniform(-2, 2, (5, arm.n)))
    gradient = jax.jit(jax.grad(lambda T: ikjax.solve(arm, T).margin.sum()))(jnp.asarray(goals))
    assert np.isfinite(gradient).all() and gradient.any()
