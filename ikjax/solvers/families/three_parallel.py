"""Arms with axis 1 perpendicular to 2 and axes 2, 3, 4 parallel; 5 and 6 each square to the last.

Branches: 8. Universal Robots' arms and the lectures' elbow manipulator.

Frames: standard DH. s1, s4, s5 are the signs of sin(alpha), c2 and c3 those of cos(alpha), where -1 is an
antiparallel axis, and `up` is +1 where axis 1 points up. Frame 1 has its origin on axis 2; the arm's plane is
its x, y plane.

Steps:
1. shoulder: the point where axes 5 and 6 meet is at the distance `lateral` from the plane of axis 1 and x1:
   joint 1.
2. wrist: the angle of axis 6 to axis 2 gives joint 5; the part of axis 6 in the plane gives the whole pitch
   t2 + c2 t3 + c2 c3 t4, and the rotation about axis 6 gives joint 6.
3. triangle: a2 and a3 reach axis 4 in the plane: joints 2, 3, then 4.

Where axis 6 is parallel to axis 2 the pitch is arbitrary. It is then the one of `Setting.fallback`, changed
as little as lets the triangle close.

Bits:
1. front or back, 2. up or down: as in `ortho_parallel_wrist`, for the point where axes 5 and 6 meet.
3. noflip or flip: sin(t5) has the sign of up s1 c2 c3 s4 (and of a1, where that is not zero), or the other.

Source: the order of the steps is that of the lectures' elbow manipulator (ME/SE 740, lecture 18);
the offsets, the signs and the rule for singular poses are ours.
"""

from typing import NamedTuple

import jax.numpy as jnp

from ikjax.arm.forward import Joint, Link, unwind
from ikjax.arm.recognition.signs import ThreeParallelSigns
from ikjax.core import safe, vector
from ikjax.core.pose import Pose
from ikjax.core.trig import Angle, Scalar, SinCos, angle
from ikjax.core.xla import pin, pin_all
from ikjax.solvers.context import Branch, Setting, bits
from ikjax.solvers.steps.shoulder import shoulder
from ikjax.solvers.steps.triangle import ring, triangle


def branches(
    signs: ThreeParallelSigns, links: tuple[Link, ...], goal: Pose, setting: Setting
) -> tuple[Branch, ...]:
    """All eight slots for one goal.

    Arguments as in `ortho_parallel_wrist`.
    """
    up, s1, s4, s5 = signs.up, signs.sin_alpha1, signs.sin_alpha4, signs.sin_alpha5
    c2, c23 = signs.cos_alpha2, signs.cos_alpha23
    one, two, three, four, five = links[:5]
    x, y, _ = goal.position
    lateral = s1 * (two.d + c2 * three.d + c23 * four.d)
    facing = safe.sign(one.a)
    hand = (four.a, -c23 * s4 * five.d)  # from axis 4 to where 5 and 6 meet, at pitch 0
    pitch_fallback = _whole_pitch(setting.fallback, c2, c23)
    turned = setting.angle
    slots: dict[int, Branch] = {}
    for first in (0, 1, 4, 5):
        side, _, wrist = bits(first)
        base = shoulder(x, y, lateral, side * facing, setting)
        t5_side = wrist * facing * (up * s1 * c23 * s4)
        seen = unwind(goal, one, Joint(base.turn.sin, base.turn.cos, one.d))
        links_up = Links(two.a, three.a, hand, one.a)
        pitch = _pitch(seen, links_up, s5 * t5_side, pitch_fallback, setting)
        t1 = _turned_further(base.turn, s1, pitch.further, setting)
        seen = _seen_further(seen, one.a, pitch.further, setting)
        v, _, n = vector.transpose(seen.rotation)
        t5_sin = t5_side * vector.norm((n[0], n[1], 0.0))
        t5_cos = -c23 * s4 * s5 * n[2]
        # The goal's x axis against the axes that joint 6 turns it between.
        forward = pitch.cos * v[0] + pitch.sin * v[1]
        t6_cos = t5_cos * forward + c23 * s4 * t5_sin * v[2]
        t6_sin = c23 * s4 * s5 * (pitch.sin * v[0] - pitch.cos * v[1])
        wrist_joints = turned(t5_sin, t5_cos), turned(t6_sin, t6_cos)
        for height in (1, -1):
            arm = triangle(
                seen.position[0] - (pitch.cos * hand[0] - pitch.sin * hand[1]),
                seen.position[1] - (pitch.sin * hand[0] + pitch.cos * hand[1]),
                two.a,
                three.a,
                up * s1 * side * facing * height,
                setting,
                setting.correction_size,
            )
            # c23 t4 = pitch - (t2 + elbow)
            fore_sin = arm.shoulder_sin * arm.elbow_cos + arm.shoulder_cos * arm.elbow_sin
            fore_cos = arm.shoulder_cos * arm.elbow_cos - arm.shoulder_sin * arm.elbow_sin
            t4_sin = pitch.sin * fore_cos - pitch.cos * fore_sin
            t4_cos = pitch.cos * fore_cos + pitch.sin * fore_sin
            joints = (
                t1,
                turned(arm.shoulder_sin, arm.shoulder_cos),
                turned(c2 * arm.elbow_sin, arm.elbow_cos),
                turned(c23 * t4_sin, t4_cos),
                *wrist_joints,
            )
            margin = jnp.minimum(base.margin, arm.margin)
            free = base.continuum | pitch.free | arm.continuum
            slots[first + (0 if height == 1 else 2)] = Branch(joints, seen, margin, free)
    return tuple(slots[slot] for slot in range(8))


