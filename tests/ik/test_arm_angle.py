"""The arm angle of arms with a spherical shoulder and a spherical wrist: measured, and given to `solve`."""

import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np
import oracle
import pytest

import ikjax
from ikjax.arm.recognition import arm_angle as recognition

Q = np.pi / 2


def offset_elbow():
    """Lengths like those of a Barrett WAM, whose elbow's axis is off the line of upper arm and forearm."""
    return ikjax.Arm.from_dh(
        a=[0, 0, 0.045, -0.045, 0, 0, 0],
        alpha=np.array([-Q, Q, -Q, Q, -Q, Q, 0]),
        d=[0, 0, 0.55, 0, 0.3, 0, 0.06],
        theta=[0.1, 0, 0, -0.2, 0, 0.3, 0],
        base=ikjax.pose(xyz=(0.1, 0.2, 0.3), rpy=(0.3, 0.2, 0.1)),
        tool=ikjax.pose(xyz=(0.1, 0.05, 0.1), rpy=(0.3, 0.2, 0.1)),
        convention="standard",
        name="offset elbow",
    )


def equal_links():
    """Its wrist can be folded onto its shoulder."""
    arm = ikjax.robots.iiwa7()
    return dataclasses.replace(arm, name="equal links")


def off_its_table():
    off = np.random.default_rng(3).uniform(-1, 1, (8, 6)) * 5e-5
    return dataclasses.replace(ikjax.robots.iiwa14(), correction=jnp.asarray(off), name="calibrated")


ARMS = {
    **{name: functools.partial(ikjax.robots.get, name) for name in ("iiwa14", "rm75")},
    "offset elbow": offset_elbow,
    "equal links": equal_links,
    "calibrated": off_its_table,
}
TOLERANCE = {"float32": 2e-5, "float64": 1e-9}


@functools.cache
def build(name):
    return ARMS[name]()


def made(name, count=64, reference="axis1", seed=0):
    """An arm, joints, their goals and arm angles."""
    arm = build(name)
    q = np.random.default_rng(seed).uniform(-2.8, 2.8, (count, 7))
    return arm, q, np.asarray(ikjax.fk(arm, q)), np.asarray(ikjax.arm_angle(arm, q, reference=reference))


def turned(x):
    return np.abs((np.asarray(x, float) + np.pi) % (2 * np.pi) - np.pi)


@pytest.mark.parametrize("reference", ["axis1", "stereographic"])
@pytest.mark.parametrize("name", ["iiwa14", "offset elbow", pytest.param("rm75", marks=pytest.mark.slow)])
def test_all_eight_slots_reach_the_goal_at_the_angle(name, reference, dtype):
    arm, q, goals, angle = made(name, 2000, reference)
    sol = ikjax.solve(arm, goals.astype(dtype), arm_angle=angle.astype(dtype), reference=reference)
    assert sol.q.shape == (2000, 8, 7) and sol.q.dtype == dtype and np.isfinite(sol.q).all()
    assert np.asarray(sol.valid).all() and not np.asarray(sol.continuum).any()
    position, rotation = ikjax.pose_error(ikjax.fk(arm, np.asarray(sol.q, float)), goals[:, None])
    assert max(np.max(position), np.max(rotation)) < 2 * TOLERANCE[np.dtype(dtype).name]
    # The reference direction is short at some goals, which magnifies the rounding of the goal.
    back = turned(ikjax.arm_angle(arm, np.asarray(sol.q, float), reference=reference) - angle[:, None])
    assert np.median(back) < 100 * np.finfo(dtype).eps
    assert np.quantile(back, 0.99) < 1e4 * np.finfo(dtype).eps
    if dtype == np.float64:
        assert turned(np.asarray(sol.q) - q[:, None]).max(-1).min(-1).max() < 1e-8


def test_slots_are_named_by_the_signs_of_their_joints():
    arm, _, goals, angle = made("iiwa14", 200)
    sol = ikjax.solve(arm, goals, arm_angle=angle)
    signs = np.sign(np.asarray(sol.q)[..., [1, 3, 5]])
    for k, name in enumerate(recognition.BRANCHES):
        wanted = [1 if part.endswith("+") else -1 for part in name.split("/")]
        assert (signs[:, k] == wanted).all(), name


