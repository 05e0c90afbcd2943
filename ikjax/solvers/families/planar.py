"""Two or three joints that move in one plane, turning or sliding.

Branches: 2, or 1 where two joints slide. Tasks: "planar_pose", "planar_position".

Frames: the plane is square to the turning axes, and its coordinates are taken at DH zero. c1, c2, c3 are the
points where the axes pierce it, u1, u2, u3 the directions of the slides, and the tip is the origin of the
last frame. `signs` says which axes point up from the plane.

Steps:
1. The heading of the goal gives the sum of the angles. If the last joint turns, it also gives the position of
   its axis.
2. Two joints are left: a triangle (RR), a line and a circle (RP, PR), or two slides (PP).
3. The last turning joint from the sum of the angles.

Bit: left or right: the elbow, against the line from joint to joint. Where a joint slides: long or short, the
larger slide first.

Source: Craig, Introduction to Robotics, 3rd ed., equations (4.6)-(4.34), the geometric solution;
`elbow_algebraic` is the algebraic one. The slides are ours.
"""

from typing import NamedTuple

import jax.numpy as jnp

from ikjax.arm.forward import Link
from ikjax.arm.recognition.signs import PlanarPoseSigns, PlanarPositionSigns
from ikjax.core import safe, vector
from ikjax.core.linear import dot
from ikjax.core.pose import Pose
from ikjax.core.trig import Angle, Scalar, SinCos
from ikjax.core.vector import Vector
from ikjax.core.xla import agreed_root, pin
from ikjax.solvers.context import Branch, Joints, Setting, Slide
from ikjax.solvers.steps.lines import Axis, axes_of, turned
from ikjax.solvers.steps.triangle import triangle

Point = tuple[Scalar, Scalar]
TURN_NONE: SinCos = (0.0, 1.0)


class Plane(NamedTuple):
    """Two directions that span it, and the one that is square to both."""

    x: Vector
    y: Vector
    up: Vector

    def point(self, v: Vector) -> Point:
        """The coordinates of a vector in the plane."""
        return vector.dot(self.x, v), vector.dot(self.y, v)


class Way(NamedTuple):
    """One answer."""

    joints: Joints
    margin: Scalar
    continuum: Scalar


def plane_of(kinds: str, axes: tuple[Axis, ...]) -> Plane:
    """The plane that the turning axes pierce; its x is x of frame 0, or the first slide."""
    up = axes[kinds.index("R")].along if "R" in kinds else vector.cross(axes[0].along, axes[1].along)
    x = (1.0, 0.0, 0.0) if kinds[0] == "R" else axes[0].along
    return Plane(x, vector.cross(up, x), up)


def branches(
    signs: PlanarPoseSigns | PlanarPositionSigns, links: tuple[Link, ...], goal: Pose, setting: Setting
) -> tuple[Branch, ...]:
    """All slots for one goal.

    Arguments as in `pieper`.
    """
    kinds = "".join(link.kind for link in links)
    axes, tip = axes_of(links)
    plane = plane_of(kinds, axes)
    where = plane.point(goal.position)
    if len(kinds) == 2:
        at = vector.add(tip.position, vector.rotate(tip.rotation, setting.tool_point))
        ways = two_joints(kinds, axes, plane, signs, where, plane.point(at), setting)
    else:
        heading = heading_of(plane, tip, goal)
        ways = three_joints(kinds, axes, plane, signs, heading, where, plane.point(tip.position), setting)
    # The goal projected onto what the task controls: the rest is not measured.
    level = tip.position
    asked = goal
    if len(kinds) == 2:
        level = at
    else:
        columns = (turned(plane.up, *heading, column) for column in vector.transpose(tip.rotation))
        asked = Pose(vector.transpose(tuple(columns)), goal.position)
    off = vector.dot(plane.up, vector.subtract(level, goal.position))
    asked = asked._replace(position=vector.add(goal.position, vector.scale(off, plane.up)))
    return tuple(Branch(way.joints, asked, way.margin, way.continuum) for way in ways)


