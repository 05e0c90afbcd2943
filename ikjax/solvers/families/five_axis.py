"""Five turning joints of which 2, 3 and 4 are parallel; 1 and 5 have any other directions.

Branches: 4. Task: "pose"; goals outside the arm's five-dimensional set are not valid.
The arm read from the tool to the base is of the same kind, so that a roll, three parallel axes and a turn are
solved as they are.

Frames: standard DH. s1, s4 are the signs of sin(alpha), c2 and c3 those of cos(alpha); `up` is +1
where axis 1 points up. Frame 1 has its origin on axis 2; the arm's plane is its x, y plane.

Steps:
1. shoulder: axis 5 is at a known angle to axis 2, and its foot from axis 4 at a known distance along axis 2.
   Both are lines x sin(t1) - y cos(t1) = l. The combination of the two with the longest (x, y) is solved:
   the foot where that is away from axis 1, the direction of axis 5 where that is away from the direction of
   axis 1. Gauss-Newton steps on both lines then restore the digits that a double root of the one has lost.
2. hand: axis 5 in the plane gives the whole pitch t2 + c2 t3 + c2 c3 t4; axis 2 seen from the hand gives
   joint 5.
3. triangle: a2 and a3 reach axis 4 in the plane: joints 2, 3, then 4.

The lines have two common roots where they are the same line. Without a lateral offset they always are, and
four slots are valid where the links reach. With one they are so only where axis 5 is along axis 1 or parallel
to it; elsewhere two slots are valid.

Bits:
1. front or back: what was solved, the foot as a rule, is on the side of axis 1 where axis 2 is (a1), or on
   the other; along x1 if a1 = 0.
2. up or down: the elbow is above the line from shoulder to wrist, for an arm that faces its wrist.

Source: Craig, Introduction to Robotics, 3rd ed., section 4.7 for the order of the steps; the two lines,
the offsets and the twists are ours.
"""

from typing import NamedTuple

import jax.numpy as jnp

from ikjax.arm.forward import Joint, Link, unwind
from ikjax.arm.recognition.signs import FiveAxisSigns
from ikjax.core import safe
from ikjax.core.pose import Pose
from ikjax.core.trig import Angle, Scalar, SinCos
from ikjax.core.vector import minus, plus, times
from ikjax.core.xla import agreed, pin
from ikjax.solvers.context import Branch, Joints, Setting, bits
from ikjax.solvers.steps.shoulder import Shoulder, shoulder
from ikjax.solvers.steps.triangle import Triangle, triangle

BEND = 8
"""How many times `correction_size` the elbow is bent: the errors of four joints add up in its reach, and from
a straight elbow one of its two answers would not be found."""

LARGEST_CORRECTION = 0.1
"""[rad] What rounding takes from a double root is less, unless it is too near axis 1 to count."""


class Line(NamedTuple):
    """x sin(t1) - y cos(t1) = lateral"""

    x: Scalar
    y: Scalar
    lateral: Scalar

    def times(self, factor: Scalar) -> "Line":
        return Line(*(times(factor, part) for part in self))

    def plus(self, other: "Line") -> "Line":
        return Line(*map(plus, self, other))

    def gap(self, turn: Angle) -> Scalar:
        return self.x * turn.sin - self.y * turn.cos - self.lateral

    def ahead(self, turn: Angle) -> Scalar:
        """Along x1; the derivative of the gap with respect to t1."""
        return self.x * turn.cos + self.y * turn.sin


def branches(
    signs: FiveAxisSigns, links: tuple[Link, ...], goal: Pose, setting: Setting
) -> tuple[Branch, ...]:
    """All four slots for one goal.

    Arguments as in `ortho_parallel_wrist`.
    """
    up, s1 = signs.up, signs.sin_alpha1
    one, two, three, four = links[:4]
    main, rest = _lines(signs, links, goal, setting)
    facing = safe.sign(one.a)
    slots: dict[int, Branch] = {}
    for first in (0, 1):
        side, *_ = bits(first)
        base = _shoulder(main, rest, side * facing, setting)
        miss = abs(one.sin_alpha) * safe.norm(main.gap(base.turn), rest.gap(base.turn))
        seen = unwind(goal, one, Joint(base.turn.sin, base.turn.cos, one.d))
        # Seen from frame 1 the rotation is Rz(pitch) Rx(tilt) Rz(t5), with sin(tilt) = c2 c3 sin(alpha4).
        tilted = signs.cos_alpha23 * signs.sin_alpha4
        n = tuple(row[2] for row in seen.rotation)
        weight = tilted * safe.reciprocal_sqrt(n[0] * n[0] + n[1] * n[1])
        p_sin, p_cos = n[0] * weight, jnp.where(weight == 0, 1, -n[1] * weight)
        p_sin, p_cos = pin(p_sin), pin(p_cos)
        h = seen.rotation[2]
        weight = tilted * safe.reciprocal_sqrt(h[0] * h[0] + h[1] * h[1])
        roll = setting.angle(h[0] * weight, jnp.where(weight == 0, 1, h[1] * weight))
        x, y, _ = seen.position
        for height in (1, -1):
            arm = triangle(
                x - four.a * p_cos,
                y - four.a * p_sin,
                two.a,
                three.a,
                up * s1 * side * facing * height,
                setting,
                BEND * setting.correction_size,
            )
            joints = joints_of(signs, base, arm, (p_sin, p_cos), roll, setting)
            margin = jnp.minimum(base.margin, arm.margin)
            slots[first + (0 if height == 1 else 2)] = Branch(
                joints, goal, margin, base.continuum | arm.continuum, miss
            )
    return tuple(slots[slot] for slot in range(4))


