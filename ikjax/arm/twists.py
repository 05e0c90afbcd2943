"""Velocities of the tool: of a joint that moves, of an arm's parameter that changes; and `jacobian`.

Twists are in scalars, in the world frame, at the tool point. Kernels use them; `jacobian` is for arrays.

Source: Spong, Robot Modeling and Control, equations (4.56)-(4.57); each number of a DH table turns or
shifts all that comes after it about an axis of its frame, as a joint does.
"""

import functools
from collections.abc import Callable, Iterable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ikjax.arm.arm import Arm, numbers
from ikjax.arm.forward import Chain, chain, check_joints, columns_of, fixed_pose
from ikjax.core import pose as poses
from ikjax.core import safe, vector
from ikjax.core.pose import Pose
from ikjax.core.trig import Scalar
from ikjax.core.typing import ArrayInput
from ikjax.core.vector import Matrix, Vector, plus, times


class Twist(NamedTuple):
    """A velocity of the tool."""

    linear: Vector
    """Of the tool point [m/s]."""
    angular: Vector
    """[rad/s]"""

    def plus(self, other: "Twist") -> "Twist":
        return Twist(vector.add(self.linear, other.linear), vector.add(self.angular, other.angular))

    def times(self, factor: Scalar) -> "Twist":
        return Twist(vector.scale(factor, self.linear), vector.scale(factor, self.angular))


ZERO = Twist((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))


def revolute_twist(axis: Vector, point: Vector, tip: Vector) -> Twist:
    """The twist of a unit rotation about an axis through a point."""
    return Twist(vector.cross(axis, vector.subtract(tip, point)), axis)


def prismatic_twist(axis: Vector) -> Twist:
    """The twist of a unit translation along an axis."""
    return Twist(axis, (0.0, 0.0, 0.0))


def angular_velocity(rotation: Matrix, rate: Matrix) -> Vector:
    """Angular velocity from the derivatives of a rotation's entries."""
    # A column c moves by w x c, and the sum of c x (w x c) over three orthonormal columns is 2 w.
    pairs = zip(vector.transpose(rotation), vector.transpose(rate), strict=True)
    products = [vector.cross(column, moved) for column, moved in pairs]
    return vector.scale(0.5, vector.add(vector.add(products[0], products[1]), products[2]))


def joint_twists(arm: Arm, chain: Chain, tip: Vector) -> list[Twist]:
    """Twists of the tool for a unit rate of each joint, without the coupling.

    Source: Spong, Robot Modeling and Control, equations (4.56)-(4.57).
    """
    twists = []
    for kind, frame in zip(arm.kinds, chain.before, strict=True):
        axis = _axis(frame, 2)
        twists.append(prismatic_twist(axis) if kind == "P" else revolute_twist(axis, frame.position, tip))
    return twists


def stacked_twists(arm: Arm, chain: Chain, tip: Vector, q: jax.Array) -> Twist:
    """`joint_twists` as one, each component an array of the shape of q (n, ...).

    The numbers of the chain and of the tip are (1, ...).
    """

    def stacked(numbers: Iterable[Scalar]) -> jax.Array:
        return jnp.concatenate(
            [jnp.broadcast_to(jnp.asarray(x, q.dtype), (1, *q.shape[1:])) for x in numbers]
        )

    axis, point = (
        tuple(map(stacked, zip(*vectors, strict=True)))
        for vectors in ([_axis(x, 2) for x in chain.before], [x.position for x in chain.before])
    )
    turning = revolute_twist(axis, point, tip)
    if "P" not in arm.kinds:
        return turning
    slides = np.array([kind == "P" for kind in arm.kinds]).reshape(-1, *[1] * (q.ndim - 1))
    linear = tuple(jnp.where(slides, x, y) for x, y in zip(axis, turning.linear, strict=True))
    return Twist(linear, tuple(jnp.where(slides, 0, x) for x in axis))


def motor_twists(arm: Arm, chain: Chain, tip: Vector) -> list[Twist]:
    """Twists of the tool for a unit rate of each entry of q: the columns of the Jacobian."""
    twists = joint_twists(arm, chain, tip)
    if arm.coupling is None:
        return twists
    return [_sum(twists, numbers(arm.coupling[:, i])) for i in range(arm.n)]


def task_rows(arm: Arm, chain: Chain, per_length: Scalar) -> Callable[[Twist], tuple[Scalar, ...]]:
    """A function from a twist to the rows that the task controls, the linear ones first.

    Args:
        arm: Its task decides which rows.
        chain: The arm's frames; a planar task needs the plane.
        per_length: What the linear rows are multiplied by [1/m], so that all rows have one unit.
    """

    def rows(twist: Twist) -> tuple[Scalar, ...]:
        linear, angular = vector.scale(per_length, twist.linear), twist.angular
        if arm.task == "pose":
            return (*linear, *angular)
        if arm.task == "position":
            return linear
        x, y, normal = task_plane(arm, chain)
        within = vector.dot(x, linear), vector.dot(y, linear)
        return within if arm.task == "planar_position" else (*within, vector.dot(normal, angular))

    return rows