def heading_of(plane: Plane, tip: Pose, goal: Pose) -> SinCos:
    """The turn within the plane that comes nearest to turning the tip at DH zero into the goal."""
    columns = list(zip(vector.transpose(tip.rotation), vector.transpose(goal.rotation), strict=True))
    sine = cosine = 0.0
    for before, after in columns:
        (a, b), (c, d) = plane.point(before), plane.point(after)
        cosine, sine = cosine + (a * c + b * d), sine + (a * d - b * c)
    weight = safe.reciprocal_sqrt(sine * sine + cosine * cosine)
    return sine * weight, jnp.where(weight == 0, 1, cosine * weight)


def three_joints(kinds, axes, plane, signs, heading, where, tip, setting) -> tuple[Way, ...]:
    """The slots of three joints.

    Args:
        kinds, axes, plane, signs: The arm.
        heading: Sine and cosine of the sum of the angles.
        where: The goal of the tip.
        tip: The tip at DH zero.
        setting: Fallback and tolerances.
    """
    c = [plane.point(axis.point) for axis in axes]
    u = [plane.point(axis.along) for axis in axes]
    if kinds.count("P") >= 2:
        return _two_slides(kinds, c, u, signs, heading, where, tip, setting)
    if kinds == "RRP":
        return _slide_last(c, u[2], signs, heading, where, tip, setting)
    # The last joint turns: the position of its axis is known.
    wrist = _minus(where, _turned(heading, _minus(tip, c[2])))
    ways = two_joints(kinds[:2], axes, plane, signs, wrist, c[2], setting)
    answers = []
    for way in ways:
        whole = TURN_NONE
        for kind, sign, joint in zip(kinds[:2], signs, way.joints, strict=False):
            if kind == "R":
                whole = _sum(whole, (sign * joint.sin, joint.cos))
        last = _sum(heading, (-whole[0], whole[1]))
        joints = (*way.joints, setting.angle(signs[2] * last[0], last[1]))
        answers.append(way._replace(joints=joints))
    return tuple(answers)


def two_joints(kinds, axes, plane, signs, where, tip, setting) -> tuple[Way, ...]:
    """The slots of two joints that bring the tip where it is wanted; arguments as in `three_joints`."""
    c = [plane.point(axis.point) for axis in axes]
    u = [plane.point(axis.along) for axis in axes]
    if kinds == "RR":
        return _two_turns(c, signs, where, tip, setting)
    if kinds == "PP":
        first, second = _components(_minus(where, tip), u[0], u[1])
        return (Way((Slide(first), Slide(second)), jnp.inf, False),)
    if kinds == "RP":
        return _turn_slide(c[0], u[1], signs[0], where, tip, setting)
    return _slide_turn(c[1], u[0], signs[1], where, tip, setting)


def _two_turns(c, signs, where, tip, setting) -> tuple[Way, ...]:
    first, second = _minus(c[1], c[0]), _minus(tip, c[1])
    upper, fore = safe.norm(*first), safe.norm(*second)
    x, y = _minus(where, c[0])
    fallback = setting.fallback[0]
    start = (safe.divide(first[1], upper), safe.divide(first[0], upper))
    filled = Angle(*_sum((signs[0] * fallback.sin, fallback.cos), start), 0.0)
    ways = []
    for left in (1, -1):
        arm = triangle(x, y, upper, fore, left, setting, fallback=filled)
        t1 = _sum((arm.shoulder_sin, arm.shoulder_cos), (-start[0], start[1]))
        bend = (safe.divide(second[1], fore), safe.divide(second[0], fore))
        t2 = _sum(_sum((arm.elbow_sin, arm.elbow_cos), start), (-bend[0], bend[1]))
        joints = tuple(setting.angle(s * t[0], t[1]) for s, t in zip(signs, (t1, t2), strict=False))
        ways.append(Way(joints, arm.margin, arm.continuum))
    return tuple(ways)


def elbow_algebraic(x: Scalar, y: Scalar, upper: Scalar, fore: Scalar, left: int) -> tuple[SinCos, SinCos]:
    """The same triangle by algebra: (sin, cos) of the shoulder and of the elbow.

    Source: Craig, Introduction to Robotics, 3rd ed., equations (4.14)-(4.27).
    """
    cosine = (x * x + y * y - upper * upper - fore * fore) * safe.divide(1, 2 * upper * fore)
    cosine = jnp.clip(cosine, -1, 1)
    sine = -left * safe.sqrt(1 - cosine * cosine)
    k1, k2 = upper + fore * cosine, fore * sine
    weight = safe.reciprocal_sqrt((x * x + y * y) * (k1 * k1 + k2 * k2))
    shoulder = (y * k1 - x * k2) * weight, (x * k1 + y * k2) * weight
    return shoulder, (sine, cosine)


