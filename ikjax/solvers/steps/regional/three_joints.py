"""The first three joints, turning or sliding, of any twists and offsets: where they bring a point.

Branches: 4, 2 or 1.

Frames: standard DH. The point is fixed in the frame after joint 3. Seen from frame 2 it is
f = (f1, f2, f3), affine in (cos t3, sin t3) or in the slide q3. Seen from the link that joint 2
carries it is h. Seen from frame 1 it is g, which is h turned by joint 2.

Steps:
1. Eliminate joint 1 and then joint 2. This leaves one equation for joint 3: a quartic, or where the
   arm's own numbers make it split (`RegionalSplit`), one of the second degree or the first.
2. Joint 2 from g and h: unique after a quartic, else two.
3. Joint 1 from the point and g: unique.

Bits after a quartic:
1. rising or falling: the sign of its derivative with respect to joint 3 at the root. After two turning joints
   that is the sign of the determinant of the Jacobian of the three joints, and changes at folds only.
2. low or high: the order of the two such roots from -pi, where they may swap.
Bits otherwise: j2+ or j2-, then j3+ or j3-: the sign of the derivative of each equation at its root. A bit is
left out where its equation has one root.

Source: Pieper, The kinematics of manipulators under computer control (1968), after Craig,
Introduction to Robotics, 3rd ed., section 4.6; sliding joints and the elimination in circle form are ours.
"""

import functools
from collections.abc import Sequence
from typing import NamedTuple

import jax.numpy as jnp

from ikjax.arm.forward import Link, advance, known_sincos
from ikjax.arm.recognition.signs import RegionalSplit
from ikjax.core import safe, vector
from ikjax.core.linear import damped_steps
from ikjax.core.pose import IDENTITY, Pose
from ikjax.core.roots import cosine_sine
from ikjax.core.trig import Scalar
from ikjax.core.vector import Vector, plus, times
from ikjax.core.xla import agreed_root, pin
from ikjax.solvers.context import Joints, Setting, Slide, moved_on, placed
from ikjax.solvers.steps.regional.point_chain import Chain, Poly, chain_of
from ikjax.solvers.steps.regional.third_joint import (
    Third,
    circle_roots,
    distance_moved,
    half_angle_harmonics,
    harmonics_of,
    roots,
    second_degree,
)


class Regional(NamedTuple):
    """One way to bring the point there."""

    joints: Joints
    """Three of them."""
    margin: Scalar
    continuum: Scalar


def regional(
    links: tuple[Link, ...], point: Vector, wanted: Vector, split: RegionalSplit, setting: Setting
) -> tuple[Regional, ...]:
    """Every way to bring a point where it is wanted.

    Args:
        links: The first three, lengths in units of the reach.
        point: The point, given in frame 3.
        wanted: Where it has to be, seen from frame 0.
        split: How the equation for joint 3 splits.
        setting: Fallback and tolerances.
    """
    chain = chain_of(links, point)
    # By the kinds of joints 1 and 2; joint 3 turns or slides in each.
    eliminate = {"RR": _two_turns, "RP": _turn_slide, "PR": _slide_turn, "PP": _two_slides}
    ways = eliminate[chain.kinds[:2]](chain, wanted, split, setting)
    nearly = setting.close_pairs(split)
    return tuple(_polished(chain, point, wanted, way, nearly, setting) for way in ways)


def _polished(
    chain: Chain, point: Vector, wanted: Vector, way: Regional, nearly: bool, setting: Setting
) -> Regional:
    """The joints after a step of damped least squares: the elimination squares lengths, and their rounding.

    Args:
        chain: The three links.
        point, wanted: As in `regional`.
        way: What the elimination gave.
        nearly: The equation nearly splits. Its roots come in close pairs, which lose twice as many digits:
            they take four steps.
        setting: Tolerances.
    """
    joints = way.joints
    for _ in range(4 if nearly else 1):
        steps = _damped_steps(chain.links, joints, point, wanted, setting)
        size = functools.reduce(jnp.maximum, (abs(step) for step in steps))
        # A larger step is not the correction of a small error: it would lead to another branch.
        small = size < setting.rounding**0.25
        if nearly:
            # A pair that came out as complex may be real but for rounding; then its roots are nearby.
            small = size < jnp.where(way.margin > 0, 0.3, 4 * setting.rounding**0.25)
        else:
            small &= way.margin > -(setting.rounding**0.5)
        steps = tuple(pin(jnp.where(small, step, 0)) for step in steps)
        moved_joints = map(moved_on, joints, steps)
        joints = tuple(j if isinstance(j, Slide) else setting.angle(j.sin, j.cos) for j in moved_joints)
    return way._replace(joints=joints)


