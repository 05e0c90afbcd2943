import itertools
import re

import numpy as np
import pytest

import ikjax
from ikjax.arm.arm import Arm
from ikjax.arm.recognition import recognize

DEG = np.pi / 180
FAMILY = {
    **dict.fromkeys(
        ["puma560", "irb120", "irb2400", "kr6_r900", "lrmate200id", "rx160"], "ortho_parallel_wrist"
    ),
    **dict.fromkeys(["ur3e", "ur5", "ur5e", "ur10e", "elbow_manipulator"], "three_parallel"),
    **dict.fromkeys(["planar_3r", "planar_rpr", "planar_prr"], "planar_pose"),
    "planar_2r": "planar_position",
    **dict.fromkeys(["motoman_l3", "so101", "katana_6m180", "vx300"], "five_axis"),
    "gx4_351s": "scara",
    **dict.fromkeys(["stanford", "iiwa7", "iiwa14", "rm75", "gen3", "openarm"], "pieper"),
    **dict.fromkeys(["fer", "fr3", "xarm7", "gen72"], "pieper_reversed"),
    **dict.fromkeys(["cobotta", "crx10ia", "gen3lite", "gofa5", "gofa10"], "offset_wrist"),
    **dict.fromkeys(["hc10", "link6", "xarm6"], "offset_wrist"),
    **dict.fromkeys(["crx5ia", "crx20ia_l", "crx25ia", "ned2"], "offset_wrist"),
    **dict.fromkeys(["px150", "rx150", "rx200", "wx200", "wx250", "vx250", "so100", "xarm5"], "five_axis"),
    **dict.fromkeys(["ur3", "ur10", "ur16e", "ur20", "ur30", "z1"], "three_parallel"),
    **dict.fromkeys(["tm5_900", "tm12", "tm14", "cr5", "cr10", "zu7", "zu12"], "three_parallel"),
    **dict.fromkeys(["yam", "wxai", "arx_x5"], "three_parallel"),
    **{"koch": "five_axis", "gen3_6": "offset_wrist"},
    **dict.fromkeys(["aubo_i5", "aubo_i10", "ec66", "cs66", "mycobot_320"], "three_parallel"),
}
"""By name; all others of the catalogue are the usual industrial arm."""
TASKS = {"planar_pose": "planar_pose", "planar_position": "planar_position"}
TABLES = {
    "ortho_parallel_wrist": {
        "a": [0.1, 0.2, 0.1, 0, 0, 0],
        "alpha": np.multiply([90, 0, -90, 90, -90, 0], DEG),
        "d": [0.1, 0.1, 0.1, 0.2, 0, 0.1],
    },
    "three_parallel": {
        "a": [0.1, 0.2, 0.2, 0.1, 0, 0],
        "alpha": np.multiply([90, 0, 0, 90, -90, 0], DEG),
        "d": [0.1, 0.1, 0, 0.1, 0, 0.1],
    },
}
"""The lengths of each add up to one metre."""


def arm_of(family, asked=None, **changes):
    """The family's table with some entries changed, each given as a5=..., counted from 1."""
    table = {key: np.array(column) for key, column in TABLES[family].items()}
    for entry, value in changes.items():
        table[entry[:-1]][int(entry[-1]) - 1] = value
    return Arm.from_dh(**table, convention="standard", family=asked)


def refusal(arm):
    with pytest.raises(ValueError) as error:
        ikjax.solve(arm, np.eye(4))
    return str(error.value)


@pytest.mark.parametrize("name", ikjax.robots.names())
def test_every_arm_of_the_catalogue_has_its_family(name):
    arm = ikjax.robots.get(name)
    assert arm.family == FAMILY.get(name, "ortho_parallel_wrist")
    assert arm.task == TASKS.get(arm.family, "pose")
    slots = 16 if arm.family == "offset_wrist" else {2: 2, 3: 2, 4: 2, 5: 4, 6: 8, 7: 8}[arm.n]
    assert len(arm.branches) == len(set(arm.branches)) == slots
    if arm.family not in TABLES:
        return
    assert arm.branches[:2] == ("front/up/noflip", "back/up/noflip")
    assert arm.branches[2] == "front/down/noflip" and arm.branches[4] == "front/up/flip"


