"""Arms with axis 1 perpendicular to 2 and axes 2, 3, 4 parallel; 5 and 6 each square to the last.

Storey: solvers. Branches: 8. Universal Robots' arms and the lectures' elbow manipulator.

Frames: standard DH. s1, s4, s5 are the signs of sin(alpha), c2 and c3 those of cos(alpha); an
antiparallel axis is c = -1, and `up` is +1 where axis 1 points up. Frame 1 stands on axis 2; the
arm's plane is its x, y plane.

Steps:
1. shoulder: the point where axes 5 and 6 meet lies `lateral` beside axis 1's plane: joint 1.
2. axis 6 against axis 2 gives joint 5; what is left of axis 6 in the plane gives the whole pitch
   t2 + c2 t3 + c2 c3 t4, and the rotation about axis 6 gives joint 6.
3. triangle: a2 and a3 reach axis 4 in the plane: joints 2, 3, then 4.
Where axis 6 is parallel to axis 2 the pitch is arbitrary; it follows `now`, moved as little as
lets the triangle close.

Bits: front and up as in `ortho_parallel_wrist`; noflip: sin(t5) has the sign of up s1 c2 c3 s4
(and of a1, where it is not zero).

Source: the order of the steps is that of the lectures' elbow manipulator (ME/SE 740, lecture 18);
the offsets, the signs and the singular rule are ours.
"""

import jax.numpy as jnp

from ikjax.arm.forward import Link
from ikjax.core import safe, vector
from ikjax.core.pose import Pose
from ikjax.core.trig import Angle, Scalar, angle
from ikjax.solvers.branch import Branch, Setting, bits
from ikjax.solvers.shoulder import shoulder
from ikjax.solvers.triangle import ring, triangle


def branches(
    signs: tuple[int, ...], links: tuple[Link, ...], goal: Pose, setting: Setting
) -> tuple[Branch, ...]:
    """All eight slots for one goal.

    Arguments as in `ortho_parallel_wrist`; signs: up, s1, c2, c3, s4, s5.
    """
    up, s1, c2, c3, s4, s5 = signs
    one, two, three, four, five = links[:5]
    c23 = c2 * c3
    x, y, z = goal.position
    lateral = s1 * (two.d + c2 * three.d + c23 * four.d)
    facing = safe.sign(one.a)
    hand = (four.a, -c23 * s4 * five.d)  # from axis 4 to where 5 and 6 meet, at pitch 0
    pitch_now = _whole_pitch(setting.now, c2, c23)
    tiny, turned = setting.tiny, setting.angle
    slots = []
    for slot in range(8):
        side, height, wrist = bits(slot)
        base = shoulder(x, y, lateral, side * facing, setting)
        seen = setting.unwind(goal, links, (base.turn,))
        v, _, n = vector.transpose(seen.rotation)

        rho_squared = n[0] * n[0] + n[1] * n[1]
        free = rho_squared <= tiny * tiny
        t5_sin = wrist * facing * (up * s1 * c23 * s4) * safe.sqrt(rho_squared)
        t5_cos = -c23 * s4 * s5 * n[2]
        weight = s5 * wrist * facing * (up * s1 * c23 * s4) * safe.reciprocal_sqrt(rho_squared)
        p_sin = jnp.where(free, pitch_now.sin, n[1] * weight)
        p_cos = jnp.where(free, pitch_now.cos, n[0] * weight)

        ahead, rise = base.ahead - one.a, s1 * (z - one.d)
        # So near the singularity the pitch is noise, or arbitrary: it may serve the triangle.
        loose = rho_squared <= 4 * tiny
        p_sin, p_cos = _closing(ahead, rise, hand, two.a, three.a, p_sin, p_cos, loose)
        arm = triangle(
            ahead - (p_cos * hand[0] - p_sin * hand[1]),
            rise - (p_sin * hand[0] + p_cos * hand[1]),
            two.a,
            three.a,
            up * s1 * side * facing * height,
            setting,
        )
        # c23 t4 = pitch - (t2 + elbow)
        fore_sin = arm.shoulder_sin * arm.elbow_cos + arm.shoulder_cos * arm.elbow_sin
        fore_cos = arm.shoulder_cos * arm.elbow_cos - arm.shoulder_sin * arm.elbow_sin
        t4_sin = p_sin * fore_cos - p_cos * fore_sin
        t4_cos = p_cos * fore_cos + p_sin * fore_sin
        # The goal's x axis against the axes that joint 6 turns it between.
        forward = p_cos * v[0] + p_sin * v[1]
        t6_cos = t5_cos * forward + c23 * s4 * t5_sin * v[2]
        t6_sin = c23 * s4 * s5 * (p_sin * v[0] - p_cos * v[1])
        joints = (
            base.turn,
            turned(arm.shoulder_sin, arm.shoulder_cos),
            turned(c2 * arm.elbow_sin, arm.elbow_cos),
            turned(c23 * t4_sin, t4_cos),
            turned(t5_sin, t5_cos),
            turned(t6_sin, t6_cos),
        )
        margin = jnp.minimum(base.margin, arm.margin)
        slots.append(Branch(joints, seen, margin, base.continuum | free | arm.continuum))
    return tuple(slots)


def _whole_pitch(now: tuple[Angle, ...], c2: int, c23: int) -> Angle:
    """t2 + c2 t3 + c23 t4."""
    sine, cosine = now[1].sin, now[1].cos
    for sign, joint in ((c2, now[2]), (c23, now[3])):
        sine, cosine = (
            sine * joint.cos + sign * cosine * joint.sin,
            cosine * joint.cos - sign * sine * joint.sin,
        )
    return angle(sine, cosine)


def _closing(
    x: Scalar, y: Scalar, hand, upper: Scalar, fore: Scalar, p_sin, p_cos, loose
) -> tuple[Scalar, Scalar]:
    """The pitch, where it is loose, moved as little as lets the links reach axis 4.

    Axis 4 lies at (x, y) less the hand turned by the pitch; its distance from the shoulder is
    brought into the ring by the law of cosines, on the side where the hand already is.
    """
    reach_squared, hand_squared = x * x + y * y, hand[0] * hand[0] + hand[1] * hand[1]
    hx, hy = p_cos * hand[0] - p_sin * hand[1], p_sin * hand[0] + p_cos * hand[1]
    span_squared = (x - hx) ** 2 + (y - hy) ** 2
    low, high = ring(upper, fore)
    wanted = jnp.clip(span_squared, low * low, high * high)
    size_squared = reach_squared * hand_squared
    weight = safe.reciprocal_sqrt(size_squared)
    cosine = jnp.clip((reach_squared + hand_squared - wanted) * (weight / 2), -1, 1)
    sine = safe.sign(x * hy - y * hx) * safe.sqrt((1 - cosine) * (1 + cosine))
    # The hand's new direction, then the pitch that takes the hand there.
    dx, dy = x * cosine - y * sine, y * cosine + x * sine
    moved = loose & (wanted != span_squared) & (weight > 0)
    new_sin = (dy * hand[0] - dx * hand[1]) * weight
    new_cos = (dx * hand[0] + dy * hand[1]) * weight
    return jnp.where(moved, new_sin, p_sin), jnp.where(moved, new_cos, p_cos)
