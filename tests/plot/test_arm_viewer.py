"""The arm's viewer follows its handles: sliders, a goal that is dragged, branches that are picked."""

import io

import browser
import numpy as np
import pytest
import test_viewer

import ikjax

pytest.importorskip("matplotlib")
arm_viewer = pytest.importorskip("ikjax.plot.arm_viewer")
Handle = test_viewer.Handle


class Server(test_viewer.Server):
    """The stand-in of the map's viewer, with balls that can be clicked."""

    def __init__(self):
        super().__init__()
        self.balls = {}

    def add_icosphere(self, name, radius, color, *, position):
        self.balls[name] = Handle(color=color, position=np.array(position))
        return self.balls[name]

    def remove_by_name(self, name):
        super().remove_by_name(name)
        self.balls.pop(name, None)


HOME = np.array([0.4, -1.2, 1.3, -0.9, -1.4, 0.3])


@pytest.fixture(scope="module")
def ur5e():
    return ikjax.robots.ur5e()


def shown(arm, q):
    return arm_viewer.ArmViewer(arm, q, server=Server())


def tool(arm, q):
    return np.asarray(ikjax.fk(arm, q), float)


def goal_of(view):
    return np.asarray(ikjax.pose(view.goal.position, wxyz=view.goal.wxyz), float)


@pytest.mark.slow
def test_a_slider_moves_its_joint_and_the_goal_with_the_tool(ur5e):
    view = shown(ur5e, HOME)
    view.sliders[2].set(value=60.0)
    wanted = HOME.copy()
    wanted[2] = np.deg2rad(60)
    np.testing.assert_allclose(view.q, wanted, atol=1e-6)
    np.testing.assert_allclose(goal_of(view), tool(ur5e, wanted), atol=1e-5)
    # The arm as drawn ends at the goal.
    points, _ = view.server.lines["/arm"]
    np.testing.assert_allclose(points[-1, 1], view.goal.position, atol=1e-5)


@pytest.mark.slow
def test_a_dragged_goal_takes_the_arm_along_on_its_nearest_branch(ur5e):
    view = shown(ur5e, HOME)
    there = HOME + np.array([0.1, 0.05, -0.05, 0.02, 0.1, -0.1])
    T = tool(ur5e, there)
    view.goal.set(position=T[:3, 3], wxyz=np.asarray(ikjax.to_wxyz_xyz(T))[:4])
    np.testing.assert_allclose(view.q, there, atol=1e-4)
    np.testing.assert_allclose([s.value for s in view.sliders], np.rad2deg(there), atol=1e-2)
    # Out of reach the arm stays, and no branch is shown.
    view.goal.set(position=np.array([5.0, 0, 0]))
    np.testing.assert_allclose(view.q, there, atol=1e-4)
    assert not view.branches and not [name for name in view.server.lines if name.startswith("/branches")]
    assert "0 of 8 branches" in view.summary.content


@pytest.mark.slow
def test_every_branch_is_shown_and_a_click_on_its_ball_takes_it(ur5e):
    view = shown(ur5e, HOME)
    goal = goal_of(view)
    valid = np.flatnonzero(ikjax.solve(ur5e, goal).valid)
    assert set(view.branches) == set(valid) and len(valid) == 8
    for slot in view.branches:
        points, _ = view.server.lines[f"/branches/{slot}/lines"]
        np.testing.assert_allclose(points[-1, 1], goal[:3, 3], atol=1e-5)
    view.server.balls["/branches/5/ball"].clicked(None)
    np.testing.assert_allclose(tool(ur5e, view.q), goal, atol=1e-5)
    assert view.branch.value == ur5e.branches[5]
    view.branch.set(value=ur5e.branches[2])
    np.testing.assert_allclose(np.sin(view.q - view.branches[2]), 0, atol=1e-5)
    assert "8 of 8 branches, 8 within limits" in view.summary.content


