"""Projected Newton descent to the nearest attainable pose: the cost, its derivatives, and the steps.

For one start of one goal; every number may be an array of any batch shape. What there is of each joint is one
array with the joints as its first axis: a program of one scalar for each joint, and for each pair of joints,
is longer and compiles longer.

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
from typing import NamedTuple, TypeVar

import jax
import jax.numpy as jnp
import numpy as np

from ikjax.arm.arm import Arm, array_of
from ikjax.arm.forward import Chain, chain, fixed_pose, reach, whole_turns
from ikjax.arm.twists import stacked_twists, task_plane
from ikjax.core import pose as poses
from ikjax.core import safe, vector
from ikjax.core.linear import solve_symmetric
from ikjax.core.pose import Pose
from ikjax.core.tolerances import CONVERGED, CURVATURE_FLOOR, NEARLY_FLAT, SADDLE_PUSH
from ikjax.core.trig import Scalar
from ikjax.core.vector import plus, times
from ikjax.core.xla import divider_once, pin, pin_all, pinning
from ikjax.ik.turns import nearest_turn
from ikjax.solvers.pipeline import TURNING

LARGEST_STEP = 1.0
"""Of any joint [rad, or reaches]."""


FIRST_DAMPING, DAMPING_FACTOR = 1e-2, 10.0
"""Damping is a share of the curvature. It is divided by the factor after a step that decreased the cost, and
multiplied by it after any other."""


Tree = TypeVar("Tree")

Joints = tuple[Scalar, ...]
"""A value for each joint, all of one shape."""


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
    enough: Scalar | None = None
    """The gradient norm of a descent that has converged; `CONVERGED` by default."""
    fixed: jax.Array | None = None
    """Joints that must not move, (n, ...); by default none is fixed."""


class Evaluation(NamedTuple):
    """The cost and its derivatives at some joints; lengths in reaches, also those of sliding joints."""

    cost: Scalar
    gradient: jax.Array
    """Of half the cost, (n, ...)."""
    hessian: jax.Array
    """Of half the cost, (n, n, ...); only the lower triangle means something."""
    distance: Scalar
    """From the goal's point to the tool point."""
    angle: Scalar
    """Between the two orientations [rad]."""
    lever_squared: Scalar
    """Square of the tool's speed for the joint that moves it fastest [rad^-2]."""


class State(NamedTuple):
    """What one step hands to the next."""

    q: jax.Array
    """(n, ...)"""
    evaluation: Evaluation
    damping: Scalar


def descend(arm: Arm, objective: Objective, q: jax.Array, steps, damping: Scalar | None = None) -> State:
    """Take Newton steps from joints within the limits.

    A start that has converged ends with the first step that does not improve it. So its end does not depend
    on what else is in the batch, and the loop ends with the last of them.

    Args:
        arm: The arm.
        objective: What is minimized.
        q: Where the descent starts, within the limits, (n, ...).
        steps: How many steps, at most; may be traced.
        damping: The damping at which an earlier descent ended; `FIRST_DAMPING` by default.

    Returns:
        The state after the last step.
    """
    zero = jnp.zeros_like(q[0])
    damping = zero + FIRST_DAMPING if damping is None else damping
    # Without steps there is no loop, and nobody reads the Hessian.
    if isinstance(steps, int) and steps == 0:
        with pinning(divider_once(q[:1])):
            return State(q, evaluate(arm, objective, q), damping)
    # The first iteration only evaluates the start: it begins at an infinite cost, with a zero gradient.
    # An evaluation outside the loop would make the program twice as long.
    state = State(q, worst_evaluation(arm, zero), damping * DAMPING_FACTOR)
    enough = CONVERGED[zero.dtype.name] if objective.enough is None else objective.enough
    none = jnp.zeros(zero.shape, bool)

    def goes_on(carried) -> jax.Array:
        count, _, ended = carried
        return (count <= steps) & ~jnp.all(ended)

    def iteration(carried):
        count, state, ended = carried
        with pinning(divider_once(state.q[:1])):
            moved = choose(ended, state, newton_step(arm, objective, state))
        refused = moved.damping > state.damping
        small = projected_gradient_norm(arm, moved.q, moved.evaluation) <= enough
        return count + 1, moved, ended | (refused & small)

    return jax.lax.while_loop(goes_on, iteration, (0, state, none))[1]


def worst_evaluation(arm: Arm, zero: Scalar) -> Evaluation:
    """An infinite cost, so that any step is better; zero gradient and unit Hessian, so that none is made."""
    none = jnp.zeros((arm.n, *zero.shape), zero.dtype)
    hessian = jnp.broadcast_to(_identity(arm, none), (arm.n, *none.shape))
    return Evaluation(zero + jnp.inf, none, hessian, zero, zero, zero)


def _of_joints(x: np.ndarray | jax.Array, like: jax.Array) -> jax.Array:
    """Numbers of the joints, (n,) or (n, n), with an axis more for each batch axis of `like` (n, ...)."""
    return jnp.asarray(x).reshape(jnp.shape(x) + (1,) * (like.ndim - 1))


