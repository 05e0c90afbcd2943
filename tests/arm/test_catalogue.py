"""Every arm of the tables against a second description of it, and which have none.

Kinds of second description: the package robotkinematicscatalogue (tables of modified parameters, compared
where it is installed and is not itself the source), the reach that the maker puts into the arm's name, files
of others written out here or their lengths, and those of `test_robots.py`.
"""

import importlib
import math
import tomllib

import numpy as np
import peers
import pytest
import test_robots
from oracle import turn

import ikjax
from ikjax.arm.robots import tables

ROOM = "robotkinematicscatalogue.inversekinematics"
SIX, TOGETHER = f"{ROOM}.__6DOF.__industrialRobots", f"{ROOM}.__6DOF.__collaborativeRobots"
PACKAGED = {
    "irb120": (SIX, "ABB_IRB_120"),
    "irb1200_7_70": (SIX, "ABB_IRB_1200_7_07"),
    "irb1200_5_90": (SIX, "ABB_IRB_1200_5_09"),
    "irb1600_10_145": (SIX, "ABB_IRB_1600_10_145"),
    "irb2600_12_165": (SIX, "ABB_IRB_2600_12_165"),
    "irb4600_60_205": (SIX, "ABB_IRB_4600_60_205"),
    "irb6700_200_260": (SIX, "ABB_IRB_6700_200_260"),
    "kr3_r540": (SIX, "KUKA_KR3_R540"),
    "kr5_arc": (SIX, "KUKA_KR5_arc"),
    "kr6_r700": (SIX, "KUKA_KR6_R700_sixx"),
    "kr10_r1100": (SIX, "KUKA_KR10_R1100_sixx"),
    "kr16_2": (SIX, "KUKA_KR16_2"),
    "kr120_r2500": (SIX, "KUKA_KR120_R2500_pro"),
    "kr150_2": (SIX, "KUKA_KR150_2"),
    "lrmate200id_7l": (SIX, "Fanuc_LR_Mate_200iD_7L"),
    "m10ia": (SIX, "Fanuc_M_10iA"),
    "m20ia": (SIX, "Fanuc_M_20iA"),
    "m710ic_50": (SIX, "Fanuc_M_710iC_50"),
    "gp7": (SIX, "Yaskawa_GP7"),
    "gp8": (SIX, "Yaskawa_GP8"),
    "gp12": (SIX, "Yaskawa_GP12"),
    "gp25": (SIX, "Yaskawa_GP25"),
    "m0609": (SIX, "Doosan_Robotics_M0609"),
    "m0617": (SIX, "Doosan_Robotics_M0617"),
    "m1013": (SIX, "Doosan_Robotics_M1013"),
    "m1509": (SIX, "Doosan_Robotics_M1509"),
    "h2017": (SIX, "Doosan_Robotics_H2017"),
    "a0912": (SIX, "Doosan_Robotics_A0912"),
    "ur5e": (TOGETHER, "UR5e"),
    "ur10e": (TOGETHER, "UR10e"),
    "ur16e": (TOGETHER, "UR16e"),
}
COARSE = {"ur5e": 1e-4, "ur10e": 5e-4, "irb1200_5_90": 2e-4, "irb1200_7_70": 2e-4}
"""Where the package rounds lengths [m]: of a UR5e's forearm, of a UR10e's wrist, of a foot (399 mm)."""


def modified(rows, joints):
    """Frames after each row of a table of modified parameters, Craig (3.6), row by row."""
    T, frames = np.eye(4), []
    for (alpha, a, d, theta), q in zip(rows, joints, strict=True):
        step = turn((1, 0, 0), alpha)
        step[0, 3] = a
        spin = turn((0, 0, 1), theta + q)
        spin[2, 3] = d
        T = T @ step @ spin
        frames.append(T)
    return np.array(frames)


def packaged_tool(module, name, q):
    """Where the package's tool stands [m], joints counted as in the catalogue: joint 3 from the upper arm."""
    robot = getattr(importlib.import_module(f"{module}.{name}"), name)()
    rows = np.stack([robot.alpha, robot.a / 1000, robot.d / 1000, robot.theta], -1).astype(float)
    return np.array([modified(rows, np.array(robot.inv_joint) * joints)[-1] for joints in q])


