"""Singular values of small matrices, many at a time, and their slopes: finite where there is none too.

Every entry may be an array of any batch shape. Columns are turned in pairs until all are square
to each other; their lengths are then the singular values, a value of zero right to rounding and not to its
root, as the eigenvalues of a Gram matrix would have it.

Source: Hestenes, Inversion of matrices by biorthogonalization (1958), in the order of a round-robin
tournament after Brent and Luk (1985); the slope u . dM v is Golub and Van Loan, Matrix Computations, 8.6.
"""

from collections.abc import Sequence

import jax
import jax.numpy as jnp

from ikjax.core import safe
from ikjax.core.linear import dot
from ikjax.core.trig import Scalar

Column = tuple[Scalar, ...]

SWEEPS = {"float32": 5, "float64": 6}
"""Every pair of columns meets so often: the error squares in every sweep, once it is small."""


@jax.custom_jvp
def singular_values(columns: Sequence[Column]) -> tuple[jax.Array, ...]:
    """The singular values of a matrix with no more columns than rows, one for each column, in no order.

    The slope of each is that of its own pair of vectors. Where values are repeated, any of the pairs that
    belong to them may come up, and functions that treat all values alike still have their own slope. A value
    of exactly zero has slope zero, as the absolute value that it is.

    Args:
        columns: Up to some eight columns, each of as many entries, of one shape and one floating type.
    """
    return tuple(map(_length, _turned(columns, len(columns[0]))))


@singular_values.defjvp
def _(primals, tangents):
    (columns,), (rates,) = primals, tangents
    lefts, rights = _vectors(columns)
    values = tuple(map(_length, lefts))
    moves = [dot(left, _times(rates, right)) for left, right in zip(lefts, rights, strict=True)]
    return values, tuple(map(safe.divide, moves, values))


@jax.custom_jvp
def _vectors(columns: Sequence[Column]) -> tuple[list[Column], list[Column]]:
    """The columns after all turns, and the right-hand vectors that belong to them."""
    rows, one = len(columns[0]), jnp.ones_like(columns[0][0])
    # Beneath each column, where it went: those entries become the right-hand vectors.
    places = [[one if i == j else 0 * one for i in range(len(columns))] for j in range(len(columns))]
    both = _turned([(*c, *e) for c, e in zip(columns, places, strict=True)], rows)
    return [c[:rows] for c in both], [c[rows:] for c in both]


@_vectors.defjvp
def _(primals, tangents):
    """For slopes of slopes: the columns stay square to each other, two of one length turn nothing."""
    (columns,), (rates,) = primals, tangents
    lefts, rights = _vectors(columns)
    moved = [_times(rates, right) for right in rights]
    squares, count = [dot(w, w) for w in lefts], range(len(lefts))
    turns = {}
    for i in count:
        for j in range(i):
            slip = dot(lefts[i], moved[j]) + dot(lefts[j], moved[i])
            turns[i, j] = safe.divide(slip, squares[j] - squares[i])
            turns[j, i] = -turns[i, j]

    def turned(vectors, still):
        return [
            tuple(
                still[j][k] + sum(vectors[i][k] * turns[i, j] for i in count if i != j) for k in range(size)
            )
            for size, j in ((len(vectors[0]), j) for j in count)
        ]

    zeros = [[0.0] * len(columns)] * len(columns)
    return (lefts, rights), (turned(lefts, moved), turned(rights, zeros))


def volume(columns: Sequence[Column]) -> Scalar:
    """The product of the singular values, by what each column adds to those before it.

    Arguments as in `singular_values`. Unlike a product of those it has slopes of slopes where values are
    repeated; where it is zero its slope is that of one side, or zero.
    """
    ways: list[Column] = []
    product: Scalar = 1.0
    for column in columns:
        for way in ways:
            along = dot(way, column)
            column = tuple(x - along * y for x, y in zip(column, way, strict=True))
        length = _length(column)
        ways.append(tuple(safe.divide(x, length) for x in column))
        product = product * length
    return product


def _turned(columns: Sequence[Column], rows: int) -> list[Column]:
    """The columns after all turns; only the first `rows` entries decide how far they turn."""
    count = len(columns)
    if count == 1:
        return list(columns)
    zero = tuple(jnp.zeros_like(x) for x in columns[0])
    # An odd one out meets a column of zeros, which turns nothing.
    around = (*columns, zero) if count % 2 else tuple(columns)
    size = len(around)

    def meet(_, around):
        pairs = [_apart(around[i], around[size - 1 - i], rows) for i in range(size // 2)]
        met = (*(first for first, _ in pairs), *(second for _, second in reversed(pairs)))
        return (met[0], met[-1], *met[1:-1])

    rounds = (size - 1) * SWEEPS[zero[0].dtype.name]
    return list(jax.lax.fori_loop(0, rounds, meet, tuple(map(tuple, around))))[:count]


def _apart(first: Column, second: Column, rows: int) -> tuple[Column, Column]:
    """Two columns turned within their plane until they are square to each other, by the lesser turn."""
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
