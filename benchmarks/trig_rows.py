"""Row (a): speed and error of our trigonometry, compared with jnp.

Both are compiled with the same options. Errors are measured with mpmath, on numbers of the timed arrays,
which are rounded to their type first.
"""

import dataclasses

import clock
import jax
import jax.numpy as jnp
import mpmath
import numpy as np

from ikjax.core import trig
from ikjax.core.xla import wide_vectors


@dataclasses.dataclass(frozen=True)
class TrigRow:
    """One function in one type: millions per second and worst absolute error [rad or 1] of both."""

    name: str
    dtype: str
    ours: float
    theirs: float
    our_error: float
    their_error: float
    target: float

    @property
    def ratio(self) -> float:
        return self.ours / self.theirs


def _arguments(dtype: str, count: int) -> dict[str, tuple[jax.Array, ...]]:
    rng = np.random.default_rng(0)
    points = rng.normal(size=(2, count)) * 10 ** rng.uniform(-3, 3, (2, count))
    angles = rng.uniform(-10, 10, count)
    return {
        "atan2": tuple(jnp.asarray(p, dtype) for p in points),
        "sincos": (jnp.asarray(angles, dtype),),
    }


FUNCTIONS = {
    "atan2": (trig.atan2, jnp.arctan2, lambda y, x: (mpmath.atan2(y, x),)),
    "sincos": (trig.sincos, lambda x: (jnp.sin(x), jnp.cos(x)), lambda x: (mpmath.sin(x), mpmath.cos(x))),
}
TARGETS = {"atan2": {"float32": 10, "float64": 2}, "sincos": {"float32": 3, "float64": 2}}


def measure(name: str, dtype: str, count: int, runs: int, sample: int) -> TrigRow:
    """Time both on `count` numbers, and compare `sample` of the results with 40-digit values."""
    arguments = _arguments(dtype, count)[name]
    ours, theirs, exact = FUNCTIONS[name]
    rates, errors = [], []
    with mpmath.workdps(40):
        wanted = [exact(*map(mpmath.mpf, row)) for row in np.stack(arguments, 1)[:sample].tolist()]
        for function in (ours, theirs):
            call = jax.jit(function, compiler_options=wide_vectors()).lower(*arguments).compile()
            timing = clock.measure(clock.blocking(lambda call=call: call(*arguments)), runs, inner=10)
            rates.append(timing.rate(count))
            outputs = np.stack(jax.tree.leaves(call(*arguments)), 1)[:sample].tolist()
            gaps = [
                abs(got - want)
                for row, exact_row in zip(outputs, wanted, strict=True)
                for got, want in zip(row, exact_row, strict=True)
            ]
            errors.append(float(max(gaps)))
    return TrigRow(name, dtype, *rates, *errors, TARGETS[name][dtype])
