"""Singular values of small matrices, many at a time, with derivatives that are finite everywhere.

Every entry may be an array of any batch shape. The one-sided Jacobi method rotates columns in pairs until all
are perpendicular; their lengths are then the singular values. A value of zero is accurate to rounding;
by the eigenvalues of the Gram matrix it would be accurate to the square root of that.

Source: Hestenes, Inversion of matrices by biorthogonalization (1958), in the order of a round-robin
tournament after Brent and Luk (1985); the derivative u . dM v is Golub and Van Loan, Matrix Computations,
8.6.
"""

from collections.abc import Sequence

import jax
import jax.numpy as jnp

from ikjax.core import safe
from ikjax.core.linear import dot
from ikjax.core.trig import Scalar

Column = tuple[Scalar, ...]

SWEEPS = {"float32": 5, "float64": 6}
"""How often every pair of columns is rotated. Once the error is small, it squares with every sweep."""


@jax.custom_jvp
def singular_values(columns: Sequence[Column]) -> tuple[jax.Array, ...]:
    """The singular values of a matrix with no more columns than rows, one for each column, in no order.

    The derivative of each is that of its own pair of singular vectors. Where values are repeated, the vectors
    are not unique; the derivative of a symmetric function of all values is right nevertheless. A value of
    exactly zero has derivative zero, where an absolute value has none.

    Args:
        columns: Up to some eight columns, each of as many entries, of one shape and one floating type.
    """
    return tuple(map(_length, _turned(columns, len(columns[0]))))


@singular_values.defjvp
def _(primals, tangents):
    # `lefts` are the left singular vectors, each as long as its value: u . dM v = left . dM v / value.
    (columns,), (rates,) = primals, tangents
    lefts, rights = _vectors(columns)
    values = tuple(map(_length, lefts))
    moves = [dot(left, _times(rates, right)) for left, right in zip(lefts, rights, strict=True)]
    return values, tuple(map(safe.divide, moves, values))


@jax.custom_jvp
def _vectors(columns: Sequence[Column]) -> tuple[list[Column], list[Column]]:
    """The columns after all rotations, M V, and the right singular vectors, the columns of V."""
    rows, one = len(columns[0]), jnp.ones_like(columns[0][0])
    # The rotations are applied to the identity too, which stands below the matrix and becomes V.
    identity = [[one if i == j else 0 * one for i in range(len(columns))] for j in range(len(columns))]
    both = _turned([(*c, *e) for c, e in zip(columns, identity, strict=True)], rows)
    return [c[:rows] for c in both], [c[rows:] for c in both]


@_vectors.defjvp
def _(primals, tangents):
    """For second derivatives: the columns stay perpendicular. Two of equal length do not rotate."""
    (columns,), (rates,) = primals, tangents
    lefts, rights = _vectors(columns)
    moved = [_times(rates, right) for right in rights]
    squares, count = [dot(w, w) for w in lefts], range(len(lefts))
    # dV = V S with S antisymmetric, such that the derivative of left_i . left_j stays zero.
    skew = {}
    for i in count:
        for j in range(i):
            slip = dot(lefts[i], moved[j]) + dot(lefts[j], moved[i])
            skew[i, j] = safe.divide(slip, squares[j] - squares[i])
            skew[j, i] = -skew[i, j]

    def turned(vectors, fixed):
        """The derivative of the vectors: what they change by without a rotation, and the rotation."""
        return [
            tuple(fixed[j][k] + sum(vectors[i][k] * skew[i, j] for i in count if i != j) for k in range(size))
            for size, j in ((len(vectors[0]), j) for j in count)
        ]

    zeros = [[0.0] * len(columns)] * len(columns)
    return (lefts, rights), (turned(lefts, moved), turned(rights, zeros))


def volume(columns: Sequence[Column]) -> Scalar:
    """The product of the singular values: the volume that the columns span.

    Arguments as in `singular_values`. Unlike a product of those it has second derivatives where values are
    repeated. Where it is zero its derivative is that from one side, or zero.

    Source: Gram-Schmidt orthogonalization; the volume is the product of the lengths that are left.
    """
    units: list[Column] = []
    product: Scalar = 1.0
    for column in columns:
        for unit in units:
            along = dot(unit, column)
            column = tuple(x - along * y for x, y in zip(column, unit, strict=True))
        length = _length(column)
        units.append(tuple(safe.divide(x, length) for x in column))
        product = product * length
    return product


def _turned(columns: Sequence[Column], rows: int) -> list[Column]:
    """The columns after all rotations; only the first `rows` entries decide the angles."""
    count = len(columns)
    if count == 1:
        return list(columns)
    zero = tuple(jnp.zeros_like(x) for x in columns[0])
    # An odd number of columns gets one of zeros, which rotates nothing.
    players = (*columns, zero) if count % 2 else tuple(columns)
    size = len(players)

    def play_round(_, players):
        """Rotate size / 2 pairs; then the first stays and all others move on by one place."""
        pairs = [_apart(players[i], players[size - 1 - i], rows) for i in range(size // 2)]
        rotated = (*(first for first, _ in pairs), *(second for _, second in reversed(pairs)))
        return (rotated[0], rotated[-1], *rotated[1:-1])

    rounds = (size - 1) * SWEEPS[zero[0].dtype.name]
    return list(jax.lax.fori_loop(0, rounds, play_round, tuple(map(tuple, players))))[:count]


def _apart(first: Column, second: Column, rows: int) -> tuple[Column, Column]:
    """Two columns rotated in their plane until they are perpendicular, by the smaller of the two angles."""
    more = dot(second[:rows], second[:rows]) - dot(first[:rows], first[:rows])
    twice = 2 * dot(first[:rows], second[:rows])
    tangent = safe.divide(safe.sign(more) * twice, jnp.abs(more) + safe.sqrt(more * more + twice * twice))
    cosine = 1 / jnp.sqrt(1 + tangent * tangent)
    sine = cosine * tangent
    pairs = list(zip(first, second, strict=True))
    return tuple(cosine * x - sine * y for x, y in pairs), tuple(sine * x + cosine * y for x, y in pairs)


def _length(column: Column) -> Scalar:
    return safe.norm(*column)


def _times(columns: Sequence[Column], factors: Column) -> Column:
    """The sum of the columns, each by its factor."""
    return tuple(dot(row, factors) for row in zip(*columns, strict=True))
