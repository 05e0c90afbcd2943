"""Joint limits tested on sines and cosines: no angle is ever computed.

Storey: study.
"""

import math

import jax
import jax.numpy as jnp

from ikjax.arm.arm import Arm
from ikjax.arm.forward import links
from ikjax.solvers.family import Slot


def within(arm: Arm, slot: Slot) -> jax.Array:
    """Whether whole turns can bring every joint of a slot between its limits.

    An angle lies between two others when it is left of the one and right of the other, by the sign
    of cross products; an arc of more than half a turn is the complement of one of less.

    Args:
        arm: A baked arm of turning joints.
        slot: One of its slots.
    """
    slack = 8 * float(jnp.finfo(arm.dtype).eps)
    inside = jnp.asarray(True)
    for link, joint, (lower, upper) in zip(links(arm), slot.joints, arm.limits.tolist(), strict=True):
        width = upper - lower
        if width >= 2 * math.pi:
            continue
        first, last = link.theta + lower, link.theta + upper
        past_first = joint.sin * math.cos(first) - joint.cos * math.sin(first)
        before_last = joint.cos * math.sin(last) - joint.sin * math.cos(last)
        if width <= math.pi:
            between = (past_first >= -slack) & (before_last >= -slack)
            # A short arc has an opposite one, where both signs are right for a limit met exactly.
            middle = (first + last) / 2
            between &= joint.cos * math.cos(middle) + joint.sin * math.sin(middle) > 0
        else:
            between = (past_first >= -slack) | (before_last >= -slack)
        inside = inside & between
    return inside
