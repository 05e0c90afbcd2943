"""Derivatives of joints and margins: against differences, the implicit formula, each other, and edges."""

import dataclasses
import functools
import itertools

import arm_patterns
import arms
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import ikjax
from ikjax.solvers.families import FAMILIES

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
    "planar_prr": {"a": [1, 2], "alpha": [], "d": []},
    "2R": {"a": [0, 1], "alpha": [], "d": []},
}
"""Entries of the table that may change without leaving the family: those that are not zero there, so that
the kernel's form stays; the joint offsets, base and tool always may."""


TYPES = (np.float32, np.float64)


def _mark(quick: bool, slow: bool):
    return () if quick else pytest.mark.slow if slow else pytest.mark.long


QUICK = ("puma560", "3R")
SLOW = ("RRR, point", "SCARA RRPR", "RPR", "planar_prr", "2R", "five axes, lateral")
FOLLOWED = [
    # The PUMA compiles longest, and the point's quartic has all it has.
    pytest.param(name, marks=_mark(name in ("3R", "2R", "RPR"), name in QUICK + SLOW))
    for name in FREE
    if name != "turret"
]
EITHER = [
    # Each arm is compiled in one type, in turn; the long form tries both.
    pytest.param(
        name,
        dtype,
        marks=_mark(
            (name, dtype) in zip(QUICK, itertools.cycle(TYPES)),
            (name, dtype) in zip(SLOW, itertools.cycle(TYPES)),
        ),
    )
    for name in (*FREE, "five axes, lateral")
    for dtype in TYPES
]


def build(name):
    return arms.build(name) if name in ikjax.robots.names() else arm_patterns.build(name)


@pytest.fixture(autouse=True)
def _x64():
    with jax.enable_x64(True):
        yield


def case(name, count=24):
    """An arm, goals, and which slots are valid and regular."""
    arm = build(name).astype(np.float64)
    q = arm_patterns.joints(arm, count, seed=11)
    goals = jnp.asarray(arms.numpy_fk(arm, q))
    sol = ikjax.solve(arm, goals)
    regular = np.asarray(sol.valid & (sol.margin > 1e-2) & ~sol.continuum)
    least = np.where(regular, arm_patterns.sigma_min(arm, np.asarray(sol.q)), 0)
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
        up = np.asarray(ikjax.jacobian(arm, np.zeros(arm.n)))[3:, arm.kinds.index("R")]
        if arm.task.startswith("planar"):
            twist[:3] -= up * (up @ twist[:3])
        twist[3:] = up * (up @ twist[3:])
    return twist


def differences(f, step=1e-6):
    """Derivative of f(t) at 0, fourth order."""
    near, far = f(step) - f(-step), f(2 * step) - f(-2 * step)
    return (8 * near - far) / (12 * step)


def agree(arm, moved_q, ok, tolerance):
    """The derivative of moved_q(t) at t = 0 against differences of it; moved_q gives both."""
    start, derivative = map(np.asarray, moved_q(0.0))
    turning = np.array([kind == "R" for kind in arm.kinds])

    def unwrapped(t):
        q = np.asarray(moved_q(t)[0])
        return np.where(turning, start + arms.wrapped(q - start), q)

    rough = differences(unwrapped)
    size = 1 + np.abs(rough).max(-1, keepdims=True)
    assert ok.sum() > 10
    assert (np.abs(derivative - rough) / size)[ok].max() < tolerance


def random_rates(name, arm, rng):
    """Rates of the free entries of the table, and twists of the base and of the goals."""
    rates = {key: np.zeros(arm.n) for key in ("a", "alpha", "d", "theta")}
    for key, places in FREE[name].items():
        rates[key][places] = rng.normal(size=len(places))
    for i, kind in enumerate(arm.kinds):
        rates["theta" if kind == "R" else "d"][i] = rng.normal()
    return rates, in_plane(arm, rng.normal(size=6)), in_plane(arm, rng.normal(size=6))