def _damped_steps(
    links: tuple[Link, ...], joints: Joints, point: Vector, wanted: Vector, setting: Setting
) -> Sequence[Scalar]:
    """The step of each joint by damped least squares, as in `given_arm`.

    Where the Jacobian is singular it still takes the point as far as the joints can.
    """
    placed_joints = tuple(map(placed, links, joints))
    first, second, third = (
        advance(IDENTITY, link, joint) for link, joint in zip(links, placed_joints, strict=True)
    )
    from_two = _applied(third, point)
    from_one = _applied(second, from_two)
    from_zero = _applied(first, from_one)

    def motion(joint, tip):
        """Column of the Jacobian: the velocity of the point, seen from the frame of the joint's axis."""
        return (0.0, 0.0, 1.0) if isinstance(joint, Slide) else (-tip[1], tip[0], 0.0)

    # All seen from frame 1.
    back = vector.transpose(first.rotation)
    u = vector.rotate(back, motion(joints[0], from_zero))
    v = motion(joints[1], from_one)
    w = vector.rotate(second.rotation, motion(joints[2], from_two))
    gap = vector.rotate(back, vector.subtract(wanted, from_zero))
    return damped_steps((u, v, w), gap, setting.zero_tolerance / 4)


def _applied(pose: Pose, point: Vector) -> Vector:
    return vector.add(vector.rotate(pose.rotation, point), pose.position)


def _two_turns(chain: Chain, wanted: Vector, split: RegionalSplit, setting: Setting):
    """Joints 1 and 2 turn."""
    one = chain.links[0]
    x, y, z = wanted[0], wanted[1], wanted[2] - one.d
    s, c = one.sin_alpha, one.cos_alpha
    span_squared = x * x + y * y + z * z
    # Seen from frame 1: 2 a1 g1 = ahead, from the distance to the shoulder, and sin(alpha1) g2 = up, from the
    # height. With g1^2 + g2^2 = h1^2 + h2^2 joint 2 is eliminated.
    ahead = Poly(plus(span_squared, -times(one.a, one.a))).less(chain.h_squared)
    up = Poly(z).less(chain.h[2].times(c))
    answers = []
    if split.is_full:
        thirds = _quartic_of_two_turns(chain, ahead, up, (x, y, z), setting)
    elif split == RegionalSplit.MEET:
        thirds = roots(chain, ahead, setting, safe.sqrt(span_squared))
    else:
        thirds = roots(chain, up, setting)
    nearly = setting.close_pairs(split)
    for third in thirds:
        h1, h2, h3 = (pin(p.at(third.u, third.v)) for p in chain.h)
        if split.is_full:
            size = h1 * h1 + h2 * h2
            g1 = safe.divide(ahead.at(third.u, third.v), 2 * one.a)
            g2 = safe.divide(up.at(third.u, third.v), s)
            # A quotient by next to nothing: its size from g1^2 + g2^2 = h1^2 + h2^2, its sign apart.
            if nearly and split == RegionalSplit.NEARLY_MEET:
                g1 = _sign_in_close_pair(ahead, third, chain, one.a, setting) * safe.sqrt(size - g2 * g2)
            if nearly and split == RegionalSplit.NEARLY_PARALLEL:
                g2 = _sign_in_close_pair(up, third, chain, s, setting) * safe.sqrt(size - g1 * g1)
            second, free = setting.between(1, (h1, h2), (g1, g2))
            seconds = [(second, jnp.inf, free)]
        elif split == RegionalSplit.MEET:
            # The equation was divided by s: times |s| its margin is a height again.
            seconds = [
                (second, abs(s) * margin, free)
                for second, margin, free in _both_turns(
                    h2, h1, safe.divide(up.at(third.u, third.v), s), setting
                )
            ]
        else:
            gap = ahead.at(third.u, third.v)
            seconds = [
                (
                    second,
                    distance_moved(safe.sqrt(span_squared), abs(2 * one.a) * margin, safe.sign(gap)),
                    free,
                )
                for second, margin, free in _both_turns(h1, -h2, safe.divide(gap, 2 * one.a), setting)
            ]
        for second, margin, free in seconds:
            g1, g2 = second.cos * h1 - second.sin * h2, second.sin * h1 + second.cos * h2
            # The point in the plane square to axis 1, before joint 1 turns it to (x, y).
            arm = (plus(one.a, g1), plus(times(c, g2), times(-s, h3)))
            first, lost = setting.between(0, arm, (x, y))
            joints = (first, second, third.joint)
            answers.append(Regional(joints, jnp.minimum(third.margin, margin), third.free | free | lost))
    return tuple(answers)


