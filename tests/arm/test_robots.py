import dataclasses
import math

import jax
import numpy as np
import peers
import pytest
from oracle import turn

import ikjax

fk_and_frames = jax.jit(lambda arm, q: (ikjax.fk(arm, q), ikjax.frames(arm, q)))


def our_chain(arm, q):
    """fk and frames at (4, n) joints; alike arms share one program, because only their numbers differ."""
    arm = dataclasses.replace(arm, name="any", family=None, signs=(), branches=())
    q = np.broadcast_to(np.asarray(q, float), (4, arm.n))
    return [np.asarray(poses) for poses in fk_and_frames(arm, q)]


def ssik_joints(name):
    """The joints of ssik's own model of an arm."""
    return next(x for x in vars(peers.ssik(name)).values() if type(x).__name__ == "KinBody").joints


def their_chain(name, q):
    """Where ssik's tool stands, and each joint's axis with a point on it."""
    T, axes = peers.ssik_base(name), []
    for joint, angle in zip(ssik_joints(name), q, strict=True):
        T = T @ joint.T_left
        axes.append((T[:3, :3] @ joint.axis, T[:3, 3]))
        T = T @ turn(joint.axis, angle) @ joint.T_right
    return T, axes


def test_the_catalogue_is_listed_in_alphabetical_order():
    names = ikjax.robots.names()
    assert list(names) == sorted(names) and set(peers.SSIK) < set(names)
    for name in names:
        assert ikjax.robots.get(name).name == name == getattr(ikjax.robots, name)().name


def test_an_unknown_robot_is_answered_with_the_list():
    with pytest.raises(ValueError, match="no robot 'puma'; near it the catalogue has puma560"):
        ikjax.robots.get("puma")
    with pytest.raises(ValueError, match="no robot 'puma'; near it the catalogue has puma560"):
        ikjax.robots.poses("puma")


@pytest.mark.parametrize("name", peers.SSIK)
def test_joints_turn_about_the_same_lines_as_in_ssik(name, rng):
    q = rng.uniform(-math.pi, math.pi, (4, 6))
    for joints, ours in zip(q, our_chain(ikjax.robots.get(name), q)[1], strict=True):
        for frame, (axis, point) in zip(ours, their_chain(name, joints)[1], strict=False):
            np.testing.assert_allclose(frame[:3, 2], axis, atol=1e-9)
            np.testing.assert_allclose(np.cross(axis, frame[:3, 3] - point), 0, atol=1e-9)


@pytest.mark.parametrize("name", peers.SSIK)
def test_the_tool_stands_where_ssik_says_up_to_a_fixed_turn(name, rng):
    q = rng.uniform(-math.pi, math.pi, (4, 6))
    ours = our_chain(ikjax.robots.get(name), q)[0]
    theirs = np.array([their_chain(name, joints)[0] for joints in q])
    fixed = np.linalg.inv(ours[0]) @ theirs[0]
    np.testing.assert_allclose(fixed[:3, 3], 0, atol=1e-9)
    np.testing.assert_allclose(ours @ fixed, theirs, atol=1e-9)


@pytest.mark.parametrize("name", [name for name in peers.SSIK if name != "puma560" and name[:2] != "ur"])
def test_joint_limits_are_those_in_ssik(name):
    # ssik's PUMA has no limits of its own, and its UR arms keep the elbow to half a turn.
    wanted = [joint.limits for joint in ssik_joints(name)]
    np.testing.assert_allclose(ikjax.robots.get(name).limits, wanted, atol=1e-4)


def test_the_irb2400_stands_upright_with_its_forearm_level():
    # x = 0.100 + 0.755 + 0.085, z = 0.615 + 0.705 + 0.135.
    T = our_chain(ikjax.robots.irb2400(), np.zeros(6))[0][0]
    np.testing.assert_allclose(T[:3, 3], [0.94, 0, 1.455], atol=1e-12)
    np.testing.assert_allclose(T[:3, 2], [1, 0, 0], atol=1e-12)


