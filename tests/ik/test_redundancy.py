"""`solve` of arms with a redundant joint, at given values of it."""

import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import ikjax
from ikjax.ik import redundancy

DTYPES = {"float32": 2e-5, "float64": 1e-9}


def rail():
    """A PUMA on a rail that is not quite level."""
    six = ikjax.robots.puma560()
    table = {key: np.concatenate([[0.0], getattr(six, key)]) for key in ("a", "alpha", "d", "theta")}
    table["alpha"][0] = np.pi / 2
    return ikjax.Arm.from_dh(
        **table,
        kinds="PRRRRRR",
        base=ikjax.pose(xyz=(0.1, 0.2, 0.3), rpy=(1.6, 0.1, 0.2)),
        tool=ikjax.pose(xyz=(0, 0.05, 0.1), rpy=(0.3, 0, 0)),
        convention="standard",
        name="rail",
    )


def iiwa_by_its_last():
    arm = ikjax.robots.iiwa14()
    table = {key: getattr(arm, key) for key in ("a", "alpha", "d", "theta", "limits")}
    return ikjax.Arm.from_dh(**table, convention="standard", redundant=7, name="iiwa by joint 7")


def off_its_table():
    """A Panda as calibrated: every axis is off by up to 5e-5."""
    arm = ikjax.robots.fer()
    off = np.random.default_rng(3).uniform(-1, 1, (8, 6)) * 5e-5
    return dataclasses.replace(arm, correction=jnp.asarray(off), name="calibrated")


def two_redundant():
    """A PUMA on a rail on a turntable."""
    arm = rail()
    table = {key: np.concatenate([[0.0], getattr(arm, key)]) for key in ("a", "alpha", "d", "theta")}
    table["a"][0], table["alpha"][0] = 0.2, -np.pi / 2
    return ikjax.Arm.from_dh(**table, kinds="R" + arm.kinds, convention="standard", name="turntable")


ARMS = {
    **{name: functools.partial(ikjax.robots.get, name) for name in ikjax.robots.names()},
    "rail": rail,
    "iiwa by joint 7": iiwa_by_its_last,
    "calibrated": off_its_table,
    "turntable": two_redundant,
}
EVERY = [
    "fer",
    "iiwa14",
    "xarm7",
    "gen3",
    "gen72",
    "rm75",
    "iiwa by joint 7",
    "rail",
    "calibrated",
    "turntable",
]
SOME = ["fer", "rail"]


def some_or_slow(*quick):
    return [name if name in quick else pytest.param(name, marks=pytest.mark.slow) for name in EVERY]


@functools.cache
def build(name):
    return ARMS[name]()


def made(name, count, dtype=np.float64, seed=0):
    """An arm, joints, the goals that they reach, and the values of its redundant joints."""
    arm = build(name)
    q = np.random.default_rng(seed).uniform(-2.8, 2.8, (count, arm.n))
    q = q * np.where([kind == "R" for kind in arm.kinds], 1, 0.3)
    given = q[:, arm.locked[0]] if len(arm.locked) == 1 else q[:, arm.locked]
    return arm, q, np.asarray(ikjax.fk(arm, q), dtype), given.astype(dtype)


def apart(arm, one, other):
    off = np.asarray(one, float) - other
    turning = [kind == "R" for kind in arm.kinds]
    return np.abs(np.where(turning, (off + np.pi) % (2 * np.pi) - np.pi, off)).max(-1)


@pytest.mark.parametrize("name", some_or_slow("fer", "rail", "iiwa14"))
def test_every_goal_is_answered_and_every_valid_slot_reaches_it(name, costly_dtype):
    dtype = costly_dtype
    arm, _, goals, given = made(name, 2000, dtype)
    sol = ikjax.solve(arm, goals, redundancy=given)
    assert sol.q.dtype == dtype and sol.q.shape == (2000, len(arm.branches), arm.n)
    valid = np.asarray(sol.valid)
    tolerance = DTYPES[np.dtype(dtype).name]
    # In float32 up to one goal in a thousand lies within the rounding of a fold.
    assert np.isfinite(sol.q).all() and (~valid.any(-1)).sum() <= (0 if dtype == np.float64 else 4)
    position, rotation = ikjax.pose_error(
        ikjax.fk(arm, np.asarray(sol.q, float)), np.asarray(goals, float)[:, None]
    )
    scale = 4 + np.abs(goals[:, None, :3, 3]).max()
    assert (np.asarray(position) / scale)[valid].max() < 1.5 * tolerance
    assert np.asarray(rotation)[valid].max() < 1.5 * tolerance
    for i, column in zip(arm.locked, np.reshape(given, (2000, -1)).T, strict=True):
        np.testing.assert_allclose(sol.q[..., i], np.broadcast_to(column[:, None], valid.shape), rtol=1e-6)


