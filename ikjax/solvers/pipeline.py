"""From one goal to measured slots: what every family shares.

The goal is converted to units of the reach and to the frame that its family expects. The family proposes
joints for every slot. Forward kinematics on the given arm then measures each slot and decides whether it is
valid.
"""

import dataclasses
import functools
import math
from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ikjax.arm.arm import Arm, numbers
from ikjax.arm.forward import (
    Joint,
    Link,
    advance,
    corrections,
    coupled,
    fixed_pose,
    known_sincos,
    links,
    reach,
    strip,
    whole_turns,
)
from ikjax.arm.recognition.rules import RULES
from ikjax.core import pose as poses
from ikjax.core import safe, vector
from ikjax.core.pose import Pose
from ikjax.core.tolerances import TINY, UNSEEN, VALID
from ikjax.core.trig import Angle, Scalar, atan2, canonical, sincos, wrap
from ikjax.core.xla import is_traced, pin, pin_all
from ikjax.solvers.context import Branch, Joints, Setting, Slide, placed
from ikjax.solvers.families import KERNELS, Family
from ikjax.solvers.given_arm import Given, polished, polished_rows, step_count

TURNING = ("pose", "planar_pose")
"""Tasks that ask for an orientation."""


class Slot(NamedTuple):
    """One measured answer, in scalars; most fields are those of `Solutions`."""

    joints: Joints
    """The joints that were measured, as sines and cosines."""
    q: tuple[Scalar, ...]
    valid: jax.Array
    margin: Scalar
    continuum: jax.Array
    position_error: Scalar
    rotation_error: Scalar
    miss_squared: Scalar
    """Square of the larger error, in tolerances: valid slots have at most 1."""
    is_pose: jax.Array | bool = True
    """Whether the goal was a pose, which is known before it is cleaned."""
    fold: tuple = ()
    """See `Branch.fold`."""


class Measured(NamedTuple):
    """What tolerances and margins are relative to, of an arm whose mount and tool are a part of the goal."""

    reach: Scalar
    """Of the arm with its tool [m]: margins are no greater."""
    distance: Scalar
    """Of the goal from the origin of the world [m]."""


def as_solved(arm: Arm) -> Arm:
    """The arm, without a correction that is too small to decide `valid` in the arm's type.

    Without a correction the arm is solved as recognized, which is faster. See `UNSEEN`.
    """
    if arm.correction is None or is_traced(arm):
        return arm
    rows, size = np.abs(np.asarray(arm.correction, float)), float(reach(arm))
    largest = max(rows[:, :3].max() / size, rows[:, 3:].max())
    return dataclasses.replace(arm, correction=None) if largest <= unseen(arm.dtype) else arm


def unseen(dtype) -> float:
    """The largest correction that is left out, [rad] and as a share of the reach."""
    return UNSEEN * VALID[np.dtype(dtype).name]


class Frame(NamedTuple):
    """What depends on the arm alone: its table in units of the reach, and the frames around it."""

    reach: Scalar
    """[m]"""
    per_reach: Scalar
    """1 / reach [1/m]."""
    links: tuple[Link, ...]
    """The last one has no a, alpha or d of its own: it ends in the tip, the frame that its joint turns."""
    from_world: Pose
    """T_base_world."""
    from_tool: Pose
    """T_tool_tip."""
    tool_point: vector.Vector
    """Seen from the tip."""
    between: tuple[Pose, ...] | None
    """The correction at the end of each link but the last, see `Arm.correction`; None where there is none."""
    correction_size: Scalar
    """A small part (1 / 32) of the sum of these corrections: enough to bend an elbow that has to be straight
    on the arm as recognized and need not be so on the arm as given."""
    locked: Joints = ()
    """The joints of `Arm.locked` at their values, which are a part of `from_world` and of `from_tool`."""


