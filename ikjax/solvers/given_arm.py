"""Newton steps from a closed form to the arm as it is given.

All slots take their steps together, along a leading axis, so that a program holds
them once.
Source: damped least squares; Wampler (1986), Nakamura and Hanafusa (1986).
"""

import functools
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
from ikjax.core.xla import divider_once, pin, pinning
from ikjax.solvers.context import Branch, Joints, Setting, Slide, moved_on, placed

STEPS = 8
"""At most so many beside a fold, where a step only halves the error."""

CHUNK = 256
"""Goals beside folds that are worked on together."""

LARGEST_STEP = 0.3
"""The largest move of a joint in one step [rad, or reaches]."""


class Given(NamedTuple):
    """The arm as given, in units of the reach."""

    links: tuple[Link, ...]
    between: tuple[Pose, ...] | None
    """What each link but the last is off by, at its end."""
    tool_point: Vector
    """Seen from the last frame."""


def polished(
    given: Given,
    slots: tuple[Branch, ...],
    goal: Pose,
    turning: bool,
    allowed: tuple[Scalar, float],
    setting: Setting,
) -> tuple[tuple[Branch, ...], list[Scalar], list[Scalar]]:
    """The slots after their steps, and how far each is from the goal.

    All slots take the few steps that are enough away from folds, where each squares the error. Goals with a
    slot beside a fold, or that is not there yet, are then gathered, start again and take more steps, with
    care that two slots do not take one answer: a few goals in a hundred, which pay for themselves alone.

    Args:
        given: The arm.
        slots: What the closed form proposes.
        goal: Pose of the last frame, seen from frame 0; where the task leaves the orientation open, the tool
            point on a frame of zeros.
        turning: Whether the task asks for an orientation.
        allowed: Distance and angle of a valid pose, in units of the reach and rad.
        setting: What counts as zero.

    Returns:
        The slots, and for each the squared distance of the tool points and the squared Frobenius norm of
        the difference of the rotations.
    """
    start = tuple(_stacked(column) for column in zip(*(slot.joints for slot in slots), strict=True))
    shape = jax.tree.leaves(start)[0].shape
    margins = jnp.stack([jnp.broadcast_to(slot.margin, shape[1:]) for slot in slots]).reshape(len(slots), -1)
    start = jax.tree.map(lambda x: x.reshape(len(slots), -1), start)
    start = jax.tree.map(divider_once(jax.tree.leaves(start)[0]), start)
    goals = jax.tree.map(lambda x: jnp.broadcast_to(x, shape[1:]).reshape(1, -1), goal)
    solve = _Solve(given, turning, setting)
    size = 32 * setting.correction_size
    steps = _steps_at_once(setting.correction_size, allowed[1])
    joints = jax.lax.fori_loop(0, steps, lambda _, joints: solve.step(joints, goals), start)
    found = _Found(joints, *solve.errors(joints, goals))
    gap, angle = (jnp.broadcast_to(jnp.asarray(x), shape[1:]).reshape(1, -1) for x in allowed)
    there = (found.gap_squared <= gap * gap) & (found.turn_squared <= 2 * angle * angle)
    late = (abs(margins) <= 2 * size) | (~there & (margins > -8 * size))
    found = _again(solve, late.any(0), start, goals, found)
    answers = []
    for k, slot in enumerate(slots):
        mine = tuple(
            Slide(pin(joint.value[k].reshape(shape[1:])))
            if isinstance(joint, Slide)
            else setting.angle(joint.sin[k].reshape(shape[1:]), joint.cos[k].reshape(shape[1:]))
            for joint in found.joints
        )
        answers.append(slot._replace(joints=mine))
    squares = [[x[k].reshape(shape[1:]) for k in range(len(slots))] for x in found[1:]]
    return tuple(answers), squares[0], squares[1]


def _steps_at_once(off: Scalar, tolerance: float) -> int:
    """Each squares the error: two take 3e-3 below 1e-9, with what the arm's own lengths add."""
    if not isinstance(off, float):
        return 3
    off *= 32
    return 1 if off <= tolerance else 2 if off < 3e-3 else 3


class _Found(NamedTuple):
    """Joints of all slots (S, N), and how far they are from the goal."""

    joints: Joints
    gap_squared: jax.Array
    turn_squared: jax.Array


