"""The `five_axis` arms, for any goal: the point is attained, the orientation is the nearest.

Branches and bits: those of `five_axis`. Arguments, frames and signs are the same.

Steps:
1. foot: the foot of the tool point on axis 5, in the goal's orientation. A tool point on axis 5 is its own
   foot, however the tool is rolled.
2. shoulder: the foot is at a known distance along axis 2, so joint 1 brings it into the arm's plane.
3. pitch: what is left of the orientation is Rz(pitch) Rx(tilt) Rz(roll). With half angles its quaternion's
   overlap with the goal's (w, x, y, z) is
       cos(tilt/2) (w cos s + z sin s) + sin(tilt/2) (x cos d + y sin d),   s, d = (pitch +- roll) / 2,
   two terms, each of which is maximized on its own. As an angle of the goal's matrix, at the best pitch axis
   5 is along the projection of the wanted one onto the plane. On either side of the best pitch the overlap
   falls, and equally.
4. reach: the links reach axis 4 where its distance from axis 2 is within their ring. This is an interval of
   pitches on either side of the foot's direction, and the best pitch is moved to the nearest end. Where no
   pitch will do, that end points straight at the foot, or away from it, and the triangle ends as near as it
   can.
5. roll: the best for that pitch, from the trace. Then the triangle: joints 2, 3, 4.
The foot of a tool point off axis 5 depends on the attained orientation: all steps but the triangle are a
fixed-point iteration, and the point is attained to what `ROUNDS` of it leave.

Source: Craig, Introduction to Robotics, 3rd ed., section 4.7, turns the goal's tool axis into the arm's
plane: that is step 3 where axis 5 is square to axis 4. The rest is ours.
"""

from typing import NamedTuple

import jax.numpy as jnp

from ikjax.arm.forward import Joint, Link, unwind
from ikjax.arm.recognition.signs import FiveAxisSigns
from ikjax.core import safe, vector
from ikjax.core.pose import Pose
from ikjax.core.trig import Scalar, SinCos
from ikjax.core.vector import minus, plus, times
from ikjax.core.xla import pin
from ikjax.solvers.context import Branch, Setting, bits
from ikjax.solvers.families.five_axis import joints_of
from ikjax.solvers.steps.shoulder import Shoulder, shoulder
from ikjax.solvers.steps.triangle import ring, triangle

ROUNDS = 3
"""Iterations for the foot where the tool point is off axis 5."""


class Hand(NamedTuple):
    """Joint 1, and the hand in the plane that it turns."""

    base: Shoulder
    foot: tuple[Scalar, Scalar]
    """Of the tool point on axis 5, in frame 1."""
    pitch: SinCos
    roll: SinCos
    rotation: vector.Matrix
    """Of the goal, seen from frame 1."""


def branches(
    signs: FiveAxisSigns, links: tuple[Link, ...], goal: Pose, setting: Setting
) -> tuple[Branch, ...]:
    """All four slots for one goal."""
    up, s1 = signs.up, signs.sin_alpha1
    one, two, three, four = links[:4]
    slots: dict[int, Branch] = {}
    for first in (0, 1):
        side = bits(first)[0] * safe.sign(one.a)
        hand = hand_of(signs, links, goal, side, setting)
        base = hand.base
        ahead, aside = turned(wrist_of(signs, four, setting), hand.pitch)
        roll = setting.angle(*hand.roll)
        for height in (1, -1):
            left = up * s1 * side * height
            x, y = hand.foot
            arm = triangle(x - ahead, y - aside, two.a, three.a, left, setting)
            joints = joints_of(signs, base, arm, hand.pitch, roll, setting)
            slots[first + (0 if height == 1 else 2)] = Branch(
                joints, goal, jnp.minimum(base.margin, arm.margin), base.continuum | arm.continuum
            )
    return tuple(slots[slot] for slot in range(4))


def hand_of(
    signs: FiveAxisSigns, links: tuple[Link, ...], goal: Pose, side: Scalar, setting: Setting
) -> Hand:
    """Joint 1 on one side, and the nearest hand that it allows."""
    x, y, _ = setting.tool_point
    point = vector.add(goal.position, vector.rotate(goal.rotation, setting.tool_point))
    off = vector.rotate(goal.rotation, (x, y, 0.0))
    hand = _hand_at(signs, links, goal, vector.subtract(point, off), side, setting)
    if isinstance(x, float) and isinstance(y, float) and x == y == 0:
        return hand
    for _ in range(ROUNDS - 1):
        off = _carried(signs, links, hand, (x, y))
        hand = _hand_at(signs, links, goal, vector.subtract(point, off), side, setting)
    return hand


