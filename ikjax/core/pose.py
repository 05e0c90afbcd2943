"""Rigid poses: in scalars inside kernels, as (..., 4, 4) arrays in the public functions.

`T_a_b` maps coordinates in frame b to coordinates in frame a, so that neighbors
cancel when read: T_base_tool = T_base_elbow @ T_elbow_tool.
Source of the angle conventions: Craig, Introduction to Robotics, 3rd ed., section 2.8.
"""

from typing import Any, NamedTuple, Protocol

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import DTypeLike

from ikjax.core import safe, vector
from ikjax.core.tolerances import FARTHEST_GOAL, LARGEST_ENTRY, NEARLY_ROTATION, ROTATION
from ikjax.core.trig import Scalar, atan2, sincos
from ikjax.core.typing import ArrayInput
from ikjax.core.vector import Matrix, Vector
from ikjax.core.warn import warn_of_degrees
from ikjax.core.xla import pin, pin_all


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


def from_matrix(matrix: jax.Array | np.ndarray) -> Pose:
    """The scalars of a (..., 4, 4) array, each of shape (...). The bottom row is not read."""
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


def rigid(matrix: jax.Array | np.ndarray) -> jax.Array:
    """A pose (..., 4, 4) whose rotation was rounded, with an orthonormal rotation again."""
    pose = from_matrix(matrix)
    return to_matrix(Pose(vector.orthonormal(pose.rotation), pose.position))


def difference(first: Pose, second: Pose) -> tuple[Scalar, Scalar]:
    """Distance [m] and angle [rad] between two poses, in scalars.

    The angle is accurate to rounding everywhere, at zero and at pi too; both gradients are finite.

    Source: angle = atan2(|vee(M)|, (trace(M) - 1) / 2) with M = A^T B.
    """
    m = vector.matmul(vector.transpose(first.rotation), second.rotation)
    vee = (m[2][1] - m[1][2], m[0][2] - m[2][0], m[1][0] - m[0][1])
    trace = m[0][0] + m[1][1] + m[2][2]
    gap = vector.norm(vector.subtract(first.position, second.position))
    return gap, atan2(vector.norm(vee) / 2, (trace - 1) / 2)


def pose_error(first: ArrayInput, second: ArrayInput) -> tuple[jax.Array, jax.Array]:
    """Distance [m] and angle [rad] between poses.

    Both have a finite gradient everywhere, also where the poses are equal and where the angle is pi.

    Args:
        first, second: (..., 4, 4), of shapes that broadcast. They are not checked to be rigid, and the bottom
            rows are not read.

    Returns:
        The distance between the origins and the angle of the rotation between the frames, (...) each. The
        angle lies in [0, pi] and is accurate to rounding at both ends.

    Source: angle = atan2(|vee(M)|, (trace(M) - 1) / 2) with M = A^T B.
    """
    first, second = jnp.broadcast_arrays(jnp.asarray(first), jnp.asarray(second))
    return difference(from_matrix(first), from_matrix(second))


def _floating(*values: ArrayInput) -> np.dtype:
    """The floating type that values promote to; integers do not count."""
    arrays = map(jnp.asarray, values)
    return jnp.result_type(float, *(x for x in arrays if jnp.issubdtype(x.dtype, jnp.inexact)))


def _components(name: str, value: ArrayInput, count: int, dtype: DTypeLike) -> tuple[jax.Array, ...]:
    """The entries of the last axis, which has so many.

    Raises:
        ValueError: It has another number.
    """
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
    """The rotation of a quaternion (w, x, y, z); its length does not matter, and zero gives the identity."""
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


