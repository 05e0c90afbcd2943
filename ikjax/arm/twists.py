"""How the tool moves when a joint moves, and when a number of the arm itself does: twists, and `jacobian`.

In scalars, in the world frame, at the tool point.
Source: Spong, Robot Modeling and Control, equations (4.56)-(4.57); each number of a DH table turns or
shifts all that comes after it about an axis of its frame, as a joint does.
"""

import functools
from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp

from ikjax.arm.arm import Arm, numbers
from ikjax.arm.forward import Chain, fixed_pose, fk, frames
from ikjax.core import safe, vector
from ikjax.core.pose import Pose
from ikjax.core.trig import Scalar
from ikjax.core.vector import Matrix, Vector, plus, times


class Twist(NamedTuple):
    """A velocity."""

    linear: Vector
    """Of the tool point."""
    angular: Vector

    def plus(self, other: "Twist") -> "Twist":
        return Twist(vector.add(self.linear, other.linear), vector.add(self.angular, other.angular))

    def times(self, factor: Scalar) -> "Twist":
        return Twist(vector.scale(factor, self.linear), vector.scale(factor, self.angular))


STILL = Twist((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))


def turning(axis: Vector, point: Vector, tip: Vector) -> Twist:
    """About an axis through a point, at one radian a second."""
    return Twist(vector.cross(axis, vector.subtract(tip, point)), axis)


def sliding(axis: Vector) -> Twist:
    return Twist(axis, (0.0, 0.0, 0.0))


def spin(rotation: Matrix, rate: Matrix) -> Vector:
    """Angular velocity from the rates of a rotation's entries."""
    # Half the sum of the columns' cross products.
    pairs = zip(vector.transpose(rotation), vector.transpose(rate), strict=True)
    turns = [vector.cross(column, moved) for column, moved in pairs]
    return vector.scale(0.5, vector.add(vector.add(turns[0], turns[1]), turns[2]))


def of_joints(arm: Arm, found: Chain, tip: Vector) -> list[Twist]:
    """Of the tool for a unit rate of each joint, couplings aside."""
    twists = []
    for kind, frame in zip(arm.kinds, found.before, strict=True):
        axis = _axis(frame, 2)
        twists.append(sliding(axis) if kind == "P" else turning(axis, frame.position, tip))
    return twists


def of_motors(arm: Arm, found: Chain, tip: Vector) -> list[Twist]:
    """Of the tool for a unit rate of each entry of q: the columns of the Jacobian."""
    twists = of_joints(arm, found, tip)
    if arm.coupling is None:
        return twists
    return [_sum(twists, numbers(arm.coupling[:, i])) for i in range(arm.n)]


def asked(arm: Arm, found: Chain, per_length: Scalar) -> Callable[[Twist], tuple[Scalar, ...]]:
    """What the task asks of a velocity, in its rows, linear ones first and times `per_length` [1/m]."""

    def rows(twist: Twist) -> tuple[Scalar, ...]:
        linear, angular = vector.scale(per_length, twist.linear), twist.angular
        if arm.task == "pose":
            return (*linear, *angular)
        if arm.task == "position":
            return linear
        x, y, up = plane(arm, found)
        ahead = vector.dot(x, linear), vector.dot(y, linear)
        return ahead if arm.task == "planar_position" else (*ahead, vector.dot(up, angular))

    return rows


def plane(arm: Arm, found: Chain) -> tuple[Vector, Vector, Vector]:
    """Two directions of the plane that a planar arm moves in, and the one square to it."""
    axes = [_axis(frame, 2) for frame in found.before]
    x = _axis(found.before[0], 0) if arm.kinds[0] == "R" else axes[0]
    up = axes[arm.kinds.index("R")] if "R" in arm.kinds else vector.cross(axes[0], axes[1])
    up = vector.scale(safe.reciprocal_sqrt(vector.dot(up, up)), up)
    return x, vector.cross(up, x), up