def prepare(arm: Arm, free: tuple[Scalar, ...] = ()) -> Frame:
    """The frame of an arm.

    Args:
        arm: The arm.
        free: The values of the joints in `Arm.locked` [rad, m].
    """
    size = reach(arm)
    per = 1 / size
    table = tuple(
        link._replace(a=vector.times(per, link.a), d=vector.times(per, link.d), theta=_wrapped(link.theta))
        for link in links(arm)
    )
    base, tool, between = fixed_pose(arm.base), fixed_pose(arm.tool), None
    off = corrections(arm)
    if off is not None:
        base, tool = poses.compose(base, off[0]), poses.compose(off[-1], tool)
        between = tuple(Pose(p.rotation, vector.scale(per, p.position)) for p in off[1:-1])
    base = Pose(base.rotation, vector.scale(per, base.position))
    tool = Pose(tool.rotation, vector.scale(per, tool.position))
    locked = tuple(
        _joint_at(table[i], value, per, jnp.result_type(value))
        for i, value in zip(arm.locked, free, strict=True)
    )
    if locked:
        at = dict(zip(arm.locked, locked, strict=True))
        for i in range(arm.solved.start):
            base = advance(base, table[i], placed(table[i], at[i]))
            base = base if between is None else poses.compose(base, between[i])
        for i in reversed(range(arm.solved.stop, arm.n)):
            before = poses.IDENTITY if between is None else between[i - 1]
            tool = poses.compose(advance(before, table[i], placed(table[i], at[i])), tool)
        base, tool = pin_all((base, tool))
        table = table[arm.solved.start : arm.solved.stop]
        between = None if between is None else between[arm.solved.start : arm.solved.stop - 1]
    tip_tool = poses.compose(advance(poses.IDENTITY, table[-1], Joint(0.0, 1.0, table[-1].d)), tool)
    bare = Link(table[-1].kind, 0.0, 0.0, 1.0, 0.0, table[-1].theta)
    return Frame(
        size,
        per,
        (*table[:-1], bare),
        poses.inverse(base),
        poses.inverse(tip_tool),
        tip_tool.position,
        between,
        0.0 if between is None else _correction_size(arm, per),
        locked,
    )


def _correction_size(arm: Arm, per: Scalar) -> Scalar:
    assert arm.correction is not None
    rows = [numbers(arm.correction[i + 1]) for i in arm.solved[:-1]]
    return sum(per * sum(map(abs, row[:3])) + sum(map(abs, row[3:])) for row in rows) / 32


def _wrapped(theta: Scalar) -> Scalar:
    return math.remainder(theta, 2 * math.pi) if isinstance(theta, float) else wrap(theta)


def solve_scalars(
    arm: Arm,
    goal: Pose,
    fallback: tuple[Scalar, ...] | None = None,
    tolerance: float | None = None,
    free: tuple[Scalar, ...] = (),
    of_whole: Measured | None = None,
) -> tuple[Slot, ...]:
    """Every slot for one goal, in scalars (or for many goals, one array a scalar).

    Args:
        arm: An arm with a family.
        goal: T_world_tool with an orthonormal rotation; `clean` makes one of anything.
        fallback: Joint values where the goal leaves joints arbitrary; zero by default.
        tolerance: Overrides `VALID` for the goal's type.
        free: The values of the joints in `Arm.locked` [rad, m], or the arm angle [rad], finite.
        of_whole: Of an arm without its mount and tool, whose goals are those of its tip.

    Returns:
        One `Slot` for each branch of the family, in slot order.
    """
    if KERNELS[str(arm.family)].stacked is not None:
        return each_slot(solve_rows(arm, goal, fallback, tolerance, free, of_whole))
    tolerance = VALID[jnp.result_type(goal.position[0]).name] if tolerance is None else tolerance
    frame, tip, setting = _prepared(arm, goal, fallback, free)
    allowed = _allowed(frame, goal, tolerance, of_whole)
    turning = arm.task in TURNING
    family = KERNELS[str(arm.family)]
    both = allowed, tolerance
    branches = family.branches(arm.signs, frame.links, tip, setting)
    if frame.between is not None:
        given = Given(frame.links, frame.between, frame.tool_point)
        branches, gaps, turns = polished(given, branches, tip, turning, both, setting)
        measured = list(zip(gaps, turns, strict=True))
    else:
        measured = [_mismatch(frame, family, branch) for branch in branches]
    cap = _margin_cap(frame, of_whole)
    measure = _Measure(arm, frame, _motors(arm), both, _of_joints(arm, free), cap)
    return tuple(measure(branch, squares) for branch, squares in zip(branches, measured, strict=True))


