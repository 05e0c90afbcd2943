"""The arm as it stands in a cell, the same for options and study files; goals and joints as CSV."""

import csv
import io
import json
import math
import pathlib
import re
import shutil
import subprocess

import numpy as np
import pytest

import ikjax
from ikjax.cli import sections, study_file, table, whole_arm
from ikjax.cli.parser import build_parser
from ikjax.maps.store import manifest

READERS = {"sweep": study_file.read, "place": sections.read_place, "design": sections.read_design}
DOCS = pathlib.Path(__file__).parents[2] / "docs"
TOOL = ["--tool", "0", "0.02", "0.15", "0", "30", "0"]
MOUNT = ["--mount", "0.5", "0", "0.8", "0", "0", "90"]
STUDY = 'angles = "degrees"\nspacing = 0.5\norientations = 8\n'


@pytest.fixture
def read(tmp_path):
    def written(text):
        (tmp_path / "study.toml").write_text(text)
        return study_file.read(tmp_path / "study.toml")

    return written


def T(xyz, rpy_degrees=(0, 0, 0)):
    return np.asarray(ikjax.pose(np.array(xyz, float), rpy=np.radians(np.array(rpy_degrees, float))))


def test_a_tool_and_a_mount_move_the_arm_as_poses_do(run):
    code, out, _ = run("convert", "ur5e", *TOOL, *MOUNT, "--json")
    data = json.loads(out)
    assert code == 0
    np.testing.assert_allclose(data["tool"], T((0, 0.02, 0.15), (0, 30, 0)), atol=1e-12)
    np.testing.assert_allclose(data["base"], T((0.5, 0, 0.8), (0, 0, 90)), atol=1e-12)
    radians = ["--radians", "--tool", "0", "0.02", "0.15", "0", str(math.pi / 6), "0"]
    np.testing.assert_allclose(
        json.loads(run("convert", "ur5e", *radians, "--json")[1])["tool"], data["tool"]
    )


def test_what_convert_prints_is_the_arm(run):
    _, out, _ = run("convert", "fer", *TOOL, *MOUNT)
    names: dict = {}
    exec(out, names)
    arm = ikjax.robots.fer()
    q = np.linspace(-1, 0.5, 7)
    wanted = T((0.5, 0, 0.8), (0, 0, 90)) @ np.asarray(ikjax.fk(arm, q)) @ T((0, 0.02, 0.15), (0, 30, 0))
    np.testing.assert_allclose(ikjax.fk(names["arm"], q), wanted, atol=1e-9)
    assert names["arm"].family == arm.family


@pytest.mark.parametrize(
    ("name", "values", "family"),
    [
        ("fer", {"joint7": 0.3}, "pieper_reversed"),
        ("iiwa7", {"joint3": 0.0}, "ortho_parallel_wrist"),
        ("so101", {"joint5": 0.1}, "turret"),
        ("gx4_351s", {"joint3": -0.05}, None),
    ],
)
def test_an_arm_with_fixed_joints_is_the_same_arm_with_these_at_their_values(name, values, family):
    arm = ikjax.robots.get(name)
    fewer = whole_arm.with_fixed_joints(arm, values)
    ((joint, value),) = values.items()
    i = int(joint[-1]) - 1
    q = np.random.default_rng(0).uniform(-1, 1, arm.n)
    q[i] = value
    np.testing.assert_allclose(ikjax.fk(fewer, np.delete(q, i)), ikjax.fk(arm, q), atol=1e-12)
    np.testing.assert_array_equal(fewer.limits, np.delete(np.asarray(arm.limits), i, 0))
    assert fewer.joint_names == tuple(f"joint{k + 1}" for k in range(arm.n) if k != i)
    assert family is None or fewer.family == family


def test_fixed_joints_are_given_in_degrees_and_refused_by_name(run):
    code, out, _ = run("convert", "iiwa7", "--fixed-joints", "joint3=20", "--json")
    wanted = whole_arm.with_fixed_joints(ikjax.robots.iiwa7(), {"joint3": math.radians(20)})
    np.testing.assert_allclose(json.loads(out)["a"], wanted.a, atol=1e-12)
    assert code == 0 and json.loads(out)["kinds"] == "RRRRRR"
    code, _, err = run("info", "ur5", "--fixed-joints", "elbow=0")
    assert code == 2 and "no joint elbow; the arm has joint1" in err
    assert "takes NAME=VALUE, got 'elbow'" in run("info", "ur5", "--fixed-joints", "elbow")[2]
    assert "--tool takes 3 numbers" in run("info", "ur5", "--tool", "1", "2")[2]


