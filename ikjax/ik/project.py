"""`project`: the attainable pose nearest to any goal.

Storey: ik. The closed form finds the basins, Newton's steps go to their bottoms.
"""

import jax.numpy as jnp
import numpy as np

from ikjax.arm.arm import Arm
from ikjax.ik.projection import Projection
from ikjax.ik.refine import STEPS, best_of, checked, descended

SCATTERED = 64
"""Starts for an arm without a closed form."""


def project(arm: Arm, goals, length: float = 0.1, *, steps: int = STEPS) -> Projection:
    """The attainable pose nearest to each goal, within the joint limits.

    Nearest is what minimises |dp|^2 + (length * angle)^2; see `refine`. Every branch of the closed form is a
    start: for five joints of family `five_axis` with the goal's point held and the orientation as near as
    that allows (the nearest reachable point where it is out of reach), for all other families the branches of
    `solve`, clamped. An arm without a family starts from 64 joints, spread over its limits and always the
    same. Every branch ends where no small move improves it; that the best is the nearest of all poses was
    measured, and is proved for none.

    Args:
        arm: Any arm of up to seven joints.
        goals: T_world_tool, (..., 4, 4), float32 or float64. A goal that is no pose is never `converged`.
        length: What a radian is worth [m]; positive.
        steps: At most so many steps of refinement from each branch; with none, the closed form alone.

    Returns:
        `Projection`: the best branch, and all of them as `.branches`, (..., S) with S = len(arm.branches).
        Slopes as in `refine`.

    Raises:
        ValueError: Wrong shapes or types.
    """
    goals, arm = checked(arm, goals, length)
    starts = scattered(arm, goals.shape[:-2]) if arm.family is None else None
    return best_of(descended(arm, goals, starts, length, steps))


def scattered(arm: Arm, batch: tuple[int, ...]):
    """Joints spread evenly over the limits, the same for every goal, (..., S, n).

    Source: the additive recurrence R_d of Roberts, The unreasonable effectiveness of quasirandom
    sequences (2018).
    """
    root = 1.5
    for _ in range(64):
        root = (1 + root) ** (1 / (arm.n + 1))
    shares = np.outer(np.arange(1, SCATTERED + 1), root ** -np.arange(1.0, arm.n + 1)) % 1
    low, high = arm.limits[:, 0], arm.limits[:, 1]
    widest = jnp.asarray([np.pi if kind == "R" else 1 for kind in arm.kinds], arm.dtype)
    low, high = jnp.maximum(low, -widest)[None], jnp.minimum(high, widest)[None]
    starts = low + (high - low) * jnp.asarray(shares, arm.dtype)
    return jnp.broadcast_to(starts, (*batch, *starts.shape))
