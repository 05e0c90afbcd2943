"""What is returned: `Solutions` of `solve`, `Projection` of `project` and `refine`, `Trajectory` of
`track`."""

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


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True, eq=False)
class Trajectory:
    """Where the arm stands along a path of T goals."""

    q: jax.Array
    """(..., T, n) joint values [rad, m], within the limits, turns counted on from q0."""
    followed: jax.Array
    """(..., T) bool: on the branch it was on, without a leap. Where neither followed nor jumped, the goal
    is no pose, and the arm waits."""
    jumped: jax.Array
    """(..., T) bool: another branch was taken, or a joint moved by more than `leap`."""
    reached: jax.Array
    """(..., T) bool: the goal itself, or the pose nearest to it, is attained to the tolerance of `solve`."""
    cost: jax.Array
    """(..., T) |dp|^2 + (length * angle)^2 [m^2]."""
    position_error: jax.Array
    """(..., T) [m]"""
    rotation_error: jax.Array
    """(..., T) [rad]; like the cost and the position error NaN where the goal is no pose."""
    goal_error: jax.Array | None = None
    """(..., T) |R^T R - I| of each goal as given. Up to 1e-2 its nearest rotation is the goal, beyond that it
    is no pose; see `Projection`."""
