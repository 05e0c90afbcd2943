"""What `project` and `refine` return: the nearest pose found, and how near."""

import dataclasses

import jax


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True, eq=False)
class Projection:
    """The nearest attainable pose of every goal, within the joint limits."""

    q: jax.Array
    """(..., n) joint values [rad, m], within the limits; always finite."""
    cost: jax.Array
    """(...) |dp|^2 + (length * angle)^2 [m^2], or a loss of the caller's own, which is handed the goal as it
    is where that is no pose. Else NaN there, as the errors and the gradient's norm are."""
    position_error: jax.Array
    """(...) distance of `fk(arm, q)` from the goal [m]; of what the arm's task asks for."""
    rotation_error: jax.Array
    """(...) angle of `fk(arm, q)` from the goal, or from the rotation nearest to it [rad]; zero where the
    task asks for none."""
    gradient_norm: jax.Array
    """(...) length of the slope of half the cost, lengths in reaches: zero where no small move improves the
    pose. Joints that a limit holds back are left out; a residual of more than a reach divides it. With a
    priority, of the first error and a last share of the second, by that share's root. Of a loss of the
    caller's own, the slope as it is."""
    converged: jax.Array
    """(...) bool: the goal is a pose, or nearly, and gradient_norm at most 1e-8 (float64) or 2e-5 (float32).
    Not where rounding decides whether it is: where the base or the goal is so far off that the rounding of
    positions is more than that, or where the tool moves so little, as a share of the reach and counting
    `length` a radian, that every pose would do."""
    goal_error: jax.Array | None = None
    """(...) |R^T R - I| of the goal as given, in the Frobenius norm; infinite where no rotation is near it
    (reflections, numbers that are not finite, another bottom row). Up to 1e-2 the nearest rotation is what
    was projected. None in `branches`."""
    branches: "Projection | None" = None
    """The same from every start, its fields (..., S) and q (..., S, n); None there itself."""
