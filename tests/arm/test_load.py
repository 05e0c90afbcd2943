"""Whatever holds an arm: URDF trees with grippers, yourdfpy, xacro, robot_descriptions."""

import math
import subprocess
import warnings

import numpy as np
import pytest

import ikjax

pytest.importorskip("defusedxml")

PUMA = [
    ("waist", (0, 0, 0.6), "0 0 1"),
    ("shoulder", (0, -0.15, 0), "0 -1 0"),
    ("elbow", (0.4318, 0, 0), "0 -1 0"),
    ("roll", (0.02, 0, 0), "1 0 0"),
    ("wrist", (0.4318, 0, 0), "0 -1 0"),
    ("flange_turn", (0, 0, 0), "1 0 0"),
]
LAST = len(PUMA)


def joint(name, parent, child, kind="revolute", xyz=(0, 0, 0), axis="0 0 1", inside="", limits=(-3, 3)):
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="{" ".join(map(str, xyz))}"/><axis xyz="{axis}"/>'
        f'<limit lower="{limits[0]}" upper="{limits[1]}" effort="1" velocity="1"/>{inside}</joint>'
    )


def puma(*further, name="puma"):
    """A file with six joints to link l6, and what is mounted there as (child, joint)."""
    links = ["l0", *(f"l{i}" for i in range(1, LAST + 1)), *(child for child, _ in further)]
    joints = [
        joint(named, f"l{i}", f"l{i + 1}", xyz=xyz, axis=axis) for i, (named, xyz, axis) in enumerate(PUMA)
    ]
    joints += [text for _, text in further]
    named = "".join(f'<link name="{link}"/>' for link in links)
    return f'<robot name="{name}">{named}{"".join(joints)}</robot>'


def fixed(child, parent, xyz):
    return child, joint(f"{child}_fixed", parent, child, "fixed", xyz)


TOOL0 = fixed("tool0", "l6", (0.1, 0, 0))
CAMERA = fixed("camera", "l6", (0, 0, 0.05))
FOLLOW = '<mimic joint="knuckle" multiplier="-1"/>'
ROBOTIQ = [
    fixed("mount", "l6", (0.1, 0, 0)),
    ("left", joint("knuckle", "mount", "left", axis="0 0 1", limits=(0, 0.8))),
    ("right", joint("right_side", "mount", "right", axis="0 0 1", inside=FOLLOW)),
]


def test_a_gripper_that_mimics_is_trimmed_and_the_guess_is_reported():
    text = puma(*ROBOTIQ, TOOL0, CAMERA)
    with pytest.warns(UserWarning) as seen:
        arm = ikjax.Arm.from_urdf(text)
    (said,) = [str(w.message) for w in seen]
    assert (
        'the tip is guessed: "tool0", after 6 joints (waist, shoulder, elbow, roll, wrist, flange_turn)'
        in said
    )
    assert "left out as a gripper's or another branch's: knuckle, right_side. tip= overrules it" in said
    assert seen[0].filename == __file__
    assert arm.family == "ortho_parallel_wrist" and arm.joint_names == tuple(name for name, *_ in PUMA)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        asked = ikjax.Arm.from_urdf(text, tip="tool0")
    np.testing.assert_array_equal(ikjax.fk(arm, np.ones(6)), ikjax.fk(asked, np.ones(6)))


@pytest.mark.parametrize(
    ("further", "tip"),
    [
        ([TOOL0, CAMERA], "tool0"),
        ([CAMERA, fixed("gripper_tcp", "tool0", (0, 0, 0.1)), TOOL0], "gripper_tcp"),
        ([CAMERA, fixed("flange", "l6", (0.1, 0, 0))], "flange"),
        ([CAMERA, fixed("plate", "l6", (0.1, 0, 0))], "l6"),
        ([("finger", joint("finger", "l6", "finger", "prismatic", limits=(0, 0.04)))], "l6"),
        (ROBOTIQ, "mount"),
    ],
    ids=["a camera", "a tool point", "a flange", "names that tell nothing", "one finger", "no name"],
)
def test_the_tip_is_the_link_that_is_named_like_a_tool(further, tip):
    with pytest.warns(UserWarning, match=f'the tip is guessed: "{tip}"'):
        assert ikjax.Arm.from_urdf(puma(*further)).n == 6


