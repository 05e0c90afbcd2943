"""Text from a file stays text in every medium: one hostile name is passed to everything that shows it."""

import dataclasses
import html
import json
import re
from types import SimpleNamespace

import numpy as np
import pytest

import ikjax
from ikjax import cli
from ikjax.cli import whole_arm
from ikjax.maps import reach_map
from ikjax.maps.sets.positions import Grid
from ikjax.maps.store import log
from ikjax.synthesis.design import DesignResult
from ikjax.synthesis.place import Placements

NAME = (
    "</title><script>alert(1)</script><img src=q> ![x](/etc/hostname) [y](javascript:z) http://a.bc `|` {1+1}"
    "\x1b[2J\r\u202e $\\frac$\nforged: all is well"
)


def named(arm):
    slots = tuple(f"{NAME} {k}" for k in range(len(arm.branches)))
    return dataclasses.replace(arm, name=NAME, branches=slots)


ARM = named(ikjax.robots.gx4_351s())


@pytest.fixture(scope="module")
def reach():
    reach = ikjax.sweep(ikjax.robots.gx4_351s(), ikjax.maps.around(ARM, 0.2), 1)
    return dataclasses.replace(reach, arm=ARM)


def is_one_line_of(name: str, lines: str) -> None:
    """`lines` are printable, contain the name, and the name has forged none of them."""
    assert all(c.isprintable() or c == "\n" for c in lines)
    assert name in lines and not any(line.startswith("forged") for line in lines.splitlines())


def test_words_and_reprs_and_errors(reach):
    flags = np.zeros((1, 3), bool)
    zeros = np.zeros((1, 1, 1, 1))
    bases = Placements(
        ARM, np.zeros((3, 4, 4)), np.eye(4)[None], *np.zeros((2, 1)), flags, np.zeros(1), np.eye(4)[None],
        *np.zeros((2, 1)), Grid((0, 0, 0), 1, (1, 1, 1)), np.zeros(1), zeros,
    )  # fmt: skip
    designed = DesignResult(
        ARM, ARM, {}, 0.0, 0.0, flags, flags * 1.0, np.zeros(1), np.zeros((1, 0)), np.zeros((0, 1)), 0.0,
        np.zeros(0), np.zeros((1, 3, 4, 4)),
    )  # fmt: skip
    texts = [repr(ARM), ikjax.explain(ARM), reach.summary(), str(bases), designed.report()]
    with pytest.raises(ValueError) as error:
        ikjax.solve(dataclasses.replace(ARM, family=None), np.eye(4))
    for lines in (*texts, str(error.value)):
        is_one_line_of(ARM.name, lines)
    is_one_line_of(repr(ARM.name), str(ARM))
    assert ARM.name in repr(reach) and "\x1b" not in repr(reach)


def test_a_log(tmp_path):
    with log.Log(tmp_path / "map.zarr") as writer:
        writer.line(f"{NAME}, fingerprint 7")
    (line,) = (tmp_path / "map.zarr.log").read_text(encoding="utf-8").splitlines()
    is_one_line_of("$\\frac$ forged: all is well, fingerprint 7", line)


def test_a_terminal(reach, tmp_path, capsys, monkeypatch):
    pytest.importorskip("tensorstore")
    reach.save(tmp_path / "map.zarr")
    assert cli.main(["show", str(tmp_path / "map.zarr"), "--json"]) in (0, 1)
    assert json.loads(capsys.readouterr().out)["arm"] == ARM.name
    monkeypatch.setattr(whole_arm, "find_arm", lambda name, **options: ARM)
    assert cli.main(["info", "x.urdf"]) == 0
    is_one_line_of(ARM.name, capsys.readouterr().out)


