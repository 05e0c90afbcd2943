"""Six turning joints, three consecutive axes of which are parallel; the others have any direction.

Branches: 8.

Frames: axes at DH zero, seen from frame 0. h is the direction of the parallel axes. The kernel solves for
parallel axes 2, 3, 4 or 4, 5, 6; an arm with 3, 4, 5 or 1, 2, 3 is read from the tool to the base.

Steps:
1. Two facts do not depend on the parallel joints: how far along h the hand is, and the angle of an axis to h
   (of axis 6 for 2, 3, 4; of axis 2 for 4, 5, 6). Both are linear in the cosines and sines of two
   other joints, A and B. Solved for the cosine and sine of B, whose squares add up to one, they give a
   quartic in A. Where the arm's own numbers do not allow that (`PairSplit`), a combination of the two has A
   alone, and then the other gives B. Where axes 1 and 2 meet or are parallel (4, 5, 6 parallel), B is alone
   and gives A.
2. The last joint that is not parallel, C, turns one known direction to another.
3. planar: the three parallel joints, two answers.

Bits:
1. left or right: the elbow of the parallel joints.
2. rising or falling: the sign of the quartic's derivative at the root for A. If the equations split: b+ or
   b-, the sign of the derivative of the equation for B.
3. low or high: the order of the two such roots from -pi. If the equations split: a+ or a-, the sign of the
   derivative of the equation for A. Where B is alone, the second and the third change places.

Source: three parallel axes are Pieper's second case (1968); the elimination is that of subproblem 6 of
Elias and Wen, IK-Geo (2022), in circle form.
"""

import functools
import itertools
from typing import NamedTuple

import jax
import jax.numpy as jnp

from ikjax.arm.forward import Link
from ikjax.arm.recognition.signs import PairSplit, ParallelAxesSigns
from ikjax.core import pose as poses
from ikjax.core import safe, vector
from ikjax.core.linear import damped_steps
from ikjax.core.pose import Pose
from ikjax.core.roots import circle_quartic, cosine_sine
from ikjax.core.trig import Angle, Scalar, SinCos, add_small_angle
from ikjax.core.vector import Vector
from ikjax.core.xla import agreed, pin, pin_all
from ikjax.solvers.context import Branch, Setting
from ikjax.solvers.families.planar import Plane, heading_of, three_joints
from ikjax.solvers.steps.lines import Axis, axes_of, component, pose_turned, seen_from, turned
from ikjax.solvers.steps.regional.third_joint import clearance
from ikjax.solvers.steps.triangle import ring


class Equation(NamedTuple):
    """a cos(A) + b sin(A) + c cos(B) + d sin(B) = e"""

    a: Scalar
    b: Scalar
    c: Scalar
    d: Scalar
    e: Scalar


class Pair(NamedTuple):
    """Joints A and B."""

    first: Angle
    second: Angle
    margin: Scalar
    free: Scalar = False
    """Whether one of them is arbitrary."""


def branches(
    signs: ParallelAxesSigns, links: tuple[Link, ...], goal: Pose, setting: Setting
) -> tuple[Branch, ...]:
    """All eight slots for one goal.

    Arguments as in `pieper`.
    """
    place, split, b_alone, *along = signs
    axes, tip = axes_of(links)
    solve = _inner if place in (2, 3) else functools.partial(_last, b_alone)
    if place in (2, 4):
        ways = solve(axes, tip, goal, split, along, setting)
        return tuple(Branch(joints, goal, margin, free) for joints, margin, free in ways)
    # The inverse of a product of rotations about axes is the product, in the other order, of the inverse
    # rotations about the same axes, seen from the tip.
    back = tuple(seen_from(tip, axis) for axis in axes[::-1])
    fallback = tuple(Angle(-j.sin, j.cos, -j.value) for j in setting.fallback[::-1])
    setting = setting._replace(fallback=fallback)
    along = [sign * along[-1] for sign in along[::-1]]
    ways = solve(back, poses.inverse(tip), poses.inverse(goal), split, along, setting)
    slots = []
    for joints, margin, free in ways:
        turned_back = tuple(Angle(-j.sin, j.cos, -j.value) for j in joints[::-1])
        slots.append(Branch(turned_back, goal, margin, free))
    return tuple(slots)


