"""An arm in the browser: a slider for each joint, a goal to drag, every branch of it to be picked.

Needs viser (`pip install ikjax[viz3d]`). The server listens on 127.0.0.1 only, as that of `plot.viewer`.
"""

import dataclasses
import functools
import threading
import time
from typing import Any

import jax
import numpy as np

from ikjax.arm.arm import Arm
from ikjax.arm.forward import fk, frames
from ikjax.core.pose import pose
from ikjax.core.text import markdown
from ikjax.ik.results import Solutions
from ikjax.ik.select import nearest, within_limits
from ikjax.ik.solve import solve
from ikjax.maps.sets.positions import Grid
from ikjax.plot.planes import plane_of
from ikjax.plot.stick import sticks_of
from ikjax.plot.style import COLORS
from ikjax.plot.viewer import HOST, OUTSIDE, _rgb, _server, image_rotation, quaternion, slice_image

FREE, NEAR, AT = (42, 157, 92), (230, 159, 0), (209, 73, 91)
"""Colors of joints that are far from their limits, near them, and at them or beyond."""
NEAR_SHARE, AT_SHARE = 0.1, 0.02
"""Shares of a joint's range from its limit, below which it counts as near and as at it."""
ARM_COLOR = (60, 60, 60)
DISPLAY = {"R": (180 / np.pi, "deg"), "P": (1e3, "mm")}
"""What a slider shows of a joint value: a factor, and its unit."""
WIDEST = {"R": np.pi, "P": 1.0}
"""[rad, m] A slider without limits goes so far either way."""


@jax.jit
def _answers(arm: Arm, goal, free, q_now) -> tuple[Solutions, jax.Array, jax.Array]:
    """Every branch of a goal within the limits where that is possible, and the nearest one within them."""
    sol = solve(arm, goal, redundancy=free) if arm.locked else solve(arm, goal)
    inside = within_limits(arm, sol, q_now)
    best, found = nearest(arm, inside, q_now)
    # Branches outside the limits are shown too.
    return dataclasses.replace(inside, valid=sol.valid), best, found


@jax.jit
def _lines(arm: Arm, q) -> tuple[jax.Array, jax.Array]:
    return frames(arm, q), fk(arm, q)