# Where a flange stands at a named pose [m], by sums of lengths that others print.
STANDS = {
    # Corke, Robotics Toolbox for MATLAB, wiki, Arm robot examples, prints zero as 0.4521, -0.15, 0.4318;
    # the others are sums of the lengths printed there. Upper arm and forearm are at 45 deg when nominal.
    ("puma560", "zero"): (0.4318 + 0.0203, -0.15005, 0.4318),
    ("puma560", "ready"): (0.0203, -0.15005, 0.4318 + 0.4318),
    ("puma560", "stretch"): (0.4318 + 0.4318, -0.15005, -0.0203),
    ("puma560", "nominal"): ((0.4318 - 0.0203 + 0.4318) * 0.5**0.5, -0.15005, -0.0203 * 0.5**0.5),
    # Joint origins of the macros in ros-industrial/fanuc, fanuc_lrmate200id_support/urdf, and in
    # ros-industrial/kuka_experimental, kuka_kr6_support/urdf/kr6r900sixx_macro.xacro.
    ("lrmate200id", "zero"): (0.050 + 0.335 + 0.080, 0, 0.330 + 0.330 + 0.035),
    ("kr6_r900", "zero"): (0.025 + 0.455 + 0.420 + 0.080, 0, 0.400 + 0.035),
    ("kr6_r900", "start"): (0.025 + 0.420, 0, 0.400 + 0.455 + 0.035 - 0.080),
    # Reach of the product page, "GX4 SCARA Robot - 350 mm" (epson.com, RGX4-A351SSTSD).
    ("gx4_351s", "zero"): (0.350, 0, 0),
    # FANUC's file places J4 to J6 in the world: my_1, mz_3 and mx_2 there, which is J6's flange.
    ("crx10ia", "zero"): (0.700, -0.150, 0.785),
    # UFACTORY, Kinematic and dynamic parameters of xArm 6: 53.5 + 77.5 + 76, 267 + 284.5 - 342.5 - 97 mm.
    ("xarm6", "zero"): (0.207, 0, 0.112),
    # Sums of the lengths in the files that the catalogue names.
    ("hc10", "zero"): (0, 0.162, 0.275 + 0.700 - 0.500 - 0.130),
    ("gofa5", "zero"): (0.470 + 0.101, 0, 0.265 + 0.444 + 0.110 + 0.080),
    # The lectures' slides on PRR arms ask for this point.
    ("planar_prr", "stretch"): (0, 22, 0),
}


@pytest.mark.parametrize("name, pose", STANDS)
def test_a_flange_stands_where_its_named_pose_is_published(name, pose):
    T = our_chain(ikjax.robots.get(name), ikjax.robots.poses(name)[pose])[0][0]
    np.testing.assert_allclose(T[:3, 3], STANDS[name, pose], atol=1e-12)


@pytest.mark.parametrize("name", ["ur3e", "ur5", "ur5e", "ur10e"])
def test_a_universal_robot_that_is_up_stands_straight_up(name):
    T, frames = our_chain(ikjax.robots.get(name), ikjax.robots.poses(name)["up"])
    shoulder, elbow, wrist = frames[0][1:4, :3, 3]
    np.testing.assert_allclose(np.array([shoulder, elbow, wrist])[:, :2], 0, atol=1e-12)
    assert 0 < shoulder[2] < elbow[2] < wrist[2] < T[0][2, 3]


@pytest.mark.parametrize("name", ikjax.robots.names())
def test_named_poses_lie_within_the_joint_limits(name):
    poses, arm = ikjax.robots.poses(name), ikjax.robots.get(name)
    assert poses or name in ("stanford", "cobotta", "kr120_r2500"), "give it at least a pose `zero`"
    low, high = np.asarray(arm.limits).T
    for q in poses.values():
        assert len(q) == arm.n and all(type(x) is float for x in q)
        assert (low <= q).all() and (q <= high).all()


def test_the_named_poses_of_a_robot_are_ones_own_to_change():
    ikjax.robots.poses("puma560").clear()
    assert list(ikjax.robots.poses("puma560")) == ["zero", "ready", "stretch", "nominal"]