def _identity(arm: Arm, like: jax.Array) -> jax.Array:
    return _of_joints(np.eye(arm.n, dtype=like.dtype), like)


def _units(arm: Arm, like: jax.Array) -> Scalar:
    """The unit of each joint's value: a radian, or a reach of a slide."""
    if "P" not in arm.kinds:
        return 1
    return jnp.where(_slides(arm, like), jnp.asarray(reach(arm), like.dtype), 1)


def _slides(arm: Arm, like: jax.Array) -> jax.Array:
    return _of_joints(np.array([kind == "P" for kind in arm.kinds]), like)


def newton_step(arm: Arm, objective: Objective, state: State) -> State:
    """One damped projected Newton step, taken only if it decreases the cost."""
    q, here, damping = state
    eps, one = float(jnp.finfo(here.cost.dtype).eps), jnp.ones_like(here.cost)
    ones = jnp.ones_like(q)
    fixed = active_bounds(arm, q, here.gradient)
    fixed = fixed if objective.fixed is None else fixed | objective.fixed
    free = pin(jnp.where(fixed, 0, ones))
    floor = jnp.asarray(objective.curvature_floor, here.cost.dtype)
    descent = pin(-free * here.gradient)
    # Many an arm's home configuration is a saddle. There the gradient points nowhere, and damping would hide
    # the direction of negative curvature: it is reduced to a hundredth.
    flat = pin(jnp.where(_squared_norm(descent) < NEARLY_FLAT**2, one, 0))
    push, damped = SADDLE_PUSH * flat, damping * (1 - 0.99 * flat)
    # Rows and columns of fixed joints become those of the identity.
    unit = _identity(arm, q)
    damped = here.hessian + unit * damped[None, None] * (abs(here.hessian) + 1e-2)
    matrix = pin(free[:, None] * free[None] * damped + unit * (1 - free)[None])
    rows = [list(row) for row in matrix]
    moves = jnp.stack(solve_symmetric(rows, list(descent), floor, push))
    largest = functools.reduce(jnp.maximum, abs(moves))
    shrink = pin(LARGEST_STEP / jnp.maximum(largest, LARGEST_STEP))
    trial = pin(jnp.clip(q + _units(arm, q) * shrink[None] * moves, *bounds(arm, q)))
    there = evaluate(arm, objective, trial)
    # Near the minimum two costs differ by their rounding alone: there the gradient decides.
    flatter = _squared_norm(there.gradient) < _squared_norm(here.gradient) / 4
    better = (there.cost < here.cost) | (flatter & (there.cost <= here.cost * (1 + 8 * eps)))
    better = pin(jnp.where(better, one, 0)) > 0.5
    q, here = choose(better, (trial, there), (q, here))
    eased, stiffened = damping / DAMPING_FACTOR, jnp.maximum(DAMPING_FACTOR * damping, 1e-3)
    return State(q, here, jnp.where(better, eased, stiffened))


def choose(first: jax.Array, new: Tree, old: Tree) -> Tree:
    """The one tree where the flags (...) are set, else the other; leaves may have axes of joints before."""

    def of_leaf(new: jax.Array, old: jax.Array) -> jax.Array:
        return jnp.where(first.reshape((1,) * (new.ndim - first.ndim) + first.shape), new, old)

    return jax.tree.map(of_leaf, new, old)


def _squared_norm(vector: jax.Array) -> jax.Array:
    return functools.reduce(jnp.add, vector * vector)


def evaluate(arm: Arm, objective: Objective, q: jax.Array) -> Evaluation:
    """Cost, gradient and Hessian at joints q (n, ...)."""
    per_reach = 1 / reach(arm)
    # The numbers of the pose are those of one joint, (1, ...).
    objective = jax.tree.map(lambda x: x[None] if jnp.ndim(x) else x, objective._replace(fixed=None))
    kinematics = chain(arm, q)
    tool = poses.compose(kinematics.last, fixed_pose(arm.tool))
    tool = pin_all(tool)
    offset = pin_all(_offset(arm, kinematics, objective, tool, per_reach))
    position_weight, angle_weight = objective.position_weight, _angle_weight(arm, objective, per_reach)
    rotation = _rotation_from_goal(objective, tool)
    linear, angular = stacked_twists(arm, kinematics, tool.position, q)
    linear = pin_all(vector.scale(per_reach, linear))
    # The gradient is J^T (force, torque).
    force = pin_all(vector.scale(position_weight, offset))
    torque = pin_all(vector.scale(angle_weight, rotation.vector))
    gradient = plus(vector.dot(linear, force), vector.dot(angular, torque))
    # Rates of force and torque for a unit rate of each joint.
    forces = vector.add(linear, vector.cross(offset, angular))
    torques = vector.add(rotation.rate(angular), vector.cross(rotation.vector, angular))
    forces = pin_all(vector.scale(position_weight, forces))
    torques = pin_all(vector.scale(angle_weight, torques))
    forces, torques = (tuple(x[None] for x in part) for part in (forces, torques))
    later, turning = (tuple(x[:, None] for x in part) for part in (linear, angular))
    hessian = plus(vector.dot(later, forces), vector.dot(turning, torques))
    gradient, hessian = _to_motors(arm, gradient, hessian)
    distance_squared = vector.dot(offset, offset)
    angle_squared = vector.dot(rotation.vector, rotation.vector)
    levers = jnp.where(_slides(arm, q), 1, vector.dot(linear, linear))
    numbers = (
        times(position_weight, distance_squared) + angle_weight * angle_squared,
        safe.sqrt(distance_squared),
        _angle(arm, angle_squared),
    )
    cost, distance, angle, lever = pin_all((*(x[0] for x in numbers), functools.reduce(jnp.maximum, levers)))
    return Evaluation(cost, pin(gradient), pin(hessian), distance, angle, lever)


