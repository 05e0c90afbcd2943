"""Downhill to the nearest attainable pose: the cost of a pose, and damped Newton steps within limits.

In scalars, for one start of one goal; every scalar may be an array of any batch shape.

With lengths in reaches, d the way from the goal's point to the tool's, and w the vector of the turn that is
left (its length is the angle), the cost is |d|^2 + length^2 |w|^2. A joint moves the tool with the twist
(v, u); half the cost has the slope v.d + length^2 u.w, exactly, because a turn about w's own axis is what
changes |w|. For joints i before j half its second derivative is, exactly,

    v_j.(v_i + d x u_i) + length^2 u_j.(W u_i + w x u_i),

W being the inverse left Jacobian of the rotation's vector: a joint moves the twists of the joints after it,
and not of those before. At a residual that stays, Newton's steps converge where Gauss and Newton's crawl.

Source: Jacobian of the logarithm after Sola et al., A micro Lie theory (2018), (146); active bounds after
Bertsekas, Projected Newton methods (1982); damping after Marquardt (1963).
"""

import functools
import math
from typing import NamedTuple

import jax
import jax.numpy as jnp

from ikjax.arm.arm import Arm, numbers
from ikjax.arm.forward import Chain, chain, fixed_pose, reach, whole_turns
from ikjax.arm.twists import Twist, joint_twists, task_plane
from ikjax.core import pose as poses
from ikjax.core import safe, vector
from ikjax.core.linear import dot, solve_symmetric
from ikjax.core.pose import Pose
from ikjax.core.tolerances import CONVERGED, CURVATURE_FLOOR, NEARLY_FLAT, SADDLE_PUSH
from ikjax.core.trig import Scalar
from ikjax.core.vector import plus, times
from ikjax.core.xla import divider_once, pin, pinning
from ikjax.ik.turns import nearest_turn
from ikjax.solvers.pipeline import TURNING

LARGEST_STEP = 1.0
"""Of any joint [rad, or reaches]."""


FIRST_DAMPING, EASED = 1e-2, 10.0
"""As a share of the curvature; divided by `EASED` after a step that led down, multiplied after others."""


Joints = tuple[Scalar, ...]


class Wish(NamedTuple):
    """What is asked for, in scalars."""

    goal: Pose
    """T_world_tool [m]."""
    length: Scalar
    """What a radian is worth [m]; zero where the task asks for no orientation."""
    point: Scalar = 1.0
    """What the square of the distance is worth."""
    floor: Scalar = CURVATURE_FLOOR
    """The least curvature that a step believes in."""
    still: tuple[jax.Array, ...] | None = None
    """Joints that do not move."""


class Standing(NamedTuple):
    """How things stand at some joints; lengths in reaches, sliding joints too."""

    cost: Scalar
    slope: tuple[Scalar, ...]
    """Of half the cost, for each joint."""
    curve: tuple[tuple[Scalar, ...], ...]
    """Second derivatives of half the cost, the lower triangle."""
    gap: Scalar
    """Distance of the points."""
    angle: Scalar
    """[rad]"""
    lever: Scalar
    """Square of the distance that the tool moves with the joint that moves it most [rad^-2]."""


class State(NamedTuple):
    """Between two steps."""

    q: Joints
    at: Standing
    damping: Scalar


def standing(arm: Arm, wish: Wish, q: Joints) -> Standing:
    """Cost, slope and curvature at joints q."""
    per = 1 / reach(arm)
    found = chain(arm, q)
    tool = poses.compose(found.last, fixed_pose(arm.tool))
    tool = jax.tree.map(pin, tool)
    gap = tuple(map(pin, _gap(arm, found, wish, tool, per)))
    worth = _worth(arm, wish, per)
    turn = _turn(wish, tool)
    twists = [
        Twist(tuple(pin(times(per, x)) for x in twist.linear), twist.angular)
        for twist in joint_twists(arm, found, tool.position)
    ]
    pulled = tuple(pin(times(wish.point, x)) for x in gap)
    drawn = tuple(pin(times(worth, x)) for x in turn.vector)
    slope = [plus(vector.dot(t.linear, pulled), vector.dot(t.angular, drawn)) for t in twists]
    curve = []
    for i, mine in enumerate(twists):
        pulls = vector.add(mine.linear, vector.cross(gap, mine.angular))
        turns = vector.add(turn.rate(mine.angular), vector.cross(turn.vector, mine.angular))
        pulls, turns = (
            tuple(pin(times(weight, x)) for x in way) for weight, way in ((wish.point, pulls), (worth, turns))
        )
        rest = twists[i:]
        curve.append([plus(vector.dot(t.linear, pulls), vector.dot(t.angular, turns)) for t in rest])
    lower = [[curve[j][i - j] for j in range(i + 1)] for i in range(arm.n)]
    slope, lower = _of_motors(arm, slope, lower)
    far, turned = pin(vector.dot(gap, gap)), pin(vector.dot(turn.vector, turn.vector))
    levers = [
        1.0 if kind == "P" else vector.dot(twist.linear, twist.linear)
        for kind, twist in zip(arm.kinds, twists, strict=True)
    ]
    return Standing(
        pin(times(wish.point, far) + worth * turned),
        tuple(map(pin, slope)),
        tuple(tuple(map(pin, row)) for row in lower),
        pin(safe.sqrt(far)),
        pin(_angle(arm, turned)),
        pin(functools.reduce(jnp.maximum, levers, jnp.zeros_like(far))),
    )


