import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ikjax.core import safe

EDGES = (0.0, -0.0, -1.0, 1e-12)
TINY = (5e-324, 1e-310, 1e-300, 1e-45, 1e-40, 1e-36)


def value_and_derivatives(f, *args):
    """The value, then the derivatives by forward and by reverse mode."""
    places = tuple(range(len(args)))
    forward, backward = jax.jacfwd(f, places), jax.jacrev(f, places)
    return jax.jit(lambda *x: (f(*x), forward(*x), backward(*x)))(*args)


@pytest.mark.parametrize("f", [safe.sqrt, safe.reciprocal_sqrt, lambda x: safe.divide(1, x)])
def test_at_an_edge_value_and_derivative_are_finite(f, dtype):
    # The derivative of a root fits at any size, that of a quotient by 1e-300 does not.
    x = np.array(EDGES + TINY * (f is safe.sqrt), dtype)
    value, (forward,), (backward,) = value_and_derivatives(f, x)
    assert value.dtype == dtype
    assert np.isfinite(value).all() and np.isfinite(forward).all()
    np.testing.assert_array_equal(forward, backward)


def test_nothing_happens_at_and_below_zero(dtype):
    x = np.array([0.0, -0.0, -1e-30, -4.0], dtype)
    for f in (safe.sqrt, safe.reciprocal_sqrt):
        value, (forward,), (backward,) = value_and_derivatives(f, x)
        for zeros in (value, forward, backward):
            np.testing.assert_array_equal(zeros, 0)


def test_away_from_edges_these_are_the_plain_functions(dtype):
    x = np.array([1e-8, 0.3, 4.0, 1e8], dtype)
    root, (derivative,), _ = value_and_derivatives(safe.sqrt, x)
    rounding = 4 * np.finfo(dtype).eps
    np.testing.assert_allclose(root, np.sqrt(x), rtol=rounding)
    np.testing.assert_allclose(np.diag(derivative), 0.5 / np.sqrt(x), rtol=rounding)
    np.testing.assert_allclose(safe.reciprocal_sqrt(x), 1 / np.sqrt(x), rtol=rounding)
    np.testing.assert_allclose(safe.divide(x[::-1], -x), -x[::-1] / x, rtol=rounding)


def test_a_quotient_by_zero_is_zero_with_derivative_zero(dtype):
    value, *derivatives = value_and_derivatives(safe.divide, dtype(3), dtype(0))
    np.testing.assert_array_equal(value, 0)
    np.testing.assert_array_equal(derivatives, 0)


def test_a_length_has_derivative_zero_at_the_origin_and_one_elsewhere(dtype):
    zero, three, four = dtype(0), dtype(3), dtype(-4)
    value, *derivatives = value_and_derivatives(safe.norm, zero, zero, zero)
    np.testing.assert_array_equal(value, 0)
    np.testing.assert_array_equal(derivatives, 0)
    value, *derivatives = value_and_derivatives(safe.norm, three, zero, four)
    np.testing.assert_allclose(value, 5)
    np.testing.assert_allclose(derivatives, 2 * [[0.6, 0, -0.8]], rtol=4 * np.finfo(dtype).eps)


def test_zero_counts_as_positive(dtype):
    sign = safe.sign(np.array([-2, -0.0, 0.0, 3], dtype))
    assert sign.dtype == dtype
    np.testing.assert_array_equal(sign, [-1, 1, 1, 1])
    assert (safe.sign(-2), safe.sign(0)) == (-1.0, 1.0)
    assert not isinstance(safe.sign(0.5), jnp.ndarray)
