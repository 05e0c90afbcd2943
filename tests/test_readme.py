"""The README's examples run unchanged."""

import os
import pathlib
import re
import subprocess
import sys

import pytest

ROOT = pathlib.Path(__file__).parent.parent
README = (ROOT / "README.md").read_text()


def blocks(language: str, text: str = README) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", text, re.S)


def run(command, cwd) -> subprocess.CompletedProcess:
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    return subprocess.run(command, cwd=cwd, env=environment, capture_output=True, text=True)


@pytest.mark.parametrize("code", blocks("python"), ids=lambda code: f"{len(code)} characters")
def test_the_python_of_the_readme_runs(code, tmp_path):
    done = run([sys.executable, "-c", code], tmp_path)
    assert done.returncode == 0, done.stderr[-2000:]


@pytest.mark.slow
def test_the_python_of_the_page_on_gradients_runs(tmp_path):
    (code,) = blocks("python", (ROOT / "docs" / "gradients.md").read_text())
    done = run([sys.executable, "-c", code], tmp_path)
    assert done.returncode == 0, done.stderr[-2000:]


def test_the_commands_of_the_readme_run(tmp_path):
    assert len(blocks("python")) > 2
    commands = [line for block in blocks("console") for line in block.splitlines() if line.startswith("$ ")]
    assert commands
    for command in commands:
        words = command.removeprefix("$ ").split()
        assert words[0] == "ikjax"
        done = run([sys.executable, "-m", "ikjax.cli", *words[1:]], tmp_path)
        assert done.returncode == 0, command + done.stderr[-2000:]


def test_the_readme_begins_with_the_two_commands():
    first = blocks("sh")[0].splitlines()
    assert [line.split("#")[0].strip() for line in first] == ["make sweep", "make test"]