@pytest.mark.parametrize("name", some_or_slow("fer"))
def test_the_joints_that_made_a_goal_are_among_its_slots(name, costly_dtype):
    report = ikjax.verify(build(name), 3000, dtype=costly_dtype)
    assert report.wrong == report.missing == 0 and report.none <= 1


def test_values_and_goals_broadcast_and_eager_is_as_jit():
    arm, _, goals, given = made("fer", 6)
    eager = ikjax.solve(arm, goals[:, None], redundancy=given[:4])
    assert eager.q.shape == (6, 4, 8, 7) and eager.is_pose.shape == (6, 4)
    jitted = jax.jit(lambda goals, r: ikjax.solve(arm, goals, redundancy=r))(goals[:, None], given[:4])
    np.testing.assert_array_equal(eager.valid, jitted.valid)
    np.testing.assert_allclose(eager.margin, jitted.margin, atol=1e-12)
    assert apart(arm, eager.q, np.asarray(jitted.q))[np.asarray(eager.valid)].max() < 1e-7
    one = ikjax.solve(arm, goals[2], redundancy=float(given[1]))
    np.testing.assert_array_equal(one.valid, eager.valid[2, 1])
    np.testing.assert_allclose(one.q, eager.q[2, 1], atol=1e-12)
    over = jax.vmap(lambda r: ikjax.solve(arm, goals[2], redundancy=r).margin)(given[:4])
    np.testing.assert_allclose(over, eager.margin[2], atol=1e-12)


def test_a_value_that_is_not_finite_masks_its_row_and_no_other():
    arm, _, goals, given = made("fer", 4)
    whole = ikjax.solve(arm, goals, redundancy=given)
    for bad in (np.nan, np.inf, -np.inf):
        sol = ikjax.solve(arm, goals, redundancy=np.where(np.arange(4) == 2, bad, given))
        assert not sol.valid[2].any() and not sol.continuum[2].any() and sol.is_pose.all()
        for field in ("q", "margin", "position_error", "rotation_error"):
            values = np.asarray(getattr(sol, field))
            assert np.isfinite(values).all()
            np.testing.assert_array_equal(values[[0, 1, 3]], np.asarray(getattr(whole, field))[[0, 1, 3]])
        assert (np.asarray(sol.margin[2]) < 0).all()
        with pytest.raises(ValueError, match="1 of 4 goals have no solution: goal 2"):
            sol.require()


def test_a_value_beyond_the_limits_is_solved_and_masked_by_within_limits():
    arm = build("fer")
    goal = ikjax.fk(arm, np.array([0.3, -0.5, 0.2, -1.8, 0.4, 1.9, 3.0]))
    sol = ikjax.solve(arm, goal, redundancy=3.0)
    assert sol.valid.any() and not ikjax.within_limits(arm, sol).valid.any()
    sol = ikjax.solve(arm, goal, redundancy=3.0 - 2 * np.pi)
    assert sol.valid.any() and not ikjax.within_limits(arm, sol).valid.any()
    goal = ikjax.fk(arm, np.array([0.3, -0.5, 0.2, -1.8, 0.4, 1.9, 0.7]))
    inside = ikjax.within_limits(arm, ikjax.solve(arm, goal, redundancy=0.7 + 2 * np.pi))
    assert inside.valid.any()
    np.testing.assert_allclose(np.asarray(inside.q)[np.asarray(inside.valid), 6], 0.7, atol=1e-12)


@pytest.mark.parametrize(
    ("name", "shape", "redundancy", "text"),
    [
        (
            "fer",
            (3,),
            None,
            r"fer has 7 joints: redundancy= must give the value of joint7 \[rad\] between -2.897",
        ),
        ("rail", (3,), None, r"the value of joint1 \[m\] between -inf and inf"),
        (
            "puma560",
            (3,),
            0.1,
            "redundancy= is for arms with more joints than a pose asks for: puma560 has 6",
        ),
        ("so101", (3,), 0.1, "so101 has 5, and none is redundant"),
        (
            "fer",
            (3,),
            np.zeros(2),
            r"must have shape \(...\) that broadcasts with the goals' \(3,\), got \(2,\)",
        ),
        ("turntable", (3,), np.zeros(3), r"redundancy must have shape \(..., 2\) for joint1 \[rad\]"),
        ("turntable", (3,), 0.0, r"redundancy must have shape \(..., 2\)"),
    ],
)
def test_a_wrong_redundancy_is_named(name, shape, redundancy, text):
    with pytest.raises(ValueError, match=text):
        ikjax.solve(build(name), np.zeros((*shape, 4, 4)), redundancy=redundancy)