def two_fixed_motions(ours, theirs):
    """B, E with ours = B theirs E for all poses, as well as they fit.

    Motions from the first pose are conjugate by B: rotation axes by Kabsch's least squares, then positions.
    """
    first, second = (poses[1:] @ np.linalg.inv(poses[0]) for poses in (ours, theirs))
    vees = [
        np.stack([m[:, 2, 1] - m[:, 1, 2], m[:, 0, 2] - m[:, 2, 0], m[:, 1, 0] - m[:, 0, 1]], -1)
        for m in (first, second)
    ]
    u, _, vt = np.linalg.svd(vees[0].T @ vees[1])
    rotation = u @ np.diag([1, 1, np.linalg.det(u @ vt)]) @ vt
    # (R_first - I) p = rotation t_second - t_first, for the shift p of B.
    left = np.concatenate(np.eye(3) - first[:, :3, :3])
    right = np.concatenate(first[:, :3, 3] - second[:, :3, 3] @ rotation.T)
    B = np.eye(4)
    B[:3, :3], B[:3, 3] = rotation, np.linalg.lstsq(left, right, rcond=None)[0]
    return B, np.linalg.inv(B @ theirs[0]) @ ours[0]


@pytest.mark.parametrize("name", PACKAGED)
def test_an_arm_moves_as_in_the_package_robotkinematicscatalogue(name, rng):
    """In the zeros and directions of both, up to where the foot and the tool are fixed."""
    pytest.importorskip("robotkinematicscatalogue")
    q = rng.uniform(-math.pi, math.pi, (12, 6))
    arm = ikjax.robots.get(name)
    ours = np.array([np.asarray(ikjax.fk(arm, joints)) for joints in q])
    theirs = packaged_tool(*PACKAGED[name], q)
    B, E = two_fixed_motions(ours, theirs)
    np.testing.assert_allclose(B @ theirs @ E, ours, atol=COARSE.get(name, 2e-5))


def ortho(arm):
    """Axis 1 to the wrist's center, stretched out level."""
    return abs(arm.a[0]) + abs(arm.a[1]) + math.hypot(arm.a[2], arm.d[3])


def to_flange(arm):
    """The same to the flange, whose distance a table has in its last row or its tool."""
    return ortho(arm) + abs(arm.d[5] + arm.tool[2, 3])


def upright(arm):
    """Axis 2 to the flange, stretched out."""
    return to_flange(arm) - abs(arm.a[0])


def parallel(arm):
    """Shoulder to the last axis, stretched out level: upper arm, forearm and the wrist's second offset."""
    return abs(arm.a[1]) + abs(arm.a[2]) + abs(arm.d[4])


REACH = {
    # In the designation, in m or mm: half of its last digit.
    "irb1200_5_90": (ortho, 0.90, 5e-3),
    "irb1200_7_70": (ortho, 0.70, 5e-3),
    "irb1600_10_145": (ortho, 1.45, 5e-3),
    "irb2600_12_165": (ortho, 1.65, 5e-3),
    "irb4600_60_205": (ortho, 2.05, 5e-3),
    "irb6700_200_260": (ortho, 2.60, 5e-3),
    "kr3_r540": (ortho, 0.540, 1.5e-3),
    "kr6_r700": (ortho, 0.7067, 1e-4),
    "kr6_r900": (ortho, 0.9015, 1e-4),
    "kr10_r1100": (ortho, 1.101, 5e-4),
    "m0609": (upright, 0.900, 1e-9),
    "m0617": (upright, 1.700, 1e-9),
    "m1013": (upright, 1.300, 1e-9),
    "m1509": (upright, 0.900, 1e-9),
    "h2017": (upright, 1.700, 1e-9),
    "a0912": (upright, 1.200, 1e-9),
    "tm12": (parallel, 1.300, 5e-4),
    "tm14": (parallel, 1.100, 5e-4),
}


@pytest.mark.parametrize("name", REACH)
def test_an_arm_reaches_as_far_as_its_maker_says(name):
    how, published, off = REACH[name]
    assert abs(float(how(ikjax.robots.get(name))) - published) <= off + 1e-12


def by_screws(axes, home, q):
    """Product of exponentials (Lynch and Park, Modern Robotics, (4.14)) of rows (w, v)."""
    T = np.eye(4)
    for row, angle in zip(axes, q, strict=True):
        axis, moment = np.array(row[:3], float), np.array(row[3:], float)
        point = np.cross(axis, moment)
        step = turn(axis, angle)
        step[:3, 3] = point - step[:3, :3] @ point
        T = T @ step
    end = np.eye(4)
    end[:3, 3] = home
    return T @ end


