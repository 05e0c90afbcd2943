"""A map in the browser: a movable slice, and every branch of a goal that can be dragged.

Needs viser (`pip install ikjax[viz3d]`). The server listens on 127.0.0.1 only, so that nobody else on the
network can see or control it; from another machine, use `ssh -L 8080:127.0.0.1:8080`.
"""

import dataclasses
import threading
import time
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ikjax.arm.arm import Arm
from ikjax.arm.forward import fk, frames
from ikjax.core.pose import pose, to_quaternion
from ikjax.core.text import markdown
from ikjax.ik.select import within_limits
from ikjax.ik.solve import solve
from ikjax.maps.sets.positions import Grid
from ikjax.plot.planes import Plane, plane_of, posture, redundant_values, shown_axes, ticks_of
from ikjax.plot.stick import sticks_of
from ikjax.plot.style import COLORS, MAP

HOST = "127.0.0.1"
OUTSIDE = (150, 150, 150)
"""Color of branches that are outside the joint limits."""


class Skeleton(NamedTuple):
    """A branch to draw."""

    slot: int
    lines: np.ndarray
    """(m, 2, 3) links in the world [m]."""
    within: bool
    """Within the joint limits."""


@jax.jit
def _branches(arm: Arm, goal):
    if arm.locked:
        # At the value of the redundant joint that leaves the most branches.
        sol = solve(arm, goal[None], redundancy=redundant_values(arm))
        best = within_limits(arm, sol).valid.sum(-1) + sol.valid.sum(-1) / (1 + sol.valid.shape[-1])
        sol = jax.tree.map(lambda x: x[jnp.argmax(best)], sol)
    else:
        sol = solve(arm, goal)
    inside = within_limits(arm, sol)
    return sol.valid, inside.valid, frames(arm, inside.q), fk(arm, inside.q)


def skeletons(arm: Arm, goal) -> list[Skeleton]:
    """Every valid branch of a goal T_world_tool, (4, 4); where a joint is redundant, at one of its values."""
    valid, within, stations, tips = map(np.asarray, _branches(arm, goal))
    found = []
    for slot in np.flatnonzero(valid):
        line = sticks_of(arm, np.asarray(stations[slot], float), np.asarray(tips[slot], float)).line
        found.append(Skeleton(int(slot), np.stack([line[:-1], line[1:]], axis=1), bool(within[slot])))
    return found


def slice_image(reach, plane: Plane) -> np.ndarray:
    """A layer as colors (rows, columns, 4) uint8, first row on top, transparent where nothing is reached."""
    from matplotlib import colormaps

    share = np.asarray(reach.dexterity).take(plane.layer, plane.axis).T[::-1]
    anyhow = np.asarray(reach.reachable).take(plane.layer, plane.axis).T[::-1] > 0
    colors = colormaps[MAP](share / max(float(np.max(reach.dexterity)), 1e-9))
    colors[share == 0] = (0, 0, 0, 0)
    colors[(share == 0) & anyhow] = (0.7, 0.7, 0.7, 0.5)
    return (255 * colors).round().astype(np.uint8)


def quaternion(rotation: np.ndarray) -> np.ndarray:
    """wxyz of a rotation (3, 3)."""
    return np.asarray([float(c) for c in to_quaternion(tuple(map(tuple, rotation)))])


def image_rotation(axis: int) -> np.ndarray:
    """Rotation (3, 3) of a layer's image: in viser, rows run along x and columns down y."""
    across, up = shown_axes(axis)
    right, down = np.eye(3)[across], -np.eye(3)[up]
    return np.stack([right, down, np.cross(right, down)], axis=1)