def _again(solve: "_Solve", late: jax.Array, start: Joints, goals: Pose, found: _Found) -> _Found:
    """The goals that are late (N,) once more, with care: a chunk after the other until none is left."""
    count = late.shape[0]
    size = min(CHUNK, count)
    # Late ones first; what is beyond them in the last chunk is written nowhere.
    places = jnp.nonzero(late, size=count + size, fill_value=count)[0].astype(jnp.int32)

    def chunk(state):
        first, found = state
        where = jax.lax.dynamic_slice_in_dim(places, first, size)
        here = jax.tree.map(lambda x: x[:, jnp.minimum(where, count - 1)], (start, goals))
        better = solve.with_care(*here)
        found = jax.tree.map(lambda x, y: x.at[:, where].set(y, mode="drop"), found, better)
        return first + size, found

    left = late.sum().astype(jnp.int32)
    return jax.lax.while_loop(lambda state: state[0] < left, chunk, (jnp.int32(0), found))[1]


class _Solve(NamedTuple):
    """An arm as given, and what is asked of it."""

    given: Given
    turning: bool
    setting: Setting

    def step(self, joints: Joints, goals: Pose) -> Joints:
        with pinning(divider_once(jax.tree.leaves(joints)[0])):
            return _step(self.given, joints, goals, self.turning, self.setting)

    def errors(self, joints: Joints, goals: Pose) -> tuple[jax.Array, jax.Array]:
        """Squared distance of the tool points, and squared Frobenius norm of the difference of rotations."""
        with pinning(divider_once(jax.tree.leaves(joints)[0])):
            reached, _ = _walk(self.given, joints)
            slip = tuple(map(vector.subtract, reached.rotation, goals.rotation))
            gap = _gap(self.given, reached, goals, slip)
            return pin(vector.dot(gap, gap)), pin(sum(vector.dot(row, row) for row in slip))

    def with_care(self, start: Joints, goals: Pose) -> _Found:
        """Two stages of many steps; beside a fold the answers lie on both sides of it."""

        def stage(_, joints: Joints) -> Joints:
            # Who came to another's answer tries the other side.
            twin, _ = _claimed(start, joints)
            joints = _where(twin, tuple(map(_mirrored, start, joints)), joints)
            return jax.lax.fori_loop(0, STEPS, lambda _, joints: self.step(joints, goals), joints)

        joints = jax.lax.fori_loop(0, 2, stage, start)
        # Slots that meet at a fold keep their answer both. From farther off it is another's: near a fold an
        # error counts by its square root.
        claimed, moved = _claimed(start, joints)
        short = self.setting.rounding**0.25 + 4 * safe.sqrt(32 * self.setting.correction_size)
        joints = _where(claimed & (moved > short), start, joints)
        return _Found(joints, *self.errors(joints, goals))


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


def _walk(given: Given, joints: Joints) -> tuple[Pose, list[Pose]]:
    """The last frame, and the frame before each joint."""
    frame, before = poses.IDENTITY, []
    for i, (link, joint) in enumerate(zip(given.links, joints, strict=True)):
        before.append(frame)
        frame = jax.tree.map(pin, advance(frame, link, placed(link, joint)))
        if given.between is not None and i < len(given.between):
            frame = jax.tree.map(pin, poses.compose(frame, given.between[i]))
    return frame, before


def _gap(given: Given, reached: Pose, goal: Pose, slip) -> Vector:
    return vector.add(vector.subtract(reached.position, goal.position), vector.rotate(slip, given.tool_point))


def _step(given: Given, joints: Joints, goal: Pose, turning: bool, setting: Setting) -> Joints:
    """One damped step on all joints."""
    reached, before = _walk(given, joints)
    slip = tuple(map(vector.subtract, reached.rotation, goal.rotation))
    gap = tuple(map(pin, _gap(given, reached, goal, slip)))
    tip = vector.add(reached.position, vector.rotate(reached.rotation, given.tool_point))
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
        matrix[i][i] = matrix[i][i] + setting.zero_tolerance / 4
    steps = solve_symmetric(matrix, [pin(_dot(m, wanted)) for m in motions])
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
