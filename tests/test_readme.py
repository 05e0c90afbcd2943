"""The README's examples run unchanged."""

import os
import pathlib
import re
import subprocess
import sys

ROOT = pathlib.Path(__file__).parent.parent
README = (ROOT / "README.md").read_text()


def blocks(language: str, text: str = README) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", text, re.S)


def run(command, cwd) -> subprocess.CompletedProcess:
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    return subprocess.run(command, cwd=cwd, env=environment, capture_output=True, text=True)


def test_the_readme_shows_the_quickstart_and_what_it_prints(tmp_path):
    quickstart = ROOT / "examples" / "quickstart.py"
    assert blocks("python") == [quickstart.read_text()]
    done = run([sys.executable, str(quickstart)], tmp_path)
    assert done.returncode == 0, done.stderr[-2000:]
    assert blocks("text") == [done.stdout]


def test_the_readme_fits_two_screens_and_its_links_lead_somewhere():
    assert len(README.splitlines()) < 140
    for link in re.findall(r"\]\(([^)#]+)\)", README):
        assert link.startswith("https://") or (ROOT / link).exists(), link


def test_the_commands_of_the_readme_run(tmp_path):
    commands = [line for block in blocks("console") for line in block.splitlines() if line.startswith("$ ")]
    assert commands
    for command in commands:
        words = command.removeprefix("$ ").split()
        assert words[0] == "ikjax"
        done = run([sys.executable, "-m", "ikjax.cli", *words[1:]], tmp_path)
        assert done.returncode == 0, command + done.stderr[-2000:]


def test_the_first_commands_of_the_readme_are_the_two():
    first = blocks("sh")[0].splitlines()
    assert [line.split("#")[0].strip() for line in first] == ["make sweep", "make test"]
