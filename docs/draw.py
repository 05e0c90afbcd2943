"""Draw the pictures of the documentation again: `python docs/draw.py [NAME ...]`, some minutes.

The library draws them: `ikjax.plot.branches` for every family, `ikjax.plot.sticks` for the concepts,
`ikjax.plot.self_motion` for seven joints.
"""

import dataclasses
import pathlib
import sys
from collections.abc import Callable

import jax
import matplotlib
import numpy as np

import ikjax
from ikjax.plot.style import ACCENT, COLORS, INK, STYLE, pyplot

matplotlib.use("Agg")
HERE = pathlib.Path(__file__).parent / "pictures"
DPI = 100
DEG = np.pi / 180


def table(name: str, degrees, **columns) -> ikjax.Arm:
    """An arm of no maker, for families that the catalogue has no arm of."""
    alpha = np.array(degrees) * DEG
    return ikjax.Arm.from_dh(alpha=alpha, convention="standard", name=name, **columns)


# The arm that stands for each family; of five_axis one without lateral offset, which has all four branches.
ARMS: dict[str, Callable[[], ikjax.Arm]] = {
    "ortho_parallel_wrist": ikjax.robots.puma560,
    "three_parallel": ikjax.robots.ur5e,
    "pieper": lambda: table(
        "any three joints, then a wrist",
        [70, 25, -80, 90, -90, 0],
        a=[0.12, 0.4, 0.07, 0, 0, 0],
        d=[0.3, 0.11, 0.06, 0.4, 0, 0.1],
    ),
    "pieper_reversed": lambda: table(
        "a wrist, then any three joints",
        [90, -90, 70, 25, -80, 0],
        a=[0, 0, 0.4, 0.3, 0.2, 0.1],
        d=[0.3, 0, 0.1, 0.1, 0.06, 0.1],
    ),
    "parallel_axes": lambda: table(
        "three parallel axes, the rest anyhow",
        [70, 0, 180, 80, -75, 20],
        a=[0.11, 0.37, 0.29, 0.08, 0.05, 0.03],
        d=[0.3, 0.1, 0.07, 0.12, 0.09, 0.1],
    ),
    "offset_wrist": ikjax.robots.crx10ia,
    "offset_wrist_reversed": lambda: table(
        "two axes meeting, then two parallel",
        [75, -60, 80, 0, -70, 0],
        a=[0.06, 0, 0.08, 0.37, 0.11, 0.03],
        d=[0.2, 0.09, 0.32, 0.07, 0.1, 0.1],
    ),
    "scara": ikjax.robots.gx4_351s,
    "five_axis": ikjax.robots.motoman_l3,
    "turret": lambda: table("a turret", [90, 0, 0, 0], a=[0.05, 0.25, 0.2, 0.1], d=[0.3, 0, 0, 0]),
    "planar_pose": ikjax.robots.planar_3r,
    "planar_position": ikjax.robots.planar_2r,
    "position": lambda: table(
        "three joints to a point", [70, 25, 0], a=[0.12, 0.4, 0.4], d=[0.3, 0.11, 0.06]
    ),
}


def joints(arm: ikjax.Arm, count: int) -> np.ndarray:
    """Random joints within the limits; within half a turn and a metre where there are none."""
    free = np.where(np.array(list(arm.kinds)) == "R", np.pi, 1.0)[:, None] * [-1, 1]
    low, high = np.where(np.isfinite(arm.limits), np.asarray(arm.limits), free).T
    return np.random.default_rng(0).uniform(np.maximum(low, -np.pi), np.minimum(high, np.pi), (count, arm.n))


def clear_goal(arm: ikjax.Arm) -> jax.Array:
    """A goal that as many branches as can be reach, as different from each other as can be."""
    goals = ikjax.fk(arm, joints(arm, 2000))
    sol = ikjax.solve(arm, goals)
    inside = np.asarray(ikjax.within_limits(arm, sol).valid).sum(-1)
    places = np.asarray(ikjax.frames(arm, sol.q))[..., :3, 3]
    size = np.abs(places - places[..., :1, :]).max()
    apart = places.std(axis=1).sum((-1, -2)) / size
    score = 100 * np.asarray(sol.valid).sum(-1) + 2 * inside + apart
    # Drawn from the side, an arm is seen best when its goal is above the floor and away from axis 1.
    base = np.asarray(arm.base)[:3, 3]
    away = np.linalg.norm(np.asarray(goals)[:, :2, 3] - base[:2], axis=-1) / size
    score -= 1000 * (away < 0.4 * away.max())
    return goals[int(np.argmax(score))]


