"""The command line: exit codes, JSON, tables and error messages of one line."""

import json
import os
import signal
import subprocess
import sys
import time

import pytest

import ikjax
from ikjax import cli, robots

GOAL = ["--xyz", "0.4", "0.2", "0.3", "--rpy", "179.9", "0", "34.4"]
FAR = ["--xyz", "9", "0", "0"]


STUDY = """
arm = "gx4_351s"
spacing = {spacing}
orientations = {{ wxyz = [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0.8, 0.6, 0]] }}
chunk = [16, 16, 16]
"""


@pytest.fixture
def study(tmp_path):
    pytest.importorskip("tensorstore")

    def written(spacing):
        (tmp_path / "study.toml").write_text(STUDY.format(spacing=spacing))
        return tmp_path / "study.toml"

    return written


@pytest.fixture
def swept(run, study, tmp_path):
    code, out, err = run("sweep", study(0.1), "--out", tmp_path / "a.zarr", "--json")
    assert code == 0, err
    return tmp_path / "a.zarr", json.loads(out)


def test_info_lists_the_catalogue(run):
    code, out, _ = run("info")
    assert code == 0
    assert [line.split()[0] for line in out.splitlines()] == list(robots.names())


def test_info_lists_the_arms_that_a_word_finds(run):
    assert [line.split()[0] for line in run("info", "crx")[1].splitlines()] == list(robots.find("crx"))
    code, out, _ = run("info", "--find", "universal", "ur5", "--json")
    assert code == 0 and set(json.loads(out)) == {"ur5", "ur5e"}
    code, _, err = run("info", "--find", "nobody")
    assert code == 2 and "no arm of the catalogue has nobody" in err


def test_view_shows_an_arm_until_it_is_interrupted(run, monkeypatch):
    shown = {}

    class Viewer:
        def __init__(self, arm, **options):
            shown.update(options, arm=arm)

        def run(self):
            raise KeyboardInterrupt

    arm_viewer = pytest.importorskip("ikjax.plot.arm_viewer")
    monkeypatch.setattr(arm_viewer, "ArmViewer", Viewer)
    code, _, err = run("view", "ur5e", "--tool", 0, 0, 0.1, "--port", 8123)
    assert code == 0 and "Ctrl-C ends it" in err
    assert shown["port"] == 8123 and shown["urdf"] is None and shown["arm"].tool[2, 3] == pytest.approx(0.1)


def test_info_prints_a_table_and_the_family(run):
    code, out, _ = run("info", "puma560")
    assert code == 0
    assert "Arm.from_dh(" in out and "solved by ortho_parallel_wrist" in out


def test_info_prints_the_named_poses_with_the_flange(run):
    code, out, _ = run("info", "ur5e")
    head, *rows = out.splitlines()[-5:]
    assert (code, head) == (0, "Named poses (4), q in deg:")
    assert [row.split()[0] for row in rows] == list(robots.poses("ur5e"))
    # z = 0.1625 + 0.425 + 0.3922 + 0.0997, y = -(0.1333 + 0.0996).
    assert rows[2].endswith("flange at (0, -0.2329, 1.0794) m, q = (0, -90, 0, -90, 0, 0)")
    up = json.loads(run("info", "ur5e", "--json")[1])["poses"]["up"]
    assert up["xyz"] == pytest.approx([0, -0.2329, 1.0794]) and tuple(up["q"]) == robots.poses("ur5e")["up"]
    assert "Named poses" not in run("info", "stanford")[1]


def test_solve_prints_eight_rows(run):
    code, out, err = run("solve", "puma560", *GOAL)
    assert (code, err) == (0, "")
    head, _, *rows = out.splitlines()
    assert head.startswith("puma560: 8 of 8 branches reach the goal")
    assert [row.split()[1] for row in rows] == list(robots.puma560().branches)


def test_solve_takes_the_value_of_a_redundant_joint(run):
    code, out, _ = run("solve", "fer", *GOAL, "--redundancy", "0.3", "--radians")
    assert code == 0 and out.startswith("fer: 8 of 8 branches reach the goal")
    assert all(row.split()[10] == "0.3000" for row in out.splitlines()[2:])
    code, _, err = run("solve", "fer", *GOAL)
    assert code != 0 and "redundancy= must give the value of joint7" in err


