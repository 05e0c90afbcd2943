"""Slopes of joints and margins: against differences, the implicit formula, each other, and edges."""

import dataclasses
import functools

import arms
import every
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import ikjax

LEAVES = ("a", "alpha", "d", "theta", "base", "tool")
FREE = {
    "puma560": {"a": [1, 2], "alpha": [], "d": [0, 2, 3, 5]},
    "ur5": {"a": [1, 2], "alpha": [], "d": [0, 3, 4, 5]},
    "RRR, wrist": {"a": [0, 1, 2], "alpha": [0, 1, 2], "d": [0, 1, 2, 3, 5]},
    "RRP, wrist": {"a": [0, 1, 2], "alpha": [0, 1, 2], "d": [0, 1, 3, 5]},
    "skew wrist": {"a": [0, 1, 2], "alpha": [0, 1, 2, 3, 4], "d": [0, 1, 2, 3, 5]},
    "wrist first, RRRRRR": {"a": [3, 4], "alpha": [0, 1, 3, 4], "d": [0, 3, 4, 5]},
    "2, 3, 4 parallel": {"a": [0, 1, 2, 3, 4, 5], "alpha": [0, 3, 4], "d": [0, 1, 4, 5]},
    "RRR, point": {"a": [0, 1, 2], "alpha": [0, 1], "d": [0, 1, 2]},
    "SCARA RRPR": {"a": [0, 1], "alpha": [], "d": [0, 3]},
    "turret": {"a": [1, 2, 3], "alpha": [], "d": [0]},
    "3R": {"a": [0, 1, 2], "alpha": [], "d": [0]},
    "RPR": {"a": [0], "alpha": [], "d": []},
    "2R": {"a": [0, 1], "alpha": [], "d": []},
}
"""Entries of the table that may change without leaving the family: those that are not zero there, so that
the kernel's form stays; the joint offsets, base and tool always may."""


QUICK = ("puma560", "RRR, point", "SCARA RRPR", "3R", "RPR", "2R")
EVERY = [pytest.param(name, marks=() if name in QUICK else pytest.mark.long) for name in FREE]


def build(name):
    return arms.build(name) if name in ikjax.robots.names() else every.build(name)


@pytest.fixture(autouse=True)
def _x64():
    with jax.enable_x64(True):
        yield


def case(name, count=24):
    """An arm, goals, and which slots are valid and regular."""
    arm = build(name).astype(np.float64)
    q = every.joints(arm, count, seed=11)
    goals = jnp.asarray(arms.numpy_fk(arm, q))
    sol = ikjax.solve(arm, goals)
    regular = np.asarray(sol.valid & (sol.margin > 1e-2) & ~sol.continuum)
    least = np.where(regular, every.sigma_min(arm, np.asarray(sol.q)), 0)
    return arm, goals, sol, least > 2e-2


def moved(goals, twist):
    """Goals shifted and turned about the world's axes, to second order."""
    x, y, z = twist[3:]
    w = jnp.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    rotation = (jnp.eye(3) + w + w @ w / 2) @ goals[..., :3, :3]
    return goals.at[..., :3, :3].set(rotation).at[..., :3, 3].add(twist[:3])


def in_plane(arm, twist):
    """What an arm of few joints can follow of a twist."""
    if arm.task.startswith("planar") or arm.family in ("scara", "turret"):
        up = np.asarray(arm.base)[:3, 2]
        if arm.task.startswith("planar"):
            twist[:3] -= up * (up @ twist[:3])
        twist[3:] = up * (up @ twist[3:])
    return twist


def differences(f, step=1e-6):
    """Derivative of f(t) at 0, fourth order."""
    near, far = f(step) - f(-step), f(2 * step) - f(-2 * step)
    return (8 * near - far) / (12 * step)


def agree(name, arm, q_of, ok, tolerance=1e-6):
    """jax.jvp of q_of(t) at t = 0 against differences of it."""
    q_of = jax.jit(q_of)
    _, slope = jax.jvp(q_of, (0.0,), (1.0,))
    wrapped = lambda t: np.asarray(q_of(0.0)) + arms.wrapped(np.asarray(q_of(t)) - np.asarray(q_of(0.0)))  # noqa: E731
    turning = np.array([kind == "R" for kind in arm.kinds])
    rough = differences(lambda t: np.where(turning, wrapped(t), np.asarray(q_of(t))))
    size = 1 + np.abs(rough).max(-1, keepdims=True)
    assert ok.sum() > 10, name
    assert (np.abs(slope - rough) / size)[ok].max() < tolerance, name