def _inner(axes, tip: Pose, goal: Pose, split: PairSplit, along, setting: Setting):
    """Axes 2, 3, 4 parallel: A = 1, B = 5, C = 6."""
    one, two, _, four, five, six = axes
    h = two.along
    change = vector.matmul(goal.rotation, vector.transpose(tip.rotation))
    last = vector.rotate(change, six.along)
    point = vector.add(goal.position, vector.rotate(change, vector.subtract(six.point, tip.position)))
    equations = (
        _facing(h, one, five, last, six.along, 0.0),
        _facing(
            h,
            one,
            five,
            vector.subtract(point, one.point),
            vector.subtract(six.point, five.point),
            vector.dot(h, vector.subtract(five.point, one.point)),
        ),
    )
    # Both sides seen from the wrist at DH zero, where joint 6 turns backwards what joint 5 turned.
    back = vector.transpose(change)
    base = Side(
        Axis(vector.rotate(back, one.along), vector.rotate(back, vector.subtract(one.point, point))),
        vector.rotate(back, h),
        vector.rotate(back, vector.subtract(two.point, one.point)),
    )
    wrist = Side(_about(six, five), h, vector.subtract(four.point, five.point))
    answers = []
    for pair in _pairs(equations, split, (0, 4), setting):
        a, b, c, free = _settled(pair, base, wrist, six, -1, equations[1], _ring(axes[1:4]), 5, setting)
        # The parallel joints have to move `hand` to `rest`.
        rest = pose_turned(one, -a.sin, a.cos, goal)
        hand = pose_turned(five, b.sin, b.cos, pose_turned(six, c.sin, c.cos, tip))
        for way in _planar(axes[1:4], hand, rest, along, setting, 1):
            joints = (a, *way.joints, b, c)
            answers.append((joints, jnp.minimum(pair.margin, way.margin), pair.free | free | way.continuum))
    return answers


def _last(b_alone: bool, axes, tip: Pose, goal: Pose, split: PairSplit, along, setting: Setting):
    """Axes 4, 5, 6 parallel: A = 1, B = 3, C = 2."""
    one, two, three, four, _, six = axes
    h = four.along
    change = vector.matmul(goal.rotation, vector.transpose(tip.rotation))
    facing = vector.rotate(change, h)
    point = vector.add(goal.position, vector.rotate(change, vector.subtract(six.point, tip.position)))
    height = vector.dot(facing, vector.subtract(point, one.point)) - vector.dot(
        h, vector.subtract(six.point, three.point)
    )
    # The direction h as the goal has it, turned back by joint 1, against axis 2 ...
    a, b, rest = component(facing, one.along, two.along)
    c, d, other = component(two.along, three.along, h)
    first = Equation(a, b, -c, -d, other - rest)
    # ... and the height along it of a point on axis 3.
    link, fore = vector.subtract(two.point, one.point), vector.subtract(three.point, two.point)
    a, b, rest = component(facing, one.along, link)
    c, d, other = component(fore, three.along, h)
    second = Equation(a, b, c, d, height - rest - other)
    base = Side(_about(two, one), facing, vector.subtract(point, one.point))
    arm = Side(_about(two, three), h, vector.subtract(four.point, three.point))
    answers = []
    equations, joints = (first, second), (0, 2)
    if b_alone:
        equations, joints = (_exchanged(first), _exchanged(second)), joints[::-1]
    for pair in _pairs(equations, split, joints, setting):
        if b_alone:
            pair = pair._replace(first=pair.second, second=pair.first)
        a, b, c, free = _settled(pair, base, arm, two, 1, second, _ring(axes[3:]), 1, setting)
        rest = pose_turned(two, -c.sin, c.cos, pose_turned(one, -a.sin, a.cos, goal))
        rest = pose_turned(three, -b.sin, b.cos, rest)
        for way in _planar(axes[3:], tip, rest, along, setting, 3):
            joints = (a, c, b, *way.joints)
            answers.append((joints, jnp.minimum(pair.margin, way.margin), pair.free | free | way.continuum))
    return answers


