"""Rigid poses: in scalars inside kernels, as (..., 4, 4) arrays at the door.

Storey: core. `T_a_b` maps coordinates in frame b to coordinates in frame a, so that neighbours
cancel when read: T_base_tool = T_base_elbow @ T_elbow_tool.
Source of the angle conventions: Craig, Introduction to Robotics, 3rd ed., section 2.8.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ikjax.core import safe, vector
from ikjax.core.trig import Scalar, atan2, sincos
from ikjax.core.vector import Matrix, Vector


class Pose(NamedTuple):
    """A rigid motion in scalars: rotation (three rows) and position [m]."""

    rotation: Matrix
    position: Vector


IDENTITY = Pose(vector.IDENTITY, vector.ORIGIN)


def compose(first: Pose, second: Pose) -> Pose:
    """T_a_c from T_a_b and T_b_c."""
    return Pose(
        vector.matmul(first.rotation, second.rotation),
        vector.add(vector.rotate(first.rotation, second.position), first.position),
    )


def inverse(pose: Pose) -> Pose:
    """T_b_a from T_a_b."""
    back = vector.transpose(pose.rotation)
    return Pose(back, vector.scale(-1, vector.rotate(back, pose.position)))


def from_matrix(matrix) -> Pose:
    """The scalars of a (..., 4, 4) array, each of shape (...). The bottom row is not looked at."""
    rows = tuple(tuple(matrix[..., i, j] for j in range(3)) for i in range(3))
    return Pose(rows, tuple(matrix[..., i, 3] for i in range(3)))


def to_matrix(pose: Pose) -> jax.Array:
    """The (..., 4, 4) array of a pose whose scalars have shape (...)."""
    scalars = [*(c for row in pose.rotation for c in row), *pose.position]
    scalars = list(jnp.broadcast_arrays(*scalars))
    zero, one = jnp.zeros_like(scalars[0]), jnp.ones_like(scalars[0])
    rows = [[*scalars[3 * i : 3 * i + 3], scalars[9 + i]] for i in range(3)]
    rows.append([zero, zero, zero, one])
    return jnp.stack([jnp.stack(row, axis=-1) for row in rows], axis=-2)


def rigid(matrix) -> jax.Array:
    """A pose (..., 4, 4) whose rotation was rounded, with a rotation again."""
    pose = from_matrix(matrix)
    return to_matrix(Pose(vector.orthonormal(pose.rotation), pose.position))


def difference(first: Pose, second: Pose) -> tuple[Scalar, Scalar]:
    """Distance [m] and angle [rad] between two poses, in scalars.

    The angle is right to rounding everywhere, at zero and at pi too; both slopes are finite.
    Source: angle = atan2(|vee(M)|, (trace(M) - 1) / 2) with M = A^T B.
    """
    turn = vector.matmul(vector.transpose(first.rotation), second.rotation)
    vee = (turn[2][1] - turn[1][2], turn[0][2] - turn[2][0], turn[1][0] - turn[0][1])
    trace = turn[0][0] + turn[1][1] + turn[2][2]
    gap = vector.norm(vector.subtract(first.position, second.position))
    return gap, atan2(vector.norm(vee) / 2, (trace - 1) / 2)


def pose_error(first, second) -> tuple[jax.Array, jax.Array]:
    """Distance [m] and angle [rad] between poses.

    Args:
        first, second: (..., 4, 4), of shapes that broadcast.

    Returns:
        Two arrays (...). The angle lies in [0, pi] and is right to rounding at both ends.
    """
    first, second = jnp.broadcast_arrays(jnp.asarray(first), jnp.asarray(second))
    return difference(from_matrix(first), from_matrix(second))


def _components(name: str, value, count: int, dtype) -> tuple[jax.Array, ...]:
    value = jnp.asarray(value, dtype)
    if value.ndim == 0 or value.shape[-1] != count:
        raise ValueError(f"{name} must have shape (..., {count}), got {value.shape}")
    return tuple(value[..., i] for i in range(count))


def _from_rpy(rpy: Vector) -> Matrix:
    (sr, cr), (sp, cp), (sy, cy) = (sincos(angle) for angle in rpy)
    return (
        (cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr),
        (sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr),
        (-sp, cp * sr, cp * cr),
    )


def from_quaternion(wxyz: tuple[Scalar, ...]) -> Matrix:
    """The rotation of a quaternion (w, x, y, z); its length does not matter, zero gives zeros."""
    w, x, y, z = wxyz
    s = safe.divide(2, w * w + x * x + y * y + z * z)
    return (
        (1 - s * (y * y + z * z), s * (x * y - w * z), s * (x * z + w * y)),
        (s * (x * y + w * z), 1 - s * (x * x + z * z), s * (y * z - w * x)),
        (s * (x * z - w * y), s * (y * z + w * x), 1 - s * (x * x + y * y)),
    )


def to_quaternion(m: Matrix) -> tuple[Scalar, ...]:
    """The quaternion (w, x, y, z) of a rotation, of length 1, with either sign.

    The largest component is the one that is divided by, so that none loses digits.
    Source: Shepperd, Quaternion from rotation matrix (1978).
    """
    (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = m
    w, x, y, z = 1 + xx + yy + zz, 1 + xx - yy - zz, 1 - xx + yy - zz, 1 - xx - yy + zz
    by_w, by_x = (w, zy - yz, xz - zx, yx - xy), (zy - yz, x, xy + yx, xz + zx)
    by_y, by_z = (xz - zx, xy + yx, y, yz + zy), (yx - xy, xz + zx, yz + zy, z)
    in_plane = [jnp.where(xx > yy, u, v) for u, v in zip(by_x, by_y, strict=True)]
    along = [jnp.where(xx < -yy, u, v) for u, v in zip(by_z, by_w, strict=True)]
    best = [jnp.where(zz < 0, u, v) for u, v in zip(in_plane, along, strict=True)]
    per = safe.reciprocal_sqrt(sum(c * c for c in best))
    return tuple(per * c for c in best)


class Turn(NamedTuple):
    """A rotation as a vector, and what its slopes are made of."""

    vector: Vector
    """Along the axis, as long as the angle in [0, pi] [rad]."""
    shrink: Scalar
    """(angle / 2) cot(angle / 2): 1 at zero, 0 at pi."""
    bend: Scalar
    """(1 - shrink) / angle^2."""

    def rate(self, spin: Vector) -> Vector:
        """Of the vector, while the rotation is turned on from the left at an angular velocity."""
        ahead = vector.scale(self.bend * vector.dot(self.vector, spin), self.vector)
        aside = vector.scale(-0.5, vector.cross(self.vector, spin))
        return vector.add(vector.scale(self.shrink, spin), vector.add(ahead, aside))


def turn_of(m: Matrix, hold: Callable[[Scalar], Scalar] = lambda x: x) -> Turn:
    """The rotation as a vector, right to rounding at every angle; its slopes have their limits at zero.

    `hold` is called on what many outputs share; see `ik.graph`.

    Source: the logarithm of a rotation; Sola et al., A micro Lie theory (2018), (144)-(145).
    """
    w, x, y, z = map(hold, to_quaternion(m))
    side = safe.sign(w)
    w, rest = side * w, (side * x, side * y, side * z)
    square = hold(vector.dot(rest, rest))
    # Where half the angle is so small, the first terms of its series are exact.
    small = square < jnp.finfo(square.dtype).eps
    size = safe.sqrt(jnp.where(small, 1, square))
    half = hold(atan2(size, jnp.where(small, 1, w)))
    factor = hold(jnp.where(small, 2 + square / 3, 2 * half / size))
    shrink = hold(jnp.where(small, 1 - square / 3, half * w / size))
    bend = hold(jnp.where(small, 1 / 12, (1 - shrink) / (4 * half * half)))
    return Turn(tuple(hold(factor * c) for c in rest), shrink, bend)


def pose(xyz=(0.0, 0.0, 0.0), *, rpy=None, wxyz=None, matrix=None, dtype=None) -> jax.Array:
    """A pose as (..., 4, 4), from a position and at most one form of orientation.

    Args:
        xyz: Position [m], (..., 3).
        rpy: Roll, pitch, yaw about the fixed axes x, y, z in that order [rad], (..., 3):
            R = Rz(yaw) Ry(pitch) Rx(roll).
        wxyz: Quaternion, (..., 4), scalar first. Its length may be off by 1e-3.
        matrix: Rotation, (..., 3, 3).
        dtype: Of the result; by default what the inputs give.

    Raises:
        ValueError: Wrong shapes, more than one orientation, a quaternion of length far from 1.
    """
    given = {"rpy": rpy, "wxyz": wxyz, "matrix": matrix}
    given = {name: value for name, value in given.items() if value is not None}
    if len(given) > 1:
        raise ValueError(f"give one orientation, got {' and '.join(given)}")
    if dtype is None:
        dtype = jnp.result_type(float, *(jnp.asarray(v) for v in (xyz, *given.values())))
    position = _components("xyz", xyz, 3, dtype)
    if rpy is not None:
        rotation = _from_rpy(_components("rpy", rpy, 3, dtype))
    elif wxyz is not None:
        _check_quaternion(wxyz)
        rotation = from_quaternion(_components("wxyz", wxyz, 4, dtype))
    elif matrix is not None:
        matrix = jnp.asarray(matrix, dtype)
        if matrix.shape[-2:] != (3, 3):
            raise ValueError(f"matrix must have shape (..., 3, 3), got {matrix.shape}")
        rotation = tuple(tuple(matrix[..., i, j] for j in range(3)) for i in range(3))
    else:
        rotation = tuple(tuple(jnp.asarray(c, dtype) for c in row) for row in vector.IDENTITY)
    return to_matrix(Pose(rotation, position))


def _check_quaternion(wxyz) -> None:
    if isinstance(wxyz, jax.core.Tracer):
        return  # values are unknown while tracing; `solve` masks what is no rotation
    length = np.linalg.norm(np.asarray(wxyz, float), axis=-1)
    worst = float(np.max(np.abs(length - 1), initial=0.0))
    if not worst <= 1e-3:
        raise ValueError(f"wxyz must have length 1 within 1e-3, it is off by {worst:.2g}")


def planar_pose(x, y, phi, *, dtype=None) -> jax.Array:
    """The goal (x, y, phi) of a planar arm as (..., 4, 4): position [m], a turn phi about z [rad]."""
    x, y, phi = jnp.broadcast_arrays(*(jnp.asarray(v, dtype) for v in (x, y, phi)))
    zero = jnp.zeros_like(x)
    return pose(jnp.stack([x, y, zero], axis=-1), rpy=jnp.stack([zero, zero, phi], axis=-1), dtype=dtype)


def position(x, y, z, *, dtype=None) -> jax.Array:
    """A goal with no orientation to speak of, as (..., 4, 4): position [m], rotation identity."""
    xyz = jnp.broadcast_arrays(*(jnp.asarray(v, dtype) for v in (x, y, z)))
    return pose(jnp.stack(xyz, axis=-1), dtype=dtype)