@pytest.mark.parametrize("name", EVERY)
def test_joints_follow_the_goal_and_every_free_leaf(name):
    arm, goals, _, ok = case(name)
    rng = np.random.default_rng(2)
    if arm.family != "turret":
        twist = jnp.asarray(in_plane(arm, rng.normal(size=6)))
        agree(name, arm, lambda t: ikjax.solve(arm, moved(goals, t * twist)).q, ok)
    rates = {key: np.zeros(arm.n) for key in ("a", "alpha", "d", "theta")}
    for key, places in FREE[name].items():
        rates[key][places] = rng.normal(size=len(places))
    rates["theta"] = rng.normal(size=arm.n)
    for i, kind in enumerate(arm.kinds):
        if kind == "P":
            rates["theta"][i], rates["d"][i] = 0, rng.normal()
    if arm.family in ("scara", "turret") or arm.task.startswith("planar"):
        twist = in_plane(arm, rng.normal(size=6))
    else:
        twist = rng.normal(size=6)

    def along(t):
        columns = {key: getattr(arm, key) + t * rate for key, rate in rates.items()}
        other = dataclasses.replace(arm, **columns, base=moved(arm.base, t * twist))
        return ikjax.solve(other, goals).q

    if arm.family != "turret":
        agree(name, arm, along, ok, 3e-6)


@pytest.mark.parametrize("name", ["3R", pytest.param("puma560", marks=pytest.mark.long)])
def test_forward_is_reverse(name):
    arm, goals, sol, _ = case(name, 6)
    weights = jnp.asarray(np.random.default_rng(4).normal(size=sol.q.shape)) * sol.valid[..., None]

    def total(arm, goals):
        return (weights * ikjax.solve(arm, goals).q).sum()

    rng = np.random.default_rng(5)
    rates = jax.tree.map(lambda x: jnp.asarray(rng.normal(size=x.shape)), (arm, goals))
    rates = (dataclasses.replace(rates[0], limits=jnp.zeros_like(arm.limits)), rates[1])
    finite = dataclasses.replace(arm, limits=jnp.zeros_like(arm.limits))
    forward = jax.jit(lambda p, t: jax.jvp(total, p, t)[1])((finite, goals), rates)
    back = jax.jit(jax.grad(total, (0, 1)))(finite, goals)
    products = jax.tree.map(lambda g, t: (g * t).sum(), back, rates)
    np.testing.assert_allclose(forward, sum(jax.tree.leaves(products)), rtol=1e-9)


@pytest.mark.parametrize("name", ["3R", pytest.param("puma560", marks=pytest.mark.long)])
def test_second_order_vmap_jit_and_remat_agree(name):
    arm, goals, _, ok = case(name, 24)
    goals = goals[ok.all(-1)][:4]

    def total(twist, goal, solve=ikjax.solve):
        found = solve(arm, moved(goal, twist))
        return jnp.where(found.valid[..., None], jnp.sin(found.q), 0).sum()

    slope = jax.jit(jax.grad(total))
    zero = jnp.zeros(6)
    goal = goals[0]
    second = jax.jit(jax.hessian(total))(zero, goal)
    step = 1e-5
    rough = np.stack(
        [(slope(zero.at[i].set(step), goal) - slope(zero.at[i].set(-step), goal)) for i in range(6)]
    )
    np.testing.assert_allclose(second, rough / (2 * step), atol=1e-5 * np.abs(second).max())
    np.testing.assert_allclose(second, second.T, atol=1e-6 * np.abs(second).max())
    one = np.stack([slope(zero, goal) for goal in goals])
    size = np.abs(one).max()
    many = jax.jit(jax.vmap(jax.grad(total), (None, 0)))(zero, goals)
    np.testing.assert_allclose(many, one, atol=1e-9 * size)
    summed = jax.jit(jax.grad(lambda twist: jax.vmap(total, (None, 0))(twist, goals).sum()))(zero)
    np.testing.assert_allclose(summed, one.sum(0), atol=1e-9 * size)
    again = jax.jit(jax.grad(functools.partial(total, solve=jax.checkpoint(ikjax.solve, static_argnums=()))))
    np.testing.assert_allclose(again(zero, goal), slope(zero, goal), atol=1e-9 * size)


def edges(arm, dtype):
    """Goals of which many are singular, on the boundary, out of reach or no goals at all."""
    rng = np.random.default_rng(8)
    q = rng.integers(-2, 3, (64, arm.n)) * np.pi / 2 + rng.choice([0, 1e-3, 1e-7, 1e-16], (64, arm.n))
    goals = np.concatenate([arms.numpy_fk(arm, every.joints(arm, 64)), arms.numpy_fk(arm, q)])
    stretch = arms.numpy_fk(arm, np.zeros((1, arm.n)))
    far = stretch.copy()
    far[:, :3, 3] *= 10
    bad = np.full((1, 4, 4), np.nan)
    return jnp.asarray(np.concatenate([goals, stretch, far, bad, np.zeros((1, 4, 4))]), dtype)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("name", EVERY)
