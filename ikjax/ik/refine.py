"""`refine`: from given joints down to the nearest attainable pose.

The default takes damped Newton steps (`ik.multistart`, `ik.newton`). A custom loss is minimized by an optax
optimizer.
"""

from collections.abc import Callable

import jax
import jax.numpy as jnp
import optax
from jax.typing import ArrayLike

from ikjax.arm.arm import Arm
from ikjax.arm.forward import fk, reach
from ikjax.core.pose import nearest_pose, pose_error, to_matrix
from ikjax.core.tolerances import CONVERGED, NEARLY_ROTATION
from ikjax.core.xla import as_array
from ikjax.ik import newton
from ikjax.ik.inline import entries_of
from ikjax.ik.lexicographic import checked_priority
from ikjax.ik.multistart import STEPS, checked_arguments, descend_all, with_best
from ikjax.ik.results import Projection

Loss = Callable[[Arm, jax.Array, jax.Array], jax.Array]
"""`loss(arm, goal, q)` of one goal (4, 4) and joints (n,), a number ()."""


def refine(
    arm: Arm,
    goals: ArrayLike,
    q0: ArrayLike,
    characteristic_length: ArrayLike = 0.1,
    *,
    priority: str = "weighted",
    steps: int = STEPS,
    loss: Loss | None = None,
    optimizer: optax.GradientTransformation | None = None,
) -> Projection:
    """The nearest attainable pose downhill from given joints, within the joint limits.

    Minimizes |dp|^2 + (characteristic_length * angle)^2, where dp is the vector from the goal's point to the
    tool's and angle that of the rotation between them. An arm whose task leaves out the orientation, or what
    is off its plane, is asked for the rest. A start outside the limits is first moved into them, by whole
    turns where that suffices. From there on no step increases the cost, beyond its rounding.

    Args:
        arm: Any arm of up to seven joints, of a family or of none.
        goals: T_world_tool, (..., 4, 4), float32 or float64. Where a rotation is off by up to 1e-2, as with
            three typed decimals, the nearest rotation is the goal; `goal_error` says by how much. Beyond
            that, or with another bottom row, the goal is no pose: errors are NaN, and `q` is where it
            started.
        q0: Initial guess, (..., n) [rad, m], or (..., S, n) for S starts of each goal.
        characteristic_length: Length that counts as much as one radian [m], (); positive. A short one keeps
            the position exact and a long one the orientation, each to about its square over a square length
            of the arm.
        priority: "weighted" is that sum. "position": of the poses with the least distance, the one with the
            least angle; "orientation" the reverse (`ik.lexicographic`), in stages of `steps`. Of the starts,
            those whose first error is the least to 1e-7 (float32: 1e-4) reaches or rad count as equal, and
            the second decides.
        steps: Steps, at most.
        loss: `loss(arm, goal, q)` of one goal (4, 4) and joints (n,), to minimize instead.
        optimizer: An optax optimizer for `loss`; `optax.adam(0.02)` by default. Joints are put back into the
            limits after each step, and the best of all steps is returned.

    Returns:
        `Projection`, fields (...). Its `cost` is the weighted one whatever the priority, and the value of
        `loss` with one. Of several starts it is the best; of those that are equal to rounding, as branches in
        one pose are, the first. Inside jit the loop ends with the last start of the batch.

        `q`, `cost` and the errors have gradients in the goals and the arm's leaves, by the implicit function
        theorem at the minimum; joints at an active bound do not move. Those of `q` are zero where it is not
        `converged`. With a priority they are those of a last sum of both errors, to some 1e-3. With `loss`
        the gradients are those of its steps.

    Raises:
        ValueError: Wrong shapes or types.
    """
    goals, arm = checked_arguments(arm, goals, characteristic_length, steps)
    starts = _as_starts(arm, goals, q0)
    if loss is None and optimizer is not None:
        raise ValueError("optimizer is of a loss: give loss= too")
    if loss is not None:
        if priority != "weighted":
            raise ValueError(f"priority is of the errors, and not of a loss: got {priority!r} with loss=")
        return with_best(arm, goals, minimize_loss(arm, goals, starts, loss, optimizer, steps))
    priority = checked_priority(arm, priority)
    branches = descend_all(arm, goals, starts, characteristic_length, steps, priority)
    return with_best(arm, goals, branches, priority)


