"""3-vectors and 3x3 matrices as tuples of scalars.

A vector is (x, y, z), a matrix three such rows. Every component may be an array of
any batch shape: each line is one elementwise operation, which XLA fuses with its neighbors.

A component that is a Python 0, 1 or -1 is known while tracing, and its products and sums are left out: that
is why a kernel is fast whose arm is a constant (`Arm.baked`).
"""

from ikjax.core import safe
from ikjax.core.trig import Scalar
from ikjax.core.xla import pin_all

Vector = tuple[Scalar, ...]
"""(x, y, z)"""
Matrix = tuple[Vector, ...]
"""Three rows."""

IDENTITY: Matrix = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
ORIGIN: Vector = (0.0, 0.0, 0.0)


def times(a: Scalar, b: Scalar) -> Scalar:
    """a * b, left out where one factor is known to be 0, 1 or -1."""
    for known, other in ((a, b), (b, a)):
        if isinstance(known, int | float) and known in (0, 1, -1):
            return 0.0 if known == 0 else other if known == 1 else -other
    return a * b


def minus(a: Scalar) -> Scalar:
    """-a; a known zero stays 0.0, which -a would make -0.0."""
    return -a if not isinstance(a, int | float) or a != 0 else 0.0


def plus(a: Scalar, b: Scalar) -> Scalar:
    """a + b, left out where one term is known to be 0."""
    for known, other in ((a, b), (b, a)):
        if isinstance(known, int | float) and known == 0:
            return other
    return a + b


def dot(u: Vector, v: Vector) -> Scalar:
    return plus(plus(times(u[0], v[0]), times(u[1], v[1])), times(u[2], v[2]))


def cross(u: Vector, v: Vector) -> Vector:
    return (
        plus(times(u[1], v[2]), -times(u[2], v[1])),
        plus(times(u[2], v[0]), -times(u[0], v[2])),
        plus(times(u[0], v[1]), -times(u[1], v[0])),
    )


def add(u: Vector, v: Vector) -> Vector:
    return (plus(u[0], v[0]), plus(u[1], v[1]), plus(u[2], v[2]))


def subtract(u: Vector, v: Vector) -> Vector:
    return (plus(u[0], -v[0]), plus(u[1], -v[1]), plus(u[2], -v[2]))


def scale(factor: Scalar, v: Vector) -> Vector:
    return (times(factor, v[0]), times(factor, v[1]), times(factor, v[2]))


def norm(v: Vector) -> Scalar:
    return safe.norm(*v)


def transpose(m: Matrix) -> Matrix:
    return tuple(zip(*m, strict=True))


def rotate(m: Matrix, v: Vector) -> Vector:
    """The matrix times the vector."""
    return (dot(m[0], v), dot(m[1], v), dot(m[2], v))


def matmul(m: Matrix, n: Matrix) -> Matrix:
    columns = transpose(n)
    return tuple(tuple(dot(row, column) for column in columns) for row in m)


def orthonormal(m: Matrix) -> Matrix:
    """A right-handed frame by Gram-Schmidt on the columns: x keeps its direction, z is normal to x and y.

    A matrix that is no rotation still gives finite numbers.
    """
    x, y, _ = transpose(m)
    x = scale(safe.reciprocal_sqrt(dot(x, x)), x)
    z = cross(x, y)
    z = scale(safe.reciprocal_sqrt(dot(z, z)), z)
    return transpose((x, cross(z, x), z))


def nearest_rotation(m: Matrix) -> Matrix:
    """The rotation nearest to a matrix that is almost one, in the Frobenius norm: its polar factor.

    The norm e of R^T R - I becomes 3/4 e^2 with every step, so three lead from 1e-2 to 2e-17; the
    derivative converges with them. Of a matrix further off, the result is no rotation and may
    overflow: the caller replaces such a matrix first.

    Source: the Newton-Schulz iteration; Higham, Computing the polar decomposition, with
    applications (1986).
    """
    for _ in range(3):
        x, y, z = transpose(m)
        xy, yz, zx = (times(-0.5, dot(u, v)) for u, v in ((x, y), (y, z), (z, x)))
        xx, yy, zz = (plus(1.5, times(-0.5, dot(v, v))) for v in (x, y, z))
        m = pin_all(matmul(m, ((xx, xy, zx), (xy, yy, yz), (zx, yz, zz))))
    return m


def orthonormality_error(m: Matrix) -> Scalar:
    """Frobenius norm of M^T M - I: zero for a rotation or a reflection."""
    x, y, z = transpose(m)
    diagonal = sum((dot(v, v) - 1) ** 2 for v in (x, y, z))
    return safe.sqrt(diagonal + 2 * (dot(x, y) ** 2 + dot(y, z) ** 2 + dot(z, x) ** 2))


def determinant(m: Matrix) -> Scalar:
    return dot(cross(m[0], m[1]), m[2])
