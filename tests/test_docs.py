"""The Python of the documentation runs, page by page, and prints what the page shows.

Blocks of a page run from top to bottom in one namespace, in a process of their own. A block ```` ```text ````
right after a block of Python is what that block printed; its numbers may differ in their last digits. A fence
```` ```{.python .norun} ````, or a first line `# not run`, is skipped: what needs a file or a cluster.
"""

import json
import os
import pathlib
import re
import subprocess
import sys

import numpy as np
import pytest

ROOT = pathlib.Path(__file__).parent.parent
DOCS = ROOT / "docs"
PAGES = sorted(DOCS.rglob("*.md"))
QUICK = ("index.md", "conventions/frames.md")
"""The pages that the fast tests run: the others compile for long."""
SLOW = ("gradients.md", "jit.md", "how-to/urdf.md", "how-to/limits.md", "how-to/maps.md")
"""Those of the slow form, and all of `extending/`; the rest is of the long form."""

BLOCKS = re.compile(r"^```(python|text)\n(.*?)^```$(\n*)", re.S | re.M)
NUMBER = re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:e[-+]?\d+)?")
DRIVER = """
import contextlib, io, json, sys
blocks, said, names = json.load(sys.stdin), [], {"__name__": "__main__"}
for block in blocks:
    out = io.StringIO()
    with contextlib.redirect_stdout(out):
        exec(compile(block, "<block>", "exec"), names)
    said.append(out.getvalue())
print(json.dumps(said))
"""


def examples(page: pathlib.Path) -> list[tuple[str, str | None]]:
    """The blocks of Python that run, each with the output that the page shows, if it shows any."""
    found: list[tuple[str, str | None]] = []
    text, end = page.read_text(), None
    for block in BLOCKS.finditer(text):
        language, code, _ = block.groups()
        if language == "python" and not code.startswith("# not run"):
            found.append((code, None))
            end = block.end()
        elif language == "text" and end == block.start() and found:
            found[-1] = found[-1][0], code
    return found


def alike(shown: str, said: str) -> bool:
    """Whether two outputs are the same but for spaces and the last digits of numbers."""
    first, second = (re.sub(r"\s+", "", NUMBER.sub("#", text)) for text in (shown, said))
    numbers = [np.array([float(x) for x in NUMBER.findall(text)]) for text in (shown, said)]
    return (
        first == second and len(numbers[0]) == len(numbers[1]) and np.allclose(*numbers, rtol=0.02, atol=2e-3)
    )


def _mark(page):
    name = str(page.relative_to(DOCS))
    slow = name in SLOW or name.startswith("extending/")
    marks = [] if name in QUICK else [pytest.mark.slow if slow else pytest.mark.long]
    return pytest.param(page, id=name, marks=marks)


@pytest.mark.parametrize("page", [_mark(page) for page in PAGES if examples(page)])
def test_the_python_of_a_page_runs_and_prints_what_is_shown(page, tmp_path):
    blocks = examples(page)
    done = subprocess.run(
        [sys.executable, "-c", DRIVER],
        input=json.dumps([code for code, _ in blocks]),
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(ROOT), "MPLBACKEND": "Agg"},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr[-2000:]
    for (code, shown), said in zip(blocks, json.loads(done.stdout), strict=True):
        assert shown is None or alike(shown, said), f"{code}\nprinted\n{said}"


def test_every_family_has_a_page_with_its_facts_and_its_picture():
    from ikjax.solvers.families import FAMILIES

    for name in FAMILIES:
        assert f"<!-- family: {name} -->" in (DOCS / "families" / f"{name}.md").read_text()
        assert (DOCS / "pictures" / f"{name}.png").exists()


def test_every_public_name_stands_in_the_api():
    import ikjax

    text = "".join(page.read_text() for page in (DOCS / "api").glob("*.md"))
    for module in (ikjax, ikjax.maps):
        lines = pathlib.Path(module.__file__).read_text()
        for name in re.findall(r"^from \S+ import (\w+) as \1$", lines, re.M):
            assert name in ("maps", "robots", "objectives") or re.search(rf"^::: \S+\.{name}$", text, re.M), (
                name
            )