@pytest.mark.parametrize("name", FOLLOWED)
def test_joints_follow_the_goal_and_every_free_leaf(name):
    arm, goals, _, ok = case(name)
    rng = np.random.default_rng(2)

    @jax.jit
    def both(t, rates):
        def q(t):
            columns, base, twist = rates
            columns = {key: getattr(arm, key) + t * rate for key, rate in columns.items()}
            other = dataclasses.replace(arm, **columns, base=moved(arm.base, t * base))
            return ikjax.solve(other, moved(goals, t * twist)).q

        return jax.jvp(q, (t,), (jnp.ones_like(t),))

    columns, base, twist = random_rates(name, arm, rng)
    fixed = {key: 0 * rate for key, rate in columns.items()}
    for rates in ((columns, base, 0 * twist), (fixed, 0 * base, twist), (columns, 0 * base, twist)):
        agree(arm, lambda t, rates=rates: both(jnp.asarray(t), rates), ok, 3e-6)


@pytest.mark.slow
def test_joints_of_a_known_arm_follow_the_goal():
    arm, goals, _, ok = case("SCARA RRPR")
    twist = jnp.asarray(in_plane(arm, np.random.default_rng(2).normal(size=6)))
    follow = jax.jit(
        lambda t: jax.jvp(lambda t: ikjax.solve(arm, moved(goals, t * twist)).q, (t,), (jnp.ones_like(t),))
    )
    agree(arm, lambda t: follow(jnp.asarray(t)), ok, 1e-6)


ONE_OF_EACH = {
    "ortho_parallel_wrist": "puma560",
    "three_parallel": "ur5",
    "pieper": "RRR, wrist",
    "pieper_reversed": "wrist first, RRRRRR",
    "parallel_axes": "2, 3, 4 parallel",
    "offset_wrist": "offset wrist",
    "offset_wrist_reversed": "offset wrist, reversed",
    "scara": "SCARA RRPR",
    "five_axis": "five axes, lateral",
    "turret": "turret",
    "planar_pose": "3R",
    "planar_position": "2R",
    "position": "RRR, point",
}


@pytest.mark.timeout(1800)
@pytest.mark.parametrize(
    "family",
    [
        pytest.param(family, marks=_mark(False, family.startswith("planar") or family in ("scara", "turret")))
        for family in FAMILIES
    ],
)
def test_forward_is_reverse_in_every_leaf(family):
    arm, goals, sol, ok = case(ONE_OF_EACH[family], 12)
    assert arm.family == family and ok.sum() > 10
    rng = np.random.default_rng(4)
    weights = [jnp.asarray(rng.normal(size=x.shape)) for x in (sol.q, sol.margin)]
    # Near a singularity the two solve what rounding has already decided.
    weights[0] = jnp.where(ok[..., None], weights[0], 0)

    def total(leaves):
        sol = ikjax.solve(dataclasses.replace(arm, **leaves[0]), leaves[1])
        return (weights[0] * sol.q).sum() + (weights[1] * sol.margin).sum()

    leaves = {key: getattr(arm, key) for key in LEAVES}, goals
    rates = jax.tree.map(lambda x: jnp.asarray(rng.normal(size=x.shape)), leaves)
    several, form = jax.tree.flatten(rates)

    @jax.jit
    def along(leaves, rates):
        return jax.jvp(total, (leaves,), (jax.tree.unflatten(form, rates),))[1]

    places = range(len(several))
    forward = [along(leaves, [x * float(i == k) for k, x in enumerate(several)]) for i in places]
    back = jax.jit(jax.grad(total))(leaves)
    terms = [np.asarray(g * t) for g, t in zip(jax.tree.leaves(back), several, strict=True)]
    sizes = np.array([np.abs(x).sum() for x in terms])
    assert (sizes > 1e-3 * sizes.max()).sum() >= 4
    # A leaf that a plane's arm does not feel has the rounding of the others.
    allowed = 1e-12 * sizes + 1e-15 * sizes.sum()
    off = np.abs(np.array(forward) - [x.sum() for x in terms])
    assert (off <= allowed).all(), off / sizes