def test_the_elbow_manipulator_has_free_lengths():
    T = our_chain(ikjax.robots.elbow_manipulator(0.5, 0.25, 0.125), np.zeros(6))[0][0]
    np.testing.assert_allclose(T[:3, 3], [0.875, 0, 0], atol=1e-15)


def zyz(a, b, c):
    """Euler angles, which are the three turns of a spherical wrist."""
    z, y = (0, 0, 1), (0, 1, 0)
    return turn(z, a) @ turn(y, b) @ turn(z, c)


def stanford_of_the_notes(q):
    """CS 4733 notes, step 1, the matrix from base to slide; the wrist turns and then reaches d6 ahead.

    The lengths have no second source. Joint 4 is a quarter turn behind Corke's, who turns his slide by it.
    """
    d1, d2, d3, d6 = 0.412, 0.154, q[2], 0.263
    (s1, s2), (c1, c2) = np.sin(q[:2]), np.cos(q[:2])
    T = [
        [c1 * c2, -s1, c1 * s2, c1 * s2 * d3 - s1 * d2],
        [s1 * c2, c1, s1 * s2, s1 * s2 * d3 + c1 * d2],
        [-s2, 0, c2, c2 * d3 + d1],
        [0, 0, 0, 1],
    ]
    ahead = np.eye(4)
    ahead[2, 3] = d6
    return T @ zyz(q[3] - math.pi / 2, *q[4:]) @ ahead


def irb2400_of_opw(q):
    """Numbers of Jmeyer1292/opw_kinematics, opw_parameters_examples.h, makeIrb2400_10.

    Equations: Brandstoetter, Angerer and Hofbaur, An Analytical Solution of the Inverse Kinematics Problem
    of Industrial Serial Manipulators with an Ortho-parallel Basis and a Spherical Wrist (2014), as in
    `forward` of opw_kinematics_impl.h.
    """
    a1, a2, c1, c2, c3, c4 = 0.100, -0.135, 0.615, 0.705, 0.755, 0.085
    t1, t2, t3, *wrist = q - [0, 0, -math.pi / 2, 0, 0, 0]
    forearm, bend = math.hypot(a2, c3), math.atan2(a2, c3)
    ahead = c2 * math.sin(t2) + forearm * math.sin(t2 + t3 + bend) + a1
    T = zyz(t1, t2 + t3, 0) @ zyz(*wrist)
    T[:3, 3] = ahead * math.cos(t1), ahead * math.sin(t1), 0
    T[2, 3] = c2 * math.cos(t2) + forearm * math.cos(t2 + t3 + bend) + c1
    T[:3, 3] += c4 * T[:3, 2]
    return T


def elbow_manipulator_of_the_lecture(q):
    """ME/SE 740, lecture 18, step 1: A1 times the right-hand side printed there."""
    a2, a3, a4 = 0.4, 0.3, 0.1  # ours, of the catalogue
    (s1, s2, _, _, s5, s6), (c1, c2, _, _, c5, c6) = np.sin(q), np.cos(q)
    (s23, s234), (c23, c234) = np.sin([q[1] + q[2], sum(q[1:4])]), np.cos([q[1] + q[2], sum(q[1:4])])
    A1 = np.array([[c1, 0, s1, 0], [s1, 0, -c1, 0], [0, 1, 0, 0], [0, 0, 0, 1]])
    x, y = a4 * c234 + a3 * c23 + a2 * c2, a4 * s234 + a3 * s23 + a2 * s2
    return A1 @ [
        [c234 * c5 * c6 - s234 * s6, -c234 * c5 * s6 - s234 * c6, c234 * s5, x],
        [s234 * c5 * c6 + c234 * s6, -s234 * c5 * s6 + c234 * c6, s234 * s5, y],
        [-s5 * c6, s5 * s6, c5, 0],
        [0, 0, 0, 1],
    ]


def planar(phi, x, y):
    """A pose in the plane, in space."""
    T = turn((0, 0, 1), phi)
    T[:2, 3] = x, y
    return T


def planar_2r_of_the_slides(q):
    """The slides on two-link arms, (1) and (2), which Spong numbers (1.1) and (1.2)."""
    l1, l2, t12 = 0.5, 0.4, sum(q)  # ours, of the catalogue
    return planar(t12, l1 * math.cos(q[0]) + l2 * math.cos(t12), l1 * math.sin(q[0]) + l2 * math.sin(t12))