TURNS = {"square": (90, -90), "level": (0, 180)}
PATTERNS = {
    "ortho_parallel_wrist": ("square", "level", "square", "square", "square"),
    "three_parallel": ("square", "level", "level", "square", "square"),
}


@pytest.mark.parametrize("family", PATTERNS)
def test_every_pattern_of_signs_is_recognized(family):
    seen = set()
    for twists in itertools.product(*(TURNS[kind] for kind in PATTERNS[family])):
        arm = arm_of(family, **{f"alpha{i + 1}": twist * DEG for i, twist in enumerate(twists)})
        assert arm.family == family, twists
        seen.add(arm.signs)
    # Twist 3 of the first family is not among its signs: its kernel takes any angle there.
    assert len(seen) == {"ortho_parallel_wrist": 16, "three_parallel": 32}[family]


NEAR_MISSES = {
    "wrist axes 5 and 6 just miss": ("ortho_parallel_wrist", {"a5": 1e-9}, "a5 = 0 .*: 1e-09", "1e-10"),
    "wrist axes 4 and 5 just miss": ("ortho_parallel_wrist", {"a4": -1e-9}, "a4 = 0 .*: 1e-09", "1e-10"),
    "the wrist is spread along axis 5": (
        "ortho_parallel_wrist",
        {"d5": 1e-3},
        "d5 = 0 .*: 0.000999",
        "1e-10",
    ),
    "axis 1 leans": (
        "ortho_parallel_wrist",
        {"alpha1": np.pi / 2 + 1e-6},
        "axis 1 perpendicular to axis 2: 1e-06",
        "1e-10",
    ),
    "axis 3 leans": (
        "ortho_parallel_wrist",
        {"alpha2": 1e-6},
        "axis 2 parallel to axis 3: 1e-06",
        "1e-10",
    ),
    "no upper arm": ("ortho_parallel_wrist", {"a2": 0}, "axes 2 and 3 apart.*: 0", "1e-06"),
    "hardly an upper arm": ("ortho_parallel_wrist", {"a2": 1e-7}, "axes 2 and 3 apart.*", "1e-06"),
    "the wrist lies on axis 3": (
        "ortho_parallel_wrist",
        {"a3": 0, "d4": 0},
        "the wrist stands off axis 3.*: 0",
        "1e-06",
    ),
    "wrist axes 4 and 5 in line": (
        "ortho_parallel_wrist",
        {"alpha4": 0},
        "axis 4 not parallel to axis 5",
        "0.001",
    ),
    "axis 4 leans": ("three_parallel", {"alpha3": 1e-6}, "axis 3 parallel to axis 4: 1e-06", "1e-10"),
    "axis 6 leans": (
        "three_parallel",
        {"alpha5": np.pi / 2 - 1e-6},
        "axis 5 perpendicular to axis 6: 1e-06",
        "1e-10",
    ),
    "axes 5 and 6 just miss": ("three_parallel", {"a5": 1e-9}, "a5 = 0 .*: 1e-09", "1e-10"),
    "no forearm": ("three_parallel", {"a3": 0}, "axes 3 and 4 apart.*: 0", "1e-06"),
}


@pytest.mark.parametrize(("family", "change", "fact", "threshold"), NEAR_MISSES.values(), ids=NEAR_MISSES)
def test_a_near_miss_is_refused_with_the_quantity_and_the_threshold(family, change, fact, threshold):
    assert arm_of(family, **change).family != family
    with pytest.raises(ValueError, match=f"the arm is not of family {family}: ") as error:
        arm_of(family, asked=family, **change)
    reason = str(error.value)
    assert re.search(fact, reason), reason
    assert threshold in reason, reason


