"""The shoulder: joint 1 turns the arm's plane until it contains the wrist.

Branches: 2.

Bit: front has the wrist ahead of axis 1 along x1 (side = +1), back behind it (-1).

Source: Craig, Introduction to Robotics, 3rd ed., section 4.7, equations (4.62)-(4.65).
"""

from typing import NamedTuple

import jax.numpy as jnp

from ikjax.core.roots import cosine_sine
from ikjax.core.trig import Angle, Scalar
from ikjax.core.xla import pin
from ikjax.solvers.context import Setting


class Shoulder(NamedTuple):
    turn: Angle
    """Joint 1."""
    ahead: Scalar
    """Signed distance of the wrist from axis 1 along x1."""
    margin: Scalar
    continuum: Scalar


def shoulder(x: Scalar, y: Scalar, lateral: Scalar, side: Scalar, setting: Setting) -> Shoulder:
    """Solve x sin(t) - y cos(t) = lateral, with x cos(t) + y sin(t) on the given side.

    Args:
        x, y: The wrist seen along axis 1.
        lateral: Distance of the wrist from the plane through axis 1 and x1.
        side: +1 for the wrist ahead along x1, -1 for behind.
        setting: Its fallback is joint 1 where that is arbitrary: the wrist on axis 1, no lateral offset.

    Returns:
        The angle, clamped to the nearest one where the wrist is too close to axis 1. The margin
        is the wrist's distance from the cylinder about axis 1 that it cannot enter. Without a lateral offset
        there is no such cylinder, the step cannot fail, and the margin is infinite.
    """
    root = cosine_sine(-y, x, lateral, side, noise=setting.length_uncertainty)
    free = (x * x + y * y <= setting.zero_tolerance**2) & (abs(lateral) <= setting.zero_tolerance)
    turn = setting.filled(0, free | root.free, root.sin, root.cos)
    margin = jnp.where(lateral == 0, jnp.inf, root.margin)
    return Shoulder(turn, pin(root.height), margin, free)
