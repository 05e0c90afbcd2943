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

import jax
import jax.numpy as jnp

from ikjax.arm.forward import Link
from ikjax.arm.recognition.signs import PairSplit, ParallelAxesSigns
from ikjax.core import pose as poses
from ikjax.core import safe, vector
from ikjax.core.pose import Pose
from ikjax.core.roots import circle_quartic, cosine_sine
from ikjax.core.trig import Angle, Scalar, SinCos, add_small_angle
from ikjax.core.vector import Vector
from ikjax.core.xla import agreed, pin, pin_all
from ikjax.solvers.context import Branch, Setting
from ikjax.solvers.families.planar import Plane, heading_of, three_joints
from ikjax.solvers.steps.direction import Equation, Pair, Side, about, across_squared, ring_of, settled
from ikjax.solvers.steps.lines import Axis, axes_of, component, pose_turned, seen_from
from ikjax.solvers.steps.regional.third_joint import clearance


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
    wrist = Side(about(six, five), h, vector.subtract(four.point, five.point))
    answers = []
    for pair in _pairs(equations, split, (0, 4), setting):
        a, b, c, free = settled(pair, base, wrist, six, -1, equations[1], ring_of(axes[1:4]), 5, setting)
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
    base = Side(about(two, one), facing, vector.subtract(point, one.point))
    arm = Side(about(two, three), h, vector.subtract(four.point, three.point))
    answers = []
    if b_alone:
        pairs = _b_before_a(first, second, axes, facing, split, setting)
    else:
        pairs = _pairs((first, second), split, (0, 2), setting)
    for pair in pairs:
        a, b, c, free = settled(pair, base, arm, two, 1, second, ring_of(axes[3:]), 1, setting, (one, link))
        rest = pose_turned(two, -c.sin, c.cos, pose_turned(one, -a.sin, a.cos, goal))
        rest = pose_turned(three, -b.sin, b.cos, rest)
        for way in _planar(axes[3:], tip, rest, along, setting, 3):
            joints = (a, c, b, *way.joints)
            answers.append((joints, jnp.minimum(pair.margin, way.margin), pair.free | free | way.continuum))
    return answers


def _b_before_a(
    first: Equation, second: Equation, axes, facing: Vector, split: PairSplit, setting: Setting
) -> list[Pair]:
    """The four pairs where axes 1 and 2 meet or are parallel."""
    one, two, three, four, *_ = axes
    equations = _exchanged(first), _exchanged(second)
    alone, with_a = _separated(*equations)
    # Parallel axes 1 and 2: the first equation has B alone, and their angle to the goal's direction h is that
    # to the arm's, as joint 3 leaves it. Near 0 or 180 degrees its cosine has lost half the digits; its sine
    # has them.
    across = vector.cross(one.along, two.along)
    parallel = vector.dot(across, across) <= setting.zero_tolerance**2
    cosine = vector.dot(facing, two.along)
    to_goal = safe.divide(across_squared(two.along, facing), 1 + abs(cosine))
    sines = [safe.sqrt(across_squared(three.along, v)) for v in (two.along, four.along)]
    cosines = [vector.dot(three.along, v) for v in (two.along, four.along)]
    same = sines[0] * cosines[1] - jnp.where(cosine < 0, -1, 1) * sines[1] * cosines[0]
    to_arm = safe.divide(same * same, 1 + safe.sqrt(1 - same * same))
    alone, with_a = (
        Equation(*(jnp.where(parallel, x, y) for x, y in zip(known, found, strict=True)))
        for known, found in zip(equations, (alone, with_a), strict=True)
    )
    margin = parallel & ((cosine > 0) == (alone.e < 0)), to_goal - to_arm
    pairs = _split_pairs(equations, alone, with_a, split, (2, 0), setting, margin)
    return [pair._replace(first=pair.second, second=pair.first, rise=-pair.rise) for pair in pairs]


def _size(x: Scalar, y: Scalar) -> Scalar:
    return safe.sqrt(x * x + y * y)


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


def _pairs(equations: tuple[Equation, Equation], split: PairSplit, joints, setting: Setting) -> list[Pair]:
    """Joints A and B from their two equations: four pairs."""
    one, two = equations
    if split.is_split:
        return _split_pairs(equations, *_separated(one, two), split, joints, setting)
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
        ascent = rise * jnp.where(determinant < 0, -1, 1)
        pairs.append(Pair(first, second, clearance(harmonics, four, root, length), rise=ascent))
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


def _split_pairs(
    equations: tuple[Equation, Equation],
    alone: Equation,
    with_b: Equation,
    split: PairSplit,
    joints,
    setting: Setting,
    margin: tuple[jax.Array, Scalar] | None = None,
) -> list[Pair]:
    """Joints A and B where B's coefficients are proportional: A from the combination without B, then B.

    Args:
        equations: The two.
        alone, with_b: Their combinations.
        split: How exactly B's coefficients are proportional.
        joints: The numbers of A and B among the joints, from 0.
        setting: Fallback and tolerances.
        margin: Of `alone`, and whether it is known to more digits than its coefficients give.
    """
    noise = setting.length_uncertainty
    if split != PairSplit.EXACTLY:
        # So that the true root lies between the two starts.
        noise = noise + abs(alone.c) + abs(alone.d)
    known_margin, noise_alone = None, noise
    if margin is not None:
        is_known, known_margin = margin
        known_margin = jnp.where(is_known, known_margin, _size(alone.a, alone.b) - abs(alone.e))
        noise_alone = jnp.where(is_known, setting.correction_size, noise)
    pairs = []
    for side in (1, -1):
        root = cosine_sine(alone.a, alone.b, alone.e, side, noise=noise_alone, margin=known_margin)
        first = setting.filled(joints[0], root.free, root.sin, root.cos)
        rest = with_b.e - with_b.a * first.cos - with_b.b * first.sin
        for side_b in (1, -1):
            deep = cosine_sine(with_b.c, with_b.d, rest, side_b, noise=noise)
            second = setting.filled(joints[1], deep.free, deep.sin, deep.cos)
            free = root.free | deep.free
            pair = Pair(first, second, jnp.minimum(root.margin, deep.margin), free, side * side_b)
            if split != PairSplit.EXACTLY:
                ends = (first.sin, first.cos), (second.sin, second.cos)
                turns = _polished(equations, *ends, ~pair.free, setting, STEPS, 0.3)
                pair = pair._replace(first=turns[0], second=turns[1])
            pairs.append(pair)
    return pairs
