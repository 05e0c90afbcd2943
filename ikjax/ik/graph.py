"""`solve` as a plain elementwise graph, for use inside a jit.

Storey: ik. What the caller does not use is never computed.
"""

import jax
import jax.numpy as jnp

from ikjax.arm.arm import Arm
from ikjax.core import pose as poses
from ikjax.ik.solutions import Solutions
from ikjax.solvers.family import Slot, clean, reach, solve_scalars


def slots_of(arm: Arm, goals: jax.Array, q_now, tolerance) -> tuple[Slot, ...]:
    """Measured slots of (..., 4, 4) goals, each field one array (...).

    What several outputs share is divided by a one that XLA cannot see through. A division is dear
    enough that XLA keeps its result, where it would compute a sum or a product again for every
    array that leaves the jit: that is several times slower, and near a singularity, where an angle
    is made of rounding errors, two roundings of one angle do not belong together.
    """
    goal, proper = clean(poses.from_matrix(goals), reach(arm))
    bottom = [goals[..., 3, j] == float(j == 3) for j in range(4)]
    proper &= bottom[0] & bottom[1] & bottom[2] & bottom[3]
    now = None if q_now is None else tuple(q_now[..., i] for i in range(arm.n))
    one = jnp.where(goal.position[0] == goal.position[0], 1, 2).astype(goals.dtype)
    slots = solve_scalars(arm, goal, now, tolerance, hold=lambda x: x / one)
    return tuple(slot._replace(valid=slot.valid & proper) for slot in slots)


FIELDS = ("valid", "margin", "continuum", "position_error", "rotation_error")


def solve_here(arm: Arm, goals: jax.Array, q_now, tolerance) -> Solutions:
    """`Solutions` as a plain elementwise graph."""
    shape = goals.shape[:-2]

    def gather(values):
        return jnp.stack([jnp.broadcast_to(v, shape) for v in values], axis=-1)

    slots = slots_of(arm, goals, q_now, tolerance)
    q = jnp.stack([gather(slot.q) for slot in slots], axis=-2)
    return Solutions(q=q, **{f: gather([getattr(slot, f) for slot in slots]) for f in FIELDS})
