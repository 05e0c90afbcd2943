"""Arms of seven joints with a spherical shoulder and a spherical wrist, at a given arm angle.

Branches: 8.

Frames: standard DH, alpha1 to alpha6 right angles, a1 = a2 = d2 = d4 = a5 = a6 = d6 = 0. S, where axes 1, 2
and 3 meet, is at (0, 0, d1) in frame 0; W, where axes 5, 6 and 7 meet, is the origin of the last frame. w is
the direction from S to W, n that of axis 4, which is square to w.

The arm angle turns axis 4 about w from a reference direction n0(w), which is `reference_normal`.

Steps:
1. Elbow: joint 4 from the triangle of S, elbow and W in the plane square to axis 4.
2. n from w and the arm angle; with where W is seen in that plane it gives the rotation of frame 3.
3. Joints 1, 2, 3 are the angles of a spherical wrist that make it.
4. Joints 5, 6, 7 are those of the wrist, which make what is left of the goal's rotation.

Bits: the sign of sin(t2); the elbow bends about axis 4 by a positive or a negative angle; that of sin(t6).
At full stretch slots of either elbow are one. The elbow of one at an angle is where that of the other is half
a turn on.

Source: Shimizu et al. (2008), cited in `arm.recognition.arm_angle`: the reference is the posture with joint 3
at zero; Elias and Wen, Redundancy parameterization and inverse kinematics of 7-DOF revolute manipulators
(2024), for the reference that is singular in one direction alone. Axis 4 in place of the elbow's point, which
keeps the angle where the arm is straight, and offsets at the elbow are ours.
"""

import jax.numpy as jnp

from ikjax.arm.forward import Link
from ikjax.arm.recognition.signs import ArmAngleSigns
from ikjax.core import safe, vector
from ikjax.core.pose import Pose
from ikjax.core.trig import Angle, Scalar, sincos
from ikjax.core.vector import Matrix, Vector, plus, times
from ikjax.core.xla import pin, pin_all
from ikjax.solvers.context import Branch, Setting
from ikjax.solvers.steps.triangle import triangle
from ikjax.solvers.steps.wrist import square_wrist


def branches(
    signs: ArmAngleSigns, links: tuple[Link, ...], goal: Pose, setting: Setting
) -> tuple[Branch, ...]:
    """All slots for one goal.

    Arguments as in `ortho_parallel_wrist`; the arm angle [rad] is in `setting.given`.
    """
    one, _, three, four, five = links[:5]
    sin1, sin2, sin3, sin4, sin5, sin6 = signs.sin_alpha
    x, y, z = goal.position
    span, towards = direction((x, y, plus(z, -one.d)))
    normal, _ = reference_normal(towards, vector.IDENTITY, signs.stereographic, setting.zero_tolerance)
    sine, cosine = sincos(setting.given[0])
    aside = vector.cross(towards, normal)
    # Axis 4, and the direction square to it and to w, on the left of w as seen along axis 4.
    axis = pin_all(vector.add(vector.scale(cosine, normal), vector.scale(sine, aside)))
    left = pin_all(vector.cross(axis, towards))
    upper, forearm = (three.a, times(sin3, three.d)), (four.a, times(-sin4, five.d))
    lengths = safe.norm(*upper), safe.norm(*forearm)
    (upper_x, upper_y), (fore_x, fore_y) = (
        tuple(safe.divide(part, length) for part in link)
        for link, length in ((upper, lengths[0]), (forearm, lengths[1]))
    )
    # The bend of the elbow is joint 4 less this angle.
    straight_sine, straight_cosine = (
        plus(times(upper_y, fore_x), -times(upper_x, fore_y)),
        plus(times(upper_x, fore_x), times(upper_y, fore_y)),
    )
    columns = vector.transpose(goal.rotation)
    slots: dict[int, Branch] = {}
    for elbow, side in enumerate((-1, 1)):
        bend = triangle(span, jnp.zeros_like(span), *lengths, side, setting, setting.correction_size, _AHEAD)
        joint4 = setting.angle(*_sum_of(bend.elbow_sin, bend.elbow_cos, straight_sine, straight_cosine))
        # Where w is seen in the plane of frame 3: the upper arm's direction there less the shoulder's angle.
        seen_sine, seen_cosine = _sum_of(upper_y, upper_x, -bend.shoulder_sin, bend.shoulder_cos)
        x3 = pin_all(vector.subtract(vector.scale(seen_cosine, towards), vector.scale(seen_sine, left)))
        y3 = pin_all(vector.add(vector.scale(seen_sine, towards), vector.scale(seen_cosine, left)))
        x4 = pin_all(vector.add(vector.scale(joint4.cos, x3), vector.scale(joint4.sin, y3)))
        y_turned = vector.subtract(vector.scale(joint4.cos, y3), vector.scale(joint4.sin, x3))
        frame4 = (x4, vector.scale(sin4, axis), pin_all(vector.scale(-sin4, y_turned)))
        shoulders = square_wrist(vector.scale(sin3, y3), x3, (sin1, sin2), 1.0, _with_fallback(setting, 0))
        across, along = (pin_all(vector.rotate(frame4, columns[k])) for k in (0, 2))
        hands = square_wrist(along, across, (sin5, sin6), 1.0, _with_fallback(setting, 4))
        for (first, shoulder), (last, hand) in (
            (pair, other) for pair in enumerate(shoulders) for other in enumerate(hands)
        ):
            joints = (*shoulder.joints, joint4, *hand.joints)
            continuum = bend.continuum | shoulder.continuum | hand.continuum
            slots[first + 2 * elbow + 4 * last] = Branch(joints, goal, bend.margin, continuum)
    return tuple(slots[k] for k in range(8))