def _sign_in_close_pair(p: Poly, third: Third, chain: Chain, factor: Scalar, setting: Setting) -> Scalar:
    """The sign of p / factor at a root, where `factor` is so small that p is next to zero there.

    The equation that was solved is p^2 - (factor g)^2 = 0, so its roots come in close pairs, one with p of
    each sign. Where rounding hides the sign of p, it follows from which of the two roots is rising: there the
    derivative 2 p p' is positive.
    """
    value = p.at(third.u, third.v)
    derivative = p.rate_at(third.u, third.v, chain.kinds[2] == "R")
    by_rise = third.rise * safe.sign(derivative)
    # Of a value of size one, half the digits are lost at a double root.
    noise = 4 * setting.rounding**0.5
    return jnp.where(abs(value) > noise, safe.sign(value), by_rise) * safe.sign(factor)


def _quartic_of_two_turns(chain: Chain, ahead: Poly, up: Poly, wanted: Vector, setting: Setting):
    """Joint 3 from (s ahead)^2 + (a up)^2 = (a s)^2 (h1^2 + h2^2), with a = 2 a1 and s = sin(alpha1)."""
    one = chain.links[0]
    a, s = times(2.0, one.a), one.sin_alpha
    x, y, z = wanted

    def gradient_norm(ahead, up):
        """Of (s ahead)^2 + (a up)^2 with respect to the point: `ahead` has its square, `up` its height."""
        level, rise = 2 * s * s * ahead, a * a * up
        return 2 * safe.norm(level * x, level * y, level * z + rise)

    if chain.kinds[2] == "R":
        left = ahead.square().times(times(s, s)).plus(up.square().times(times(a, a)))
        whole = left.less(chain.across_squared.times(times(times(a, a), times(s, s))))
        return circle_roots(
            chain, harmonics_of(whole), setting, lambda v, u: gradient_norm(ahead.at(u, v), up.at(u, v))
        )
    # Of the fourth degree in the slide q3: its coefficients, the constant first.
    square = [0.0] * 5
    for i, p in enumerate((ahead.one, ahead.u, ahead.uu)):
        for j, q in enumerate((ahead.one, ahead.u, ahead.uu)):
            square[i + j] = plus(square[i + j], times(times(s, s), times(p, q)))
    rest = up.square().less(chain.across_squared.times(times(s, s))).times(times(a, a))
    for i, p in enumerate((rest.one, rest.u, rest.uu)):
        square[i] = plus(square[i], p)

    def half_angle_gradient_norm(sine, cosine):
        """Times cos(t / 2)^4, as the polynomial is."""
        square = (1 + cosine) / 2
        return square * gradient_norm(ahead.at_half_angle(sine, cosine), up.at_half_angle(sine, cosine))

    return circle_roots(chain, half_angle_harmonics(square), setting, half_angle_gradient_norm)


def _turn_slide(chain: Chain, wanted: Vector, split: RegionalSplit, setting: Setting):
    """Joint 1 turns, joint 2 slides. Seen from frame 1, g3 is eliminated by the height z = s g2 + c g3."""
    one, two = chain.links[:2]
    x, y, z = wanted[0], wanted[1], wanted[2] - one.d
    s, c = one.sin_alpha, one.cos_alpha
    sine, cosine = known_sincos(two.theta)
    h1, h2, h3 = chain.h
    g1, g2 = h1.times(cosine).less(h2.times(sine)), h1.times(sine).plus(h2.times(cosine))
    ahead = g1.plus(Poly(one.a))
    around = x * x + y * y
    answers = []
    if split == RegionalSplit.SQUARE:
        # c = 0: z = s g2 has joint 3 alone. Then g3 from x^2 + y^2 = (a1 + g1)^2 + g3^2.
        for third in roots(chain, Poly(z).less(g2.times(s)), setting):
            gap = around - ahead.at(third.u, third.v) ** 2
            for side in (1, -1):
                g3 = -s * side * agreed_root(gap)
                margin = jnp.minimum(third.margin, safe.sqrt(around) - abs(ahead.at(third.u, third.v)))
                answers.append((third, g3, margin))
    else:
        # g3 = (z - s g2) / c makes c g2 - s g3 = (g2 - s z) / c: `aside`, in x^2 + y^2 = ahead^2 + aside^2.
        aside = g2.less(Poly(times(s, z))).times(safe.divide(1, c))
        square = ahead.square().plus(aside.square()).less(Poly(around))

        def gradient_norm(u, v):
            slant = safe.divide(aside.at(u, v) * s, c)
            return 2 * safe.sqrt(around + slant * slant)

        for third in second_degree(chain, square, setting, gradient_norm):
            g3 = safe.divide(z - s * g2.at(third.u, third.v), c)
            if setting.close_pairs(split):
                gap = around - ahead.at(third.u, third.v) ** 2
                side = _sign_in_close_pair(g2.less(Poly(times(s, z))), third, chain, c, setting)
                g3 = safe.divide(c * g2.at(third.u, third.v) - side * safe.sqrt(gap), s)
            answers.append((third, g3, third.margin))
    ways = []
    for third, g3, margin in answers:
        slide = Slide(g3 - h3.at(third.u, third.v))
        arm = (ahead.at(third.u, third.v), times(c, g2.at(third.u, third.v)) - times(s, g3))
        first, free = setting.between(0, arm, (x, y))
        ways.append(Regional((first, slide, third.joint), margin, third.free | free))
    return tuple(ways)