@pytest.mark.parametrize(
    "name", ["2R", *(pytest.param(name, marks=pytest.mark.long) for name in ("3R", "puma560"))]
)
@pytest.mark.slow
def test_second_order_vmap_jit_and_remat_agree(name):
    arm, goals, _, ok = case(name, 24)
    goals = goals[ok.all(-1)][:4]

    # A planar arm's goals stay in its plane.
    x, y, z = np.asarray(arm.base)[:3, :3].T
    plane = np.array([[*x, 0, 0, 0], [*y, 0, 0, 0], [0, 0, 0, *z]])
    ways = jnp.asarray(plane if arm.task.startswith("planar") else np.eye(6))

    def total(move, goal, solve=ikjax.solve):
        found = solve(arm, moved(goal, move @ ways))
        return jnp.where(found.valid[..., None], jnp.sin(found.q), 0).sum()

    # The gradient of a rematerialised solve, goal by goal, and the gradient of a batched one.
    again = functools.partial(total, solve=jax.checkpoint(ikjax.solve))
    each = jax.jit(jax.vmap(jax.grad(again), (None, 0)))
    summed = jax.jit(jax.grad(lambda move: jax.vmap(total, (None, 0))(move, goals).sum()))
    zero = jnp.zeros(len(ways))
    gradients = each(zero, goals)
    np.testing.assert_allclose(summed(zero), gradients.sum(0), atol=1e-9 * np.abs(gradients).max())
    second = jax.jit(jax.hessian(total))(zero, goals[0])
    step = 1e-5
    ahead, behind = (
        np.stack([each(row, goals)[0] for row in sign * step * np.eye(len(ways))]) for sign in (1, -1)
    )
    np.testing.assert_allclose(second, (ahead - behind) / (2 * step), atol=1e-5 * np.abs(second).max())
    np.testing.assert_allclose(second, second.T, atol=1e-6 * np.abs(second).max())


def edges(arm, dtype):
    """Goals of which many are singular, on the boundary, out of reach or no goals at all."""
    rng = np.random.default_rng(8)
    q = rng.integers(-2, 3, (64, arm.n)) * np.pi / 2 + rng.choice([0, 1e-3, 1e-7, 1e-16], (64, arm.n))
    goals = np.concatenate([arms.numpy_fk(arm, arm_patterns.joints(arm, 64)), arms.numpy_fk(arm, q)])
    stretch = arms.numpy_fk(arm, np.zeros((1, arm.n)))
    far = stretch.copy()
    far[:, :3, 3] *= 10
    bad = np.full((1, 4, 4), np.nan)
    return jnp.asarray(np.concatenate([goals, stretch, far, bad, np.zeros((1, 4, 4))]), dtype)


@pytest.mark.parametrize(("name", "dtype"), EITHER)
def test_gradients_are_finite_at_every_edge(name, dtype):
    arm = build(name).astype(dtype)
    arm = dataclasses.replace(arm, limits=jnp.zeros_like(arm.limits))
    goals = edges(build(name).astype(np.float64), dtype)

    def total(arm, goals):
        sol = ikjax.solve(arm, goals)
        return (sol.q**2).sum() + sol.margin.sum()

    gradients = jax.jit(jax.grad(total, (0, 1)))(arm, goals)
    for gradient in jax.tree.leaves(gradients):
        assert np.isfinite(gradient).all()


@pytest.mark.parametrize("name", ["SCARA RRPR", pytest.param("puma560", marks=pytest.mark.long)])
def test_a_bad_row_leaves_the_sum_over_the_good_rows(name):
    arm, goals, _, _ = case(name, 40)
    mixed = goals.at[7].set(jnp.nan).at[20, :3, 3].set(jnp.inf)
    good = np.delete(np.arange(40), [7, 20])

    @jax.jit
    def gradient(d, goals):
        return jax.grad(lambda d: jnp.sin(ikjax.solve(dataclasses.replace(arm, d=d), goals).q).sum())(d)

    # One program for both: the rows left out are filled with a row out of reach, whose gradients are zero.
    far = goals[0].at[:3, 3].multiply(100)
    np.testing.assert_array_equal(
        gradient(arm.d, mixed), gradient(arm.d, goals.at[jnp.array([7, 20])].set(far))
    )
    assert np.isfinite(gradient(arm.d, mixed)).all() and len(good) == 38


