"""The first three joints, turning or sliding, of any twists and offsets: where they bring a point.

Storey: solvers. Branches: 4, 2 or 1.

Frames: standard DH. The point is fixed in the frame after joint 3; seen from frame 2 it is
f = (f1, f2, f3), affine in (cos t3, sin t3) or in the slide q3; seen from the link that joint 2
carries it is h, from frame 1 it is g, h turned by joint 2.

Steps:
1. Joint 1 and then joint 2 are eliminated, which leaves one equation for joint 3: a quartic, or
   where the arm's own numbers make it split, one of the second degree or the first.
2. Joint 2 from g and h: unique after a quartic, else two.
3. Joint 1 from the point and g, unique.

Bits: after a quartic, whether it rises or falls in joint 3 at the root, which after two turning joints is
the sign of the determinant of the three joints' motions and changes at folds only; then the order of
the two from -pi, where they may swap. Otherwise the sign of the derivative of each equation at its
root, first joint 2, then joint 3.

Source: Pieper, The kinematics of manipulators under computer control (1968), after Craig,
Introduction to Robotics, 3rd ed., section 4.6; sliding joints and the elimination in circle form are ours.
"""

import functools
from typing import NamedTuple

import jax.numpy as jnp

from ikjax.arm.forward import Link, advance, known_sincos
from ikjax.core import safe, vector
from ikjax.core.pose import IDENTITY, Pose
from ikjax.core.roots import CircleRoot, circle_quartic, cosine_sine, harmonics_at
from ikjax.core.trig import Angle, Scalar
from ikjax.core.vector import Vector, plus, times
from ikjax.solvers.branch import Joints, Setting, Slide, placed

POLISH = 2
"""Newton steps at the end."""


class Regional(NamedTuple):
    """One way to bring the point there."""

    joints: Joints
    """Three of them."""
    margin: Scalar
    continuum: Scalar


class Poly(NamedTuple):
    """one + u U + v V + uu U^2 + uv U V + vv V^2, with (U, V) = (cos t3, sin t3) or (q3, 0)."""

    one: Scalar
    u: Scalar = 0.0
    v: Scalar = 0.0
    uu: Scalar = 0.0
    uv: Scalar = 0.0
    vv: Scalar = 0.0

    def plus(self, other: "Poly") -> "Poly":
        return Poly(*map(plus, self, other))

    def times(self, factor: Scalar) -> "Poly":
        return Poly(*(times(factor, c) for c in self))

    def less(self, other: "Poly") -> "Poly":
        return self.plus(other.times(-1.0))

    def square(self) -> "Poly":
        """Of a polynomial of the first degree."""
        one, u, v = self[:3]
        return Poly(
            times(one, one),
            times(2.0, times(one, u)),
            times(2.0, times(one, v)),
            times(u, u),
            times(2.0, times(u, v)),
            times(v, v),
        )

    def at(self, u: Scalar, v: Scalar) -> Scalar:
        low = plus(plus(self.one, times(self.u, u)), times(self.v, v))
        high = plus(times(times(self.uu, u), u), times(times(self.uv, u), v))
        return plus(plus(low, high), times(times(self.vv, v), v))


class Third(NamedTuple):
    """A candidate for joint 3."""

    joint: Angle | Slide
    u: Scalar
    v: Scalar
    margin: Scalar


class Chain(NamedTuple):
    """What the three links make of the point."""

    kinds: str
    links: tuple[Link, ...]
    h: tuple[Poly, Poly, Poly]
    """The point seen from the link that joint 2 carries; without q2 where that slides."""
    h_squared: Poly
    """h1^2 + h2^2 + h3^2"""
    across_squared: Poly
    """h1^2 + h2^2"""