class Viewer:
    """A server with one map of a box grid.

    Args:
        reach: A `ReachMap`.
        port: For the browser; another one is used if it is taken.
        server: A viser server to draw on; a new one on 127.0.0.1 by default.

    Raises:
        ImportError: Without viser or matplotlib.
        ValueError: A map of no box grid, an arm of no family.
    """

    def __init__(self, reach, port: int = 8080, server: Any = None):
        if not isinstance(reach.positions, Grid):
            raise ValueError(f"the viewer shows box grids, got {reach.positions.in_words()}")
        if reach.arm.family is None:
            raise ValueError(f"the viewer needs an arm with a closed form, {reach.arm.name} has none")
        # Read once, because a slice is drawn at every move of the slider.
        self.reach = dataclasses.replace(reach, arrays=reach.to_numpy())
        self.arm = reach.arm
        self._lock = threading.Lock()
        self.server = _server(port) if server is None else server
        scene, gui = self.server.scene, self.server.gui
        base = np.asarray(self.arm.base, float)[:3, 3]
        self.size = float(max(np.ptp(tick) for tick in ticks_of(reach)) or 1.0)
        scene.set_up_direction("+z")
        floor = np.array([base[0], base[1], ticks_of(reach)[2][0]])
        scene.add_grid("/floor", self.size, self.size, cell_size=0.1, section_size=0.5, position=floor)
        camera = self.server.initial_camera
        camera.position, camera.look_at = base + self.size * np.array([0.55, -1.05, 0.45]), base
        scene.add_frame("/base", axes_length=0.08 * self.size, axes_radius=0.004 * self.size, position=base)
        gui.add_markdown(
            f"**{markdown(self.arm.name)}**: {reach.positions.in_words()} x {reach.orientation_count:,} "
            "orientations. "
            "A click on the slice puts the goal there; its handles move and turn it."
        )
        self.axis = gui.add_dropdown("Slice square to", ("x", "y", "z"), initial_value="y")
        self.layer = gui.add_slider("Where along it", 0.0, 1.0, 0.001, 0.5)
        self.limited = gui.add_checkbox("Within joint limits only", False)
        self.summary = gui.add_markdown("")
        start = np.asarray(posture(reach, plane_of(reach, ("y", base[1]))), float)
        self.goal = self._gizmo(start)
        for handle in (self.axis, self.layer):
            handle.on_update(lambda _: self.draw_slice())
        self.limited.on_update(lambda _: self.draw_branches())
        self.goal.on_update(lambda _: self.draw_branches())
        self.draw_slice()
        self.draw_branches()

    def _gizmo(self, q: np.ndarray) -> Any:
        tool = np.asarray(fk(self.arm, q), float)
        return self.server.scene.add_transform_controls(
            "/goal", 0.22 * self.size, wxyz=quaternion(tool[:3, :3]), position=tool[:3, 3]
        )

    def draw_slice(self) -> None:
        """Draw the slice at the position of the slider."""
        axis = "xyz".index(self.axis.value)
        ticks, half = ticks_of(self.reach), self.reach.positions.spacing / 2
        at = ticks[axis][0] + float(self.layer.value) * (ticks[axis][-1] - ticks[axis][0])
        plane = plane_of(self.reach, (self.axis.value, at))
        across, up = shown_axes(axis)
        center = np.array([(tick[0] + tick[-1]) / 2 for tick in ticks])
        center[axis] = plane.at
        self.plane = plane
        width, height = (float(ticks[k][-1] - ticks[k][0] + 2 * half) for k in (across, up))
        with self._lock:
            image = self.server.scene.add_image(
                "/slice",
                np.ascontiguousarray(slice_image(self.reach, plane)),
                width,
                height,
                wxyz=quaternion(image_rotation(axis)),
                position=center,
                cast_shadow=False,
                receive_shadow=False,
                format="png",
            )
            image.on_click(self.put_goal)

    def put_goal(self, click: Any) -> None:
        """Move the goal to where a click's ray meets the slice; its orientation is unchanged."""
        start, ray = np.asarray(click.ray_origin, float), np.asarray(click.ray_direction, float)
        axis = self.plane.axis
        if ray[axis] != 0:
            self.goal.position = start + ray * ((self.plane.at - start[axis]) / ray[axis])
            self.draw_branches()

    def draw_branches(self) -> None:
        """Solve the goal at the gizmo and draw every branch that reaches it."""
        goal = pose(self.goal.position, wxyz=self.goal.wxyz, dtype=self.arm.dtype)
        with self._lock:
            found = {skeleton.slot: skeleton for skeleton in skeletons(self.arm, goal)}
            within = sum(skeleton.within for skeleton in found.values())
            for slot in range(len(self.arm.branches)):
                name, skeleton = f"/branches/{slot}", found.get(slot)
                if skeleton is None or (self.limited.value and not skeleton.within):
                    self.server.scene.remove_by_name(name)
                    continue
                color = _rgb(COLORS[slot % len(COLORS)]) if skeleton.within else OUTSIDE
                # Branches that differ only in the wrist coincide: those within the limits are drawn thicker.
                thick = (0.006 if skeleton.within else 0.003) * self.size
                lines = skeleton.lines.astype(np.float32)
                self.server.scene.add_line_segments(name, lines, color, thickness=thick)
            names = "\n".join(
                f"- {markdown(self.arm.branches[k])}{'' if each.within else ' (outside the limits)'}"
                for k, each in found.items()
            )
            total = len(self.arm.branches)
            self.summary.content = f"**{len(found)} of {total} branches, {within} within limits**\n\n{names}"

    def run(self) -> None:
        """Serve until Ctrl-C."""
        where = f"http://{HOST}:{self.server.get_port()}"
        try:
            # Flushed, because a reader behind a pipe waits for this line.
            print(f"the map is at {where}, for this machine only; Ctrl-C ends it", flush=True)
            while True:
                time.sleep(3600)
        except KeyboardInterrupt:
            self.server.stop()


def _server(port: int) -> Any:
    try:
        import viser
    except ImportError as error:
        raise ImportError("the viewer needs viser: pip install 'ikjax[viz3d]'") from error
    return viser.ViserServer(host=HOST, port=port, verbose=False)


def _rgb(color: str) -> tuple[int, int, int]:
    red, green, blue = (int(color[k : k + 2], 16) for k in (1, 3, 5))
    return red, green, blue