def solve_rows(
    arm: Arm,
    goal: Pose,
    fallback: tuple[Scalar, ...] | None = None,
    tolerance: float | None = None,
    free: tuple[Scalar, ...] = (),
    of_whole: Measured | None = None,
) -> Slot:
    """Every slot in one, whose numbers have the slots as their first axis, for a family with `stacked`.

    Arguments as in `solve_scalars`.
    """
    dtype, family = jnp.result_type(goal.position[0]), KERNELS[str(arm.family)]
    assert family.stacked is not None
    tolerance = VALID[dtype.name] if tolerance is None else tolerance
    if _is_wide(arm, dtype):
        return _in_float64(arm, goal, fallback, tolerance, free, of_whole)
    frame, tip, setting = _prepared(arm, goal, fallback, free)
    allowed = _allowed(frame, goal, tolerance, of_whole)
    given = Given(frame.links, frame.between, frame.tool_point)
    whole = family.stacked(arm.signs, frame.links, tip, setting)
    branch, squares = _finished(given, whole, tip, (allowed, tolerance), setting)
    frame, free = frame._replace(locked=_in_rows(frame.locked, branch)), _in_rows(free, branch)
    both, cap = (jnp.asarray(allowed)[None], tolerance), _margin_cap(frame, of_whole)
    return _Measure(arm, frame, _motors(arm), both, free, cap)(branch, squares)


def _allowed(frame: Frame, goal: Pose, tolerance: float, of_whole: Measured | None) -> Scalar:
    """How far the position of a valid answer may be off, in units of the reach."""
    if of_whole is None:
        return tolerance * (1 + frame.per_reach * vector.norm(goal.position))
    return tolerance * frame.per_reach * (of_whole.reach + of_whole.distance)


def _margin_cap(frame: Frame, of_whole: Measured | None) -> Scalar:
    """The greatest margin, in units of the reach."""
    return 1 if of_whole is None else frame.per_reach * of_whole.reach


def _in_rows(values, rows: Branch):
    """Numbers of a goal (...) that its slots have in common, for each slot (S, ...)."""
    return jax.tree.map(lambda x: jnp.broadcast_to(x, rows.margin.shape), values)


def each_slot(rows: Slot) -> tuple[Slot, ...]:
    """The slots that are stacked in one, whose goal they have in common."""

    def slot(k: int) -> Slot:
        apart = jax.tree.map(lambda x: x if isinstance(x, bool) else x[k], rows._replace(is_pose=True))
        return apart._replace(is_pose=rows.is_pose)

    return tuple(map(slot, range(len(rows.valid))))


def margin_rows(arm: Arm, goal: Pose, fold: tuple, free: tuple[Scalar, ...] = ()) -> Scalar:
    """The margins of `solve_rows` with their derivatives, from the `Slot.fold` that it gave."""
    family = KERNELS[str(arm.family)]
    assert family.margins is not None
    dtype = jnp.result_type(goal.position[0])
    if _is_wide(arm, dtype):
        goal, free, fold = _cast((goal, free, fold), jnp.float64)
        return margin_rows(arm.astype(jnp.float64), goal, fold, free).astype(jnp.float32)
    frame, tip, _ = _prepared(arm, goal, None, free)
    margin = family.margins(arm.signs, frame.links, tip, fold)
    return frame.reach * jnp.minimum(margin, 1)


