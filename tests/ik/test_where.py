"""`Solutions.where`: a mask of one's own."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import ikjax

ARM = ikjax.robots.ur5e()
Q = np.array([[0.3, -1.5, 0.9, 0.7, -1.6, 0.2], [0.1, -1.0, 1.2, -0.7, -1.2, 0.5]])


def test_only_valid_is_narrowed():
    sol = ikjax.solve(ARM, ikjax.fk(ARM, Q))
    ok = np.arange(8) % 2 == 0
    free = sol.where(ok)
    np.testing.assert_array_equal(free.valid, np.asarray(sol.valid) & ok)
    np.testing.assert_array_equal(free.q, sol.q)
    np.testing.assert_array_equal(sol.where(ok[None]).valid, free.valid)
    q, found = ikjax.nearest(ARM, free, Q)
    assert found.all()
    for answer, slots in zip(np.asarray(q), np.asarray(sol.q)[:, ::2], strict=True):
        assert np.abs(np.sin((slots - answer) / 2)).max(-1).min() < 1e-9


@pytest.mark.slow
def test_the_choice_and_its_gradient_within_a_jit_are_those_outside():
    goals = ikjax.fk(ARM, Q)

    def chosen(goals, narrow):
        sol = ikjax.within_limits(ARM, ikjax.solve(ARM, goals))
        if narrow:
            sol = sol.where(sol.q[..., 2] < 0)
        return ikjax.nearest(ARM, sol, Q)[0]

    outside = chosen(goals, True)
    np.testing.assert_allclose(jax.jit(chosen, static_argnums=1)(goals, True), outside, atol=1e-12)
    assert (outside[:, 2] < 0).all() and (chosen(goals, False)[:, 2] > 0).all()
    slopes = jax.jit(jax.grad(lambda goals: chosen(goals, True).sum()))(goals)
    assert np.isfinite(slopes).all() and np.abs(slopes).max() > 0.1


@pytest.mark.parametrize("ok", [np.ones(7, bool), np.ones((3, 2, 8), bool), np.ones(8)])
def test_a_mask_of_another_shape_or_type_is_refused(ok):
    sol = ikjax.solve(ARM, ikjax.fk(ARM, Q))
    with pytest.raises(ValueError, match=r"ok must be bool, of shape \(2, 8\)"):
        sol.where(jnp.asarray(ok))
