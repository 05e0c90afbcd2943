import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ikjax.core.linear import solve_symmetric


def _solve(matrix, right):
    n = right.shape[-1]
    rows = [[matrix[..., i, j] for j in range(n)] for i in range(n)]
    return jnp.stack(solve_symmetric(rows, [right[..., i] for i in range(n)]), axis=-1)


@pytest.mark.parametrize("n", range(1, 8))
def test_it_solves_what_numpy_solves(n, dtype, rng):
    root = rng.normal(size=(50, n, n))
    matrix = root @ np.swapaxes(root, 1, 2) + 0.5 * np.eye(n)
    right = rng.normal(size=(50, n))
    wanted = np.linalg.solve(matrix, right[..., None])[..., 0]
    computed = jax.jit(_solve)(jnp.asarray(matrix, dtype), jnp.asarray(right, dtype))
    assert computed.dtype == dtype
    np.testing.assert_allclose(computed, wanted, rtol=0, atol=1e-11 if dtype == np.float64 else 1e-3)


def test_a_matrix_of_zeros_gives_zeros_with_a_finite_derivative(dtype):
    zeros, ones = jnp.zeros((3, 3), dtype), jnp.ones(3, dtype)
    assert (np.asarray(_solve(zeros, ones)) == 0).all()
    assert np.isfinite(jax.grad(lambda m: _solve(m, ones).sum())(zeros)).all()