def family(name: str):
    """Every branch of one goal, by the library."""
    arm = ARMS[name]()
    assert arm.family == name, (arm.family, name)
    return ikjax.plot.branches(arm, clear_goal(arm))


def flat(ax, arm: ikjax.Arm, q, color: str, width: float = 3, alpha: float = 1.0) -> None:
    """A planar arm seen from above."""
    body = ikjax.plot.sticks(arm, q)
    ax.plot(*body.line[:, :2].T, color=color, lw=width, alpha=alpha, solid_capstyle="round")
    ax.plot(*body.joints[:, :2].T, "o", color="white", mec=color, mew=1.4, ms=6, alpha=alpha, zorder=4)


def margin():
    """Two branches of a 2R arm that meet at a fold, and their margin along the way out."""
    arm = ikjax.robots.planar_2r(0.6, 0.4)
    figure = pyplot().figure(figsize=(9.5, 3.6), layout="constrained")
    left, right = figure.subplots(1, 2)
    turn = np.linspace(0, 2 * np.pi, 200)
    for r in (0.2, 1.0):
        left.plot(r * np.cos(turn), r * np.sin(turn), color="#999999", lw=1, ls="--")
    for r, angle in ((0.7, 2.2), (0.95, 0.9), (1.2, -0.4)):
        goal = ikjax.position(r * np.cos(angle), r * np.sin(angle), 0.0)
        sol = ikjax.solve(arm, goal)
        for slot, q in enumerate(np.asarray(sol.q)):
            flat(left, arm, q, COLORS[slot] if sol.valid[slot] else "#b8b8b8")
        left.plot(*np.asarray(goal)[:2, 3], "D", color=INK, ms=6, zorder=6)
        label = f"margin {float(sol.margin[0]):+.2f} m"
        left.annotate(label, np.asarray(goal)[:2, 3], (8, 8), textcoords="offset points", fontsize=8)
    left.set(aspect="equal", xlabel="x [m]", ylabel="y [m]", title="two branches (blue: left, orange: right)")
    left.set(xlim=(-1.15, 1.75), ylim=(-1.1, 1.1))
    r = np.linspace(0.02, 1.4, 400)
    margins = ikjax.solve(arm, ikjax.position(r, 0 * r, 0 * r)).margin[:, 0]
    right.plot(r, margins, color=INK, lw=2)
    right.fill_between(r, margins, 0, where=np.asarray(margins) > 0, color=COLORS[2], alpha=0.25)
    right.fill_between(r, margins, 0, where=np.asarray(margins) < 0, color=ACCENT, alpha=0.25)
    right.axhline(0, color="#888888", lw=0.8)
    for fold in (0.2, 1.0):
        right.annotate("fold", (fold, 0), (0, -14), textcoords="offset points", fontsize=8, ha="center")
        right.plot(fold, 0, "o", color=ACCENT, ms=6)
    right.set(xlabel="distance of the goal from axis 1 [m]", ylabel="margin [m]", title="margin along a ray")
    return figure


def continuum():
    """A 2R arm of equal links whose goal lies on axis 1: every angle of joint 1 is an answer."""
    arm = ikjax.robots.planar_2r(0.5, 0.5)
    figure = pyplot().figure(figsize=(9.5, 3.6), layout="constrained")
    axes = figure.subplots(1, 3)
    for ax, title, r, now in zip(
        axes,
        ("goal off axis 1", "goal on axis 1, q_now = (0, 0)", "goal on axis 1, q_now = (1, 0)"),
        (0.4, 0.0, 0.0),
        (0.0, 0.0, 1.0),
        strict=True,
    ):
        goal = ikjax.position(r, 0.0, 0.0)
        sol = ikjax.solve(arm, goal, np.array([now, 0.0]))
        if r == 0:
            for turn in np.linspace(0, 2 * np.pi, 24, endpoint=False):
                flat(ax, arm, np.array([turn, np.pi]), "#bbbbbb", 1.2, 0.7)
        for slot, q in enumerate(np.asarray(sol.q)):
            flat(ax, arm, q, COLORS[slot], 4 - 1.5 * slot)
        ax.plot(*np.asarray(goal)[:2, 3], "D", color=INK, ms=6, zorder=6)
        said = "continuum: " + ", ".join(str(bool(x)) for x in sol.continuum)
        ax.set(aspect="equal", xlim=(-0.6, 0.6), ylim=(-0.6, 0.6), title=f"{title}\n{said}", xlabel="x [m]")
    axes[0].set_ylabel("y [m]")
    return figure


