"""Pictures are made, say what they show, and leave nothing open."""

import numpy as np
import pytest

import ikjax
from ikjax import plot

pytest.importorskip("matplotlib").use("Agg")
plt = pytest.importorskip("matplotlib.pyplot")

GOAL = ikjax.pose(xyz=(0.4, 0.2, 0.3), rpy=(3.14, 0, 0.6))


@pytest.fixture(scope="module")
def reach():
    arm = ikjax.robots.puma560()
    return ikjax.sweep(arm, ikjax.around(arm, 0.2), 16)


@pytest.fixture(autouse=True)
def nothing_left_open():
    yield
    plt.close("all")


def is_png(path) -> bool:
    return path.read_bytes().startswith(b"\x89PNG") and path.stat().st_size > 10_000


def test_sticks_run_from_the_base_to_the_tool():
    arm = ikjax.robots.ur5()
    q = np.array([0.3, -1.0, 0.8, 0.2, 1.1, -0.4])
    body = plot.sticks(arm, q)
    np.testing.assert_allclose(body.line[0], 0, atol=1e-12)
    np.testing.assert_allclose(body.line[-1], ikjax.fk(arm, q)[:3, 3], atol=1e-9)
    lengths = np.linalg.norm(np.diff(body.line, axis=0), axis=1)
    expected = np.abs(np.stack([arm.d, arm.a], axis=1)).reshape(-1)
    np.testing.assert_allclose(lengths[:-1], expected, atol=1e-9)


def test_a_map_becomes_a_picture_and_is_closed(reach, tmp_path):
    plot.reach_map(reach, tmp_path / "map.png")
    assert is_png(tmp_path / "map.png")
    assert not plt.get_fignums()


def test_slices_choose_the_panels(reach):
    figure = plot.reach_map(reach, slices=[("x", 0.1), ("z", 0.3), ("z", -0.3)], q=np.zeros(6))
    titles = [ax.get_title(loc="left") for ax in figure.axes]
    near = {k: reach.grid.axis(k)[np.abs(reach.grid.axis(k) - v).argmin()] for k, v in ((0, 0.1), (2, 0.3))}
    assert titles[:2] == [f"x = {near[0]:.2f} m", f"z = {near[2]:.2f} m"]
    assert len(figure.axes) == 4  # and the colour bar


@pytest.mark.parametrize("piece", [("w", 0), ("xy", 0), ("", 0), ("x", "up"), "x", 3])
def test_a_slice_that_is_none_is_named(reach, piece):
    with pytest.raises(ValueError, match="a slice must be"):
        plot.reach_map(reach, slices=[piece])


def test_a_map_where_nothing_is_reached_is_a_picture_too(tmp_path):
    arm = ikjax.robots.puma560()
    empty = ikjax.sweep(arm, ikjax.grid((5, 5, 5), (5.4, 5.4, 5.4), 0.2), 4)
    plot.reach_map(empty, tmp_path / "empty.png")
    assert is_png(tmp_path / "empty.png")


@pytest.mark.parametrize("name", ["puma560", "ur5"])
def test_every_branch_has_its_figure(name, tmp_path):
    arm = ikjax.robots.get(name)
    figure = plot.branches(arm, GOAL, tmp_path / "branches.png")
    assert is_png(tmp_path / "branches.png")
    assert [ax.get_title().split()[1] for ax in figure.axes] == list(arm.branches)


def test_branches_of_many_goals_are_refused():
    with pytest.raises(ValueError, match=r"goal must have shape \(4, 4\)"):
        plot.branches(ikjax.robots.ur5(), np.stack([GOAL, GOAL]))


def test_an_arm_stands_on_an_axis_of_its_own_or_of_the_caller():
    arm = ikjax.robots.puma560()
    ax = plot.arm(arm, np.zeros(6))
    assert plot.arm(arm, np.ones(6), ax) is ax
