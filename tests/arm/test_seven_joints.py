"""Arms of seven joints in the catalogue, against the joint origins of their makers' or others' files."""

import math

import jax.numpy as jnp
import numpy as np
import pytest
from oracle import turn

import ikjax

Q = math.pi / 2
P = 1.5708
X, Y, Z = (1, 0, 0), (0, 1, 0), (0, 0, 1)


def iiwa(d1, d2, d3, d4, d5, d6):
    return [
        ((0, 0, d1), (0, 0, 0), Z),
        ((0, 0, d2), (Q, 0, 2 * Q), Z),
        ((0, d3, 0), (Q, 0, 2 * Q), Z),
        ((0, 0, d4), (Q, 0, 0), Z),
        ((0, d5, 0), (-Q, 2 * Q, 0), Z),
        ((0, *d6), (Q, 0, 0), Z),
        ((0, 0.081, d6[0]), (-Q, 2 * Q, 0), Z),
        ((0, 0, 0.045), (2 * Q, 2 * Q, 2 * Q), None),
    ]


FRANKA = [
    ((0, 0, 0.333), (0, 0, 0), Z),
    ((0, 0, 0), (-Q, 0, 0), Z),
    ((0, -0.316, 0), (Q, 0, 0), Z),
    ((0.0825, 0, 0), (Q, 0, 0), Z),
    ((-0.0825, 0.384, 0), (-Q, 0, 0), Z),
    ((0, 0, 0), (Q, 0, 0), Z),
    ((0.088, 0, 0), (Q, 0, 0), Z),
    ((0, 0, 0.107), (0, 0, 0), None),
]
# xyz and rpy of each joint's frame in the one before, and the axis it turns about; a fixed frame last.
FILES = {
    # frankaemika/franka_ros, franka_description.
    "fer": FRANKA,
    "fr3": FRANKA,
    # IFL-CAMP/iiwa_stack, iiwa_description/urdf, iiwa7.xacro and iiwa14.urdf.
    "iiwa7": iiwa(0.15, 0.19, 0.21, 0.19, 0.21, (0.0607, 0.19)),
    "iiwa14": iiwa(0.1575, 0.2025, 0.2045, 0.2155, 0.1845, (0, 0.2155)),
    # xArm-Developer/xarm_ros, xarm_description/config/kinematics/default.
    "xarm7": [
        ((0, 0, 0.267), (0, 0, 0), Z),
        ((0, 0, 0), (-P, 0, 0), Z),
        ((0, -0.293, 0), (P, 0, 0), Z),
        ((0.0525, 0, 0), (P, 0, 0), Z),
        ((0.0775, -0.3425, 0), (P, 0, 0), Z),
        ((0, 0, 0), (P, 0, 0), Z),
        ((0.076, 0.097, 0), (-P, 0, 0), Z),
    ],
    # Kinovarobotics/ros_kortex, kortex_description/arms/gen3/7dof.
    "gen3": [
        ((0, 0, 0.15643), (3.1416, 0, 0), Z),
        ((0, 0.005375, -0.12838), (P, 0, 0), Z),
        ((0, -0.21038, -0.006375), (-P, 0, 0), Z),
        ((0, 0.006375, -0.21038), (P, 0, 0), Z),
        ((0, -0.20843, -0.006375), (-P, 0, 0), Z),
        ((0, 0.00017505, -0.10593), (P, 0, 0), Z),
        ((0, -0.10593, -0.00017505), (-P, 0, 0), Z),
        ((0, 0, -0.0615250000000001), (3.14159265358979, 0, 0), None),
    ],
    # RealManRobot/ros2_rm_robot, rm_description/urdf.
    "rm75": [
        ((0, 0, 0.2405), (-P, 0, 0), (0, -1, 0)),
        ((0, 0, 0), (P, 0, 0), Y),
        ((0, 0, 0.256), (-P, 0, 0), (0, -1, 0)),
        ((0, 0, 0), (P, 0, 0), Y),
        ((0, 0, 0.21), (-P, 0, 0), (0, -1, 0)),
        ((0, 0, 0), (P, 0, 0), Y),
        ((0, 0, 0.144), (0, 0, 0), Z),
    ],
    # enactic/openarm_description, urdf/arm/openarm_arm.xacro without a prefix, and its kinematics.yaml.
    "openarm": [
        ((0, 0, 0.0625), (0, 0, 0), Z),
        ((-0.0301, 0, 0.06), (0, 0, 0), (-1, 0, 0)),
        ((0.0301, 0, 0.06625), (0, 0, 0), Z),
        ((0, 0.0315, 0.15375), (0, 0, 0), Y),
        ((0, -0.0315, 0.0955), (0, 0, 0), Z),
        ((0.0375, 0, 0.1205), (0, 0, 0), X),
        ((-0.0375, 0, 0), (0, 0, 0), (0, -1, 0)),
    ],
    "gen72": [
        ((0, 0, 0.218), (0, 0, 0), Z),
        ((0, 0, 0), (-P, 0, 0), Z),
        ((0, -0.28, 0), (P, 0, 0), Z),
        ((0.04, 0, 0), (P, 0, 0), Z),
        ((-0.019, 0.2525, 0), (-P, 0, 0), Z),
        ((0, 0, 0), (P, 0, 0), Z),
        ((0.0905, 0.067, 0), (P, 0, P), Z),
    ],
}
REDUNDANT = {
    **dict.fromkeys(["fer", "fr3", "xarm7", "gen72"], ("joint7", "pieper_reversed")),
    **dict.fromkeys(["iiwa7", "iiwa14", "gen3", "rm75", "openarm"], ("joint1", "pieper")),
}