def test_two_arms_of_one_length_are_not_guessed_between():
    links = "".join(f'<link name="{x}"/>' for x in ("torso", "left", "right"))
    joints = joint("l", "torso", "left") + joint("r", "torso", "right")
    with pytest.raises(ikjax.ArmFileError, match=r'2 leaf links below "torso", give one as tip='):
        ikjax.Arm.from_urdf(f'<robot name="two">{links}{joints}</robot>')


def test_a_frozen_joint_leaves_the_rest_where_it_puts_it():
    whole, held = ikjax.Arm.from_urdf(puma()), ikjax.Arm.from_urdf(puma(), fixed_joints={"elbow": 0.4})
    assert held.joint_names == ("waist", "shoulder", "roll", "wrist", "flange_turn")
    q = np.array([0.3, -0.2, 0.5, 0.7, -0.9])
    expected = ikjax.fk(whole, np.insert(q, 2, 0.4))
    np.testing.assert_allclose(ikjax.fk(held, q), expected, atol=1e-12)


def test_a_joint_that_mimics_a_frozen_one_stays_with_it():
    follower = '<mimic joint="elbow" multiplier="-0.5" offset="0.1"/>'
    text = puma().replace(
        '<joint name="wrist" type="revolute">', f'<joint name="wrist" type="revolute">{follower}'
    )
    held = ikjax.Arm.from_urdf(text, fixed_joints={"elbow": 0.4})
    assert held.joint_names == ("waist", "shoulder", "roll", "flange_turn") and held.coupling is None
    q = np.array([0.3, -0.2, 0.5, 0.7])
    expected = ikjax.fk(ikjax.Arm.from_urdf(puma()), np.insert(np.insert(q, 2, 0.4), 4, -0.1))
    np.testing.assert_allclose(ikjax.fk(held, q), expected, atol=1e-12)
    # One that is frozen itself follows no longer.
    free = ikjax.Arm.from_urdf(text, fixed_joints={"wrist": 0.2})
    expected = ikjax.fk(ikjax.Arm.from_urdf(puma()), np.insert(np.insert(q, 2, 0.4), 4, 0.2))
    np.testing.assert_allclose(ikjax.fk(free, np.insert(q, 2, 0.4)), expected, atol=1e-12)


def test_a_mimic_that_no_serial_arm_can_express_is_refused_with_ways_out():
    text = puma().replace(
        '<joint name="wrist" type="revolute">', '<joint name="wrist" type="revolute"><mimic joint="waist"/>'
    )
    with pytest.raises(
        ikjax.ArmFileError, match=r'base= and tip= on one side of it, or fixed_joints=\{"waist"'
    ):
        ikjax.Arm.from_urdf(text)


@pytest.mark.parametrize(
    ("held", "gist"),
    [
        (
            {"elbo": 0.1},
            'fixed_joints names "elbo", no moving joint of the chain: it has "waist", "shoulder"',
        ),
        ({"elbow": 20.0}, '"elbow">: fixed_joints holds it at 20, outside its limits -3 to 3'),
        ({"elbow": math.nan}, "outside its limits"),
    ],
)
def test_what_cannot_be_frozen_is_named(held, gist):
    with pytest.raises(ikjax.ArmFileError) as error:
        ikjax.Arm.from_urdf(puma(), fixed_joints=held)
    assert gist in str(error.value)


def test_a_xacro_file_is_expanded_or_the_package_is_named(tmp_path):
    file = tmp_path / "puma.urdf.xacro"
    text = puma().replace('xyz="0 0 0.6"', 'xyz="0 0 ${2 * 0.3}"')
    file.write_text(text.replace("<robot ", '<robot xmlns:xacro="http://ros.org/wiki/xacro" ', 1))
    try:
        import xacro  # noqa: F401
    except ImportError:
        with pytest.raises(ikjax.ArmFileError, match="is xacro: pip install xacro"):
            ikjax.load(file)
        return
    q = np.full(6, 0.3)
    expected = ikjax.fk(ikjax.Arm.from_urdf(puma()), q)
    np.testing.assert_allclose(ikjax.fk(ikjax.load(file), q), expected, atol=1e-12)
    file.write_text(file.read_text().replace("2 * 0.3", "two * 0.3"))
    with pytest.raises(ikjax.ArmFileError, match="xacro cannot expand it"):
        ikjax.load(file)


