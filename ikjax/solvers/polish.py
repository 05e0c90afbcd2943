"""Newton steps from a closed form to the arm as it is given.

Storey: solvers. All slots take their steps together, along a leading axis, so that a program holds
them once.
Source: damped least squares; Wampler (1986), Nakamura and Hanafusa (1986).
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from ikjax.arm.forward import Link, advance
from ikjax.core import pose as poses
from ikjax.core import safe, vector
from ikjax.core.linear import solve_symmetric
from ikjax.core.pose import Pose
from ikjax.core.trig import Angle, Scalar
from ikjax.core.vector import Vector
from ikjax.solvers.branch import Branch, Joints, Setting, Slide, placed

STEPS = 10
"""Three bring an arm that is off by a hundredth to 1e-4, 1e-8, 1e-16; more are for goals near a fold."""

LARGEST_STEP = 0.3
"""A larger one [rad, or reaches] is not the correction of a small error."""


class Given(NamedTuple):
    """The arm as given, in units of the reach."""

    links: tuple[Link, ...]
    between: tuple[Pose, ...] | None
    """What each link but the last is off by, at its end."""
    tool: Vector
    """The tool point seen from the last frame."""


def polished(
    given: Given, slots: tuple[Branch, ...], goal: Pose, turning: bool, setting: Setting
) -> tuple[tuple[Branch, ...], list[Scalar], list[Scalar]]:
    """The slots after their steps, and how far each is from the goal.

    Args:
        given: The arm.
        slots: What the closed form proposes.
        goal: Pose of the last frame, seen from frame 0; where the task leaves the orientation open, the tool
            point on a frame of zeros.
        turning: Whether the task asks for an orientation.
        setting: What counts as zero.

    Returns:
        The slots, and for each the squared distance of the tool points and the squared Frobenius norm of
        the difference of the rotations.
    """
    joints = tuple(_stacked(column) for column in zip(*(slot.joints for slot in slots), strict=True))
    goal = Pose(*(_lifted(part) for part in goal))
    joints = jax.lax.fori_loop(
        0, STEPS, lambda _, joints: _step(given, joints, goal, turning, setting), joints
    )
    reached, _ = _walk(given, joints)
    slip = tuple(map(vector.subtract, reached.rotation, goal.rotation))
    gap = _gap(given, reached, goal, slip)
    gap_squared, turn_squared = vector.dot(gap, gap), sum(vector.dot(row, row) for row in slip)
    answers = []
    for k, slot in enumerate(slots):
        mine = tuple(
            Slide(joint.value[k]) if isinstance(joint, Slide) else setting.angle(joint.sin[k], joint.cos[k])
            for joint in joints
        )
        answers.append(slot._replace(joints=mine))
    count = range(len(slots))
    return tuple(answers), [gap_squared[k] for k in count], [turn_squared[k] for k in count]


def _stacked(column: tuple[Angle | Slide, ...]) -> Angle | Slide:
    def stack(values):
        return jnp.stack(jnp.broadcast_arrays(*values))

    if isinstance(column[0], Slide):
        return Slide(stack([joint.value for joint in column]))
    sine, cosine = (stack([getattr(joint, name) for joint in column]) for name in ("sin", "cos"))
    return Angle(sine, cosine, ())


def _lifted(part):
    """Entries with a leading axis of one."""
    if isinstance(part, tuple):
        return tuple(map(_lifted, part))
    return jnp.asarray(part)[None]


def _walk(given: Given, joints: Joints) -> tuple[Pose, list[Pose]]:
    """The last frame, and the frame before each joint."""
    frame, before = poses.IDENTITY, []
    for i, (link, joint) in enumerate(zip(given.links, joints, strict=True)):
        before.append(frame)
        frame = advance(frame, link, placed(link, joint))
        if given.between is not None and i < len(given.between):
            frame = poses.compose(frame, given.between[i])
    return frame, before


def _gap(given: Given, reached: Pose, goal: Pose, slip) -> Vector:
    return vector.add(vector.subtract(reached.position, goal.position), vector.rotate(slip, given.tool))


def _step(given: Given, joints: Joints, goal: Pose, turning: bool, setting: Setting) -> Joints:
    """One damped step on all joints."""
    reached, before = _walk(given, joints)
    slip = tuple(map(vector.subtract, reached.rotation, goal.rotation))
    gap = _gap(given, reached, goal, slip)
    tip = vector.add(reached.position, vector.rotate(reached.rotation, given.tool))
    # Half the sum of the columns' cross products is the sine of the turn that is left, along its axis.
    columns = zip(vector.transpose(reached.rotation), vector.transpose(goal.rotation), strict=True)
    turns = [vector.cross(mine, wanted) for mine, wanted in columns]
    turn = vector.scale(0.5, vector.add(vector.add(turns[0], turns[1]), turns[2]))
    wanted = (*vector.scale(-1, gap), *turn)
    rows = 6 if turning else 3
    motions = []
    for joint, frame in zip(joints, before, strict=True):
        axis = tuple(row[2] for row in frame.rotation)
        if isinstance(joint, Slide):
            motions.append((*axis, 0.0, 0.0, 0.0))
        else:
            motions.append((*vector.cross(axis, vector.subtract(tip, frame.position)), *axis))
    motions = [m[:rows] for m in motions]
    wanted = wanted[:rows]
    count = len(joints)
    matrix = [[_dot(motions[i], motions[j]) for j in range(count)] for i in range(count)]
    for i in range(count):
        matrix[i][i] = matrix[i][i] + setting.tiny / 4
    steps = solve_symmetric(matrix, [_dot(m, wanted) for m in motions])
    size = abs(steps[0])
    for step in steps[1:]:
        size = jnp.maximum(size, abs(step))
    shrink = jnp.where(size > LARGEST_STEP, LARGEST_STEP / jnp.maximum(size, LARGEST_STEP), 1)
    return tuple(_moved(joint, step * shrink) for joint, step in zip(joints, steps, strict=True))


def _dot(u, v) -> Scalar:
    return sum(a * b for a, b in zip(u, v, strict=True))


def _moved(joint: Angle | Slide, step: Scalar) -> Angle | Slide:
    if isinstance(joint, Slide):
        return Slide(joint.value + step)
    # Second order, and back onto the circle.
    less = 1 - step * step / 2
    sine, cosine = joint.sin * less + joint.cos * step, joint.cos * less - joint.sin * step
    size = safe.reciprocal_sqrt(sine * sine + cosine * cosine)
    return Angle(sine * size, cosine * size, ())