# Gradients.


def regular(name, count=8):
    """A case whose slots are far from folds, and which of them are valid."""
    arm, _, goals, given = made(name, count, seed=1)
    sol = ikjax.solve(arm, goals, redundancy=given)
    far = np.asarray(sol.valid & ~sol.continuum) & (np.asarray(sol.margin) > 0.02)
    sigma = np.asarray(ikjax.jacobian(arm, sol.q))[..., list(arm.solved)]
    sigma[..., :3, :] /= 2
    far &= np.linalg.svd(sigma, compute_uv=False)[..., -1] > 0.03
    assert far.sum() > count
    return arm, goals, given, far


@pytest.mark.parametrize("name", some_or_slow("fer"))
def test_derivatives_by_the_redundant_joint_are_the_tangent_of_the_self_motion(name):
    arm, goals, given, far = regular(name)

    @jax.jit
    def of(r):
        sol = ikjax.solve(arm, goals, redundancy=r)
        return sol.q, sol.margin

    direction = np.random.default_rng(2).uniform(0.5, 1, given.shape)
    (q, _), (rate, margin_rate) = jax.jvp(of, (given,), (direction,))
    np.testing.assert_allclose(
        np.asarray(rate)[far][:, arm.locked[0]],
        np.broadcast_to(direction.reshape(len(given), -1)[:, :1], far.shape)[far],
    )
    # The tool stands still.
    still = jnp.einsum("...ij,...j", ikjax.jacobian(arm, q), rate)
    np.testing.assert_allclose(np.asarray(still)[far], 0, atol=1e-8)
    step = 1e-6
    (plus, m_plus), (minus, m_minus) = of(given + step * direction), of(given - step * direction)
    difference = (np.asarray(plus - minus) + np.pi) % (2 * np.pi) - np.pi
    np.testing.assert_allclose(np.asarray(rate)[far], difference[far] / (2 * step), rtol=1e-5, atol=1e-6)
    wanted = np.asarray(m_plus - m_minus)[far] / (2 * step)
    close = np.abs(np.asarray(margin_rate)[far] - wanted) < 1e-5 * (1 + np.abs(wanted))
    # A margin is a minimum of several, which has corners.
    assert close.mean() > 0.9


@pytest.mark.parametrize("name", some_or_slow())
def test_derivatives_by_goal_and_arm_hold_the_redundant_joint(name):
    arm, goals, given, far = regular(name)
    rng = np.random.default_rng(4)
    twist = rng.uniform(-1, 1, (len(given), 6))
    cross = np.cross(np.eye(3)[None], twist[:, None, 3:])
    rates = np.zeros(goals.shape)
    rates[:, :3, :3], rates[:, :3, 3] = cross @ goals[:, :3, :3], twist[:, :3]
    arm_rate = jax.tree.map(jnp.zeros_like, arm)
    arm_rate = dataclasses.replace(
        arm_rate,
        d=jnp.where(arm.d != 0, 0.3, 0.0),
        theta=jnp.full(arm.n, 0.2),
        a=jnp.where(arm.a != 0, 0.1, 0.0),
    )
    _, rate = jax.jvp(lambda a, g: ikjax.solve(a, g, redundancy=given).q, (arm, goals), (arm_rate, rates))
    q = ikjax.solve(arm, goals, redundancy=given).q
    _, moved = jax.jvp(lambda a, q: ikjax.fk(a, q), (arm, q), (arm_rate, rate))
    off = np.abs(np.asarray(moved) - rates[:, None])[far]
    assert off.max() < 1e-6
    assert (np.asarray(rate)[..., list(arm.locked)] == 0).all()


