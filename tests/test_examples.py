"""Every example runs as it stands, and ends with asserts of its own."""

import os
import pathlib
import subprocess
import sys

import pytest

ROOT = pathlib.Path(__file__).parent.parent
NEEDS = {"mjx_rollout": "mujoco.mjx"}
SLOW = {"branches_as_seeds", "mjx_rollout", "so101_follower"}
"""They compile for more than ten seconds. `quickstart` is in `test_readme.py`."""


def examples():
    for path in sorted((ROOT / "examples").glob("*.py")):
        if path.stem != "quickstart":
            yield pytest.param(path, id=path.stem, marks=[pytest.mark.slow] if path.stem in SLOW else [])


@pytest.mark.parametrize("path", list(examples()))
def test_an_example_runs_and_its_asserts_hold(path, tmp_path):
    if path.stem in NEEDS:
        pytest.importorskip(NEEDS[path.stem])
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    done = subprocess.run(
        [sys.executable, path], cwd=tmp_path, env=environment, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr[-2000:]
    assert done.stdout
