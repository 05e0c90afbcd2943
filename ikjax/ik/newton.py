"""Projected Newton descent to the nearest attainable pose: the cost, its derivatives, and the steps.

In scalars, for one start of one goal; every scalar may be an array of any batch shape.

Lengths are divided by the arm's reach. Let d be the vector from the goal's point to the tool point, and w the
rotation vector from the goal's orientation to the tool's (its length is the angle). The cost is
|d|^2 + length^2 |w|^2, where length is the characteristic length. A joint moves the tool with the twist
(v, u). The gradient of half the cost is exactly v.d + length^2 u.w, because only a rotation about w itself
changes |w|. For joints i before j, the Hessian of half the cost is exactly

    v_j.(v_i + d x u_i) + length^2 u_j.(W u_i + w x u_i),

where W is the inverse left Jacobian of the rotation vector: a joint moves the twists of the joints after it,
and not of those before. Where a residual remains at the minimum, Newton's method converges fast and
Gauss-Newton slowly.

The steps, in the order of `newton_step`:

1. Joints at a limit that the descent would leave are fixed (the active bounds of projected Newton).
2. The Hessian gets Levenberg-Marquardt damping on its diagonal.
3. Where the gradient is nearly zero, the step follows directions of negative curvature: it may be a saddle.
4. The step is shortened, clipped to the limits, and taken only if it decreases the cost.

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


FIRST_DAMPING, DAMPING_FACTOR = 1e-2, 10.0
"""Damping is a share of the curvature. It is divided by the factor after a step that decreased the cost, and
multiplied by it after any other."""


Joints = tuple[Scalar, ...]


class Objective(NamedTuple):
    """What is minimized, in scalars."""

    goal: Pose
    """T_world_tool [m]."""
    characteristic_length: Scalar
    """Length that counts as much as one radian [m]; zero where the task asks for no orientation."""
    position_weight: Scalar = 1.0
    """Weight of the squared distance."""
    curvature_floor: Scalar = CURVATURE_FLOOR
    """The least curvature that a step divides by."""
    fixed: tuple[jax.Array, ...] | None = None
    """Per joint, whether it must not move; by default none is fixed."""


class Evaluation(NamedTuple):
    """The cost and its derivatives at some joints; lengths in reaches, also those of sliding joints."""

    cost: Scalar
    gradient: tuple[Scalar, ...]
    """Of half the cost, for each joint."""
    hessian: tuple[tuple[Scalar, ...], ...]
    """Of half the cost, the lower triangle."""
    distance: Scalar
    """From the goal's point to the tool point."""
    angle: Scalar
    """Between the two orientations [rad]."""
    lever_squared: Scalar
    """Square of the tool's speed for the joint that moves it fastest [rad^-2]."""


class State(NamedTuple):
    """What one step hands to the next."""

    q: Joints
    evaluation: Evaluation
    damping: Scalar


def descend(arm: Arm, objective: Objective, q: Joints, steps, damping: Scalar | None = None) -> State:
    """Take a number of Newton steps from joints within the limits.

    Args:
        arm: The arm.
        objective: What is minimized.
        q: Where the descent starts, within the limits.
        steps: How many steps; may be traced.
        damping: The damping at which an earlier descent ended; `FIRST_DAMPING` by default.

    Returns:
        The state after the last step.
    """
    zero = jnp.zeros_like(q[0])
    damping = zero + FIRST_DAMPING if damping is None else damping
    # Without steps there is no loop, and nobody reads the Hessian.
    if isinstance(steps, int) and steps == 0:
        with pinning(divider_once(q[0])):
            return State(q, evaluate(arm, objective, q), damping)
    # The first iteration only evaluates the start: it begins at an infinite cost, with a zero gradient.
    # An evaluation outside the loop would make the program twice as long.
    state = State(q, worst_evaluation(arm, zero), damping * DAMPING_FACTOR)

    def iteration(_, state: State) -> State:
        with pinning(divider_once(state.q[0])):
            return newton_step(arm, objective, state)

    return jax.lax.fori_loop(0, steps + 1, iteration, state)