class RotationVector(NamedTuple):
    """A rotation vector r, and the coefficients of the inverse left Jacobian of the rotation group.

    The inverse is shrink I - [r]x / 2 + bend r r^T.
    """

    vector: Vector
    """Along the axis, as long as the angle in [0, pi] [rad]."""
    shrink: Scalar
    """(angle / 2) cot(angle / 2): 1 at zero, 0 at pi."""
    bend: Scalar
    """(1 - shrink) / angle^2."""

    def rate(self, spin: Vector) -> Vector:
        """The derivative of the vector while the rotation turns at an angular velocity in the fixed frame."""
        along = vector.scale(self.bend * vector.dot(self.vector, spin), self.vector)
        across = vector.scale(-0.5, vector.cross(self.vector, spin))
        return vector.add(vector.scale(self.shrink, spin), vector.add(along, across))


def rotation_vector(m: Matrix) -> RotationVector:
    """The rotation vector of a matrix, accurate to rounding at every angle.

    Near zero its derivatives are the limits there.

    Source: the logarithm of a rotation; Sola et al., A micro Lie theory (2018), (144)-(145).
    """
    w, x, y, z = pin_all(to_quaternion(m))
    # Of the two quaternions of a rotation the one with w >= 0 has the angle in [0, pi].
    side = safe.sign(w)
    w, rest = side * w, (side * x, side * y, side * z)
    square = pin(vector.dot(rest, rest))
    # Below it the first terms of each series are accurate to rounding.
    small = square < jnp.finfo(square.dtype).eps
    size = safe.sqrt(jnp.where(small, 1, square))
    half = pin(atan2(size, jnp.where(small, 1, w)))
    factor = pin(jnp.where(small, 2 + square / 3, 2 * half / size))
    shrink = pin(jnp.where(small, 1 - square / 3, half * w / size))
    bend = pin(jnp.where(small, 1 / 12, (1 - shrink) / (4 * half * half)))
    return RotationVector(pin_all(vector.scale(factor, rest)), shrink, bend)


def from_rotation_vector(v: Vector) -> Matrix:
    """The rotation about a vector by its length [rad]; near zero its derivatives are the limits there.

    Source: the exponential of a rotation; Sola et al., A micro Lie theory (2018), (132)-(133).
    """
    square = vector.dot(v, v)
    # Below it the first terms of each series are accurate to rounding.
    small = square < jnp.finfo(square.dtype).eps
    angle = safe.sqrt(jnp.where(small, 1, square))
    sine, cosine = sincos(angle / 2)
    factor = jnp.where(small, (1 - square / 24) / 2, sine / angle)
    return from_quaternion((jnp.where(small, 1 - square / 8, cosine), *vector.scale(factor, v)))


class HasMatrix(Protocol):
    """A rotation or pose of another library."""

    def as_matrix(self) -> ArrayInput:
        """(..., 3, 3) or (..., 4, 4)"""


def as_matrix(x: Any) -> Any:
    """The array that an object's method `as_matrix()` returns, or what is no such object as it is."""
    return x.as_matrix() if hasattr(x, "as_matrix") else x


def to_wxyz_xyz(poses: ArrayInput | HasMatrix) -> jax.Array:
    """Poses as quaternions and positions, the form of many other libraries.

    Args:
        poses: (..., 4, 4), or an object with a method `as_matrix()`. They are not checked to be rigid.

    Returns:
        (..., 7): w, x, y, z of a quaternion of length 1, of either sign; then x, y, z [m].
    """
    there = from_matrix(jnp.asarray(as_matrix(poses)))
    return jnp.stack([*to_quaternion(there.rotation), *there.position], axis=-1)


