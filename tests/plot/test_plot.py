"""Pictures are made, are labeled, and leave no figure open."""

import dataclasses

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
    return ikjax.sweep(arm, ikjax.maps.around(arm, 0.2), 16)


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
    near = {
        k: reach.positions.axis(k)[np.abs(reach.positions.axis(k) - v).argmin()]
        for k, v in ((0, 0.1), (2, 0.3))
    }
    assert titles[:2] == [f"x = {near[0]:.2f} m", f"z = {near[2]:.2f} m"]
    assert len(figure.axes) == 4  # and the color bar


@pytest.mark.parametrize("piece", [("w", 0), ("xy", 0), ("", 0), ("x", "up"), "x", 3])
def test_an_invalid_slice_is_named(reach, piece):
    with pytest.raises(ValueError, match="a slice must be"):
        plot.reach_map(reach, slices=[piece])


def test_a_map_where_nothing_is_reached_is_a_picture_too(tmp_path):
    arm = ikjax.robots.puma560()
    empty = ikjax.sweep(arm, ikjax.maps.grid((5, 5, 5), (5.4, 5.4, 5.4), 0.2), 4)
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


def test_a_shell_becomes_discs_and_a_surface_points(reach, tmp_path):
    def fake(grid):
        counts = np.arange(grid.count, dtype=np.int32).reshape(grid.shape) % 17
        return dataclasses.replace(
            reach, positions=grid, arrays={"reachable": counts, "reachable_within": counts // 2}
        )

    shell = fake(ikjax.maps.shell((0, 0, 0), (0.5, 0.7), 60))
    figure = plot.reach_map(shell)
    assert [ax.get_title() for ax in figure.axes[:2]] == [
        f"radius {r} m: {shell.dexterity[k].mean():.0%}" for k, r in enumerate((0.5, 0.7))
    ]
    balls = np.array([[0.5, 0, 0.1], [0.5, 0.2, 0.1], [3, 0, 0]])
    for normals in (None, [[0, 0, 1]] * 3):
        part = fake(ikjax.maps.surface(balls, normals))
        plot.reach_map(part, tmp_path / "part.png")
        assert is_png(tmp_path / "part.png")
    for other in (shell, part):
        with pytest.raises(ValueError, match="slices are of a box grid"):
            plot.reach_map(other, slices=[("x", 0)])
        with pytest.raises(ValueError, match="solids need a box grid"):
            plot.nested(other)


def test_an_isosurface_of_a_ball_is_closed_and_has_its_volume():
    x = np.linspace(-1.3, 1.3, 27)
    field = 1 - np.linalg.norm(np.stack(np.meshgrid(x, x, x, indexing="ij")), axis=0)
    a, b, c = np.moveaxis(-1.3 + 0.1 * plot.isosurface(field, 0.0), 1, 0)
    np.testing.assert_allclose(
        np.cross(b - a, c - a).sum(0), 0, atol=1e-9
    )  # the net area of a closed surface is zero
    volume = np.einsum("ij,ij->", a, np.cross(b, c)) / 6  # positive: turned outwards
    np.testing.assert_allclose(volume, 4 / 3 * np.pi, rtol=0.02)


def test_solids_say_their_volume_and_leave_out_what_is_empty_or_twice(reach):
    figure = plot.nested(reach, levels=(0.0, 1e-6, 0.5, 1.5))
    titles = [ax.get_title() for ax in figure.axes if ax.get_title()]
    volumes = [reach.positions.volume(reach.dexterity >= level) for level in (1e-9, 0.5)]
    names = ("reached at all", "at least 50%")
    expected = [f"{name}: {volume:.3g} m³" for name, volume in zip(names, volumes, strict=True)]
    assert titles == list(dict.fromkeys(expected))[: len(titles)] and titles


def test_a_globe_has_the_share_that_solving_each_direction_gives(reach):
    point = (0.5, 0.1, 0.2)
    figure = plot.globe(reach.arm, point, directions=60, turns=2)
    turns = ikjax.maps.cone((0, 0, 1), np.pi, 60, 2)
    goals = np.tile(np.eye(4), (120, 1, 1))
    goals[:, :3, 3] = point

    goals[:, :3, :3] = turns.rotations
    sol = ikjax.within_limits(reach.arm, ikjax.solve(reach.arm, goals))
    share = float(np.asarray(sol.valid).any(-1).mean())
    assert figure.axes[0].get_title() == f"at (0.50, 0.10, 0.20) m: {share:.0%}"
    with pytest.raises(ValueError, match="whose task is pose"):
        plot.globe(ikjax.robots.planar_2r(0.5, 0.3), point)


def test_a_histogram_holds_the_volume_that_is_reached(reach):
    ax = plot.histogram(reach).axes[0]
    total = sum(bar.get_height() for bar in ax.patches)
    np.testing.assert_allclose(total, reach.positions.volume(reach.reachable_within > 0))
    assert plot.histogram(reach, "best_margin").axes[0].get_xlabel() == "best margin [m]"
    with pytest.raises(ValueError, match="name must be one of dexterity, reachable"):
        plot.histogram(reach, "beauty")


def test_two_maps_are_compared_position_by_position(reach, tmp_path):
    counts = np.array(reach.reachable_within)
    i, j, k = np.argwhere(counts == 0)[0], np.argwhere(counts > 1)[0], np.argwhere(counts > 0)[-1]
    other = counts.copy()
    other[tuple(i)], other[tuple(j)], other[tuple(k)] = 3, counts[tuple(j)] - 1, 0
    changed = dataclasses.replace(reach, arrays={**reach.arrays, "reachable_within": other})
    same = int((counts > 0).sum()) - 2
    assert plot.change(reach, changed) == (1, 0, same, 1, 1)
    assert plot.change(changed, reach) == (1, 1, same, 0, 1)
    plot.comparison(reach, changed, tmp_path / "two.png")
    assert is_png(tmp_path / "two.png")
    with pytest.raises(ValueError, match="must have the same positions"):
        plot.comparison(reach, dataclasses.replace(reach, positions=ikjax.maps.around(reach.arm, 0.3)))


def test_the_color_map_prints_in_grey():
    from matplotlib import colormaps

    from ikjax.plot.style import MAP

    luminance = colormaps[MAP](np.linspace(0, 1, 64))[:, :3] @ [0.2126, 0.7152, 0.0722]
    assert (np.diff(luminance) > 0).all()


@pytest.mark.slow
def test_a_page_needs_nothing_else_and_escapes_what_comes_out_of_a_map(reach):
    from ikjax.plot.page import page

    evil = dataclasses.replace(reach, arm=dataclasses.replace(reach.arm, name="<script>x</script>"))
    text = page(evil, reach, "<b>.zarr")
    assert "<script" not in text and "<b>" not in text
    assert "http" not in text and text.count("data:image/png;base64,") == 5
    assert "ikjax.sweep(old.arm" in text and "positions that differ" in text


def test_a_self_motion_is_drawn_with_its_parts(tmp_path):
    from ikjax.ik.self_motion import SelfMotion

    arm, samples = ikjax.robots.fer(), np.linspace(-2, 2, 9)
    q = np.zeros((8, 9, 7))
    q[..., 0] = (samples * 3 + np.pi) % (2 * np.pi) - np.pi
    valid = np.abs(samples) < 1.6
    within = valid & (samples > 0)
    parts = np.zeros((8, 4, 2))
    parts[:, 0] = 0.2, 1.4
    curve = SelfMotion(
        samples,
        q,
        np.broadcast_to(valid, (8, 9)),
        np.broadcast_to(within, (8, 9)),
        np.zeros((8, 9)),
        parts,
        np.broadcast_to(np.arange(4) == 0, (8, 4)),
    )
    figure = plot.self_motion(arm, curve)
    first, bars = figure.axes[0], figure.axes[6]
    assert len(bars.patches) == 8 and "within the limits" in bars.get_title()
    # No line crosses the jump from pi to -pi.
    assert all(np.abs(np.diff(line.get_ydata())).max(initial=0) < np.pi for line in first.lines[:-2])
    assert {line.get_linewidth() for line in first.lines[:-2]} == {0.8, 0.9, 3.0}
    plot.self_motion(arm, curve, tmp_path / "curve.png")
    assert (tmp_path / "curve.png").stat().st_size > 10_000
    with pytest.raises(ValueError, match="of one goal of an arm with one redundant joint"):
        plot.self_motion(ikjax.robots.puma560(), curve)