def _exchanged(equation: Equation) -> Equation:
    """The equation with A and B exchanged."""
    a, b, c, d, e = equation
    return Equation(c, d, a, b, e)


def _facing(h: Vector, one: Axis, five: Axis, far: Vector, near: Vector, gap: Scalar) -> Equation:
    """h . (far turned back by joint 1) = h . (near turned by joint 5) + gap"""
    a, b, rest = component(h, one.along, far)
    c, d, other = component(h, five.along, near)
    return Equation(a, -b, -c, -d, other + gap - rest)


def _planar(axes, tip: Pose, goal: Pose, along, setting: Setting, first: int):
    up = axes[0].along
    # Any direction square to the axes will do; that to the next axis is never zero.
    x = vector.subtract(axes[1].point, axes[0].point)
    x = vector.subtract(x, vector.scale(vector.dot(up, x), up))
    x = vector.scale(safe.reciprocal_sqrt(vector.dot(x, x)), x)
    plane = Plane(x, vector.cross(up, x), up)
    return three_joints(
        "RRR",
        axes,
        plane,
        tuple(along),
        heading_of(plane, tip, goal),
        plane.point(goal.position),
        plane.point(tip.position),
        setting._replace(fallback=setting.fallback[first : first + 3]),
    )


DIRECTION_STEPS = 2
"""Steps on the direction itself. Of 10,000 goals with the direction 1e-9 to 0.1 rad off axis C, 336 went
unanswered after one step and 270 after two (a scratch arm of right angles)."""


class Side(NamedTuple):
    """What one of joints A and B turns: the direction of the parallel axes, and a point of one of them."""

    axis: Axis
    """Of the joint; its point is seen from a point of axis C."""
    direction: Vector
    point: Vector
    """Seen from the point of the axis."""

    def turned(self, joint: Angle, sense: int) -> tuple[Vector, Vector, Vector]:
        """The direction, its derivative by the joint, and the point seen from a point of axis C."""
        sine, along = sense * joint.sin, self.axis.along
        direction = turned(along, sine, joint.cos, self.direction)
        point = vector.add(self.axis.point, turned(along, sine, joint.cos, self.point))
        return direction, vector.scale(sense, vector.cross(along, direction)), point


def _about(c: Axis, axis: Axis) -> Axis:
    """An axis, its point seen from that of axis C."""
    return axis._replace(point=vector.subtract(axis.point, c.point))


def _ring(axes: tuple[Axis, ...]) -> tuple[Scalar, Scalar]:
    """Least and greatest distance of the first of three parallel axes from the last."""
    up = axes[0].along
    links = (vector.subtract(b.point, a.point) for a, b in itertools.pairwise(axes))
    return ring(*(vector.norm(vector.cross(up, link)) for link in links))


