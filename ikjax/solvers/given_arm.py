"""From the closed form, which solves the arm as recognized, to the arm as given: damped least squares.

Each step solves (J^T J + damping) x = J^T r, as Levenberg and Marquardt do with a small constant damping.
All slots are one array with a leading axis, so that a program contains the step once.

Source: damped least squares in robotics: Wampler (1986), Nakamura and Hanafusa (1986).
"""

import functools
from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp

from ikjax.arm.forward import Link, advance
from ikjax.arm.twists import angular_velocity, prismatic_twist, revolute_twist
from ikjax.core import pose as poses
from ikjax.core import safe, vector
from ikjax.core.linear import damped_steps
from ikjax.core.pose import Pose
from ikjax.core.trig import Angle, Scalar
from ikjax.core.vector import Vector
from ikjax.core.xla import divider_once, pin, pin_all, pinning
from ikjax.solvers.context import Branch, Joints, Setting, Slide, moved_on, placed

STEPS = 8
"""Steps in each of the two stages beside a fold. At a double root a Newton step only halves the error."""

BATCH = 256
"""Batch size of the goals beside folds, which are gathered and solved again."""

LARGEST_STEP = 0.3
"""The largest move of a joint in one step [rad, or reaches]."""


class Given(NamedTuple):
    """The arm as given, in units of the reach."""

    links: tuple[Link, ...]
    between: tuple[Pose, ...] | None
    """The correction at the end of each link but the last."""
    tool_point: Vector
    """Seen from the last frame; beyond a redundant joint each goal has its own."""


def polished(
    given: Given,
    slots: tuple[Branch, ...],
    goal: Pose,
    turning: bool,
    allowed: tuple[Scalar, float],
    setting: Setting,
) -> tuple[tuple[Branch, ...], list[Scalar], list[Scalar]]:
    """The slots after their steps, and how far each is from the goal; see `polished_rows`."""
    start = tuple(_stacked(column) for column in zip(*(slot.joints for slot in slots), strict=True))
    shape = jax.tree.leaves(start)[0].shape
    margins = jnp.stack([jnp.broadcast_to(slot.margin, shape[1:]) for slot in slots])
    # The whole sum of the corrections: `correction_size` is 1 / 32 of it.
    size = 32 * setting.correction_size
    steps = step_count(setting.correction_size, allowed[1])
    joints, *squares = polished_rows(given, start, margins, goal, turning, allowed, setting, steps, size)
    answers = tuple(slot._replace(joints=joints_of_slot(joints, k, setting)) for k, slot in enumerate(slots))
    gaps, turns = ([x[k] for k in range(len(slots))] for x in squares)
    return answers, gaps, turns


def joints_of_slot(joints: Joints, k: int, setting: Setting) -> Joints:
    """The joints of one slot, from those of all, whose first axis counts the slots."""
    return tuple(
        Slide(pin(joint.value[k])) if isinstance(joint, Slide) else setting.angle(joint.sin[k], joint.cos[k])
        for joint in joints
    )


def polished_rows(
    given: Given,
    start: Joints,
    margins: jax.Array,
    goal: Pose,
    turning: bool,
    allowed: tuple[Scalar, float],
    setting: Setting,
    steps: int,
    size: Scalar,
) -> tuple[Joints, jax.Array, jax.Array]:
    """The joints of all slots after their steps, and how far each slot is from the goal.

    All slots take the few steps that are enough away from folds, where Newton's method converges
    quadratically. Goals with a slot beside a fold, or with one that has not converged, are then gathered.
    They start again and take more steps, and it is checked that no two slots converge to one answer. These
    are a few goals in a hundred, and the others do not pay for them.

    Args:
        given: The arm.
        start: What the closed form proposes, (S, ...).
        margins: Theirs, (S, ...).
        goal: Pose of the last frame, seen from frame 0; where the task leaves the orientation open, the tool
            point on a frame of zeros.
        turning: Whether the task asks for an orientation.
        allowed: Distance and angle of a valid pose, in units of the reach and rad.
        setting: Tolerances.
        steps: How many steps every slot takes.
        size: How far the closed form may be off; a slot whose margin is within twice that is beside a fold.

    Returns:
        The joints, and for each slot the squared distance of the tool points and the squared Frobenius norm
        of the difference of the rotations, (S, ...).
    """
    shape = margins.shape
    margins = margins.reshape(shape[0], -1)
    start = jax.tree.map(lambda x: x.reshape(shape[0], -1), start)
    start = jax.tree.map(divider_once(jax.tree.leaves(start)[0]), start)
    goals = jax.tree.map(lambda x: jnp.broadcast_to(x, shape[1:]).reshape(1, -1), goal)
    solve = _Solve(given, turning, setting).at_goals(lambda x: jnp.broadcast_to(x, shape[1:]).reshape(1, -1))
    joints = start
    if steps:
        joints = jax.lax.fori_loop(0, steps, lambda _, joints: solve.step(joints, goals), start)
    answer = _Answer(joints, *solve.errors(joints, goals))
    gap, angle = (jnp.broadcast_to(jnp.asarray(x), shape[1:]).reshape(1, -1) for x in allowed)
    # The Frobenius norm of R - S is sqrt(2) times a small angle.
    converged = (answer.gap_squared <= gap * gap) & (answer.turn_squared <= 2 * angle * angle)
    unfinished = (abs(margins) <= 2 * size) | (~converged & (margins > -8 * size))
    answer = _solved_again(solve, unfinished.any(0), start, goals, answer)
    return jax.tree.map(lambda x: x.reshape(shape), tuple(answer))