def _angle(arm: Arm, squared: Scalar) -> Scalar:
    return safe.sqrt(squared) if arm.task in TURNING else jnp.zeros_like(squared)


def errors(arm: Arm, wish: Wish, q: Joints) -> tuple[Scalar, Scalar, Scalar]:
    """Cost [m^2], distance [m] and angle [rad] at joints q, for their slopes."""
    found = chain(arm, q)
    tool = jax.tree.map(pin, poses.compose(found.last, fixed_pose(arm.tool)))
    gap, turn = _gap(arm, found, wish, tool, 1.0), _turn(wish, tool)
    far, turned = vector.dot(gap, gap), vector.dot(turn.vector, turn.vector)
    return far + _worth(arm, wish, 1.0) * turned, safe.sqrt(far), _angle(arm, turned)


def _worth(arm: Arm, wish: Wish, per: Scalar) -> Scalar:
    """The square of what a radian is worth."""
    length = wish.length * per
    return length * length if arm.task in TURNING else 0.0 * length


def _gap(arm: Arm, found: Chain, wish: Wish, tool: Pose, per: Scalar) -> vector.Vector:
    """From the goal's point to the tool's; an arm that moves in a plane is asked for what lies in it."""
    gap = vector.scale(per, vector.subtract(tool.position, wish.goal.position))
    if not arm.task.startswith("planar"):
        return gap
    up = task_plane(arm, found)[2]
    return vector.subtract(gap, vector.scale(vector.dot(up, gap), up))


def _turn(wish: Wish, tool: Pose) -> poses.RotationVector:
    """The turn from the goal to the tool, in the world."""
    left = vector.matmul(tool.rotation, vector.transpose(wish.goal.rotation))
    return poses.rotation_vector(jax.tree.map(pin, left))


def _of_motors(arm: Arm, slope: list, curve: list[list]) -> tuple[list, list[list]]:
    """From joints to motors, sliding ones in reaches."""
    size, n = reach(arm), arm.n
    if arm.coupling is not None:
        # A column of the coupling says how far each joint moves.
        ways = [numbers(arm.coupling[:, i]) for i in range(n)]
        whole = [[curve[max(i, j)][min(i, j)] for j in range(n)] for i in range(n)]
        slope = [dot(way, slope) for way in ways]
        pulls = [[dot(row, way) for row in whole] for way in ways]
        curve = [[dot(ways[i], pulls[j]) for j in range(i + 1)] for i in range(n)]
    units = [size if kind == "P" else 1 for kind in arm.kinds]
    slope = [times(unit, x) for unit, x in zip(units, slope, strict=True)]
    curve = [[times(times(units[i], units[j]), x) for j, x in enumerate(row)] for i, row in enumerate(curve)]
    return slope, curve


def bounds(arm: Arm) -> list[tuple[Scalar, Scalar]]:
    """Lower and upper limit of each joint."""
    return [numbers(arm.limits[i]) for i in range(arm.n)]


def held_back(arm: Arm, q: Joints, slope: tuple[Scalar, ...]) -> list[jax.Array]:
    """Which joints stand at a limit beyond which they would go down."""
    return [
        ((x <= low) & (s > 0)) | ((x >= high) & (s < 0))
        for x, s, (low, high) in zip(q, slope, bounds(arm), strict=True)
    ]


def steepness(arm: Arm, q: Joints, at: Standing) -> Scalar:
    """Length of the slope of half the cost along the joints that are free to go.

    In reaches and radians, as a share of the residual where that is more than a reach: the goal's rounding
    is then what limits it.
    """
    free = [jnp.where(back, 0, s) for back, s in zip(held_back(arm, q, at.slope), at.slope, strict=True)]
    return safe.norm(*free) / jnp.maximum(1, safe.sqrt(at.cost))


def is_seen(arm: Arm, goal: Pose, at: Standing, length: Scalar) -> jax.Array:
    """Whether `CONVERGED` says anything about the pose, and not about rounding.

    Positions are rounded to eps of the largest number on their way, which is one of the table, the base or
    the goal: a slope of that times a reach must be below `CONVERGED`, as a share of the residual where that
    is taken. And the slope is the residual times what the joints move the tool by: where that is next to
    nothing in reaches, as between axes that kilometres in the table compensate, every slope is below it.
    """
    name, per = at.cost.dtype.name, 1 / reach(arm)
    away = vector.norm(vector.scale(per, fixed_pose(arm.base).position))
    rounding = float(jnp.finfo(name).eps) * (1 + away + per * vector.norm(goal.position))
    exact = rounding <= CONVERGED[name] * jnp.maximum(1, safe.sqrt(at.cost))
    return exact & (at.lever + _worth(arm, Wish(goal, length), per) > CONVERGED[name])