def test_a_tool_may_change_the_closed_form_of_an_arm_of_few_joints():
    arm = ikjax.robots.planar_2r(0.6, 0.3)
    moved = whole_arm.with_tool(arm, T((0, 0, 0.1), (0, 20, 0)))
    q = np.array([0.3, -0.4])
    np.testing.assert_allclose(ikjax.fk(moved, q), ikjax.fk(arm, q) @ T((0, 0, 0.1), (0, 20, 0)), atol=1e-12)
    goal = ikjax.fk(moved, q)
    assert moved.family is None or np.asarray(ikjax.solve(moved, goal).valid).any()


def test_a_study_file_says_the_same_as_the_options(read, run):
    keys = "tool = [0, 0.02, 0.15, 0, 30, 0]\nmount = { xyz = [0.5, 0, 0.8], rpy = [0, 0, 90] }\n"
    arm = read('arm = "ur5e"\n' + keys + STUDY).arm
    data = json.loads(run("convert", "ur5e", *TOOL, *MOUNT, "--json")[1])
    np.testing.assert_allclose(arm.tool, data["tool"], atol=1e-12)
    np.testing.assert_allclose(arm.base, data["base"], atol=1e-12)
    wxyz = 'arm = "ur5e"\ntool = { wxyz = [0, 1, 0, 0] }\n'
    np.testing.assert_allclose(read(wxyz + STUDY).arm.tool, np.diag([1, -1, -1, 1]), atol=1e-12)
    fixed = read('arm = "iiwa7"\nfixed_joints = { joint3 = 20 }\n' + STUDY).arm
    assert (
        fixed.kinds == "RRRRRR"
        and fixed.family == read('arm = "iiwa7"\nfixed_joints = {joint3 = 20}\n' + STUDY).arm.family
    )


def test_angles_of_a_study_are_of_one_unit(read):
    rest = 'arm = "planar_2r"\nlimits = [[-90, 90], [-180, 45]]\nspacing = 0.5\n'
    cone = "orientations = { cone = { direction = [0, 0, 1], half_angle = 30, directions = 4 } }\n"
    study = read('angles = "degrees"\n' + rest + cone)
    np.testing.assert_allclose(study.arm.limits, np.radians([[-90, 90], [-180, 45]]))
    assert study.orientations.half_angle == pytest.approx(math.pi / 6)
    slide = read('angles = "degrees"\narm = "gx4_351s"\nlimits = [[-90, 90], [-9, 9], [-0.1, 0], [-9, 9]]\n'
                 + "spacing = 0.5\norientations = 8\n").arm  # fmt: skip
    assert np.asarray(slide.limits)[2].tolist() == pytest.approx([-0.1, 0])


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ('angles = "grad"', 'angles must be "degrees" or "radians", got \'grad\''),
        ("tool = [1, 2]", "tool must be 6 numbers, got [1, 2]"),
        ("tool = { xyz = [0, 0, 0], rpy = [0, 0, 0], wxyz = [1, 0, 0, 0] }", "give one orientation"),
        ("tool = { length = 1 }", "tool must have the keys xyz, rpy"),
        ("mount = 3", "mount must have the keys xyz, rpy"),
        ("fixed_joints = { joint9 = 1 }", "no joint joint9"),
        ('fixed_joints = { joint1 = "x" }', "fixed_joints is of the wrong kind"),
        ("title = 3", "title must be a text"),
    ],
)
def test_a_wrong_key_is_named(read, text, says):
    with pytest.raises(ValueError, match=re.escape(says)):
        read(f'arm = "ur5"\nspacing = 0.5\norientations = 8\n{text}')


