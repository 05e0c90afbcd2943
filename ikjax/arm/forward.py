"""Forward kinematics: where every link and the tool are, and the reach, which is the unit of length.

`fk` and `frames` take arrays; the rest is in scalars, for kernels. The functions of `Link` go from frame to
frame in both directions: `advance`, `unwind` and `strip`.

Source: Spong, Robot Modeling and Control, equation (3.10).
"""

import functools
import math
import operator
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ikjax.arm.arm import Arm, numbers
from ikjax.core import pose as poses
from ikjax.core import vector
from ikjax.core.pose import Pose
from ikjax.core.trig import Scalar, sincos
from ikjax.core.typing import ArrayInput
from ikjax.core.vector import plus, times
from ikjax.core.xla import as_array, pin, pin_all, pin_number


class Link(NamedTuple):
    """One row of the standard DH table, in scalars."""

    kind: str
    a: Scalar
    sin_alpha: Scalar
    cos_alpha: Scalar
    d: Scalar
    theta: Scalar


def _twist(alpha: Scalar, noise: float) -> tuple[Scalar, ...]:
    """Sine and cosine of a twist, exactly 0, 1 or -1 where they are so to within `noise`."""
    if isinstance(alpha, float):
        exact = (math.sin(alpha), math.cos(alpha))
        return tuple(float(round(x)) if abs(x - round(x)) < noise else x for x in exact)
    # The value is snapped, the derivative is not: twists stay differentiable.
    snapped = (x + jax.lax.stop_gradient(jnp.where(jnp.abs(x) < noise, -x, 0)) for x in sincos(alpha))
    return tuple(map(pin_number, snapped))


def links(arm: Arm) -> tuple[Link, ...]:
    """The rows of the DH table in scalars."""
    noise = 4 * float(np.finfo(arm.dtype).eps)
    rows = zip(
        arm.kinds,
        numbers(arm.a),
        [_twist(alpha, noise) for alpha in numbers(arm.alpha)],
        numbers(arm.d),
        numbers(arm.theta),
        strict=True,
    )
    return tuple(Link(kind, a, s, c, d, theta) for kind, a, (s, c), d, theta in rows)


def fixed_pose(matrix) -> Pose:
    """A (4, 4) leaf in scalars."""
    rows = [numbers(matrix[i]) for i in range(3)]
    return Pose(tuple(row[:3] for row in rows), tuple(row[3] for row in rows))


def known_sincos(angle: Scalar) -> tuple[Scalar, Scalar]:
    """Sine and cosine of an angle of the arm, as Python floats where it is known while tracing."""
    if isinstance(angle, float):
        return math.sin(angle), math.cos(angle)
    sine, cosine = sincos(angle)
    return pin_number(sine), pin_number(cosine)


class Joint(NamedTuple):
    """The value of a link's joint: the DH angle as sine and cosine, and the DH offset."""

    sin: Scalar
    cos: Scalar
    d: Scalar


def advance(frame: Pose, link: Link, joint: Joint) -> Pose:
    """The frame after the link: T_0_i from T_0_(i-1).

    Source: Spong, Robot Modeling and Control, equation (3.10), by columns.
    """
    x, y, z = vector.transpose(frame.rotation)
    turned_x = _mix(joint.cos, x, joint.sin, y)
    turned_y = _mix(joint.cos, y, -joint.sin, x)
    s, c = link.sin_alpha, link.cos_alpha
    axes = (turned_x, _mix(c, turned_y, s, z), _mix(c, z, -s, turned_y))
    step = _mix(link.a, turned_x, joint.d, z)
    return Pose(vector.transpose(axes), vector.add(frame.position, step))


def unwind(goal: Pose, link: Link, joint: Joint) -> Pose:
    """The goal seen from the frame after the link: T_i_goal from T_(i-1)_goal."""

    def turned(x, y, z):
        return _sum(joint.cos, x, joint.sin, y), _sum(joint.cos, y, -joint.sin, x), z

    def tilted(x, y, z):
        s, c = link.sin_alpha, link.cos_alpha
        return x, _sum(c, y, s, z), _sum(c, z, -s, y)

    columns = (tilted(*turned(*column)) for column in vector.transpose(goal.rotation))
    x, y, z = turned(*goal.position)
    return Pose(vector.transpose(tuple(columns)), tilted(plus(x, -link.a), y, plus(z, -joint.d)))


