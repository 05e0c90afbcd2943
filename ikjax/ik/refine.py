"""`refine`: from given joints down to the nearest attainable pose.

The default takes damped Newton steps (`ik.multistart`, `ik.newton`); a loss of the caller's own is minimized
by an optax optimizer.
"""

import jax
import jax.numpy as jnp
import optax

from ikjax.arm.arm import Arm
from ikjax.arm.forward import fk, reach
from ikjax.core.known import as_array
from ikjax.core.pose import nearest_pose, pose_error, to_matrix
from ikjax.core.tolerances import CONVERGED, NEARLY_ROTATION
from ikjax.ik import lexicographic as priorities
from ikjax.ik import newton
from ikjax.ik.inline import entries_of
from ikjax.ik.multistart import STEPS, best_of, checked, descended
from ikjax.ik.results import Projection


def refine(
    arm: Arm,
    goals,
    q0,
    characteristic_length: float = 0.1,
    *,
    priority: str = "weighted",
    steps: int = STEPS,
    loss=None,
    optimizer=None,
) -> Projection:
    """The nearest attainable pose downhill from given joints, within the joint limits.

    Minimizes |dp|^2 + (characteristic_length * angle)^2, dp being the way between the tool's point and the
    goal's and angle the rotation between them. An arm whose task leaves out the orientation, or what lies off
    its plane, is asked for the rest. A start outside the limits is first moved into them, by whole turns
    where that will do. From there on no step makes the cost greater, beyond its rounding.

    Args:
        arm: Any arm of up to seven joints, of a family or of none.
        goals: T_world_tool, (..., 4, 4), float32 or float64. Of a rotation that is off by up to 1e-2, as
            three typed decimals are, the nearest rotation is the goal; `goal_error` says by how much. Beyond
            that, or of another bottom row, the goal is no pose: errors are NaN, and `q` is where it started.
        q0: (..., n) joint values to start from, or (..., S, n) for S starts of each goal.
        characteristic_length: What a radian is worth [m]; positive. A short one holds the point and a long
            one the orientation, each to about its square over a square length of the arm.
        priority: "weighted" is that sum. "position": of the poses with the least distance, that of the least
            angle; "orientation" the reverse (`ik.lexicographic`), in stages of `steps`. Of the starts, those
            whose first error is the least to 1e-7 (float32: 1e-4) reaches or rad count as equal, and the
            second decides.
        steps: At most so many.
        loss: `loss(arm, goal, q)` of one goal (4, 4) and joints (n,), to minimize instead.
        optimizer: An optax optimizer for `loss`; `optax.adam(0.02)` by default. Joints are put back into the
            limits after each step, and the best of all steps is returned.

    Returns:
        `Projection`; its `cost` is the weighted one whatever the priority, and with `loss` that. Of several
        starts the best, and of those that are level, as branches in one pose are, the first. Inside jit it
        takes all `steps` for every start. `q`, `cost` and the errors have slopes in the goals and the arm's
        leaves, by the condition that holds at the bottom, joints at a limit standing still; those of `q` are
        zero where it is not `converged`. With a priority they are those of a last sum of both errors, to
        some 1e-3. With `loss` the slopes are those of its steps.

    Raises:
        ValueError: Wrong shapes or types.
    """
    goals, arm = checked(arm, goals, characteristic_length, steps)
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
        starts = jnp.broadcast_to(starts, (*batch, starts.shape[-2], arm.n))
    except ValueError as error:
        raise ValueError(f"q0 must have shape {wanted} or (..., S, {arm.n}), got {jnp.shape(q0)}") from error
    if loss is None and optimizer is not None:
        raise ValueError("optimizer is of a loss: give loss= too")
    if loss is not None:
        if priority != "weighted":
            raise ValueError(f"priority is of the errors, and not of a loss: got {priority!r} with loss=")
        return best_of(arm, goals, minimized(arm, goals, starts, loss, optimizer, steps))
    priority = priorities.checked(arm, priority)
    return best_of(
        arm, goals, descended(arm, goals, starts, characteristic_length, steps, priority), priority
    )


def minimized(arm: Arm, goals: jax.Array, starts: jax.Array, loss, optimizer, steps: int) -> Projection:
    """The best of all steps from each start (..., S, n), fields (..., S); arguments as in `refine`.

    The loss is handed the pose nearest to each goal, or the goal as it is where there is none.
    """
    optimizer = optax.adam(0.02) if optimizer is None else optimizer
    columns = newton.into_limits(arm, tuple(starts[..., i] for i in range(arm.n)))
    starts, size = jnp.stack(columns, axis=-1), jnp.asarray(reach(arm), goals.dtype)
    low, high = arm.limits[:, 0], arm.limits[:, 1]

    def one(goal, q0):
        slope = jax.value_and_grad(lambda q: loss(arm, goal, q))

        def look(q, best):
            value, grad = slope(q)
            # A loss that is no number is no best, and its slope leads nowhere.
            grad = jnp.where(jnp.isfinite(grad), grad, 0)
            free = jnp.where(((q <= low) & (grad > 0)) | ((q >= high) & (grad < 0)), 0, grad)
            now = q, value, jnp.sqrt(jnp.sum(free * free))
            return grad, jax.tree.map(lambda new, old: jnp.where(value < best[1], new, old), now, best)

        def step(carry, _):
            q, inner, best = carry
            grad, best = look(q, best)
            # Optax mixes types as the caller's settings may forbid.
            with jax.numpy_dtype_promotion("standard"):
                moves, inner = optimizer.update(grad, inner, q)
            return (jnp.clip(optax.apply_updates(q, moves), low, high), inner, best), None

        none = q0, jnp.full((), jnp.inf, q0.dtype), jnp.zeros((), q0.dtype)
        (q, _, best), _ = jax.lax.scan(step, (q0, optimizer.init(q0), none), length=steps)
        return look(q, best)[1]

    pose, off = nearest_pose(entries_of(goals), jax.lax.stop_gradient(size))
    proper = off <= NEARLY_ROTATION
    goals = jnp.where(proper[..., None, None], to_matrix(pose), goals)
    flat = starts.reshape(-1, *starts.shape[-2:])
    found = jax.vmap(jax.vmap(one, (None, 0)))(goals.reshape(-1, 4, 4), flat)
    q, value, steep = (x.reshape(*starts.shape[:-1], *x.shape[2:]) for x in found)
    proper = proper[..., None]
    errors = pose_error(fk(arm, q), goals[..., None, :, :])
    gap, angle = (jnp.where(proper, x, jnp.nan) for x in errors)
    down = proper & jnp.isfinite(value) & (steep <= CONVERGED[q.dtype.name])
    return Projection(q, value, gap, angle, steep, down)
