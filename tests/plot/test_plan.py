"""Plans of one layer and one line: areas, colors, goals and titles, and two of them compared."""

import dataclasses

import numpy as np
import pytest

import ikjax
from ikjax import plot
from ikjax.plot.contrast import names_of
from ikjax.plot.plan import amount, plan_axes, reached_at
from ikjax.plot.planes import orientations_to_try, posture_at

pytest.importorskip("matplotlib").use("Agg")
plt = pytest.importorskip("matplotlib.pyplot")


@pytest.fixture(autouse=True)
def nothing_left_open():
    yield
    plt.close("all")


def layer(lower, upper, tool=0.0, orientations=((1.0, 0, 0, 0),), **values):
    """A map of a SCARA, some of whose goals lie beyond its limits."""
    arm = ikjax.robots.gx4_351s()
    T = np.asarray(ikjax.pose((tool, 0, 0)))
    arm = dataclasses.replace(arm, tool=np.asarray(arm.tool) @ T)
    turned = np.asarray(ikjax.pose(np.zeros((len(orientations), 3)), wxyz=np.array(orientations)))
    grid = ikjax.maps.grid(lower, upper, 0.05)
    names = ["reachable", "reachable_within", "limited_by"]
    return ikjax.sweep(arm, grid, turned[:, :3, :3], statistics=names, dtype="float64", **values)


@pytest.fixture(scope="module")
def flat():
    return layer((-0.4, -0.4, -0.05), (0.4, 0.4, -0.05), title="no tool")


def texts(figure):
    return " ".join(text.get_text() for text in figure.findobj(plt.Text))


def test_a_layer_has_an_area_in_words_and_numbers(flat):
    hit = flat.reachable_within > 0
    assert 0 < hit.sum() < (flat.reachable > 0).sum() < hit.size
    numbers = flat.numbers()
    assert numbers["area"] == pytest.approx(hit.sum() * 0.05**2) and "volume" not in numbers
    assert f"of the layer, {numbers['area']:.3f} m^2" in flat.summary()
    line = layer((-0.4, 0.1, -0.05), (0.4, 0.1, -0.05))
    assert line.numbers()["length"] == pytest.approx((line.reachable_within > 0).sum() * 0.05)


def test_yes_or_no_is_two_colors_with_all_that_is_out_of_reach(flat, tmp_path):
    figure = plot.reach_map(flat)
    said = texts(figure)
    assert len(figure.axes) == 1  # no color bar
    ax = figure.axes[0]
    assert {"reached", "beyond the joint limits alone", "out of reach", "base", "tool"} <= {
        text.get_text() for text in figure.legends[0].get_texts()
    }
    assert "gx4_351s, no tool" in said and amount(flat.positions, flat.reachable_within > 0) in said
    assert ax.get_xlim()[0] <= -0.425 and ax.get_xlim()[1] >= 0.425 and ax.get_aspect() == 1
    images = [np.ma.count(image.get_array()) for image in ax.images]
    hit, anyhow = flat.reachable_within > 0, flat.reachable > 0
    assert images == [hit.size, (anyhow & ~hit).sum(), hit.sum()]
    plot.plan(flat, tmp_path / "plan.png")
    assert (tmp_path / "plan.png").stat().st_size > 10_000


def test_an_image_lies_where_its_positions_are():
    """Along all three normals: the drawn pixel at a position is that position's."""
    for lower, upper in (
        ((-0.4, -0.2, -0.05), (0.4, 0.4, -0.05)),
        ((-0.4, 0.1, -0.3), (0.4, 0.1, 0.1)),
        ((0.2, -0.4, -0.3), (0.2, 0.4, 0.1)),
    ):
        reach = layer(lower, upper)
        across, up, normal = plan_axes(reach.positions)
        assert reach.positions.shape[normal] == 1 and up > across
        image = plot.plan(reach).axes[0].images[-1]
        left, right, bottom, top = image.get_extent()
        points = reach.positions.points().reshape(-1, 3)
        pixels = np.ma.getmaskarray(image.get_array())
        column = ((points[:, across] - left) / (right - left) * pixels.shape[1]).astype(int)
        row = ((points[:, up] - bottom) / (top - bottom) * pixels.shape[0]).astype(int)
        np.testing.assert_array_equal(~pixels[row, column], reach.reachable_within.ravel() > 0)


