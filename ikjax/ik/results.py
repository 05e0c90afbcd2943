"""Results: `Solutions` of `solve`, `Projection` of `project` and `refine`, `Trajectory` of `track`."""

import dataclasses
import weakref
from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ikjax.core.typing import ArrayInput


class Origin(NamedTuple):
    """Joints before they are put into an array, and before their derivatives.

    Where the choice of a slot is made in the trace of `solve`, it is made among these numbers: the array of
    all slots is never stored, and only the chosen slot is differentiated.
    """

    slots: list[list[jax.Array]]
    """S lists of n numbers (...): the joints as in `Solutions.q`, without derivatives."""
    valid: jax.Array
    """(..., S): which slots reach their goal. The others have zero derivatives."""
    differentiable: Callable[[jax.Array, jax.Array], jax.Array]
    """From joints (..., n) that stand in a slot, and whether that slot reaches its goal, (...), to the same
    joints with their derivatives."""


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True, eq=False)
class Solutions:
    """Every branch of every goal, in S fixed slots; `arm.branches` names them.

    Slots are never sorted and never merged: slot k means the same for every goal.
    """

    q: jax.Array
    """(..., S, n) joint values [rad, m], in (-pi, pi] where a whole turn leaves the pose (with `coupling` it
    may not); always finite, also where not valid."""
    valid: jax.Array
    """(..., S) bool: the branch reaches the goal, as measured by forward kinematics."""
    margin: jax.Array
    """(..., S) clearance [m] from the fold where the branch appears or ends: positive inside, zero
    on it, negative outside. Not a Euclidean distance. Where an arm of few joints has no pose at the goal, the
    margin is minus the distance of the goal from its poses, a radian counting as one reach; where the goal is
    no pose, it is minus the reach."""
    continuum: jax.Array
    """(..., S) bool: one joint is arbitrary; the slot stands for a one-parameter family of answers."""
    position_error: jax.Array
    """(..., S) distance of `fk(arm, q)` from the goal [m]; the reach where the goal is no pose."""
    rotation_error: jax.Array
    """(..., S) angle of `fk(arm, q)` from the goal [rad]; pi where the goal is no pose."""
    is_pose: jax.Array | None = None
    """(...) bool: the goal was a pose: finite numbers, a bottom row (0, 0, 0, 1), and a rotation to 1e-5.
    Where not, nothing was solved. None, in solutions made by hand, counts as True for all goals."""

    def __repr__(self) -> str:
        goals, slots = self.valid.shape[:-1], self.valid.shape[-1]
        text = f"Solutions of goals {goals}, {slots} slots of {self.q.shape[-1]} joints, {self.q.dtype}"
        if isinstance(self.valid, jax.core.Tracer) or not isinstance(self.valid, jax.Array | np.ndarray):
            return f"<{text}>"
        solved = np.asarray(self.valid).any(-1)
        return f"<{text}: {solved.sum()} of {solved.size} goals are answered>"

    @property
    def origin(self) -> "Origin | None":
        """What `q` is made of; known only in the trace of the `solve` that made it."""
        return _origins.get(self)

    def with_origin(self, origin: "Origin") -> "Solutions":
        """The same solutions, with their origin. It is no field, so it does not leave the trace."""
        _origins[self] = origin
        return self

    def where(self, ok: ArrayInput) -> "Solutions":
        """These solutions, valid only where a mask of one's own is true: a collision checker's, for one.

        Args:
            ok: (..., S) bool, or of a shape that broadcasts to it.

        Returns:
            `Solutions` of the same shape; only `valid` differs. `nearest` chooses among what is left.

        Raises:
            ValueError: A shape that does not broadcast, or a type that is not bool.
        """
        ok, shape = jnp.asarray(ok), self.valid.shape
        # Whether it broadcasts: trailing axes agree or are 1, and there are no more of them.
        pairs = zip(ok.shape[::-1], shape[::-1], strict=False)
        if ok.dtype != bool or ok.ndim > len(shape) or any(x not in (1, y) for x, y in pairs):
            raise ValueError(f"ok must be bool, of shape {shape}, got {ok.dtype}, {ok.shape}")
        narrowed = dataclasses.replace(self, valid=self.valid & jnp.broadcast_to(ok, shape))
        return narrowed if self.origin is None else narrowed.with_origin(self.origin)

    def require(self) -> "Solutions":
        """These solutions, if every goal has a valid one.

        Host side: it looks at the values, so it cannot be used inside jit.

        Raises:
            ValueError: Naming the goals that are no poses, with the remedy, and those without a solution,
                with how far they are from one. Also inside jit, vmap or grad.
        """
        if isinstance(self.valid, jax.core.Tracer):
            raise ValueError("require() looks at values, so it cannot stand inside jit, vmap or grad")
        solved = np.asarray(self.valid).any(-1)
        if solved.all():
            return self
        pose = np.ones(solved.shape, bool) if self.is_pose is None else np.asarray(self.is_pose)
        lines = []
        if not pose.all():
            names = _first_names([str(name) for name in _indices(~pose)])
            lines.append(
                f"{(~pose).sum()} of {pose.size} goals are no poses: goal {names}. A rounded rotation is "
                "made one by ikjax.pose(matrix=T, orthonormalize=True); is the matrix transposed? "
                "ikjax.check_goals(arm, goals) says what is wrong"
            )
        unsolved = pose & ~solved
        if unsolved.any():
            margins = np.asarray(self.margin).max(-1)[unsolved]
            rows = zip(_indices(unsolved), margins, strict=True)
            names = _first_names([f"{name} (margin {margin:.3g} m)" for name, margin in rows])
            lines.append(f"{unsolved.sum()} of {solved.size} goals have no solution: goal {names}")
        raise ValueError("\n".join(lines))


