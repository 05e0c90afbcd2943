"""Small dense linear systems, with all loops unrolled.

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
    """The inner product of two sequences of one length; products with a known 0, 1 or -1 are left out."""
    return functools.reduce(plus, map(times, u, v))


def solve_symmetric(
    matrix: list[Row],
    right: Row,
    floor: Scalar | None = None,
    push: Scalar | None = None,
) -> Row:
    """x with matrix x = right, for a symmetric positive definite matrix; zeros where a pivot is zero.

    With `floor` and `push` it is the step of a modified Newton method, for a Hessian that need not be
    positive definite.

    Args:
        matrix: n rows of n entries, of which the lower triangle is read.
        right: n entries.
        floor: The least pivot. The absolute values of the pivots are taken, and no smaller than this, so that
            any symmetric matrix becomes a positive definite one; one with larger positive pivots stays as it
            is.
        push: With `floor`: how far x goes at least along each direction of negative curvature (a pivot below
            -10 floors), or the square root of the pivot where that is less. Without it a right-hand side of
            zero would not tell a saddle point from a minimum.

    Returns:
        n entries.
    """
    n = len(right)
    lower: list[Row] = [[0.0] * n for _ in range(n)]
    inverse_pivots: Row = []
    least_steps: Row = []
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
            is_negative, pivot = pivot < -10 * floor, jnp.maximum(abs(pivot), floor)
            if push is not None:
                least_steps.append(pin(jnp.where(is_negative, jnp.minimum(push, safe.sqrt(pivot)), 0)))
        inverse_pivots.append(pin(safe.divide(1, pivot)))
    # L y = right, D z = y, L^T x = z, in one list. Each entry is pinned once it is complete, because all
    # later ones need it.
    x = list(right)
    for i in range(n):
        for j in range(i):
            x[i] = x[i] - lower[i][j] * x[j]
        x[i] = pin(x[i])
    for i in range(n):
        x[i] = x[i] * inverse_pivots[i]
        if push is not None:
            least = least_steps[i]
            x[i] = jnp.where(x[i] < 0, jnp.minimum(x[i], -least), jnp.maximum(x[i], least))
    for i in reversed(range(n)):
        for j in range(i + 1, n):
            x[i] = x[i] - lower[j][i] * x[j]
        x[i] = pin(x[i])
    return x


def damped_steps(columns: Sequence[Sequence[Scalar]], gap: Sequence[Scalar], damping: Scalar) -> Row:
    """x with (J^T J + damping) x = J^T gap: a step of damped least squares.

    Args:
        columns: Those of J.
        gap: What the step should make up for, of the length of a column.
        damping: A positive number, which keeps the system regular where columns are dependent.

    Source: Levenberg (1944) and Marquardt (1963), with a constant damping.
    """
    matrix = [[pin(dot(columns[i], columns[j])) for j in range(i + 1)] for i in range(len(columns))]
    for i, row in enumerate(matrix):
        row[i] = row[i] + damping
    return solve_symmetric(matrix, [pin(dot(column, gap)) for column in columns])