def _hand_at(
    signs: FiveAxisSigns,
    links: tuple[Link, ...],
    goal: Pose,
    foot: vector.Vector,
    side: Scalar,
    setting: Setting,
) -> Hand:
    """The nearest hand whose foot is at a given point."""
    c2, c23, s4 = float(signs.cos_alpha2), float(signs.cos_alpha23), signs.sin_alpha4
    one, two, three, four = links[:4]
    s, c = one.sin_alpha, one.cos_alpha
    lateral = plus(plus(two.d, times(c2, three.d)), times(c23, four.d))
    lateral = plus(lateral, times(times(c23, four.cos_alpha), setting.tool_point[2]))
    x, y, z = foot
    lateral = times(safe.divide(1, s), plus(lateral, minus(times(c, plus(z, -one.d)))))
    base = shoulder(x, y, lateral, side, setting)
    seen = unwind(Pose(goal.rotation, foot), one, Joint(base.turn.sin, base.turn.cos, one.d))
    x, y, _ = (pin(value) for value in seen.position)
    n = seen.rotation[0][2], seen.rotation[1][2]
    weight = c23 * s4 * safe.reciprocal_sqrt(n[0] * n[0] + n[1] * n[1])
    pitch = pin(n[0] * weight), pin(jnp.where(weight == 0, 1, -n[1] * weight))
    pitch = _reachable(pitch, (x, y), wrist_of(signs, four, setting), two, three)
    pitch = pin(pitch[0]), pin(pitch[1])
    return Hand(base, (x, y), pitch, roll_of(signs, seen.rotation, pitch, four, setting), seen.rotation)


def wrist_of(signs: FiveAxisSigns, four: Link, setting: Setting) -> tuple[Scalar, Scalar]:
    """From axis 4 to the foot, at pitch zero."""
    return four.a, times(-float(signs.cos_alpha23), times(four.sin_alpha, setting.tool_point[2]))


def turned(point: tuple[Scalar, Scalar], angle: SinCos) -> tuple[Scalar, Scalar]:
    """A vector of a plane, turned by an angle."""
    (x, y), (sine, cosine) = point, angle
    return plus(times(x, cosine), times(-sine, y)), plus(times(x, sine), times(cosine, y))


def _reachable(pitch: SinCos, foot, wrist, two: Link, three: Link) -> SinCos:
    """The nearest pitch at which the links reach axis 4.

    Args:
        pitch: The best pitch.
        foot: In frame 1.
        wrist: From axis 4 to the foot, at pitch zero.
        two, three: The links.
    """
    low, high = ring(two.a, three.a)
    (x, y), (u, v) = foot, turned(wrist, pitch)
    far, span = x * x + y * y, plus(times(wrist[0], wrist[0]), times(wrist[1], wrist[1]))
    # |foot - (u, v)| is within the ring where their dot product is between two bounds (law of cosines).
    product, cross = x * u + y * v, x * v - y * u
    middle = (far + span) / 2
    most = safe.sqrt(far * span)
    wanted = jnp.clip(product, middle - high * high / 2, middle - low * low / 2)
    wanted = jnp.clip(wanted, -most, most)
    height = safe.sign(cross) * safe.sqrt((most - wanted) * (most + wanted))
    scale = safe.divide(1, far * span)
    # The pitch is turned from the present angle to the wanted one, both against the foot's direction.
    sine = (height * product - wanted * cross) * scale
    cosine = (wanted * product + height * cross) * scale
    stays = (wanted == product) | (scale == 0)
    sine, cosine = jnp.where(stays, 0, sine), jnp.where(stays, 1, cosine)
    return pitch[0] * cosine + pitch[1] * sine, pitch[1] * cosine - pitch[0] * sine


def roll_of(
    signs: FiveAxisSigns, rotation: vector.Matrix, pitch: SinCos, four: Link, setting: Setting
) -> SinCos:
    """The roll that brings Rz(pitch) Rx(tilt) Rz(roll) nearest to a rotation seen from frame 1.

    It maximizes the trace, which is a cosine and sine of the roll.
    """
    (p_sin, p_cos), c23 = pitch, float(signs.cos_alpha23)
    ahead = [p_cos * rotation[0][k] + p_sin * rotation[1][k] for k in (0, 1)]
    aside = [p_cos * rotation[1][k] - p_sin * rotation[0][k] for k in (0, 1)]
    t_sin, t_cos = times(c23, four.sin_alpha), times(c23, four.cos_alpha)
    tilted = [plus(times(t_cos, aside[k]), times(t_sin, rotation[2][k])) for k in (0, 1)]
    sine, cosine = tilted[0] - ahead[1], ahead[0] + tilted[1]
    weight = safe.reciprocal_sqrt(sine * sine + cosine * cosine)
    return pin(sine * weight), pin(jnp.where(weight == 0, 1, cosine * weight))


def _carried(signs: FiveAxisSigns, links: tuple[Link, ...], hand: Hand, tool) -> vector.Vector:
    """A vector in the hand square to axis 5, seen from frame 0."""
    one, four = links[0], links[3]
    c23 = float(signs.cos_alpha23)
    t_sin, t_cos = times(c23, four.sin_alpha), times(c23, four.cos_alpha)
    x, y = turned(tool, hand.roll)
    y, z = times(t_cos, y), times(t_sin, y)
    x, y = turned((x, y), hand.pitch)
    y, z = (
        plus(times(one.cos_alpha, y), times(-1.0, times(one.sin_alpha, z))),
        plus(times(one.sin_alpha, y), times(one.cos_alpha, z)),
    )
    x, y = turned((x, y), (hand.base.turn.sin, hand.base.turn.cos))
    return x, y, z