@pytest.mark.slow
def test_a_table_in_markdown(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(whole_arm, "find_arm", lambda name, **options: ARM)
    table = tmp_path / "table.md"
    assert cli.main(["verify", "x", "-n", "10", "--out", str(table)]) == 0
    is_one_line_of(ARM.name, capsys.readouterr().out)
    row = table.read_text(encoding="utf-8").splitlines()[2]
    assert not set(row) & set("<>[]()!*`{}$\\") and row.count("|") == 11


def test_a_stored_map_comes_back_under_its_name_and_differences_are_lines(reach, tmp_path):
    pytest.importorskip("tensorstore")
    reach.save(tmp_path / "map.zarr")
    back = ikjax.ReachMap.load(tmp_path / "map.zarr")
    assert back.arm.name == ARM.name and back.arm.branches == ARM.branches
    is_one_line_of(ARM.name, back.summary())
    text = reach_map.in_words(reach_map.compare(reach, back), "the first")
    assert "\x1b" not in text
    from ikjax.maps.store import manifest

    assert all(line.isprintable() for line in manifest.differences({NAME: 1, "a": {NAME: 2}}, {"a": {}}))


@pytest.mark.parametrize(
    "change", [{"free_rolls": "1); evil("}, {"dtype": "evil"}, {"statistics": "../evil"}]
)
def test_a_map_whose_spec_would_be_a_path_or_a_program_is_refused(reach, tmp_path, change):
    pytest.importorskip("tensorstore")
    from ikjax.maps.store import manifest

    reach.save(tmp_path / "map.zarr")
    file = tmp_path / "map.zarr" / "zarr.json"
    head = manifest.read_group(file.read_bytes())
    if name := change.pop("statistics", None):
        change = {"statistics": {name: head.spec["statistics"]["reachable"]}}
    file.write_bytes(manifest.group_document(head._replace(spec={**head.spec, **change})))
    with pytest.raises(ValueError, match="no map that a sweep has written"):
        ikjax.ReachMap.load(tmp_path / "map.zarr")
    family = {**head.arm, "family": "evil"}
    file.write_bytes(manifest.group_document(head._replace(arm=family)))
    with pytest.raises(ValueError, match="no family 'evil'"):
        ikjax.ReachMap.load(tmp_path / "map.zarr")


@pytest.mark.slow
def test_a_page(reach):
    pytest.importorskip("matplotlib").use("Agg")
    from ikjax.plot.page import page

    text = page(reach, reach, NAME)
    tags = set(re.findall(r"</?\w+", text))
    assert not tags & {"<script", "</script", "</html><"} and text.count("<img") == text.count('<img alt="" ')
    assert text.count("</title>") == 1 and html.escape(ARM.name) in text
    assert all(c.isprintable() or c == "\n" for c in text)


def test_pictures(reach):
    pytest.importorskip("matplotlib").use("Agg")
    from matplotlib import cbook, pyplot
    from matplotlib.text import Text

    from ikjax import plot

    goal = ikjax.fk(ARM, np.array([0.3, 0.4, -0.1, 0.2]))
    odd = dataclasses.replace(
        reach,
        arrays={**reach.arrays, "$a$": reach.arrays["best_margin"]},
        statistic_specs={**reach.statistic_specs, "$a$": reach.statistic_specs["best_margin"]},
    )
    with pyplot.rc_context({"text.usetex": True}):
        for figure in (
            plot.reach_map(reach, slices=[("z", 0)], q=np.zeros(4)),
            plot.nested(reach, q=np.zeros(4)),
            plot.comparison(reach, reach, slices=[("z", 0)]),
            plot.histogram(odd, "$a$"),
            plot.branches(ARM, goal),
        ):
            texts = [text for text in figure.findobj(Text) if "$" in text.get_text()]
            assert texts and not any(cbook.is_math_text(text.get_text()) for text in texts)
            assert not any(text.get_usetex() or "\x1b" in text.get_text() for text in texts)
            pyplot.close(figure)


def test_the_viewer(reach):
    pytest.importorskip("matplotlib")
    viewer = pytest.importorskip("ikjax.plot.viewer")
    panels = []

    class Stub:
        def __getattr__(self, name):
            if name == "add_markdown":
                return lambda content: panels.append(SimpleNamespace(content=content)) or panels[-1]
            start = {"add_dropdown": "y", "add_slider": 0.5, "add_checkbox": False}.get(name)
            return lambda *_, **given: SimpleNamespace(
                value=start,
                on_update=lambda call: None,
                on_click=lambda call: None,
                position=given.get("position"),
                wxyz=given.get("wxyz"),
            )

    shown = viewer.Viewer(
        reach, server=SimpleNamespace(scene=Stub(), gui=Stub(), initial_camera=SimpleNamespace())
    )
    shown.goal.position = np.asarray(ikjax.fk(ARM, np.array([0.3, 0.4, -0.1, 0.2])))[:3, 3]
    shown.draw_branches()
    title, branches = (panel.content for panel in panels)
    assert branches.count("\n- ") == 2  # and none that a name has forged
    for text in (title, branches):
        assert not set(re.sub(r"\*\*|\(outside the limits\)|&#\d+;", "", text)) & set("<>[]!*`{}$\\")
        assert ARM.name in html.unescape(text).replace("\N{WORD JOINER}", "")
