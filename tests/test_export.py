"""Programs lower for GPUs and TPUs, of which none is at hand: nothing is said of their speed."""

import functools
import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import export

import ikjax
from ikjax.maps.kernel import program
from ikjax.maps.kernel.loop import CALL, loop

PLATFORMS = ("cuda", "tpu")
GOALS = jax.ShapeDtypeStruct((256, 4, 4), jnp.float32)
PUMA, SO101, FRANKA = (ikjax.robots.get(name) for name in ("puma560", "so101", "fer"))
Q = jnp.zeros(6, jnp.float32)

CALLS = {
    "solve": lambda T: ikjax.solve(PUMA, T),
    "solve, its gradient": jax.grad(lambda T: ikjax.solve(PUMA, T).q.sum()),
    "nearest": lambda T: ikjax.nearest(PUMA, ikjax.within_limits(PUMA, ikjax.solve(PUMA, T)), Q),
    "solve, seven joints": lambda T: ikjax.solve(FRANKA, T, redundancy=0.3),
    "project": lambda T: ikjax.project(SO101, T, extra_starts=2),
    "project, its gradient": jax.grad(lambda T: ikjax.project(SO101, T, extra_starts=2).q.sum()),
}


def lowers(f, *shapes):
    text = export.export(jax.jit(f), platforms=PLATFORMS)(*shapes).mlir_module()
    # What only one platform knows is a custom call; that of a layout or of sharding is XLA's own.
    assert not set(re.findall(r"custom_call @([\w.]+)", text)) - {"LayoutConstraint", "Sharding"}


@pytest.mark.parametrize("call", list(CALLS))
def test_a_program_lowers_for_other_devices(call):
    lowers(CALLS[call], GOALS)


def test_a_step_of_a_sweep_lowers_for_other_devices(monkeypatch):
    class FoundError(Exception):
        pass

    def found(spec, tables, mesh):
        raise FoundError(spec, tables)

    monkeypatch.setattr(program, "_compile_loop", found)
    # Another number of orientations than other tests have, or the program is in the cache.
    with pytest.raises(FoundError) as error:
        ikjax.sweep(PUMA, ikjax.maps.around(PUMA, 0.37), 65, dtype="float32")
    spec, tables = error.value.args
    data = tables, spec.parts.mounted
    shapes = jax.tree.map(lambda x: jax.ShapeDtypeStruct(x.shape, x.dtype), data)
    index = jax.ShapeDtypeStruct((CALL, len(spec.positions.shape)), np.int32)
    lowers(functools.partial(loop, spec), *shapes, index, *[jax.ShapeDtypeStruct((), np.int32)] * 3)