def _is_wide(arm: Arm, dtype) -> bool:
    """Whether goals of a type are solved in float64."""
    return RULES[str(arm.family)].wide and dtype == jnp.float32 and jnp.result_type(float) == jnp.float64


def _cast(tree, dtype):
    """The tree with its arrays in a type."""
    return jax.tree.map(lambda x: x.astype(dtype) if hasattr(x, "astype") else x, tree)


def _in_float64(
    arm: Arm,
    goal: Pose,
    fallback: tuple[Scalar, ...] | None,
    tolerance: float,
    free: tuple[Scalar, ...],
    of_whole: Measured | None,
) -> Slot:
    """The slots of a float32 goal, computed in float64."""
    goal, fallback, free, of_whole = _cast((goal, fallback, free, of_whole), jnp.float64)
    slot = solve_rows(arm.astype(jnp.float64), goal, fallback, tolerance, free, of_whole)

    def narrow(x):
        return x.astype(jnp.float32) if hasattr(x, "astype") and x.dtype == jnp.float64 else x

    slot = jax.tree.map(narrow, slot)
    return slot._replace(q=tuple(map(canonical, slot.q)))


class _Measure(NamedTuple):
    """What makes slots of branches: whether they reach the goal, and how far they are off."""

    arm: Arm
    frame: Frame
    motors: Callable[[tuple[Scalar, ...]], tuple[Scalar, ...]]
    allowed: tuple[Scalar, float]
    """Distance and angle of a valid pose, in units of the reach and rad."""
    free: tuple[Scalar, ...]
    """The values of the joints in `Arm.locked` [rad, m]."""
    cap: Scalar
    """The greatest margin, in units of the reach."""

    def __call__(self, branch: Branch, squares: tuple[Scalar, Scalar]) -> Slot:
        """The slot of a branch, with its squared errors: of tool point and rotation (Frobenius)."""
        arm, frame, (length, angle) = self.arm, self.frame, self.allowed
        gap_squared, turn_squared = pin_all(squares)
        turn_squared = turn_squared if arm.task in TURNING else jnp.zeros_like(gap_squared)
        # |R - S| = sqrt(8) sin(angle / 2) in the Frobenius norm, which is sqrt(2) angle for small angles.
        valid = (gap_squared <= length * length) & (turn_squared <= 2 * angle**2)
        half = safe.sqrt(jnp.minimum(turn_squared / 8, 1))
        margin = jnp.minimum(branch.margin, self.cap)
        if not isinstance(branch.miss, float):
            margin = jnp.where(valid, margin, jnp.minimum(margin, -branch.miss))
        return Slot(
            _whole(arm, branch.joints, frame.locked),
            self.motors(_whole(arm, _joint_values(frame, branch.joints), self.free)),
            valid,
            frame.reach * margin,
            branch.continuum,
            frame.reach * safe.sqrt(gap_squared),
            2 * atan2(half, safe.sqrt((1 - half) * (1 + half))),
            jnp.maximum(gap_squared / (length * length), turn_squared / (2 * angle**2)),
            fold=branch.fold,
        )


def _finished(
    given: Given, slots: Branch, goal: Pose, allowed: tuple[Scalar, float], setting: Setting
) -> tuple[Branch, tuple[Scalar, Scalar]]:
    """All slots as one `Branch`, finished by Newton's method, and how far each is off.

    The closed form is exact but beside folds, where its angles are good to the root of the rounding.
    """
    size = vector.plus(setting.rounding**0.5, 32 * setting.correction_size)
    steps = 0 if given.between is None else step_count(setting.correction_size, allowed[1])
    found = polished_rows(given, slots.joints, slots.margin, goal, True, allowed, setting, steps, size)
    joints, *squares = found
    joints = tuple(setting.angle(joint.sin, joint.cos) for joint in joints)
    return slots._replace(joints=joints), (squares[0], squares[1])


