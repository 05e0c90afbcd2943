"""The arm angle of a posture: how far axis 4 is turned about the line from shoulder to wrist.

`solvers.families.arm_angle` states the angle and solves for it; here it is measured, with its derivatives by
the joints, and an arm is made ready to be solved at one.
"""

import dataclasses
from typing import NamedTuple, cast

import jax
import jax.numpy as jnp
from jax.typing import ArrayLike

from ikjax.arm.arm import Arm, once_for_each_arm
from ikjax.arm.forward import Chain, chain, check_joints
from ikjax.arm.recognition import arm_angle as recognition
from ikjax.arm.recognition.signs import ArmAngleSigns
from ikjax.core import safe, vector
from ikjax.core.tolerances import FACT, TINY
from ikjax.core.trig import Scalar, atan2
from ikjax.core.xla import is_traced
from ikjax.ik.inline import jit_with_arm
from ikjax.solvers.families.arm_angle import direction, reference_normal

FAMILY = "arm_angle"
"""Of an arm that is solved at an arm angle: see `solvers.families.KERNELS`."""

REFERENCES = ("axis1", "stereographic")


def arm_angle(arm: Arm, q: ArrayLike, *, reference: str = "axis1") -> jax.Array:
    """The arm angle of postures, which `solve(arm, goals, arm_angle=...)` takes.

    It is the angle of axis 4 about the line from the shoulder S to the wrist W, from a reference direction:
    that of axis 1 times (as a cross product) the direction from S to W. So it is zero or half a turn where
    joint 3 is at zero and its theta is zero. Where W is on axis 1 the x axis of the base takes the place of
    axis 1; beside it a small motion turns the angle by much.

    Args:
        arm: Seven turning joints, the first three meeting in S and the last three in W, right angles between.
        q: (..., 7) [rad].
        reference: "axis1"; or "stereographic", which is not defined for W straight below S alone: its
            directions are those of the x axis of the base, carried over the sphere about S by the circles
            through its lowest point.

    Returns:
        (...) [rad], from -pi to pi. Its derivatives are finite everywhere.

    Raises:
        ValueError: Another arm, another reference, or q of another length.

    Source: Shimizu et al. (2008); Elias and Wen (2024) for the stereographic reference.
    """
    ready = at_arm_angle(arm, reference)
    return _arm_angle(ready, check_joints(ready, q))


@jit_with_arm
def _arm_angle(arm: Arm, q: jax.Array) -> jax.Array:
    return measured(arm, chain(arm, tuple(q[..., i] for i in range(arm.n)))).angle


@once_for_each_arm
def at_arm_angle(arm: Arm, reference: str) -> Arm:
    """The arm as it is solved at an arm angle: no joint is locked.

    Raises:
        ValueError: An arm that has no arm angle, with the facts that fail, or an unknown reference.
    """
    if reference not in REFERENCES:
        raise ValueError(f"reference must be one of {', '.join(REFERENCES)}, got {reference!r}")
    if arm.arm_angle_signs is None:
        wanted = (
            f"{arm.name} has no arm angle: it is for arms with a spherical shoulder and a spherical wrist"
        )
        columns = {key: getattr(arm, key) for key in ("a", "d", "alpha")}
        if arm.coupling is not None or is_traced(columns):
            raise ValueError(f"{wanted}, without coupling, built outside jit")
        wrong = [check for check in recognition.checks(arm.kinds, columns, FACT) if not check.holds]
        facts = "; ".join(f"{check.fact}: {check.deviation:.3g} {check.wanted}".rstrip() for check in wrong)
        raise ValueError(f"{wanted}; not {facts}")
    signs = arm.arm_angle_signs._replace(stereographic=reference != "axis1")
    return dataclasses.replace(arm, family=FAMILY, signs=signs, branches=recognition.BRANCHES, locked=())


class Measured(NamedTuple):
    """The arm angle of a posture, in scalars."""

    angle: Scalar
    """[rad]"""
    scale: Scalar
    """What the reference direction was divided by, zero where it is not defined: at most 2."""
    row: tuple[Scalar, ...]
    """The angle's derivative by each joint, times `scale`."""


def measured(arm: Arm, kinematics: Chain) -> Measured:
    """The arm angle of a posture, and its derivatives, which grow where the reference is not defined.

    While the frame of axis 4 turns with a spin s, the angle about w turns with w . s; while w moves, so does
    the reference direction n0, whose own turn about w is subtracted.
    """
    frames, signs = kinematics.before, cast(ArmAngleSigns, arm.signs)
    shoulder, wrist = frames[1].position, frames[5].position
    span, towards = direction(vector.subtract(wrist, shoulder))
    frame0 = vector.transpose(frames[0].rotation)
    tolerance = TINY * float(jnp.finfo(arm.dtype).eps)
    normal, scale = reference_normal(towards, frame0, signs.stereographic, tolerance)
    axis = vector.transpose(frames[3].rotation)[2]
    aside = vector.cross(towards, normal)
    angle = atan2(vector.dot(aside, axis), vector.dot(normal, axis))
    # The turn of n0 about w is aside . d(n0) = turning . d(W) / scale, with n0 = m / |m| as it is made there.
    x0, _, z0 = frame0
    r, from_point = (x0, vector.add(towards, z0)) if signs.stereographic else (z0, towards)
    along = vector.dot(vector.cross(from_point, r), towards)
    turning = vector.subtract(vector.scale(along, aside), vector.cross(r, aside))
    across = vector.subtract(turning, vector.scale(vector.dot(turning, towards), towards))
    turning = vector.scale(safe.divide(1, span), across)
    row: list[Scalar] = []
    for i, frame in enumerate(frames[:4]):
        z = vector.transpose(frame.rotation)[2]
        moved = vector.dot(turning, vector.cross(z, vector.subtract(wrist, frame.position)))
        spin = scale * vector.dot(towards, z) if i < 3 else 0.0
        row.append(spin - moved)
    return Measured(angle, scale, (*row, 0.0, 0.0, 0.0))