def planar_3r_of_craig(q):
    """Craig, Introduction to Robotics, 3rd ed., (4.6), whose frame is the wrist; the tip is l3 further on."""
    l3 = 0.2  # ours, of the catalogue
    wrist, phi = planar_2r_of_the_slides(q[:2])[:2, 3], sum(q)
    return planar(phi, *wrist + l3 * np.array([math.cos(phi), math.sin(phi)]))


def gx4_351s_of_epson(q):
    """A SCARA's plane is a two-link arm; numbers of Epson, GX series, Standard Work Envelope."""
    arm1, arm2, t12 = 0.220, 0.350 - 0.220, q[0] + q[1]
    x, y = arm1 * math.cos(q[0]) + arm2 * math.cos(t12), arm1 * math.sin(q[0]) + arm2 * math.sin(t12)
    T = planar(t12 + q[3], x, y)
    T[2, 3] = q[2]
    return T


def motoman_l3_of_craig(q):
    """Craig, section 3.7: two links in the plane that joint 1 turns; z leans by the whole pitch."""
    l2, l3, z, y = 0.4, 0.3, (0, 0, 1), (0, 1, 0)  # lengths ours, of the catalogue
    out = l2 * math.cos(q[1]) + l3 * math.cos(q[1] + q[2])
    T = turn(z, q[0]) @ turn(y, sum(q[1:4])) @ turn(z, q[4])
    T[:3, 3] = out * math.cos(q[0]), out * math.sin(q[0]), -l2 * math.sin(q[1]) - l3 * math.sin(q[1] + q[2])
    return T


def katana_6m180_of_the_maker(q):
    """Neuronics AG, Katana Native Interface, AnaGuess, kinematics6M180.cpp, `directKinematics`, with its
    segments for the angle gripper [m] and its Euler angles z, x, z.

    Its joints but the second are half a turn on; its frame stands on axis 2, and its tool points along z.
    """
    a = np.array(q) + np.array([1, 0, 1, 1, 1]) * math.pi
    t1, t2, t3, t4, t5 = a[0], a[1] - math.pi / 2, a[2] - math.pi, math.pi - a[3], -a[4]
    bends = np.array([t2, t2 + t3, t2 + t3 + t4])
    lengths = np.array([0.190, 0.139, 0.1473 + 0.1555])
    out, up = lengths @ np.sin(bends), lengths @ np.cos(bends)
    z, x = (0, 0, 1), (1, 0, 0)
    T = turn(z, t1 + math.pi / 2) @ turn(x, bends[2]) @ turn(z, t5)
    T[:3, 3] = out * math.cos(t1), out * math.sin(t1), 0.2015 + up
    # The description's tool points along x.
    return T @ turn(z, -math.pi / 2) @ turn((0, 1, 0), -math.pi / 2)


def vx300_of_the_maker(q):
    """Interbotix/interbotix_ros_toolboxes, interbotix_xs_modules, xs_robot/mr_descriptions.py, vx300: screws
    (w, v) and the home pose, by the product of exponentials (Lynch and Park, Modern Robotics, (4.14))."""
    screws = [
        ((0, 0, 1), (0, 0, 0)),
        ((0, 1, 0), (-0.12705, 0, 0)),
        ((0, 1, 0), (-0.42705, 0, 0.05955)),
        ((0, 1, 0), (-0.42705, 0, 0.35955)),
        ((1, 0, 0), (0, 0.42705, 0)),
    ]
    T = np.eye(4)
    for (axis, moment), angle in zip(screws, q, strict=True):
        point = np.cross(axis, moment)
        step = turn(axis, angle)
        step[:3, 3] = point - step[:3, :3] @ point
        T = T @ step
    home = np.eye(4)
    home[:3, 3] = 0.536494, 0, 0.42705
    return T @ home


