"""What `solve` returns: every branch of every goal, with masks."""

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
    is outside by how far it is from its poses, a radian counting one reach; one that is no pose, by the
    reach."""
    continuum: jax.Array
    """(..., S) bool: one joint is arbitrary; the slot stands for a family of answers."""
    position_error: jax.Array
    """(..., S) distance of `fk(arm, q)` from the goal [m]; the reach where the goal is no pose."""
    rotation_error: jax.Array
    """(..., S) angle of `fk(arm, q)` from the goal [rad]; pi where the goal is no pose."""
    is_pose: jax.Array | None = None
    """(...) bool: the goal was a pose: finite numbers, a bottom row (0, 0, 0, 1), and a rotation to 1e-5.
    Where not, nothing was solved. None, in solutions made by hand, counts as all."""

    def require(self) -> "Solutions":
        """These solutions, if every goal has a valid one.

        Host side: it looks at the values, so it cannot stand inside jit.

        Raises:
            ValueError: Naming the goals that are no poses, with the remedy, and those without a solution,
                with how far they are from one.
        """
        if isinstance(self.valid, jax.core.Tracer):
            raise ValueError("require() looks at values, so it cannot stand inside jit, vmap or grad")
        found = np.asarray(self.valid).any(-1)
        if found.all():
            return self
        pose = np.ones(found.shape, bool) if self.is_pose is None else np.asarray(self.is_pose)
        said = []
        if not pose.all():
            names = _named([str(name) for name in _indices(~pose)])
            said.append(
                f"{(~pose).sum()} of {pose.size} goals are no poses: goal {names}. A rounded rotation is "
                "made one by ikjax.pose(matrix=T, orthonormalize=True); is the matrix transposed? "
                "ikjax.check_goals(arm, goals) says what is wrong"
            )
        lost = pose & ~found
        if lost.any():
            gaps = np.asarray(self.margin).max(-1)[lost]
            rows = zip(_indices(lost), gaps, strict=True)
            names = _named([f"{name} (margin {gap:.3g} m)" for name, gap in rows])
            said.append(f"{lost.sum()} of {found.size} goals have no solution: goal {names}")
        raise ValueError("\n".join(said))


def _indices(flags: np.ndarray) -> list:
    """Where flags are set, as a user would index them."""
    return [tuple(map(int, index)) if len(index) != 1 else int(index[0]) for index in np.argwhere(flags)]


def _named(names: list[str]) -> str:
    """The first five."""
    return ", ".join(names[:5]) + (f" and {len(names) - 5} more" if len(names) > 5 else "")