def pose(
    xyz: ArrayInput | None = None,
    *,
    rpy: ArrayInput | None = None,
    wxyz: ArrayInput | None = None,
    xyzw: ArrayInput | None = None,
    rotvec: ArrayInput | None = None,
    matrix: ArrayInput | HasMatrix | None = None,
    wxyz_xyz: ArrayInput | None = None,
    orthonormalize: bool = False,
    dtype: DTypeLike | None = None,
) -> jax.Array:
    """A pose as (..., 4, 4), from a position and at most one form of orientation.

    Position and orientation must have the same leading shape, or broadcast. Without an orientation the
    rotation is the identity.

    Args:
        xyz: Position [m], (..., 3); by default that of a (..., 4, 4) `matrix`, else zero.
        rpy: Roll, pitch, yaw about the fixed axes x, y, z in that order [rad], (..., 3):
            R = Rz(yaw) Ry(pitch) Rx(roll).
        wxyz: Quaternion, (..., 4), scalar first. Its length may be off by 1e-3.
        xyzw: The same with the scalar last.
        rotvec: Rotation vector [rad], (..., 3): the axis, as long as the angle.
        matrix: Rotation, (..., 3, 3), or whole pose, (..., 4, 4); taken as it is. Or (..., 9), a rotation
            row by row, as MuJoCo keeps `site_xmat`. Or an object whose method `as_matrix()` returns one, such
            as scipy's `Rotation` or jaxlie's `SE3`.
        wxyz_xyz: Whole pose, (..., 7): a quaternion as `wxyz`, then the position [m].
        orthonormalize: Replace the rotation of `matrix`, which may be off by 1e-2 (the norm of
            R^T R - I), by the nearest one. What is traced and off by more is left as it is: `solve` masks it.
        dtype: Of the result; by default the floating type of the inputs.

    Returns:
        The pose, (..., 4, 4). The length of a quaternion is divided out, and one of zeros, which only a
        traced one can be, gives the identity.

    Raises:
        ValueError: Wrong shapes, more than one orientation or position, a quaternion of length far
            from 1, a bottom row other than (0, 0, 0, 1), a matrix too far from a rotation to orthonormalize.

    Warns:
        Where an angle is beyond a whole turn, as degrees are.

    Source: Craig, Introduction to Robotics, 3rd ed., section 2.8; of `rotvec`, Sola et al., A micro Lie
    theory (2018), (132)-(133).
    """
    forms = {
        "rpy": rpy,
        "wxyz": wxyz,
        "xyzw": xyzw,
        "rotvec": rotvec,
        "matrix": as_matrix(matrix),
        "wxyz_xyz": wxyz_xyz,
    }
    given: dict[str, Any] = {name: value for name, value in forms.items() if value is not None}
    if len(given) > 1:
        raise ValueError(f"give one orientation, got {' and '.join(given)}")
    if orthonormalize and matrix is None:
        raise ValueError("orthonormalize goes with matrix=, which is not given")
    form, value = next(iter(given.items()), ("", ()))
    if dtype is None:
        dtype = _floating(*(v for v in (xyz, *given.values()) if v is not None))
    position = None if xyz is None else _components("xyz", xyz, 3, dtype)
    if form == "rpy":
        rotation = _from_rpy(_angles(form, value, dtype))
    elif form == "rotvec":
        rotation = from_rotation_vector(_angles(form, value, dtype))
    elif form in ("wxyz", "xyzw"):
        quaternion = _components(form, value, 4, dtype)
        if not isinstance(quaternion[0], jax.core.Tracer):  # `solve` masks what is no rotation
            _check_quaternion(form, value)
        rotation = from_quaternion(quaternion if form == "wxyz" else (quaternion[3], *quaternion[:3]))
    elif form == "matrix":
        rotation, matrix_position = _from_array(value, orthonormalize, dtype)
        if matrix_position is not None and position is not None:
            raise ValueError("give one position: matrix of shape (..., 4, 4) holds one, and xyz is another")
        position = matrix_position if position is None else position
    elif form == "wxyz_xyz":
        if position is not None:
            raise ValueError("give one position: wxyz_xyz holds one, and xyz is another")
        both = _components(form, value, 7, dtype)
        if not isinstance(both[0], jax.core.Tracer):
            _check_quaternion(form, np.asarray(value)[..., :4])
        rotation, position = from_quaternion(both[:4]), both[4:]
    else:
        rotation = tuple(tuple(jnp.asarray(c, dtype) for c in row) for row in vector.IDENTITY)
    if position is None:
        position = tuple(jnp.zeros_like(rotation[0][0]) for _ in range(3))
    return to_matrix(Pose(rotation, position))