@pytest.mark.parametrize("name", ["SCARA RRPR", pytest.param("puma560", marks=pytest.mark.long)])
def test_slots_that_reach_nothing_have_zero_derivatives(name):
    arm, goals, _, _ = case(name, 12)
    far = goals.at[1, :3, 3].multiply(100.0)
    derivatives = jax.jit(jax.jacfwd(lambda t: ikjax.solve(arm, moved(far, t)).q))(jnp.zeros(6))
    assert not derivatives[1].any() and derivatives[0].any() and derivatives[2].any()


@pytest.mark.slow
def test_derivatives_of_many_goals_are_those_of_few(monkeypatch):
    arm, goals, _, _ = case("2R", 40)
    plane = jnp.asarray(in_plane(arm, np.ones(6)))

    def total(a, t):
        where = moved(goals, t * plane).reshape(2, 20, 4, 4)
        return jnp.sin(ikjax.solve(dataclasses.replace(arm, a=a), where).q).sum()

    def derivatives(a, t):
        forward = jax.jvp(lambda t: total(a, t), (t,), (jnp.ones_like(t),))[1]
        back = jax.grad(total, (0, 1))
        return forward, *back(a, t), *jax.jvp(back, (a, t), (jnp.ones_like(a), jnp.ones_like(t)))[1]

    whole = jax.jit(derivatives)(arm.a, jnp.zeros(()))
    monkeypatch.setattr(ikjax.ik.solve_gradient, "BLOCK", 12)
    blocked = jax.jit(lambda *x: derivatives(*x)).lower(arm.a, jnp.zeros(()))
    assert "while" in blocked.as_text()
    for one, other in zip(blocked.compile()(arm.a, jnp.zeros(())), whole, strict=True):
        np.testing.assert_allclose(one, other, atol=1e-12 * np.abs(other).max())


@pytest.mark.slow
def test_captured_goals_leave_shared_values_apart():
    """Constants of a jit make the program that arguments make: a division holds what is shared."""
    arm, goals, _, _ = case("2R", 24)

    def total(a, goals):
        sol = ikjax.solve(dataclasses.replace(arm, a=a), goals)
        return jnp.sin(sol.q).sum() + sol.margin.sum()

    passed = jax.jit(jax.grad(total)).lower(arm.a, goals).compile().as_text()
    captured = jax.jit(jax.grad(lambda a: total(a, goals))).lower(arm.a).compile().as_text()
    assert captured.count(" divide(") >= passed.count(" divide(") > 50


@pytest.mark.slow
def test_damping_bounds_the_derivative_at_a_singularity():
    arm = build("puma560").astype(np.float64)
    q = jnp.array([0.3, -0.5, 0.4, 0.2, 0.0, 0.6])  # the wrist is straight
    goal = ikjax.fk(arm, q)

    @jax.jit
    def jacobian(goals, damping):
        now = jnp.broadcast_to(q, (*goals.shape[:-2], arm.n))
        return jax.jacfwd(lambda t: ikjax.solve(arm, moved(goals, t), now, damping=damping).q)(jnp.zeros(6))

    _, goals, _, ok = case("puma560", 7)
    goals = jnp.concatenate([goal[None], goals])
    # A singular value s is inverted to s / (s^2 + damping^2), at most 1 / (2 damping).
    for damping in (1e-1, 1e-2, 1e-3):
        assert np.abs(jacobian(goals, damping)[0]).max() < 0.5 / damping * 3
    assert np.abs(jacobian(goals, 1e-1)[0]).max() < 100
    # ... and where the arm is regular, derivatives are short by (damping / sigma)^2 only.
    off = np.abs(jacobian(goals, 1e-4) - jacobian(goals, 1e-6)).max((-1, -2))[1:]
    assert 0 < off[ok].max() < 1e-2