def test_negative_numbers_are_numbers(run):
    code, out, _ = run("solve", "ur5", "--xyz", "-0.4", "-.2", "3e-1", "--rpy", "-1", "0", "-0.5", "--json")
    assert code == 0
    assert [row[3] for row in json.loads(out)["goal"][:3]] == pytest.approx([-0.4, -0.2, 0.3])


def test_a_goal_out_of_reach_exits_with_1(run):
    code, out, _ = run("solve", "puma560", *FAR, "--json")
    assert code == 1
    assert not any(row["valid"] for row in json.loads(out)["branches"])


def test_limits_may_leave_nothing(run):
    words = ["solve", "puma560", "--xyz", "0", "0.16", "-0.1"]
    code, out, _ = run(*words, "--json")
    rows = json.loads(out)["branches"]
    assert code == 0 and not any(row["within_limits"] for row in rows)
    assert run(*words, "--limits")[0] == 1


def test_both_precisions_agree(run):
    exact, rough = (
        json.loads(run("solve", "ur5", *GOAL, "--json", *more)[1])["branches"] for more in ([], ["--float32"])
    )
    assert exact[0]["q"] == pytest.approx(rough[0]["q"], abs=1e-4)
    assert exact[0]["q"] != rough[0]["q"]


@pytest.mark.parametrize(
    "words, says",
    [
        (["sweep", "puma560", "--resume"], "--resume needs --out"),
        (["sweep", "puma560", "--force"], "--force needs --out"),
        (["sweep", "nowhere.toml"], "No such file"),
        (["sweep", "nowhere.toml", "--spacing", "1"], "No such file"),
        (["sweep", "ur5", "--redundancy-samples", "8"], "is for arms with redundant joints, ur5 has none"),
        (
            ["sweep", "gx4_351s", "--certify", "--float64"],
            "--certify is for float32 sweeps; --float64 needs none",
        ),
        (["sweep", "ur5", "--compare", "nowhere.zarr"], "holds no ikjax map"),
        (["sweep", "ur5", "--max-hours", "-1"], "not a positive number"),
        (["solve", "nobody", *GOAL], "no robot 'nobody'"),
        (["solve", "no\x1b[31mbody", *GOAL], r"no robot 'no\x1b[31mbody'"),
        (["solve", "puma560", "--xyz", "1", "2"], "--xyz"),
        (["solve", "puma560", "--xyz", "1", "2", "three"], "invalid float value: 'three'"),
        (["solve", "puma560", "--xyz", "nan", "0", "0"], "finite"),
        (["solve", "puma560", "--xyz", "0", "0", "0", "--wxyz", "0", "0", "0", "0"], "length 1"),
        (["solve", "puma560", *GOAL, "--from", "1", "2"], "--from takes 6 values for puma560, got 2"),
        (["solve", "puma560", *GOAL, "--\x1b[2J"], r"\x1b[2J"),
        (["sweep", "puma560", "--spacing", "0"], "not a positive number"),
        (["sweep", "puma560", "--spacing", "nan"], "not a positive number"),
        (["sweep", "puma560", "--spacing", "1e-6"], "positions, 2^31 or more"),
        (["sweep", "puma560", "--spacing", "0.3", "--orientations", "0", "--json"], "n must be at least 1"),
        (["sweep", "puma560", "--picture", "map.exe"], "--picture must end in"),
        (["show", "nowhere.zarr"], "holds no ikjax map"),
        (["fly"], "invalid choice: 'fly'"),
        ([], "COMMAND"),
    ],
)
def test_bad_input_exits_with_2_and_one_line(run, words, says):
    code, out, err = run(*words)
    assert (code, out) == (2, "")
    assert err.startswith("ikjax") and err.count("\n") == 1
    assert says in err and "\x1b" not in err


def test_millimetres_are_noticed(run):
    code, _, err = run("solve", "puma560", "--xyz", "4000", "0", "0")
    assert code == 1
    assert "are these millimetres?" in err and err.count("\n") == 1


def test_something_else_at_out_is_left_alone_before_anything_is_swept(run, tmp_path):
    pytest.importorskip("tensorstore")
    (tmp_path / "letter").write_text("dear")
    code, _, err = run("sweep", "ur5", "--out", tmp_path / "letter")
    assert code == 2 and "left alone" in err
    assert (tmp_path / "letter").read_text() == "dear"


