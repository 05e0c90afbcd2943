"""Newton steps from a closed form to the arm as it is given.

Storey: solvers. All slots take their steps together, along a leading axis, so that a program holds
them once.
Source: damped least squares; Wampler (1986), Nakamura and Hanafusa (1986).
"""

import functools
import math
from collections.abc import Callable
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
from ikjax.core.xla import pinned
from ikjax.solvers.branch import Branch, Joints, Setting, Slide, moved_on, placed

STEPS = 8
"""At most so many: beside a fold a step only halves the error."""

LARGEST_STEP = 0.3
"""The largest move of a joint in one step [rad, or reaches]."""


class Given(NamedTuple):
    """The arm as given, in units of the reach."""

    links: tuple[Link, ...]
    between: tuple[Pose, ...] | None
    """What each link but the last is off by, at its end."""
    tool: Vector
    """The tool point seen from the last frame."""


def stages_and_steps(off: Scalar, tolerance: float) -> tuple[int, int]:
    """How many stages of how many Newton steps bring an arm that is off by so much within a tolerance.

    Away from folds each step squares the error, so that two are enough for a thousandth. Beside a fold the
    start is off by the square root of what the arm is off by, each step halves that, and the pose's error
    goes with its square. The second stage parts two slots that went to one answer.
    """
    if not isinstance(off, float):
        return 2, STEPS
    ratio = 32 * off / tolerance
    if ratio <= 0.1:
        return 1, 1
    return 2, min(STEPS, 2 + math.ceil(max(0, math.log2(ratio)) / 2))


def polished(
    given: Given,
    slots: tuple[Branch, ...],
    goal: Pose,
    turning: bool,
    tolerance: float,
    setting: Setting,
) -> tuple[tuple[Branch, ...], list[Scalar], list[Scalar]]:
    """The slots after their steps, and how far each is from the goal.

    Args:
        given: The arm.
        slots: What the closed form proposes.
        goal: Pose of the last frame, seen from frame 0; where the task leaves the orientation open, the tool
            point on a frame of zeros.
        turning: Whether the task asks for an orientation.
        tolerance: Of a valid pose.
        setting: What counts as zero.

    Returns:
        The slots, and for each the squared distance of the tool points and the squared Frobenius norm of
        the difference of the rotations.
    """
    start = tuple(_stacked(column) for column in zip(*(slot.joints for slot in slots), strict=True))
    goal = Pose(*(_lifted(part) for part in goal))

    def step(_, joints: Joints) -> Joints:
        return _step(given, joints, goal, turning, setting)

    stages, steps = stages_and_steps(setting.off, tolerance)

    def stage(_, joints: Joints) -> Joints:
        # Two answers near a fold lie on both sides of it: who came to another's answer tries the other side.
        twin, _ = _claimed(start, joints)
        joints = _where(twin, tuple(map(_mirrored, start, joints)), joints)
        return jax.lax.fori_loop(0, steps, step, joints)

    joints = step(0, start) if (stages, steps) == (1, 1) else jax.lax.fori_loop(0, stages, stage, start)
    # Slots that meet at a fold keep their answer both. From farther off it is another's: near a fold an
    # error counts by its square root.
    claimed, moved = _claimed(start, joints)
    short = float(jnp.finfo(moved.dtype).eps) ** 0.25 + 4 * safe.sqrt(32 * setting.off)
    joints = _where(claimed & (moved > short), start, joints)
    reached, _ = _walk(given, joints, pinned(jax.tree.leaves(joints)[0]))
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


def _stack(values) -> jax.Array:
    return jnp.stack(jnp.broadcast_arrays(*values))


def _stacked(column: tuple[Angle | Slide, ...]) -> Angle | Slide:
    if isinstance(column[0], Slide):
        return Slide(_stack([joint.value for joint in column]))
    sine, cosine = (_stack([getattr(joint, name) for joint in column]) for name in ("sin", "cos"))
    return Angle(sine, cosine, ())


def _claimed(start: Joints, joints: Joints) -> tuple[jax.Array, jax.Array]:
    """Which slots came to an answer that another had less far to, and how far each slot moved."""
    moved = _apart(start, joints)
    close = 32 * float(jnp.finfo(moved.dtype).eps) ** 0.5
    places = jnp.arange(moved.shape[0]).reshape(-1, *[1] * (moved.ndim - 1))

    def against(k, claimed: jax.Array) -> jax.Array:
        other, other_moved = jax.tree.map(lambda x: jax.lax.dynamic_slice_in_dim(x, k, 1), (joints, moved))
        nearer = (other_moved < moved) | ((other_moved == moved) & (k < places))
        return claimed | (nearer & (_apart(joints, other) < close))

    return jax.lax.fori_loop(0, moved.shape[0], against, jnp.zeros(moved.shape, bool)), moved


