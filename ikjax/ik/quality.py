"""How well an arm can move at given joints: per branch with `sol.q`, differentiable in joints and arm.

All measures but `limit_clearance` are functions of the singular values of the Jacobian, in the rows that the
arm's task asks for. Lengths, of the tool's motion and of a slide's alike, are divided by the arm's reach to
make them comparable with radians. So the values have no unit, and do not change when an arm is scaled. A
`characteristic_length` takes the place of the reach.

Values and gradients are finite everywhere. At singularities, where the least singular value has a corner, its
gradient is that of one side or zero.

Source: Yoshikawa, Manipulability of robotic mechanisms (1985); Salisbury and Craig (1982) for the condition.
"""

import functools
import math

import jax
import jax.numpy as jnp
from jax.typing import ArrayLike

from ikjax.arm import twists
from ikjax.arm.arm import Arm, numbers
from ikjax.arm.forward import chain, check_joints, fixed_pose, reach, whole_turns
from ikjax.core import pose as poses
from ikjax.core import safe
from ikjax.core.singular import singular_values, volume
from ikjax.core.trig import wrap
from ikjax.core.xla import opaque_one, pinning
from ikjax.ik.inline import jit_with_arm


def manipulability(arm: Arm, q: ArrayLike, *, characteristic_length: ArrayLike | None = None) -> jax.Array:
    """Yoshikawa's measure: the product of the singular values, |det J| where J is square.

    For an arm with fewer joints than its task has rows (five joints, a pose) it is the volume of the motions
    that its joints can make, sqrt(det J^T J).

    Args:
        arm: Its leaves may be traced.
        q: Joint values [rad, m], (..., n); `sol.q` gives a value for each branch.
        characteristic_length: Length that counts as much as one radian, and as one unit of a slide [m], ();
            the arm's reach by default.

    Returns:
        (...) [1], zero at a singularity. Gradients are finite everywhere.

    Raises:
        ValueError: The last axis of q is not as long as the arm has joints.
    """
    return _volume(arm, check_joints(arm, q), characteristic_length)


def sigma_min(arm: Arm, q: ArrayLike, *, characteristic_length: ArrayLike | None = None) -> jax.Array:
    """The least singular value of the Jacobian: the least tool speed for a joint velocity of unit length.

    Arguments and errors as in `manipulability`.

    Returns:
        (...) [1]. Where the least value is repeated, the gradient is the mean of theirs.
    """
    return functools.reduce(jnp.minimum, _values(arm, check_joints(arm, q), characteristic_length))


def inverse_condition(arm: Arm, q: ArrayLike, *, characteristic_length: ArrayLike | None = None) -> jax.Array:
    """The least singular value over the greatest: 0 at a singularity, 1 where all are equal (isotropic).

    Arguments and errors as in `manipulability`.

    Returns:
        (...) [1].
    """
    values = _values(arm, check_joints(arm, q), characteristic_length)
    return safe.divide(functools.reduce(jnp.minimum, values), functools.reduce(jnp.maximum, values))


def limit_clearance(arm: Arm, q: ArrayLike) -> jax.Array:
    """How far the nearest joint limit is [rad]: positive within the limits, negative beyond one.

    A turning joint counts with the best of its whole turns, whichever of them is in `q`: the value is
    positive exactly where `within_limits` finds turns that bring the joint inside. For a slide, one reach
    counts as one radian. The value is pi at most, which is also that of an arm without limits.

    Args:
        arm: With limits (n, 2) [rad, m], in terms of q.
        q: (..., n); `sol.q` gives a value for each branch.

    Returns:
        (...) [rad]. Half-way between two limits it has a corner.

    Raises:
        ValueError: The last axis of q is not as long as the arm has joints.
    """
    return _limit_clearance(arm, check_joints(arm, q))


@jit_with_arm
def _limit_clearance(arm: Arm, q: jax.Array) -> jax.Array:
    return functools.reduce(jnp.minimum, joint_clearances(arm, tuple(q[..., i] for i in range(arm.n))))


def joint_clearances(arm: Arm, q: tuple[jax.Array, ...]) -> list[jax.Array]:
    """`limit_clearance` of each joint alone, from joint values in scalars."""
    return [_clearance(arm, i, value) for i, value in enumerate(q)]


def _clearance(arm: Arm, i: int, value: jax.Array) -> jax.Array:
    """`limit_clearance` of joint i alone."""
    lower, upper = (jnp.asarray(limit, value.dtype) for limit in numbers(arm.limits[i]))
    # Infinite limits are replaced by zeros: in a branch that is not used they would make gradients NaN.
    low, high = (jnp.where(jnp.isfinite(limit), limit, 0) for limit in (lower, upper))
    size = reach(arm) if arm.kinds[i] == "P" else 1
    above = jnp.where(jnp.isfinite(lower), (value - low) / size, math.pi)
    below = jnp.where(jnp.isfinite(upper), (high - value) / size, math.pi)
    straight = jnp.minimum(jnp.minimum(above, below), math.pi)
    inside = (high - low) / 2 - jnp.abs(wrap(value - (high + low) / 2))
    # A single limit can always be met by whole turns.
    bounded = jnp.isfinite(lower) & jnp.isfinite(upper)
    return jnp.where(whole_turns(arm)[i], jnp.where(bounded, jnp.minimum(inside, math.pi), math.pi), straight)


@jit_with_arm
def _volume(arm: Arm, q: jax.Array, characteristic_length) -> jax.Array:
    return volume(_columns(arm, q, characteristic_length))


@jit_with_arm
def _values(arm: Arm, q: jax.Array, characteristic_length) -> tuple[jax.Array, ...]:
    """Singular values of the Jacobian, each (...)."""
    return singular_values(_columns(arm, q, characteristic_length))


def _columns(arm: Arm, q: jax.Array, characteristic_length) -> list[tuple[jax.Array, ...]]:
    """Columns of the Jacobian, or its rows where those are fewer; each entry (...)."""
    one = opaque_one(q[..., 0])

    with pinning(lambda x: x / one if isinstance(x, jax.Array) else x):
        kinematics = chain(arm, tuple(q[..., i] for i in range(arm.n)))
    tip = poses.compose(kinematics.last, fixed_pose(arm.tool)).position
    characteristic_length = reach(arm) if characteristic_length is None else characteristic_length
    rows = twists.task_rows(arm, kinematics, safe.divide(1, characteristic_length))
    units = [characteristic_length if kind == "P" else 1.0 for kind in arm.kinds]
    motions = zip(units, twists.motor_twists(arm, kinematics, tip), strict=True)
    columns = [tuple(x * one for x in rows(motion.times(unit))) for unit, motion in motions]
    few = len(columns) <= len(columns[0])
    return columns if few else list(zip(*columns, strict=True))