def step_count(correction_size: Scalar, tolerance: float) -> int:
    """How many steps are enough away from folds.

    Each squares the error: two take 3e-3 below 1e-9, with what the arm's own lengths add.
    """
    if not isinstance(correction_size, float):
        return 3
    correction_size *= 32
    return 1 if correction_size <= tolerance else 2 if correction_size < 3e-3 else 3


class _Answer(NamedTuple):
    """Joints of all slots (S, N), and how far they are from the goal."""

    joints: Joints
    gap_squared: jax.Array
    turn_squared: jax.Array


def _solved_again(
    solve: "_Solve", unfinished: jax.Array, start: Joints, goals: Pose, answer: _Answer
) -> _Answer:
    """The answer, with the unfinished goals (N,) solved once more in batches of `BATCH`."""
    count = unfinished.shape[0]
    size = min(BATCH, count)
    # Unfinished goals first. The last batch is filled with an index out of range, which is never written.
    places = jnp.nonzero(unfinished, size=count + size, fill_value=count)[0].astype(jnp.int32)

    def batch(state):
        first, answer = state
        where = jax.lax.dynamic_slice_in_dim(places, first, size)

        def gathered(x):
            return x[:, jnp.minimum(where, count - 1)]

        here = jax.tree.map(gathered, (start, goals))
        better = solve.at_goals(gathered).beside_fold(*here)
        answer = jax.tree.map(lambda x, y: x.at[:, where].set(y, mode="drop"), answer, better)
        return first + size, answer

    left = unfinished.sum().astype(jnp.int32)
    return jax.lax.while_loop(lambda state: state[0] < left, batch, (jnp.int32(0), answer))[1]


class _Solve(NamedTuple):
    """An arm as given, and what its task controls."""

    given: Given
    turning: bool
    setting: Setting

    def at_goals(self, pick: Callable[[jax.Array], jax.Array]) -> "_Solve":
        """The same at some of the goals, where each has a tool point of its own."""
        tool_point = tuple(pick(x) if jnp.ndim(x) else x for x in self.given.tool_point)
        return self._replace(given=self.given._replace(tool_point=tool_point))

    def step(self, joints: Joints, goals: Pose) -> Joints:
        """One damped step of all slots."""
        with pinning(divider_once(jax.tree.leaves(joints)[0])):
            return _step(self.given, joints, goals, self.turning, self.setting)

    def errors(self, joints: Joints, goals: Pose) -> tuple[jax.Array, jax.Array]:
        """Squared distance of the tool points, and squared Frobenius norm of the difference of rotations."""
        with pinning(divider_once(jax.tree.leaves(joints)[0])):
            reached, _ = _forward(self.given, joints)
            change = tuple(map(vector.subtract, reached.rotation, goals.rotation))
            gap = _gap(self.given, reached, goals, change)
            return pin(vector.dot(gap, gap)), pin(sum(vector.dot(row, row) for row in change))

    def beside_fold(self, start: Joints, goals: Pose) -> _Answer:
        """Two stages of `STEPS` steps. Beside a fold two answers lie on either side of the start."""

        def stage(_, joints: Joints) -> Joints:
            # A slot that converged to another slot's answer starts anew from the other side of the fold.
            twin, _ = _claimed(start, joints)
            joints = _where(twin, tuple(map(_mirrored, start, joints)), joints)
            return jax.lax.fori_loop(0, STEPS, lambda _, joints: self.step(joints, goals), joints)

        joints = jax.lax.fori_loop(0, 2, stage, start)
        # Two slots that meet at the fold may have the same answer. A slot that moved farther than that has
        # another slot's answer, and goes back to its start. At a fold the joints move by the square root of
        # the error of the pose, here of the corrections.
        claimed, moved = _claimed(start, joints)
        short = self.setting.rounding**0.25 + 4 * safe.sqrt(32 * self.setting.correction_size)
        joints = _where(claimed & (moved > short), start, joints)
        return _Answer(joints, *self.errors(joints, goals))


