import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ikjax.core import roots

solve = jax.jit(roots.cosine_sine)


@pytest.mark.parametrize("side", [1, -1])
def test_each_side_has_its_own_root(side, dtype, rng):
    a, b, share = rng.uniform(-1, 1, (3, 500)).astype(dtype)
    size = np.hypot(a, b)
    c = share * size
    root = solve(a, b, c, dtype(side))
    rounding = 16 * np.finfo(dtype).eps
    np.testing.assert_allclose(a * root.cos + b * root.sin - c, 0, atol=rounding)
    np.testing.assert_allclose(root.sin**2 + root.cos**2, 1, atol=rounding)
    np.testing.assert_allclose(
        b * root.cos - a * root.sin, root.height, atol=2e-3 if dtype == np.float32 else 1e-7
    )
    assert np.all(root.height * side >= 0)
    np.testing.assert_allclose(root.margin, size - np.abs(c), atol=rounding)
    assert not np.any(root.free)


def test_half_a_turn_is_no_special_angle(dtype):
    # a + c = 0: one root is pi, where the tangent of half the angle is infinite.
    a, b = dtype(1), dtype(0.5)
    found = [solve(a, b, -a, dtype(side)) for side in (1, -1)]
    np.testing.assert_allclose([[root.sin, root.cos] for root in found], [[-0.8, -0.6], [0, -1]], atol=1e-6)


def test_where_there_is_no_root_the_nearest_angle_is_given(dtype):
    for c, wanted in ((6, [0.6, 0.8]), (-6, [-0.6, -0.8])):
        for side in (1, -1):
            root = solve(dtype(3), dtype(4), dtype(c), dtype(side))
            np.testing.assert_allclose([root.cos, root.sin], wanted, rtol=1e-6)
            assert root.margin == -1 and root.height == 0 and not root.free


def test_a_double_root_is_found_from_both_sides(dtype):
    for side in (1, -1):
        root = solve(dtype(3), dtype(4), dtype(5), dtype(side))
        np.testing.assert_allclose([root.cos, root.sin, root.margin], [0.6, 0.8, 0], rtol=1e-6)


def test_without_coefficients_the_angle_is_free(dtype):
    for c in (0, 1):
        root = solve(dtype(0), dtype(0), dtype(c), dtype(1))
        assert root.free and root.margin == -c
        assert root.sin == root.cos == 0


EDGES = {
    "double": (3, 4, 5),
    "half a turn": (1, 0.5, -1),
    "no root": (3, 4, 6),
    "level": (1, 0, 0),
    "free": (0, 0, 0),
    "free, no root": (0, 0, 1),
}


def test_slopes_are_finite_at_every_edge(dtype):
    def numbers(abc, side):
        return jnp.stack(roots.cosine_sine(*abc, side)[:4])

    edges = np.repeat(np.array(list(EDGES.values()), dtype), 2, axis=0)
    sides = np.resize(np.array([1, -1], dtype), len(edges))
    both = jax.jit(jax.vmap(lambda abc, side: [f(numbers)(abc, side) for f in (jax.jacfwd, jax.jacrev)]))
    forward, backward = both(edges, sides)
    assert np.isfinite(forward).all()
    np.testing.assert_allclose(forward, backward, rtol=1e-4, atol=1e-5)


def test_the_root_moves_as_the_equation_says(rng):
    # Differentiate a cos(t) + b sin(t) = c: cos(t) da + sin(t) db + height dt = dc.
    def numbers(abc):
        root = roots.cosine_sine(*abc, -1.0)
        return (root.sin, root.margin), root

    (slopes, clearance), root = jax.jit(jax.jacrev(numbers, has_aux=True))(np.array([0.8, -0.5, 0.3]))
    wanted = np.array([-root.cos, -root.sin, 1]) / root.height * root.cos
    np.testing.assert_allclose(slopes, wanted, rtol=1e-12)
    np.testing.assert_allclose(clearance, [0.8 / np.hypot(0.8, 0.5), -0.5 / np.hypot(0.8, 0.5), -1])
