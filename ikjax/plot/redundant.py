"""The self-motion of a goal: the joints over the redundant joint, and its parts within the limits."""

import numpy as np

from ikjax.arm.arm import Arm
from ikjax.core.text import picture
from ikjax.ik.self_motion import SelfMotion
from ikjax.plot.style import COLORS, INK, PALE, STYLE, finish, pyplot

COLUMNS = 4


def self_motion(arm: Arm, curve: SelfMotion, path=None):
    """Every joint over the redundant one, a color a slot, and the parts of each slot within the limits.

    Lines are thick within the joint limits, thin where a slot reaches the goal beyond them, and pale where it
    does not reach it. They are cut where a joint turns through half a turn. Dashed lines are joint limits.

    Args:
        arm: The arm, with one redundant joint.
        curve: From `ikjax.self_motion(arm, goal)`, of one goal.
        path: Where to save the picture.

    Returns:
        The figure.

    Raises:
        ImportError: Without matplotlib.
        ValueError: A self-motion of more than one goal, or of another arm.
    """
    plt = pyplot()
    if curve.q.ndim != 3 or curve.q.shape[-1] != arm.n or len(arm.locked) != 1:
        raise ValueError(
            f"curve must be of one goal of an arm with one redundant joint, got q {curve.q.shape}"
        )
    free = arm.locked[0]
    values, q = np.asarray(curve.redundancy, float), np.asarray(curve.q, float)
    state = np.asarray(curve.valid, int) + np.asarray(curve.within, int)
    shown = [i for i in range(arm.n) if i != free]
    rows = -(-(len(shown) + 1) // COLUMNS)
    names = arm.joint_names or [f"joint {i + 1}" for i in range(arm.n)]
    units = ["rad" if kind == "R" else "m" for kind in arm.kinds]
    across = f"{picture(names[free])} [{units[free]}]"
    with plt.rc_context(STYLE):
        figure, grid = plt.subplots(
            rows, COLUMNS, figsize=(3.1 * COLUMNS, 2.5 * rows + 0.5), layout="constrained", sharex=True
        )
        panels = list(grid.reshape(-1))
        for ax, i in zip(panels, shown, strict=False):
            for slot in range(q.shape[0]):
                for style, x, y in _lines(values, q[slot, :, i], state[slot], arm.kinds[i] == "R"):
                    color = COLORS[slot % len(COLORS)]
                    ax.plot(x, y, **_STYLES[style], **({} if style == 0 else {"color": color}))
            for limit in np.asarray(arm.limits, float)[i]:
                if np.isfinite(limit):
                    ax.axhline(limit, color=INK, lw=0.8, ls="--", zorder=1)
            ax.set_title(f"{picture(names[i])} [{units[i]}]", color=INK)
            ax.grid(axis="both")
        bars = panels[len(shown)]
        _bars(bars, arm, curve, values)
        for ax in panels[len(shown) + 1 :]:
            ax.set_axis_off()
        if spare := panels[len(shown) + 1 :]:
            _legend(spare[0])
        for k, ax in enumerate(panels[: len(shown) + 1]):
            ax.spines[["top", "right"]].set_visible(False)
            if k + COLUMNS > len(shown):
                ax.set_xlabel(across)
                ax.tick_params(labelbottom=True)
        figure.suptitle(
            f"{picture(arm.name)}: the self-motion of a goal over {picture(names[free])}",
            fontsize=12,
            fontweight="bold",
        )
    return finish(figure, path)


_STYLES = (
    {"color": PALE, "lw": 0.8, "zorder": 2},
    {"lw": 0.9, "alpha": 0.8, "zorder": 3},
    {"lw": 3.0, "solid_capstyle": "round", "zorder": 4},
)
"""Of a line where a slot does not reach the goal, where it does, and where it does within the limits."""


def _lines(x: np.ndarray, y: np.ndarray, state: np.ndarray, turning: bool):
    """A slot's curve cut where its state changes or its joint jumps: states, and x and y of each piece."""
    jump = np.abs(np.diff(y)) > (np.pi if turning else np.inf)
    first = 0
    for k in range(1, len(x) + 1):
        if k == len(x) or jump[k - 1] or state[k] != state[k - 1]:
            # Where only the state changes, the lesser one goes on to the next sample.
            before = first > 0 and not jump[first - 1] and state[first] < state[first - 1]
            after = k < len(x) and not jump[k - 1] and state[k - 1] < state[k]
            piece = slice(first - before, k + after)
            yield int(state[first]), x[piece], y[piece]
            first = k


def _bars(ax, arm: Arm, curve: SelfMotion, values: np.ndarray) -> None:
    """The parts within the limits, a row a slot."""
    parts, is_part = np.asarray(curve.parts, float), np.asarray(curve.is_part)
    for slot, row in enumerate(parts):
        for low, high in row[is_part[slot]]:
            width = max(high - low, 4e-3 * np.ptp(values))
            ax.barh(slot, width, 0.7, left=low, color=COLORS[slot % len(COLORS)])
    ax.set(ylim=(len(parts) - 0.4, -0.6), yticks=range(len(parts)), xlim=(values[0], values[-1]))
    ax.set_yticklabels([f"{k}  {picture(name)}" for k, name in enumerate(arm.branches)], fontsize=6)
    ax.set_title("parts within the limits, by slot", color=INK)
    ax.grid(axis="x")
    ax.set_axisbelow(True)


def _legend(ax) -> None:
    names = ("does not reach", "reaches beyond the limits", "within the limits")
    for style, name in zip(reversed(_STYLES), reversed(names), strict=True):
        ax.plot([], [], label=name, **{"color": COLORS[0], **style})
    ax.plot([], [], color=INK, lw=0.8, ls="--", label="joint limit")
    ax.legend(loc="center left", frameon=False)