def _stack(values) -> jax.Array:
    return jnp.stack(jnp.broadcast_arrays(*values))


def _stacked(column: tuple[Angle | Slide, ...]) -> Angle | Slide:
    if isinstance(column[0], Slide):
        return Slide(_stack([joint.value for joint in column]))
    sine, cosine = (_stack([getattr(joint, name) for joint in column]) for name in ("sin", "cos"))
    return Angle(sine, cosine, ())


def _claimed(start: Joints, joints: Joints) -> tuple[jax.Array, jax.Array]:
    """Which slots have an answer that another slot reached by a shorter way, and how far each slot moved."""
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
    """The joint mirrored at the start: as far from it on the other side."""
    if isinstance(start, Slide) or isinstance(joint, Slide):
        return Slide(2 * start.value - joint.value)
    sine, cosine = 2 * start.sin * start.cos, start.cos * start.cos - start.sin * start.sin
    return Angle(sine * joint.cos - cosine * joint.sin, cosine * joint.cos + sine * joint.sin, ())


def _apart(first: Joints, last: Joints) -> jax.Array:
    """The largest difference of two sets of joints [rad, or reaches]; for angles the length of the chord."""
    return functools.reduce(jnp.maximum, map(_difference, first, last))


def _difference(first: Angle | Slide, last: Angle | Slide) -> jax.Array:
    return safe.norm(*(a - b for a, b in zip(jax.tree.leaves(last), jax.tree.leaves(first), strict=True)))


def _forward(given: Given, joints: Joints) -> tuple[Pose, list[Pose]]:
    """Forward kinematics of the arm as given: the last frame, and the frame before each joint."""
    frame, before = poses.IDENTITY, []
    for i, (link, joint) in enumerate(zip(given.links, joints, strict=True)):
        before.append(frame)
        frame = pin_all(advance(frame, link, placed(link, joint)))
        if given.between is not None and i < len(given.between):
            frame = pin_all(poses.compose(frame, given.between[i]))
    return frame, before


def _gap(given: Given, reached: Pose, goal: Pose, change) -> Vector:
    return vector.add(
        vector.subtract(reached.position, goal.position), vector.rotate(change, given.tool_point)
    )


def _step(given: Given, joints: Joints, goal: Pose, turning: bool, setting: Setting) -> Joints:
    """One damped step on all joints."""
    reached, before = _forward(given, joints)
    change = tuple(map(vector.subtract, reached.rotation, goal.rotation))
    gap = pin_all(_gap(given, reached, goal, change))
    tip = vector.add(reached.position, vector.rotate(reached.rotation, given.tool_point))
    tip = pin_all(tip)
    # The axis of the rotation that is left, times the sine of its angle.
    turn = angular_velocity(reached.rotation, goal.rotation)
    wanted = (*vector.scale(-1, gap), *map(pin, turn))
    rows = 6 if turning else 3
    motions = []
    for joint, frame in zip(joints, before, strict=True):
        axis = tuple(row[2] for row in frame.rotation)
        slides = isinstance(joint, Slide)
        twist = prismatic_twist(axis) if slides else revolute_twist(axis, frame.position, tip)
        motions.append((*(twist.linear if slides else map(pin, twist.linear)), *twist.angular))
    motions = [m[:rows] for m in motions]
    wanted = wanted[:rows]
    # The damping, 16 eps, keeps the normal equations regular where the columns of J are dependent.
    steps = damped_steps(motions, wanted, setting.zero_tolerance / 4)
    size = functools.reduce(jnp.maximum, map(abs, steps))
    shrink = pin(LARGEST_STEP / jnp.maximum(size, LARGEST_STEP))
    moved = (_rounded(moved_on(joint, step * shrink)) for joint, step in zip(joints, steps, strict=True))
    return tuple(pin_all(joint) for joint in moved)


def _rounded(joint: Angle | Slide) -> Angle | Slide:
    """The joint with its sine and cosine scaled back to length one."""
    if isinstance(joint, Slide):
        return joint
    size = safe.reciprocal_sqrt(joint.sin * joint.sin + joint.cos * joint.cos)
    return Angle(joint.sin * size, joint.cos * size, ())
