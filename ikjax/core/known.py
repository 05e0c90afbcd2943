"""Functions that keep a concrete value concrete while an outer function is traced.

Inside a jit every `jnp` call returns a tracer, also of concrete numbers: `asarray`, `astype`, indexing,
`stop_gradient`. A kernel cannot take such a number in as a constant and is many times slower. A number that
may be known passes through these functions instead. "Known" means concrete: its value can be read while
tracing.
"""

from typing import Any, TypeVar

import jax
import jax.numpy as jnp
import numpy as np

Tree = TypeVar("Tree")


def is_traced(tree: Any) -> bool:
    """Whether any leaf is a tracer, whose value is not known yet."""
    return any(isinstance(x, jax.core.Tracer) for x in jax.tree.leaves(tree))


def as_array(x: Any, dtype: Any) -> Any:
    """x as an array of a type: a tracer only if x is one, a numpy array if x is one, else a jax array."""
    if isinstance(x, jax.core.Tracer):
        return jnp.asarray(x, dtype)
    if isinstance(x, np.ndarray | jax.Array) and x.dtype == dtype:
        return x
    if isinstance(x, np.ndarray):
        return x.astype(dtype)
    # Concrete also while an outer function is traced.
    with jax.ensure_compile_time_eval():
        return jnp.asarray(x, dtype)


def constants(tree: Tree) -> Tree:
    """The tree with numpy arrays for all concrete leaves: the constants of a kernel. Tracers stay."""
    return jax.tree.map(lambda x: x if isinstance(x, jax.core.Tracer) else np.asarray(x), tree)


def stop_gradient(tree: Tree) -> Tree:
    """The tree without derivatives; concrete leaves have none and are returned as they are."""
    return jax.tree.map(lambda x: jax.lax.stop_gradient(x) if isinstance(x, jax.core.Tracer) else x, tree)