def test_a_new_study_runs_and_is_not_overwritten(run, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    code, out, _ = run("study", "new", "--arm", "ur5e")
    assert code == 0 and "ikjax sweep study.toml" in out
    study = study_file.read(tmp_path / "study.toml")
    assert study.arm.name == "ur5e" and study.free_rolls == 12 and study.positions.shape == (41, 41, 1)
    code, _, err = run("study", "new")
    assert code == 2 and "there already; --force replaces it" in err
    assert run("study", "new", "--force")[0] == 0
    assert study_file.read(tmp_path / "study.toml").arm.name == "puma560"
    assert run("study", "new", "a.txt")[0] == 2 and run("study", "new", "--arm", "nobody")[0] == 2


def test_every_key_and_every_statistic_is_listed(run):
    _, out, _ = run("study", "keys")
    first, *sections = re.split(r"^\[(\w+)\]", out, flags=re.M)
    assert [*re.findall(r"^(\w+) =", first, re.M), *sections[::2]] == list(study_file.KEYS)
    _, out, _ = run("study", "statistics")
    assert "limited_by" in out and "widest_interval" in out
    code, out, _ = run("sweep", "--help")
    assert "ikjax study keys" in out and code == 0


def test_the_studies_of_the_documentation_are_understood(tmp_path):
    found = 0
    for page in sorted(DOCS.rglob("*.md")):
        for block in re.findall(r"^```toml\n(.*?)^```$", page.read_text(), re.S | re.M):
            for name in re.findall(r'"([\w.]+\.csv)"', block):
                (tmp_path / name).write_text("0.5, 0, 0\n0.5, 0.1, 0\n")
            (tmp_path / "study.toml").write_text(block)
            for command in re.findall(r"^\[(place|design)\]", block, re.M) or ["sweep"]:
                options = build_parser().parse_args([command, str(tmp_path / "study.toml")])
                READERS[command](tmp_path / "study.toml", options)
            found += 1
    assert found >= 4


GOALS = "x,y,z,roll,pitch,yaw\n0.2,0.1,-0.05,0,0,30\n0.2,0.05,-0.05,0,0,30\n"


def test_a_file_of_goals_gives_what_single_goals_give(run, tmp_path):
    (tmp_path / "goals.csv").write_text(GOALS)
    one = ["--xyz", "0.2", "0.05", "-0.05", "--rpy", "0", "0", "30", "--json"]
    single = json.loads(run("solve", "gx4_351s", *one)[1])["branches"]
    code, out, err = run("solve", "gx4_351s", "--goals", tmp_path / "goals.csv", "--json")
    assert code == 0, err
    rows = json.loads(out)["goals"]
    assert len(rows) == 2
    for a, b in zip(rows[1]["branches"], single, strict=True):
        assert a["valid"] == b["valid"] and a["q"] == pytest.approx(b["q"], abs=1e-9)


def test_joints_leave_as_csv_and_come_back_in_the_unit_that_is_printed(run, tmp_path):
    arm = ikjax.robots.gx4_351s()
    names = ["joint1 [deg]", "joint2 [deg]", "joint3 [m]", "joint4 [deg]"]
    (tmp_path / "goals.csv").write_text(GOALS)
    code, out, _ = run("solve", "gx4_351s", "--goals", tmp_path / "goals.csv", "--csv", "-")
    rows = list(csv.DictReader(io.StringIO(out)))
    assert code == 0 and [row["branch"] for row in rows] == [*arm.branches] * 2
    for row in rows[:2]:
        q = [float(row[name]) for name in names]
        q = [value if k == 2 else math.radians(value) for k, value in enumerate(q)]
        np.testing.assert_allclose(ikjax.fk(arm, q), T((0.2, 0.1, -0.05), (0, 0, 30)), atol=1e-9)
    goal = ["--xyz", "0.2", "0.1", "-0.05", "--rpy", "0", "0", "30"]
    within = next(row for row in rows[:2] if row["within_limits"] == "1")
    words = ["solve", "gx4_351s", *goal, "--from", *(within[name] for name in names)]
    code, out, _ = run(*words, "--json")
    assert code == 0 and json.loads(out)["nearest"] == int(within["slot"])
    _, out, _ = run(*words, "--explain")
    assert "nearest" in out and "branch 0, " in out


def test_units_of_columns_and_bare_rows(tmp_path):
    def goals(text, **turn):
        (tmp_path / "goals.csv").write_text(text)
        return table.read_goals(str(tmp_path / "goals.csv"), math.pi / 180, turn)

    named = goals(GOALS)
    np.testing.assert_allclose(goals(GOALS.partition("\n")[2]), named)
    np.testing.assert_allclose(
        goals("name,z [mm],x [mm],y [cm],roll,pitch,yaw [rad]\na,-50,200,10,0,0,0.5235987755982988\n"),
        named[:1],
    )
    np.testing.assert_allclose(
        goals("x,y,z,qw,qx,qy,qz\n0.1,0,0,0,1,0,0\n")[0, :3, :3], np.diag([1, -1, -1]), atol=1e-12
    )
    down = goals("x,y,z\n0.1,0,0\n", rpy=np.array([math.pi, 0, 0]))
    np.testing.assert_allclose(down[0, :3, :3], np.diag([1, -1, -1]), atol=1e-12)
    for text, says in (
        ("1,2,3,1,0,0,0\n", "7 columns without names"),
        ("x,y\n1,2\n", "column z is missing"),
        ("a,b,c\n1,2,3\n", "goals need columns x, y, z"),
        ("x,y,z\n1,2\n", "row 2: 3 columns are named, got 2"),
        ("x,y,z\n1,2,nan\n", "z must be a finite number"),
        ("x [ft],y,z\n1,2,3\n", "the units are m, mm"),
        ("", "no goals"),
        ("x,y,z\n", "no goals below"),
    ):
        with pytest.raises(ValueError, match=re.escape(says)):
            goals(text)


def test_project_says_how_far_the_nearest_pose_is(run, tmp_path):
    words = ["project", "planar_2r", "--xyz"]
    code, out, _ = run(*words, "0.5", "0.2", "0", "--json")
    (row,) = json.loads(out)["projections"]
    assert code == 0 and row["position_error"] < 1e-8
    (tmp_path / "goals.csv").write_text("x,y,z\n9,0,0\n0.5,0.2,0\n")
    code, out, _ = run("project", "planar_2r", "--goals", tmp_path / "goals.csv")
    reach = float(np.abs(ikjax.robots.get("planar_2r").a).sum())
    assert "off by [mm]" in out and "q1 [deg]" in out
    assert float(out.splitlines()[2].split()[3]) == pytest.approx(1000 * (9 - reach), rel=1e-3)
    code, _, err = run("project", "planar_2r")
    assert code == 2 and "give a goal with --xyz, or a CSV file" in err


def test_track_follows_a_file_of_goals(run, tmp_path):
    arm = ikjax.robots.get("planar_3r")
    q = np.linspace([0.2, 0.9, 0.3], [0.4, 0.8, 0.4], 5)
    lines = ["x,y,z,qw,qx,qy,qz"]
    for wxyz_xyz in np.asarray(ikjax.to_wxyz_xyz(ikjax.fk(arm, q))):
        lines.append(",".join(f"{x:.15g}" for x in (*wxyz_xyz[4:], *wxyz_xyz[:4])))
    (tmp_path / "path.csv").write_text("\n".join(lines))
    words = ["track", "planar_3r", tmp_path / "path.csv", "--radians", "--from", *q[0]]
    code, out, err = run(*words, "--csv", tmp_path / "joints.csv", "--json")
    data = json.loads(out)
    assert code == 0 and all(data["reached"]) and not any(data["jumped"]), err
    np.testing.assert_allclose(data["q"], q, atol=1e-6)
    rows = list(csv.DictReader((tmp_path / "joints.csv").open()))
    assert float(rows[4]["joint3 [rad]"]) == pytest.approx(0.4, abs=1e-6)


def test_specs_are_compared_in_words_and_hashes_come_last():
    eye = np.eye(4).tolist()
    there = {"arm": {"tool": eye, "a": [0, 0.4, 0.3, 0]}, "fixed": {"x": {"sha256": "abc"}}, "zeta": 1}
    here = {
        "arm": {"tool": T((0, 0, 0.2), (0, 90, 0)).tolist(), "a": [0, 0.4, 0.35, 0]},
        "fixed": {"x": {"sha256": "abd"}},
        "zeta": 2,
    }
    assert manifest.differences(there, here) == [
        "arm.a: 0.3 there, 0.35 here (entry 3)",
        "arm.tool: (0, 0, 0) m there, (0, 0, 0.2) m turned by rpy (0, 90, 0) deg here",
        "zeta: 1 there, 2 here",
        "fixed.x: other numbers",
    ]


def test_fish_completes_commands_options_and_arms(run, tmp_path):
    if shutil.which("fish") is None:
        pytest.skip("fish is not installed")
    (tmp_path / "ikjax.fish").write_text(run("completion", "fish")[1])

    def completed(line):
        call = ["fish", "--no-config", "-c", f'source {tmp_path}/ikjax.fish; complete -C "{line}"']
        done = subprocess.run(call, capture_output=True, text=True, check=True, cwd=tmp_path)
        return [row.split("\t")[0] for row in done.stdout.splitlines()]

    assert completed("ikjax pro") == ["project"]
    assert completed("ikjax solve puma") == ["puma560"]
    assert completed("ikjax place --kee") == ["--keep", "--keep-out"]


def test_zsh_reads_its_script(run):
    if shutil.which("zsh") is None:
        pytest.skip("zsh is not installed")
    script = run("completion", "zsh")[1]
    call = f"{script}\nprint -r -- $_comps[ikjax]"
    done = subprocess.run(["zsh", "-f", "-c", call], capture_output=True, text=True, check=True)
    assert "_ikjax" in done.stdout and not done.stderr


def test_a_shell_completes_commands_options_and_arms(run):
    _, script, _ = run("completion", "bash")
    assert "__fish_seen_subcommand_from solve" in run("completion", "fish")[1]

    def completed(*words):
        call = (
            f'COMP_WORDS=({" ".join(words)}); COMP_CWORD={len(words) - 1}; _ikjax; echo "${{COMPREPLY[@]}}"'
        )
        done = subprocess.run(["bash", "-c", f"{script}\n{call}"], capture_output=True, text=True, check=True)
        return done.stdout.split()

    assert completed("ikjax", "pro") == ["project"]
    assert completed("ikjax", "solve", "puma") == ["puma560"]
    assert completed("ikjax", "track", "--to") == ["--tool"]