def test_goals_are_rings_or_crosses(flat):
    points = flat.positions.points().reshape(-1, 3)
    hit = flat.reachable_within.ravel() > 0
    goals = np.concatenate([points[hit][:3], points[~hit][:2], [[9, 9, 0]]])
    np.testing.assert_array_equal(reached_at(flat, goals), [True] * 3 + [False] * 3)
    said = texts(plot.reach_map(flat, goals=goals))
    assert "goal (3)" in said and "goal not reached (3)" in said
    poses = np.tile(np.eye(4), (3, 1, 1))
    poses[:, :3, 3] = points[hit][:3]
    assert "goal (3)" in texts(plot.reach_map(flat, goals=poses))
    with pytest.raises(ValueError, match="goals must have shape"):
        plot.plan(flat, goals=np.zeros((3, 2)))


def test_several_orientations_have_a_scale_and_a_line_is_a_graph(tmp_path):
    turns = [(np.cos(a / 2), 0, 0, np.sin(a / 2)) for a in np.linspace(0, 6, 7)]
    several = layer((-0.4, -0.4, -0.05), (0.4, 0.4, -0.05), orientations=turns)
    assert len(plot.reach_map(several).axes) == 2
    line = layer((-0.4, 0.1, -0.05), (0.4, 0.1, -0.05), orientations=turns)
    figure = plot.reach_map(line, goals=[[0.1, 0.1, -0.05]])
    assert "x [m]" in texts(figure) and "y = 0.1 m" in texts(figure)
    plot.comparison(line, line, tmp_path / "line.png")
    point = layer((0.2, 0.1, -0.05), (0.2, 0.1, -0.05), orientations=turns)
    plot.reach_map(point, tmp_path / "point.png")
    assert (tmp_path / "point.png").stat().st_size > 10_000
    with pytest.raises(ValueError, match="a plan is of one layer"):
        plot.plan(point)


def test_two_plans_say_what_was_gained_and_lost_and_are_told_apart(flat):
    longer = layer((-0.4, -0.4, -0.05), (0.4, 0.4, -0.05), tool=0.1, title="long tool")
    a, b = flat.reachable_within > 0, longer.reachable_within > 0
    assert (a & ~b).any() and (b & ~a).any()
    said = texts(plot.comparison(flat, longer))
    assert "no tool" in said and "long tool" in said and "second against first" in said
    grid = flat.positions
    assert f"{amount(grid, b & ~a)} gained, {amount(grid, a & ~b)} lost" in said
    assert f"{int((b & ~a).sum())} positions gained" in said and "better" not in said


def test_maps_without_titles_are_told_apart_by_what_differs(flat):
    plain = dataclasses.replace(flat, title="")
    longer = layer((-0.4, -0.4, -0.05), (0.4, 0.4, -0.05), tool=0.1)
    assert names_of(plain, longer) == ("tool at (0, 0, 0) mm", "tool at (100, 0, 0) mm")
    assert names_of(plain, plain) == ("first", "second")
    other = dataclasses.replace(plain, arm=dataclasses.replace(plain.arm, name="other"))
    assert names_of(plain, other) == ("gx4_351s", "other")


def test_the_arm_is_drawn_in_an_orientation_of_the_map():
    arm = ikjax.robots.puma560()
    down = np.diag([1.0, -1.0, -1.0])
    reach = ikjax.ReachMap(
        arm, ikjax.maps.grid((0.4, 0, 0.1), (0.5, 0.1, 0.1), 0.1),
        ikjax.maps.cone((0, 0, -1), 0, 1), 6, "float64", {}, {}, 0.0,
    )  # fmt: skip
    q = posture_at(reach, np.array([0.4, 0.1, 0.1]))
    T = np.asarray(ikjax.fk(arm, q))
    np.testing.assert_allclose(T[:3, 3], [0.4, 0.1, 0.1], atol=1e-9)
    np.testing.assert_allclose(T[:3, 2], down[:, 2], atol=1e-9)
    tried = orientations_to_try(reach)
    assert tried.shape == (6, 3, 3)
    assert orientations_to_try(dataclasses.replace(reach, orientations=ikjax.maps.even_rotations(8))) is None


def test_histograms_name_their_units_and_limits_have_bars(flat, tmp_path):
    assert plot.histogram(flat).axes[0].get_ylabel() == "area [m²]"
    assert plot.histogram(flat, "reachable").axes[0].get_xlabel() == "reachable [orientations]"
    figure = plot.limit_costs(flat, None)
    widths = [bar.get_width() for bar in figure.axes[0].patches]
    np.testing.assert_allclose(widths, flat.numbers()["limited_by"])
    assert max(widths) > 0
    with pytest.raises(ValueError, match="made without limited_by"):
        plot.limit_costs(dataclasses.replace(flat, arrays={"reachable": flat.reachable}))