def chain_of(links: tuple[Link, ...], point: Vector) -> Chain:
    """The polynomials of the arm, from the point seen from frame 3 without its own turn and slide."""
    _, two, three = links
    kinds = "".join(link.kind for link in links)
    s, c = three.sin_alpha, three.cos_alpha
    along = plus(three.a, point[0])
    aside = plus(times(c, point[1]), times(-s, point[2]))
    above = plus(plus(three.d, times(s, point[1])), times(c, point[2]))
    if kinds[2] == "R":
        f1, f2, f3 = Poly(0.0, along, times(-1.0, aside)), Poly(0.0, aside, along), Poly(above)
    else:
        sine, cosine = known_sincos(three.theta)
        f1 = Poly(plus(times(cosine, along), times(-sine, aside)))
        f2 = Poly(plus(times(sine, along), times(cosine, aside)))
        f3 = Poly(above, 1.0)
    s, c = two.sin_alpha, two.cos_alpha
    h1 = f1.plus(Poly(two.a))
    h2 = f2.times(c).less(f3.times(s))
    h3 = f2.times(s).plus(f3.times(c)).plus(Poly(two.d))
    if kinds[2] == "R":
        size = plus(plus(times(along, along), times(aside, aside)), times(above, above))
        size = plus(plus(size, times(two.a, two.a)), times(two.d, two.d))
        cross = f1.times(times(2.0, two.a)).plus(f2.times(s).plus(f3.times(c)).times(times(2.0, two.d)))
        h_squared = cross.plus(Poly(size))
        across_squared = h_squared.less(h3.square())
    else:
        across_squared = h1.square().plus(h2.square())
        h_squared = across_squared.plus(h3.square())
    return Chain(kinds, links, (h1, h2, h3), h_squared, across_squared)


def regional(
    links: tuple[Link, ...], point: Vector, wanted: Vector, how: str, setting: Setting
) -> tuple[Regional, ...]:
    """Every way to bring a point where it is wanted.

    Args:
        links: The first three, lengths in units of the reach.
        point: Fixed in frame 3 without joint 3's own turn and slide.
        wanted: Where it has to be, seen from frame 0.
        how: How the equation for joint 3 splits, see `arm.rules`: "" where it does not, "meet" where axes
            1 and 2 do, "parallel", "square" where one turns squarely to a slide, "slides".
        setting: Fills what is arbitrary.
    """
    chain = chain_of(links, point)
    eliminate = {"RR": _two_turns, "RP": _turn_slide, "PR": _slide_turn, "PP": _two_slides}
    ways = eliminate[chain.kinds[:2]](chain, wanted, how, setting)
    return tuple(_polished(chain, point, wanted, way, setting) for way in ways)


def _polished(chain: Chain, point: Vector, wanted: Vector, way: Regional, setting: Setting) -> Regional:
    """Newton steps on the joints themselves: the elimination squares lengths, and rounding with them."""
    joints = way.joints
    for _ in range(POLISH):
        steps = _newton(chain.links, joints, point, wanted)
        size = functools.reduce(jnp.maximum, (abs(step) for step in steps))
        # A larger step is not the correction of a small error: it would lead to another branch.
        small = size < jnp.finfo(size.dtype).eps ** 0.25
        steps = tuple(setting.hold(jnp.where(small, step, 0)) for step in steps)
        joints = tuple(map(_moved, joints, steps))
    held = tuple(j if isinstance(j, Slide) else setting.angle(j.sin, j.cos) for j in joints)
    return way._replace(joints=held)


def _newton(links: tuple[Link, ...], joints: Joints, point: Vector, wanted: Vector) -> tuple[Scalar, ...]:
    """How far each joint has to move on, to first order; zero where their motions are dependent."""
    placed_joints = tuple(map(placed, links, joints))
    first, second, third = (
        advance(IDENTITY, link, joint) for link, joint in zip(links, placed_joints, strict=True)
    )
    from_two = _applied(third, point)
    from_one = _applied(second, from_two)
    from_zero = _applied(first, from_one)

    def motion(joint, tip):
        return (0.0, 0.0, 1.0) if isinstance(joint, Slide) else (-tip[1], tip[0], 0.0)

    # All seen from frame 1.
    back = vector.transpose(first.rotation)
    u = vector.rotate(back, motion(joints[0], from_zero))
    v = motion(joints[1], from_one)
    w = vector.rotate(second.rotation, motion(joints[2], from_two))
    gap = vector.rotate(back, vector.subtract(wanted, from_zero))
    vw = vector.cross(v, w)
    weight = safe.divide(1, vector.dot(u, vw))
    across = vector.cross(gap, u)
    return (
        vector.dot(gap, vw) * weight,
        -vector.dot(across, w) * weight,
        vector.dot(across, v) * weight,
    )


def _applied(pose: Pose, point: Vector) -> Vector:
    return vector.add(vector.rotate(pose.rotation, point), pose.position)


def _moved(joint: Angle | Slide, step: Scalar) -> Angle | Slide:
    if isinstance(joint, Slide):
        return Slide(joint.value + step)
    sine, cosine = joint.sin + step * joint.cos, joint.cos - step * joint.sin
    size = safe.reciprocal_sqrt(sine * sine + cosine * cosine)
    return Angle(sine * size, cosine * size, joint.value)