def given():
    """The arm as recognized and, with axes that lean, as given."""
    arm = ikjax.robots.ur10e()
    # Three times what axis_tolerance may be.
    off = np.zeros((arm.n + 1, 6))
    off[1, 3:], off[2, 3:], off[3, 3:] = (0.03, 0, 0), (-0.06, 0.02, 0), (0.05, 0, 0)
    lean = dataclasses.replace(arm, correction=off)
    figure = pyplot().figure(figsize=(9.5, 4.5), layout="constrained")
    q = np.array([0.3, -1.1, 1.3, -0.9, -1.2, 0.0])
    whole = ikjax.plot.sticks(arm, q).line
    center, half = (whole.max(0) + whole.min(0)) / 2, 0.6 * np.ptp(whole, axis=0).max()
    for k, (title, one) in enumerate(
        (("as recognized: the table", arm), ("as given: the table and `correction`", lean))
    ):
        ax = figure.add_subplot(1, 2, k + 1, projection="3d")
        for i, letter in enumerate("xyz"):
            getattr(ax, f"set_{letter}lim")(center[i] - half, center[i] + half)
            getattr(ax, f"set_{letter}label")(f"{letter} [m]", fontsize=7)
        ax.tick_params(labelsize=6)
        ax.view_init(elev=20, azim=-125)
        ax.set_box_aspect((1, 1, 1), zoom=1.0)
        ikjax.plot.arm(arm, q, ax, color=COLORS[0] if one is arm else "#c8c8c8", width=2.5)
        if one is lean:
            ikjax.plot.arm(one, q, ax, color=COLORS[1], width=2.5)
        frames = np.asarray(ikjax.frames(one, q))
        for i in (1, 2, 3):
            point, along = frames[i, :3, 3], frames[i, :3, 2]
            ax.plot(*np.stack([point - 0.45 * along, point + 0.45 * along]).T, color=ACCENT, lw=1, ls="--")
        ax.set_title(title.replace("`", ""))
    figure.suptitle(
        "Axes 2, 3 and 4 of a UR10e, dashed; on the right they lean by up to 0.06 rad, so that it can be seen"
    )
    return figure


def precision():
    """How far valid answers are from their goals, in both types."""
    figure = pyplot().figure(figsize=(7.5, 3.2), layout="constrained")
    ax = figure.subplots()
    bins = np.logspace(-18, -3, 91)
    for dtype, tolerance, color in ((np.float64, 1e-9, COLORS[0]), (np.float32, 2e-5, COLORS[1])):
        arm = ikjax.robots.puma560().astype(dtype)
        goals = ikjax.fk(arm, joints(arm, 20_000).astype(dtype))
        sol = ikjax.solve(arm, goals)
        off = np.asarray(sol.position_error)[np.asarray(sol.valid)].astype(float)
        name = np.dtype(dtype).name
        ax.hist(np.maximum(off, 2e-18), bins, color=color, alpha=0.7, label=name)
        far = np.asarray(goals)[:, :3, 3].astype(float)
        reach = float(np.abs(arm.a).sum() + np.abs(arm.d).sum())
        allowed = tolerance * (reach + np.linalg.norm(far, axis=-1).mean())
        ax.axvline(allowed, color=color, lw=1.5, ls="--")
        ax.annotate(
            f"allowed\nin {name}",
            (allowed, 0.8),
            (4, 0),
            xycoords=("data", "axes fraction"),
            fontsize=8,
            textcoords="offset points",
        )
    ax.set(xscale="log", xlabel="position_error of valid slots [m]", ylabel="slots")
    ax.legend(loc="upper left")
    return figure


def self_motion():
    """Every posture of a Franka that reaches one goal."""
    arm = ikjax.robots.fer()
    goal = ikjax.fk(arm, np.array([0.2, -0.4, 0.1, -1.9, 0.3, 1.8, 0.5]))
    return ikjax.plot.self_motion(arm, ikjax.self_motion(arm, goal, samples=256))


CONCEPTS = {
    "margin": margin,
    "continuum": continuum,
    "given": given,
    "precision": precision,
    "self_motion": self_motion,
}


def main(names: list[str]) -> None:
    jax.config.update("jax_enable_x64", True)
    HERE.mkdir(exist_ok=True)
    plt = pyplot()
    for name in names or [*CONCEPTS, *ARMS]:
        with plt.rc_context(STYLE):
            figure = CONCEPTS[name]() if name in CONCEPTS else family(name)
            figure.savefig(HERE / f"{name}.png", dpi=DPI)
            plt.close(figure)
        print(HERE / f"{name}.png")


if __name__ == "__main__":
    main(sys.argv[1:])
