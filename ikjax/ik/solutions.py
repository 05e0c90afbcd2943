"""What `solve` returns: every branch of every goal, with masks.

Storey: ik.
"""

import dataclasses

import jax
import numpy as np


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True, eq=False)
class Solutions:
    """Every branch of every goal, in S fixed slots; `arm.branches` names them.

    Slots are never sorted and never merged: slot k means the same for every goal.
    """

    q: jax.Array
    """(..., S, n) joint values [rad, m], in (-pi, pi] where a whole turn leaves the pose (`coupling` may part
    them from that); always finite, also where not valid."""
    valid: jax.Array
    """(..., S) bool: the branch reaches the goal, as measured by forward kinematics."""
    margin: jax.Array
    """(..., S) clearance [m] from the fold where the branch appears or ends: positive inside, zero
    on it, negative outside. Not a Euclidean distance. A goal that is none of an arm of few joints
    is outside by how far it is from its poses, a radian counting one reach."""
    continuum: jax.Array
    """(..., S) bool: one joint is arbitrary; the slot stands for a family of answers."""
    position_error: jax.Array
    """(..., S) distance of `fk(arm, q)` from the goal [m]."""
    rotation_error: jax.Array
    """(..., S) angle of `fk(arm, q)` from the goal [rad]."""

    def require(self) -> "Solutions":
        """These solutions, if every goal has a valid one.

        Host side: it looks at the values, so it cannot stand inside jit.

        Raises:
            ValueError: Naming the goals without a solution, and how far they are from one.
        """
        if isinstance(self.valid, jax.core.Tracer):
            raise ValueError("require() looks at values, so it cannot stand inside jit, vmap or grad")
        found = np.asarray(self.valid).any(-1)
        if found.all():
            return self
        lost = np.argwhere(~found)
        gap = np.asarray(self.margin).max(-1)[~found]
        names = ", ".join(
            f"{tuple(map(int, index)) if len(index) != 1 else int(index[0])} (margin {g:.3g} m)"
            for index, g in zip(lost[:5], gap[:5], strict=True)
        )
        more = f" and {len(lost) - 5} more" if len(lost) > 5 else ""
        raise ValueError(f"{len(lost)} of {found.size} goals have no solution: goal {names}{more}")