def worst_evaluation(arm: Arm, zero: Scalar) -> Evaluation:
    """An infinite cost, so that any step is better; zero gradient and unit Hessian, so that none is made."""
    hessian = tuple((zero,) * i + (zero + 1,) for i in range(arm.n))
    return Evaluation(zero + jnp.inf, (zero,) * arm.n, hessian, zero, zero, zero)


def newton_step(arm: Arm, objective: Objective, state: State) -> State:
    """One damped projected Newton step, taken only if it decreases the cost."""
    q, here, damping = state
    eps, zero = float(jnp.finfo(here.cost.dtype).eps), jnp.zeros_like(here.cost)
    fixed = active_bounds(arm, q, here.gradient)
    if objective.fixed is not None:
        fixed = [bound | other for bound, other in zip(fixed, objective.fixed, strict=True)]
    free = [pin(jnp.where(f, zero, zero + 1)) for f in fixed]
    floor = jnp.asarray(objective.curvature_floor, here.cost.dtype)
    descent = [pin(-f * g) for f, g in zip(free, here.gradient, strict=True)]
    # Many an arm's home configuration is a saddle. There the gradient points nowhere, and damping would hide
    # the direction of negative curvature: it is reduced to a hundredth.
    flat = pin(jnp.where(_squared_norm(descent) < NEARLY_FLAT**2, zero + 1, zero))
    push, damped = SADDLE_PUSH * flat, damping * (1 - 0.99 * flat)
    # Rows and columns of fixed joints become those of the identity.
    matrix = [
        [pin(free[i] * free[j] * here.hessian[i][j]) for j in range(i)]
        + [pin(free[i] * (here.hessian[i][i] + damped * (abs(here.hessian[i][i]) + 1e-2)) + (1 - free[i]))]
        for i in range(arm.n)
    ]
    moves = solve_symmetric(matrix, descent, floor, push)
    largest = functools.reduce(jnp.maximum, map(abs, moves))
    shrink = pin(LARGEST_STEP / jnp.maximum(largest, LARGEST_STEP))
    size = reach(arm)
    units = [size if kind == "P" else 1.0 for kind in arm.kinds]
    trial = tuple(
        pin(jnp.clip(x + unit * shrink * move, low, high))
        for x, unit, move, (low, high) in zip(q, units, moves, bounds(arm), strict=True)
    )
    there = evaluate(arm, objective, trial)
    # Near the minimum two costs differ by their rounding alone: there the gradient decides.
    flatter = _squared_norm(there.gradient) < _squared_norm(here.gradient) / 4
    better = (there.cost < here.cost) | (flatter & (there.cost <= here.cost * (1 + 8 * eps)))
    better = pin(jnp.where(better, 1.0, 0.0).astype(here.cost.dtype)) > 0.5
    q, here = jax.tree.map(lambda new, old: jnp.where(better, new, old), (trial, there), (q, here))
    eased, stiffened = damping / DAMPING_FACTOR, jnp.maximum(DAMPING_FACTOR * damping, 1e-3)
    return State(q, here, jnp.where(better, eased, stiffened))


def _squared_norm(entries) -> Scalar:
    return sum(x * x for x in entries)