def test_a_stored_map_shows_what_the_sweep_said(run, swept, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    path, said = swept
    code, out, _ = run("show", path, "--json")
    assert said.pop("units") == {"total": 1, "kept": 0, "missing": 1, "damaged": 0}
    assert code == 0 and json.loads(out) == said
    assert not list(tmp_path.glob("*.html"))


def test_a_damaged_map_is_refused(run, swept):
    path, _ = swept
    chunk = next(
        file for file in (path / "solutions").rglob("*") if file.is_file() and file.name != "zarr.json"
    )
    data = bytearray(chunk.read_bytes())
    data[5] ^= 1
    chunk.write_bytes(data)
    code, _, err = run("show", path)
    assert code == 2 and "solutions is damaged" in err


def test_a_stored_map_becomes_a_picture(run, swept, tmp_path):
    pytest.importorskip("matplotlib")
    picture = tmp_path / "deep" / "map.png"
    code, _, err = run("show", swept[0], "--picture", picture)
    assert code == 0, err
    assert picture.stat().st_size > 10_000


def test_a_map_has_a_page_and_two_maps_are_compared(run, swept, tmp_path, monkeypatch):
    pytest.importorskip("matplotlib")
    monkeypatch.chdir(tmp_path)
    code, out, err = run("show", swept[0], swept[0])
    assert code == 0, err
    assert (
        out.startswith("gx4_351s: ")
        and "positions that differ      0" in out
        and "page              a-a.html" in out
    )
    text = (tmp_path / "a-a.html").read_text()
    assert "Compared" in text and "0 better" not in text  # the counts are in the picture
    assert (tmp_path / "a-a.png").stat().st_size > 10_000


def test_without_matplotlib_a_map_still_has_its_summary(run, swept, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    monkeypatch.setitem(sys.modules, "matplotlib.pyplot", None)
    code, out, err = run("show", swept[0])
    assert code == 0 and out.startswith("gx4_351s: ") and "pip install ikjax[viz]" in err
    assert run("show", swept[0], "--page", "b.html")[0] == 2


@pytest.mark.slow
def test_an_arm_of_seven_joints_is_swept_and_drawn(run, tmp_path):
    pytest.importorskip("matplotlib")
    pytest.importorskip("tensorstore")
    out, picture = tmp_path / "map.zarr", tmp_path / "map.png"
    words = ["sweep", "fer", "--spacing", "0.5", "--orientations", "8", "--redundancy-samples", "4"]
    code, text, err = run(*words, "--out", out, "--picture", picture)
    assert code == 0, err
    assert "x 8 orientations, 4 values of joint7" in text and picture.stat().st_size > 10_000
    code, _, err = run(*words[:-1], "5", "--out", out, "--resume")
    assert code == 2 and "redundancy_samples: 4 there, 5 here" in err
    code, text, err = run("show", out, "--page", tmp_path / "map.html")
    assert code == 0, err
    assert "free_rolls=1, redundancy_samples=4" in (tmp_path / "map.html").read_text()


def test_doctor_finds_this_device_well(run):
    code, out, _ = run("doctor", "--json")
    data = json.loads(out)
    assert code == 0 and all(check["ok"] for check in data["checks"])
    assert {"python", "jax", "jaxlib", "numpy", "devices"} <= set(data)


def test_a_reader_that_leaves_early_is_no_error():
    command = [sys.executable, "-m", "ikjax.cli", "info"]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, env=environment
    ) as program:
        program.stdout.close()
        assert program.wait(120) == 0
        assert b"Traceback" not in program.stderr.read()


def test_a_slide_is_printed_in_meters(capsys):
    code = cli.main(["solve", "gx4_351s", "--xyz", "0.2", "0.1", "-0.05", "--rpy", "0", "0", "17"])
    out = capsys.readouterr().out
    assert code == 0
    assert "q3 [m]" in out and "-0.0500" in out and "q1 [deg]" in out


def test_an_arm_can_be_a_urdf_file(capsys, tmp_path):
    file = tmp_path / ("deep" * 30) / "two.urdf"
    file.parent.mkdir()
    text = '<robot name="two"><link name="a"/><link name="b"/><link name="c"/><link name="d"/>'
    joints = ("j1", "revolute", "a", "b"), ("j2", "revolute", "b", "c"), ("t", "fixed", "c", "d")
    for name, kind, above, below in joints:
        text += f'<joint name="{name}" type="{kind}"><parent link="{above}"/><child link="{below}"/>'
        text += '<origin xyz="1 0 0"/><axis xyz="0 0 1"/>'
        text += '<limit lower="-1" upper="1" effort="1" velocity="1"/></joint>'
    file.write_text(text + "</robot>")
    assert cli.main(["info", str(file)]) == 0
    assert "planar_position" in capsys.readouterr().out
    file.write_text("<robot")
    assert cli.main(["info", str(file)]) == 2
    assert "two.urdf" in capsys.readouterr().err


JOINT = """<joint name="{0}" type="{1}"><parent link="{2}"/><child link="{3}"/><origin xyz="0.5 0 0"/>
<axis xyz="0 {4} 1"/><limit lower="-1" upper="1"/></joint>"""


@pytest.fixture
def forked(tmp_path, monkeypatch):
    """A SCARA, its axes parallel to 1e-3 only, with a camera beside its tool, as a file."""
    monkeypatch.chdir(tmp_path)
    rows = ["j1 revolute a b 0", "j2 revolute b c 0.001", "j3 prismatic c d 0", "j4 revolute d e 0"]
    rows += ["t fixed e tool 0", "k fixed e camera 0"]
    links = "".join(f'<link name="{name}"/>' for name in ("a", "b", "c", "d", "e", "tool", "camera"))
    text = f'<robot name="forked">{links}{"".join(JOINT.format(*row.split()) for row in rows)}</robot>'
    (tmp_path / "forked.URDF").write_text(text)
    (tmp_path / "forked").write_text(text)
    return "forked.URDF"


@pytest.mark.parametrize(
    "words",
    [
        ["info"],
        ["solve", "--xyz", "0.5", "0.5", "0"],
        ["verify", "-n", "50"],
        ["sweep", "--spacing", "0.5", "--orientations", "1"],
    ],
)
def test_every_command_takes_the_ends_of_a_files_arm_and_its_tolerance(run, forked, words):
    if words[0] == "sweep":
        pytest.importorskip("tensorstore")
    words = [words[0], forked, *words[1:]]
    code, _, err = run(*words, "--tip", "hand")
    assert code == 2 and '--tip "hand" is none of' in err
    ends = ["--base", "a", "--tip", "tool", "--axis-tolerance"]
    code, out, err = run(*words, *ends, "1e-5")
    if words[0] == "info":
        assert code == 0 and "no closed form here: axes 1, 2, 3, 4 are 0.0573 deg" in out
        assert "build it with --axis-tolerance 1e-3" in out and "axis_tolerance=" not in out
    else:
        assert code == 2 and "build it with --axis-tolerance 1e-3" in err and "axis_tolerance=" not in err
    code, out, err = run(*words, *ends, "1e-2")
    assert code < 2 and "forked" in out, err  # nothing need be reached


def test_a_file_is_known_by_its_ending_or_by_being_there(run, forked):
    assert run("info", "forked", "--tip", "tool")[0] == 0
    for name in ("nowhere.urdf", "nowhere.URDF", "deep/nowhere.xml"):
        code, _, err = run("info", name)
        assert code == 2 and "No such file" in err and name in err
    code, _, err = run("info", "nowhere")
    assert code == 2 and "no such file, and no robot 'nowhere'; the catalogue has" in err


def test_an_option_of_files_is_refused_for_the_catalogue(run):
    code, _, err = run("info", "ur5", "--tip", "tool0")
    assert code == 2 and "--tip goes with a URDF file, ur5 is of the catalogue" in err


def test_a_goal_may_be_a_rotation_vector_or_a_quaternion_with_its_scalar_last(run):
    words = ["solve", "ur5", "--xyz", "0.4", "0.2", "0.3", "--json"]
    turns = [["--rpy", "0", "0", "1", "--radians"], ["--rotvec", "0", "0", "57.29577951308232"]]
    turns.append(["--xyzw", "0", "0", "0.479425538604203", "0.8775825618903728"])
    goals = [json.loads(run(*words, *turn)[1])["goal"] for turn in turns]
    for goal in goals[1:]:
        for row, wanted in zip(goal, goals[0], strict=True):
            assert row == pytest.approx(wanted)


def test_verify_checks_arms_and_writes_a_table(capsys, tmp_path):
    table = tmp_path / "table.md"
    assert cli.main(["verify", "planar_3r", "gx4_351s", "-n", "500", "--out", str(table)]) == 0
    rows = [line.split() for line in capsys.readouterr().out.splitlines()]
    assert [row[0] for row in rows] == ["arm", "planar_3r", "gx4_351s"]
    for row in rows[1:]:
        assert row[3:9] == ["500", "500", "0", "0", "0", "50"]
    assert table.read_text().startswith("| arm | family |")


def test_verify_finds_a_wrong_answer(monkeypatch):
    import dataclasses

    from ikjax.ik import verify

    def lying(arm, goals, **values):
        sol = ikjax.solve(arm, goals, **values)
        return dataclasses.replace(sol, q=sol.q + 1e-3)

    monkeypatch.setattr(verify, "solve", lying)
    report = verify.verify(ikjax.robots.planar_3r(), 200)
    assert report.wrong > 200 and report.success == 0


def test_a_study_is_swept_continued_and_compared(run, study, tmp_path):
    words = ["sweep", study(0.03), "--out", tmp_path / "map.zarr"]
    code, _, err = run(*words, "--max-hours", 1e-9)
    assert code == 4 and "stopped: 1e-09 hours are over; " in err and "map.zarr holds 1 of 8 units" in err
    code, _, err = run("show", tmp_path / "map.zarr")
    assert code == 2 and "unfinished: 7 of 8 units are missing; go on" in err
    code, _, err = run(*words)
    assert code == 2 and "holds an unfinished map; go on with resume=True (--resume), or replace" in err
    code, out, _ = run(*words, "--resume", "--json")
    said = json.loads(out)
    assert code == 0 and said["units"] == {"total": 8, "kept": 1, "missing": 7, "damaged": 0}
    code, _, err = run(*words)
    assert code == 2 and "holds a finished map; go on with resume=True (--resume), or replace it" in err
    code, out, _ = run(*words, "--force", "--compare", tmp_path / "map.zarr")
    assert code == 0 and "positions that differ      0" in out
    log = (tmp_path / "map.zarr.log").read_text()
    assert "1 of 8 units kept, 7 missing, 0 damaged" in log and "SweepStoppedError" in log
    study(0.06)
    code, _, err = run(*words, "--resume")
    assert code == 2 and "positions.spacing: 0.03 there, 0.06 here" in err


def test_a_map_that_cannot_be_written_exits_with_3(run, study, tmp_path):
    (tmp_path / "letter").write_text("dear")
    code, _, err = run("sweep", study(0.2), "--out", tmp_path / "letter" / "map.zarr")
    assert code == 3 and "cannot write" in err.splitlines()[-1]


@pytest.mark.parametrize("name, code", [("SIGINT", 130), ("SIGTERM", 143)])
def test_a_signal_stops_a_sweep_that_can_be_continued(run, study, tmp_path, name, code):
    words = ["sweep", str(study(0.004)), "--out", str(tmp_path / "map.zarr")]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    command = [sys.executable, "-m", "ikjax.cli", *words]
    with subprocess.Popen(command, stderr=subprocess.PIPE, env=environment, text=True) as program:
        while not list((tmp_path / "map.zarr" / "best_margin" / "c").glob("*/*/*")):
            assert program.poll() is None
            time.sleep(0.02)
        program.send_signal(getattr(signal, name))
        _, err = program.communicate(timeout=60)
        assert program.returncode == code
    assert f"stopped: {name}; " in err and "units; go on with resume=True (--resume)" in err
    assert not (tmp_path / "map.zarr.lock").exists()
    _, _, err = run(*words, "--resume", "--max-hours", "1e-9")
    assert int(err.split(" holds ")[1].split(" of ")[0]) >= 2


def test_compiled_programs_are_kept_in_the_users_cache_folder(tmp_path):
    environment = {k: v for k, v in os.environ.items() if k != "JAX_COMPILATION_CACHE_DIR"}
    environment |= {"XDG_CACHE_HOME": str(tmp_path)}
    goal = ["--xyz", "0.5", "0.2", "0", "--rpy", "0", "0", "0"]
    command = [sys.executable, "-m", "ikjax.cli", "solve", "planar_2r", *goal]
    subprocess.run([*command, "--no-cache"], env=environment, check=False, capture_output=True)
    assert not (tmp_path / "ikjax").exists()
    done = subprocess.run(command, env=environment, check=False, capture_output=True)
    assert done.returncode in (0, 1), done.stderr
    assert any((tmp_path / "ikjax").iterdir())