def test_slopes_are_finite_at_every_edge(name, dtype):
    arm = build(name).astype(dtype)
    arm = dataclasses.replace(arm, limits=jnp.zeros_like(arm.limits))
    goals = edges(build(name).astype(np.float64), dtype)

    def total(arm, goals):
        sol = ikjax.solve(arm, goals)
        return (sol.q**2).sum() + sol.margin.sum()

    slopes = jax.jit(jax.grad(total, (0, 1)))(arm, goals)
    for slope in jax.tree.leaves(slopes):
        assert np.isfinite(slope).all()


def test_a_bad_row_leaves_the_sum_over_the_good_rows():
    arm, goals, _, _ = case("puma560", 40)
    mixed = goals.at[7].set(jnp.nan).at[20, :3, 3].set(jnp.inf)
    good = np.delete(np.arange(40), [7, 20])

    @jax.jit
    def slope(d, goals):
        return jax.grad(lambda d: jnp.sin(ikjax.solve(dataclasses.replace(arm, d=d), goals).q).sum())(d)

    # One program for both: the rows left out are filled with a row out of reach, whose slopes are zero.
    far = goals[0].at[:3, 3].multiply(100)
    np.testing.assert_array_equal(slope(arm.d, mixed), slope(arm.d, goals.at[jnp.array([7, 20])].set(far)))
    assert np.isfinite(slope(arm.d, mixed)).all() and len(good) == 38


def test_slots_that_reach_nothing_stand_still():
    arm, goals, _, _ = case("puma560", 3)
    far = goals.at[:, :3, 3].multiply(jnp.array([1, 100, 1])[:, None])
    slopes = jax.jit(jax.jacfwd(lambda t: ikjax.solve(arm, moved(far, t)).q))(jnp.zeros(6))
    assert not slopes[1].any() and slopes[0].any() and slopes[2].any()


def test_damping_bounds_the_slope_at_a_singularity():
    arm = build("puma560").astype(np.float64)
    q = jnp.array([0.3, -0.5, 0.4, 0.2, 0.0, 0.6])  # the wrist is straight
    goal = ikjax.fk(arm, q)

    def slope(damping):
        follow = lambda t: ikjax.solve(arm, moved(goal, t), q, damping=damping).q  # noqa: E731
        return np.abs(jax.jacfwd(follow)(jnp.zeros(6))).max()

    # A singular value s is inverted to s / (s^2 + damping^2), at most 1 / (2 damping).
    for damping in (1e-1, 1e-2, 1e-3):
        assert slope(damping) < 0.5 / damping * 3
    assert slope(1e-1) < 100
    # ... and where the arm is regular, slopes are short by (damping / sigma)^2 only.
    arm, goals, _, ok = case("puma560", 8)
    follow = lambda damping: jax.jacfwd(  # noqa: E731
        lambda t: ikjax.solve(arm, moved(goals, t), damping=damping).q
    )(jnp.zeros(6))
    off = np.abs(follow(1e-4) - follow(1e-6)).max((-1, -2))
    assert 0 < off[ok].max() < 1e-2


@pytest.mark.parametrize(
    "name", ["puma560", "ur5", "RRR, wrist", "2R", "3R", "SCARA RRPR", "2, 3, 4 parallel"]
)
def test_margins_have_their_own_slope_inside_and_outside(name):
    arm, goals, sol, _ = case(name)
    out = goals.at[:, :3, 3].add(1.5 * arms.reach(arm) * goals[:, :3, 0])
    for where in (goals, out):
        rng = np.random.default_rng(3)
        twist = jnp.asarray(in_plane(arm, rng.normal(size=6)))
        margin = jax.jit(lambda t, where=where, twist=twist: ikjax.solve(arm, moved(where, t * twist)).margin)
        _, slope = jax.jvp(margin, (0.0,), (1.0,))
        rough = differences(lambda t, margin=margin: np.asarray(margin(t)), 1e-7)
        assert np.isfinite(slope).all()
        close = np.abs(slope - rough) < 1e-4 * (1 + np.abs(rough))
        # Not where two steps are equally near to failing: there the least of them has a corner.
        assert close.mean() > 0.97
    assert (np.abs(np.asarray(sol.margin)) > 0).any()