_origins: weakref.WeakKeyDictionary[Solutions, Origin] = weakref.WeakKeyDictionary()
"""The origins of solutions that are being traced, for as long as these live."""


def _indices(flags: np.ndarray) -> list:
    """Where flags are set, as a user would index them."""
    return [tuple(map(int, index)) if len(index) != 1 else int(index[0]) for index in np.argwhere(flags)]


def _first_names(names: list[str]) -> str:
    """The first five, and how many more there are."""
    return ", ".join(names[:5]) + (f" and {len(names) - 5} more" if len(names) > 5 else "")


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True, eq=False)
class Projection:
    """The nearest attainable pose of every goal, within the joint limits."""

    q: jax.Array
    """(..., n) joint values [rad, m], within the limits; always finite."""
    cost: jax.Array
    """(...) |dp|^2 + (characteristic_length * angle)^2 [m^2], or the value of a custom loss. NaN where the
    goal is no pose, as the errors and the gradient norm are; a custom loss gets such a goal as it is."""
    position_error: jax.Array
    """(...) distance of `fk(arm, q)` from the goal [m], in what the arm's task asks for."""
    rotation_error: jax.Array
    """(...) angle of `fk(arm, q)` from the goal, or from the rotation nearest to it [rad]; zero where the
    task asks for none."""
    gradient_norm: jax.Array
    """(...) norm of the gradient of half the cost, lengths in reaches: zero where no small move improves the
    pose. Joints at an active bound are left out; a residual of more than one reach divides it. With a
    priority it is that of the first error and a last weight times the second, over the root of that weight.
    With a custom loss it is that of the loss itself."""
    converged: jax.Array
    """(...) bool: the goal is a pose, or nearly, and gradient_norm at most 1e-8 (float64) or 2e-5 (float32).
    False where rounding decides: where the base or the goal is so far off that the rounding of positions is
    more than that, or where the joints move the tool so little (as a share of the reach, with
    `characteristic_length` for a radian) that every pose would pass."""
    goal_error: jax.Array | None = None
    """(...) |R^T R - I| of the goal as given, in the Frobenius norm; infinite where no rotation is near it
    (reflections, numbers that are not finite, another bottom row). Up to 1e-2 the nearest rotation was
    projected. None in `branches`."""
    branches: "Projection | None" = None
    """The results from every start, fields (..., S) and q (..., S, n); their own `branches` is None."""


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True, eq=False)
class Trajectory:
    """The joints of the arm along a path of T goals."""

    q: jax.Array
    """(..., T, n) joint values [rad, m], within the limits, with the whole turns that follow from q0."""
    followed: jax.Array
    """(..., T) bool: the arm stayed on its branch, and no joint jumped. Where neither followed nor jumped,
    the goal is no pose, and the arm does not move."""
    jumped: jax.Array
    """(..., T) bool: another branch was taken, or a joint moved by more than `max_joint_step`."""
    reached: jax.Array
    """(..., T) bool: the goal, or the rotation nearest to it, is met to the tolerance of `solve`."""
    cost: jax.Array
    """(..., T) |dp|^2 + (characteristic_length * angle)^2 [m^2]."""
    position_error: jax.Array
    """(..., T) distance from the goal [m]."""
    rotation_error: jax.Array
    """(..., T) angle from the goal [rad]; like cost and position error, NaN where the goal is no pose."""
    goal_error: jax.Array | None = None
    """(..., T) |R^T R - I| of each goal as given. Up to 1e-2 the nearest rotation is the goal; beyond that
    the goal is no pose. See `Projection`."""
