"""`project`: the attainable pose nearest to any goal.

Storey: ik. The closed form finds the basins, Newton's steps go to their bottoms.
"""

import jax
import jax.numpy as jnp
import numpy as np

from ikjax.arm.arm import Arm
from ikjax.ik import priority as priorities
from ikjax.ik.projection import Projection
from ikjax.ik.refine import STEPS, best_of, checked, descended
from ikjax.solvers import FAMILIES

SCATTERED, BESIDE = 64, 28
"""Starts for an arm without a closed form, and beside the branches of an arm with limits."""


def project(
    arm: Arm,
    goals,
    length: float = 0.1,
    *,
    priority: str = "weighted",
    steps: int = STEPS,
    beside: int | None = None,
) -> Projection:
    """The attainable pose nearest to each goal, within the joint limits.

    Nearest is what minimises |dp|^2 + (length * angle)^2; see `refine`. Every branch of the closed form is a
    start: for five joints of family `five_axis` with the goal's point held and the orientation as near as
    that allows (the nearest reachable point where it is out of reach), for all other families the branches of
    `solve`, clamped. Limits, and joints too few, make basins that no branch leads to: `beside` adds starts
    that are spread over them, always the same. An arm without a family starts from 64 such. Each start ends
    where no small move improves it; that the best is the nearest of all poses is not proved, and within tight
    limits it is not always (`benchmarks/projection.py` compares).

    Args:
        arm: Any arm of up to seven joints.
        goals: T_world_tool, (..., 4, 4), float32 or float64. A goal that is no pose is never `converged`.
        length: What a radian is worth [m]; positive.
        priority: "weighted" is the cost above. "position" and "orientation" put one error first; see
            `refine`. Where the closed form holds the point, it is what "position" starts from.
        steps: At most so many steps of refinement from each branch; with none, the closed form alone.
        beside: So many starts beside the branches; by default 28 for an arm with limits, and for one that is
            asked for poses and not of family `five_axis`; none without steps. They are most of the work.

    Returns:
        `Projection`: the best branch, and all of them as `.branches`, (..., S): first those of the arm, in
        their order, then the starts beside them. Slopes as in `refine`.

    Raises:
        ValueError: Wrong shapes or types.
    """
    goals, arm = checked(arm, goals, length)
    priority = priorities.checked(arm, priority)
    if beside is None:
        beside = SCATTERED if arm.family is None else BESIDE if steps and _astray(arm) else 0
    return best_of(arm, _from_all(arm, goals, length, steps, beside, priority), priority)


def _from_all(arm: Arm, goals, length, steps: int, beside: int, priority: str) -> Projection:
    more = scattered(arm, goals.shape[:-2], beside)
    if arm.family is None:
        return descended(arm, goals, more, length, steps, priority)
    if priority != "weighted" and steps:
        # The closed form once for all priorities, and all starts in one program.
        still = jax.lax.stop_gradient((arm, goals, jnp.asarray(length, goals.dtype)))
        closed = descended(*still[:2], None, still[2], 0).q
        starts = jnp.concatenate([closed, more], axis=-2)
        return descended(arm, goals, starts, length, steps, priority)
    found = descended(arm, goals, None, length, steps)
    if not beside:
        return found
    rest = descended(arm, goals, more, length, steps)
    axis = goals.ndim - 2
    return jax.tree.map(lambda x, y: jnp.concatenate([x, y], axis), found, rest)


def _astray(arm: Arm) -> bool:
    """Whether the nearest pose may be where no branch leads: by limits, or for want of joints."""
    if arm.task == "pose" and FAMILIES[str(arm.family)].nearest is None:
        return True
    return isinstance(arm.limits, jax.core.Tracer) or bool(np.isfinite(np.asarray(arm.limits)).any())


def scattered(arm: Arm, batch: tuple[int, ...], count: int):
    """Joints spread evenly over the limits, the same for every goal, (..., S, n).

    Source: the additive recurrence R_d of Roberts, The unreasonable effectiveness of quasirandom
    sequences (2018).
    """
    root = 1.5
    for _ in range(64):
        root = (1 + root) ** (1 / (arm.n + 1))
    shares = np.outer(np.arange(1, count + 1), root ** -np.arange(1.0, arm.n + 1)) % 1
    low, high = arm.limits[:, 0], arm.limits[:, 1]
    widest = jnp.asarray([np.pi if kind == "R" else 1 for kind in arm.kinds], arm.dtype)
    low, high = jnp.maximum(low, -widest)[None], jnp.minimum(high, widest)[None]
    starts = low + (high - low) * jnp.asarray(shares, arm.dtype)
    return jnp.broadcast_to(starts, (*batch, *starts.shape))
