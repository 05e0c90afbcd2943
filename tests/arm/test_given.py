"""The arm as given and the arm as recognized: rounded files, calibrated tables, coupled joints."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import ikjax
from ikjax.core.trig import Angle
from ikjax.solvers import given_arm
from ikjax.solvers.context import Slide

HALF_PI = np.pi / 2
UR10E = {
    "a": np.array([0, -0.6127, -0.57155, 0, 0, 0]),
    "alpha": np.array([HALF_PI, 0, 0, HALF_PI, -HALF_PI, 0]),
    "d": np.array([0.1807, 0, 0, 0.17415, 0.11985, 0.11655]),
}
# What a controller adds to its table: the third set of ur_calibration/test/calibration_test.cpp in
# UniversalRobots/Universal_Robots_ROS2_Driver, commit 2bd7f74. Common normals of nearly parallel axes
# lie hundreds of metres away.
CALIBRATION = {
    "a": [2.12234865571206e-05, 0.6320171326277007, 0.0022983363889123, -4.61409023720934e-05,
          -6.39280053471802e-05, 0],
    "alpha": [-0.000650246557584166, 0.0013941666682559, 0.00693818880325995, -0.00081164156239022,
              0.000411120504570706, 0],
    "d": [-0.000160188285741325, 439.14097407990096, -446.02705980633215, 6.8861868964236015,
          -3.86588496858e-05, -0.000879082742573742],
    "theta": [-2.4147806894359e-07, 1.6023395238669456, -1.686071907521713, 0.08373311477001187,
              -1.01260355871158e-07, 3.91986209186124e-08],
}  # fmt: skip


def calibrated(tolerance):
    table = {key: UR10E.get(key, 0) + np.array(CALIBRATION[key]) for key in CALIBRATION}
    return ikjax.Arm.from_dh(**table, convention="standard", axis_tolerance=tolerance, name="mine")


def urdf(joints) -> str:
    """A chain of (xyz, rpy, axis, type)."""
    text = '<robot name="arm"><link name="l0"/>'
    for i, (xyz, rpy, axis, kind) in enumerate(joints, 1):
        text += (
            f'<link name="l{i}"/><joint name="j{i}" type="{kind}"><parent link="l{i - 1}"/>'
            f'<child link="l{i}"/><origin xyz="{xyz}" rpy="{rpy}"/><axis xyz="{axis}"/>'
            '<limit lower="-2.9" upper="2.9" effort="1" velocity="1"/></joint>'
        )
    return text + "</robot>"


PUMA = [
    ("0 0 0.6", "0 0 0", "0 0 1", "revolute"),
    ("0 0.15005 0", "-1.5708 0 0", "0 0 1", "revolute"),
    ("0.4318 0 0", "0 0 0", "0 0 1", "revolute"),
    ("0.0203 -0.4318 0", "1.5708 0 0", "0 0 1", "revolute"),
    ("0 0 0", "-1.5708 0 0", "0 0 1", "revolute"),
    ("0 0 0", "1.5708 0 0", "0 0 1", "revolute"),
]


def _solved(arm, count, seed=0, dtype=np.float64):
    """Joints, goals made by `fk`, and the solutions."""
    q = np.random.default_rng(seed).uniform(-np.pi, np.pi, (count, arm.n))
    goals = np.asarray(ikjax.fk(arm.astype(np.float64), q))
    sol = ikjax.solve(arm, jnp.asarray(goals, dtype))
    return q, goals, jax.tree.map(np.asarray, sol)


def _found(q, sol):
    off = np.abs((sol.q - q[:, None] + np.pi) % (2 * np.pi) - np.pi).max(-1)
    return np.where(sol.valid, off, np.inf).min(-1)


@pytest.mark.slow
def test_a_rounded_file_is_recognized_and_answered_as_it_is():
    arm = ikjax.Arm.from_urdf(urdf(PUMA))
    assert arm.family == "ortho_parallel_wrist" and arm.kinds == "RRRRRR" and arm.name == "arm"
    assert 1e-6 < np.abs(arm.correction).max() < 1e-5
    np.testing.assert_allclose(arm.limits, [[-2.9, 2.9]] * 6)
    q, goals, sol = _solved(arm, 500)
    again = np.asarray(ikjax.fk(arm, sol.q))
    gap = np.abs(again - goals[:, None]).max((-1, -2))
    assert gap[sol.valid].max() < 1e-8
    assert sol.valid.any(-1).all()
    assert (_found(q, sol) < 1e-5).mean() > 0.995


def test_the_file_is_the_truth_for_forward_kinematics():
    def turn(axis, angle):
        x, y, z = np.array(axis) / np.linalg.norm(axis)
        k = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
        T = np.eye(4)
        T[:3, :3] = np.eye(3) + np.sin(angle) * k + (1 - np.cos(angle)) * k @ k
        return T

    joints = [
        ("0.1 0.2 0.3", "0.1 -0.2 0.3", "0 1 0", "revolute"),
        ("0.3 0 0.1", "0 0 0", "0 1 1e-6", "revolute"),
        ("0.2 0.1 0", "0.4 0 0", "1 0 0", "prismatic"),
        ("0 0.1 0.2", "0 0.7 0", "0 0 -1", "continuous"),
    ]
    arm = ikjax.Arm.from_urdf(urdf(joints))
    assert arm.kinds == "RRPR"
    for q in np.random.default_rng(1).uniform(-2, 2, (5, 4)):
        T = np.eye(4)
        for value, (xyz, rpy, axis, kind) in zip(q, joints, strict=True):
            axis = np.array(axis.split(), float)
            origin = np.asarray(
                ikjax.pose(xyz=list(map(float, xyz.split())), rpy=list(map(float, rpy.split())))
            )
            T = T @ origin
            if kind == "prismatic":
                slide = np.eye(4)
                slide[:3, 3] = axis / np.linalg.norm(axis) * value
                T = T @ slide
            else:
                T = T @ turn(axis, value)
        np.testing.assert_allclose(ikjax.fk(arm, q), T, atol=1e-12)


def test_a_calibrated_arm_has_its_family_when_asked():
    assert calibrated(None).family is None
    assert calibrated(1e-5).family is None
    arm = calibrated(1e-2)
    assert arm.family == "three_parallel"
    assert np.abs(np.asarray(arm.a)).max() < 1 and np.abs(np.asarray(arm.d)).max() < 1
    assert 5e-3 < np.abs(arm.correction).max() < 1e-2
    q = np.random.default_rng(2).uniform(-np.pi, np.pi, (100, 6))
    np.testing.assert_allclose(ikjax.fk(arm, q), ikjax.fk(calibrated(None), q), atol=1e-11)
    assert "As given, its axes are off by up to 0.0069 rad and 0.0011 m" in ikjax.explain(arm)
    # The flange that the same source gives at q = 0.
    np.testing.assert_allclose(ikjax.fk(arm, np.zeros(6))[:3, 3], [-1.183647, -0.290326, 0.058973], atol=1e-6)


@pytest.mark.parametrize("dtype", [np.float64, pytest.param(np.float32, marks=pytest.mark.long)])
@pytest.mark.slow
def test_a_calibrated_arm_is_solved_as_it_is(dtype):
    arm = calibrated(1e-2)
    q, goals, sol = _solved(arm, 500, dtype=dtype)
    raw = np.asarray(ikjax.fk(calibrated(None), sol.q.astype(float)))
    gap = np.abs(raw - goals[:, None]).max((-1, -2))
    assert gap[sol.valid].max() < (5e-9 if dtype == np.float64 else 2e-4)
    if dtype == np.float64:
        assert sol.valid.any(-1).all()
        # Near two folds at once, two branches may be led to the same answer.
        assert (_found(q, sol) < 1e-5).mean() > 0.99
    else:
        assert sol.valid.any(-1).mean() > 0.99


@pytest.mark.slow
def test_every_answer_of_an_arm_off_by_a_thousandth_is_found():
    arm = calibrated(1e-2)
    arm = dataclasses.replace(arm, correction=np.asarray(arm.correction) / 7)
    assert 9e-4 < np.abs(np.asarray(arm.correction)).max() < 1.1e-3
    q, _, sol = _solved(arm, 2000)
    least = np.linalg.svd(np.asarray(ikjax.jacobian(arm, q)), compute_uv=False).min(-1)
    assert (_found(q, sol) < 1e-5)[least > 1e-3].all() and (least > 1e-3).mean() > 0.98


def test_the_other_side_of_a_fold_is_as_far_away():
    assert given_arm._mirrored(Slide(0.5), Slide(0.7)).value == pytest.approx(0.3)
    start, joint = (Angle(np.sin(t), np.cos(t), ()) for t in (2.9, -2.9))
    mirrored = given_arm._mirrored(start, joint)
    assert np.arctan2(mirrored.sin, mirrored.cos) == pytest.approx(2 * 2.9 - (2 * np.pi - 2.9))


def test_the_jacobian_is_that_of_the_arm_as_given():
    arm = calibrated(1e-2)
    q = np.array([0.3, -0.4, 0.5, 0.7, -0.6, 0.2])
    h = 1e-6
    for i in range(6):
        ahead, behind = (np.asarray(ikjax.fk(arm, q + s * h * np.eye(6)[i])) for s in (1, -1))
        derivative = (ahead - behind) / (2 * h)
        np.testing.assert_allclose(ikjax.jacobian(arm, q)[:3, i], derivative[:3, 3], atol=1e-8)


FANUC = np.eye(6)
FANUC[2, 1] = 1


def coupled():
    arm = ikjax.robots.lrmate200id()
    table = {
        key: np.asarray(getattr(arm, key)) for key in ("a", "alpha", "d", "theta", "base", "tool", "limits")
    }
    return ikjax.Arm.from_dh(**table, convention="standard", coupling=FANUC, name="pendant")


@pytest.mark.slow
def test_coupled_joints_are_motor_values_everywhere():
    plain, arm = ikjax.robots.lrmate200id(), coupled()
    q, goals, sol = _solved(arm, 200)
    np.testing.assert_allclose(goals, ikjax.fk(plain, q @ FANUC.T), atol=1e-12)
    assert (_found(q, sol) < 1e-6).all()
    top = np.pi
    assert ((sol.q > -top) & (sol.q <= top)).all()
    np.testing.assert_allclose(
        ikjax.jacobian(arm, q[0]), np.asarray(ikjax.jacobian(plain, FANUC @ q[0])) @ FANUC, atol=1e-12
    )
    now = np.array([0.1, 0.2, 0.3, 0.4, 0.5, 0.6])
    straight = np.array([0.4, 0.3, -0.5, 0.2, 0.0, 0.3])
    free = ikjax.solve(arm, np.asarray(ikjax.fk(arm, straight)), now)
    mine = np.asarray(free.q)[np.asarray(free.valid & free.continuum)]
    assert len(mine) and np.allclose(mine[:, 3], 0.4)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"coupling": np.eye(5)}, r"coupling must have shape \(6, 6\), got \(5, 5\)"),
        ({"coupling": np.zeros((6, 6))}, "coupling must have an inverse"),
        ({"coupling": np.full((6, 6), np.nan)}, "coupling must hold finite numbers"),
        ({"correction": np.zeros((6, 6))}, r"correction must have shape \(7, 6\), got \(6, 6\)"),
        ({"correction": np.ones((7, 6))}, "correction must turn by 0.05 rad at most, got 1.0"),
        ({"correction": np.zeros((7, 6)), "axis_tolerance": 0.01}, "give one or the other"),
        ({"axis_tolerance": 0.5}, "axis_tolerance must be between 0 and 0.02, got 0.5"),
    ],
)
def test_a_mistake_is_named(changes, message):
    with pytest.raises(ValueError, match=message):
        ikjax.Arm.from_dh(**UR10E, convention="standard", **changes)


@pytest.mark.parametrize("make", [lambda: calibrated(1e-2), coupled])
def test_a_printed_arm_can_be_pasted_back(make):
    arm = make()
    exec(str(arm), scope := {})
    q = np.random.default_rng(4).uniform(-np.pi, np.pi, (20, 6))
    np.testing.assert_allclose(ikjax.fk(scope["arm"], q), ikjax.fk(arm, q), atol=1e-10)
    assert scope["arm"].family == arm.family


def test_a_table_that_is_exact_needs_no_correction():
    arm = ikjax.Arm.from_dh(**UR10E, convention="standard", axis_tolerance=1e-2)
    assert arm.correction is None and arm.family == "three_parallel"
    q = np.random.default_rng(3).uniform(-np.pi, np.pi, (20, 6))
    plain = ikjax.Arm.from_dh(**UR10E, convention="standard")
    np.testing.assert_allclose(ikjax.fk(arm, q), ikjax.fk(plain, q), atol=1e-13)


def screwed():
    """A SCARA whose last joint turns with its first, and lowers the slide by 20 mm in a turn."""
    arm = ikjax.robots.gx4_351s()
    table = {key: np.asarray(getattr(arm, key)) for key in ("a", "alpha", "d", "theta", "base", "tool")}
    coupling = np.eye(4)
    coupling[3, 1], coupling[2, 3] = -0.3, 0.02 / (2 * np.pi)
    limits = [(-3, 3), (-3, 3), (-1, 1), (0, 6.28)]
    return ikjax.Arm.from_dh(
        **table, convention="standard", kinds=arm.kinds, coupling=coupling, limits=limits
    )


@pytest.mark.slow
def test_a_sweep_within_limits_turns_no_motor_that_may_not():
    arm, rotations = screwed(), np.zeros((4, 3, 3))
    for rotation, angle in zip(rotations, (0.3, 1.5, 2.9, 4.4), strict=True):
        rotation[:] = [[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]]
    grid = ikjax.maps.grid((-0.3, -0.3, -0.05), (0.3, 0.3, 0.05), 0.05)
    found = ikjax.sweep(arm, grid, rotations, statistics=("reachable_within", "reachable"))
    goals = np.broadcast_to(np.eye(4), (*grid.shape, 4, 4, 4)).copy()
    goals[..., :3, :3], goals[..., :3, 3] = rotations, grid.points().reshape(*grid.shape, 1, 3)
    wanted = ikjax.within_limits(arm, ikjax.solve(arm, goals)).valid.any(-1).sum(-1)
    np.testing.assert_array_equal(found.arrays["reachable_within"], wanted)
    assert found.arrays["reachable"].sum() > wanted.sum() > 0


@pytest.mark.parametrize("traced", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_a_turn_of_a_motor_that_is_another_pose_is_not_taken(traced, rng):
    arm = screwed()
    q = rng.uniform([-2, -2, -0.1, 0.1], [2, 2, 0, 6], (200, 4))
    goals = ikjax.fk(arm, q)
    sol = jax.jit(ikjax.solve)(arm, goals) if traced else ikjax.solve(arm, goals)
    assert sol.valid.any(-1).all()
    inside = ikjax.within_limits(arm, sol)
    assert 0.2 < inside.valid.any(-1).mean() < 0.9
    for chosen in (sol, inside):
        gap, _ = ikjax.pose_error(ikjax.fk(arm, chosen.q), goals[:, None])
        assert np.where(chosen.valid, gap, 0).max() < 1e-12
    low, high = np.asarray(arm.limits).T
    found = np.asarray(inside.q)
    held = ((found >= low - 1e-12) & (found <= high + 1e-12)).all(-1)
    assert (held | ~np.asarray(inside.valid)).all()
    assert np.array_equal(inside.valid, sol.valid & (ikjax.limit_clearance(arm, sol.q) >= -1e-12))
    nearest, any_found = ikjax.nearest(arm, inside, np.zeros(4))
    gap, _ = ikjax.pose_error(ikjax.fk(arm, nearest), goals)
    assert np.where(any_found, gap, 0).max() < 1e-12