@pytest.mark.slow
def test_a_branch_that_is_not_there_cannot_be_picked(ur5e):
    view = shown(ur5e, HOME)
    view.set_goal(np.array([[1, 0, 0, 5.0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]))
    with pytest.raises(ValueError, match="branch 3 does not reach the goal"):
        view.pick(3)


@pytest.mark.slow
def test_joints_and_branches_are_colored_by_their_limits():
    arm = ikjax.robots.irb120()
    low, high = np.asarray(arm.limits, float).T
    q = np.array([0.2, 0.1, 0.1, 0.3, 0.5, 0.2])
    q[0], q[1] = high[0] - 0.01 * (high[0] - low[0]), low[1] + 0.05 * (high[1] - low[1])
    view = shown(arm, q)
    colors = [view.server.balls[f"/joints/{i}"].color for i in range(6)]
    assert colors == [arm_viewer.AT, arm_viewer.NEAR, *[arm_viewer.FREE] * 4]
    inside = ikjax.within_limits(arm, ikjax.solve(arm, goal_of(view))).valid
    for slot in view.branches:
        grey = view.server.balls[f"/branches/{slot}/ball"].color == arm_viewer.OUTSIDE
        assert grey != bool(inside[slot])
    assert 0 < int(inside.sum()) < len(view.branches)


@pytest.mark.slow
def test_the_self_motion_of_seven_joints_has_a_slider_that_keeps_the_goal():
    arm = ikjax.robots.fr3()
    q = np.array([0.1, -0.5, 0.2, -2.0, 0.1, 1.7, 0.6])
    view = shown(arm, q)
    goal = goal_of(view)
    view.sliders[6].set(value=np.rad2deg(0.65))
    np.testing.assert_allclose(goal_of(view), goal, atol=1e-12)
    np.testing.assert_allclose(tool(arm, view.q), goal, atol=2e-5)
    # A small step of it moves the others a little, along one branch.
    assert abs(view.q[6] - 0.65) < 1e-6 and np.abs(view.q[:6] - q[:6]).max() < 0.3


@pytest.mark.slow
def test_a_map_stands_beside_the_arm():
    arm = ikjax.robots.gx4_351s()
    reach = ikjax.sweep(arm, ikjax.maps.around(arm, 0.1), 1)
    view = arm_viewer.ArmViewer(arm, server=Server(), reach=reach)
    image, width, height, _, position = view.server.slice
    assert image.shape[2] == 4 and position[1] == pytest.approx(0, abs=0.051)
    assert width > 0.5 and height > 0


def test_arms_without_a_closed_form_are_refused():
    arm = ikjax.Arm.from_dh(a=[0.3] * 4, alpha=[0.5] * 4, d=[0.1] * 4, convention="standard")
    with pytest.raises(ValueError, match="needs an arm with a closed form"):
        arm_viewer.ArmViewer(arm, server=Server())


@pytest.mark.slow
def test_in_a_browser_the_goal_is_dragged_and_a_branch_is_picked(ur5e, tmp_path):
    pytest.importorskip("viser")
    pytest.importorskip("websockets.sync.client")
    if (path := browser.find()) is None:
        pytest.skip(f"no browser: none of {', '.join(browser.NAMES)} is found")
    from matplotlib.image import imread

    view = arm_viewer.ArmViewer(ur5e, HOME, port=8771)
    assert view.server.get_host() == "127.0.0.1"

    def scene(page):
        return np.round(255 * imread(io.BytesIO(page.picture()))[..., :3])

    def settled(page):
        looks = [scene(page)]
        browser.until(
            lambda: looks.append(scene(page)) or (looks[-1] == looks[-2]).all(), 120, "an unchanged scene"
        )
        return looks[-1]

    try:
        with browser.Browser(path, tmp_path) as page:
            page.open(f"http://127.0.0.1:{view.server.get_port()}/")
            browser.until(lambda: "8 of 8 branches" in page.text(), 120, "the panel")
            assert "joint3 [deg]" in page.text()
            browser.until(lambda: len(np.unique(settled(page).reshape(-1, 3), axis=0)) > 50, 120, "the arm")
            first, q = settled(page), view.q.copy()
            (tmp_path / "arm.png").write_bytes(page.picture())
            # A slider is dragged by its thumb: the first one is that of joint 1.
            find = (
                "document.querySelectorAll('[role=slider].mantine-Slider-thumb')[0].getBoundingClientRect()"
            )
            x, y = page.evaluate(f"(b => [b.x + b.width / 2, b.y + b.height / 2])({find})")
            page.drag((x, y), (x + 20, y))
            browser.until(lambda: abs(view.q[0] - q[0]) > 0.1, 60, "the slider")
            np.testing.assert_allclose(goal_of(view), tool(ur5e, view.q), atol=1e-5)
            assert (settled(page) != first).any(-1).mean() > 0.002
            # The goal's gizmo, and a ball: where they are on the page is told by the camera.
            client = next(iter(view.server.get_clients().values()))
            place = view.goal.position.copy()
            x, y = pixel(client, place)
            page.drag((x, y), (x + 30, y - 20))
            browser.until(lambda: not np.allclose(view.goal.position, place, atol=1e-3), 60, "the gizmo")
            before = view.q.copy()
            settled(page)
            slot = max(view.branches, key=lambda k: np.abs(view.branches[k] - view.q).max())
            stations = np.asarray(ikjax.frames(ur5e, view.branches[slot]), float)
            x, y = pixel(client, view._ball(stations, slot))
            for kind, buttons in (("mouseMoved", 0), ("mousePressed", 1), ("mouseReleased", 0)):
                page.mouse(kind, x, y, buttons)
            browser.until(lambda: np.abs(view.q - before).max() > 0.3, 60, "the branch")
            np.testing.assert_allclose(tool(ur5e, view.q), goal_of(view), atol=1e-4)
    finally:
        view.server.stop()


def pixel(client, point, size=(900, 600)):
    """Where a point of the world is on the page [pixels], by the client's camera."""
    camera = client.camera
    R = np.asarray(ikjax.pose(wxyz=camera.wxyz), float)[:3, :3]
    # The camera looks along z, x is right and y is down.
    right, down, ahead = R.T @ (np.asarray(point) - camera.position)
    scale = camera.image_height / 2 / np.tan(camera.fov / 2)
    return camera.image_width / 2 + scale * right / ahead, camera.image_height / 2 + scale * down / ahead