def test_an_arm_of_no_family_is_told_what_keeps_it_out_of_each():
    arm = arm_of("ortho_parallel_wrist", a5=1e-3, alpha2=0.3)
    assert arm.family is None and arm.branches == ()
    text = ikjax.explain(arm)
    assert text.startswith(refusal(arm))
    for family in ("ortho_parallel_wrist", "pieper", "parallel_axes"):
        assert re.search(rf"{family}: .*\n *Not this arm: .*\d", text), family


@pytest.mark.parametrize("change", [{"a5": 1e-11}, {"alpha1": np.pi / 2 + 1e-11}, {"d5": -1e-11}])
def test_what_rounding_leaves_is_forgiven(change):
    assert arm_of("ortho_parallel_wrist", **change).family == "ortho_parallel_wrist"


@pytest.mark.parametrize("scale", [1e-9, 1e9])
@pytest.mark.parametrize("family", TABLES)
def test_the_unit_of_length_does_not_matter(family, scale):
    table = {**TABLES[family], **{key: np.multiply(TABLES[family][key], scale) for key in ("a", "d")}}
    assert Arm.from_dh(**table, convention="standard").family == family
    table["a"][4] = 1e-9 * scale
    assert Arm.from_dh(**table, convention="standard").family != family


@pytest.mark.parametrize("n", [1, 4, 5, 7])
def test_an_arm_of_another_number_of_joints_is_told_what_is_supported(n):
    arm = Arm.from_dh(a=np.full(n, 0.3), alpha=np.zeros(n), d=np.zeros(n), convention="standard", name="odd")
    text = ikjax.explain(arm)
    assert text.startswith("odd has no closed form here: ") and f"Found: joints {'R' * n}" in text
    for family in recognize.RULES:
        assert f"{family}: " in text
    assert text.count("it wants joints RRRRRR.") == 5


def test_a_sliding_joint_keeps_an_arm_out_of_the_turning_families():
    arm = Arm.from_dh(**TABLES["three_parallel"], kinds="RRPRRR", convention="standard")
    assert arm.family is None and "joints RRPRRR" in ikjax.explain(arm)


def test_an_arm_of_two_families_can_be_asked_for_either():
    for family in TABLES:
        arm = Arm.from_dh(**TABLES[family], convention="standard", family=family)
        assert arm.family == family


def test_an_explanation_prints_what_was_measured():
    text = ikjax.explain(arm_of("ortho_parallel_wrist", a5=3e-11))
    assert text.startswith("arm is solved by ortho_parallel_wrist: axis 1 perpendicular to 2")
    assert "yes a5 = 0 (axes 5 and 6 meet), share of the reach: 3e-11" in text
    assert "yes axis 1 perpendicular to axis 2: 6.1e-17" in text
    assert "Branches (8):\n  0  front/up/noflip\n  1  back/up/noflip" in text
    assert "NO" not in text


def test_an_explanation_of_an_unsolved_arm_says_what_stands_in_the_way():
    text = ikjax.explain(arm_of("ortho_parallel_wrist", a5=2e-3, a4=0.1))
    verdict, found, *_ = text.splitlines()
    assert verdict.startswith(
        "arm has no closed form here: for ortho_parallel_wrist, the nearest, axes 4 and 5 are 100 mm apart"
    )
    assert found.startswith("Found: joints RRRRRR; axes 1-2 perpendicular, 0.1 m apart")
    assert "axes 2-3 parallel, 0.2 m apart" in text and "axes 5-6 perpendicular, 0.002 m apart" in text
    assert "Not this arm: axes 4 and 5 are 100 mm apart; axes 5 and 6 are 2 mm apart.\n" in text


def test_single_precision_numbers_are_not_held_against_an_arm(dtype):
    arm = ikjax.robots.ur5e().astype(dtype)
    assert "NO" not in ikjax.explain(arm)