MARGINS = ("puma560", "2R", "3R")
MORE_MARGINS = ("RRR, point", "ur5", "RRR, wrist", "SCARA RRPR", "2, 3, 4 parallel")


@pytest.mark.parametrize(
    "name", [*MARGINS, *(pytest.param(name, marks=pytest.mark.long) for name in MORE_MARGINS)]
)
def test_margins_have_their_own_derivative_inside_and_outside(name):
    arm, goals, _, _ = case(name)
    out = goals.at[:, :3, 3].add(1.5 * arms.reach(arm) * goals[:, :3, 0])
    twist = jnp.asarray(in_plane(arm, np.random.default_rng(3).normal(size=6)))

    @jax.jit
    def both(t, where):
        margin = lambda t: ikjax.solve(arm, moved(where, t * twist)).margin  # noqa: E731
        return jax.jvp(margin, (t,), (jnp.ones_like(t),))

    for where in (goals, out):
        margin = lambda t, where=where: np.asarray(both(jnp.asarray(t), where)[0])  # noqa: E731
        derivative, rough = both(jnp.asarray(0.0), where)[1], differences(margin, 1e-7)
        assert np.isfinite(derivative).all() and np.abs(derivative).max() > 0
        close = np.abs(derivative - rough) < 1e-4 * (1 + np.abs(rough))
        # Not where two steps are equally near to failing: there the least of them has a corner.
        assert close.mean() > 0.97


FEW = ("scara", "turret", "five_axis")
"""Families whose poses are fewer than all."""

LED = [family for family in FAMILIES if family not in ("turret", "five_axis")]


@pytest.mark.parametrize("family", FEW)
def test_margins_of_few_joints_lead_to_their_poses(family):
    """Goals moved off an arm's poses anyhow: as far as the margin says, and back along its gradient."""
    arm = build(ONE_OF_EACH[family]).astype(np.float64)
    size, ways = arms.reach(arm), np.diag([arms.reach(arm)] * 3 + [1.0] * 3)
    goals = arms.numpy_fk(arm, arm_patterns.joints(arm, 60, seed=3))
    inside = np.asarray(ikjax.solve(arm, goals).margin.max(-1)) > 0.05 * size
    assert inside.sum() > 20

    @jax.jit
    def look(goals):
        def best(move):
            sol = ikjax.solve(arm, jax.vmap(moved)(goals, move @ ways))
            return sol.margin.max(-1).sum(), (sol.margin.max(-1), sol.valid.any(-1))

        gradient, (margin, valid) = jax.grad(best, has_aux=True)(jnp.zeros((60, 6)))
        return gradient, margin, valid

    def put(goals, twists):
        goals, twists = goals.copy(), twists @ ways
        goals[:, :3, :3] = Rotation.from_rotvec(twists[:, 3:]).as_matrix() @ goals[:, :3, :3]
        goals[:, :3, 3] += twists[:, :3]
        return goals

    twists = 0.03 * np.random.default_rng(1).normal(size=(60, 6))
    goals = put(goals, twists)
    gradient, margin, valid = map(np.asarray, look(goals))
    assert not valid.any() and (margin < 0).all()
    assert (-margin <= 2 * size * np.linalg.norm(twists, axis=-1)).all()
    # Where a fold and the miss are left in turn, each step undoes a part of the one before.
    for _ in range(30):
        step = -margin[:, None] * gradient / np.maximum((gradient**2).sum(-1, keepdims=True), 1e-300)
        goals = put(goals, np.where(valid[:, None], 0, step))
        gradient, margin, valid = map(np.asarray, look(goals))
    assert valid[inside].all()