def strip(goal: Pose, link: Link, joint: Joint) -> Pose:
    """The goal with its last link taken off: T_0_(i-1) from T_0_i."""
    x, y, z = vector.transpose(goal.rotation)
    s, c = link.sin_alpha, link.cos_alpha
    y, z = _mix(c, y, -s, z), _mix(s, y, c, z)
    step = _mix(link.a, x, joint.d, z)
    x, y = _mix(joint.cos, x, -joint.sin, y), _mix(joint.sin, x, joint.cos, y)
    return Pose(vector.transpose((x, y, z)), vector.subtract(goal.position, step))


def _sum(a: Scalar, u: Scalar, b: Scalar, v: Scalar) -> Scalar:
    """a u + b v of scalars."""
    return plus(times(a, u), times(b, v))


def _mix(a: Scalar, u: vector.Vector, b: Scalar, v: vector.Vector) -> vector.Vector:
    """a u + b v of vectors."""
    return vector.add(vector.scale(a, u), vector.scale(b, v))


def corrections(arm: Arm) -> tuple[Pose, ...] | None:
    """What the arm as given is off by after the base and after each link, as poses; None if nothing."""
    if arm.correction is None:
        return None
    return tuple(_small_pose(numbers(arm.correction[i])) for i in range(arm.n + 1))


def _small_pose(twist: tuple[Scalar, ...]) -> Pose:
    """The pose of a shift and a rotation vector; the series are exact to 1e-16 up to 0.05 rad.

    Source: Rodrigues' formula, with the Taylor series of sin(t) / t and (1 - cos(t)) / t^2.
    """
    x, y, z = twist[3:]
    square = x * x + y * y + z * z
    first = 1 - square / 6 * (1 - square / 20 * (1 - square / 42))
    second = (1 - square / 12 * (1 - square / 30 * (1 - square / 56))) / 2
    rotation = (
        (1 - second * (y * y + z * z), second * x * y - first * z, second * x * z + first * y),
        (second * x * y + first * z, 1 - second * (x * x + z * z), second * y * z - first * x),
        (second * x * z - first * y, second * y * z + first * x, 1 - second * (x * x + y * y)),
    )
    return Pose(rotation, tuple(twist[:3]))


def coupled(arm: Arm, q: tuple[Scalar, ...]) -> tuple[Scalar, ...]:
    """Joint values from motor values."""
    if arm.coupling is None:
        return q
    rows = [numbers(arm.coupling[i]) for i in range(arm.n)]
    return tuple(functools.reduce(plus, map(times, row, q)) for row in rows)


def whole_turns(arm: Arm) -> tuple[bool | jax.Array, ...]:
    """For each entry of q, whether a whole turn leaves the pose as it is.

    It does for a revolute joint; for a motor that drives several joints, where it turns all of them by
    whole turns and slides none (a screw slides one).
    """
    if arm.coupling is None:
        return tuple(kind == "R" for kind in arm.kinds)

    def odd(kind: str, share: Scalar) -> Scalar:
        """What a unit of the motor moves the joint by, less whole turns."""
        nearest = round(share) if isinstance(share, float) else jnp.round(share)
        return share - nearest if kind == "R" else share

    columns = [numbers(arm.coupling[:, i]) for i in range(arm.n)]
    odds = [[odd(kind, share) for kind, share in zip(arm.kinds, column, strict=True)] for column in columns]
    return tuple(
        functools.reduce(operator.and_, [x == 0 for x in odd], kind == "R")
        for kind, odd in zip(arm.kinds, odds, strict=True)
    )


class Chain(NamedTuple):
    """All frames of an arm at joint values q, in scalars and in the world."""

    before: list[Pose]
    """The frame before each joint, the base first."""
    ends: list[Pose]
    """The frame after each link of the table, before the correction there."""
    last: Pose
    """The frame that the tool is mounted on."""


def chain(arm: Arm, q: tuple[Scalar, ...] | jax.Array) -> Chain:
    """Every frame at joint values q. Each is pinned, because all later frames need it.

    Of joints in one array (n, ...) the numbers of the frames are (1, ...).
    """
    frame, off = fixed_pose(arm.base), corrections(arm)
    frame = frame if off is None else poses.compose(frame, off[0])
    before, ends, table = [], [], links(arm)
    for i, (link, joint) in enumerate(zip(table, _joint_values(arm, table, q), strict=True)):
        before.append(frame)
        ends.append(pin_all(advance(frame, link, joint)))
        frame = ends[-1] if off is None else pin_all(poses.compose(ends[-1], off[i + 1]))
    return Chain(before, ends, frame)