def _settled(
    pair: Pair,
    base: Side,
    hand: Side,
    axis: Axis,
    sense: int,
    height: Equation,
    span: tuple[Scalar, Scalar],
    joint: int,
    setting: Setting,
) -> tuple[Angle, Angle, Angle, jax.Array]:
    """Joint C, and A and B after a step of damped least squares.

    A and B come from an angle to the parallel axes by its cosine, which near 0 and 180 degrees loses half the
    digits. The step is on the direction itself, as C turns it. Where that is along axis C, joint C is
    arbitrary; it then stays where it was as far as the parallel joints reach.

    Args:
        pair: Joints A and B.
        base: What A turns, against the sense.
        hand: What B turns.
        axis: The axis of C, which turns the direction of `hand` to that of `base`.
        sense: 1 or -1: which way B and C turn it.
        height: How far along the parallel axes the hand is.
        span: Least and greatest distance of the points of `base` and `hand`.
        joint: The number of C among the joints, from 0.
        setting: Fallback and tolerances.

    Returns:
        The three joints, and whether C is arbitrary.
    """
    a, b = pair.first, pair.second
    for _ in range(DIRECTION_STEPS):
        wanted, by_a, _ = base.turned(a, -sense)
        given, by_b, _ = hand.turned(b, sense)
        c, _ = _turn_to(axis, given, wanted, joint, sense, setting)
        turn = functools.partial(turned, axis.along, sense * c.sin, c.cos)
        columns = (
            (*vector.scale(-1, by_a), height.b * a.cos - height.a * a.sin),
            (*turn(by_b), height.d * b.cos - height.c * b.sin),
        )
        rest = height.e - height.a * a.cos - height.b * a.sin - height.c * b.cos - height.d * b.sin
        gap = (*vector.subtract(wanted, turn(given)), rest)
        steps = damped_steps(columns, gap, setting.zero_tolerance / 4)
        small = functools.reduce(jnp.maximum, map(abs, steps)) < setting.rounding**0.25
        a, b = (
            setting.angle(*add_small_angle(x.sin, x.cos, pin(jnp.where(small, step, 0))))
            for x, step in zip((a, b), steps, strict=True)
        )
    wanted, _, target = base.turned(a, -sense)
    given, _, start = hand.turned(b, sense)
    c, free = _turn_to(axis, given, wanted, joint, sense, setting)
    filled = _closing(axis, sense, start, target, span, setting.fallback[joint])
    c = setting.angle(jnp.where(free, filled[0], c.sin), jnp.where(free, filled[1], c.cos))
    return a, b, c, free


def _turn_to(axis: Axis, before: Vector, after: Vector, joint: int, sense: int, setting: Setting):
    """The joint that turns one direction to another about its axis, and whether it is arbitrary."""
    cosine, sine, _ = component(after, axis.along, before)
    free = _across_squared(axis.along, after) <= setting.zero_tolerance**2
    weight = safe.reciprocal_sqrt(sine * sine + cosine * cosine)
    return setting.filled(joint, free | (weight == 0), sense * sine * weight, cosine * weight), free


def _closing(axis: Axis, sense: int, start: Vector, target: Vector, span, fallback: Angle) -> SinCos:
    """The turn nearest to the fallback that brings the start within the span of the target.

    Both are seen along the axis: their distance squared is p^2 + q^2 - 2 p q cos(angle between them).
    """
    cosine, sine, _ = component(target, axis.along, start)
    size = safe.sqrt(cosine * cosine + sine * sine)
    # The angle from the start at the fallback to the target, by its cosine and sine times `size`.
    ahead = cosine * fallback.cos + sense * sine * fallback.sin
    aside = sense * sine * fallback.cos - cosine * fallback.sin
    squares = sum(_across_squared(axis.along, v) for v in (start, target))
    low, high = span
    wanted = jnp.clip(ahead, (squares - high * high) / 2, (squares - low * low) / 2)
    kept = wanted == ahead
    wanted = jnp.clip(wanted, -size, size)
    beside = jnp.where(aside < 0, -1, 1) * safe.sqrt((size - wanted) * (size + wanted))
    # The turn is the angle to the target, less the angle that is left.
    weight = safe.divide(1, size * size)
    new_sin = (sense * sine * wanted - cosine * beside) * weight
    new_cos = (cosine * wanted + sense * sine * beside) * weight
    kept |= size == 0
    return jnp.where(kept, fallback.sin, new_sin), jnp.where(kept, fallback.cos, new_cos)