# Its file: xyz and rpy of each joint's frame in the one before, then of the gripper frame.
SO101 = [
    ((0.0207909, -0.0230745, 0.0948817), (-3.14159, 0, 1.5708)),
    ((-0.0303992, -0.0182778, -0.0542), (-1.5708, -1.5708, 0)),
    ((-0.11257, -0.028, 0), (0, 0, 1.5708)),
    ((-0.1349, 0.0052, 0), (0, 0, -1.5708)),
    ((0, -0.0611, 0.0181), (1.5708, -9.38083e-08, 3.14159)),
    ((-0.0079, -0.000218121, -0.0981274), (0, 3.14159, 0)),
]


def so101_of_its_file(q):
    """Frame by frame: fixed-axis roll, pitch, yaw, then the turn about z."""
    T = np.eye(4)
    for (xyz, (roll, pitch, yaw)), angle in zip(SO101, (*q, 0.0), strict=True):
        origin = turn((0, 0, 1), yaw) @ turn((0, 1, 0), pitch) @ turn((1, 0, 0), roll)
        origin[:3, 3] = xyz
        T = T @ origin @ turn((0, 0, 1), angle)
    return T


FLAT, Z, Y, X = (0, 0, 0), (0, 0, 1), (0, 1, 0), (1, 0, 0)
HALF, QUARTER = math.pi, math.pi / 2
FRAMES = {
    "crx10ia": [
        ((0, 0, 0.245), FLAT, Z),
        (FLAT, FLAT, Y),
        ((0, 0, 0.540), FLAT, (0, -1, 0)),
        (FLAT, FLAT, (-1, 0, 0)),
        ((0.540, 0, 0), FLAT, (0, -1, 0)),
        ((0, -0.150, 0), FLAT, (-1, 0, 0)),
        ((0.160, 0, 0), (HALF, -QUARTER, 0), None),
    ],
    "hc10": [
        ((0, 0, 0.275), FLAT, Z),
        (FLAT, FLAT, Y),
        ((0, 0, 0.700), FLAT, (0, -1, 0)),
        ((0, 0, -0.500), FLAT, Z),
        ((0, 0.162, 0), FLAT, (0, -1, 0)),
        (FLAT, FLAT, Z),
        ((0, 0, -0.130), (HALF, 0, 0), None),
    ],
    "xarm6": [
        ((0, 0, 0.267), FLAT, Z),
        (FLAT, (-QUARTER, 0, 0), Z),
        ((0.0535, -0.2845, 0), FLAT, Z),
        ((0.0775, 0.3425, 0), (-QUARTER, 0, 0), Z),
        (FLAT, (QUARTER, 0, 0), Z),
        ((0.076, 0.097, 0), (-QUARTER, 0, 0), Z),
        (FLAT, FLAT, None),
    ],
    "gofa5": [
        ((0, 0, 0.265), FLAT, Z),
        (FLAT, FLAT, Y),
        ((0, 0, 0.444), FLAT, Y),
        ((0, 0, 0.110), FLAT, X),
        ((0.470, 0, 0), FLAT, Y),
        ((0.101, 0, 0.080), FLAT, X),
        (FLAT, (0, QUARTER, 0), None),
    ],
    "gen3lite": [
        ((0, 0, 0.12825), FLAT, Z),
        ((0, -0.03, 0.115), (QUARTER, 0, 0), Z),
        ((0, 0.28, 0), (-HALF, 0, 0), Z),
        ((0, -0.14, 0.02), (QUARTER, 0, 0), Z),
        ((0.0285, 0, 0.105), (0, QUARTER, 0), Z),
        ((-0.105, 0, 0.0285), (0, -QUARTER, 0), Z),
        (FLAT, FLAT, None),
    ],
    "cobotta": [
        (FLAT, FLAT, Z),
        ((0, 0, 0.180), FLAT, Y),
        ((0, 0, 0.165), FLAT, Y),
        ((-0.012, 0.020, 0.088), FLAT, Z),
        ((0, -0.020, 0.0895), FLAT, Y),
        ((0, -0.0445, 0.042), FLAT, Z),
        (FLAT, FLAT, None),
    ],
}
"""xyz and rpy of each joint's frame in the one before, and its axis, then of the flange, as in the files
that the catalogue names. Of the CRX the flange is FANUC's own, which points up (x) and ahead (z) at zero."""