def _angles(name: str, value: ArrayInput, dtype: DTypeLike) -> Vector:
    """Three angles, with a warning where they look like degrees."""
    angles = _components(name, value, 3, dtype)
    warn_of_degrees(name, value)
    return angles


def _from_array(value: ArrayInput, orthonormalize: bool, dtype: DTypeLike) -> tuple[Matrix, Vector | None]:
    """The rotation of a (..., 3, 3), (..., 9) or (..., 4, 4) array, and the position of the last."""
    array = jnp.asarray(value, dtype)
    if array.shape[-1:] == (9,):
        array = array.reshape(*array.shape[:-1], 3, 3)
    if array.shape[-2:] not in ((3, 3), (4, 4)):
        raise ValueError(f"matrix must have shape (..., 3, 3), (..., 9) or (..., 4, 4), got {array.shape}")
    whole = array.shape[-1] == 4
    known = None if isinstance(array, jax.core.Tracer) else np.asarray(value, float).reshape(array.shape)
    if whole and known is not None and not np.allclose(known[..., 3, :], (0, 0, 0, 1), atol=1e-9):
        raise ValueError("matrix must have bottom rows (0, 0, 0, 1): transposed?")
    rotation = tuple(tuple(array[..., i, j] for j in range(3)) for i in range(3))
    if orthonormalize:
        if known is not None:
            _check_rotation(known[..., :3, :3])
        near = vector.orthonormality_error(rotation) <= NEARLY_ROTATION
        # Far from a rotation the iteration overflows and its derivative would be NaN: it gets the identity.
        nearest = vector.nearest_rotation(_choose(near, rotation, vector.IDENTITY))
        rotation = _choose(near, nearest, rotation)
    return rotation, tuple(array[..., i, 3] for i in range(3)) if whole else None


def _choose(which: jax.Array, first: Matrix, second: Matrix) -> Matrix:
    """The first matrix where `which` is true, else the second."""
    rows = zip(first, second, strict=True)
    return tuple(tuple(jnp.where(which, u, v) for u, v in zip(*pair, strict=True)) for pair in rows)


def _check_rotation(matrix: np.ndarray) -> None:
    """Raise where one of (..., 3, 3) is not near enough to a rotation to orthonormalize it."""
    gap = np.linalg.norm(np.swapaxes(matrix, -1, -2) @ matrix - np.eye(3), axis=(-2, -1))
    worst = float(np.max(gap, initial=0.0))
    if not worst <= NEARLY_ROTATION:
        raise ValueError(
            f"matrix must be a rotation within {NEARLY_ROTATION:g}, its R^T R - I has norm {worst:.2g}"
        )
    if np.any(np.linalg.det(matrix) < 0):
        raise ValueError("matrix must be a rotation, got a reflection (determinant -1)")


def _check_quaternion(name: str, value) -> None:
    length = np.linalg.norm(np.asarray(value, float), axis=-1)
    worst = float(np.max(np.abs(length - 1), initial=0.0))
    if not worst <= 1e-3:
        raise ValueError(f"{name} must have length 1 within 1e-3, it is off by {worst:.2g}")


def planar_pose(
    x: ArrayInput, y: ArrayInput, phi: ArrayInput, *, dtype: DTypeLike | None = None
) -> jax.Array:
    """The goal of a planar arm as a pose: a position in the plane and a rotation about z.

    Args:
        x, y: Position [m], (...); z is zero.
        phi: Angle about z [rad], (...); the three shapes broadcast.
        dtype: Of the result; by default the floating type of the inputs.

    Returns:
        (..., 4, 4).

    Warns:
        Where `phi` is beyond a whole turn, as degrees are.
    """
    warn_of_degrees("phi", phi)
    if dtype is None:
        dtype = _floating(x, y, phi)
    sine, cosine = sincos(jnp.asarray(phi, dtype))
    position = (jnp.asarray(x, dtype), jnp.asarray(y, dtype), 0.0)
    return to_matrix(Pose(((cosine, -sine, 0.0), (sine, cosine, 0.0), (0.0, 0.0, 1.0)), position))