def task_plane(arm: Arm, chain: Chain) -> tuple[Vector, Vector, Vector]:
    """Two perpendicular unit vectors in the plane that a planar arm moves in, and its normal."""
    axes = [_axis(frame, 2) for frame in chain.before]
    x = _axis(chain.before[0], 0) if arm.kinds[0] == "R" else axes[0]
    normal = axes[arm.kinds.index("R")] if "R" in arm.kinds else vector.cross(axes[0], axes[1])
    normal = vector.scale(safe.reciprocal_sqrt(vector.dot(normal, normal)), normal)
    return x, vector.cross(normal, x), normal


def parameter_twist(arm: Arm, rates: Arm, q: tuple[Scalar, ...], chain: Chain, tip: Vector) -> Twist:
    """The twist of the tool at fixed q, while the arm's own parameters change at given rates.

    Args:
        arm: The arm.
        rates: The derivative of each leaf. Those of `base` and `tool` are read as velocities of a rigid body,
            whatever else their entries hold.
        q: Joint values; of coupled joints, motor values.
        chain: The arm's frames there.
        tip: The tool point.
    """
    total = _mounted(fixed_pose(arm.base), fixed_pose(rates.base), None, tip)
    total = total.plus(_mounted(fixed_pose(arm.tool), fixed_pose(rates.tool), chain.last, tip))
    table = zip(*map(numbers, (rates.d, rates.a, rates.theta, rates.alpha)), strict=True)
    for before, end, (d, a, theta, alpha) in zip(chain.before, chain.ends, table, strict=True):
        z, x = _axis(before, 2), _axis(end, 0)
        total = total.plus(prismatic_twist(z).times(d)).plus(prismatic_twist(x).times(a))
        total = total.plus(revolute_twist(z, before.position, tip).times(theta))
        total = total.plus(revolute_twist(x, end.position, tip).times(alpha))
    if arm.coupling is not None and rates.coupling is not None:
        moves = [functools.reduce(plus, map(times, numbers(rates.coupling[i]), q)) for i in range(arm.n)]
        total = total.plus(_sum(joint_twists(arm, chain, tip), moves))
    if arm.correction is not None and rates.correction is not None:
        uncorrected = [fixed_pose(arm.base), *chain.ends]
        corrected = [*chain.before, chain.last]
        for i, (start, end) in enumerate(zip(uncorrected, corrected, strict=True)):
            row, rate = numbers(arm.correction[i]), numbers(rates.correction[i])
            shift = vector.rotate(start.rotation, rate[:3])
            turn = vector.rotate(start.rotation, _rate_of_turn(row[3:], rate[3:]))
            total = total.plus(prismatic_twist(shift)).plus(revolute_twist(turn, end.position, tip))
    return total


def _mounted(fixed: Pose, rate: Pose, on: Pose | None, tip: Vector) -> Twist:
    """The twist of the tool while a pose of the arm changes that is fixed to a frame, or to the world."""
    shift, turn, origin = rate.position, angular_velocity(fixed.rotation, rate.rotation), fixed.position
    if on is not None:
        shift, turn = vector.rotate(on.rotation, shift), vector.rotate(on.rotation, turn)
        origin = vector.add(on.position, vector.rotate(on.rotation, origin))
    return prismatic_twist(shift).plus(revolute_twist(turn, origin, tip))


def _rate_of_turn(r: Vector, rate: Vector) -> Vector:
    """Angular velocity of the rotation of a small vector r: its left Jacobian times the vector's rate.

    The series, the sum of [r]x^k rate / (k + 1)!, is exact to 1e-16 up to 0.05 rad.
    """
    total, term = rate, rate
    for k in range(2, 9):
        term = vector.scale(1 / k, vector.cross(r, term))
        total = vector.add(total, term)
    return total


def _axis(frame: Pose, which: int) -> Vector:
    """An axis of a frame: 0 is x, 2 is z."""
    return frame.rotation[0][which], frame.rotation[1][which], frame.rotation[2][which]


def _sum(twists: list[Twist], shares) -> Twist:
    """The sum of the twists, each times its share."""
    pairs = zip(twists, shares, strict=True)
    return functools.reduce(Twist.plus, (twist.times(share) for twist, share in pairs), ZERO)


def jacobian(arm: Arm, q: ArrayInput) -> jax.Array:
    """The geometric Jacobian: velocity of the tool for unit joint rates.

    Args:
        arm: The arm; it needs no family.
        q: Joint values [rad, m], (..., n); of coupled joints, motor values.

    Returns:
        (..., 6, n) in the world frame: three linear rows [m/s] for the tool point, then three
        angular rows [rad/s]. A column is for 1 rad/s of a revolute joint, 1 m/s of a prismatic one.

    Raises:
        ValueError: q of another length.

    Source: Spong, Robot Modeling and Control, equations (4.56)-(4.57).
    """
    values, arm = check_joints(arm, q), arm.baked()
    kinematics = chain(arm, columns_of(values))
    tip = poses.compose(kinematics.last, fixed_pose(arm.tool)).position
    zero = jnp.zeros_like(values[..., 0])
    twists = motor_twists(arm, kinematics, tip)
    rows = zip(*((*twist.linear, *twist.angular) for twist in twists), strict=True)
    return jnp.stack([jnp.stack([x + zero for x in row], axis=-1) for row in rows], axis=-2)
