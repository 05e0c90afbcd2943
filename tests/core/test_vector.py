import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ikjax.core import vector


def matrices(rng, count=20):
    """As (count, 3, 3), and as three rows of three (count,) scalars."""
    array = rng.standard_normal((count, 3, 3))
    return array, tuple(tuple(array[:, i, j] for j in range(3)) for i in range(3))


def array_of(nested):
    return np.moveaxis(np.array(nested), -1, 0)


def test_products_are_those_of_numpy(rng):
    (m, mt), (n, nt) = matrices(rng), matrices(rng)
    u, v = m[:, 0], n[:, 1]
    ut, vt = tuple(u.T), tuple(v.T)
    near = {"rtol": 1e-12, "atol": 1e-14}
    np.testing.assert_allclose(vector.dot(ut, vt), (u * v).sum(-1), **near)
    np.testing.assert_allclose(array_of(vector.cross(ut, vt)), np.cross(u, v), **near)
    np.testing.assert_allclose(array_of(vector.rotate(mt, vt)), (m @ v[..., None])[..., 0], **near)
    np.testing.assert_allclose(array_of(vector.matmul(mt, nt)), m @ n, **near)
    np.testing.assert_allclose(array_of(vector.subtract(ut, vector.scale(2.5, vt))), u - 2.5 * v, **near)
    np.testing.assert_allclose(vector.norm(ut), np.linalg.norm(u, axis=-1), **near)
    np.testing.assert_allclose(vector.determinant(mt), np.linalg.det(m), **near)
    np.testing.assert_array_equal(array_of(vector.transpose(mt)), np.swapaxes(m, 1, 2))


def test_what_is_known_costs_nothing():
    def turn_by_constants(x, y, z):
        quarter = ((0.0, -1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, 1.0))
        return vector.rotate(vector.matmul(quarter, vector.IDENTITY), vector.add((x, y, z), vector.ORIGIN))

    graph = jax.make_jaxpr(turn_by_constants)(1.0, 2.0, 3.0)
    assert [line.primitive.name for line in graph.eqns] == ["neg"]
    assert turn_by_constants(1.0, 2.0, 3.0) == (-2.0, 1.0, 3.0)
    assert str(vector.minus(0.0)) == "0.0" and vector.minus(2.0) == -2.0


def test_cross_products_keep_the_hand():
    x, y, z = vector.IDENTITY
    assert vector.cross(x, y) == z and vector.cross(y, z) == x and vector.cross(z, x) == y


def test_a_frame_is_made_right_handed_and_square(rng):
    m, mt = matrices(rng)
    frame = array_of(vector.orthonormal(mt))
    np.testing.assert_allclose(np.swapaxes(frame, 1, 2) @ frame, np.tile(np.eye(3), (20, 1, 1)), atol=1e-12)
    np.testing.assert_allclose(np.linalg.det(frame), 1, atol=1e-12)
    along = (frame[:, :, 0] * m[:, :, 0]).sum(1)
    np.testing.assert_allclose(along, np.linalg.norm(m[:, :, 0], axis=1), atol=1e-12)
    np.testing.assert_allclose(vector.orthonormality_error(vector.orthonormal(mt)), 0, atol=1e-14)


@pytest.mark.parametrize("size", [0, 1e-6, 1e-3, 1e-2])
def test_the_nearest_rotation_is_that_of_the_singular_value_decomposition(rng, size, dtype):
    m = np.linalg.qr(rng.standard_normal((20, 3, 3)))[0]
    m *= np.sign(np.linalg.det(m))[:, None, None]
    m += rng.standard_normal(m.shape) * size / 9
    off = np.linalg.norm(np.swapaxes(m, 1, 2) @ m - np.eye(3), axis=(1, 2)).max()
    assert size / 2 <= off <= max(size, 1e-14)
    u, _, v = np.linalg.svd(m)
    m = m.astype(dtype)
    got = array_of(vector.nearest_rotation(tuple(tuple(m[:, i, j] for j in range(3)) for i in range(3))))
    assert got.dtype == dtype
    np.testing.assert_allclose(got, u @ v, atol=8 * np.finfo(dtype).eps)


def test_the_gradient_of_the_nearest_rotation_is_right_at_a_rotation_and_near_one(rng):
    def nearest(m):
        rows = vector.nearest_rotation(tuple(tuple(m[i, j] for j in range(3)) for i in range(3)))
        return jnp.stack([jnp.stack(row) for row in rows])

    def by_svd(m):
        u, _, v = np.linalg.svd(m)
        return u @ v

    turn = np.linalg.qr(rng.standard_normal((3, 3)))[0]
    for m in (turn, turn + rng.standard_normal((3, 3)) * 1e-3):
        change = rng.standard_normal((3, 3))
        (_, got), h = jax.jvp(nearest, (jnp.asarray(m),), (jnp.asarray(change),)), 1e-5
        wanted = (by_svd(m + h * change) - by_svd(m - h * change)) / (2 * h)
        np.testing.assert_allclose(got, wanted, atol=1e-8)


def test_the_orthonormality_error_is_the_frobenius_norm(rng):
    m, mt = matrices(rng)
    wanted = np.linalg.norm(np.swapaxes(m, 1, 2) @ m - np.eye(3), axis=(1, 2))
    np.testing.assert_allclose(vector.orthonormality_error(mt), wanted, rtol=1e-12)


@pytest.mark.parametrize("matrix", [np.zeros((3, 3)), np.ones((3, 3)), np.diag([1.0, 0, 0])])
def test_no_rotation_at_all_still_gives_finite_numbers_and_derivatives(matrix, dtype):
    def flat(m):
        rows = tuple(tuple(m[i, j] for j in range(3)) for i in range(3))
        return jnp.stack(jax.tree.leaves((vector.orthonormal(rows), vector.orthonormality_error(rows))))

    value, derivative = jax.jit(lambda m: (flat(m), jax.jacrev(flat)(m)))(matrix.astype(dtype))
    assert np.isfinite(value).all() and np.isfinite(derivative).all()