def flange(name, q):
    """Frame by frame: fixed-axis roll, pitch, yaw, then the turn about the axis."""
    T = np.eye(4)
    for i, (xyz, (roll, pitch, yaw), axis) in enumerate(FILES[name]):
        origin = turn(Z, yaw) @ turn(Y, pitch) @ turn(X, roll)
        origin[:3, 3] = xyz
        T = T @ origin if axis is None else T @ origin @ turn(axis, q[i])
    return T


def urdf(name):
    text = f'<robot name="{name}"><link name="l0"/>'
    for i, (xyz, rpy, axis) in enumerate(FILES[name], 1):
        kind, numbers = (
            "revolute" if axis else "fixed",
            [" ".join(map(str, x)) for x in (xyz, rpy, axis or Z)],
        )
        text += (
            f'<link name="l{i}"/><joint name="{name}_{i}" type="{kind}"><parent link="l{i - 1}"/>'
            f'<child link="l{i}"/><origin xyz="{numbers[0]}" rpy="{numbers[1]}"/><axis xyz="{numbers[2]}"/>'
            '<limit lower="-3" upper="3" effort="1" velocity="1"/></joint>'
        )
    return text + "</robot>"


@pytest.mark.parametrize("name", FILES)
def test_the_flange_stands_where_the_file_puts_it(name, rng):
    arm = ikjax.robots.get(name)
    q = rng.uniform(-math.pi, math.pi, (4, 7))
    wanted = np.array([flange(name, joints) for joints in q])
    # Quarter turns are rounded to five digits in some files; the flange of the iiwa turns with link 7.
    rounded = any(P in np.abs(rpy) for _, rpy, _ in FILES[name])
    off = np.linalg.inv(np.asarray(ikjax.fk(arm, q))) @ wanted
    atol = 1e-4 if rounded else 1e-11
    np.testing.assert_allclose(off[:, :3, 3], 0, atol=atol)
    np.testing.assert_allclose(off, np.broadcast_to(off[0], off.shape), atol=atol)
    if name not in ("rm75", "gen72"):
        np.testing.assert_allclose(off[0, :3, :3], np.eye(3), atol=atol)


@pytest.mark.parametrize("name", FILES)
def test_the_redundant_joint_is_found(name):
    arm = ikjax.robots.get(name)
    assert (arm.redundant, arm.family) == ((REDUNDANT[name][0],), REDUNDANT[name][1])
    assert f"{arm.redundant[0]} given" in ikjax.explain(arm)


