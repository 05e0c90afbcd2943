"""The viewer's scene follows its handles, and nobody else on the network can reach it."""

import dataclasses
import io
import os
import signal
import subprocess
import sys
import urllib.request

import browser
import numpy as np
import pytest

import ikjax

pytest.importorskip("matplotlib")
viewer = pytest.importorskip("ikjax.plot.viewer")


@pytest.fixture(scope="module")
def reach():
    arm = ikjax.robots.puma560()
    return ikjax.sweep(arm, ikjax.maps.around(arm, 0.2), 16)


class Handle:
    """A stand-in for what viser returns: values, and callbacks for their changes."""

    def __init__(self, **values):
        self.__dict__.update(values)
        self.callbacks = []

    def on_update(self, call):
        self.callbacks.append(call)

    def on_click(self, call):
        self.clicked = call

    def set(self, **values):
        self.__dict__.update(values)
        for call in self.callbacks:
            call(None)


class Server:
    """A stand-in for a viser server; its scene and its panel are itself."""

    def __init__(self):
        self.scene = self.gui = self
        self.initial_camera = Handle()
        self.lines, self.slice = {}, None

    def add_line_segments(self, name, points, colors, **_):
        self.lines[name] = (points, colors)

    def add_image(self, name, image, width, height, *, wxyz, position, **_):
        self.slice = (image, width, height, np.array(wxyz), np.array(position))
        self.image = Handle()
        return self.image

    def remove_by_name(self, name):
        self.lines.pop(name, None)

    def add_dropdown(self, _, options, initial_value):
        return Handle(value=initial_value)

    def add_slider(self, _, low, high, step, initial):
        return Handle(value=initial)

    def add_checkbox(self, _, initial):
        return Handle(value=initial)

    def add_markdown(self, content):
        return Handle(content=content)

    def add_transform_controls(self, name, size, *, wxyz, position):
        return Handle(wxyz=wxyz, position=position)

    def set_up_direction(self, _): ...

    def add_grid(self, *_, **__): ...

    def add_frame(self, *_, **__): ...


@pytest.mark.slow
def test_every_valid_branch_of_the_goal_is_drawn_and_ends_there(reach):
    server = Server()
    shown = viewer.Viewer(reach, server=server)
    for xyz, q in (((0.4, 0.2, 0.3), (1, 0, 0, 0)), ((0.5, -0.1, 0.2), (0, 1, 0, 0))):
        shown.goal.set(position=np.array(xyz), wxyz=np.array(q, float))
        sol = ikjax.solve(reach.arm, ikjax.pose(xyz, wxyz=np.array(q, float)))
        assert {int(name.split("/")[-1]) for name in server.lines} == set(np.flatnonzero(sol.valid))
        assert server.lines
        for lines, _ in server.lines.values():
            np.testing.assert_allclose(lines[-1, 1], xyz, atol=1e-5)
            np.testing.assert_array_equal(lines[1:, 0], lines[:-1, 1])
    within = int(np.sum(ikjax.within_limits(reach.arm, sol).valid))
    assert f"{int(sol.valid.sum())} of 8 branches, {within} within limits" in shown.summary.content
    shown.limited.set(value=True)
    assert len(server.lines) == within
    shown.goal.set(position=np.array([9.0, 0, 0]))
    assert not server.lines


def test_the_slice_lies_where_the_slider_is_and_stands_as_the_grid_does(reach):
    server = Server()
    shown = viewer.Viewer(reach, server=server)
    for axis, share in (("x", 0.0), ("y", 0.5), ("z", 1.0)):
        shown.axis.set(value=axis)
        shown.layer.set(value=share)
        image, width, height, wxyz, position = server.slice
        k = "xyz".index(axis)
        ticks = reach.positions.axis(k)
        assert position[k] == ticks[round(share * (len(ticks) - 1))]
        turn = np.asarray(ikjax.pose(wxyz=wxyz))[:3, :3]
        across, up = (j for j in range(3) if j != k)
        np.testing.assert_allclose(turn[:, 0], np.eye(3)[across], atol=1e-12)
        np.testing.assert_allclose(turn[:, 1], -np.eye(3)[up], atol=1e-12)  # down, as images run
        assert image.shape == (reach.positions.shape[up], reach.positions.shape[across], 4)
        np.testing.assert_allclose(
            [width, height], [reach.positions.spacing * image.shape[j] for j in (1, 0)]
        )
    # The lowest row of the image is the first along z.
    shown.axis.set(value="y")
    image = server.slice[0]
    layer = plane_index(reach, shown)
    for row in range(reach.positions.shape[2]):
        empty = np.asarray(reach.reachable)[:, layer, row] == 0
        np.testing.assert_array_equal(image[-1 - row, :, 3] == 0, empty)