def _joint_values(arm: Arm, table: tuple[Link, ...], q: tuple[Scalar, ...] | jax.Array) -> list[Joint]:
    """The value of each joint, its sine and cosine pinned."""
    values = coupled(arm, tuple(q[i : i + 1] for i in range(arm.n)) if isinstance(q, jax.Array) else q)
    pairs = list(zip(table, values, strict=True))
    angles = [link.theta + value if link.kind == "R" else link.theta for link, value in pairs]
    slides = [link.d + value if link.kind == "P" else link.d for link, value in pairs]
    if isinstance(q, tuple) or set(arm.kinds) != {"R"}:
        turns = [known_sincos(x) if isinstance(x, float) else sincos(x) for x in angles]
        return [Joint(pin(s), pin(c), d) for (s, c), d in zip(turns, slides, strict=True)]
    # The sines of all joints are one computation.
    sines, cosines = pin_all(sincos(jnp.concatenate(angles)))
    return [Joint(sines[i : i + 1], cosines[i : i + 1], d) for i, d in enumerate(slides)]


def columns_of(q: jax.Array) -> tuple[jax.Array, ...]:
    """One array (...) for each joint."""
    return tuple(q[..., i] for i in range(q.shape[-1]))


def check_joints(arm: Arm, q: ArrayInput) -> jax.Array:
    """q as an array of the arm's type, (..., n).

    Raises:
        ValueError: Another shape.
    """
    values = as_array(q, arm.dtype)
    if values.ndim == 0 or values.shape[-1] != arm.n:
        raise ValueError(f"q must have shape (..., {arm.n}) for {arm.name}, got {values.shape}")
    return values


def fk(arm: Arm, q: ArrayInput) -> jax.Array:
    """The pose of the tool: forward kinematics of the arm as given, its `correction` included.

    Differentiable in `q` and in the leaves of the arm.

    Args:
        arm: The arm; it needs no family.
        q: Joint values [rad, m], (..., n); of coupled joints, motor values.

    Returns:
        T_world_tool, (..., 4, 4), of the floating type of the arm.

    Raises:
        ValueError: q of another length.

    Source: Spong, Robot Modeling and Control, equation (3.10).
    """
    values, arm = check_joints(arm, q), arm.baked()
    last = chain(arm, columns_of(values)).last
    return poses.to_matrix(poses.compose(last, fixed_pose(arm.tool)))


def frames(arm: Arm, q: ArrayInput) -> jax.Array:
    """The frames of the base and of every link, its `correction` included.

    Args:
        arm: The arm; it needs no family.
        q: Joint values [rad, m], (..., n); of coupled joints, motor values.

    Returns:
        T_world_link, (..., n + 1, 4, 4): the base first, then the frame after each link. Joint i turns about
        or slides along the z axis of frame i. The tool is left out.

    Raises:
        ValueError: q of another length.

    Source: Spong, Robot Modeling and Control, equation (3.10).
    """
    values, arm = check_joints(arm, q), arm.baked()
    zero = jnp.zeros_like(values[..., 0])
    placed = chain(arm, columns_of(values))
    # The base is one frame for all of q: the zeros give every scalar the shape of a joint.
    spread = [jax.tree.map(lambda x: x + zero, frame) for frame in (*placed.before, placed.last)]
    return jnp.stack([poses.to_matrix(frame) for frame in spread], axis=-3)


def reach(arm: Arm) -> Scalar:
    """Sum of the lengths in the table and the tool [m].

    While all slides are at zero, no tool point is further from the base.

    It is also the unit of length of kernels and tolerances. An arm without lengths (a wrist alone, a gantry)
    has 1 m: there is nothing else to compare with.
    """
    tool = fixed_pose(arm.tool).position
    total = sum(abs(x) for link in links(arm) for x in (link.a, link.d)) + sum(abs(x) for x in tool)
    return total or 1.0 if isinstance(total, int | float) else jnp.where(total > 0, total, 1)