def evaluate(arm: Arm, objective: Objective, q: Joints) -> Evaluation:
    """Cost, gradient and Hessian at joints q."""
    per_reach = 1 / reach(arm)
    kinematics = chain(arm, q)
    tool = poses.compose(kinematics.last, fixed_pose(arm.tool))
    tool = jax.tree.map(pin, tool)
    offset = tuple(map(pin, _offset(arm, kinematics, objective, tool, per_reach)))
    position_weight, angle_weight = objective.position_weight, _angle_weight(arm, objective, per_reach)
    rotation = _rotation_from_goal(objective, tool)
    twists = [
        Twist(tuple(pin(times(per_reach, x)) for x in twist.linear), twist.angular)
        for twist in joint_twists(arm, kinematics, tool.position)
    ]
    # The gradient is J^T (force, torque).
    force = tuple(pin(times(position_weight, x)) for x in offset)
    torque = tuple(pin(times(angle_weight, x)) for x in rotation.vector)
    gradient = [plus(vector.dot(t.linear, force), vector.dot(t.angular, torque)) for t in twists]
    columns = []
    for i, twist in enumerate(twists):
        linear = vector.add(twist.linear, vector.cross(offset, twist.angular))
        angular = vector.add(rotation.rate(twist.angular), vector.cross(rotation.vector, twist.angular))
        linear = tuple(pin(times(position_weight, x)) for x in linear)
        angular = tuple(pin(times(angle_weight, x)) for x in angular)
        columns.append(
            [plus(vector.dot(t.linear, linear), vector.dot(t.angular, angular)) for t in twists[i:]]
        )
    hessian = [[columns[j][i - j] for j in range(i + 1)] for i in range(arm.n)]
    gradient, hessian = _to_motors(arm, gradient, hessian)
    distance_squared = pin(vector.dot(offset, offset))
    angle_squared = pin(vector.dot(rotation.vector, rotation.vector))
    levers = [
        1.0 if kind == "P" else vector.dot(twist.linear, twist.linear)
        for kind, twist in zip(arm.kinds, twists, strict=True)
    ]
    return Evaluation(
        pin(times(position_weight, distance_squared) + angle_weight * angle_squared),
        tuple(map(pin, gradient)),
        tuple(tuple(map(pin, row)) for row in hessian),
        pin(safe.sqrt(distance_squared)),
        pin(_angle(arm, angle_squared)),
        pin(functools.reduce(jnp.maximum, levers, jnp.zeros_like(distance_squared))),
    )


def pose_errors(arm: Arm, objective: Objective, q: Joints) -> tuple[Scalar, Scalar, Scalar]:
    """Cost [m^2], distance [m] and angle [rad] at joints q, written so that they can be differentiated."""
    kinematics = chain(arm, q)
    tool = jax.tree.map(pin, poses.compose(kinematics.last, fixed_pose(arm.tool)))
    offset, rotation = _offset(arm, kinematics, objective, tool, 1.0), _rotation_from_goal(objective, tool)
    distance_squared = vector.dot(offset, offset)
    angle_squared = vector.dot(rotation.vector, rotation.vector)
    cost = distance_squared + _angle_weight(arm, objective, 1.0) * angle_squared
    return cost, safe.sqrt(distance_squared), _angle(arm, angle_squared)


def _angle(arm: Arm, squared: Scalar) -> Scalar:
    """The angle from its square; zero where the task asks for no orientation."""
    return safe.sqrt(squared) if arm.task in TURNING else jnp.zeros_like(squared)


def _angle_weight(arm: Arm, objective: Objective, per_reach: Scalar) -> Scalar:
    """Weight of the squared angle: the square of the characteristic length."""
    length = objective.characteristic_length * per_reach
    return length * length if arm.task in TURNING else 0.0 * length


def _offset(
    arm: Arm, kinematics: Chain, objective: Objective, tool: Pose, per_reach: Scalar
) -> vector.Vector:
    """From the goal's point to the tool point; for a planar arm, its component in the arm's plane."""
    offset = vector.scale(per_reach, vector.subtract(tool.position, objective.goal.position))
    if not arm.task.startswith("planar"):
        return offset
    normal = task_plane(arm, kinematics)[2]
    return vector.subtract(offset, vector.scale(vector.dot(normal, offset), normal))


def _rotation_from_goal(objective: Objective, tool: Pose) -> poses.RotationVector:
    """The rotation from the goal's orientation to the tool's, in the world frame."""
    matrix = vector.matmul(tool.rotation, vector.transpose(objective.goal.rotation))
    return poses.rotation_vector(jax.tree.map(pin, matrix))


