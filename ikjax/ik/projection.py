"""What `project` and `refine` return: the nearest pose found, and how near.

Storey: ik.
"""

import dataclasses

import jax


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True, eq=False)
class Projection:
    """The nearest attainable pose of every goal, within the joint limits."""

    q: jax.Array
    """(..., n) joint values [rad, m], within the limits; always finite."""
    cost: jax.Array
    """(...) |dp|^2 + (length * angle)^2 [m^2], or a loss of the caller's own. Of a goal that is no pose it
    says nothing; `converged` tells."""
    position_error: jax.Array
    """(...) distance of `fk(arm, q)` from the goal [m]; of what the arm's task asks for."""
    rotation_error: jax.Array
    """(...) angle of `fk(arm, q)` from the goal [rad]; zero where the task asks for none."""
    gradient_norm: jax.Array
    """(...) length of the slope of half the cost, lengths in reaches: zero where no small move improves the
    pose. Joints that a limit holds back are left out; a residual of more than a reach divides it. With a
    priority, of the first error and a last share of the second, by that share's root. Of a loss of the
    caller's own, the slope as it is."""
    converged: jax.Array
    """(...) bool: the goal is a pose, and gradient_norm at most 1e-8 (float64) or 2e-5 (float32)."""
    branches: "Projection | None" = None
    """The same from every start, its fields (..., S) and q (..., S, n); None there itself."""