class Links(NamedTuple):
    """The links in the arm's plane, in units of the reach."""

    upper: Scalar
    fore: Scalar
    hand: tuple[Scalar, Scalar]
    """From axis 4 to where axes 5 and 6 meet, at pitch 0."""
    first: Scalar
    """a1: from axis 1 to axis 2."""


class Pitch(NamedTuple):
    """The whole pitch t2 + c2 t3 + c2 c3 t4."""

    sin: Scalar
    cos: Scalar
    further: SinCos
    """A further turn of joint 1, about y1, that makes this pitch the goal's; the identity as a rule."""
    free: Scalar
    """Axis 6 is parallel to axis 2, so that every pitch is the goal's."""


def _pitch(seen: Pose, links: Links, side: Scalar, fallback: Angle, setting: Setting) -> Pitch:
    """The pitch of axis 6, or one that is as good to within rounding and for which the triangle closes.

    Where axis 6 is nearly parallel to axis 2, the pitch is rounding noise. Where the wrist is near its
    cylinder, or near axis 1, joint 1 is noise and the pitch with it. Where the triangle does not close,
    either of these freedoms is used: there is an answer, but rounding has moved it.

    Args:
        seen: The goal seen from frame 1.
        links: The links in the plane.
        side: +1 or -1 times the part of axis 6 in the plane points along the pitch.
        fallback: The pitch where it is arbitrary.
        setting: Tolerances.
    """
    tolerance = setting.zero_tolerance
    n = tuple(row[2] for row in seen.rotation)
    x, y, z = seen.position
    rho_squared = n[0] * n[0] + n[1] * n[1]
    free = rho_squared <= tolerance * tolerance
    weight = side * safe.reciprocal_sqrt(rho_squared)
    p_sin = jnp.where(free, fallback.sin, n[1] * weight)
    p_cos = jnp.where(free, fallback.cos, n[0] * weight)
    loose = rho_squared <= 4 * setting.zero_tolerance
    new_sin, new_cos, moved = _closing(x, y, links, p_sin, p_cos)
    new_sin, new_cos = pin(new_sin), pin(new_cos)
    # After the further turn about y1, the part of axis 6 in the plane is (level, n[1]), along the new pitch.
    size_squared = n[0] * n[0] + n[2] * n[2]
    steep, tilted = jnp.abs(new_sin) > tolerance, size_squared > tolerance
    # XLA keeps a quotient that several values need; each of them goes through a mask of its own.
    level = jnp.where(steep, n[1] * new_cos / jnp.where(steep, new_sin, 1), 0)
    beside = safe.sign(n[2]) * safe.sqrt(size_squared - level * level)
    weight = jnp.where(tilted, 1 / jnp.where(tilted, size_squared, 1), 0)
    root_sin = (n[0] * beside - n[2] * level) * weight
    root_cos = (n[0] * level + n[2] * beside) * weight
    slip = jnp.abs((x + links.first) * root_sin) + jnp.abs(z) * (1 - root_cos)
    able = (
        moved
        & steep
        & tilted
        & (level * level <= size_squared)
        & (slip <= setting.zero_tolerance)
        & (side * n[1] * new_sin >= 0)
    )
    further_sin, further_cos = pin(jnp.where(able, root_sin, 0)), pin(jnp.where(able, root_cos, 1))
    moved &= loose | able
    p_sin, p_cos = jnp.where(moved, new_sin, p_sin), jnp.where(moved, new_cos, p_cos)
    return Pitch(pin(p_sin), pin(p_cos), (further_sin, further_cos), free)


