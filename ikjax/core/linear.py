"""Small dense systems, unrolled.

Every entry may be an array of any batch shape.
Source: the square-root-free Cholesky factorization; Golub and Van Loan, Matrix Computations, section 4.1.
"""

import functools
from collections.abc import Sequence

import jax.numpy as jnp

from ikjax.core import safe
from ikjax.core.trig import Scalar
from ikjax.core.vector import plus, times
from ikjax.core.xla import pin

Row = list[Scalar]


def dot(u: Sequence[Scalar], v: Sequence[Scalar]) -> Scalar:
    """The inner product of two sequences of any one length; products with a known zero or one are left
    out."""
    return functools.reduce(plus, map(times, u, v))


def solve_symmetric(
    matrix: list[Row],
    right: Row,
    floor: Scalar | None = None,
    push: Scalar | None = None,
) -> Row:
    """x with matrix x = right, for a symmetric positive definite matrix; zeros where a pivot is zero.

    Args:
        matrix: n rows of n entries, of which the lower triangle is looked at.
        right: n entries.
        floor: Pivots are taken without their signs and no smaller than this, which makes any symmetric
            matrix a positive definite one, and leaves those alone that were.
        push: With `floor`: along each way on which the form falls, by a pivot below -10 floors, x goes so far
            at least, or the pivot's root where that is less; a right-hand side of zero does not tell a saddle
            from a bottom.
    """
    n = len(right)
    lower: list[Row] = [[0.0] * n for _ in range(n)]
    inverse_pivots: Row = []
    least: Row = []
    for i in range(n):
        scaled: Row = []
        for j in range(i):
            entry = matrix[i][j]
            for k in range(j):
                entry = entry - scaled[k] * lower[j][k]
            scaled.append(entry)
        pivot = matrix[i][i]
        for j in range(i):
            lower[i][j] = pin(scaled[j] * inverse_pivots[j])
            pivot = pivot - scaled[j] * lower[i][j]
        if floor is not None:
            falls, pivot = pivot < -10 * floor, jnp.maximum(abs(pivot), floor)
            if push is not None:
                least.append(pin(jnp.where(falls, jnp.minimum(push, safe.sqrt(pivot)), 0)))
        inverse_pivots.append(pin(safe.divide(1, pivot)))
    # Each entry is pinned where it is whole: later ones need all of them.
    x = list(right)
    for i in range(n):
        for j in range(i):
            x[i] = x[i] - lower[i][j] * x[j]
        x[i] = pin(x[i])
    for i in range(n):
        x[i] = x[i] * inverse_pivots[i]
        if push is not None:
            x[i] = jnp.where(x[i] < 0, jnp.minimum(x[i], -least[i]), jnp.maximum(x[i], least[i]))
    for i in reversed(range(n)):
        for j in range(i + 1, n):
            x[i] = x[i] - lower[j][i] * x[j]
        x[i] = pin(x[i])
    return x
