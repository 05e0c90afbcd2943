"""`project`: the attainable pose nearest to any goal.

The closed form finds the basins, and Newton's method goes to their minima.
"""

import functools
import math
from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike

from ikjax.arm.arm import Arm
from ikjax.core.xla import as_array, is_traced
from ikjax.ik.batched import FEW
from ikjax.ik.inline import jit_with_arm
from ikjax.ik.lexicographic import checked_priority
from ikjax.ik.multistart import (
    STEPS,
    branches,
    branches_and_limits,
    checked_arguments,
    closed_form_ends,
    descend_all,
    scattered_starts,
    with_best,
)
from ikjax.ik.results import Projection
from ikjax.solvers.families import FAMILIES

SCATTERED, EXTRA = 64, 28
"""Numbers of scattered starts: for an arm without a closed form or with one error first, and beside the
branches of any other arm."""


def project(
    arm: Arm,
    goals: ArrayLike,
    characteristic_length: ArrayLike = 0.1,
    *,
    priority: str = "weighted",
    steps: int = STEPS,
    extra_starts: int | None = None,
) -> Projection:
    """The attainable pose nearest to each goal, within the joint limits.

    Nearest is what minimizes |dp|^2 + (characteristic_length * angle)^2; see `refine`.

    Every branch of the closed form is a start. For five joints of family `five_axis`, a branch meets the
    goal's point, with the orientation as near as that allows (where the point is out of reach, the nearest
    reachable point). For all other families these are the branches of `solve`, clamped to the limits.

    Limits, and joints too few, make basins that no branch leads to, so there are further starts. For family
    `five_axis` they have joint 2 or 4 at a limit, or joint 5 beyond the gap in its range (`ik.multistart`).
    For other arms they are spread over the limits, always the same. An arm of no family starts from 64 of
    those.

    Each start ends where no small move improves it. That the best is the nearest of all poses is not proved,
    and within tight limits it is not always (`benchmarks/projection.py` compares).

    Args:
        arm: Any arm of up to seven joints.
        goals: T_world_tool, (..., 4, 4), float32 or float64. Where a rotation is off by up to 1e-2, the
            nearest rotation is the goal; a goal that is no pose is never `converged`. See `refine`.
        characteristic_length: Length that counts as much as one radian [m], (); positive.
        priority: "weighted" is the cost above. "position" and "orientation" put one error first; see
            `refine`. Where the closed form meets the point, "position" starts from that.
        steps: Newton steps from each start, at most; with none, the result is the closed form alone.
        extra_starts: Number of starts beside the branches, spread over the limits. By default the 36
            closed-form ones for an arm of family `five_axis` with limits; 28 for another arm with limits, or
            that is asked for poses; 64 for either where one error comes first; none without steps. They are
            most of the work.

    Returns:
        `Projection`: the best start, fields (...), and all of them as `.branches`, (..., S): first the
        branches of the arm, in their order, then the further starts. Gradients as in `refine`.

    Raises:
        ValueError: Wrong shapes or types.
    """
    goals, arm = checked_arguments(arm, goals, characteristic_length, steps)
    if extra_starts is not None and extra_starts < 0:
        raise ValueError(f"extra_starts must not be negative, got {extra_starts}")
    priority = checked_priority(arm, priority)
    options = Options(priority, steps, _further_starts(arm, steps, extra_starts, priority))
    length = as_array(characteristic_length, goals.dtype)
    batch = goals.shape[:-2]
    if is_traced((arm, goals, length)) or not 0 < math.prod(batch) <= FEW:
        return _project(options, arm, goals, length)
    # All starts of a goal are a batch that is large enough, and one program for any number of goals.
    one = _of_one_goal(options)
    if not batch:
        return one(arm, goals, length)
    rows = [one(arm, goal, length) for goal in np.asarray(goals).reshape(-1, 4, 4)]
    return jax.tree.map(lambda *xs: jnp.asarray(np.stack(xs).reshape(*batch, *xs[0].shape)), *rows)


class Options(NamedTuple):
    """Arguments of `project` that its program is compiled for."""

    priority: str
    steps: int
    scattered: int | None
    """Starts that are spread over the limits; None for those with a joint at a limit."""


@functools.cache
def _of_one_goal(options: Options) -> Callable[[Arm, ArrayLike, ArrayLike], Projection]:
    """The program of one goal, with a while loop that ends when all its starts have converged."""
    return jit_with_arm(functools.partial(_project, options), quick=True)


def _project(options: Options, arm: Arm, goals: jax.Array, length: jax.Array) -> Projection:
    """`project` of checked arguments."""
    priority, steps, count = options
    batch = goals.shape[:-2]
    if steps == count == 0 and _has_branches(arm):
        return with_best(arm, goals, closed_form_ends(arm, goals, length), priority)
    starts = [] if count is None else [scattered_starts(arm, batch, count)]
    if _has_branches(arm):
        starts.insert(0, branches_and_limits(arm, goals) if count is None else branches(arm, goals))
    ends = descend_all(arm, goals, jnp.concatenate(starts, axis=-2), length, steps, priority)
    return with_best(arm, goals, ends, priority)


def _further_starts(arm: Arm, steps: int, count: int | None, priority: str) -> int | None:
    """How many starts beside the branches are spread over the limits; None for those at the limits."""
    if count is not None:
        return count
    astray = _has_branches(arm) and steps > 0 and _branches_may_miss(arm)
    if astray and priority == "weighted" and FAMILIES[str(arm.family)].locked:
        return None
    many = EXTRA if _has_branches(arm) and priority == "weighted" else SCATTERED
    return many if astray or not _has_branches(arm) else 0


def _has_branches(arm: Arm) -> bool:
    """Whether the closed form has starts for a goal alone; with redundant joints it wants their values."""
    return arm.family is not None and not arm.locked


def _branches_may_miss(arm: Arm) -> bool:
    """Whether limits, or joints too few, may make a basin that no branch leads to."""
    if arm.task == "pose" and FAMILIES[str(arm.family)].nearest is None:
        return True
    return isinstance(arm.limits, jax.core.Tracer) or bool(np.isfinite(np.asarray(arm.limits)).any())