def of_frames(name, q):
    """Frame by frame: fixed-axis roll, pitch, yaw, then the turn about the axis."""
    T = np.eye(4)
    for (xyz, (roll, pitch, yaw), axis), angle in zip(FRAMES[name], (*q, 0.0), strict=True):
        origin = turn(Z, yaw) @ turn(Y, pitch) @ turn(X, roll)
        origin[:3, 3] = xyz
        T = T @ origin @ (np.eye(4) if axis is None else turn(axis, angle))
    return T


@pytest.mark.parametrize("name", FRAMES)
def test_the_flange_stands_where_the_frames_of_the_makers_file_put_it(name, rng):
    q = rng.uniform(-math.pi, math.pi, (4, 6))
    np.testing.assert_allclose(
        our_chain(ikjax.robots.get(name), q)[0], [of_frames(name, joints) for joints in q], atol=1e-12
    )


# The package robotkinematicscatalogue 1.1.2: a [mm], d [mm] and theta [deg] of modified tables, whose twists
# are COMMON. It leaves out how high the foot of some is, and its Cobotta has a longer tool.
COMMON = (0, -90, 0, -90, 90, -90)
TABLES = {
    "crx10ia": ([0, 0, 540, 0, 0, 0], [0, 0, 0, 540, -150, 160], [0, -90, 0, 0, 0, 0]),
    "hc10": ([0, 0, 700, 0, 0, 0], [0, 0, 0, 500, 162, 130], [0, -90, 90, 0, 0, 180]),
    "gofa5": ([0, 0, 444, 110, 0, 80], [265, 0, 0, 470, 0, 101], [0, -90, 0, 0, 0, 180]),
    "gen3lite": ([0, 0, 280, 0, 0, 0], [243.25, 10, 0, 245, -57, 105], [180, -90, -90, -90, 0, 0]),
    "cobotta": ([0, 0, 165, 12, 0, 0], [180, 20, 0, 177.5, -64.5, 102], [0, -90, -90, 0, 0, 180]),
    "gofa10": ([0, 150, 707, 110, 0, 80], [400, 0, 0, 637, 0, 101], [0, -90, 0, 0, 0, 180]),
    "link6": (
        [0, 110.24, 485, 0, 0, 86],
        [190.5, -22.447, 0, 374.91, 139.879, 179.028],
        [0, -90, -90, 0, 90, 90],
    ),
}


def of_table(name, q):
    T = np.eye(4)
    for a, alpha, d, theta, angle in zip(TABLES[name][0], COMMON, *TABLES[name][1:], q, strict=True):
        before, after = turn(X, math.radians(alpha)), turn(Z, math.radians(theta) + angle)
        before[0, 3], after[2, 3] = a * 1e-3, d * 1e-3
        T = T @ before @ after
    return T


def screw(T):
    """The angle and the advance of a motion along its axis, which are alike in all frames."""
    R = T[:3, :3]
    axis = np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
    return math.acos((np.trace(R) - 1) / 2), axis @ T[:3, 3] / np.linalg.norm(axis)


@pytest.mark.parametrize("name", TABLES)
def test_arms_with_an_offset_wrist_have_the_table_that_others_print(name, rng):
    """Up to where base and tool are, and to the joints' directions."""
    signs = {
        "crx10ia": (1, 1, -1, -1, -1, -1),
        "hc10": (1, 1, -1, -1, -1, -1),
        "gen3lite": (1, 1, -1, 1, -1, 1),
    }
    q = rng.uniform(-math.pi, math.pi, (4, 6))
    ours = our_chain(ikjax.robots.get(name), q)[0]
    theirs = np.array([of_table(name, joints * signs.get(name, 1)) for joints in q])
    for k in range(1, 4):
        motions = [screw(T[k] @ np.linalg.inv(T[0])) for T in (ours, theirs)]
        np.testing.assert_allclose(*motions, atol=1e-9)