@pytest.mark.parametrize("name", ["iiwa14", "offset elbow"])
def test_the_angle_is_that_of_axis_4_about_the_line_to_the_wrist_with_50_digits(name):
    arm, _, goals, angle = made(name, 3, seed=4)
    arm = arm.astype(np.float64)
    sol = ikjax.solve(arm, goals, arm_angle=angle)
    mp = oracle.mp
    for i, k in ((0, 0), (1, 5), (2, 7)):
        found = np.asarray(sol.q)[i, k]
        assert max(oracle.error(arm, found, goals[i])) < 1e-12
        frames = oracle.frames(arm, found)
        columns = [[frame[:3, j] for j in range(4)] for frame in frames]

        def cross(u, v):
            return mp.matrix(
                [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]]
            )

        def dot(u, v):
            return sum(x * y for x, y in zip(u, v, strict=True))

        toward = columns[5][3] - columns[1][3]
        toward = toward / mp.norm(toward)
        zero, axis = cross(columns[0][2], toward), columns[3][2]
        # Square to each other on such an arm, whatever the joints.
        assert abs(dot(toward, axis)) < 1e-14
        measured = mp.atan2(dot(cross(zero, axis), toward), dot(zero, axis))
        assert turned(float(measured) - angle[i]) < 1e-12


def test_joint_3_at_zero_is_an_arm_angle_of_zero_or_half_a_turn():
    q = np.random.default_rng(2).uniform(-2, 2, (50, 7)) * [1, 1, 0, 1, 1, 1, 1]
    for name in ("iiwa14", "rm75"):
        angle = np.asarray(ikjax.arm_angle(build(name), q))
        assert np.minimum(turned(angle), turned(angle - np.pi)).max() < 1e-12


@pytest.mark.slow
def test_an_arm_off_its_table_is_solved_as_given():
    arm, _, goals, angle = made("calibrated", 500)
    sol = ikjax.solve(arm, goals, arm_angle=angle)
    # Beyond the fold of the arm as recognized a slot may be lost.
    assert np.asarray(sol.valid).any(-1).all() and np.asarray(sol.valid).mean() > 0.995
    # The angle is given to the arm as recognized: the arm as given is at it to the size of the correction.
    back = turned(ikjax.arm_angle(arm, sol.q) - angle[:, None])
    assert np.median(back) < 1e-3 and np.quantile(back, 0.99) < 0.01


def test_eager_jit_and_broadcasting_agree():
    arm, _, goals, angle = made("iiwa14", 6)
    eager = ikjax.solve(arm, goals[:, None], arm_angle=angle[:4])
    assert eager.q.shape == (6, 4, 8, 7)
    jitted = jax.jit(lambda goals, r: ikjax.solve(arm, goals, arm_angle=r))(goals[:, None], angle[:4])
    np.testing.assert_array_equal(eager.valid, jitted.valid)
    assert turned(eager.q - jitted.q).max() < 1e-9
    one = ikjax.solve(arm, goals[2], arm_angle=float(angle[1]))
    assert turned(one.q - eager.q[2, 1]).max() < 1e-9
    # What chooses among branches takes them as any other.
    q, found = ikjax.nearest(arm, ikjax.within_limits(arm, eager), np.zeros(7))
    assert q.shape == (6, 4, 7) and found.shape == (6, 4)


@pytest.mark.slow
def test_vmap_over_angles_is_broadcasting():
    arm, _, goals, angle = made("iiwa14", 6)
    over = jax.vmap(lambda r: ikjax.solve(arm, goals[2], arm_angle=r).q)(angle[:4])
    assert turned(over - ikjax.solve(arm, goals[2], arm_angle=angle[:4]).q).max() < 1e-9