def _to_motors(arm: Arm, gradient: list, hessian: list[list]) -> tuple[list, list[list]]:
    """Derivatives by joint values to derivatives by motor values (entries of q), sliding ones in reaches."""
    size, n = reach(arm), arm.n
    if arm.coupling is not None:
        # Column i of the coupling says how far each joint moves with motor i.
        motors = [numbers(arm.coupling[:, i]) for i in range(n)]
        full = [[hessian[max(i, j)][min(i, j)] for j in range(n)] for i in range(n)]
        gradient = [dot(motor, gradient) for motor in motors]
        products = [[dot(row, motor) for row in full] for motor in motors]
        hessian = [[dot(motors[i], products[j]) for j in range(i + 1)] for i in range(n)]
    units = [size if kind == "P" else 1 for kind in arm.kinds]
    gradient = [times(unit, x) for unit, x in zip(units, gradient, strict=True)]
    hessian = [
        [times(times(units[i], units[j]), x) for j, x in enumerate(row)] for i, row in enumerate(hessian)
    ]
    return gradient, hessian


def bounds(arm: Arm) -> list[tuple[Scalar, Scalar]]:
    """Lower and upper limit of each joint."""
    return [numbers(arm.limits[i]) for i in range(arm.n)]


def active_bounds(arm: Arm, q: Joints, gradient: tuple[Scalar, ...]) -> list[jax.Array]:
    """Which joints stand at a limit that the descent would leave."""
    return [
        ((x <= low) & (g > 0)) | ((x >= high) & (g < 0))
        for x, g, (low, high) in zip(q, gradient, bounds(arm), strict=True)
    ]


def projected_gradient_norm(arm: Arm, q: Joints, here: Evaluation) -> Scalar:
    """Norm of the gradient of half the cost over the joints that no active bound holds.

    In reaches and radians. A residual of more than one reach divides it: the rounding of the goal is then
    what limits it.
    """
    active = active_bounds(arm, q, here.gradient)
    free = [jnp.where(bound, 0, g) for bound, g in zip(active, here.gradient, strict=True)]
    return safe.norm(*free) / jnp.maximum(1, safe.sqrt(here.cost))


def is_above_rounding(arm: Arm, goal: Pose, here: Evaluation, characteristic_length: Scalar) -> jax.Array:
    """Whether a gradient norm below `CONVERGED` says something about the pose, and not only about rounding.

    Two conditions must hold:

    - Positions are rounded to eps of the largest number that they are made of, which is one of the table, the
      base or the goal. The gradient that this rounding makes must be below `CONVERGED` (times the residual
      where that is more than one reach).
    - The gradient is the residual times what the joints move the tool by. Where that is next to nothing in
      reaches, as between axes that kilometres in the table compensate, every gradient is below `CONVERGED`.
    """
    name, per_reach = here.cost.dtype.name, 1 / reach(arm)
    away = vector.norm(vector.scale(per_reach, fixed_pose(arm.base).position))
    rounding = float(jnp.finfo(name).eps) * (1 + away + per_reach * vector.norm(goal.position))
    exact = rounding <= CONVERGED[name] * jnp.maximum(1, safe.sqrt(here.cost))
    angle_weight = _angle_weight(arm, Objective(goal, characteristic_length), per_reach)
    return exact & (here.lever_squared + angle_weight > CONVERGED[name])


def into_limits(arm: Arm, q: Joints, near: Joints | None = None) -> Joints:
    """The joints moved into the limits: by whole turns where that suffices, else to the nearer limit.

    Args:
        arm: The arm.
        q: Joint values.
        near: Joint values that the result shall be nearest to, among those that differ by whole turns. By
            default as few turns as suffice are taken.
    """
    places = (None,) * arm.n if near is None else near
    return tuple(
        _within(x, low, high, whole, place)
        for x, whole, (low, high), place in zip(q, whole_turns(arm), bounds(arm), places, strict=True)
    )


def _within(x: Scalar, low: Scalar, high: Scalar, whole: bool | jax.Array, near: Scalar | None) -> Scalar:
    """`into_limits` of one joint; `whole` says whether a whole turn of it leaves the pose."""
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
