"""How well an arm moves where it stands: per branch with `sol.q`, differentiable in joints and arm.

All but `limit_clearance` are read off the singular values of the Jacobian in the rows that the arm's task
asks for. Metres and radians are made comparable as everywhere in this library: a characteristic_length counts
as its share of the reach, of the tool's motion and of a slide's alike. So the values have no unit and do not
change when an arm is scaled; `characteristic_length` puts another number of metres in the place of the reach.

Values are finite everywhere, and so are slopes: at singularities, where the least singular value has a
corner, its slope is that of one side or zero.

Source: Yoshikawa, Manipulability of robotic mechanisms (1985); Salisbury and Craig (1982) for the condition.
"""

import functools
import math

import jax
import jax.numpy as jnp

from ikjax.arm import twists
from ikjax.arm.arm import Arm, numbers
from ikjax.arm.forward import chain, check_joints, fixed_pose, reach, whole_turns
from ikjax.core import pose as poses
from ikjax.core import safe
from ikjax.core.singular import singular_values, volume
from ikjax.core.trig import wrap
from ikjax.core.xla import opaque_one, pinning
from ikjax.ik.inline import jit_with_arm


def manipulability(arm: Arm, q, *, characteristic_length=None) -> jax.Array:
    """Yoshikawa's measure: the product of the singular values, |det J| where J is square.

    An arm of fewer joints than its task has rows (five joints, a pose) is measured by the volume of what
    its joints can do, sqrt(det J^T J).

    Args:
        arm: Its leaves may be traced.
        q: Joint values [rad, m], (..., n); `sol.q` gives a value for each branch.
        characteristic_length: Metres that count as one radian, and as one for a slide; the arm's reach by
            default.

    Returns:
        (...), zero at a singularity.

    Raises:
        ValueError: q of another length than the arm has joints.
    """
    return _volume(arm, check_joints(arm, q), characteristic_length)


def sigma_min(arm: Arm, q, *, characteristic_length=None) -> jax.Array:
    """The least singular value of the Jacobian: the slowest that the tool moves for joints at unit speed.

    Arguments as in `manipulability`. Where the least value is repeated, the slope is the mean of its own.
    """
    return functools.reduce(jnp.minimum, _values(arm, check_joints(arm, q), characteristic_length))


def inverse_condition(arm: Arm, q, *, characteristic_length=None) -> jax.Array:
    """The least singular value over the greatest: 0 at a singularity, 1 where the arm moves all ways alike.

    Arguments as in `manipulability`.
    """
    values = _values(arm, check_joints(arm, q), characteristic_length)
    return safe.divide(functools.reduce(jnp.minimum, values), functools.reduce(jnp.maximum, values))


def limit_clearance(arm: Arm, q) -> jax.Array:
    """How far the nearest joint limit is [rad]: positive within the limits, negative beyond one.

    A turning joint counts with the best of all its whole turns, wherever in `q` it stands: the value is
    positive just where `within_limits` finds turns that bring it inside. A slide counts one radian a reach.
    It is pi at most, which is also what an arm without limits has.

    Args:
        arm: With limits (n, 2) [rad, m], in terms of q.
        q: (..., n); `sol.q` gives a value for each branch.

    Returns:
        (...). Half-way between two limits it has a corner.
    """
    return _limit_clearance(arm, check_joints(arm, q))


@jit_with_arm
def _limit_clearance(arm: Arm, q: jax.Array) -> jax.Array:
    return functools.reduce(jnp.minimum, [_clearance(arm, i, q[..., i]) for i in range(arm.n)])


def _clearance(arm: Arm, i: int, value: jax.Array) -> jax.Array:
    lower, upper = (jnp.asarray(limit, value.dtype) for limit in numbers(arm.limits[i]))
    # Zeros in the place of infinities keep them out of the slopes.
    low, high = (jnp.where(jnp.isfinite(limit), limit, 0) for limit in (lower, upper))
    size = reach(arm) if arm.kinds[i] == "P" else 1
    above = jnp.where(jnp.isfinite(lower), (value - low) / size, math.pi)
    below = jnp.where(jnp.isfinite(upper), (high - value) / size, math.pi)
    straight = jnp.minimum(jnp.minimum(above, below), math.pi)
    inside = (high - low) / 2 - jnp.abs(wrap(value - (high + low) / 2))
    # Whole turns can always meet one limit.
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
    """Of the Jacobian, or its rows where those are fewer; each entry (...)."""
    one = opaque_one(q[..., 0])

    with pinning(lambda x: x / one if isinstance(x, jax.Array) else x):
        found = chain(arm, tuple(q[..., i] for i in range(arm.n)))
    tip = poses.compose(found.last, fixed_pose(arm.tool)).position
    characteristic_length = reach(arm) if characteristic_length is None else characteristic_length
    rows = twists.task_rows(arm, found, safe.divide(1, characteristic_length))
    units = [characteristic_length if kind == "P" else 1.0 for kind in arm.kinds]
    motions = zip(units, twists.motor_twists(arm, found, tip), strict=True)
    columns = [tuple(x * one for x in rows(motion.times(unit))) for unit, motion in motions]
    few = len(columns) <= len(columns[0])
    return columns if few else list(zip(*columns, strict=True))