def interbotix(low, high, elbow, wrist, tip, roll=False):
    """Interbotix/interbotix_ros_toolboxes, interbotix_xs_modules, mr_descriptions.py, in its numbers."""
    rows = [(0, 0, 1, 0, 0, 0), (0, 1, 0, -low, 0, 0), (0, 1, 0, -high, 0, elbow)]
    rows += [(1, 0, 0, 0, high, 0)] * roll + [(0, 1, 0, -high, 0, wrist), (1, 0, 0, 0, high, 0)]
    return lambda q: by_screws(rows, (tip, 0, high), q)


def by_frames(rows):
    """Frames (xyz, wxyz, axis) one in the other, as MJCF places bodies; joints turn about the axis."""

    def tool(q):
        T = np.eye(4)
        for (xyz, wxyz, axis), angle in zip(rows, (*q, 0.0)[: len(rows)], strict=True):
            step = np.asarray(ikjax.pose(xyz=xyz, wxyz=np.divide(wxyz, np.linalg.norm(wxyz))))
            T = T @ step @ turn(axis, angle)
        return T

    return tool


def universal(z, upper, fore, wrist, second, third):
    """Joint frames of config/NAME/default_kinematics.yaml: xyz, and a quarter turn about x before 2, 5 and 6.

    Joint 6 has roll 90, pitch 180, yaw 180 deg, which is a quarter turn back.
    """
    lie, back = (math.sqrt(0.5), math.sqrt(0.5), 0, 0), (math.sqrt(0.5), -math.sqrt(0.5), 0, 0)
    none, up = (1, 0, 0, 0), (0, 0, 1)
    return by_frames(
        [
            ((0, 0, z), none, up),
            ((0, 0, 0), lie, up),
            ((-upper, 0, 0), none, up),
            ((-fore, 0, wrist), none, up),
            ((0, -second, 0), lie, up),
            ((0, third, 0), back, up),
        ]
    )


LENGTHS = {
    # Axis 1 to 2, 2 to 3, 3 to 4, then along axis 4 to 5, and 5 to the flange [m], none where a file has
    # another flange. Kawasaki-Robotics/khi_robot, khi_rs_description/urdf, macros of both.
    "rs007n": (0, 0.355, 0, 0.0925 + 0.2825, 0.078),
    "rs007l": (0, 0.455, 0, 0.0925 + 0.3825, 0.078),
    # Tianhuanyu/mecademic_desctiption, urdf/meca_500_r3.urdf.
    "meca500": (0, 0.135, 0.038, 0.12, 0.07),
    # DENSORobot/denso_robot_ros, denso_robot_descriptions, vs060.urdf and vs068.xacro.
    "vs060": (0, 0.305, 0.01, 0.1645 + 0.1355, 0.07),
    "vs068": (0.03, 0.34, 0.02, 0.197 + 0.143, None),
    # develop.realman-robotics.com, RM65 Series Parameters and D-H Model, RM65-B.
    "rm65": (0, 0.256, 0, 0.21, 0.144),
    # Elite-Robots/ROS, elite_description/urdf/ec66_description.urdf; 3 to 4 and along 4 of parallel axes.
    "ec66": (0, 0.418, 0.398, 0.122, 0.089),
}


@pytest.mark.parametrize("name", LENGTHS)
def test_an_arm_has_the_lengths_that_another_file_gives(name):
    arm, (*lengths, flange) = ikjax.robots.get(name), LENGTHS[name]
    own = [arm.a[0], arm.a[1], arm.a[2], arm.d[3]]
    np.testing.assert_allclose(np.abs(own), lengths, atol=1e-9)
    if flange is not None:
        assert abs(float(arm.d[5] + arm.tool[2, 3])) == pytest.approx(flange, abs=1e-9)