def _as_starts(arm: Arm, goals: jax.Array, q0) -> jax.Array:
    """The initial guesses as (..., S, n).

    Raises:
        ValueError: A wrong shape.
    """
    starts = as_array(q0, goals.dtype)
    batch = goals.shape[:-2]
    wanted = (*batch, arm.n)
    if starts.ndim < goals.ndim or (goals.ndim == 2 and starts.ndim == 1):
        starts = starts[..., None, :] if starts.ndim else starts
    if starts.ndim == 0 or starts.shape[-1] != arm.n:
        raise ValueError(f"q0 must have shape {wanted} or (..., S, {arm.n}), got {jnp.shape(q0)}")
    if starts.shape[-2] == 0:
        raise ValueError(f"q0 must hold at least one start, got shape {jnp.shape(q0)}")
    try:
        return jnp.broadcast_to(starts, (*batch, starts.shape[-2], arm.n))
    except ValueError as error:
        raise ValueError(f"q0 must have shape {wanted} or (..., S, {arm.n}), got {jnp.shape(q0)}") from error


def minimize_loss(
    arm: Arm,
    goals: jax.Array,
    starts: jax.Array,
    loss: Loss,
    optimizer: optax.GradientTransformation | None,
    steps: int,
) -> Projection:
    """The best of all steps from each start (..., S, n), fields (..., S); arguments as in `refine`.

    The loss gets the pose nearest to each goal, or the goal as it is where there is none.
    """
    solver = optax.adam(0.02) if optimizer is None else optimizer
    columns = newton.into_limits(arm, tuple(starts[..., i] for i in range(arm.n)))
    starts, size = jnp.stack(columns, axis=-1), jnp.asarray(reach(arm), goals.dtype)
    low, high = arm.limits[:, 0], arm.limits[:, 1]

    def minimize_one(goal, q0):
        value_and_gradient = jax.value_and_grad(lambda q: loss(arm, goal, q))

        def evaluate(q, best):
            value, gradient = value_and_gradient(q)
            # A loss that is not finite is never the best, and its gradient is taken as zero.
            gradient = jnp.where(jnp.isfinite(gradient), gradient, 0)
            active = ((q <= low) & (gradient > 0)) | ((q >= high) & (gradient < 0))
            free = jnp.where(active, 0, gradient)
            current = q, value, jnp.sqrt(jnp.sum(free * free))
            return gradient, jax.tree.map(
                lambda new, old: jnp.where(value < best[1], new, old), current, best
            )

        def step(carry, _):
            q, inner, best = carry
            gradient, best = evaluate(q, best)
            # Optax mixes types as the caller's settings may forbid.
            with jax.numpy_dtype_promotion("standard"):
                moves, inner = solver.update(gradient, inner, q)
            return (jnp.clip(optax.apply_updates(q, moves), low, high), inner, best), None

        none = q0, jnp.full((), jnp.inf, q0.dtype), jnp.zeros((), q0.dtype)
        (q, _, best), _ = jax.lax.scan(step, (q0, solver.init(q0), none), length=steps)
        return evaluate(q, best)[1]

    pose, off = nearest_pose(entries_of(goals), jax.lax.stop_gradient(size))
    proper = off <= NEARLY_ROTATION
    goals = jnp.where(proper[..., None, None], to_matrix(pose), goals)
    flat = starts.reshape(-1, *starts.shape[-2:])
    best = jax.vmap(jax.vmap(minimize_one, (None, 0)))(goals.reshape(-1, 4, 4), flat)
    q, value, gradient_norm = (x.reshape(*starts.shape[:-1], *x.shape[2:]) for x in best)
    proper = proper[..., None]
    errors = pose_error(fk(arm, q), goals[..., None, :, :])
    distance, angle = (jnp.where(proper, x, jnp.nan) for x in errors)
    converged = proper & jnp.isfinite(value) & (gradient_norm <= CONVERGED[q.dtype.name])
    return Projection(q, value, distance, angle, gradient_norm, converged)