def _two_turns(chain: Chain, wanted: Vector, how: str, setting: Setting):
    one = chain.links[0]
    x, y, z = wanted[0], wanted[1], wanted[2] - one.d
    s, c = one.sin_alpha, one.cos_alpha
    span_squared = x * x + y * y + z * z
    # 2 a1 g1 = ahead and sin(alpha1) g2 = up
    ahead = Poly(plus(span_squared, -times(one.a, one.a))).less(chain.h_squared)
    up = Poly(z).less(chain.h[2].times(c))
    answers = []
    if how == "":
        thirds = _quartic_of_two_turns(chain, ahead, up, setting)
    elif how == "meet":
        thirds = _roots(chain, ahead, setting, safe.sqrt(span_squared))
    else:
        thirds = _roots(chain, up, setting, 1.0)
    for third in thirds:
        h1, h2, h3 = (setting.hold(p.at(third.u, third.v)) for p in chain.h)
        if how == "":
            g1 = safe.divide(ahead.at(third.u, third.v), 2 * one.a)
            g2 = safe.divide(up.at(third.u, third.v), s)
            seconds = [(_turn_between((h1, h2), (g1, g2), setting, 1), jnp.inf, False)]
        elif how == "meet":
            seconds = _turns(h2, h1, up.at(third.u, third.v) / s, setting)
        else:
            seconds = _turns(h1, -h2, ahead.at(third.u, third.v) / (2 * one.a), setting)
        for second, margin, free in seconds:
            g1, g2 = second.cos * h1 - second.sin * h2, second.sin * h1 + second.cos * h2
            arm = (plus(one.a, g1), plus(times(c, g2), times(-s, h3)))
            first = _turn_between(arm, (x, y), setting, 0)
            joints = (first, second, third.joint)
            answers.append(Regional(joints, jnp.minimum(third.margin, margin), free))
    return tuple(answers)


def _quartic_of_two_turns(chain: Chain, ahead: Poly, up: Poly, setting: Setting):
    one = chain.links[0]
    a, s = times(2.0, one.a), one.sin_alpha
    if chain.kinds[2] == "R":
        left = ahead.square().times(times(s, s)).plus(up.square().times(times(a, a)))
        whole = left.less(chain.across_squared.times(times(times(a, a), times(s, s))))
        return _circle_roots(chain, _harmonics(whole), setting)
    square = [0.0] * 5
    for i, p in enumerate((ahead.one, ahead.u, ahead.uu)):
        for j, q in enumerate((ahead.one, ahead.u, ahead.uu)):
            square[i + j] = plus(square[i + j], times(times(s, s), times(p, q)))
    rest = up.square().less(chain.across_squared.times(times(s, s))).times(times(a, a))
    for i, p in enumerate((rest.one, rest.u, rest.uu)):
        square[i] = plus(square[i], p)
    return _circle_roots(chain, _half_angle_harmonics(square), setting)


def _turn_slide(chain: Chain, wanted: Vector, how: str, setting: Setting):
    one, two = chain.links[:2]
    x, y, z = wanted[0], wanted[1], wanted[2] - one.d
    s, c = one.sin_alpha, one.cos_alpha
    sine, cosine = known_sincos(two.theta)
    h1, h2, h3 = chain.h
    g1, g2 = h1.times(cosine).less(h2.times(sine)), h1.times(sine).plus(h2.times(cosine))
    ahead = g1.plus(Poly(one.a))
    around = x * x + y * y
    answers = []
    if how == "square":
        for third in _roots(chain, Poly(z).less(g2.times(s)), setting, 1.0):
            gap = around - ahead.at(third.u, third.v) ** 2
            for side in (1, -1):
                g3 = -s * side * setting.root(gap)
                margin = jnp.minimum(third.margin, safe.sqrt(around) - abs(ahead.at(third.u, third.v)))
                answers.append((third, g3, margin))
    else:
        aside = g2.less(Poly(times(s, z))).times(1 / c)
        square = ahead.square().plus(aside.square()).less(Poly(around))
        for third in _second_degree(chain, square, setting):
            g3 = (z - s * g2.at(third.u, third.v)) / c
            answers.append((third, g3, third.margin))
    ways = []
    for third, g3, margin in answers:
        slide = Slide(g3 - h3.at(third.u, third.v))
        arm = (ahead.at(third.u, third.v), times(c, g2.at(third.u, third.v)) - times(s, g3))
        first = _turn_between(arm, (x, y), setting, 0)
        ways.append(Regional((first, slide, third.joint), margin, False))
    return tuple(ways)