# Pose after pose in closed form, each written from a text of its own; planar_rpr and planar_prr
# have theirs in tests/solvers/test_textbooks.py.
CLOSED = {
    "elbow_manipulator": elbow_manipulator_of_the_lecture,
    "gx4_351s": gx4_351s_of_epson,
    "irb2400": irb2400_of_opw,
    "katana_6m180": katana_6m180_of_the_maker,
    "motoman_l3": motoman_l3_of_craig,
    "planar_2r": planar_2r_of_the_slides,
    "planar_3r": planar_3r_of_craig,
    "so101": so101_of_its_file,
    "stanford": stanford_of_the_notes,
    "vx300": vx300_of_the_maker,
}


@pytest.mark.parametrize("name", CLOSED)
def test_the_flange_stands_where_a_closed_form_of_others_puts_it(name, rng):
    arm = ikjax.robots.get(name)
    q = rng.uniform(-math.pi, math.pi, (4, arm.n))
    np.testing.assert_allclose(our_chain(arm, q)[0], [CLOSED[name](joints) for joints in q], atol=1e-12)


def test_joint_limits_of_the_irb2400_are_those_of_its_ros_description():
    # ros-industrial/abb, abb_irb2400_support/urdf/irb2400_macro.xacro, to the digits given there.
    wanted = [(-3.1416, 3.1416), (-1.7453, 1.9199), (-1.0472, 1.1345), (-3.49, 3.49)]
    wanted += [(-2.0944, 2.0944), (-6.9813, 6.9813)]
    np.testing.assert_allclose(ikjax.robots.irb2400().limits, wanted, atol=1e-3)


def test_the_gx4_ends_where_epsons_work_envelope_does():
    # Computed by Epson, GX series, Standard Work Envelope, GX4-351*: f = 142 mm is the nearest to axis 1 that
    # joint 2 allows, g = 298.5 mm the furthest behind it that joint 1 does; m = 150 mm is joint 3's stroke.
    arm = ikjax.robots.gx4_351s()
    (_, end1), (_, end2), (bottom, top), _ = np.asarray(arm.limits)
    near = our_chain(arm, [0, end2, 0, 0])[0][0][:2, 3]
    back = our_chain(arm, [end1, math.pi - end1, bottom, 0])[0][0][:3, 3]
    np.testing.assert_allclose(np.hypot(*near), 0.142, atol=5e-4)
    np.testing.assert_allclose(back[0], -0.2985, atol=5e-5)
    np.testing.assert_allclose(top - back[2], 0.150, atol=1e-12)


def test_the_so101_keeps_what_its_file_rounds_and_its_roll_axis_passes_beside_its_first():
    arm = ikjax.robots.so101()
    assert arm.family == "five_axis" and arm.correction is None
    np.testing.assert_allclose(abs(abs(arm.alpha[3]) - math.pi / 2), 3.673e-6, atol=1e-9)
    np.testing.assert_allclose(abs(sum(arm.d[1:4])), 1.8e-4, atol=2e-6)
    # The tip is this far off the roll axis.
    np.testing.assert_allclose(np.hypot(*arm.tool[:2, 3]), 7.9e-3, atol=1e-5)


def test_the_so101_read_from_a_urdf_file_is_the_same_arm():
    pytest.importorskip("defusedxml")
    text = '<robot name="so101"><link name="l0"/>'
    for i, (xyz, rpy) in enumerate(SO101, 1):
        kind, numbers = "revolute" if i < 6 else "fixed", [" ".join(map(str, x)) for x in (xyz, rpy)]
        text += (
            f'<link name="l{i}"/><joint name="j{i}" type="{kind}"><parent link="l{i - 1}"/>'
            f'<child link="l{i}"/>'
            f'<origin xyz="{numbers[0]}" rpy="{numbers[1]}"/><axis xyz="0 0 1"/>'
            '<limit lower="-1" upper="1" effort="1" velocity="1"/></joint>'
        )
    read, ours = ikjax.Arm.from_urdf(text + "</robot>"), ikjax.robots.so101()
    assert read.family == ours.family == "five_axis" and read.signs == ours.signs
    assert read.correction is None
    for leaf in ("a", "alpha", "d", "theta", "base", "tool"):
        np.testing.assert_allclose(getattr(read, leaf), getattr(ours, leaf), atol=1e-15)