def descend(arm: Arm, wish: Wish, q: Joints, steps, damping: Scalar | None = None) -> State:
    """So many steps from joints within the limits; `damping` goes on from an earlier descent.

    The first round of the loop only looks where the start stands: written down outside, it would make the
    program twice as long. Where it is known that there is no step there is no loop, and nobody reads the
    curvature.
    """
    zero = jnp.zeros_like(q[0])
    damping = zero + FIRST_DAMPING if damping is None else damping
    if isinstance(steps, int) and steps == 0:
        with pinning(divider_once(q[0])):
            return State(q, standing(arm, wish, q), damping)
    state = State(q, nowhere(arm, zero), damping * EASED)

    def again(_, state: State) -> State:
        with pinning(divider_once(state.q[0])):
            return step(arm, wish, state)

    return jax.lax.fori_loop(0, steps + 1, again, state)


def nowhere(arm: Arm, zero: Scalar) -> Standing:
    """Worse than anywhere."""
    curve = tuple((zero,) * i + (zero + 1,) for i in range(arm.n))
    return Standing(zero + jnp.inf, (zero,) * arm.n, curve, zero, zero, zero)


def step(arm: Arm, wish: Wish, state: State) -> State:
    """One damped Newton step, taken only if it leads down."""
    q, at, damping = state
    noise, zero = float(jnp.finfo(at.cost.dtype).eps), jnp.zeros_like(at.cost)
    back = held_back(arm, q, at.slope)
    if wish.still is not None:
        back = [b | held for b, held in zip(back, wish.still, strict=True)]
    free = [pin(jnp.where(b, zero, zero + 1)) for b in back]
    floor = jnp.asarray(wish.floor, at.cost.dtype)
    down = [pin(-f * s) for f, s in zip(free, at.slope, strict=True)]
    # On a saddle, where many an arm is at home, the slope leads nowhere, and damping would hide the way down.
    flat = pin(jnp.where(_square(down) < NEARLY_FLAT**2, zero + 1, zero))
    push, damped = SADDLE_PUSH * flat, damping * (1 - 0.99 * flat)
    matrix = [
        [pin(free[i] * free[j] * at.curve[i][j]) for j in range(i)]
        + [pin(free[i] * (at.curve[i][i] + damped * (abs(at.curve[i][i]) + 1e-2)) + (1 - free[i]))]
        for i in range(arm.n)
    ]
    moves = solve_symmetric(matrix, down, floor, push)
    largest = functools.reduce(jnp.maximum, map(abs, moves))
    shrink = pin(LARGEST_STEP / jnp.maximum(largest, LARGEST_STEP))
    size = reach(arm)
    units = [size if kind == "P" else 1.0 for kind in arm.kinds]
    tried = tuple(
        pin(jnp.clip(x + unit * shrink * move, low, high))
        for x, unit, move, (low, high) in zip(q, units, moves, bounds(arm), strict=True)
    )
    there = standing(arm, wish, tried)
    flatter = _square(there.slope) < _square(at.slope) / 4
    # Near the bottom two costs differ by their rounding alone: there the slope decides.
    better = (there.cost < at.cost) | (flatter & (there.cost <= at.cost * (1 + 8 * noise)))
    better = pin(jnp.where(better, 1.0, 0.0).astype(at.cost.dtype)) > 0.5
    q, at = jax.tree.map(lambda new, old: jnp.where(better, new, old), (tried, there), (q, at))
    return State(q, at, jnp.where(better, damping / EASED, jnp.maximum(EASED * damping, 1e-3)))


def _square(slope) -> Scalar:
    return sum(s * s for s in slope)


def into_limits(arm: Arm, q: Joints, near: Joints | None = None) -> Joints:
    """The joints moved into the limits: by whole turns where that will do, else to the nearer limit.

    The turns are as few as will do, or those that end nearest to a place.
    """
    places = (None,) * arm.n if near is None else near
    return tuple(
        _within(x, low, high, whole, place)
        for x, whole, (low, high), place in zip(q, whole_turns(arm), bounds(arm), places, strict=True)
    )


def _within(x: Scalar, low: Scalar, high: Scalar, whole: bool | jax.Array, near: Scalar | None) -> Scalar:
    if whole is False:
        return jnp.clip(x, low, high)
    low, high = (jnp.asarray(limit, x.dtype) for limit in (low, high))
    middle = jnp.where(jnp.isfinite(low), low + math.pi, jnp.where(jnp.isfinite(high), high - math.pi, 0))
    middle = jnp.where(jnp.isfinite(low) & jnp.isfinite(high), low / 2 + high / 2, middle)
    x = jnp.where(jnp.isfinite(x), x, middle)
    turned, inside = nearest_turn(x, low, high, whole, near)
    # Outside, turns bring a joint as near to the middle as they can: the end that it passes is the nearer.
    closest, _ = nearest_turn(x, -math.inf, math.inf, whole, middle)
    return jnp.clip(jnp.where(inside, turned, closest), low, high)
