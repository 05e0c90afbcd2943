"""The commands on a map's page make the map again, bit by bit, when they are run unchanged."""

import html
import os
import pathlib
import re
import subprocess
import sys

import pytest

import ikjax

pytest.importorskip("tensorstore")
pytest.importorskip("matplotlib").use("Agg")
page = pytest.importorskip("ikjax.plot.page")

ROOT = pathlib.Path(__file__).parent.parent
BOX = {"lower": (0.2, -0.3, 0.0), "upper": (0.6, 0.3, 0.4), "spacing": 0.1}
MAPS = {
    "float64": {"orientations": 12, "dtype": "float64"},
    "a list": {
        "orientations": ikjax.maps.even_rotations(12).rotations[::2],
        "dtype": "float32",
        "free_rolls": 2,
    },
    "certified": {"orientations": ikjax.maps.hopf(0), "dtype": "float32", "certify": True},
    "mask": {"orientations": ikjax.maps.cone((0, 0, -1), 0.5, 9), "statistics": ["mask", "best_sigma_min"]},
    "near": {"orientations": 16, "statistics": ["reachable", ikjax.maps.Near(0.01, 0.5, "nearly")]},
}


def swept(folder, name: str) -> pathlib.Path:
    """A stored map, whose name has a space and a quote."""
    out = folder / f"{name}'s map.zarr"
    arm = ikjax.robots.motoman_l3() if name == "near" else ikjax.robots.puma560()
    ikjax.sweep(arm, ikjax.maps.grid(**BOX), out=out, **MAPS[name])
    return out


def run(folder, *words) -> str:
    """The output of a program, started as by a user: without this suite's settings."""
    kept = {key: value for key, value in os.environ.items() if key != "JAX_ENABLE_X64"}
    paths = {"PYTHONPATH": str(ROOT), "PATH": f"{folder / 'bin'}{os.pathsep}{os.environ['PATH']}"}
    done = subprocess.run(
        words, cwd=folder, env={**kept, **paths}, capture_output=True, text=True, timeout=300
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def parts(words: str) -> tuple[str, str]:
    """The commands of a page, in Python and in a shell."""
    python, mark, shell = words.partition("# in a shell")
    assert mark and "ikjax.sweep" in python
    return python, mark + shell


def again(folder, out) -> None:
    """Assert that the map that the commands made has the bits of the first."""
    first, second = (ikjax.ReachMap.load(each).to_numpy() for each in (out, folder / "again.zarr"))
    assert {k: v.tobytes() for k, v in first.items()} == {k: v.tobytes() for k, v in second.items()}
    assert first


@pytest.mark.slow
@pytest.mark.parametrize("name", MAPS)
def test_the_python_of_a_page_makes_the_same_bits(name, tmp_path):
    out = swept(tmp_path, name)
    python, _ = parts(page.repeat(ikjax.ReachMap.load(out), out.name))
    run(tmp_path, sys.executable, "-c", python)
    again(tmp_path, out)


@pytest.mark.slow
def test_all_commands_are_run_as_they_stand_on_the_page(tmp_path):
    out = swept(tmp_path, "a list")
    (tmp_path / "bin").mkdir()
    command = tmp_path / "bin" / "ikjax"
    command.write_text(f'#!/bin/sh\nexec "{sys.executable}" -m ikjax.cli "$@"\n')
    command.chmod(0o755)
    run(tmp_path, "ikjax", "show", out.name)
    (shown,) = tmp_path.glob("*.html")
    _, _, after = shown.read_text().partition("How to repeat it")
    python, shell = parts(html.unescape(re.search(r"<pre>(.*?)</pre>", after, re.DOTALL)[1]))
    run(tmp_path, sys.executable, "-c", python)
    again(tmp_path, out)
    shown.unlink()
    printed = run(tmp_path, "sh", "-e", "-c", shell)
    assert "positions that differ      0" in printed
    assert shown.exists() and (tmp_path / "again.html").exists()


def test_a_custom_measure_is_left_to_the_user(tmp_path):
    count = ikjax.maps.Measure("most", lambda sol: sol.valid.sum(-1).astype("float32"), "max")
    positions = ikjax.maps.grid((0.4, 0, 0), (0.5, 0.1, 0.1), 0.1)
    reach = ikjax.sweep(ikjax.robots.gx4_351s(), positions, 4, statistics=["reachable", count])
    python, _ = parts(page.repeat(reach, "map.zarr"))
    assert "most = ...  # the ikjax.maps.Measure" in python and "statistics=['reachable', most]" in python


@pytest.mark.slow
def test_a_map_without_counts_is_shown_on_a_page_without_their_pictures(tmp_path):
    out = swept(tmp_path, "mask")
    printed = run(tmp_path, sys.executable, "-m", "ikjax.cli", "show", out.name)
    assert "page" in printed and "picture" not in printed
    assert not list(tmp_path.glob("*.png"))
