"""What a family's kernel gets besides the arm and the goal, and what it returns: one closed-form answer."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from ikjax.arm.forward import Joint, Link, known_sincos, unwind
from ikjax.arm.recognition.signs import PairSplit, RegionalSplit
from ikjax.core import safe
from ikjax.core.pose import Pose
from ikjax.core.tolerances import TINY
from ikjax.core.trig import Angle, Scalar, add_small_angle, angle
from ikjax.core.vector import Vector, plus
from ikjax.core.xla import pin, pin_all


class Slide(NamedTuple):
    """The value of a sliding joint."""

    value: Scalar
    """In units of the reach."""


Joints = tuple[Any, ...]
"""An `Angle` for each turning joint, a `Slide` for each sliding one."""


def placed(link: Link, joint: Angle | Slide) -> Joint:
    """The joint of a link at a given value, for forward kinematics."""
    if isinstance(joint, Slide):
        return Joint(*known_sincos(link.theta), plus(link.d, joint.value))
    return Joint(joint.sin, joint.cos, link.d)


def moved_on(joint: Angle | Slide, step: Scalar) -> Angle | Slide:
    """The joint after a small step [rad, or reaches]; of an angle only the sine and cosine."""
    if isinstance(joint, Slide):
        return Slide(joint.value + step)
    return Angle(*add_small_angle(joint.sin, joint.cos, step), ())


class Setting(NamedTuple):
    """What a family's kernel needs besides the arm and the goal."""

    fallback: Joints
    """The value of each joint where the goal leaves it arbitrary: the caller's `q_now`, zero by default."""
    tool_point: Vector
    """The tool point, seen from the frame that ends in the last joint."""
    zero_tolerance: float
    """Lengths (in units of the reach) and sines below this count as zero: `TINY` roundings."""
    length_uncertainty: Scalar
    """How far a computed length may be off, in units of the reach: an eighth of `zero_tolerance` for
    rounding, and `correction_size`. Steps add it beside a fold, where a length that is too short loses an
    answer."""
    correction_size: Scalar
    """A measure of `Arm.correction`, in units of the reach and rad; zero for an arm solved as recognized."""
    given: tuple[Scalar, ...] = ()
    """What is given beside the goal and is no joint: the arm angle [rad]."""

    @property
    def rounding(self) -> float:
        """The machine epsilon of the goals' type."""
        return self.zero_tolerance / TINY

    def close_pairs(self, split: RegionalSplit | PairSplit) -> bool:
        """Whether an equation that nearly splits has roots in pairs that rounding does not tell apart."""
        in_float32 = self.rounding > 1e-10
        return split == PairSplit.NEARLY or (in_float32 and split.is_nearly)

    def angle(self, sine: Scalar, cosine: Scalar) -> Angle:
        """The angle of a sine and a cosine, both pinned."""
        return angle(pin(sine), pin(cosine))

    def filled(self, joint: int, free: jax.Array, sine: Scalar, cosine: Scalar) -> Angle:
        """The angle of a sine and a cosine, or the joint's fallback where it is arbitrary."""
        fallback = self.fallback[joint]
        return self.angle(jnp.where(free, fallback.sin, sine), jnp.where(free, fallback.cos, cosine))

    def between(
        self, joint: int, before: tuple[Scalar, Scalar], after: tuple[Scalar, Scalar], sign: int = 1
    ) -> tuple[Angle, jax.Array]:
        """The joint that turns one vector of a plane to the direction of another, and whether it is
        arbitrary.

        Args:
            joint: Which one fills the angle where a vector is zero.
            before, after: The vectors.
            sign: -1 where the joint's axis points down from the plane.
        """
        (u, v), (x, y) = before, after
        sine, cosine = u * y - v * x, u * x + v * y
        free = (u * u + v * v <= self.zero_tolerance**2) | (x * x + y * y <= self.zero_tolerance**2)
        weight = safe.reciprocal_sqrt(sine * sine + cosine * cosine)
        free |= weight == 0
        return self.filled(joint, free, sign * sine * weight, cosine * weight), free

    def unwind(self, goal: Pose, links: tuple[Link, ...], joints: Joints) -> Pose:
        """The goal seen from the frame after the first links, pinned."""
        for link, joint in zip(links, joints, strict=False):
            goal = unwind(goal, link, placed(link, joint))
        return pin_all(goal)


class Branch(NamedTuple):
    """The answer of one slot, before it is measured."""

    joints: Joints
    """The DH angle of each turning joint, the displacement of each sliding one."""
    seen: Pose
    """The goal seen from the frame after the first joints, as many as `Family.first` says."""
    margin: Scalar
    """Signed distance from the fold, in units of the reach; negative where the answer is clamped."""
    continuum: jax.Array
    """The slot stands for a one-parameter family of answers."""
    miss: Scalar = 0.0
    """How far the goal is from the poses that fewer than six joints can attain, in units of the reach and
    rad. Zero for six joints."""
    fold: tuple = ()
    """What `Family.margins` needs to know again for the margin's derivatives; a family without has none."""


def bits(slot: int, count: int = 3) -> tuple[int, ...]:
    """The bits of a slot as signs, lowest first: +1 where the bit is clear, -1 where it is set."""
    return tuple(-1 if slot >> k & 1 else 1 for k in range(count))
