"""What a family is handed besides a goal, and one closed-form answer as it hands it on.

Storey: solvers.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax

from ikjax.arm.forward import Joint, Link, unwind
from ikjax.core.pose import Pose
from ikjax.core.trig import Angle, Scalar, angle


class Setting(NamedTuple):
    """What a family's kernel needs besides the arm and the goal."""

    now: tuple[Angle, ...]
    """DH angles that fill what is arbitrary."""
    tiny: float
    """Lengths (in units of the reach) and sines below this are zero."""
    slip: float
    """What is `tiny` may become this, where a step leaves a freedom to the next."""
    noise: float
    """What rounding may have taken from a length."""
    hold: Callable[[Scalar], Scalar]
    """Called on what many outputs share; see `ik.graph`."""

    def angle(self, sine: Scalar, cosine: Scalar) -> Angle:
        """The angle of a sine and a cosine, held."""
        return angle(self.hold(sine), self.hold(cosine))

    def unwind(self, goal: Pose, links: tuple[Link, ...], joints: tuple[Angle, ...]) -> Pose:
        """The goal seen from the frame after the first links, held."""
        for link, joint in zip(links, joints, strict=False):
            goal = unwind(goal, link, Joint(joint.sin, joint.cos, link.d))
        return jax.tree.map(self.hold, goal)


class Branch(NamedTuple):
    """Joint values of one slot, before they are measured."""

    joints: tuple[Angle, ...]
    """The DH angle of each joint."""
    seen: Pose
    """The goal seen from the frame after the first joints, as many as `Family.first` says."""
    margin: Scalar
    """Clearance from the fold, in units of the reach."""
    continuum: jax.Array
    """The slot stands for a one-parameter family of answers."""


def bits(slot: int, count: int = 3) -> tuple[int, ...]:
    """The bits of a slot as signs, lowest first: +1 where the bit is clear, -1 where it is set."""
    return tuple(-1 if slot >> k & 1 else 1 for k in range(count))
