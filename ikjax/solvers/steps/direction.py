"""The direction of three parallel axes, as joints A, B and C turn it to where the goal has it.

A and B come from an angle of that direction and a height along it (`families.parallel_axes`); here their
rounding is mended, C follows, and joints that the direction leaves arbitrary go where the parallel joints
reach.

Source: damped least squares: Levenberg (1944); the root of the osculating parabola is Euler's method: Traub,
Iterative Methods for the Solution of Equations (1964), section 5.21.
"""

import functools
import itertools
from typing import NamedTuple

import jax
import jax.numpy as jnp

from ikjax.core import safe, vector
from ikjax.core.linear import damped_steps
from ikjax.core.trig import Angle, Scalar, SinCos, add_small_angle
from ikjax.core.vector import Vector
from ikjax.core.xla import pin, pin_all
from ikjax.solvers.context import Setting
from ikjax.solvers.steps.lines import Axis, component, turned
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
    rise: Scalar = 1
    """The sign of the first equation's derivative along the line where the second one holds: B moves along it
    by the second's derivative with respect to A, A by that with respect to B, with the other sign."""


DIRECTION_STEPS = 2
"""Of 4,096 goals of an arm of right angles, all joints at multiples of a right angle, 106 were lost with one
step and 21 with two."""


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


def about(c: Axis, axis: Axis) -> Axis:
    """An axis, its point seen from that of axis C."""
    return axis._replace(point=vector.subtract(axis.point, c.point))


def ring_of(axes: tuple[Axis, ...]) -> tuple[Scalar, Scalar]:
    """Least and greatest distance of the first of three parallel axes from the last."""
    up = axes[0].along
    links = (vector.subtract(b.point, a.point) for a, b in itertools.pairwise(axes))
    return ring(*(vector.norm(vector.cross(up, link)) for link in links))


def settled(
    pair: Pair,
    base: Side,
    hand: Side,
    axis: Axis,
    sense: int,
    height: Equation,
    span: tuple[Scalar, Scalar],
    joint: int,
    setting: Setting,
    reach: tuple[Axis, Vector] | None = None,
) -> tuple[Angle, Angle, Angle, jax.Array]:
    """Joint C, and A and B after steps that mend their rounding.

    A and B come from an angle to the parallel axes by its cosine, which near 0 and 180 degrees loses half the
    digits. The steps are on the direction itself. Where that is along axis C, joint C is arbitrary, and along
    axis A joint A; such a joint stays where it was as far as the parallel joints reach.

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
        reach: Where joint A can be arbitrary too: its axis, and the point of axis C seen from a point of it.

    Returns:
        The three joints, and whether one of them is arbitrary.
    """
    a, b = pair.first, pair.second
    for _ in range(DIRECTION_STEPS):
        ends = pin_all((base.turned(a, -sense)[:2], hand.turned(b, sense)[:2]))
        steps = _damped_step(ends, axis, sense, (a, b), height, joint, setting)
        near = _step_along_height(ends, (a, b), base.axis, hand.axis, axis, height, pair.rise)
        beside = across_squared(axis.along, ends[0][0]) < NEAR_C**2
        moves = tuple(jnp.where(beside, x, y) for x, y in zip(near, steps, strict=True))
        most = jnp.where(beside, NEAR_C, setting.rounding**0.25)
        small = functools.reduce(jnp.maximum, map(abs, moves)) < most
        a, b = (
            setting.angle(*add_small_angle(x.sin, x.cos, pin(jnp.where(small, move, 0))))
            for x, move in zip((a, b), moves, strict=True)
        )
    given, _, start = hand.turned(b, sense)
    wanted, _, target = base.turned(a, -sense)
    c, free = _turn_to(axis, given, wanted, joint, sense, setting)
    # Beside the axis a joint is known to rounding over the sine of the angle to it. So it goes where the
    # parallel joints reach, if the direction moves by less than `valid` can see.
    unseen = setting.rounding**1.4
    beside_c = across_squared(axis.along, wanted)
    if reach is not None:
        # Where the direction is along axis A, it is the same at any turn of A.
        one, link = reach
        beside_a, loose = across_squared(one.along, base.direction), free | (4 * beside_c < unseen)
        end = vector.add(link, turned(axis.along, sense * c.sin, c.cos, start))
        end = tuple(jnp.where(loose, x, y) for x, y in zip(link, end, strict=True))
        more = jnp.where(loose, safe.sqrt(across_squared(axis.along, start)), 0)
        wide = jnp.maximum(jnp.maximum(span[0] - more, more - span[1]), 0), span[1] + more
        a = _within(unseen, beside_a, a, _closing(one, sense, end, base.point, wide, a), setting)
        free |= beside_a <= setting.zero_tolerance**2
        _, _, target = base.turned(a, -sense)
    c = _within(unseen, beside_c, c, _closing(axis, sense, start, target, span, c), setting)
    return a, b, c, free


NEAR_C = 0.03
"""[rad] So near axis C the step is along the height. The other one takes joint C as it is; it is better where
two folds meet, and the line of equal height has no direction. A choice: both are good from 1e-6 to 0.1."""


