"""The tables [place] and [design] of a study, their commands, and options beside a study file."""

import argparse
import json

import numpy as np
import pytest

import ikjax
from ikjax.cli import sections, study_file
from ikjax.cli.parser import build_parser

STUDY = """
angles = "degrees"
arm = "gx4_351s"
spacing = 0.2
orientations = { wxyz = [[0, 1, 0, 0]] }
goals = { file = "holes.csv", rpy = [0, 0, 90] }
alternatives = { cone = { direction = [0, 0, 1], half_angle = 0, directions = 1, turns = 2 } }

[place]
move = ["x", "turn"]
bounds = [{ x = [-0.3, 0] }, { x = [0.2, 0.4] }]
keep_out = [[[0.19, -1, -1], [0.21, 1, 1]]]
parts = "part.csv"
clearance = 0.05
spacing = 0.1
starts = 2
steps = 0

[design]
vary = { a2 = [0.1, 0.3], "tool.z" = [-0.1, 0.1], "tool.rz" = [-90, 90] }
ties = ["a2 + tool.z = 0.2"]
limits = false
steps = 3
"""


@pytest.fixture
def study(tmp_path):
    (tmp_path / "holes.csv").write_text("x [mm],y,z\n200,0.1,-0.1\n150,0.2,-0.1\n")
    (tmp_path / "part.csv").write_text("1,1,0\n")
    (tmp_path / "cell.toml").write_text(STUDY)
    return tmp_path / "cell.toml"


def options_of(*words) -> argparse.Namespace:
    return build_parser().parse_args([str(word) for word in words])


def test_a_study_says_where_a_base_may_stand(study):
    arm, goals, said = sections.read_place(study, options_of("place", study))
    assert arm.name == "gx4_351s" and goals.shape == (2, 4, 4)
    np.testing.assert_allclose(goals[0], ikjax.pose((0.2, 0.1, -0.1), rpy=(0, 0, np.pi / 2)), atol=1e-7)
    assert said["bounds"] == [{"x": (-0.3, 0.0)}, {"x": (0.2, 0.4)}]
    assert said["keep_out"].shape == (1, 2, 3) and said["parts"].tolist() == [[1, 1, 0]]
    assert said["free_rolls"] == 1 and len(said["alternatives"].rotations) == 2
    assert said["clearance"] == 0.05 and said["steps"] == 0 and "redundancy_samples" not in said


def test_options_count_before_the_study(study):
    more = ["--bounds", "x=0:1", "turn=-90:90", "--free-rolls", 3, "--cone", 20, "--no-limits", "--starts", 1]
    _, _, said = sections.read_place(study, options_of("place", study, *more))
    assert said["bounds"]["x"] == (0, 1) and said["bounds"]["turn"] == pytest.approx((-np.pi / 2, np.pi / 2))
    assert said["free_rolls"] == 3 and said["limits"] is False and said["starts"] == 1
    cone = said["alternatives"].rotations
    assert len(cone) == sections.CONE_DIRECTIONS and cone[:, 2, 2].min() >= np.cos(np.radians(20)) - 1e-9
    moved = study_file.read(
        study, options_of("sweep", study, "--spacing", 0.1, "--tool", 0, 0, 0.3, "--title", "a")
    )
    assert moved.title == "a" and moved.positions == ikjax.maps.around(moved.arm, 0.1)
    assert moved.arm.tool[2, 3] == pytest.approx(0.3) and moved.dtype == "float32"
    assert study_file.read(study, options_of("sweep", study, "--float64")).dtype == "float64"


def test_a_study_says_what_may_vary(study):
    _, _, said = sections.read_design(study, options_of("design", study))
    assert said["vary"]["a2"] == (0.1, 0.3) and said["vary"]["tool.rz"] == pytest.approx(
        (-np.pi / 2, np.pi / 2)
    )
    assert said["ties"] == ["a2 + tool.z = 0.2"] and said["limits"] is False
    _, _, said = sections.read_design(study, options_of("design", study, "--vary", "tool.rz=-45:45"))
    assert said["vary"] == {"tool.rz": pytest.approx((-np.pi / 4, np.pi / 4))}


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["place", "ur5"], "goals are missing"),
        (["design", "STUDY", "--vary", "a2"], "bounds are NAME=LOW:HIGH"),
        (["design", "STUDY", "--objective", "beauty"], "objective must be one of coverage"),
        (["place", "STUDY", "--bounds", "x=1"], "bounds are NAME=LOW:HIGH, as in x=-1:1, got 'x=1'"),
    ],
)
def test_what_is_wrong_is_named(run, study, words, says):
    code, _, err = run(*[study if word == "STUDY" else word for word in words])
    assert code == 2 and says in err and len(err.splitlines()) == 1


def test_a_table_with_an_unknown_key_is_refused(run, study):
    study.write_text(STUDY.replace("keep_out", "keepout"))
    code, _, err = run("place", study)
    assert code == 2 and "place must have the keys move, bounds" in err


def test_a_study_file_stands_for_its_arm(run, study):
    code, out, _ = run("solve", study, "--xyz", 0.2, 0.1, -0.1, "--rpy", 0, 0, 0, "--json")
    assert code == 0 and json.loads(out)["arm"] == "gx4_351s"
    code, out, _ = run("convert", study, "--tool", 0, 0, 0.1, "--json")
    assert json.loads(out)["tool"][2][3] == pytest.approx(0.1)


def test_place_runs(run, study):
    code, out, _ = run("place", study, "--json")
    bases = json.loads(out)["bases"]
    assert code == 0 and bases[0]["share"] == 1
    assert all(-0.31 < base["base"][0][3] < 0.15 or base["base"][0][3] > 0.25 for base in bases)
    assert "in a study of angles in degrees: mount = [" in run("place", study)[1]


@pytest.mark.slow
def test_design_runs(run, study):
    code, out, err = run("design", study)
    assert code == 0, err
    assert "designing gx4_351s for 2 goals" in err
    assert "tool.rz" in out and "deg" in out and "Arm.from_dh(" in out
