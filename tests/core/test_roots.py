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
    computed = [solve(a, b, -a, dtype(side)) for side in (1, -1)]
    np.testing.assert_allclose(
        [[root.sin, root.cos] for root in computed], [[-0.8, -0.6], [0, -1]], atol=1e-6
    )


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


def test_derivatives_are_finite_at_every_edge(dtype):
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

    (derivatives, clearance), root = jax.jit(jax.jacrev(numbers, has_aux=True))(np.array([0.8, -0.5, 0.3]))
    wanted = np.array([-root.cos, -root.sin, 1]) / root.height * root.cos
    np.testing.assert_allclose(derivatives, wanted, rtol=1e-12)
    np.testing.assert_allclose(clearance, [0.8 / np.hypot(0.8, 0.5), -0.5 / np.hypot(0.8, 0.5), -1])


def _harmonics_of(roots: np.ndarray) -> np.ndarray:
    """Coefficients (n, 5), of size one, of the polynomials whose roots (n, 4) are given."""
    z = np.exp(1j * roots)
    c = np.ones((len(roots), 1), complex)
    for k in range(4):
        c = np.pad(c, ((0, 0), (0, 1))) - np.pad(c, ((0, 0), (1, 0))) * z[:, k : k + 1]
    c *= np.exp(-0.5j * roots.sum(-1, keepdims=True))
    columns = [2 * c[:, 0].real, -2 * c[:, 0].imag, c[:, 1].real, -c[:, 1].imag, c[:, 2].real]
    polynomials = np.stack(columns, -1)
    return polynomials / np.abs(polynomials).sum(-1, keepdims=True)


quartic = jax.jit(roots.circle_quartic)


def _found(polynomials: np.ndarray, dtype):
    """Angles (n, 4) in slot order, and whether each is a root."""
    computed = quartic(tuple(jnp.asarray(column, dtype) for column in polynomials.T))
    every = (*computed.rising, *computed.falling)
    angles = [np.arctan2(np.asarray(r.sin, float), np.asarray(r.cos, float)) for r in every]
    return np.stack(angles, -1), np.stack([np.asarray(r.real) for r in every], -1)


def _apart(a, b):
    return np.abs(np.angle(np.exp(1j * (a - b))))


def _four(kind: str, rng) -> np.ndarray:
    t = rng.uniform(-np.pi, np.pi, (2000, 4))
    if kind == "one at pi":
        t[:, 0] = np.pi
    elif kind == "two close":
        t[:, 3] = t[:, 2] + 1e-3
    elif kind == "three close":
        t[:, 2], t[:, 3] = t[:, 1] + 0.1, t[:, 1] - 0.1
    elif kind == "symmetric":
        t[:, 2:] = -t[:, :2]
    elif kind == "symmetric about a right angle":
        t[:, 2:] = np.pi - t[:, :2]
    return t


BOTH = np.array([1, -1])
NOTHING = [(0, 0, 0, 0, 0), (0, 0, 0, 0, 1), (0, 0, 1, 0, -2), (1, 0, 0, 0, 1)]