def _turned_further(t1: Angle, s1: int, further: SinCos, setting: Setting) -> Angle:
    sine, cosine = s1 * further[0], further[1]
    return setting.angle(t1.sin * cosine + t1.cos * sine, t1.cos * cosine - t1.sin * sine)


def _seen_further(seen: Pose, a1: Scalar, further: SinCos, setting: Setting) -> Pose:
    """The goal seen from frame 1 after the further turn of joint 1: it turns back about y1, around axis 1."""
    sine, cosine = further

    def back(v):
        turned = (v[0] * cosine - v[2] * sine, v[1], v[0] * sine + v[2] * cosine)
        return pin_all(turned)

    ahead, _, along = vector.transpose(seen.rotation)
    ahead, along = back(ahead), back(along)
    x, y, z = seen.position
    x, y, z = back((x + a1, y, z))
    # Computing the third column again costs less than pinning it.
    return Pose(vector.transpose((ahead, vector.cross(along, ahead), along)), (x - a1, y, z))


def _whole_pitch(fallback: tuple[Angle, ...], c2: int, c23: int) -> Angle:
    """t2 + c2 t3 + c23 t4."""
    sine, cosine = fallback[1].sin, fallback[1].cos
    for sign, joint in ((c2, fallback[2]), (c23, fallback[3])):
        sine, cosine = (
            sine * joint.cos + sign * cosine * joint.sin,
            cosine * joint.cos - sign * sine * joint.sin,
        )
    return angle(sine, cosine)


def _closing(
    x: Scalar, y: Scalar, links: Links, p_sin: Scalar, p_cos: Scalar
) -> tuple[Scalar, Scalar, Scalar]:
    """The pitch changed as little as lets the links reach axis 4, and whether it was changed.

    Axis 4 is at (x, y) less the hand turned by the pitch. Its distance from the shoulder is brought into the
    ring by the law of cosines, on the side where the hand is.
    """
    # The point to reach, turned so that the hand at pitch 0 lies along x.
    hand = links.hand
    u, v = x * hand[0] + y * hand[1], y * hand[0] - x * hand[1]
    reach_squared, hand_squared = x * x + y * y, hand[0] * hand[0] + hand[1] * hand[1]
    total = reach_squared + hand_squared
    span_squared = total - 2 * (u * p_cos + v * p_sin)
    low, high = ring(links.upper, links.fore)
    wanted = jnp.clip(span_squared, low * low, high * high)
    weight = safe.reciprocal_sqrt(reach_squared * hand_squared)
    cosine = jnp.clip((total - wanted) * (weight / 2), -1, 1)
    sine = jnp.where(u * p_sin < v * p_cos, -weight, weight) * safe.sqrt((1 - cosine) * (1 + cosine))
    cosine = cosine * weight
    moved = (wanted != span_squared) & (weight > 0)
    new_sin, new_cos = v * cosine + u * sine, u * cosine - v * sine
    return jnp.where(moved, new_sin, p_sin), jnp.where(moved, new_cos, p_cos), moved