def moved(arm, goals, angle, x):
    """Goals moved by a twist x[:6], the angle by x[6], lengths and tool by the rest."""
    changed = dataclasses.replace(
        arm,
        d=jnp.asarray(arm.d).at[np.array([0, 2, 4])].add(x[7:10]),
        theta=jnp.asarray(arm.theta).at[2].add(x[10]),
        tool=jnp.asarray(arm.tool).at[0, 3].add(x[11]),
    )
    w = x[3:6]
    zero = jnp.zeros_like(w[0])
    cross = jnp.stack(
        [jnp.stack(row) for row in ((zero, -w[2], w[1]), (w[2], zero, -w[0]), (-w[1], w[0], zero))]
    )
    rotation = jax.scipy.linalg.expm(cross) @ jnp.asarray(goals)[:, :3, :3]
    moved_goals = jnp.asarray(goals).at[:, :3, :3].set(rotation).at[:, :3, 3].add(x[None, :3])
    return changed, moved_goals, jnp.asarray(angle) + x[6]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "reference"),
    [
        ("iiwa14", "axis1"),
        ("offset elbow", "axis1"),
        ("offset elbow", "stereographic"),
    ],
)
def test_derivatives_are_those_of_differences_forwards_and_backwards(name, reference):
    arm = build(name)
    q = np.random.default_rng(1).uniform(-2.5, 2.5, (5, 7))
    q[:, 3] = 0.6 * np.abs(q[:, 3]) + 0.4
    goals, angle = np.asarray(ikjax.fk(arm, q)), np.asarray(ikjax.arm_angle(arm, q, reference=reference))

    @jax.jit
    def answer(x):
        changed, at, to = moved(arm, goals, angle, x)
        sol = ikjax.solve(changed, at, arm_angle=to, reference=reference)
        return sol.q, sol.margin

    @jax.jit
    def rates(x, direction):
        return jax.jvp(answer, (x,), (direction,))[1]

    start, step, by = np.zeros(12), 1e-6, []
    for i, e in enumerate(np.eye(12)):
        (rate, margin_rate), (plus, m_plus), (minus, m_minus) = (
            rates(start, e),
            answer(step * e),
            answer(-step * e),
        )
        wanted = ((np.asarray(plus - minus) + np.pi) % (2 * np.pi) - np.pi) / (2 * step)
        np.testing.assert_allclose(rate, wanted, rtol=1e-5, atol=2e-6, err_msg=str(i))
        np.testing.assert_allclose(margin_rate, np.asarray(m_plus - m_minus) / (2 * step), atol=1e-8)
        by.append(np.asarray(rate))
    weights = np.random.default_rng(2).normal(size=by[0].shape)
    back = jax.jit(jax.grad(lambda x: jnp.sum(answer(x)[0] * weights)))(start)
    np.testing.assert_allclose(back, [np.sum(rate * weights) for rate in by], rtol=1e-9, atol=1e-9)


def edges():
    """Postures at the edges, by name, of an arm with equal links."""
    base = np.array([0.4, -0.6, 0.3, -1.2, 0.5, 0.8, 0.2])

    def at(**joints):
        q = base.copy()
        for name, value in joints.items():
            q[int(name[1]) - 1] = value
        return q

    return {
        "straight": at(j4=0),
        "nearly straight": at(j4=1e-9),
        "folded": at(j4=np.pi),
        "wrist on axis 1": at(j2=0, j4=0),
        "wrist nearly on axis 1": at(j2=1e-9, j4=0),
        "wrist below": at(j2=np.pi, j4=0),
        "hand straight": at(j6=0),
        "shoulder straight": at(j2=0),
        "all straight": at(j2=0, j4=0, j6=0),
        "at right angles": np.array([Q, Q, 0, -Q, 0, Q, 0]),
        "half a turn": at(j3=np.pi),
    }


def at_edges(reference, dtype):
    """An arm, its goals at the edges and their arm angles."""
    arm = build("equal links")
    q = np.stack(list(edges().values()))
    goals = np.asarray(ikjax.fk(arm, q), dtype)
    return arm, goals, np.asarray(ikjax.arm_angle(arm, q, reference=reference), dtype)