class TestCircleQuartic:
    @pytest.mark.parametrize(
        "kind", ["any", "one at pi", "two close", "three close", "symmetric", "symmetric about a right angle"]
    )
    def test_four_real_roots_are_found(self, kind, dtype):
        wanted = _four(kind, np.random.default_rng(3))
        polynomials = _harmonics_of(wanted)
        angles, real = _found(polynomials, dtype)
        off = _apart(angles[:, :, None], wanted[:, None, :]).min(1).max(-1)
        if dtype == np.float64:
            assert real.all()
            assert off.max() < 1e-5
            assert np.quantile(off, 0.9) < 1e-9
        else:
            # A pair 1e-3 apart is a double root to what float32 knows of the coefficients.
            assert np.quantile(off, 0.9) < 2e-2

    @pytest.mark.parametrize("turned", [0.0, 1e-12, 1e-9, 1e-5, 0.4, np.pi / 2, 3.0])
    @pytest.mark.parametrize("off", [0.0, 1e-12, 1e-8])
    def test_two_real_roots_are_found_where_the_other_two_are_complex_and_symmetric(self, turned, off, dtype):
        """An arm whose axes 2 and 3 are parallel, without offsets: joint 3 and its negative are answers
        alike."""
        rng = np.random.default_rng(6)
        first = rng.uniform(-0.99, 0.99, 500)
        second = rng.uniform(1.05, 6, 500) * rng.choice([-1, 1], 500)
        # 2 (cos t - first) (cos t - second), turned.
        along = -(first + second)
        columns = [
            np.full(500, np.cos(2 * turned)),
            np.full(500, np.sin(2 * turned)),
            along * np.cos(turned),
            along * np.sin(turned) + off,
            1 + 2 * first * second,
        ]
        polynomials = np.stack(columns, -1)
        polynomials /= np.abs(polynomials).sum(-1, keepdims=True)
        wanted = turned + np.arccos(first)[:, None] * BOTH
        angles, real = _found(polynomials, dtype)
        away = np.where(real[:, :, None], _apart(angles[:, :, None], wanted[:, None, :]), np.inf).min(1)
        assert (real.sum(-1) == 2).all()
        assert away.max() < (1e-6 if dtype == np.float64 else 2e-3)

    def test_the_number_of_roots_is_that_of_the_eigenvalues_on_the_circle(self):
        rng = np.random.default_rng(4)
        polynomials = rng.normal(size=(2000, 5))
        polynomials /= np.abs(polynomials).sum(-1, keepdims=True)
        angles, real = _found(polynomials, np.float64)
        for (u, v, x, y, w), t, mine in zip(polynomials, angles, real, strict=True):
            every = np.roots([(u - 1j * v) / 2, x - 1j * y, w, x + 1j * y, (u + 1j * v) / 2])
            on_circle = np.angle(every[np.abs(np.abs(every) - 1) < 1e-7])
            assert mine.sum() == len(on_circle)
            for root in on_circle:
                assert _apart(t[mine], root).min() < 1e-6

    def test_two_rise_and_two_fall_in_the_order_of_their_angles(self, dtype):
        polynomials = _harmonics_of(_four("any", np.random.default_rng(5)))
        angles, _ = _found(polynomials, dtype)
        u, v, x, y, _ = polynomials.T[:, :, None]
        derivative = v * np.cos(2 * angles) - u * np.sin(2 * angles) + y * np.cos(angles) - x * np.sin(angles)
        clear = np.abs(derivative) > 1e-3
        assert (derivative[:, :2][clear[:, :2]] > 0).all() and (derivative[:, 2:][clear[:, 2:]] < 0).all()
        assert (angles[:, 0] <= angles[:, 1]).all() and (angles[:, 2] <= angles[:, 3]).all()

    def test_a_double_root_is_kept_as_two(self, dtype):
        wanted = np.tile([[0.3, 0.3, 2.0, -1.5]], (1, 1))
        angles, _ = _found(_harmonics_of(wanted), dtype)
        near = _apart(angles[0], 0.3) < (1e-6 if dtype == np.float64 else 2e-3)
        assert near.sum() == 2 and near[:2].sum() == 1

    @pytest.mark.parametrize(
        ("polynomial", "wanted"),
        [
            (
                (0, 0, 0.3, 0.2, -0.3),
                np.arctan2(0.2, 0.3) + np.arccos(0.15 / np.hypot(0.3, 0.2)) * np.array([1, -1]),
            ),
            ((0.3, 0, 0.2, 0, -0.1), np.arccos(np.roots([0.6, 0.4, -0.4]).max()) * BOTH),
            ((0.3, 0, 0, 0, 0), np.array([1, 3, -1, -3]) * np.pi / 4),
            ((0, 0, 0, 0.5, 0), [0, np.pi]),
        ],
        ids=["no second harmonic", "a cosine alone", "a second harmonic alone", "a sine alone"],
    )
    def test_what_is_missing_does_not_matter(self, polynomial, wanted, dtype):
        angles, real = _found(np.array([polynomial], float), dtype)
        values = [float(roots.harmonics_at(polynomial, np.sin(t), np.cos(t))[0]) for t in angles[0][real[0]]]
        assert np.abs(values).max() < (1e-12 if dtype == np.float64 else 1e-6)
        if len(wanted) > 1:
            for t in wanted:
                assert _apart(angles[0], t).min() < 1e-6

    @pytest.mark.parametrize(
        "polynomial", [(0, 0, 0, 0, 0), (0, 0, 0, 0, 1), (0, 0, 1, 0, -2), (1, 0, 0, 0, 1)]
    )
    def test_value_and_derivative_are_finite_where_there_is_nothing_to_find(self, polynomial, dtype):
        def total(p):
            computed = roots.circle_quartic(tuple(p))
            return sum(r.sin + 2 * r.cos for r in (*computed.rising, *computed.falling))

        p = jnp.asarray(polynomial, dtype)
        assert np.isfinite(total(p)) and np.isfinite(jax.grad(total)(p)).all()


def test_the_last_step_ends_on_the_root():
    # cos(2t) = cos(0.6) at t = 0.3, seen from 1e-5 beside it.
    polynomial = (1.0, 0.0, 0.0, 0.0, -np.cos(0.6))
    beside = jnp.asarray(0.3 + 1e-5)
    sine, cosine = roots._polished(polynomial, jnp.sin(beside), jnp.cos(beside), jnp.asarray(True))
    np.testing.assert_allclose(np.arctan2(sine, cosine), 0.3, atol=1e-9)
    assert roots._polished(polynomial, jnp.sin(beside), jnp.cos(beside), jnp.asarray(False))[0] == jnp.sin(
        beside
    )
