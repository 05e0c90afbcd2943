"""`project`: the attainable pose nearest to any goal.

The closed form finds the basins, Newton's steps go to their bottoms.
"""

import jax
import jax.numpy as jnp
import numpy as np

from ikjax.arm.arm import Arm
from ikjax.core.known import as_array, stop_gradient
from ikjax.ik import lexicographic as priorities
from ikjax.ik.multistart import STEPS, at_limits, best_of, checked, descended, scattered
from ikjax.ik.results import Projection
from ikjax.solvers.families import FAMILIES

SCATTERED, EXTRA = 64, 28
"""Starts for an arm without a closed form or with one error first, and beside the branches of another."""


def project(
    arm: Arm,
    goals,
    characteristic_length: float = 0.1,
    *,
    priority: str = "weighted",
    steps: int = STEPS,
    extra_starts: int | None = None,
) -> Projection:
    """The attainable pose nearest to each goal, within the joint limits.

    Nearest is what minimizes |dp|^2 + (characteristic_length * angle)^2; see `refine`. Every branch of the
    closed form is a start: for five joints of family `five_axis` with the goal's point held and the
    orientation as near as that allows (the nearest reachable point where it is out of reach), for all other
    families the branches of `solve`, clamped. Limits, and joints too few, make basins that no branch leads
    to: starts beside them are for family `five_axis` those with joint 2 or 4 at a limit, and with joint 5
    beyond the gap in its range (`ik.multistart`); else they are spread over the limits, always the same. An
    arm of no family starts from 64 such. Each start ends where no small move improves it; that the best is
    the nearest of all poses is not proved, and within tight limits it is not always
    (`benchmarks/projection.py` compares).

    Args:
        arm: Any arm of up to seven joints.
        goals: T_world_tool, (..., 4, 4), float32 or float64. Of a rotation that is off by up to 1e-2, the
            nearest rotation is the goal; a goal that is no pose is never `converged`. See `refine`.
        characteristic_length: What a radian is worth [m]; positive.
        priority: "weighted" is the cost above. "position" and "orientation" put one error first; see
            `refine`. Where the closed form holds the point, it is what "position" starts from.
        steps: At most so many steps of refinement from each branch; with none, the closed form alone.
        extra_starts: So many starts beside the branches, spread over the limits. By default the 36 closed
            ones for an arm of family `five_axis` with limits; 28 for another with limits, or that is asked
            for poses; 64 for either where one error comes first; none without steps. They are most of the
            work.

    Returns:
        `Projection`: the best branch, and all of them as `.branches`, (..., S): first those of the arm, in
        their order, then the starts beside them. Slopes as in `refine`.

    Raises:
        ValueError: Wrong shapes or types.
    """
    goals, arm = checked(arm, goals, characteristic_length, steps)
    if extra_starts is not None and extra_starts < 0:
        raise ValueError(f"extra_starts must not be negative, got {extra_starts}")
    priority = priorities.checked(arm, priority)
    more = _extra_starts(arm, goals, steps, extra_starts, priority)
    return best_of(arm, goals, _from_all(arm, goals, characteristic_length, steps, more, priority), priority)


def _extra_starts(arm: Arm, goals, steps: int, count: int | None, priority: str) -> jax.Array:
    """The starts beside the branches, (..., S, n)."""
    if count is None:
        astray = arm.family is not None and steps > 0 and _astray(arm)
        if astray and priority == "weighted" and FAMILIES[str(arm.family)].locked:
            return at_limits(arm, goals)
        many = SCATTERED if arm.family is None or priority != "weighted" else EXTRA
        count = many if astray or arm.family is None else 0
    return scattered(arm, goals.shape[:-2], count)


def _from_all(arm: Arm, goals, characteristic_length, steps: int, more, priority: str) -> Projection:
    if arm.family is None:
        return descended(arm, goals, more, characteristic_length, steps, priority)
    if priority != "weighted" and steps:
        # The closed form once for all priorities, and all starts in one program.
        still = stop_gradient((arm, goals, as_array(characteristic_length, goals.dtype)))
        closed = descended(*still[:2], None, still[2], 0).q
        starts = jnp.concatenate([closed, more], axis=-2)
        return descended(arm, goals, starts, characteristic_length, steps, priority)
    found = descended(arm, goals, None, characteristic_length, steps)
    if not more.shape[-2]:
        return found
    rest = descended(arm, goals, more, characteristic_length, steps)
    axis = goals.ndim - 2
    return jax.tree.map(lambda x, y: jnp.concatenate([x, y], axis), found, rest)


def _astray(arm: Arm) -> bool:
    """Whether the nearest pose may be where no branch leads: by limits, or for want of joints."""
    if arm.task == "pose" and FAMILIES[str(arm.family)].nearest is None:
        return True
    return isinstance(arm.limits, jax.core.Tracer) or bool(np.isfinite(np.asarray(arm.limits)).any())