def proposed(arm: Arm, goal: Pose, free: tuple[Scalar, ...] = ()) -> list[tuple[Scalar, ...]]:
    """Joints of every slot, for a goal that need not be reached: as near as the closed form comes.

    Arguments as in `solve_scalars`. Nothing is measured, and the arm is taken as recognized.
    """
    frame, tip, setting = _prepared(arm, goal, None, free)
    family = KERNELS[str(arm.family)]
    branches = (family.nearest or family.branches)(arm.signs, frame.links, tip, setting)
    motors = _motors(arm)
    return [motors(_whole(arm, _joint_values(frame, branch.joints), free)) for branch in branches]


def proposed_at_limits(arm: Arm, goal: Pose) -> tuple[jax.Array, ...]:
    """As `proposed`, and with one joint locked at one of its limits, for a family that locks some.

    Returns:
        Joints, each (S, ...), those of `proposed` first. Joints that can be locked but have no limits are not
        locked.
    """
    family, limits = KERNELS[str(arm.family)], {}
    assert family.locked is not None
    for joint in family.lockable:
        angles = [vector.plus(links(arm)[joint].theta, limit) for limit in numbers(arm.limits[joint])]
        angles = [x for x in angles if not isinstance(x, float) or math.isfinite(x)]
        # A traced limit may be infinite at run time: any angle will do in its place.
        limits[joint] = [
            known_sincos(x if isinstance(x, float) else jnp.where(jnp.isfinite(x), x, 0)) for x in angles
        ]
    frame, tip, setting = _prepared(arm, goal, None)
    motors, shape = _motors(arm), goal.position[0].shape

    def flat(joints: Joints) -> list[jax.Array]:
        values = motors(_joint_values(frame, joints))
        whole = jnp.broadcast_shapes(*map(jnp.shape, values))
        whole = (*whole[: len(whole) - len(shape)], *shape)
        return [pin(jnp.broadcast_to(x, whole)).reshape(-1, *shape) for x in values]

    ways = [flat(joints) for joints in family.locked(arm.signs, frame.links, tip, setting, limits)]
    return tuple(jnp.concatenate(parts) for parts in zip(*ways, strict=True))


def _whole(arm: Arm, solved: tuple, locked: tuple) -> tuple:
    """What there is of each joint, of that of the solved joints and that of the locked ones."""
    return (*locked[: arm.solved.start], *solved, *locked[arm.solved.start :])


def _prepared(
    arm: Arm, goal: Pose, fallback: tuple[Scalar, ...] | None, free: tuple[Scalar, ...] = ()
) -> tuple[Frame, Pose, Setting]:
    """The arm's frame, the goal as its family expects it, and the setting of the family."""
    dtype = jnp.result_type(goal.position[0])
    frame = prepare(arm, _of_joints(arm, free))
    zero = TINY * float(np.finfo(dtype).eps)
    values = coupled(arm, (0.0,) * arm.n if fallback is None else fallback)
    values = values[arm.solved.start : arm.solved.stop]
    joints = tuple(
        _joint_at(link, value, frame.per_reach, dtype)
        for link, value in zip(frame.links, values, strict=True)
    )
    scaled = Pose(goal.rotation, vector.scale(frame.per_reach, goal.position))
    tip = pin_all(_tip_goal(arm.task, frame, scaled))
    return (
        frame,
        tip,
        Setting(
            fallback=joints,
            tool_point=frame.tool_point,
            zero_tolerance=zero,
            length_uncertainty=vector.plus(zero / 8, frame.correction_size),
            correction_size=frame.correction_size,
            given=() if arm.locked else free,
        ),
    )


def _of_joints(arm: Arm, free: tuple[Scalar, ...]) -> tuple[Scalar, ...]:
    """The values of locked joints, where what is given is not the arm angle."""
    return free if arm.locked else ()


