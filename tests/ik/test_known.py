"""What a user's jit captures stays known: a captured arm is constants of its program, and never traced."""

import dataclasses
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import ikjax
from ikjax.core.xla import as_array, constants, is_traced, stop_gradient

ARM = ikjax.robots.get("puma560").astype(np.float32)
GOALS = np.tile(np.eye(4, dtype=np.float32), (3, 1, 1))
Q = np.zeros(6, np.float32)
ONES = np.ones((1, 6), np.float32)

CALLS = {
    "solve": lambda arm, T: ikjax.solve(arm, T),
    "solve, joints": lambda arm, T: ikjax.solve(arm, T).q,
    "gradient": lambda arm, T: jax.grad(lambda T: ikjax.solve(arm, T).q.sum())(T),
    "project": lambda arm, T: ikjax.project(arm, T, steps=2, extra_starts=1).q,
    "refine": lambda arm, T: ikjax.refine(arm, T, Q, steps=2).q,
    "track": lambda arm, T: ikjax.track(arm, T, Q, steps=2).q,
    "nearest": lambda arm, T: ikjax.nearest(arm, ikjax.solve(arm, T), Q)[0],
    "within_limits": lambda arm, T: ikjax.within_limits(arm, ikjax.solve(arm, T)).q,
    "limited_margins": lambda arm, T: ikjax.limited_margins(arm, ikjax.solve(arm, T)).margin,
    "manipulability": lambda arm, T: ikjax.manipulability(arm, T[:, 0, :1] * ONES),
    "sigma_min": lambda arm, T: ikjax.sigma_min(arm, T[:, 0, :1] * ONES),
    "limit_clearance": lambda arm, T: ikjax.limit_clearance(arm, T[:, 0, :1] * ONES),
    "fk": lambda arm, T: ikjax.fk(arm, T[:, 0, :1] * ONES),
    "jacobian": lambda arm, T: ikjax.jacobian(arm, T[:, 0, :1] * ONES),
}


@pytest.fixture
def traced_numbers(monkeypatch):
    """The leaves' types that kernels and forward kinematics are handed."""
    from ikjax.arm import arm as arms

    seen = []
    numbers = arms.numbers

    def looked(leaf):
        seen.append(type(leaf))
        return numbers(leaf)

    for module in list(sys.modules.values()):
        if getattr(module, "numbers", None) is numbers and module.__name__.startswith("ikjax"):
            monkeypatch.setattr(module, "numbers", looked)
    return seen


@pytest.mark.parametrize("call", list(CALLS))
@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_a_captured_arm_is_no_tracer(call, dtype, traced_numbers):
    """Also where its type has to be changed on the way."""
    arm = ARM.astype(dtype)
    jax.make_jaxpr(lambda T: CALLS[call](arm, T))(GOALS)
    assert traced_numbers
    assert not [kind for kind in traced_numbers if issubclass(kind, jax.core.Tracer)]


def test_only_what_a_design_varies_is_traced(traced_numbers):
    def count(a, T):
        return ikjax.solve(dataclasses.replace(ARM, a=a), T).valid.sum()

    jax.make_jaxpr(count)(ARM.a, GOALS)
    kinds = [kind for kind in traced_numbers if issubclass(kind, jax.core.Tracer)]
    assert kinds
    assert len(kinds) < len(traced_numbers) / 4


def test_known_numbers_stay_known_while_a_program_is_traced():
    def look(x):
        assert not is_traced(as_array(ARM.a, jnp.float32))
        assert not is_traced(ARM.astype(np.float64))
        assert not is_traced(stop_gradient(ARM))
        assert isinstance(constants(ARM).alpha, np.ndarray)
        assert is_traced(as_array(x, jnp.float32)) and is_traced(stop_gradient(x))
        return x

    jax.jit(look)(jnp.ones(3))