class ArmViewer:
    """A server that shows one arm.

    Its fields `q` and `goal` follow the handles; `set_joints`, `set_goal` and `pick` do what a hand does.

    Args:
        arm: With a closed form, and at most one redundant joint.
        q: Its joints at first, (n,) [rad, m]; by default beside the middle of each range.
        port: For the browser; another one is used if it is taken.
        server: A viser server to draw on; a new one on 127.0.0.1 by default.
        reach: A `ReachMap` of a box grid, whose middle layer is shown beside the arm.
        urdf: A `yourdfpy.URDF` of the arm with its meshes loaded, to be drawn as well: its joints are found
            by the arm's `joint_names`.

    Raises:
        ImportError: Without viser, or without matplotlib where a map is shown.
        ValueError: An arm of no family, or of more than one redundant joint; a map of no box grid.
    """

    def __init__(
        self,
        arm: Arm,
        q: Any = None,
        *,
        port: int = 8080,
        server: Any = None,
        reach: Any = None,
        urdf: Any = None,
    ):
        if arm.family is None or len(arm.locked) > 1:
            raise ValueError(
                f"the viewer needs an arm with a closed form, {arm.name} has none of one parameter"
            )
        if reach is not None and not isinstance(reach.positions, Grid):
            raise ValueError(f"the viewer shows box grids, got {reach.positions.in_words()}")
        self.arm, self.names = arm, tuple(arm.to_dict(np.zeros(arm.n)))
        self.low, self.high = self._ranges()
        self.q = self._middle() if q is None else np.array(q, float)
        self.branches: dict[int, np.ndarray] = {}
        self._lock, self._quiet = threading.RLock(), False
        self.server = _server(port) if server is None else server
        scene, gui = self.server.scene, self.server.gui
        stations, tip = self._chain(self.q)
        line = sticks_of(arm, stations, tip).line
        self.size = float(max(np.linalg.norm(np.diff(line, axis=0), axis=-1).sum(), 1e-3))
        scene.set_up_direction("+z")
        scene.add_grid("/floor", self.size, self.size, cell_size=self.size / 10, section_size=self.size / 2)
        camera = self.server.initial_camera
        camera.position = stations[0, :3, 3] + self.size * np.array([0.9, -1.2, 0.8])
        camera.look_at = stations[0, :3, 3] + np.array([0, 0, 0.3 * self.size])
        gui.add_markdown(
            f"**{markdown(arm.name)}** ({markdown(str(arm.family))}). Drag the goal's handles; click a ball "
            "to take its branch. Joints: green far from their limits, orange near them, red at them."
        )
        self.sliders = [self._slider(i) for i in range(arm.n)]
        self.branch = gui.add_dropdown("Branch", ("nearest", *arm.branches), initial_value="nearest")
        self.summary = gui.add_markdown("")
        self.goal = scene.add_transform_controls(
            "/goal", 0.2 * self.size, wxyz=quaternion(tip[:3, :3]), position=tip[:3, 3]
        )
        self._mesh = None if urdf is None else self._draw_mesh(urdf)
        if reach is not None:
            self._draw_map(reach)
        for i, slider in enumerate(self.sliders):
            slider.on_update(functools.partial(self._moved, i))
        self.goal.on_update(lambda _: self._dragged())
        self.branch.on_update(lambda _: self._chosen())
        self.set_joints(self.q)

    def set_joints(self, q: Any) -> None:
        """Put the arm at joints (n,) [rad, m], and the goal at its tool."""
        with self._lock:
            tip = self._chain(np.array(q, float))[1]
            self._at_rest(lambda: self._place_goal(tip))
            self._solve(np.array(q, float), stay=True)

    def set_goal(self, goal: Any) -> None:
        """Put the goal at a pose (4, 4) T_world_tool, and the arm at its nearest branch."""
        with self._lock:
            self._at_rest(lambda: self._place_goal(np.asarray(goal, float)))
            self._solve(self.q)

    def pick(self, slot: int) -> None:
        """Put the arm at a branch that is shown.

        Raises:
            ValueError: The slot does not reach the goal.
        """
        with self._lock:
            if slot not in self.branches:
                raise ValueError(f"branch {slot} does not reach the goal; these do: {sorted(self.branches)}")
            self._solve(self.branches[slot], stay=True)

    def run(self) -> None:
        """Serve until Ctrl-C."""
        where = f"http://{HOST}:{self.server.get_port()}"
        try:
            print(f"the arm is at {where}, for this machine only; Ctrl-C ends it", flush=True)
            while True:
                time.sleep(3600)
        except KeyboardInterrupt:
            self.server.stop()

    def _ranges(self) -> tuple[np.ndarray, np.ndarray]:
        """(n,) ends of the sliders [rad, m]."""
        low, high = np.asarray(self.arm.limits, float).T
        widest = np.array([WIDEST[kind] for kind in self.arm.kinds])
        return np.where(np.isfinite(low), low, -widest), np.where(np.isfinite(high), high, widest)

    def _middle(self) -> np.ndarray:
        middle = (self.low + self.high) / 2
        return np.clip(middle + 0.3 * np.array([kind == "R" for kind in self.arm.kinds]), self.low, self.high)

    def _slider(self, i: int) -> Any:
        factor, unit = DISPLAY[self.arm.kinds[i]]
        low, high = factor * self.low[i], factor * self.high[i]
        start = float(np.clip(factor * self.q[i], low, high))
        label = f"{self.names[i]} [{unit}]"
        if i in self.arm.locked:
            label = f"self-motion: {label}"
        return self.server.gui.add_slider(label, low, high, (high - low) / 1000, start)

    def _chain(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The poses of the links (n + 1, 4, 4) and of the tool (4, 4)."""
        stations, tip = _lines(self.arm, q.astype(self.arm.dtype))
        return np.asarray(stations, float), np.asarray(tip, float)

    def _at_rest(self, change) -> None:
        """Change handles without being called back for it."""
        before, self._quiet = self._quiet, True
        try:
            change()
        finally:
            self._quiet = before

    def _place_goal(self, T: np.ndarray) -> None:
        self.goal.position, self.goal.wxyz = T[:3, 3], quaternion(T[:3, :3])

    def _moved(self, i: int, _) -> None:
        """A slider was moved: the arm follows. That of a redundant joint keeps the goal."""
        with self._lock:
            if self._quiet:
                return
            q = self.q.copy()
            q[i] = float(self.sliders[i].value) / DISPLAY[self.arm.kinds[i]][0]
            if i in self.arm.locked:
                self._solve(q)
            else:
                self.set_joints(q)

    def _dragged(self) -> None:
        with self._lock:
            if not self._quiet:
                self._solve(self.q)

    def _chosen(self) -> None:
        with self._lock:
            if self._quiet or self.branch.value == "nearest":
                return
            slot = self.arm.branches.index(self.branch.value)
            if slot in self.branches:
                self.pick(slot)

    def _solve(self, q: np.ndarray, stay: bool = False) -> None:
        """Solve the goal at the gizmo and draw: the arm at q, or at the branch nearest to q within limits."""
        dtype = self.arm.dtype
        goal = pose(self.goal.position, wxyz=self.goal.wxyz, dtype=dtype)
        free = np.asarray(q[self.arm.locked[0]], dtype) if self.arm.locked else None
        sol, best, found = _answers(self.arm, goal, free, q.astype(dtype))
        valid = np.asarray(sol.valid)
        self.branches = {int(k): np.asarray(sol.q[k], float) for k in np.flatnonzero(valid)}
        self.q = np.asarray(best, float) if bool(found) and not stay else q
        self._at_rest(self._show)

    def _show(self) -> None:
        for i, slider in enumerate(self.sliders):
            factor = DISPLAY[self.arm.kinds[i]][0]
            slider.value = float(np.clip(factor * self.q[i], factor * self.low[i], factor * self.high[i]))
        here = [k for k, q in self.branches.items() if np.abs(np.sin((q - self.q) / 2)).max() < 1e-3]
        self.branch.value = self.arm.branches[here[0]] if here else "nearest"
        self._draw("/arm", self.q, ARM_COLOR, 0.012)
        self._draw_joints()
        within = 0
        for slot in range(len(self.arm.branches)):
            q = self.branches.get(slot)
            if q is None:
                for part in ("lines", "ball"):
                    self.server.scene.remove_by_name(f"/branches/{slot}/{part}")
                continue
            inside = bool((self._shares(q) >= 0).all())
            within += inside
            color = _rgb(COLORS[slot % len(COLORS)]) if inside else OUTSIDE
            stations = self._draw(f"/branches/{slot}/lines", q, color, 0.004)
            ball = self.server.scene.add_icosphere(
                f"/branches/{slot}/ball", 0.02 * self.size, color, position=self._ball(stations, slot)
            )
            ball.on_click(functools.partial(self._clicked, slot))
        if self._mesh is not None:
            self._mesh(self.q)
        named = "\n".join(f"- {markdown(self.arm.branches[k])}" for k in self.branches)
        total = len(self.arm.branches)
        self.summary.content = (
            f"**{len(self.branches)} of {total} branches, {within} within limits**\n\n{named}"
        )

    def _clicked(self, slot: int, _) -> None:
        with self._lock:
            if slot in self.branches:
                self.pick(slot)

    def _ball(self, stations: np.ndarray, slot: int) -> np.ndarray:
        """Where a branch is clicked: at its elbow, those that differ in the wrist only side by side."""
        elbow = stations[min(3, len(stations) - 1), :3, 3]
        return elbow + np.array([0, 0, 0.05 * self.size * (slot // 4)])

    def _shares(self, q: np.ndarray) -> np.ndarray:
        """(n,) clearance of the nearer limit as a share of the range; negative outside, 1 without limits."""
        low, high = np.asarray(self.arm.limits, float).T
        with np.errstate(invalid="ignore"):
            shares = np.minimum(q - low, high - q) / np.maximum(high - low, 1e-12)
        # A limit is rounded to the arm's own type.
        return np.where(np.isfinite(shares), np.where(abs(shares) < 1e-6, 0, shares), 1)

    def _draw_joints(self) -> None:
        """A ball on each joint, in the color of its clearance."""
        stations, _ = self._chain(self.q)
        for i, share in enumerate(self._shares(self.q)):
            color = AT if share < AT_SHARE else NEAR if share < NEAR_SHARE else FREE
            self.server.scene.add_icosphere(
                f"/joints/{i}", 0.015 * self.size, color, position=stations[i, :3, 3]
            )

    def _draw(self, name: str, q: np.ndarray, color: tuple[int, int, int], thick: float) -> np.ndarray:
        stations, tip = self._chain(q)
        line = sticks_of(self.arm, stations, tip).line
        points = np.stack([line[:-1], line[1:]], axis=1).astype(np.float32)
        self.server.scene.add_line_segments(name, points, color, thickness=thick * self.size)
        return stations

    def _draw_map(self, reach: Any) -> None:
        """The layer of a map through the arm's foot, across y."""
        plane = plane_of(reach, ("y", float(np.asarray(self.arm.base)[1, 3])))
        spans = [reach.positions.axis(k) for k in range(3)]
        half = reach.positions.spacing / 2
        center = np.array([(ticks[0] + ticks[-1]) / 2 for ticks in spans])
        center[plane.axis] = plane.at
        width, height = (float(spans[k][-1] - spans[k][0] + 2 * half) for k in (0, 2))
        self.server.scene.add_image(
            "/map",
            np.ascontiguousarray(slice_image(reach, plane)),
            width,
            height,
            wxyz=quaternion(image_rotation(plane.axis)),
            position=center,
            format="png",
        )

    def _draw_mesh(self, urdf: Any) -> Any:
        """The file's meshes at the foot of its root link; gives a function that moves them to joints."""
        from viser.extras import ViserUrdf

        shown = ViserUrdf(self.server, urdf, root_node_name="/meshes")
        driven = list(shown.get_actuated_joint_names())

        def move(q: np.ndarray) -> None:
            values = dict(zip(self.names, q, strict=True))
            shown.update_cfg(np.array([values.get(name, 0.0) for name in driven]))

        return move


def view(arm: Arm, q: Any = None, **options: Any) -> None:
    """Show an arm in the browser until Ctrl-C; arguments as those of `ArmViewer`."""
    ArmViewer(arm, q, **options).run()