def _tip_goal(task: str, frame: Frame, goal: Pose) -> Pose:
    """The goal of the tip, seen from frame 0.

    Where the task leaves the orientation open, the goal is the tool point itself, with a rotation of zeros.
    `_mismatch` then compares the whole tool point of the reached frame with it.
    """
    seen = poses.compose(frame.from_world, goal)
    if task in TURNING:
        return poses.compose(seen, frame.from_tool)
    zero = jnp.zeros_like(seen.position[0])
    return Pose(((zero,) * 3,) * 3, seen.position)


def _motors(arm: Arm) -> Callable[[tuple[Scalar, ...]], tuple[Scalar, ...]]:
    """A function from joint values to motor values.

    Motor values are in (-pi, pi] where a whole turn of the motor does not change the pose.
    """
    if arm.coupling is None:
        return lambda q: q
    known = isinstance(arm.coupling, np.ndarray) and arm.coupling.dtype != object
    inverse = np.linalg.inv(arm.coupling) if known else jnp.linalg.inv(jnp.stack([*map(_row, arm.coupling)]))
    rows = [numbers(inverse[i]) for i in range(arm.n)]

    def motor(whole, row, q):
        value = functools.reduce(vector.plus, map(vector.times, row, q))
        if isinstance(whole, bool):
            return wrap(value) if whole else value
        return jnp.where(whole, wrap(value), value)

    return lambda q: tuple(motor(whole, row, q) for whole, row in zip(whole_turns(arm), rows, strict=True))


def _row(entries) -> jax.Array:
    return jnp.stack([jnp.asarray(x) for x in entries]) if isinstance(entries, np.ndarray) else entries


def _joint_at(link: Link, value: Scalar, per_reach: Scalar, dtype) -> Angle | Slide:
    """The joint of a link at a value [rad, m]."""
    if link.kind == "P":
        return Slide(jnp.asarray(per_reach * value, dtype))
    total = jnp.asarray(link.theta + value, dtype)
    return Angle(*sincos(total), total)


def _mismatch(frame: Frame, family: Family, branch: Branch) -> tuple[Scalar, Scalar]:
    """Squared distance of the tool points, and squared Frobenius norm of R - S.

    Forward kinematics on the given arm, divided so that slots share as much of it as they can: the first
    joints (`Family.first`) and the last ones (`Family.last`) are moved to the goal's side of the equation,
    and the joints between are multiplied out. Both sides are compared in the frame after the latter.
    """
    joints = [placed(link, joint) for link, joint in zip(frame.links, branch.joints, strict=True)]
    chain = list(zip(frame.links, joints, strict=True))
    end = len(chain) - family.last
    goal, tool = branch.seen, frame.tool_point
    for link, joint in reversed(chain[end:]):
        goal = strip(goal, link, joint)
        tool = _carried(tool, link, joint)
    reached = poses.IDENTITY
    for link, joint in chain[family.first : end]:
        reached = advance(reached, link, joint)
    change = tuple(map(vector.subtract, reached.rotation, goal.rotation))
    # The tool point is at p + R t: its error has a part from the positions and one from the rotations.
    gap = vector.add(vector.subtract(reached.position, goal.position), vector.rotate(change, tool))
    return vector.dot(gap, gap), sum(vector.dot(row, row) for row in change)


def _carried(point: vector.Vector, link: Link, joint: Joint) -> vector.Vector:
    """A point, given in the frame after the link, seen from the frame before it."""
    step = advance(poses.IDENTITY, link, joint)
    return vector.add(vector.rotate(step.rotation, point), step.position)


def _joint_values(frame: Frame, joints: Joints) -> tuple[Scalar, ...]:
    values = []
    for link, joint in zip(frame.links, joints, strict=True):
        if isinstance(joint, Slide):
            values.append(frame.reach * joint.value)
            continue
        turned = joint.value - link.theta
        turned = jnp.where(turned > np.pi, turned - 2 * np.pi, turned)
        turned = jnp.where(turned < -np.pi, turned + 2 * np.pi, turned)
        values.append(canonical(turned))
    return tuple(values)