def joints_of(
    signs: FiveAxisSigns, base: Shoulder, arm: Triangle, pitch: SinCos, roll: Angle, setting: Setting
) -> Joints:
    """All five joints.

    Args:
        signs: Those of the family.
        base: Joint 1.
        arm: The triangle in the plane that joint 1 turns.
        pitch: The hand's whole pitch in that plane.
        roll: Joint 5.
        setting: Pins values.
    """
    (p_sin, p_cos), c2, c23 = pitch, signs.cos_alpha2, signs.cos_alpha23
    # c23 t4 = pitch - (t2 + elbow)
    fore_sin = arm.shoulder_sin * arm.elbow_cos + arm.shoulder_cos * arm.elbow_sin
    fore_cos = arm.shoulder_cos * arm.elbow_cos - arm.shoulder_sin * arm.elbow_sin
    return (
        base.turn,
        setting.angle(arm.shoulder_sin, arm.shoulder_cos),
        setting.angle(c2 * arm.elbow_sin, arm.elbow_cos),
        setting.angle(c23 * (p_sin * fore_cos - p_cos * fore_sin), p_cos * fore_cos + p_sin * fore_sin),
        roll,
    )


def _lines(signs: FiveAxisSigns, links: tuple[Link, ...], goal: Pose, setting: Setting) -> tuple[Line, Line]:
    """The combination of the two lines with the longest (x, y), and the one square to it."""
    one, two, three, four = links[:4]
    s, c = one.sin_alpha, one.cos_alpha
    c2, c23 = float(signs.cos_alpha2), float(signs.cos_alpha23)
    per = safe.divide(1, s)
    x, y, z = goal.position
    lateral = plus(plus(two.d, times(c2, three.d)), times(c23, four.d))
    foot = Line(x, y, times(per, plus(lateral, minus(times(c, plus(z, -one.d))))))
    n = tuple(row[2] for row in goal.rotation)
    along = Line(n[0], n[1], times(per, plus(times(c23, four.cos_alpha), minus(times(c, n[2])))))
    # (x, y) of the combination by the angle t is an ellipse; half-angle formulas give its longer axis.
    more = (foot.x * foot.x + foot.y * foot.y - along.x * along.x - along.y * along.y) / 2
    both = foot.x * along.x + foot.y * along.y
    per_size = safe.reciprocal_sqrt(more * more + both * both)
    larger = safe.sqrt((1 + abs(more) * per_size) / 2)
    smaller = safe.divide(abs(both) * per_size, 2 * larger)
    foot_first = (more >= 0) | (per_size == 0)
    p = agreed(jnp.where(foot_first, larger, smaller))
    q = agreed(safe.sign(both) * jnp.where(foot_first, smaller, larger))
    return foot.times(p).plus(along.times(q)), along.times(p).plus(foot.times(-q))


def _shoulder(main: Line, rest: Line, side: Scalar, setting: Setting) -> Shoulder:
    """Joint 1 from the main line, corrected by two Gauss-Newton steps on both."""
    base = shoulder(main.x, main.y, main.lateral, side, setting)
    half = _half_gauss_newton_step(main, rest, base.turn)
    # A step to the other side of the fold would lead to the other slot's answer, unless the two are as near
    # as rounding puts them.
    stays = side * (5 * main.ahead(base.turn) - 8 * half * main.lateral) >= 0
    corrects = stays & (abs(half) < LARGEST_CORRECTION / 2) & ~base.continuum
    turn = _turned(base.turn, jnp.where(corrects, half, 0))
    turn = _turned(turn, agreed(jnp.where(corrects, _half_gauss_newton_step(main, rest, turn), 0)))
    return base._replace(turn=setting.angle(turn.sin, turn.cos))


def _half_gauss_newton_step(main: Line, rest: Line, turn: Angle) -> Scalar:
    """Half the Gauss-Newton step [rad] of the least squares of both gaps."""
    derivatives = main.ahead(turn), rest.ahead(turn)
    size = derivatives[0] * derivatives[0] + derivatives[1] * derivatives[1]
    return -safe.divide(derivatives[0] * main.gap(turn) + derivatives[1] * rest.gap(turn), 2 * size)


def _turned(turn: Angle, half: Scalar) -> Angle:
    """The angle turned by 2 atan(half), which stays on the circle."""
    per = 1 / (1 + half * half)
    sine, cosine = 2 * half * per, (1 - half * half) * per
    return Angle(turn.sin * cosine + turn.cos * sine, turn.cos * cosine - turn.sin * sine, ())
