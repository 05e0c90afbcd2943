"""Singular values against LAPACK's, and their derivatives where values are zero or repeated."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ikjax.core.singular import singular_values


def columns(matrices):
    return tuple(
        tuple(matrices[..., i, j] for i in range(matrices.shape[-2])) for j in range(matrices.shape[-1])
    )


@jax.jit
def values(matrices):
    return jnp.sort(jnp.stack(singular_values(columns(matrices)), axis=-1), axis=-1)


@jax.jit
def derivatives(matrices, rates):
    def product(matrices):
        computed = singular_values(columns(matrices))
        total = computed[0]
        for value in computed[1:]:
            total = total * value
        return total

    return jax.jvp(product, (matrices,), (rates,))[1], jax.grad(lambda m: product(m).sum())(matrices)


def matrices(shape, rng):
    """Random ones, and ones of few whole numbers, which are often singular and have repeated values."""
    rows, count = shape
    random = rng.normal(size=(200, rows, count))
    whole = rng.integers(-1, 2, (200, rows, count)).astype(float)
    return np.concatenate([random, whole, np.eye(rows, count)[None], np.zeros((1, rows, count))])


@pytest.mark.parametrize("shape", [(6, 6), (6, 5), (3, 3), (2, 2), (3, 1)])
def test_values_are_those_of_lapack(shape, dtype, rng):
    given = matrices(shape, rng).astype(dtype)
    expected = np.sort(np.linalg.svd(given.astype(np.float64), compute_uv=False), axis=-1)
    # A few roundings for each of some forty turns, in units of the greatest value.
    bound = 40 * np.finfo(dtype).eps * (1 + expected.max(-1, keepdims=True))
    assert (np.abs(np.asarray(values(jnp.asarray(given))) - expected) <= bound).all()


@pytest.mark.parametrize("shape", [(6, 6), (3, 3)])
def test_the_derivative_of_the_product_is_that_of_the_determinant(shape, costly_dtype, rng):
    given = matrices(shape, rng).astype(costly_dtype)
    rates = rng.normal(size=(402, *shape)).astype(costly_dtype)
    forward, reverse = map(np.asarray, derivatives(jnp.asarray(given), jnp.asarray(rates)))
    assert np.isfinite(forward).all() and np.isfinite(reverse).all()
    exact = given.astype(np.float64)
    sign = np.sign(np.linalg.det(exact))
    with np.errstate(divide="ignore", invalid="ignore"):
        cofactors = np.stack([_cofactors(m) for m in exact])
    expected = sign * (cofactors * rates).sum((-1, -2))
    regular = np.linalg.svd(exact, compute_uv=False)[:, -1] > 1e-2
    size = np.abs(cofactors).sum((-1, -2)) * np.abs(rates).max() + 1
    assert regular.sum() > 150
    # Where values are repeated too: the whole numbers, the identity.
    assert (np.abs(forward - expected) / size)[regular].max() < 2e3 * np.finfo(costly_dtype).eps
    again = (reverse.astype(np.float64) * rates).sum((-1, -2))
    assert (np.abs(again - forward) / size).max() < 1e3 * np.finfo(costly_dtype).eps


def _cofactors(m):
    count = len(m)
    rest = [[np.delete(np.delete(m, i, 0), j, 1) for j in range(count)] for i in range(count)]
    return np.array(
        [[(-1) ** (i + j) * np.linalg.det(rest[i][j]) for j in range(count)] for i in range(count)]
    )


def test_a_least_value_has_the_derivative_of_its_vectors(rng):
    given, rates = rng.normal(size=(50, 6, 6)), rng.normal(size=(50, 6, 6))
    least = lambda m: values_least(m)  # noqa: E731
    derivative = jax.jvp(least, (jnp.asarray(given),), (jnp.asarray(rates),))[1]
    step = 1e-6
    ahead, behind = (np.linalg.svd(given + s * rates, compute_uv=False)[:, -1] for s in (step, -step))
    apart = np.linalg.svd(given, compute_uv=False)[:, -1] > 1e-2
    np.testing.assert_allclose(derivative[apart], ((ahead - behind) / (2 * step))[apart], atol=1e-6)


@jax.jit
def values_least(matrices):
    return jnp.min(jnp.stack(singular_values(columns(matrices)), axis=-1), axis=-1)


@pytest.mark.slow
def test_second_derivatives_are_finite_and_those_of_differences(rng):
    def measures(m):
        values = jnp.stack(singular_values(columns(m)))
        return jnp.stack([values.min(), values.min() / values.max(), values.prod()])

    first, second = jax.jit(jax.vmap(jax.jacfwd(measures))), jax.jit(jax.vmap(jax.hessian(measures)))
    whole = rng.integers(-1, 2, (200, 6, 3)) * rng.choice([1, 1e-8, 1e-17, 1e-100], (200, 6, 3))
    whole = whole[np.abs(whole).max((-1, -2)) > 1e-90]
    assert np.isfinite(second(whole)).all()
    given, rates, step = rng.normal(size=(50, 6, 3)), rng.normal(size=(50, 6, 3)), 1e-5
    rough = np.asarray(first(given + step * rates) - first(given - step * rates)) / (2 * step)
    exact = np.einsum("nmijkl,nkl->nmij", second(given), rates)
    size = 1 + np.abs(rough).max((1, 2, 3))[:, None, None, None]
    assert (np.abs(exact - rough) / size).max() < 1e-6