@pytest.mark.parametrize(
    "family", [pytest.param(family, marks=_mark(False, family == "planar_position")) for family in LED]
)
def test_margins_lead_in_from_outside(family):
    arm, count = build(ONE_OF_EACH[family]).astype(np.float64), 60
    size = arms.reach(arm)
    goals = jnp.asarray(arms.numpy_fk(arm, arm_patterns.joints(arm, count, seed=3)))
    out = np.asarray(goals)[:, :3, 3] - np.asarray(arm.base)[:3, 3]
    if arm.task.startswith("planar"):
        up = arm_patterns.plane_normal(arm)
        out = out - (out @ up)[:, None] * up
    out /= np.linalg.norm(out, axis=-1, keepdims=True)

    @jax.jit
    def gradient_at(points):
        def best(points):
            sol = ikjax.solve(arm, goals.at[:, :3, 3].set(points))
            return ikjax.smooth_max(sol.margin, 0.01 * size).sum(), sol.valid.any(-1)

        return jax.grad(best, has_aux=True)(points)

    points = np.asarray(goals[:, :3, 3]) + 0.8 * size * out
    outside = ~np.asarray(gradient_at(points)[1])
    for step in 0.05 * size * 0.975 ** np.arange(120):
        gradient, reached = map(np.asarray, gradient_at(points))
        way = gradient / np.maximum(np.linalg.norm(gradient, axis=-1, keepdims=True), 1e-300)
        points = np.where(reached[:, None], points, points + step * way)
    assert outside.mean() > 0.7 and np.asarray(gradient_at(points)[1])[outside].all()