def of_numbers(arm: Arm, rates: Arm, q: tuple[Scalar, ...], found: Chain, tip: Vector) -> Twist:
    """Of the tool at joints that stand still, while the arm's own numbers change at given rates.

    Rates of `base` and `tool` are read as velocities of a rigid body, whatever else their entries hold.
    """
    total = _mounted(fixed_pose(arm.base), fixed_pose(rates.base), None, tip)
    total = total.plus(_mounted(fixed_pose(arm.tool), fixed_pose(rates.tool), found.last, tip))
    table = zip(*map(numbers, (rates.d, rates.a, rates.theta, rates.alpha)), strict=True)
    for before, end, (d, a, theta, alpha) in zip(found.before, found.ends, table, strict=True):
        z, x = _axis(before, 2), _axis(end, 0)
        total = total.plus(sliding(z).times(d)).plus(sliding(x).times(a))
        total = total.plus(turning(z, before.position, tip).times(theta))
        total = total.plus(turning(x, end.position, tip).times(alpha))
    if arm.coupling is not None and rates.coupling is not None:
        moves = [functools.reduce(plus, map(times, numbers(rates.coupling[i]), q)) for i in range(arm.n)]
        total = total.plus(_sum(of_joints(arm, found, tip), moves))
    if arm.correction is not None and rates.correction is not None:
        starts = [fixed_pose(arm.base), *found.ends]
        stands = [*found.before, found.last]
        for i, (start, end) in enumerate(zip(starts, stands, strict=True)):
            row, rate = numbers(arm.correction[i]), numbers(rates.correction[i])
            shift = vector.rotate(start.rotation, rate[:3])
            turn = vector.rotate(start.rotation, _rate_of_turn(row[3:], rate[3:]))
            total = total.plus(sliding(shift)).plus(turning(turn, end.position, tip))
    return total


def _mounted(fixed: Pose, rate: Pose, on: Pose | None, tip: Vector) -> Twist:
    """Of the tool, while a fixed pose changes that is mounted on a frame."""
    shift, turn, origin = rate.position, spin(fixed.rotation, rate.rotation), fixed.position
    if on is not None:
        shift, turn = vector.rotate(on.rotation, shift), vector.rotate(on.rotation, turn)
        origin = vector.add(on.position, vector.rotate(on.rotation, origin))
    return sliding(shift).plus(turning(turn, origin, tip))


def _rate_of_turn(r: Vector, rate: Vector) -> Vector:
    """Angular velocity of the rotation of a small vector r; the series is exact to 1e-16 up to 0.05 rad."""
    total, term = rate, rate
    for k in range(2, 9):
        term = vector.scale(1 / k, vector.cross(r, term))
        total = vector.add(total, term)
    return total


def _axis(frame: Pose, which: int) -> Vector:
    return frame.rotation[0][which], frame.rotation[1][which], frame.rotation[2][which]


def _sum(twists: list[Twist], shares) -> Twist:
    pairs = zip(twists, shares, strict=True)
    return functools.reduce(Twist.plus, (twist.times(share) for twist, share in pairs), STILL)


def jacobian(arm: Arm, q) -> jax.Array:
    """Velocity of the tool for unit joint rates.

    Args:
        arm: The arm.
        q: Joint values [rad, m], (..., n).

    Returns:
        (..., 6, n) in the world frame: three linear rows [m/s] for the tool point, then three
        angular rows [rad/s].
    """
    before = frames(arm, q)[..., :-1, :, :]
    axis, origin = before[..., :3, 2], before[..., :3, 3]
    tip = fk(arm, q)[..., None, :3, 3]
    turning = jnp.concatenate([jnp.cross(axis, tip - origin), axis], axis=-1)
    sliding = jnp.concatenate([axis, jnp.zeros_like(axis)], axis=-1)
    revolute = jnp.asarray([[kind == "R"] for kind in arm.kinds])
    columns = jnp.where(jnp.broadcast_to(revolute, turning.shape), turning, sliding)
    columns = jnp.swapaxes(columns, -1, -2)
    return columns if arm.coupling is None else jnp.matmul(columns, jnp.asarray(arm.coupling))
