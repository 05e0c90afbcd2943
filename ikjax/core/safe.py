"""Square roots, norms and quotients with a finite value and a finite derivative at every edge.

All other files handle their edges (zero lengths, negative radicands, division by zero) by calling these. A
Python number stays one: as an array it would bring its own type into a kernel of another.

Source: the double-where trick; the JAX FAQ, "Gradients contain NaN where using where".
"""

import math

import jax.numpy as jnp

from ikjax.core.trig import Scalar


def sqrt(x: Scalar) -> Scalar:
    """Square root; zero below zero. Its derivative is zero, not infinite, at and below zero."""
    if isinstance(x, int | float):
        return math.sqrt(max(x, 0.0))
    inside = x > 0
    # Two masks on purpose: the inner one keeps the unused side finite, because reverse mode multiplies its
    # derivative by zero, and 0 * inf is NaN. It is filled with the least normal number, because a compiler
    # may compute an x of rounding errors twice, once above and once below zero.
    return jnp.where(inside, jnp.sqrt(jnp.where(inside, x, jnp.finfo(x.dtype).tiny)), 0)


def reciprocal_sqrt(x: Scalar) -> Scalar:
    """1 / sqrt(x); zero at and below zero, with its derivative."""
    if isinstance(x, int | float):
        return 1 / math.sqrt(x) if x > 0 else 0.0
    inside = x > 0
    return jnp.where(inside, 1 / jnp.sqrt(jnp.where(inside, x, 1)), 0)


def divide(numerator: Scalar, denominator: Scalar) -> Scalar:
    """Quotient; zero where the denominator is zero, with its derivatives."""
    if isinstance(denominator, int | float):
        return numerator / denominator if denominator else 0.0 * numerator
    usable = denominator != 0
    return jnp.where(usable, numerator / jnp.where(usable, denominator, 1), 0)


def norm(*components: Scalar) -> Scalar:
    """Euclidean norm, with derivative zero at the origin.

    Accurate to rounding while the squares neither overflow nor underflow; kernels work in units of the
    reach, where they do not.
    """
    return sqrt(sum(c * c for c in components))


def sign(x: Scalar) -> Scalar:
    """-1 below zero, else 1: never zero."""
    if isinstance(x, int | float):
        return -1.0 if x < 0 else 1.0
    return jnp.where(x < 0, -1, 1).astype(x.dtype)