def test_a_yourdfpy_object_is_read_as_its_file(tmp_path):
    yourdfpy = pytest.importorskip("yourdfpy")
    file = tmp_path / "puma.urdf"
    file.write_text(puma(*ROBOTIQ, TOOL0).replace("0.4318", "0.43180000000000007"))
    held = yourdfpy.URDF.load(str(file), load_meshes=False, build_scene_graph=False)
    arms = [
        ikjax.Arm.from_urdf(held, tip="tool0"),
        ikjax.load(held, tip="tool0"),
        ikjax.load(file, tip="tool0"),
    ]
    assert len({arm.joint_names for arm in arms}) == 1
    for leaf in ("a", "alpha", "d", "theta", "base", "tool", "limits"):
        for arm in arms[:2]:
            np.testing.assert_array_equal(getattr(arm, leaf), getattr(arms[2], leaf))


def git(folder, *words):
    subprocess.run(["git", "-c", "user.name=a", "-c", "user.email=a@b", *words], cwd=folder, check=True)
    return subprocess.run(
        ["git", "rev-parse", "HEAD"], cwd=folder, capture_output=True, text=True
    ).stdout.strip()


@pytest.fixture
def cache(tmp_path, monkeypatch):
    """A cache of robot_descriptions that holds one repository of ours in place of the one with the Panda."""
    pytest.importorskip("robot_descriptions")
    import dataclasses
    import sys

    from robot_descriptions._repositories import REPOSITORIES

    monkeypatch.setenv("ROBOT_DESCRIPTIONS_CACHE", str(tmp_path))
    folder = tmp_path / REPOSITORIES["example-robot-data"].cache_path
    file = folder / "robots" / "panda_description" / "urdf" / "panda.urdf"
    file.parent.mkdir(parents=True)
    file.write_text(puma(TOOL0, CAMERA, name="held"))
    git(folder, "init", "--quiet")
    git(folder, "add", ".")
    commit = git(folder, "commit", "--quiet", "-m", "one")
    entry = dataclasses.replace(REPOSITORIES["example-robot-data"], url="file:///nowhere", commit=commit)
    monkeypatch.setitem(REPOSITORIES, "example-robot-data", entry)
    menagerie = dataclasses.replace(REPOSITORIES["mujoco_menagerie"], url="file:///nowhere")
    monkeypatch.setitem(REPOSITORIES, "mujoco_menagerie", menagerie)
    yield
    for name in ("panda_description", "panda_mj_description"):
        sys.modules.pop(f"robot_descriptions.{name}", None)


@pytest.mark.filterwarnings("ignore:.*the tip is guessed")
def test_a_name_of_robot_descriptions_is_read_from_its_cache_without_a_network(cache):
    arm = ikjax.load("panda_description")
    assert arm.name == "held" and arm.family == "ortho_parallel_wrist" and arm.n == 6


def test_a_description_that_cannot_be_got_says_so(cache):
    with pytest.raises(ikjax.ArmFileError, match='robot_descriptions cannot get "panda_mj_description"'):
        ikjax.load("panda_mj_description")
    with pytest.raises(ValueError, match='robot_descriptions has no "no_such_description"'):
        ikjax.load("no_such_description")


def test_names_of_the_catalogue_are_loaded_and_others_refused_with_the_choices():
    assert ikjax.load("ur5e").family == "three_parallel"
    with pytest.raises(ValueError, match=r"no arm 'ur5x': give a file, a name of the catalogue"):
        ikjax.load("ur5x")
    with pytest.raises(ValueError, match="takes no options, got tip"):
        ikjax.load("ur5e", tip="tool0")


def test_text_of_a_urdf_is_loaded():
    assert ikjax.load(puma()).joint_names == tuple(name for name, *_ in PUMA)