def _across_squared(along: Vector, v: Vector) -> Scalar:
    across = vector.cross(along, v)
    return vector.dot(across, across)


def _pairs(equations: tuple[Equation, Equation], split: PairSplit, joints, setting: Setting) -> list[Pair]:
    """Joints A and B from their two equations: four pairs."""
    one, two = equations
    if split.is_split:
        return _split_pairs(one, two, split, joints, setting)
    determinant = one.c * two.d - one.d * two.c
    weight = safe.divide(1, determinant)

    def solved(u, v):
        return (u * two.d - v * one.d) * weight, (v * one.c - u * two.c) * weight

    rows = [solved(u, v) for u, v in zip(one, two, strict=True)]
    (ac, as_), (bc, bs), _, _, (ec, es) = rows
    # cos(B) = ec - ac cos(A) - bc sin(A), and sin(B) likewise; their squares add up to one.
    cos_squared, mixed, sin_squared = ac * ac + as_ * as_, ac * bc + as_ * bs, bc * bc + bs * bs
    harmonics = (
        (cos_squared - sin_squared) / 2,
        mixed,
        -(ac * ec + as_ * es),
        -(bc * ec + bs * es),
        ec * ec + es * es - 1 + (cos_squared + sin_squared) / 2,
    )
    scale = safe.divide(1, sum(abs(x) for x in harmonics))
    harmonics = tuple(agreed(x * scale) for x in harmonics)
    four = circle_quartic(harmonics)

    def length(value, sine, cosine):
        # The derivative of the polynomial with respect to the goal's position along h, which is on the right
        # side of the second equation with the factor one.
        cos_b, sin_b = ec - ac * cosine - bc * sine, es - as_ * cosine - bs * sine
        derivative = 2 * scale * abs(weight * (one.c * sin_b - one.d * cos_b))
        return value / jnp.maximum(derivative, setting.zero_tolerance)

    pairs = []
    in_order = (four.rising[0], four.falling[0], four.rising[1], four.falling[1])
    for root, rise in zip(in_order, (1, -1, 1, -1), strict=True):
        cosine, sine = ec - ac * root.cos - bc * root.sin, es - as_ * root.cos - bs * root.sin
        size = safe.reciprocal_sqrt(cosine * cosine + sine * sine)
        turn = pin(sine * size), pin(jnp.where(size == 0, 1, cosine * size))
        start, real, steps, largest = (root.sin, root.cos), root.real, 1, setting.rounding**0.25
        if setting.close_pairs(split):
            turn = _side_of_close_pair(equations, start, rise, setting)
            # A pair that came out as complex may be real but for rounding; then its roots are nearby.
            steps, largest, real = 4, jnp.where(root.real, 0.3, 4 * largest), True
        first, second = _polished(equations, start, turn, real, setting, steps, largest)
        pairs.append(Pair(first, second, clearance(harmonics, four, root, length)))
    return pairs


def _separated(one: Equation, two: Equation) -> tuple[Equation, Equation]:
    """The two combinations, of weights of norm one, with the least and with the most of joint B."""
    size_one, size_two = one.c * one.c + one.d * one.d, two.c * two.c + two.d * two.d
    both = one.c * two.c + one.d * two.d
    weight = safe.reciprocal_sqrt(size_one * size_one + both * both)
    other = safe.reciprocal_sqrt(size_two * size_two + both * both)
    # (p, q) is along the ratio of the two rows, computed from the larger one.
    larger, smaller = (size_one * weight, both * weight), (both * other, size_two * other)
    if isinstance(size_one, float) and isinstance(size_two, float):
        p, q = larger if size_one >= size_two else smaller
    else:
        p, q = (jnp.where(size_one >= size_two, a, b) for a, b in zip(larger, smaller, strict=True))
    alone = Equation(*(v * p - u * q for u, v in zip(one, two, strict=True)))
    with_b = Equation(*(u * p + v * q for u, v in zip(one, two, strict=True)))
    return alone, with_b