_AHEAD = Angle(0.0, 1.0, 0.0)
"""Of the shoulder where equal links are folded: any will do."""


def _sum_of(sine: Scalar, cosine: Scalar, sine2: Scalar, cosine2: Scalar) -> tuple[Scalar, Scalar]:
    """Sine and cosine of the sum of two angles."""
    return (
        plus(times(sine, cosine2), times(cosine, sine2)),
        plus(times(cosine, cosine2), -times(sine, sine2)),
    )


def _with_fallback(setting: Setting, joint: int) -> Setting:
    """The setting of a wrist whose first joint is `joint`, counted from 0."""
    return setting._replace(fallback=(*setting.fallback[:3], setting.fallback[joint]))


def direction(p: Vector) -> tuple[Scalar, Vector]:
    """The length of a vector and its direction, which is (0, 0, 1) where it is zero."""
    span = vector.norm(p)
    per = safe.divide(1, span)
    x, y, z = vector.scale(per, p)
    return span, pin_all((x, y, jnp.where(span == 0, 1, z)))


def reference_normal(
    towards: Vector, frame0: Matrix, stereographic: bool, tolerance: float
) -> tuple[Vector, Scalar]:
    """The direction of axis 4 at an arm angle of zero, and how well it is defined.

    With r axis 1 it is r x w, which is not defined where W is on axis 1. In the stereographic one r is the x
    axis of frame 0, seen from the point below the shoulder: it is not defined for W straight below alone.
    There a second axis takes the place of r.

    Args:
        towards: w, of length one.
        frame0: Columns of the rotation of frame 0.
        stereographic: Which one.
        tolerance: Sines below this count as zero.

    Returns:
        The direction, of length one and square to w, and the size that it was divided by: the sine of the
        angle of w with r, or up to 2.
    """
    x0, y0, z0 = frame0
    first, second = (x0, y0) if stereographic else (z0, x0)
    from_point = vector.add(towards, z0) if stereographic else towards

    def made(r: Vector) -> Vector:
        k = vector.cross(from_point, r)
        return vector.subtract(vector.scale(vector.dot(k, towards), towards), k)

    usual, other = made(first), vector.cross(second, towards)
    size = vector.norm(usual)
    lost = size <= tolerance
    chosen = tuple(jnp.where(lost, u, v) for u, v in zip(other, usual, strict=True))
    size = jnp.where(lost, vector.norm(other), size)
    unit = vector.scale(safe.divide(1, size), chosen)
    # Square to w once more: a short vector brings its rounding along.
    unit = vector.subtract(unit, vector.scale(vector.dot(unit, towards), towards))
    return pin_all(vector.scale(safe.divide(1, vector.norm(unit)), unit)), pin(size)
