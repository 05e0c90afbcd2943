"""Objectives of a design: scores of an arm and its `Solutions`, smooth for the ascent and exact at the end.

An objective is called as objective(arm, sol, blur) and returns a score to be maximized: one number, or an
array, whose mean is taken. `sol` is the `Solutions` of the goals in the shape they were given; its margins
and masks include the joint limits where those count. `blur` [m] is how far a margin must be above zero to
count nearly in full; a design study reduces it from step to step. A blur that is the Python number 0 asks
for the exact score. Your own functions may ignore it.
"""

import jax
import jax.numpy as jnp

from ikjax.arm.arm import Arm
from ikjax.ik.margins import smooth_max, smooth_min
from ikjax.ik.quality import manipulability
from ikjax.ik.results import Solutions

SHARE_BLUR = 0.05
"""How far above its threshold a share of orientations must be to count nearly in full."""


def coverage(arm: Arm, sol: Solutions, blur) -> jax.Array:
    """The share of goals that are reached."""
    if _exact(blur):
        return sol.valid.any(-1).astype(sol.margin.dtype)
    return jax.nn.sigmoid(smooth_max(sol.margin, blur) / blur)


def dexterous_share(arm: Arm, sol: Solutions, blur, *, share: float = 0.5) -> jax.Array:
    """The share of positions where at least `share` of the orientations are reached; goals (P, O, 4, 4).

    The dexterity of a position is the share of its orientations that are reached, as in a `ReachMap`. Over a
    grid, the share of positions times its volume is the dexterous volume.

    Raises:
        ValueError: Goals of another shape.
    """
    if sol.valid.ndim != 3:
        raise ValueError(
            f"dexterous_share wants goals (positions, orientations, 4, 4), got {sol.valid.shape[:-1]}"
        )
    reached = coverage(arm, sol, blur).mean(-1)
    if _exact(blur):
        return (reached >= share).astype(reached.dtype)
    return jax.nn.sigmoid((reached - share) / SHARE_BLUR)


def worst_margin(arm: Arm, sol: Solutions, blur) -> jax.Array:
    """The least margin [m] of all goals, each by its best branch."""
    return smooth_min(smooth_max(sol.margin, blur).reshape(-1), blur)


def mean_manipulability(arm: Arm, sol: Solutions, blur) -> jax.Array:
    """Yoshikawa's measure of the best branch that reaches, zero for goals out of reach.

    A goal out of reach has a zero gradient here: add margins where an arm has to reach its goals first.
    """
    return jnp.max(jnp.where(sol.valid, manipulability(arm, sol.q), 0), axis=-1)


NAMED = {
    "coverage": coverage,
    "dexterous_share": dexterous_share,
    "worst_margin": worst_margin,
    "mean_manipulability": mean_manipulability,
}


def _exact(blur) -> bool:
    return isinstance(blur, int | float) and blur == 0