def _turn_slide(c, u, sign, where, tip, setting) -> tuple[Way, ...]:
    """Turn about c, then slide along u: the slide gives the distance from c, the turn the direction."""
    arm, gap = _minus(tip, c), _minus(where, c)
    along, beside = dot(arm, u), _cross(u, arm)
    far_squared = dot(gap, gap)
    root = agreed_root(far_squared - beside * beside)
    margin = safe.sqrt(far_squared) - abs(beside)
    ways = []
    for side in (1, -1):
        q = pin(side * root - along)
        turn, free = setting.between(0, (arm[0] + u[0] * q, arm[1] + u[1] * q), gap, sign)
        ways.append(Way((turn, Slide(q)), margin, free))
    return tuple(ways)


def _slide_turn(c, u, sign, where, tip, setting) -> tuple[Way, ...]:
    """Slide along u, then turn about c, which slides with it: a line meets a circle."""
    arm, gap = _minus(tip, c), _minus(where, c)
    ways = []
    for q, margin in _line_and_circle(u, gap, dot(arm, arm), setting):
        turn, free = setting.between(1, arm, (gap[0] - u[0] * q, gap[1] - u[1] * q), sign)
        ways.append(Way((Slide(q), turn), margin, free))
    return tuple(ways)


def _slide_last(c, u, signs, heading, where, tip, setting) -> tuple[Way, ...]:
    """Two turns, then a slide: its direction is the goal's, so a line meets the first link's circle."""
    link = _minus(c[1], c[0])
    gap = _minus(_minus(where, _turned(heading, _minus(tip, c[1]))), c[0])
    u = _turned(heading, u)
    ways = []
    for q, margin in _line_and_circle(u, gap, dot(link, link), setting):
        first, free = setting.between(0, link, (gap[0] - u[0] * q, gap[1] - u[1] * q), signs[0])
        rest = _sum(heading, (-signs[0] * first.sin, first.cos))
        ways.append(Way((first, setting.angle(signs[1] * rest[0], rest[1]), Slide(q)), margin, free))
    return tuple(ways)


def _line_and_circle(u, gap, radius_squared, setting):
    """q with |gap - u q| = radius, the larger first, and how far the line is inside the circle."""
    beside = _cross(u, gap)
    root = agreed_root(radius_squared - beside * beside)
    margin = safe.sqrt(radius_squared) - abs(beside)
    return [(pin(dot(gap, u) + side * root), margin) for side in (1, -1)]


def _two_slides(kinds, c, u, signs, heading, where, tip, setting) -> tuple[Way, ...]:
    """One turn, which is the heading, and two slides."""
    k = kinds.index("R")
    turn = setting.angle(signs[k] * heading[0], heading[1])
    gap = _minus(_minus(where, _turned(heading, _minus(tip, c[k]))), c[k])
    # Slides beyond the turn are turned with it.
    slides = [u[i] if i < k else _turned(heading, u[i]) for i in range(3) if i != k]
    joints = [Slide(q) for q in _components(gap, *slides)]
    joints.insert(k, turn)
    return (Way(tuple(joints), abs(_cross(*slides)), False),)


def _components(gap: Point, u: Point, v: Point) -> Point:
    """(p, q) with gap = p u + q v, by Cramer's rule."""
    weight = safe.divide(1, _cross(u, v))
    return _cross(gap, v) * weight, _cross(u, gap) * weight


def _minus(u: Point, v: Point) -> Point:
    return u[0] - v[0], u[1] - v[1]


def _cross(u: Point, v: Point) -> Scalar:
    return u[0] * v[1] - u[1] * v[0]


def _turned(by: SinCos, v: Point) -> Point:
    return by[1] * v[0] - by[0] * v[1], by[0] * v[0] + by[1] * v[1]


def _sum(first: SinCos, second: SinCos) -> SinCos:
    return (
        first[0] * second[1] + first[1] * second[0],
        first[1] * second[1] - first[0] * second[0],
    )