@pytest.mark.parametrize("name", FILES)
def test_a_file_gives_the_same_arm(name, rng):
    pytest.importorskip("defusedxml")
    arm = ikjax.Arm.from_urdf(urdf(name))
    ours = ikjax.robots.get(name)
    assert arm.locked == ours.locked and arm.redundant == (f"{name}_{arm.locked[0] + 1}",)
    q = rng.uniform(-math.pi, math.pi, (4, 7))
    np.testing.assert_allclose(ikjax.fk(arm, q), [flange(name, x) for x in q], atol=1e-11)


def test_the_redundant_joint_can_be_asked_for_by_name_and_by_number():
    pytest.importorskip("defusedxml")
    file = urdf("iiwa14")
    for redundant in ("iiwa14_7", "joint7", 7):
        arm = ikjax.Arm.from_urdf(file, redundant=redundant)
        assert arm.locked == (6,) and arm.family == "pieper_reversed"
    with pytest.raises(ValueError, match="no joint 'elbow'; the arm has iiwa14_1, iiwa14_2"):
        ikjax.Arm.from_urdf(file, redundant="elbow")


SEVEN = dict(a=[0.1] * 7, alpha=[1.0] * 7, d=[0.1] * 7, convention="standard")


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"redundant": "joint3"}, "wanted joint 7 or 1, which leaves six in a row"),
        ({"redundant": 8}, "there is no joint 8"),
        ({"redundant": [1, 7]}, "wanted joint 7 or 1"),
        ({"redundant": 1, "coupling": np.diag([1.0] * 6 + [2.0])}, "redundant= is for arms without coupling"),
        ({"redundant": 1, **{key: [0.1] * 6 for key in ("a", "alpha", "d")}}, "this one has 6"),
        ({"redundant": 1, "family": "pieper"}, "the arm is not of family pieper"),
        ({"redundant": 1, **{key: [0.1] * 10 for key in ("a", "alpha", "d")}}, "wanted 9 joints at most"),
    ],
)
def test_a_redundant_joint_that_does_not_fit_is_refused(changes, text):
    with pytest.raises(ValueError, match=text):
        ikjax.Arm.from_dh(**{**SEVEN, **changes})


def test_an_arm_that_no_joint_makes_solvable_says_why():
    arm = ikjax.Arm.from_dh(**SEVEN)
    assert arm.family is None and arm.locked == () and arm.redundant == ()
    with pytest.raises(ValueError, match=r"with joint7 given, the others are not .*; with joint1 given"):
        ikjax.solve(arm, jnp.eye(4))
    coupled = ikjax.Arm.from_dh(**{**SEVEN, "coupling": np.diag([1.0] * 6 + [2.0])})
    with pytest.raises(ValueError, match="of coupled joints none can be given"):
        ikjax.solve(coupled, jnp.eye(4))


def test_two_joints_may_be_redundant():
    """A six-axis arm on a rail that turns."""
    six = ikjax.robots.puma560()
    table = {key: np.concatenate([[0.0, 0.0], getattr(six, key)]) for key in ("a", "alpha", "d", "theta")}
    table["alpha"][:2] = Q, -Q
    arm = ikjax.Arm.from_dh(**table, kinds="RPRRRRRR", convention="standard")
    assert arm.redundant == ("joint1", "joint2") and arm.family == "ortho_parallel_wrist"
    assert arm.branches == six.branches and arm.signs == six.signs


def test_an_arm_that_hangs_from_its_rail_counts_up_as_seen_in_the_world():
    six = ikjax.robots.puma560()
    table = {key: np.concatenate([[0.0], getattr(six, key)]) for key in ("a", "alpha", "d", "theta")}
    down, up = (
        ikjax.Arm.from_dh(
            **{**table, "alpha": np.concatenate([[tilt], six.alpha])},
            kinds="PRRRRRR",
            base=turn(X, Q),
            convention="standard",
        )
        for tilt in (Q, -Q)
    )
    assert (down.signs.up, up.signs.up) == (-1, 1)


def test_parameters_that_may_change_count_those_beyond_the_lock():
    arm = ikjax.robots.fer()
    assert {"d1", "d3", "a3", "d5", "a6", "alpha7", "d7"} <= set(arm.free) and "a1" not in arm.free