@pytest.mark.parametrize("reference", ["axis1", pytest.param("stereographic", marks=pytest.mark.slow)])
def test_edges_are_answered(reference, dtype):
    arm, goals, angle = at_edges(reference, dtype)
    names = list(edges())
    for shift in (0, 1.0, np.pi):
        sol = ikjax.solve(arm, goals, arm_angle=angle + np.asarray(shift, dtype), reference=reference)
        for name, row in zip(names, np.asarray(sol.valid), strict=True):
            assert row.all(), name
        assert np.isfinite(sol.q).all() and np.isfinite(sol.margin).all()
    sol = ikjax.solve(arm, goals, arm_angle=angle, reference=reference)
    continuum = dict(zip(names, np.asarray(sol.continuum), strict=True))
    for name in ("folded", "hand straight", "shoulder straight", "all straight"):
        assert continuum[name].any(), name
    assert not continuum["half a turn"].any() and not continuum["straight"].any()
    # At full stretch the slots of either elbow are one.
    pair = np.asarray(sol.q)[names.index("straight")]
    assert turned(pair[[0, 1, 4, 5]] - pair[[2, 3, 6, 7]]).max() < 20 * np.sqrt(np.finfo(dtype).eps)
    assert np.abs(np.asarray(sol.margin)[names.index("straight")]).max() < 100 * np.finfo(dtype).eps


@pytest.mark.slow
@pytest.mark.parametrize("reference", ["axis1", "stereographic"])
def test_derivatives_are_finite_at_edges(reference, dtype):
    arm, goals, angle = at_edges(reference, dtype)
    q = np.stack(list(edges().values()))
    assert np.isfinite(jax.vmap(jax.grad(lambda q: ikjax.arm_angle(arm, q, reference=reference)))(q)).all()

    @jax.jit
    @functools.partial(jax.grad, argnums=(0, 1))
    def gradient(goals, angle):
        sol = ikjax.solve(arm, goals, arm_angle=angle, reference=reference)
        return sol.q.sum() + sol.margin.sum()

    for shift in (0, 1.0, np.pi):
        assert all(np.isfinite(x).all() for x in gradient(goals, angle + np.asarray(shift, dtype)))
    bad = np.array(goals)
    bad[1] = np.nan
    by_goal, by_angle = gradient(bad, angle)
    assert np.isfinite(by_goal).all() and np.isfinite(by_angle).all() and by_angle[1] == 0


def test_a_row_that_is_not_finite_is_masked_and_no_other():
    arm, _, goals, angle = made("iiwa14", 4)
    whole = ikjax.solve(arm, goals, arm_angle=angle)
    for bad in (np.nan, np.inf):
        sol = ikjax.solve(arm, goals, arm_angle=np.where(np.arange(4) == 2, bad, angle))
        assert not sol.valid[2].any() and sol.is_pose.all() and np.isfinite(sol.q).all()
        np.testing.assert_array_equal(np.asarray(sol.q)[[0, 1, 3]], np.asarray(whole.q)[[0, 1, 3]])
    wrong = np.array(goals)
    wrong[1, 0, 3] = np.nan
    wrong[3, 0, 3] = 5.0
    sol = ikjax.solve(arm, wrong, arm_angle=angle)
    assert not sol.valid[1].any() and not sol.valid[3].any() and sol.valid[0].all()
    assert (sol.margin[3] < -1).all() and np.isfinite(sol.q).all()


@pytest.mark.parametrize(
    ("call", "text"),
    [
        (lambda: ikjax.solve(ikjax.robots.fer(), np.eye(4), arm_angle=0.0), "not a4 = 0|not a.* = 0"),
        (lambda: ikjax.solve(ikjax.robots.puma560(), np.eye(4), arm_angle=0.0), "it wants 7 turning joints"),
        (
            lambda: ikjax.solve(build("iiwa14"), np.eye(4), arm_angle=0.0, redundancy=0.0),
            "two ways to say one thing",
        ),
        (
            lambda: ikjax.solve(build("iiwa14"), np.eye(4), arm_angle=0.0, reference="up"),
            "one of axis1, ster",
        ),
        (
            lambda: ikjax.solve(build("iiwa14"), np.zeros((3, 4, 4)), arm_angle=np.zeros(2)),
            r"\(3,\), got \(2,\)",
        ),
        (lambda: ikjax.arm_angle(build("iiwa14"), np.zeros(6)), r"q must have shape \(..., 7\)"),
    ],
)
def test_mistakes_are_named(call, text):
    with pytest.raises(ValueError, match=text):
        call()