def _slide_turn(chain: Chain, wanted: Vector, how: str, setting: Setting):
    one = chain.links[0]
    s, c = one.sin_alpha, one.cos_alpha
    sine, cosine = known_sincos(one.theta)
    x, y, z = cosine * wanted[0] + sine * wanted[1], cosine * wanted[1] - sine * wanted[0], wanted[2]
    g1 = x - one.a
    h1, h2, h3 = chain.h
    ways = []
    if how == "square":
        thirds = _roots(chain, Poly(y).plus(h3.times(s)), setting, 1.0)
    else:
        g2 = Poly(y).plus(h3.times(s)).times(1 / c)
        square = g2.square().plus(Poly(g1 * g1)).less(chain.across_squared)
        thirds = _second_degree(chain, square, setting)
    for third in thirds:
        at = [p.at(third.u, third.v) for p in (h1, h2, h3)]
        if how == "square":
            seconds = _turns(at[0], -at[1], g1, setting)
        else:
            other = g2.at(third.u, third.v)
            seconds = [(_turn_between((at[0], at[1]), (g1, other), setting, 1), jnp.inf, False)]
        for second, margin, free in seconds:
            along = second.sin * at[0] + second.cos * at[1]
            slide = Slide(z - one.d - (times(s, along) + times(c, at[2])))
            ways.append(Regional((slide, second, third.joint), jnp.minimum(third.margin, margin), free))
    return tuple(ways)


def _two_slides(chain: Chain, wanted: Vector, how: str, setting: Setting):
    one, two = chain.links[:2]
    s, c = one.sin_alpha, one.cos_alpha
    sine, cosine = known_sincos(one.theta)
    x, y, z = cosine * wanted[0] + sine * wanted[1], cosine * wanted[1] - sine * wanted[0], wanted[2]
    sine, cosine = known_sincos(two.theta)
    h1, h2, h3 = chain.h
    g1, g2 = h1.times(cosine).less(h2.times(sine)), h1.times(sine).plus(h2.times(cosine))
    ways = []
    for third in _roots(chain, Poly(x - one.a).less(g1), setting, 1.0):
        across, above = g2.at(third.u, third.v), h3.at(third.u, third.v)
        second = Slide((times(c, across) - y) / s - above)
        first = Slide(z - one.d - (times(s, across) + times(c, above + second.value)))
        ways.append(Regional((first, second, third.joint), third.margin, False))
    return tuple(ways)


def _turn_between(before: tuple[Scalar, Scalar], after: tuple[Scalar, Scalar], setting: Setting, joint: int):
    """The angle that turns one plane vector to another of its length; the joint's own where one is zero."""
    (u, v), (x, y) = before, after
    now = setting.now[joint]
    sine, cosine = u * y - v * x, u * x + v * y
    lost = (u * u + v * v <= setting.tiny**2) | (x * x + y * y <= setting.tiny**2)
    weight = safe.reciprocal_sqrt(sine * sine + cosine * cosine)
    lost |= weight == 0
    return setting.angle(jnp.where(lost, now.sin, sine * weight), jnp.where(lost, now.cos, cosine * weight))


def _turns(a: Scalar, b: Scalar, c: Scalar, setting: Setting):
    """Joint 2 from a cos + b sin = c, both ways."""
    answers = []
    for side in (1, -1):
        root = cosine_sine(a, b, c, side, noise=setting.noise, root=setting.root)
        free = (a * a + b * b <= setting.tiny**2) & (abs(c) <= setting.tiny)
        lost, now = free | root.free, setting.now[1]
        turn = setting.angle(jnp.where(lost, now.sin, root.sin), jnp.where(lost, now.cos, root.cos))
        answers.append((turn, root.margin, free))
    return answers