def _side_of_close_pair(equations, first: SinCos, rise: int, setting: Setting) -> SinCos:
    """Joint B at a root for A of equations that nearly split.

    The part of B in `alone` is a small factor times the height of B (the derivative of `with_b`), so the
    roots for A come in close pairs, one with each sign of the height. Where rounding hides the sign, it
    follows from which of the two roots is rising.
    """
    alone, with_b = _separated(*equations)
    sine, cosine = first
    value = alone.e - alone.a * cosine - alone.b * sine
    derivative = alone.a * sine - alone.b * cosine
    factor = with_b.c * alone.d - with_b.d * alone.c
    noise = 4 * setting.rounding**0.5
    turned = jnp.where(factor > 0, -1, 1).astype(value.dtype)
    side = jnp.where(abs(value) > noise, safe.sign(value), rise * safe.sign(derivative)) * turned
    rest = with_b.e - with_b.a * cosine - with_b.b * sine
    root = cosine_sine(with_b.c, with_b.d, rest, side, noise=setting.length_uncertainty)
    return pin(root.sin), pin(root.cos)


def _polished(
    equations, first: SinCos, second: SinCos, real, setting: Setting, steps: int, largest: Scalar
) -> tuple[Angle, Angle]:
    """A and B after Newton steps on their equations: the quartic squares these, and rounding with them.

    Args:
        equations: The two.
        first, second: A and B.
        real: Whether there is a root to go to.
        setting: Pins values.
        steps: How many steps.
        largest: The largest step that is taken [rad]: a larger one is not the correction of a small error,
            and would lead to another branch.
    """
    for _ in range(steps):
        rows = []
        for a, b, c, d, e in equations:
            gap = e - a * first[1] - b * first[0] - c * second[1] - d * second[0]
            rows.append((b * first[1] - a * first[0], d * second[1] - c * second[0], gap))
        (p, q, gap), (r, s, other) = rows
        weight = safe.divide(1, p * s - q * r)
        moves = (gap * s - other * q) * weight, (other * p - gap * r) * weight
        small = real & (jnp.maximum(*map(abs, moves)) < largest)
        moved = [
            add_small_angle(*joint, jnp.where(small, move, 0))
            for joint, move in zip((first, second), moves, strict=True)
        ]
        first, second = (pin_all(joint) for joint in moved)
    a, b = (setting.angle(*joint) for joint in (first, second))
    return a, b


STEPS = 8
"""Newton steps where the equations split within 1e-5. At a fold a step only halves the error, and there 1e-5
moves the joints by its square root."""


def _split_pairs(one: Equation, two: Equation, split: PairSplit, joints, setting: Setting) -> list[Pair]:
    """Joints A and B where B's coefficients are proportional: A from the combination without B, then B."""
    alone, with_b = _separated(one, two)
    noise = setting.length_uncertainty
    if split != PairSplit.EXACTLY:
        # So that the true root lies between the two starts.
        noise = noise + abs(alone.c) + abs(alone.d)
    pairs = []
    for side in (1, -1):
        root = cosine_sine(alone.a, alone.b, alone.e, side, noise=noise)
        first = setting.filled(joints[0], root.free, root.sin, root.cos)
        rest = with_b.e - with_b.a * first.cos - with_b.b * first.sin
        for side_b in (1, -1):
            deep = cosine_sine(with_b.c, with_b.d, rest, side_b, noise=noise)
            second = setting.filled(joints[1], deep.free, deep.sin, deep.cos)
            pair = Pair(first, second, jnp.minimum(root.margin, deep.margin), root.free | deep.free)
            if split != PairSplit.EXACTLY:
                ends = (first.sin, first.cos), (second.sin, second.cos)
                turns = _polished((one, two), *ends, ~pair.free, setting, STEPS, 0.3)
                pair = pair._replace(first=turns[0], second=turns[1])
            pairs.append(pair)
    return pairs