def pose_errors(arm: Arm, objective: Objective, q: Joints) -> tuple[Scalar, Scalar, Scalar]:
    """Cost [m^2], distance [m] and angle [rad] at joints q, written so that they can be differentiated."""
    kinematics = chain(arm, q)
    tool = pin_all(poses.compose(kinematics.last, fixed_pose(arm.tool)))
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
    return poses.rotation_vector(pin_all(matrix))


def _to_motors(arm: Arm, gradient: jax.Array, hessian: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Derivatives by joint values to derivatives by motor values (entries of q), sliding ones in reaches."""
    if arm.coupling is not None:
        # Column i of the coupling says how far each joint moves with motor i.
        lower = _of_joints(np.tri(arm.n, dtype=bool), gradient)
        full = jnp.where(lower, hessian, jnp.swapaxes(hessian, 0, 1))
        shares = jnp.stack([jnp.asarray(array_of(row, gradient.dtype)) for row in arm.coupling])
        gradient = jnp.tensordot(shares, gradient, (0, 0))
        hessian = jnp.moveaxis(jnp.tensordot(shares, jnp.tensordot(shares, full, (0, 0)), (0, 1)), 0, 1)
    units = _units(arm, gradient)
    if isinstance(units, int):
        return gradient, hessian
    return units * gradient, units[:, None] * units[None] * hessian


def bounds(arm: Arm, q: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Lower and upper limit of each joint, with as many axes as q (n, ...)."""
    low, high = (_of_joints(array_of(arm.limits[:, end], q.dtype), q) for end in (0, 1))
    return low, high


def active_bounds(arm: Arm, q: jax.Array, gradient: jax.Array) -> jax.Array:
    """Which joints (n, ...) stand at a limit that the descent would leave."""
    low, high = bounds(arm, q)
    return ((q <= low) & (gradient > 0)) | ((q >= high) & (gradient < 0))


def projected_gradient_norm(arm: Arm, q: jax.Array, here: Evaluation) -> Scalar:
    """Norm of the gradient of half the cost over the joints that no active bound holds.

    In reaches and radians. A residual of more than one reach divides it: the rounding of the goal is then
    what limits it.
    """
    free = jnp.where(active_bounds(arm, q, here.gradient), 0, here.gradient)
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


def into_limits(arm: Arm, q: Joints, near: Joints | None = None) -> jax.Array:
    """The joints moved into the limits: by whole turns where that suffices, else to the nearer limit.

    Args:
        arm: The arm.
        q: Joint values, each (...).
        near: Joint values that the result shall be nearest to, among those that differ by whole turns. By
            default as few turns as suffice are taken.

    Returns:
        (n, ...)
    """
    x, turns = jnp.stack(q), whole_turns(arm)
    low, high = bounds(arm, x)
    alike = arm.coupling is None and len(set(turns)) == 1
    whole = turns[0] if alike else _of_joints(jnp.stack([jnp.asarray(turn) for turn in turns]), x)
    return _within(x, low, high, whole, None if near is None else jnp.stack(near))


def _within(x: jax.Array, low, high, whole: bool | jax.Array, near: jax.Array | None) -> jax.Array:
    """`into_limits`; `whole` says whether a whole turn of a joint leaves the pose."""
    if whole is False:
        return jnp.clip(x, low, high)
    middle = jnp.where(jnp.isfinite(low), low + math.pi, jnp.where(jnp.isfinite(high), high - math.pi, 0))
    middle = jnp.where(jnp.isfinite(low) & jnp.isfinite(high), low / 2 + high / 2, middle)
    x = jnp.where(jnp.isfinite(x), x, middle)
    turned, inside = nearest_turn(x, low, high, whole, near)
    # Outside, turns bring a joint as near to the middle as they can: the end that it passes is the nearer.
    closest, _ = nearest_turn(x, -math.inf, math.inf, whole, middle)
    return jnp.clip(jnp.where(inside, turned, closest), low, high)
