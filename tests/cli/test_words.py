"""What the library and the command say of themselves: short, and true."""

import dataclasses
import sys
import time

import numpy as np
import pytest

import ikjax
from ikjax.cli.waiting import saying_so_when_it_takes_long
from ikjax.maps.reach_map import Units


def test_a_first_sweep_says_that_the_map_is_new():
    assert str(Units(12, 0, 12, 0)) == "new map, 12 units"
    assert str(Units(1, 0, 1, 0)) == "new map, 1 unit"
    assert str(Units(8, 1, 7, 0)) == "1 of 8 units kept, 7 missing, 0 damaged"


@pytest.fixture(scope="module")
def reach():
    arm = ikjax.robots.gx4_351s()
    return ikjax.sweep(arm, ikjax.maps.around(arm, 0.2), 1, title="short tool")


def test_reprs_have_five_lines_at_most(reach):
    said = repr(reach)
    assert said.startswith("<ReachMap of gx4_351s, short tool: ") and len(said.splitlines()) <= 5
    assert f"{(reach.reachable_within > 0).mean():.1%} of the positions are reached" in said
    goals = ikjax.fk(ikjax.robots.planar_2r(0.6, 0.3), np.zeros((3, 2)))
    bases = ikjax.place(ikjax.robots.planar_2r(0.6, 0.3), goals, steps=0, starts=8, keep=8, spacing=0.3)
    assert len(str(bases).splitlines()) > 5 and len(repr(bases).splitlines()) == 5
    assert f"and {len(bases) - 3} more>" in repr(bases)


def test_xarray_attributes_say_what_was_swept(reach):
    pytest.importorskip("xarray")
    attrs = reach.to_xarray().attrs
    assert attrs["arm"] == "gx4_351s" and attrs["title"] == "short tool" and "rad" in attrs["units"]
    np.testing.assert_allclose(np.reshape(attrs["tool"], (4, 4)), reach.arm.tool)
    assert attrs["branches"] == list(reach.arm.branches)


def test_all_bad_goals_are_named():
    goals = np.tile(np.eye(4), (6, 1, 1))
    goals[[1, 4, 5], 0, 0] = np.nan
    with pytest.raises(ValueError, match=r"goals\[1\] \(and 2 more: \[4\], \[5\]\) must hold finite numbers"):
        ikjax.check_goals(ikjax.robots.puma560(), goals)


def test_who_waits_at_a_terminal_is_told_once(monkeypatch, capsys):
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True, raising=False)
    with saying_so_when_it_takes_long(True, 0.05):
        time.sleep(0.3)
    assert capsys.readouterr().err.count("compiled first") == 1
    with saying_so_when_it_takes_long(True, 5):
        pass
    with saying_so_when_it_takes_long(False, 0):
        time.sleep(0.05)
    assert capsys.readouterr().err == ""


def test_a_title_is_stored_and_changes_no_number(reach, tmp_path):
    pytest.importorskip("tensorstore")
    reach.save(tmp_path / "map.zarr")
    assert ikjax.ReachMap.load(tmp_path / "map.zarr").title == "short tool"
    dataclasses.replace(reach, title="").save(tmp_path / "plain.zarr")
    assert ikjax.ReachMap.load(tmp_path / "plain.zarr").title == ""
    one, other = (tmp_path / name / "reachable" / "zarr.json" for name in ("map.zarr", "plain.zarr"))
    assert one.read_bytes() == other.read_bytes()  # with the same fingerprint