@pytest.mark.slow
def test_a_click_on_the_slice_puts_the_goal_there(reach):
    server = Server()
    shown = viewer.Viewer(reach, server=server)
    start, place = np.array([1.0, -3.0, 1.0]), np.array([0.5, shown.plane.at, 0.2])
    turned = shown.goal.wxyz
    server.image.clicked(Handle(ray_origin=start, ray_direction=(place - start) / 7))
    np.testing.assert_allclose(shown.goal.position, place, atol=1e-12)
    assert shown.goal.wxyz is turned and server.lines
    for lines, _ in server.lines.values():
        np.testing.assert_allclose(lines[-1, 1], place, atol=1e-5)
    server.image.clicked(Handle(ray_origin=start, ray_direction=(1, 0, 0)))  # along the slice
    np.testing.assert_allclose(shown.goal.position, place, atol=1e-12)


def plane_index(reach, shown) -> int:
    return round(shown.layer.value * (reach.positions.shape[1] - 1))


def test_what_is_no_box_grid_is_refused(reach):
    shell = dataclasses.replace(reach, positions=ikjax.maps.shell((0, 0, 0), 0.5, 9))
    with pytest.raises(ValueError, match="shows box grids"):
        viewer.Viewer(shell, server=Server())


def test_the_server_listens_on_this_machine_alone(reach):
    pytest.importorskip("viser")
    shown = viewer.Viewer(reach, port=8765)
    try:
        assert shown.server.get_host() == "127.0.0.1"
    finally:
        shown.server.stop()


@pytest.mark.slow
def test_the_command_serves_a_map_until_it_is_interrupted(reach, tmp_path):
    pytest.importorskip("viser")
    pytest.importorskip("tensorstore")
    reach.save(tmp_path / "map.zarr")
    # A shell starts background jobs, and so the tests and their children, with interrupts ignored.
    heed = "signal.signal(signal.SIGINT, signal.default_int_handler)"
    start = f"import runpy, signal; {heed}; runpy.run_module('ikjax.cli', run_name='__main__')"
    command = [sys.executable, "-c", start, "show", "map.zarr", "--viewer", "--port", "8767"]
    path = {**os.environ, "PYTHONPATH": os.pathsep.join(map(os.path.abspath, filter(None, sys.path)))}
    with subprocess.Popen(command, cwd=tmp_path, stdout=subprocess.PIPE, text=True, env=path) as program:
        try:
            said = next(line for line in program.stdout if line.startswith("the map is at "))
            with urllib.request.urlopen(said.split()[4].rstrip(",")) as page:
                assert page.status == 200 and b"<html" in page.read()
            program.send_signal(signal.SIGINT)
            assert program.wait(60) == 0
        finally:
            program.kill()


@pytest.mark.slow
def test_in_a_browser_a_moved_slice_and_a_clicked_goal_change_what_is_shown(reach, tmp_path):
    pytest.importorskip("viser")
    pytest.importorskip("websockets.sync.client")
    if (path := browser.find()) is None:
        pytest.skip(f"no browser: none of {', '.join(browser.NAMES)} is found")
    from matplotlib.image import imread

    def scene(page) -> np.ndarray:
        """The middle of the page, where nothing but the map is."""
        return np.round(255 * imread(io.BytesIO(page.picture()))[150:450, 330:560, :3])

    def settled(page) -> np.ndarray:
        """The scene, once two pictures of it are the same."""
        looks = [scene(page)]
        browser.until(
            lambda: looks.append(scene(page)) or (looks[-1] == looks[-2]).all(), 120, "an unchanged scene"
        )
        return looks[-1]

    shown = viewer.Viewer(reach, port=8766)
    try:
        with browser.Browser(path, tmp_path) as page:
            page.open(f"http://127.0.0.1:{shown.server.get_port()}/")
            browser.until(lambda: " branches, " in page.text(), 120, "the panel")
            assert shown.server.get_clients() and reach.arm.name in page.text()
            browser.until(lambda: len(np.unique(settled(page).reshape(-1, 3), axis=0)) > 100, 120, "the map")
            first, said = settled(page), shown.summary.content
            # The slider is dragged by its thumb.
            find = "document.querySelector('[role=slider].mantine-Slider-thumb').getBoundingClientRect()"
            x, y = page.evaluate(f"(b => [b.x + b.width / 2, b.y + b.height / 2])({find})")
            page.drag((x, y), (x + 24, y))
            browser.until(lambda: shown.layer.value > 0.6, 60, "the slider")
            at = shown.plane.at
            assert at > reach.positions.axis(1)[6]
            second = settled(page)
            assert (first != second).any(-1).mean() > 0.05
            # A click on the slice, beside the gizmo.
            before = np.array(shown.goal.position)
            page.mouse("mouseMoved", 420, 250)
            page.mouse("mousePressed", 420, 250, buttons=1)
            page.mouse("mouseReleased", 420, 250)
            browser.until(lambda: not np.array_equal(shown.goal.position, before), 60, "the click")
            assert shown.goal.position[1] == pytest.approx(at)
            browser.until(lambda: shown.summary.content != said, 60, "other branches")
            words = shown.summary.content.split("**")[1]
            browser.until(lambda: words in page.text(), 60, "them in the panel")
            assert (second != settled(page)).any(-1).mean() > 0.005
    finally:
        shown.server.stop()