def _where(condition: jax.Array, yes: Joints, no: Joints) -> Joints:
    return jax.tree.map(lambda a, b: jnp.where(condition, a, b), yes, no)


def _mirrored(start: Angle | Slide, joint: Angle | Slide) -> Angle | Slide:
    """As far on the other side of the start."""
    if isinstance(start, Slide) or isinstance(joint, Slide):
        return Slide(2 * start.value - joint.value)
    sine, cosine = 2 * start.sin * start.cos, start.cos * start.cos - start.sin * start.sin
    return Angle(sine * joint.cos - cosine * joint.sin, cosine * joint.cos + sine * joint.sin, ())


def _apart(first: Joints, last: Joints) -> jax.Array:
    """The largest difference of two sets of joints [rad, or reaches]; of angles the chord."""
    return functools.reduce(jnp.maximum, map(_difference, first, last))


def _difference(first: Angle | Slide, last: Angle | Slide) -> jax.Array:
    return safe.norm(*(a - b for a, b in zip(jax.tree.leaves(last), jax.tree.leaves(first), strict=True)))


def _lifted(part):
    """Entries with a leading axis of one."""
    if isinstance(part, tuple):
        return tuple(map(_lifted, part))
    return jnp.asarray(part)[None]


def _walk(given: Given, joints: Joints, pin: Callable[[Scalar], Scalar]) -> tuple[Pose, list[Pose]]:
    """The last frame, and the frame before each joint."""
    frame, before = poses.IDENTITY, []
    for i, (link, joint) in enumerate(zip(given.links, joints, strict=True)):
        before.append(frame)
        frame = jax.tree.map(pin, advance(frame, link, placed(link, joint)))
        if given.between is not None and i < len(given.between):
            frame = jax.tree.map(pin, poses.compose(frame, given.between[i]))
    return frame, before


def _gap(given: Given, reached: Pose, goal: Pose, slip) -> Vector:
    return vector.add(vector.subtract(reached.position, goal.position), vector.rotate(slip, given.tool))


def _step(given: Given, joints: Joints, goal: Pose, turning: bool, setting: Setting) -> Joints:
    """One damped step on all joints."""
    pin = pinned(jax.tree.leaves(joints)[0])
    reached, before = _walk(given, joints, pin)
    slip = tuple(map(vector.subtract, reached.rotation, goal.rotation))
    gap = tuple(map(pin, _gap(given, reached, goal, slip)))
    tip = vector.add(reached.position, vector.rotate(reached.rotation, given.tool))
    tip = tuple(map(pin, tip))
    # Half the sum of the columns' cross products is the sine of the turn that is left, along its axis.
    columns = zip(vector.transpose(reached.rotation), vector.transpose(goal.rotation), strict=True)
    turns = [vector.cross(mine, wanted) for mine, wanted in columns]
    turn = vector.scale(0.5, vector.add(vector.add(turns[0], turns[1]), turns[2]))
    wanted = (*vector.scale(-1, gap), *map(pin, turn))
    rows = 6 if turning else 3
    motions = []
    for joint, frame in zip(joints, before, strict=True):
        axis = tuple(row[2] for row in frame.rotation)
        if isinstance(joint, Slide):
            motions.append((*axis, 0.0, 0.0, 0.0))
        else:
            arm = vector.cross(axis, vector.subtract(tip, frame.position))
            motions.append((*map(pin, arm), *axis))
    motions = [m[:rows] for m in motions]
    wanted = wanted[:rows]
    count = len(joints)
    matrix = [[pin(_dot(motions[i], motions[j])) for j in range(i + 1)] for i in range(count)]
    for i in range(count):
        matrix[i][i] = matrix[i][i] + setting.tiny / 4
    steps = solve_symmetric(matrix, [pin(_dot(m, wanted)) for m in motions], pin)
    size = functools.reduce(jnp.maximum, map(abs, steps))
    shrink = pin(LARGEST_STEP / jnp.maximum(size, LARGEST_STEP))
    moved = (_rounded(moved_on(joint, step * shrink)) for joint, step in zip(joints, steps, strict=True))
    return tuple(jax.tree.map(pin, joint) for joint in moved)


def _rounded(joint: Angle | Slide) -> Angle | Slide:
    """Back onto the circle."""
    if isinstance(joint, Slide):
        return joint
    size = safe.reciprocal_sqrt(joint.sin * joint.sin + joint.cos * joint.cos)
    return Angle(joint.sin * size, joint.cos * size, ())


def _dot(u, v) -> Scalar:
    return functools.reduce(vector.plus, map(vector.times, u, v))