def _slide_turn(chain: Chain, wanted: Vector, split: RegionalSplit, setting: Setting):
    """Joint 1 slides, joint 2 turns. Seen from frame 1, g1 is known, and y = c g2 - s g3 has no joint 1."""
    one = chain.links[0]
    s, c = one.sin_alpha, one.cos_alpha
    sine, cosine = known_sincos(one.theta)
    x, y, z = cosine * wanted[0] + sine * wanted[1], cosine * wanted[1] - sine * wanted[0], wanted[2]
    g1 = x - one.a
    h1, h2, h3 = chain.h
    ways = []
    if split == RegionalSplit.SQUARE:
        # c = 0: y = -s h3 has joint 3 alone. Then joint 2 from g1.
        thirds = roots(chain, Poly(y).plus(h3.times(s)), setting)
    else:
        # g2 = (y + s h3) / c into g1^2 + g2^2 = h1^2 + h2^2.
        across = Poly(y).plus(h3.times(s))
        g2 = across.times(safe.divide(1, c))
        square = g2.square().plus(Poly(g1 * g1)).less(chain.across_squared)

        def gradient_norm(u, v):
            slant = safe.divide(g2.at(u, v), c)
            return 2 * safe.sqrt(g1 * g1 + slant * slant)

        thirds = second_degree(chain, square, setting, gradient_norm)
    for third in thirds:
        at = [p.at(third.u, third.v) for p in (h1, h2, h3)]
        if split == RegionalSplit.SQUARE:
            seconds = _both_turns(at[0], -at[1], g1, setting)
        else:
            other = g2.at(third.u, third.v)
            if setting.close_pairs(split):
                gap = at[0] * at[0] + at[1] * at[1] - g1 * g1
                other = _sign_in_close_pair(across, third, chain, c, setting) * safe.sqrt(gap)
            second, free = setting.between(1, (at[0], at[1]), (g1, other))
            seconds = [(second, jnp.inf, free)]
        for second, margin, free in seconds:
            along = second.sin * at[0] + second.cos * at[1]
            slide = Slide(z - one.d - (times(s, along) + times(c, at[2])))
            margin = jnp.minimum(third.margin, margin)
            ways.append(Regional((slide, second, third.joint), margin, third.free | free))
    return tuple(ways)


def _two_slides(chain: Chain, wanted: Vector, split: RegionalSplit, setting: Setting):
    """Joints 1 and 2 slide: x = a1 + g1 has joint 3 alone, and the slides follow from y and z."""
    one, two = chain.links[:2]
    s, c = one.sin_alpha, one.cos_alpha
    sine, cosine = known_sincos(one.theta)
    x, y, z = cosine * wanted[0] + sine * wanted[1], cosine * wanted[1] - sine * wanted[0], wanted[2]
    sine, cosine = known_sincos(two.theta)
    h1, h2, h3 = chain.h
    g1, g2 = h1.times(cosine).less(h2.times(sine)), h1.times(sine).plus(h2.times(cosine))
    ways = []
    for third in roots(chain, Poly(x - one.a).less(g1), setting):
        across, above = g2.at(third.u, third.v), h3.at(third.u, third.v)
        # Joint 2 slides along z of frame 1 and joint 1 along z of frame 0: y = c g2 - s g3, then z.
        second = Slide(safe.divide(times(c, across) - y, s) - above)
        first = Slide(z - one.d - (times(s, across) + times(c, above + second.value)))
        ways.append(Regional((first, second, third.joint), third.margin, third.free))
    return tuple(ways)


def _both_turns(a: Scalar, b: Scalar, c: Scalar, setting: Setting):
    """Both roots for joint 2 of a cos(t) + b sin(t) = c, as (joint, margin, whether it is arbitrary)."""
    answers = []
    for side in (1, -1):
        root = cosine_sine(a, b, c, side, noise=setting.length_uncertainty)
        free = (a * a + b * b <= setting.zero_tolerance**2) & (abs(c) <= setting.zero_tolerance)
        turn = setting.filled(1, free | root.free, root.sin, root.cos)
        answers.append((turn, root.margin, free))
    return answers
