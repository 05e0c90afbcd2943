"""What is known while a program is traced stays known.

Inside a jit every `jnp` call returns a tracer, also of numbers that are concrete: `asarray`,
`astype`, indexing, `stop_gradient`. A kernel that is handed such a number can no longer fold it in, and
is many times slower. Numbers that may be known pass through these functions instead.
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
    """x as an array of a type: a tracer only if x is one, numpy's if x is, else a jax array."""
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
    """The tree with numpy arrays for all leaves whose values are known: constants of a kernel."""
    return jax.tree.map(lambda x: x if isinstance(x, jax.core.Tracer) else np.asarray(x), tree)


def stop_gradient(tree: Tree) -> Tree:
    """The tree without derivatives; leaves whose values are known have none and are handed on as they are."""
    return jax.tree.map(lambda x: jax.lax.stop_gradient(x) if isinstance(x, jax.core.Tracer) else x, tree)