@pytest.mark.long
@pytest.mark.parametrize("name", ["puma560", "ur5", "RRR, wrist"])
def test_gradients_of_a_million_goals_are_finite_half_of_them_at_edges(name, dtype):
    arm = build(name)
    pool = np.array(edges(arm.astype(np.float64), np.float64))
    count = 10**6
    picked = pool[np.random.default_rng(0).integers(0, len(pool), count // 2)]
    goals = np.concatenate([arms.numpy_fk(arm, arm_patterns.joints(arm, count // 2, seed=5)), picked]).astype(
        dtype
    )
    plain = dataclasses.replace(arm.astype(dtype), limits=jnp.zeros_like(arm.limits, dtype=dtype))

    @jax.jit
    def gradients(leaves, goals):
        def total(leaves, goals):
            sol = ikjax.solve(dataclasses.replace(plain, **leaves), goals)
            return sol.q.sum() + sol.margin.sum()

        return jax.grad(total, (0, 1))(leaves, goals)

    leaves = {key: getattr(plain, key) for key in LEAVES}
    for part in np.split(goals, 10):
        for gradient in jax.tree.leaves(gradients(leaves, jnp.asarray(part))):
            assert np.isfinite(gradient).all()


@pytest.mark.long
def test_one_bad_row_in_a_million_leaves_the_sum_over_the_others(dtype):
    arm, count = build("puma560"), 10**6
    goals = arms.numpy_fk(arm, arm_patterns.joints(arm, count, seed=6)).astype(dtype)
    arm = arm.astype(dtype)

    @jax.jit
    def gradients(leaves, goals):
        def total(leaves, goals):
            sol = ikjax.solve(dataclasses.replace(arm, **leaves), goals)
            return jnp.sin(sol.q).sum()

        return jax.grad(total, (0, 1))(leaves, goals)

    leaves = {key: getattr(arm, key) for key in LEAVES}
    # A row out of reach has no gradients: with it, the sum is that over the others, in the same order.
    far, bad = goals.copy(), goals.copy()
    far[4321, :3, 3] *= 100
    bad[4321] = np.nan
    wanted, got = (gradients(leaves, jnp.asarray(x)) for x in (far, bad))
    assert not np.asarray(wanted[1][4321]).any() and np.asarray(wanted[0]["a"]).any()
    for one, other in zip(jax.tree.leaves(wanted), jax.tree.leaves(got), strict=True):
        np.testing.assert_array_equal(one, other)


@pytest.mark.long
@pytest.mark.parametrize("name", list(FREE))
def test_derivatives_of_many_arms_are_those_of_differences_and_of_the_jacobian(name):
    """200 arms of a family with a goal each: along each leaf and the goal, wherever sigma_min > 1e-3."""
    arm, count = build(name).astype(np.float64), 200
    rng = np.random.default_rng(12)
    rates = {key: np.zeros((count, arm.n)) for key in ("a", "alpha", "d", "theta")}
    for key, places in FREE[name].items():
        rates[key][:, places] = rng.normal(size=(count, len(places)))
    for i, kind in enumerate(arm.kinds):
        rates["theta" if kind == "R" else "d"][:, i] = rng.normal(size=count)
    for key in ("base", "tool", "goal"):
        rates[key] = np.stack([in_plane(arm, rng.normal(size=6)) for _ in range(count)])
    if arm.task.startswith("planar") or arm.family == "scara":
        rates["tool"][:, 3:5] = 0  # turns about the last axis, as the arm does
        rates["tool"][:, 2] *= arm.family == "scara"
    if arm.task in ("position", "planar_position"):
        rates["tool"][:] = 0  # turns the goal's free orientation
    if arm.family == "turret":
        rates = {key: rate * (key in ("a", "d", "theta")) for key, rate in rates.items()}
    # Other arms of the family: only what may move has moved.
    several = {key: np.asarray(getattr(arm, key)) + 0.03 * rates[key] for key in ("a", "alpha", "d", "theta")}
    stack = jax.vmap(lambda leaves: dataclasses.replace(arm, **leaves))(several)
    goals = jax.vmap(ikjax.fk)(stack, arm_patterns.joints(arm, count, seed=13))

    def joints(arm, goal, rate, t):
        columns = {key: getattr(arm, key) + t * rate[key] for key in ("a", "alpha", "d", "theta")}
        mounts = {key: moved(getattr(arm, key), t * rate[key]) for key in ("base", "tool")}
        return ikjax.solve(dataclasses.replace(arm, **columns, **mounts), moved(goal, t * rate["goal"])).q

    @jax.jit
    @jax.vmap
    def along(arm, goal, rate, t):
        return jax.jvp(lambda t: joints(arm, goal, rate, t), (t,), (jnp.ones_like(t),))

    sol = jax.jit(jax.vmap(ikjax.solve))(stack, goals)
    valid = np.asarray(sol.valid & ~sol.continuum)
    J = np.asarray(jax.jit(jax.vmap(jax.vmap(ikjax.jacobian, (None, 0))))(stack, sol.q))
    least = np.stack(
        [
            arm_patterns.sigma_min(jax.tree.map(lambda x, i=i: x[i], stack), np.asarray(sol.q[i]))
            for i in range(count)
        ]
    )
    asked = valid & (least > 1e-3)
    assert asked.any(-1).mean() > 0.9
    # Differences of short steps are noisy, those of long ones bent: how much, is told by sigma_min.
    steps = np.where(asked, least, np.inf).min(-1, initial=0.1) ** 2 * np.array([[0.01], [0.05], [0.2]])
    turning = np.array([kind == "R" for kind in arm.kinds])
    for key in rates:
        one = {other: rate * (other == key) for other, rate in rates.items()}
        start, derivative = map(np.asarray, along(stack, goals, one, np.zeros(count)))

        def at(t, one=one, start=start):
            q = np.asarray(along(stack, goals, one, t)[0])
            return np.where(turning, arms.wrapped(q - start), q - start)

        rough = [(8 * (at(t) - at(-t)) - (at(2 * t) - at(-2 * t))) / (12 * t[:, None, None]) for t in steps]
        off = np.min([np.abs(derivative - r).max(-1) / (1 + np.abs(r).max(-1)) for r in rough], axis=0)
        # Two slots of a quartic may change names: then both jump.
        far = 2 * steps[-1]
        same = asked & (np.abs(at(far) - far[:, None, None] * derivative).max(-1) < 0.1)
        assert same.sum() > 0.98 * asked.sum()
        assert off[same].max() < 1e-6, (key, off[same].max())
        if key == "goal" and arm.task == "pose" and arm.n == 6:
            exact = np.linalg.solve(J[asked], np.repeat(rates[key], asked.sum(-1), axis=0)[..., None])[..., 0]
            np.testing.assert_allclose(derivative[asked], exact, rtol=1e-6, atol=1e-6 * np.abs(exact).max())


@pytest.mark.parametrize(
    "count", [pytest.param(10, marks=pytest.mark.slow), pytest.param(200, marks=pytest.mark.long)]
)
def test_derivatives_of_five_joints_follow_their_own_poses(count):
    """Goals that move with the arm, because no others are reached: along each leaf, and with the joints."""
    arm = build("five axes, lateral").astype(np.float64)
    rng, columns, mounts = np.random.default_rng(12), ("a", "alpha", "d", "theta"), ("base", "tool")
    rates = {key: np.zeros((count, arm.n)) for key in columns}
    for name in arm.free:
        rates[name[:-1]][:, int(name[-1]) - 1] = rng.normal(size=count)
    assert {name[:-1] for name in arm.free} == set(columns)
    rates |= {key: rng.normal(size=(count, 6)) for key in mounts}
    several = {key: np.asarray(getattr(arm, key)) + 0.03 * rates[key] for key in columns}
    stack = jax.vmap(lambda leaves: dataclasses.replace(arm, **leaves))(several)
    q, speed = arm_patterns.joints(arm, count, seed=13), rng.normal(size=(count, arm.n))

    def joints(arm, q, speed, rate, t):
        leaves = {key: getattr(arm, key) + t * rate[key] for key in columns}
        leaves |= {key: moved(getattr(arm, key), t * rate[key]) for key in mounts}
        other = dataclasses.replace(arm, **leaves)
        return ikjax.solve(other, ikjax.fk(other, q + t * speed)).q

    @jax.jit
    @jax.vmap
    def along(arm, q, speed, rate, t):
        return jax.jvp(lambda t: joints(arm, q, speed, rate, t), (t,), (jnp.ones_like(t),))

    zero = np.zeros(count)
    fixed = {key: 0 * rate for key, rate in rates.items()}
    start = np.asarray(along(stack, q, speed, fixed, zero)[0])
    valid = np.asarray(jax.jit(jax.vmap(ikjax.solve))(stack, jax.vmap(ikjax.fk)(stack, q)).valid)
    least = np.stack(
        [arm_patterns.sigma_min(jax.tree.map(lambda x, i=i: x[i], stack), start[i]) for i in range(count)]
    )
    asked = valid & (least > 1e-3)
    assert asked.any(-1).mean() > 0.9
    mine = asked & (np.abs(arms.wrapped(start - q[:, None])).max(-1) < 1e-6)
    assert mine.any(-1).mean() > 0.9
    steps = np.where(asked, least, np.inf).min(-1, initial=0.1) ** 2 * np.array([[0.01], [0.05], [0.2]])
    for key in (*rates, "q"):
        rate = {other: rate * (other == key) for other, rate in rates.items()}
        derivative = np.asarray(along(stack, q, speed, rate, zero)[1])
        # The slot that the goal was made of goes on with its joints.
        wanted = np.broadcast_to(speed[:, None], derivative.shape)[mine]
        np.testing.assert_allclose(derivative[mine], wanted, rtol=1e-6, atol=1e-6 * np.abs(wanted).max())

        def at(t, rate=rate):
            return arms.wrapped(np.asarray(along(stack, q, speed, rate, t)[0]) - start)

        rough = [(8 * (at(t) - at(-t)) - (at(2 * t) - at(-2 * t))) / (12 * t[:, None, None]) for t in steps]
        off = np.min([np.abs(derivative - r).max(-1) / (1 + np.abs(r).max(-1)) for r in rough], axis=0)
        assert off[asked].max() < 1e-6, (key, off[asked].max())


def test_reverse_mode_where_some_equations_depend_on_no_rate():
    """The lengths of a SCARA move nothing vertically: that right-hand side is a known zero."""
    arm = ikjax.robots.gx4_351s()
    goals = ikjax.fk(arm, np.random.default_rng(0).uniform(0.05, 0.1, (4, arm.n)))
    reverse, forward = (
        derivative(lambda a: ikjax.solve(dataclasses.replace(arm, a=a), goals).q.sum())(arm.a)
        for derivative in (jax.grad, jax.jacfwd)
    )
    np.testing.assert_allclose(reverse, forward, rtol=1e-9, atol=1e-9)
