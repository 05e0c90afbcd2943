"""What the compiler needs to be told: values that it must not compute twice.

XLA on a CPU computes a sum or a product again for every array that needs it: cheap where
little is shared, and many times slower where a long chain is. A pinned value is computed once and kept.
"""

import jax
import jax.numpy as jnp

from ikjax.core.trig import Scalar


def opaque_one(like: jax.Array) -> jax.Array:
    """Ones of the shape and type of `like`, which XLA cannot see through."""
    return jnp.where(like == like, 1, 2).astype(like.dtype)


def holder(like: jax.Array):
    """A function that divides by a one which XLA cannot see through.

    A division is dear enough that XLA keeps its result instead of computing it again; an
    optimization barrier is gone by the time it decides that.
    """
    one = opaque_one(like)
    # A division by a number that is spread out would become a multiplication, and be done again.
    return lambda x: x / (one if jnp.ndim(x) <= one.ndim else opaque_one(x))


def pinned(like: jax.Array):
    """As `holder`, but numbers that are known, and what it returned before, are returned as they are."""
    hold = holder(like)
    done: dict[int, jax.Array] = {}

    def pin(x: Scalar) -> Scalar:
        if not isinstance(x, jax.Array) or id(x) in done:
            return x
        result = hold(x)
        done[id(result)] = result
        return result

    return pin