Z = (0, 0, 1)
WRITTEN = {
    "px150": interbotix(0.10457, 0.25457, 0.05, 0.2, 0.358575),
    "rx150": interbotix(0.10457, 0.25457, 0.05, 0.2, 0.358575),
    "rx200": interbotix(0.10457, 0.30457, 0.05, 0.25, 0.408575),
    "vx250": interbotix(0.12705, 0.37705, 0.06, 0.31, 0.468575),
    "vx300s": interbotix(0.12705, 0.42705, 0.05955, 0.35955, 0.536494, True),
    "wx200": interbotix(0.11065, 0.31065, 0.05, 0.25, 0.408575),
    "wx250": interbotix(0.11065, 0.36065, 0.04975, 0.29975, 0.458325),
    "wx250s": interbotix(0.11065, 0.36065, 0.04975, 0.29975, 0.458325, True),
    # ros-industrial/universal_robot, and for the UR30 UniversalRobots/Universal_Robots_ROS2_Description.
    "ur3": universal(0.1519, 0.24365, 0.21325, 0.11235, 0.08535, 0.0819),
    "ur10": universal(0.1273, 0.612, 0.5723, 0.163941, 0.1157, 0.0922),
    "ur20": universal(0.2363, 0.862, 0.7287, 0.201, 0.1593, 0.1543),
    "ur30": universal(0.2363, 0.637, 0.5037, 0.201, 0.1593, 0.1543),
    # google-deepmind/mujoco_menagerie, bodies as in unitree_z1/z1.xml.
    "z1": by_frames(
        [
            ((0, 0, 0.0585), (1, 0, 0, 0), Z),
            ((0, 0, 0.045), (1, 0, 0, 0), (0, 1, 0)),
            ((-0.35, 0, 0), (1, 0, 0, 0), (0, 1, 0)),
            ((0.218, 0, 0.057), (1, 0, 0, 0), (0, 1, 0)),
            ((0.07, 0, 0), (1, 0, 0, 0), Z),
            ((0.0492, 0, 0), (1, 0, 0, 0), (1, 0, 0)),
        ]
    ),
    # ufactory_lite6/lite6.xml there.
    "lite6": by_frames(
        [
            ((0, 0, 0.2435), (1, 0, 0, 0), Z),
            ((0, 0, 0), (-1, 1, 1, 1), Z),
            ((0.2002, 0, 0), (0, -1, -1, 0), Z),
            ((0.087, -0.22761, 0), (1, 1, 0, 0), Z),
            ((0, 0, 0), (1, 1, 0, 0), Z),
            ((0, 0.0625, 0), (1, -1, 0, 0), Z),
        ]
    ),
}


@pytest.mark.parametrize("name", WRITTEN)
def test_the_tool_stands_where_a_file_of_others_puts_it(name, rng):
    arm = ikjax.robots.get(name)
    q = rng.uniform(-math.pi, math.pi, (4, arm.n))
    for joints in q:
        np.testing.assert_allclose(ikjax.fk(arm, joints), WRITTEN[name](joints), atol=1e-9)


def test_the_piper_moves_as_its_model_in_the_menagerie():
    """agilex_piper/piper.xml, bodies one in the other.

    It counts joints 2 and 3 as the maker did before: 2 deg further and 2 deg less. Joint 6 is 1.4 mm beside
    the axis of the maker's table, which the tolerance allows for.
    """
    half = math.sqrt(0.5)
    piper = by_frames(
        [
            ((0, 0, 0.123), (half, 0, 0, -half), Z),
            ((0, 0, 0), (0.5, 0.5, -0.5, -0.5), Z),
            ((0.28358, 0.028726, 0), (0.998726, 0, 0, 0.0504536), Z),
            ((-0.24221, 0.068514, 0), (0.544767, -0.544769, -0.450809, 0.450808), Z),
            ((0, 0, 0), (half, half, 0, 0), Z),
            ((0, 0.091, 0.0014165), (0, 0, -half, -half), Z),
        ]
    )
    q = np.random.default_rng(1).uniform(-2, 2, (12, 6))
    arm = ikjax.robots.piper()
    ours = np.array([np.asarray(ikjax.fk(arm, joints)) for joints in q])
    before = q + np.deg2rad([0, 2, -2, 0, 0, 0])
    theirs = np.array([piper(joints) for joints in before])
    B, E = two_fixed_motions(ours, theirs)
    np.testing.assert_allclose((B @ theirs @ E)[:, :3, 3], ours[:, :3, 3], atol=2.5e-3)


def test_the_yam_moves_as_its_model_in_the_menagerie():
    """i2rt_yam/yam.xml, whose foot and link 6 have frames of their own."""
    none, third = (1, 0, 0, 0), (1, 1, 1, 1)
    yam = by_frames(
        [
            ((0, 0, 0.0631), (1, 0, 0, 1), Z),
            ((2.5e-5, -0.02, 0.0409), third, Z),
            ((0.264, 0, 0), (0, 1, 0, 0), Z),
            ((-0.245, -0.06, 0), none, Z),
            ((-0.074, -0.0395, 2.5e-5), (1, -1, 1, 1), Z),
            ((0, 0.0353, 0.0395), (1, -1, 0, 0), Z),
        ]
    )
    q = np.random.default_rng(1).uniform(-2, 2, (12, 6))
    ours = np.array([np.asarray(ikjax.fk(ikjax.robots.yam(), joints)) for joints in q])
    theirs = np.array([yam(joints) for joints in q])
    B, E = two_fixed_motions(ours, theirs)
    np.testing.assert_allclose(B @ theirs @ E, ours, atol=1e-9)
    assert np.abs(B @ theirs @ np.roll(E, 1, 0) - ours).max() > 0.1