def position(x: ArrayInput, y: ArrayInput, z: ArrayInput, *, dtype: DTypeLike | None = None) -> jax.Array:
    """The goal of an arm whose task is "position", as a pose with the identity as its rotation.

    Args:
        x, y, z: Position [m], (...), of shapes that broadcast.
        dtype: Of the result; by default the floating type of the inputs.

    Returns:
        (..., 4, 4).
    """
    xyz = jnp.broadcast_arrays(*(jnp.asarray(v, dtype) for v in (x, y, z)))
    return pose(jnp.stack(xyz, axis=-1), dtype=dtype)


def clean(goal: Pose, reach: Scalar) -> tuple[Pose, jax.Array]:
    """A goal made finite, orthonormal and not absurdly far, and whether it was a pose.

    Args:
        goal: As given; anything.
        reach: Of the arm [m].

    Returns:
        The goal, its rotation orthonormalized, the identity where it was none; and whether its rotation is
        one within `ROTATION` and all its numbers are finite.
    """
    goal, off = _measured(goal, reach)
    is_pose = off <= ROTATION
    return Pose(vector.orthonormal(_or_identity(is_pose, goal.rotation)), goal.position), is_pose


def nearest_pose(rows: tuple[tuple[Scalar, ...], ...], reach: Scalar) -> tuple[Pose, jax.Array]:
    """The pose nearest to a goal T_world_tool that need not be rigid, and how far the goal is from rigid.

    Args:
        rows: The goal's entries, four rows of four.
        reach: Of the arm [m].

    Returns:
        The pose, with the nearest rotation where that of the goal is off by at most `NEARLY_ROTATION`, else
        the identity, which nothing may be measured against; and |R^T R - I|, infinite for a reflection, for
        numbers that are not finite and for a bottom row other than (0, 0, 0, 1).
    """
    rotation, position = tuple(row[:3] for row in rows[:3]), tuple(row[3] for row in rows[:3])
    goal, off = _measured(Pose(rotation, position), reach)
    for entry, wanted in zip(rows[3], (0, 0, 0, 1), strict=True):
        off = jnp.where(entry == wanted, off, jnp.inf)
    off = pin(off)
    rotation = pin_all(_or_identity(off <= NEARLY_ROTATION, goal.rotation))
    return Pose(vector.nearest_rotation(rotation), pin_all(goal.position)), off


def _measured(goal: Pose, reach: Scalar) -> tuple[Pose, jax.Array]:
    """The goal with finite numbers, and |R^T R - I|, infinite where they were not finite or mirror."""
    numbers = [*(c for row in goal.rotation for c in row), *goal.position]
    finite = jnp.isfinite(numbers[0])
    for number in numbers[1:]:
        finite &= jnp.isfinite(number)
    # The fourth power of a large entry must not overflow in the norm below, see `LARGEST_ENTRY`.
    rotation = tuple(
        tuple(jnp.clip(c, -LARGEST_ENTRY, LARGEST_ENTRY) for c in row)
        for row in _or_identity(finite, goal.rotation)
    )
    far = FARTHEST_GOAL * reach
    position = tuple(jnp.where(finite, jnp.clip(p, -far, far), 0) for p in goal.position)
    proper = finite & (vector.determinant(rotation) > 0)
    off = jnp.where(proper, vector.orthonormality_error(rotation), jnp.inf)
    return Pose(rotation, position), off


def _or_identity(good: jax.Array, rotation: vector.Matrix) -> vector.Matrix:
    """The rotation where it is good, else the identity."""
    return tuple(
        tuple(jnp.where(good, c, k) for c, k in zip(row, unit, strict=True))
        for row, unit in zip(rotation, vector.IDENTITY, strict=True)
    )
