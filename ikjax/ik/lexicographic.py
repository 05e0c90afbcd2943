"""What comes first in a nearest pose: neither, the point, or the orientation.

First the one error as small as can be, then the other as small as that allows. With the second
worth a share s of the first, the bottom q(s) of their sum moves smoothly to that pose as s goes to zero; so
the share is eased down stage by stage, each going on from where the last one ended, and the straight line
through the last two bottoms is followed to share zero, by all joints but those that a limit holds back. What
is then left of the first error is of the order of the product of the last two shares, where a penalty alone
would leave the last share.

At full stretch a tool point off the last axis leaves bottoms that lie close together, of which either may be
taken: that the best start is the best of all poses is not proved here either.

Source: penalties and their extrapolation after Fiacco and McCormick, Nonlinear Programming (1968), chapter 5.
"""

from collections.abc import Callable

import jax
import jax.numpy as jnp

from ikjax.arm.arm import Arm
from ikjax.arm.forward import reach
from ikjax.core.pose import Pose
from ikjax.core.tolerances import CONVERGED, CURVATURE_FLOOR, LAST_WEIGHT, SAME_COST, SAME_ERROR
from ikjax.core.trig import Scalar
from ikjax.ik import newton
from ikjax.ik.newton import Joints, State, Wish
from ikjax.ik.results import Projection
from ikjax.solvers.pipeline import TURNING

PRIORITIES = ("weighted", "position", "orientation")


EASE = {"float32": 10.0, "float64": 100.0}
"""By how much it is worth less from stage to stage."""

STAGES = 3


def checked(arm: Arm, priority: str) -> str:
    """The priority, where the arm's task has two terms at all."""
    if priority not in PRIORITIES:
        raise ValueError(f"priority must be one of {', '.join(PRIORITIES)}, got {priority!r}")
    return priority if arm.task in TURNING else "weighted"


def wish(arm: Arm, goal: Pose, length: Scalar, priority: str, share: Scalar | None = None) -> Wish:
    """What the steps go down on; `share` is the last one unless given."""
    if priority == "weighted":
        return Wish(goal, length)
    dtype = goal.position[0].dtype
    share = jnp.asarray(LAST_WEIGHT[dtype.name] if share is None else share, dtype)
    floor, size = CURVATURE_FLOOR * jnp.where(share > 0, share, 1), reach(arm)
    if priority == "position":
        return Wish(goal, size * jnp.sqrt(share), 1.0, floor)
    return Wish(goal, size, share, floor)


def in_order(near, priority: str):
    """The first error and the second of what has `gap` and `angle`."""
    return (near.gap, near.angle) if priority == "position" else (near.angle, near.gap)


def descend(
    arm: Arm, goal: Pose, length: Scalar, priority: str, q, steps, damping
) -> tuple[State, Scalar, Joints]:
    """So many steps, or as many in each stage: where they end, how steep it is, and the last sum's bottom."""
    if priority == "weighted":
        state = newton.descend(arm, wish(arm, goal, length, priority), q, steps, damping)
        return state, newton.steepness(arm, state.q, state.at), state.q
    return _staged(arm, lambda share: wish(arm, goal, length, priority, share), priority, q, steps)


def _staged(
    arm: Arm, wish_of: Callable[[Scalar], Wish], priority: str, q, steps
) -> tuple[State, Scalar, Joints]:
    dtype, zero = q[0].dtype, jnp.zeros_like(q[0])
    last, ease = (jnp.asarray(x[dtype.name], dtype) for x in (LAST_WEIGHT, EASE))
    allowed = CONVERGED[dtype.name]

    def stage(k, carried):
        before, q, at, flat = carried
        # The round after the last stage goes on from where the line leads, on the first error alone.
        extra, settled = k == STAGES, flat <= allowed
        share = last * ease ** (STAGES - 1 - k).astype(dtype)
        ahead = tuple(
            jnp.clip(x + (x - y) / (ease - 1), low, high)
            for x, y, (low, high) in zip(q, before, newton.bounds(arm), strict=True)
        )
        # Joints at a limit stay there: the first error alone would rather have them off it.
        still = tuple(extra & back for back in newton.held_back(arm, q, at.slope))
        start = tuple(
            jnp.where(extra & settled & ~held, x, y) for x, y, held in zip(ahead, q, still, strict=True)
        )
        damping = zero + newton.FIRST_DAMPING * share
        asked = wish_of(jnp.where(extra, 0, share))._replace(still=still)
        state = newton.descend(arm, asked, start, steps, damping)
        steep = newton.steepness(arm, state.q, state.at) / jnp.sqrt(share)
        nearer = in_order(state.at, priority)[0] <= in_order(at, priority)[0]
        take = ~extra | nearer
        now = jax.tree.map(lambda new, old: jnp.where(take, new, old), (state.q, state.at), (q, at))
        return q, *now, jnp.where(extra, flat, steep)

    carried = (zero,) * arm.n, q, newton.nowhere(arm, zero), zero
    bottom, q, at, flat = jax.lax.fori_loop(0, STAGES + 1, stage, carried)
    return State(q, at, zero + newton.FIRST_DAMPING), flat, bottom


def best(arm: Arm, branches: Projection, priority: str) -> jax.Array:
    """The first start (...) that has least, but for rounding, of what (..., S) have."""
    name = branches.q.dtype.name
    rounding = 16 * float(jnp.finfo(name).eps)
    if priority == "weighted":
        return jnp.argmax(_least(branches.cost, SAME_COST[name], (rounding * reach(arm)) ** 2), axis=-1)
    first, second, size, other = branches.rotation_error, branches.position_error, 1, reach(arm)
    if priority == "position":
        first, second, size, other = second, first, other, size
    candidates = jnp.where(_least(first, 0, SAME_ERROR[name] * size), second, jnp.inf)
    return jnp.argmax(_least(candidates, SAME_COST[name], rounding * other), axis=-1)


def _least(values: jax.Array, share: float, slack: Scalar) -> jax.Array:
    """Which values (..., S) are the least, to a share of it and some more."""
    values = jnp.where(jnp.isfinite(values), values, jnp.inf)
    return values <= (1 + share) * jnp.min(values, axis=-1, keepdims=True) + slack