UNCHECKED = {
    *("arx_x5", "aubo_i10", "aubo_i5", "cr10", "cr5", "crx20ia_l", "crx25ia", "crx5ia", "cs66", "fr3"),
    *("gen3_6", "gofa10", "irb140", "koch", "link6", "mycobot_320", "ned2", "rv4frl", "rv7fr", "so100"),
    *("tm5_900", "tx2_60", "tx2_90", "wxai", "xarm5", "zu12", "zu7"),
}
"""Arms of which no second description was found, but for parts: the FR3 has the FER's lengths, the xArm 5
those of the xArm 6, the SO-100 has some of the SO-101's."""


def test_every_arm_of_the_tables_has_a_second_description_or_is_said_to_have_none():
    elsewhere = {
        *peers.SSIK,
        *(name for name, _ in test_robots.STANDS),
        *test_robots.CLOSED,
        *test_robots.FRAMES,
        # tests/arm/test_seven_joints.py reads these from their makers' frames.
        *("fer", "iiwa7", "iiwa14", "xarm7", "gen3", "rm75", "gen72", "openarm"),
    }
    checked = {*PACKAGED, *REACH, *LENGTHS, *WRITTEN, "piper", "yam", *elsewhere}
    assert set(tables.tables()) - checked == UNCHECKED


def test_a_table_says_what_it_is_and_where_it_is_from():
    for name, table in tables.tables().items():
        assert {"title", "maker", "source"} <= set(table), name
        assert ("dh" in table) != ("joints" in table) and ("limits" in table) != ("limits_rad" in table), name
        known = {"title", "maker", "source", "pose_source", "note", "units", "kinds", "limits", "limits_rad"}
        known |= {
            "poses",
            "poses_rad",
            "base",
            "tool",
            "axis_tolerance",
            "convention",
            "dh",
            "turns",
            "joints",
            "family",
        }
        assert set(table) <= known, name


@pytest.mark.parametrize("name", sorted(tables.tables()))
def test_an_arm_of_the_tables_is_complete_and_within_a_closed_form(name):
    arm = ikjax.robots.get(name)
    assert arm.family is not None and arm.name == name
    # The Gen3's axes are off its family by 0.35 mm.
    assert arm.complete or name == "gen3"


@pytest.mark.parametrize(
    ("words", "found"),
    [
        (["ur"], {"ur3", "ur3e", "ur5", "ur5e", "ur10", "ur10e", "ur16e", "ur20", "ur30"}),
        (["Universal Robots", "UR5"], {"ur5", "ur5e"}),
        (["crx"], {"crx5ia", "crx10ia", "crx20ia_l", "crx25ia"}),
        (["KUKA", "iiwa"], {"iiwa7", "iiwa14"}),
        (["franka"], {"fer", "fr3"}),
        (["panda"], {"fer", "fr3"}),
        (["gp-12"], {"gp12"}),
        (["nothing at all"], set()),
    ],
)
def test_robots_are_found_by_words(words, found):
    assert set(ikjax.robots.find(*words)) == found


def test_no_word_finds_every_robot_and_a_wrong_name_says_which_are_near():
    assert ikjax.robots.find() == ikjax.robots.names()
    with pytest.raises(ValueError, match=r"no robot 'ur5x'; near it the catalogue has ur5, ur5e"):
        ikjax.robots.get("ur5x")
    with pytest.raises(AttributeError, match="no attribute 'ur5x'"):
        _ = ikjax.robots.ur5x


def test_what_the_catalogue_says_of_a_robot_is_given():
    assert ikjax.robots.about("crx10ia")["maker"] == "FANUC"
    assert "urdf" in ikjax.robots.about("so101")["source"].lower()
    assert "Corke" in ikjax.robots.about("puma560")["source"]


def test_two_tables_of_one_name_are_refused(tmp_path, monkeypatch):
    folder = tmp_path / "tables"
    folder.mkdir()
    for file in ("a.toml", "b.toml"):
        (folder / file).write_text('[twin]\ntitle = "twin"\n')
    monkeypatch.setattr(tables.resources, "files", lambda _: tmp_path)
    with pytest.raises(ValueError, match=r"two robots are called 'twin', the second in b\.toml"):
        tables.tables.__wrapped__()


def test_the_tables_are_within_the_package():
    from importlib import resources

    files = [x.name for x in resources.files("ikjax.arm.robots").joinpath("tables").iterdir()]
    assert sum(name.endswith(".toml") for name in files) > 10
    assert tomllib.loads("a = inf")["a"] == math.inf