def _damped_step(ends, axis: Axis, sense: int, joints, height: Equation, joint: int, setting: Setting):
    """A step of A and B on the direction itself, as C turns it now."""
    (wanted, by_a), (given, by_b) = ends
    a, b = joints
    c, _ = _turn_to(axis, given, wanted, joint, sense, setting)
    turn = functools.partial(turned, axis.along, sense * c.sin, c.cos)
    columns = (
        (*vector.scale(-1, by_a), height.b * a.cos - height.a * a.sin),
        (*turn(by_b), height.d * b.cos - height.c * b.sin),
    )
    rest = height.e - height.a * a.cos - height.b * a.sin - height.c * b.cos - height.d * b.sin
    gap = (*vector.subtract(wanted, turn(given)), rest)
    return damped_steps(columns, gap, setting.zero_tolerance / 4)


def _step_along_height(
    ends, joints, axis_a: Axis, axis_b: Axis, axis: Axis, height: Equation, rise: Scalar
) -> tuple[Scalar, Scalar]:
    """A step of A and B to the root of the osculating quadratic along the line of equal height.

    The first equation, of the angles of two directions to axis C, by their sines where they are small: there
    their cosines have lost half the digits, and both derivatives of the equation are zero too.

    Args:
        rise: Which of the two roots: the sign of the derivative of the first equation along the line.
    """
    (wanted, by_a), (given, by_b) = ends
    a, b = joints
    along = axis.along
    cos_a, cos_b = vector.dot(along, wanted), vector.dot(along, given)
    both = cos_a + cos_b
    squares = across_squared(along, given) - across_squared(along, wanted)
    gap = jnp.where(abs(both) > 1, safe.divide(squares, both), cos_a - cos_b)
    by_a, by_b = vector.dot(along, by_a), -vector.dot(along, by_b)
    # The second derivative of a turned vector is its part along the axis less itself.
    twice_a = vector.dot(axis_a.along, along) * vector.dot(axis_a.along, wanted) - cos_a
    twice_b = cos_b - vector.dot(axis_b.along, along) * vector.dot(axis_b.along, given)
    rest = height.e - height.a * a.cos - height.b * a.sin - height.c * b.cos - height.d * b.sin
    p, q = height.b * a.cos - height.a * a.sin, height.d * b.cos - height.c * b.sin
    size = safe.reciprocal_sqrt(p * p + q * q)
    p, q, rest = pin_all((p * size, q * size, rest * size))
    gap, by_a, by_b, twice_a, twice_b = pin_all((gap, by_a, by_b, twice_a, twice_b))
    p = jnp.where((p == 0) & (q == 0), 1, p)
    start = gap + (by_a * p + by_b * q) * rest + (twice_a * p * p + twice_b * q * q) * rest * rest / 2
    rate = by_b * p - by_a * q + (twice_b - twice_a) * p * q * rest
    twice = twice_a * q * q + twice_b * p * p
    root = safe.sqrt(rate * rate - 2 * start * twice)
    same = rate * rise >= 0
    far = rise * root - rate
    near = rise * root + rate
    t = jnp.where(same, safe.divide(-2 * start, near), safe.divide(far, twice))
    t = pin(t)
    return p * rest - q * t, q * rest + p * t


def _turn_to(axis: Axis, before: Vector, after: Vector, joint: int, sense: int, setting: Setting):
    """The joint that turns one direction to another about its axis, and whether it is arbitrary."""
    # Their parts square to the axis first: near it, products of the directions themselves lose those.
    x, y = vector.cross(axis.along, before), vector.cross(axis.along, after)
    cosine, sine = pin(vector.dot(x, y)), pin(vector.dot(axis.along, vector.cross(x, y)))
    free = vector.dot(y, y) <= setting.zero_tolerance**2
    weight = safe.reciprocal_sqrt(sine * sine + cosine * cosine)
    return setting.filled(joint, free | (weight == 0), sense * sine * weight, cosine * weight), free


def _within(unseen: Scalar, beside: Scalar, joint: Angle, closing: SinCos, setting: Setting) -> Angle:
    """The joint at the turn that closes, if the direction moves by less than `unseen` (squared)."""
    chord_squared = (closing[0] - joint.sin) ** 2 + (closing[1] - joint.cos) ** 2
    ok = chord_squared * beside < unseen
    return setting.angle(*(jnp.where(ok, x, y) for x, y in zip(closing, joint[:2], strict=True)))


def _closing(axis: Axis, sense: int, start: Vector, target: Vector, span, turn: Angle) -> SinCos:
    """The turn nearest to one that brings the start within the span of the target.

    Both are seen along the axis: their distance squared is p^2 + q^2 - 2 p q cos(angle between them).
    """
    cosine, sine, _ = component(target, axis.along, start)
    size = safe.sqrt(cosine * cosine + sine * sine)
    # The angle from the start at this turn to the target, by its cosine and sine times `size`.
    ahead = cosine * turn.cos + sense * sine * turn.sin
    aside = sense * sine * turn.cos - cosine * turn.sin
    squares = sum(across_squared(axis.along, v) for v in (start, target))
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
    return jnp.where(kept, turn.sin, new_sin), jnp.where(kept, turn.cos, new_cos)


def across_squared(along: Vector, v: Vector) -> Scalar:
    across = vector.cross(along, v)
    return vector.dot(across, across)