def test_reverse_mode_is_the_tangent_and_finite_with_a_bad_row():
    arm, goals, given, far = regular("fer", 4)

    @jax.jit
    def gradient(goals, r):
        def loss(goals, r):
            sol = ikjax.solve(arm, goals, redundancy=r)
            return jnp.sum(jnp.where(far[..., None], sol.q, 0)), sol.q

        return jax.grad(loss, argnums=(0, 1), has_aux=True)(goals, r)

    (_, by_r), q = gradient(goals, given)
    columns = np.asarray(ikjax.jacobian(arm, q))
    others = -np.linalg.solve(columns[..., :6], columns[..., 6:])[..., 0]
    wanted = np.where(far, 1 + others.sum(-1), 0).sum(-1)
    np.testing.assert_allclose(by_r, wanted, rtol=1e-6)
    bad_goals, bad_given = np.array(goals), np.array(given)
    bad_goals[1, 0, 3], bad_given[2] = np.nan, np.nan
    both, _ = gradient(bad_goals, bad_given)
    assert all(np.isfinite(x).all() for x in both)
    np.testing.assert_allclose(np.asarray(both[1])[[0, 3]], np.asarray(by_r)[[0, 3]], rtol=1e-9)


# Edges: the wrist, the elbow and the shoulder straight, alone and together.


@pytest.mark.parametrize("name", ["fer", "iiwa14"])
def test_singular_goals_are_answered_with_finite_derivatives(name):
    arm = build(name)
    steps = [0.0, *10.0 ** -np.arange(1, 17)]
    base = np.array([0.4, -0.6, 0.3, -1.2, 0.5, 0.8, 0.2])
    q = np.stack(
        [
            np.where(np.isin(np.arange(7), zeros), step, base)
            for zeros in ((5,), (3,), (1,), (1, 3), (3, 5), (1, 3, 5))
            for step in steps
        ]
    )
    goals, given = ikjax.fk(arm, q), q[:, arm.locked[0]]

    def answer(r):
        sol = ikjax.solve(arm, goals, redundancy=r)
        return sol.q, sol.valid

    _, rate, valid = jax.jvp(answer, (given,), (np.ones(len(q)),), has_aux=True)
    assert np.asarray(valid).any(-1).all()
    assert np.isfinite(rate).all()


def test_values_are_spread_over_limits_or_a_turn_or_two_reaches():
    middles = redundancy.middles(build("fer").baked(), 4, np.float32)
    assert middles.shape == (4, 1) and middles.dtype == np.float32
    np.testing.assert_allclose(middles[:, 0], 2.8973 * np.array([-0.75, -0.25, 0.25, 0.75]), rtol=1e-6)
    # Joint 7 of the xArm may turn twice round, joint 1 of the Gen3 without an end: one turn is enough.
    for name in ("xarm7", "gen3"):
        values = redundancy.with_ends(build(name).baked(), 5, np.float64)
        np.testing.assert_allclose(values, np.linspace(-np.pi, np.pi, 5))
    arm = dataclasses.replace(build("rail"), limits=np.array([[1, np.inf], *build("rail").limits[1:]]))
    low, high = redundancy.redundant_range(arm.baked(), 0, np.float64)
    assert low == 1 and high - low == pytest.approx(2 * ikjax.arm.forward.reach(arm.baked()))
    both = redundancy.middles(build("turntable").baked(), 3, np.float64)
    assert both.shape == (9, 2) and len(np.unique(both[:, 0])) == len(np.unique(both[:, 1])) == 3


def test_a_path_is_followed_by_seven_joints():
    arm = build("fer")
    q0 = np.array([0.2, -0.4, 0.1, -1.9, 0.3, 1.8, 0.5])
    start = np.asarray(ikjax.fk(arm, q0))
    goals = np.repeat(start[None], 12, 0)
    goals[:, 0, 3] += 0.01 * np.arange(12)
    path = ikjax.track(arm, goals, q0)
    assert path.q.shape == (12, 7) and path.followed.all() and path.reached.all()
    assert not path.jumped.any()
    # The least motion that follows is 0.04 rad a step.
    assert np.linalg.norm(np.diff(path.q, axis=0), axis=-1).max() < 0.12
    np.testing.assert_allclose(ikjax.fk(arm, path.q), goals, atol=1e-8)


def test_projection_takes_seven_joints_as_it_did():
    arm = build("fer")
    goal = ikjax.fk(arm, np.array([0.2, -0.4, 0.1, -1.9, 0.3, 1.8, 0.5]))
    near = ikjax.project(arm, goal)
    assert near.converged and near.position_error < 1e-8 and near.branches.q.shape == (64, 7)