def _roots(chain: Chain, p: Poly, setting: Setting, length: Scalar) -> list[Third]:
    """Joint 3 from a polynomial of the first degree on the circle, or up to the second in a slide."""
    if chain.kinds[2] == "P":
        return _slides(p, setting)
    thirds = []
    for side in (1, -1):
        root = cosine_sine(p.u, p.v, times(-1.0, p.one), side, noise=setting.noise, root=setting.root)
        turn = setting.angle(
            jnp.where(root.free, setting.now[2].sin, root.sin),
            jnp.where(root.free, setting.now[2].cos, root.cos),
        )
        # Where the equation is one of squared distances, length is the distance.
        margin = root.margin if isinstance(length, float) else root.margin / (1 + length)
        thirds.append(Third(turn, turn.cos, turn.sin, margin))
    return thirds


def _slides(p: Poly, setting: Setting) -> list[Third]:
    """Joint 3 as the roots of a polynomial in a slide: one or two."""
    if isinstance(p.uu, float) and p.uu == 0:
        q = setting.hold(safe.divide(times(-1.0, p.one), p.u))
        return [Third(Slide(q), q, 0.0, jnp.inf)]
    thirds = []
    middle = -p.u / (2 * p.uu)
    gap = middle * middle - p.one / p.uu
    for side in (1, -1):
        q = setting.hold(middle + safe.sign(p.uu) * side * setting.root(gap))
        thirds.append(Third(Slide(q), q, 0.0, safe.sign(gap) * safe.sqrt(abs(gap))))
    return thirds


def _second_degree(chain: Chain, p: Poly, setting: Setting) -> list[Third]:
    return _slides(p, setting) if chain.kinds[2] == "P" else _circle_roots(chain, _harmonics(p), setting)


def _harmonics(p: Poly):
    """A polynomial in (cos, sin) as harmonics."""
    return (
        (p.uu - p.vv) / 2,
        p.uv / 2,
        p.u / 2,
        p.v / 2,
        p.one + (p.uu + p.vv) / 2,
    )


def _half_angle_harmonics(c: list[Scalar]):
    """A quartic in q = tan(t / 2), times cos(t / 2)^4."""
    return (
        (c[0] - c[2] + c[4]) / 8,
        (c[1] - c[3]) / 8,
        (c[0] - c[4]) / 4,
        (c[1] + c[3]) / 8,
        (3 * c[0] + c[2] + 3 * c[4]) / 8,
    )


def _circle_roots(chain: Chain, harmonics, setting: Setting) -> list[Third]:
    harmonics = tuple(jnp.asarray(c) for c in harmonics)
    scale = sum(abs(c) for c in harmonics)
    weight = safe.divide(1, scale)
    harmonics = tuple(setting.keep(c * weight) for c in harmonics)
    found = circle_quartic(harmonics, setting.keep)
    thirds = []
    for root in (found.rising[0], found.falling[0], found.rising[1], found.falling[1]):
        sine, cosine = root.sin, root.cos
        margin = clearance(harmonics, found, root)
        if chain.kinds[2] == "P":
            # tan(t / 2), from the form that does not cancel.
            q = jnp.where(cosine > 0, safe.divide(sine, 1 + cosine), safe.divide(1 - cosine, sine))
            thirds.append(Third(Slide(q), q, 0.0, margin))
            continue
        turn = setting.angle(sine, cosine)
        thirds.append(Third(turn, turn.cos, turn.sin, margin))
    return thirds


def clearance(harmonics, found, root: CircleRoot) -> Scalar:
    """How far the polynomial is from having a double root here: its size between two neighbours."""
    value, _ = harmonics_at(harmonics, root.sin, root.cos)
    return jnp.where(root.real, _between(harmonics, found, root), -abs(value))


def _between(harmonics, found, root: CircleRoot) -> Scalar:
    """The lesser size of the polynomial midway to the real neighbours, which are of the other kind."""
    rises = any(root is r for r in found.rising)
    others, rise = (found.falling, 1) if rises else (found.rising, -1)
    least: Scalar = jnp.inf
    for other in others:
        cosine = root.cos * other.cos + root.sin * other.sin
        sine = root.cos * other.sin - root.sin * other.cos
        half_cos = safe.sqrt((1 + cosine) / 2)
        half_sin = safe.sign(sine) * safe.sqrt((1 - cosine) / 2)
        middle = (
            root.sin * half_cos + root.cos * half_sin,
            root.cos * half_cos - root.sin * half_sin,
        )
        # Between a root where it rises and one where it falls, the sign is known; not so where the
        # short way holds other roots.
        size = rise * safe.sign(sine) * harmonics_at(harmonics, *middle)[0]
        least = jnp.where(other.real & (size >= 0), jnp.minimum(least, size), least)
    return jnp.minimum(least, 1)
