"""Six turning joints, axis 2 parallel to 3, axes 4 and 5 meeting; the others have any direction and offset.

Branches: 16. Collaborative arms with an offset in the wrist, and welding and painting arms.

Frames: standard DH, a4 = 0. W is the point where axes 4 and 5 meet. Frame 1 has its origin on axis 2; the
arm's plane is its x, y plane, `lateral` is W's distance from it, and X, Y is W seen from axis 2 in it.

Steps:
1. Seen from the goal, W lies on a circle about axis 6. Joints 1, 2, 3 bring W to a point in four ways: the
   shoulder's sign is that of a root S, the elbow's that of a root E. Then cos(alpha4) = z4 . z5 is one
   equation for joint 6. The product of its four ways is a real trigonometric polynomial of degree 8 in joint
   6, of which E leaves in closed form and S by numbers u + v S, whose square is known and may be negative.
   Where W's circle passes near axis 1, where joint 6 does not tell where W is, the variable is joint 1
   instead: the circle meets the plane that joint 1 turns in two points, and S is the root of that.
2. The polynomial is interpolated from 18 angles, and its 16 candidates for roots are found. Each belongs to
   the ways whose own equation has a root there, which a step of Newton's method tells. Roots that are nearer
   to each other than rounding tells apart share out these ways.
3. The other joints follow in closed form.

An arm whose front and back share joint 6 (`OffsetWristSigns.shared`) has a polynomial of degree 4, each of
whose roots serves both.

Where axes 1 and 6 are one line, joint 6 is arbitrary.

The margin is that of the polynomial's roots. It is zero at every fold, and also where roots of two ways
coincide, as with the tool in the arm's plane, although no branch ends there.

Bits:
1. front or back, 2. up or down: as in `ortho_parallel_wrist`, for W.
3., 4. the order of such a branch's answers by joint 6, from its DH angle -pi. Where two of them meet and end
   the later ones move up; where an angle passes pi they change places. A fifth answer, which is rare, takes
   a slot that is left over.

The reversed arm, with axes 2 and 3 meeting and 4 parallel to 5, is this one read from the tool to the base.

Source: the elimination is ours. That such arms have up to 16 solutions is a case of Lee and Liang (1988) and
of Raghavan and Roth (1993).
"""

import functools
import math
from typing import NamedTuple

import jax
import jax.numpy as jnp

from ikjax.arm.forward import Link
from ikjax.arm.recognition.signs import OffsetWristSigns
from ikjax.core import circle_roots, safe, vector
from ikjax.core.circle_roots import Series, column
from ikjax.core.pose import Pose
from ikjax.core.tolerances import KEEPS_JOINT_6, ONE_WAY, ROOT_NOISE, WAY_STEP
from ikjax.core.trig import Angle, Scalar, add_small_angle, sincos
from ikjax.core.vector import Vector, minus, plus, times
from ikjax.core.xla import pin, pin_all, stop_gradient
from ikjax.solvers.context import Branch, Setting
from ikjax.solvers.families.pieper import reverse

SLOTS = 16


class Constants(NamedTuple):
    """What the table says, in units of the reach."""

    links: tuple[Link, ...]
    lateral: Scalar
    """W's coordinate along axis 2, from the origin of frame 1."""
    fore: tuple[Scalar, Scalar]
    """From axis 3 to W where joint 3 is zero, in the arm's plane."""
    fore_squared: Scalar
    tilt: tuple[Scalar, Scalar]
    """The part of z4's direction in the plane, divided by `fore` as complex numbers."""
    along: Scalar
    """The part of z4's direction along axis 2."""

    @property
    def fore_length(self) -> Scalar:
        return safe.sqrt(self.fore_squared)


def constants(signs: OffsetWristSigns, links: tuple[Link, ...]) -> Constants:
    side, two, three, four = signs.cos_alpha2, links[1], links[2], links[3]
    fore = three.a, times(-side, times(three.sin_alpha, four.d))
    squared = plus(times(fore[0], fore[0]), times(fore[1], fore[1]))
    # z4 is (0, zeta) in the plane at joint 3 zero; zeta conj(fore) / |fore|^2.
    zeta = times(-side, three.sin_alpha)
    per = safe.divide(1.0, squared)
    return Constants(
        links,
        plus(two.d, times(side, plus(three.d, times(three.cos_alpha, four.d)))),
        fore,
        squared,
        (times(times(zeta, fore[1]), per), times(times(zeta, fore[0]), per)),
        times(side, three.cos_alpha),
    )


# Numbers u + v S of which the square of S is known.


class Surd(NamedTuple):
    u: Scalar
    v: Scalar = 0.0

    def at(self, root: Scalar) -> Scalar:
        return plus(self.u, times(self.v, root))


class Field(NamedTuple):
    """Arithmetic of these numbers."""

    square: Scalar

    def add(self, x: Surd, y: Surd) -> Surd:
        return Surd(plus(x.u, y.u), plus(x.v, y.v))

    def scale(self, k: Scalar, x: Surd) -> Surd:
        return Surd(times(k, x.u), times(k, x.v))

    def multiply(self, x: Surd, y: Surd) -> Surd:
        u = plus(times(x.u, y.u), times(self.square, times(x.v, y.v)))
        return Surd(u, plus(times(x.u, y.v), times(x.v, y.u)))

    def number(self, x: Scalar) -> Surd:
        return Surd(x)


class Reals:
    """The same of numbers without a root."""

    add = staticmethod(plus)
    scale = multiply = staticmethod(times)

    @staticmethod
    def number(x: Scalar) -> Scalar:
        return x


class Way(NamedTuple):
    """Where joints 1 and 6 put W and axis 5, seen from frame 1: surds, or numbers for one sign of S."""

    x: Surd
    y: Surd
    axis: tuple[Surd, Surd, Surd]
    turn1: tuple[Surd, Surd]
    """Sine and cosine of joint 1."""
    turn6: tuple[Surd, Surd]

    def at(self, root: Scalar) -> "Way":
        return jax.tree.map(lambda s: s.at(root), self, is_leaf=lambda s: isinstance(s, Surd))


class Front(NamedTuple):
    way: Way
    square: Scalar
    """Of the root S."""
    weight: Scalar
    """The polynomial is divided by its square."""


class Circle(NamedTuple):
    """A vector of frame 0 that joint 6 turns: fixed + cos(t6) cos + sin(t6) sin."""

    fixed: Vector
    cos: Vector
    sin: Vector

    def at(self, sine: Scalar, cosine: Scalar) -> Vector:
        turned = vector.add(vector.scale(cosine, self.cos), vector.scale(sine, self.sin))
        return vector.add(self.fixed, turned)

    def map(self, f) -> "Circle":
        return Circle(*map(f, self))


class Seen(NamedTuple):
    """What the goal says: W, from the height of frame 1's origin, and the direction of axis 5."""

    center: Circle
    axis: Circle


def seen_from_goal(constants: Constants, goal: Pose) -> Seen:
    x, y, z = vector.transpose(goal.rotation)
    one, five = constants.links[0], constants.links[4]

    def circle(v: Vector) -> Circle:
        return Circle(
            vector.scale(v[2], z),
            vector.add(vector.scale(v[0], x), vector.scale(v[1], y)),
            vector.add(vector.scale(v[1], x), vector.scale(minus(v[0]), y)),
        )

    s, c = five.sin_alpha, five.cos_alpha
    center = circle((minus(five.a), minus(times(s, five.d)), minus(times(c, five.d))))
    px, py, pz = goal.position
    fixed = vector.add(center.fixed, (px, py, plus(pz, minus(one.d))))
    return Seen(center._replace(fixed=fixed), circle((0.0, s, c)))


def front_of_joint_6(constants: Constants, seen: Seen, sine: Scalar, cosine: Scalar) -> Front:
    """Joint 1 turns the arm's plane to W."""
    one, lateral = constants.links[0], constants.lateral
    s, c = one.sin_alpha, one.cos_alpha
    (x, y, z), w = seen.center.at(sine, cosine), seen.axis.at(sine, cosine)
    height = times(safe.divide(1.0, s), plus(z, minus(times(c, lateral))))
    beside = plus(times(c, height), minus(times(s, lateral)))
    distance = x * x + y * y
    per = 1 / jnp.maximum(distance, jnp.finfo(distance.dtype).tiny)
    turn_sin = Surd(minus(times(beside, x)) * per, y * per)
    turn_cos = Surd(times(beside, y) * per, x * per)
    field = Field(distance - beside * beside)
    ahead = field.add(field.scale(w[0], turn_cos), field.scale(w[1], turn_sin))
    aside = field.add(field.scale(w[1], turn_cos), field.scale(minus(w[0]), turn_sin))
    axis = (
        ahead,
        field.add(field.scale(c, aside), Surd(times(s, w[2]))),
        field.add(Surd(times(c, w[2])), field.scale(minus(s), aside)),
    )
    way = Way(Surd(minus(one.a), 1.0), Surd(height), axis, (turn_sin, turn_cos), (Surd(sine), Surd(cosine)))
    return Front(way, field.square, distance)


def front_of_joint_1(constants: Constants, seen: Seen, sine: Scalar, cosine: Scalar) -> Front:
    """Joint 6 turns W into the arm's plane."""
    one = constants.links[0]
    s, c = one.sin_alpha, one.cos_alpha

    def into_frame_1(v: Vector) -> Vector:
        ahead = plus(times(cosine, v[0]), times(sine, v[1]))
        aside = plus(times(cosine, v[1]), minus(times(sine, v[0])))
        return ahead, plus(times(c, aside), times(s, v[2])), plus(times(c, v[2]), minus(times(s, aside)))

    center, axis = seen.center.map(into_frame_1), seen.axis.map(into_frame_1)
    a, b = center.cos[2], center.sin[2]
    weight = a * a + b * b
    missing = plus(constants.lateral, minus(center.fixed[2]))
    per = 1 / jnp.maximum(weight, jnp.finfo(weight.dtype).tiny)
    field = Field(weight - missing * missing)
    turn_cos, turn_sin = Surd(a * missing * per, -b * per), Surd(b * missing * per, a * per)

    def entry(circle: Circle, i: int, off: Scalar = 0.0) -> Surd:
        turned = field.add(field.scale(circle.cos[i], turn_cos), field.scale(circle.sin[i], turn_sin))
        return field.add(Surd(plus(circle.fixed[i], off)), turned)

    way = Way(
        entry(center, 0, minus(one.a)),
        entry(center, 1),
        (entry(axis, 0), entry(axis, 1), entry(axis, 2)),
        (Surd(sine), Surd(cosine)),
        (turn_sin, turn_cos),
    )
    return Front(way, field.square, weight)


class Problem(NamedTuple):
    """The equation of one goal."""

    constants: Constants
    seen: Seen
    by_joint_1: jax.Array
    """Whether the variable is joint 1 (twice joint 1 where front and back share roots), else joint 6."""
    shared: bool
    scale: Scalar
    """The polynomial's largest value [its own unit]; its coefficients are divided by that."""

    @property
    def degree(self) -> int:
        """Of the polynomial."""
        return 4 if self.shared else 8

    def front(self, sine: Scalar, cosine: Scalar) -> Front:
        """Both eliminations at their variable, of which one is taken."""
        half = _half(sine, cosine) if self.shared else (sine, cosine)
        by_1 = front_of_joint_1(self.constants, self.seen, *half)
        by_6 = front_of_joint_6(self.constants, self.seen, sine, cosine)
        return jax.tree.map(lambda a, b: pin(_choose(self.by_joint_1, a, b)), by_1, by_6)


def _choose(which: jax.Array, a: Scalar, b: Scalar) -> Scalar:
    alike = isinstance(a, float) and isinstance(b, float) and a == b
    return a if alike else jnp.where(which, a, b)


def _half(sine: Scalar, cosine: Scalar) -> tuple[Scalar, Scalar]:
    """Sine and cosine of half an angle in [-pi, pi]."""
    right = cosine >= 0
    large = safe.sqrt(jnp.where(right, 1 + cosine, 1 - cosine) / 2)
    small = abs(sine) / (2 * large)
    sign = safe.sign(sine)
    return sign * jnp.where(right, small, large), jnp.where(right, large, small)


class Terms(NamedTuple):
    """Of one way: its equation is share - cross E = 0, with E^2 = fore^2 span^2 - level^2."""

    span_squared: Scalar
    level: Scalar
    pull: tuple[Scalar, Scalar]
    rest: Scalar
    cross: Scalar


def terms(constants: Constants, way: Way, field) -> Terms:
    """Terms of the equation, in surds or in numbers."""
    add, scale, multiply = field.add, field.scale, field.multiply
    two, four = constants.links[1], constants.links[3]
    span = add(multiply(way.x, way.x), multiply(way.y, way.y))
    off = plus(constants.fore_squared, minus(times(two.a, two.a)))
    level = scale(0.5, add(span, field.number(off)))
    (kr, ki), (u, v, w) = constants.tilt, way.axis
    pull = add(scale(kr, u), scale(ki, v)), add(scale(kr, v), scale(minus(ki), u))
    rest = add(scale(constants.along, w), field.number(minus(four.cos_alpha)))
    cross = add(multiply(pull[0], way.y), scale(-1.0, multiply(pull[1], way.x)))
    return pin_all(Terms(span, level, pull, rest, cross))


def _product(constants: Constants, way: Way, field):
    """The product of the equations of both elbows, times span^2."""
    t = terms(constants, way, field)
    add, multiply = field.add, field.multiply
    first = add(multiply(t.level, t.pull[0]), multiply(t.rest, way.x))
    second = add(multiply(t.level, t.pull[1]), multiply(t.rest, way.y))
    first, second = pin_all((first, second))
    squares = add(multiply(first, first), multiply(second, second))
    return add(squares, field.scale(minus(constants.fore_squared), multiply(t.cross, t.cross)))


def polynomial(problem: Problem, front: Front, apart: bool = True) -> Scalar:
    """The trigonometric polynomial at an angle, from the front there.

    Args:
        problem: The equation.
        front: At the angle.
        apart: Whether both real factors are computed, each by itself: one may be far smaller than the other
            and keeps its digits in that way.
    """
    constants = problem.constants
    both = _product(constants, front.way, Field(front.square))
    norm = both.u * both.u - front.square * both.v * both.v
    if apart:
        root = safe.sqrt(front.square)
        plus_side = _product(constants, front.way.at(root), Reals)
        minus_side = _product(constants, front.way.at(-root), Reals)
        norm = jnp.where(front.square > 0, plus_side * minus_side, norm)
    whole = front.weight * front.weight * norm
    return jnp.where(problem.by_joint_1, whole, front.weight * both.u) if problem.shared else whole


def elbow_squared(constants: Constants, span_squared: Scalar) -> Scalar:
    """E^2: sixteen times the square of the triangle's area, by Heron's formula."""
    upper, fore = constants.links[1].a, constants.fore_length
    less, more = plus(upper, minus(fore)), plus(upper, fore)
    return (span_squared - times(less, less)) * (times(more, more) - span_squared) / 4


def equations(problem: Problem, front: Front) -> tuple[Scalar, ...]:
    """The four ways' equations times span^2: both elbows of S >= 0, then those of S <= 0."""
    root, values = safe.sqrt(front.square), []
    for sign in (1, -1):
        way = front.way.at(sign * root)
        t = terms(problem.constants, way, Reals)
        bend = safe.sqrt(elbow_squared(problem.constants, t.span_squared))
        share = t.level * plus(times(t.pull[0], way.x), times(t.pull[1], way.y)) + t.rest * t.span_squared
        values += [share - t.cross * bend, share + t.cross * bend]
    return tuple(values)


def formulate(
    constants: Constants, goal: Pose, shared: bool, by_joint_1: jax.Array | None = None
) -> tuple[Problem, Series]:
    """The equation of a goal, and the coefficients of its polynomial, the largest value of which is one.

    Args:
        constants: Of the arm.
        goal: The pose.
        shared: Whether front and back share roots.
        by_joint_1: Whether the variable is joint 1, where that is decided already.
    """
    count = 10 if shared else 18
    first = 0.5 * math.pi / count
    goal = jax.tree.map(lambda x: jnp.asarray(x)[None], goal)
    seen = pin_all(seen_from_goal(constants, goal))
    like = goal.position[0]
    angles = [first + 2 * math.pi * j / count for j in range(count)]
    sine, cosine = (column([f(t) for t in angles], like) for f in (math.sin, math.cos))
    by_6 = front_of_joint_6(constants, seen, sine, cosine)
    half = _half(sine, cosine) if shared else (sine, cosine)
    by_1 = front_of_joint_1(constants, seen, *half)
    if by_joint_1 is None:
        by_joint_1 = _decided(constants, by_6, by_1)
    problem = Problem(constants, seen, by_joint_1, shared, jnp.ones_like(like))
    front = jax.tree.map(lambda a, b: pin(_choose(by_joint_1, a, b)), by_1, by_6)
    samples = pin(polynomial(problem, front))
    largest = stop_gradient(jnp.max(abs(samples), axis=0, keepdims=True))
    samples = pin(samples * safe.divide(1.0, largest))
    return problem._replace(scale=largest), pin_all(circle_roots.interpolated(samples, first))


def _decided(constants: Constants, by_6: Front, by_1: Front) -> jax.Array:
    """Whether joint 1 is the variable."""
    # How near W comes to axis 1, and axis 6 to the direction of axis 2, where the variable tells nothing.
    near_6, near_1 = (
        jnp.min(2 * front.weight - front.square, axis=0, keepdims=True) for front in (by_6, by_1)
    )
    five = constants.links[4]
    radius_squared = five.a**2 + (five.sin_alpha * five.d) ** 2
    by_joint_1 = (near_6 < radius_squared) & ((near_1 > KEEPS_JOINT_6 * radius_squared) | (near_6 < near_1))
    return pin(jnp.where(by_joint_1, jnp.ones_like(near_6), 0)) > 0


class Fold(NamedTuple):
    """Where a margin is measured: at an extremum of the polynomial, (S, ...)."""

    angle: Scalar
    """[rad] Of the variable."""
    order: Scalar
    """As in `circle_roots.Roots`."""
    sign: Scalar
    """Of the margin; zero where it is constant."""
    by_joint_1: Scalar
    """1 where the variable is joint 1, else 0."""
    direction: Vector
    """In which the polynomial grows most there, as a unit vector of positions of the goal."""


class Candidate(NamedTuple):
    """One answer or none, by its variable and the signs of its roots."""

    sine: Scalar
    cosine: Scalar
    shoulder: Scalar
    elbow: Scalar
    margin: Scalar
    fold: Fold


def candidates(problem: Problem, series: Series, setting: Setting) -> Candidate:
    """One candidate for each interval of the polynomial, (2 m, ...)."""
    roots = circle_roots.real_roots(series)
    sine, cosine = (pin(x) for x in sincos(roots.angle))
    margin, fold = _margins(problem, roots)
    way, step, loose = _ways(problem, series, roots.angle, sine, cosine, setting)
    # Where roots of several ways coincide the polynomial tells nothing of folds, but each way has a root.
    coincide = (margin < 0) & (abs(step) <= loose)
    margin = pin(jnp.where(coincide, 0, margin))
    fold = fold._replace(sign=pin(jnp.where(coincide, 0, fold.sign)))
    # From an extremum that is no root a step would lead to another candidate's root.
    step = jnp.where(margin >= -(setting.rounding**0.5), step, 0)
    sine, cosine = add_small_angle(sine, cosine, step)
    size = safe.reciprocal_sqrt(sine * sine + cosine * cosine)
    shoulder, elbow = jnp.where(way >= 2, -1, 1), jnp.where((way == 1) | (way == 3), -1, 1)
    dtype = sine.dtype
    return Candidate(
        pin(sine * size), pin(cosine * size), shoulder.astype(dtype), elbow.astype(dtype), margin, fold
    )


def _ways(
    problem: Problem, series: Series, angle: Scalar, sine: Scalar, cosine: Scalar, setting: Setting
) -> tuple[Scalar, Scalar, Scalar]:
    """Which of the four equations has its root at each root of the polynomial.

    Further, the step to it [rad], and how far rounding may have moved the root [rad].
    """

    def at(s, c):
        front = problem.front(s, c)
        return (*equations(problem, front), front.square)

    loose = pin(_uncertainty(series, angle, setting))
    # How many roots before this one are at the same place.
    near = [_apart(angle, _before(angle, k)) < 2 * (loose + _before(loose, k)) for k in range(1, 4)]
    order = jnp.where(near[0], jnp.where(near[1], jnp.where(near[2], 3, 2), 1), 0)
    order = pin(order.astype(sine.dtype))
    found, rates = jax.jvp(at, (sine, cosine), (cosine, -sine))
    # Where the root S ends, its two signs are one way.
    fold = found[4] < setting.rounding**0.5 * loose * abs(rates[4])
    tiny = jnp.finfo(sine.dtype).tiny
    steps = [-v / jnp.where(d != 0, d, tiny) for v, d in zip(found[:4], rates[:4], strict=True)]
    sizes = [abs(s) for s in steps]
    # Joint 6 serves both signs of a shared root with the other elbow: only two ways are different.
    second = problem.by_joint_1 & ~fold if problem.shared else ~fold
    sizes[2:] = [jnp.where(second, s, jnp.inf) for s in sizes[2:]]
    least = functools.reduce(jnp.minimum, sizes)
    # A way whose root is clearly nearer than the others' is the only one.
    most = jnp.minimum(loose, ONE_WAY * (least + setting.rounding**0.5))
    fits = [((s <= least) | (s < most)).astype(sine.dtype) for s in sizes]
    count = sum(fits)
    order = jnp.where(order < count, order, order - count * jnp.floor(order / count))
    way, step, passed = jnp.zeros_like(sine), jnp.zeros_like(sine), jnp.zeros_like(sine)
    for k in range(4):
        mine = (fits[k] > 0) & (passed == order)
        way, step = jnp.where(mine, k, way), jnp.where(mine, steps[k], step)
        passed = passed + fits[k]
    return pin(way), pin(jnp.clip(step, -WAY_STEP, WAY_STEP)), loose


def _before(row: jax.Array, k: int) -> jax.Array:
    """The entry k places before each, around the circle."""
    return jnp.concatenate([row[-k:], row[:-k]])


def _apart(first: Scalar, last: Scalar) -> Scalar:
    """The difference of two angles in [-pi, pi] [rad]."""
    difference = abs(first - last)
    return jnp.minimum(difference, abs(2 * math.pi - difference))


def _uncertainty(series: Series, angle: Scalar, setting: Setting) -> Scalar:
    """How far rounding may have moved a root, of multiplicity 1, 2 or 4 [rad]."""
    noise = ROOT_NOISE * setting.rounding
    _, first, second = circle_roots.values(series, angle)
    fourth = circle_roots.values(series.derivative().derivative(), angle)[2]
    tiny = jnp.finfo(angle.dtype).tiny
    single = noise / jnp.maximum(2 * abs(first), tiny)
    double = jnp.sqrt(noise / jnp.maximum(abs(second), tiny))
    fourfold = jnp.sqrt(jnp.sqrt(12 * noise / jnp.maximum(abs(fourth), tiny)))
    spread = jnp.minimum(jnp.minimum(single, double), jnp.minimum(fourfold, WAY_STEP))
    return spread + setting.rounding**0.5


def _margins(problem: Problem, roots: circle_roots.Roots) -> tuple[Scalar, Fold]:
    """How far the goal can move before the candidate's interval loses its root, to first order.

    The root is lost where an extremum at an end of the interval is zero.
    """
    clearance, direction = _clearance(problem, roots.extremum, roots.extremum_order)
    following = circle_roots.shifted(clearance)
    first = jnp.where(roots.real, clearance <= following, roots.first)
    sign = pin(jnp.where(roots.real, jnp.ones_like(clearance), -1))

    def nearer(x, turn: float = 0.0):
        return pin(jnp.where(first, x, circle_roots.shifted(x, turn)))

    by_joint_1 = problem.by_joint_1.astype(clearance.dtype) * jnp.ones_like(clearance)
    angle, order = nearer(roots.extremum, 2 * math.pi), nearer(roots.extremum_order)
    x, y, z = map(nearer, direction)
    return sign * nearer(clearance), Fold(angle, order, sign, by_joint_1, (x, y, z))


def _clearance(problem: Problem, extremum: Scalar, order: Scalar) -> tuple[Scalar, Vector]:
    """How far the goal is from where the extremum is zero: the polynomial over its gradient in the position.

    Where two extrema are complex their place has a derivative that is not zero. As far as that is, over the
    degree, the value of the polynomial has to move before they are real (Bernstein's inequality). The second
    result is the gradient's direction.
    """
    sine, cosine = (pin(x) for x in sincos(extremum))
    zero = jnp.zeros_like(sine)
    value = functools.partial(_polynomial_at, problem)
    height, pull = jax.vjp(value, sine, cosine, zero, zero, zero)
    by_sine, by_cosine, *gradient = pull(jnp.ones_like(height))
    rate = cosine * by_sine - sine * by_cosine
    per = pin(safe.divide(1.0, safe.norm(*gradient)))
    x, y, z = (pin(g * per) for g in gradient)
    return pin(jnp.minimum(_height(problem, height, rate, order) * per, 1)), (x, y, z)


def _polynomial_at(problem: Problem, sine: Scalar, cosine: Scalar, *shift: Scalar) -> Scalar:
    """The polynomial at an angle of a goal that is shifted."""
    center = problem.seen.center
    moved = center._replace(fixed=tuple(map(jnp.add, center.fixed, shift)))
    there = problem._replace(seen=problem.seen._replace(center=moved))
    return polynomial(there, there.front(sine, cosine), apart=False)


def _height(problem: Problem, value: Scalar, rate: Scalar, order: Scalar) -> Scalar:
    return abs(value) + jnp.where(order > 1, abs(rate) / problem.degree, 0)


def margins(signs: OffsetWristSigns, links: tuple[Link, ...], goal: Pose, fold: Fold) -> Scalar:
    """The margins of `stacked` at their folds, with their derivatives.

    The derivative of the gradient's length is that of its part in the gradient's direction.
    """
    problem, series = formulate(constants(signs, links), goal, bool(signs.shared), fold.by_joint_1[:1] > 0)
    extremum = pin(_carried(series, fold))
    sine, cosine = (pin(x) for x in sincos(extremum))

    def value(way: Scalar) -> Scalar:
        return _polynomial_at(problem, sine, cosine, *(way * x for x in fold.direction))

    height, pull = jax.jvp(value, (jnp.zeros_like(sine),), (jnp.ones_like(sine),))
    rate = problem.scale * circle_roots.values(series, extremum)[1]
    return fold.sign * _height(problem, height, rate, fold.order) * safe.divide(1.0, pull)


def _carried(series: Series, fold: Fold) -> Scalar:
    """The angle of the extremum, with its derivatives as a root of a derivative of the polynomial."""
    value, slope = circle_roots.derivatives(series, fold.angle, fold.order)
    slope = stop_gradient(slope)
    # Beyond the highest derivative is no root: there the angle is fixed.
    fixed = fold.order > circle_roots.LEVELS
    per = jnp.where(fixed, 0, slope / (slope * slope + jnp.finfo(slope.dtype).eps))
    return fold.angle - per * (value - stop_gradient(value))


def reversed_margins(signs: OffsetWristSigns, links: tuple[Link, ...], goal: Pose, fold: Fold) -> Scalar:
    """Those of `reversed_stacked`."""
    return margins(signs, *reverse(links, goal), fold)


class Place(NamedTuple):
    """What the other joints follow from."""

    x: Scalar
    """W in the arm's plane, from axis 2."""
    y: Scalar
    one_sin: Scalar
    one_cos: Scalar
    six_sin: Scalar
    six_cos: Scalar
    elbow: Scalar
    """The sign of E."""
    margin: Scalar
    fold: Fold


def places_of(problem: Problem, found: Candidate) -> Place:
    """Joints 1 and 6 of each candidate; shared roots stand for both sides of axis 1."""
    front = problem.front(found.sine, found.cosine)
    way = front.way.at(found.shoulder * safe.sqrt(front.square))
    one, six = (_unit(*turn) for turn in (way.turn1, way.turn6))
    place = Place(way.x, way.y, one[0], one[1], six[0], six[1], found.elbow, found.margin, found.fold)
    place = jax.tree.map(lambda x: pin(x + jnp.zeros_like(found.sine)), place)
    if not problem.shared:
        return place
    other = place._replace(x=-place.x, elbow=-place.elbow)
    other = other._replace(one_sin=-place.one_sin, one_cos=-place.one_cos)
    return jax.tree.map(lambda a, b: pin(jnp.concatenate([a, b])), place, other)


def joints_of(problem: Problem, rotation, place: Place):
    """Sines and cosines of the six joints."""
    constants = problem.constants
    one, two, three, four, _ = constants.links[:5]
    x, y, one_sin, one_cos, six_sin, six_cos, elbow, *_ = place
    span = x * x + y * y
    bend = elbow * safe.sqrt(elbow_squared(constants, span))
    level = (span + plus(constants.fore_squared, minus(times(two.a, two.a)))) / 2
    per = 1 / jnp.maximum(span, jnp.finfo(span.dtype).tiny)
    fore_x, fore_y = (x * level - y * bend) * per, (y * level + x * bend) * per
    side = safe.sign(two.a)
    two_sin, two_cos = pin_all(_unit((y - fore_y) * side, (x - fore_x) * side))
    # The forearm's direction against that at joint 3 zero.
    u, v = constants.fore
    pitch = _unit(plus(times(u, fore_y), minus(times(v, fore_x))), plus(times(u, fore_x), times(v, fore_y)))
    pitch_sin, pitch_cos = pin_all(pitch)
    c2 = two.cos_alpha
    three_sin = c2 * (pitch_sin * two_cos - pitch_cos * two_sin)
    three_cos = pitch_cos * two_cos + pitch_sin * two_sin
    # Axes of frame 3, seen from frame 0.
    s, c = one.sin_alpha, one.cos_alpha
    x1 = (one_cos, one_sin, 0.0)
    y1 = (times(minus(c), one_sin), times(c, one_cos), s)
    z1 = (times(s, one_sin), times(minus(s), one_cos), c)
    x3 = vector.add(vector.scale(pitch_cos, x1), vector.scale(pitch_sin, y1))
    across = vector.add(vector.scale(minus(pitch_sin), x1), vector.scale(pitch_cos, y1))
    y2, z2 = vector.scale(c2, across), vector.scale(c2, z1)
    s, c = three.sin_alpha, three.cos_alpha
    y3 = vector.add(vector.scale(c, y2), vector.scale(s, z2))
    z3 = vector.add(vector.scale(minus(s), y2), vector.scale(c, z2))
    gx, gy, _ = vector.transpose(rotation)
    w = problem.seen.axis.at(six_sin, six_cos)
    x5 = vector.subtract(vector.scale(six_cos, gx), vector.scale(six_sin, gy))
    y5 = vector.cross(w, x5)
    hand = safe.sign(four.sin_alpha)
    four_sin, four_cos = _unit(hand * vector.dot(x3, w), -hand * vector.dot(y3, w))
    five_sin, five_cos = _unit(hand * vector.dot(z3, x5), hand * vector.dot(z3, y5))
    pairs = (
        (one_sin, one_cos),
        (two_sin, two_cos),
        (three_sin, three_cos),
        (four_sin, four_cos),
        (five_sin, five_cos),
        (six_sin, six_cos),
    )
    return tuple((pin(s), pin(c)) for s, c in pairs)


def _unit(sine: Scalar, cosine: Scalar) -> tuple[Scalar, Scalar]:
    """A direction scaled to length one; no turn where it has no length."""
    squared = sine * sine + cosine * cosine
    size = safe.reciprocal_sqrt(squared)
    return sine * size, jnp.where(squared > 0, cosine * size, 1)


def stacked(signs: OffsetWristSigns, links: tuple[Link, ...], goal: Pose, setting: Setting) -> Branch:
    """All slots for one goal as one `Branch`, whose numbers have the slots as their first axis.

    Arguments as in `pieper`.
    """
    table = constants(signs, links)
    problem, series = formulate(table, goal, bool(signs.shared))
    found = candidates(problem, series, setting)
    free = _one_line(goal, setting)[None]
    # Joint 6 is arbitrary: each slot stands for one way, and the equation does not depend on joint 6.
    places = column(range(found.sine.shape[0]), found.sine)
    last = jax.tree.map(lambda x: jnp.asarray(x)[None], setting.fallback[5])
    spread = 2 if signs.shared else 4
    turn = places - spread * jnp.floor(places / spread)
    found = Candidate(
        jnp.where(free & ~problem.by_joint_1, last.sin, found.sine),
        jnp.where(free & ~problem.by_joint_1, last.cos, found.cosine),
        jnp.where(free, jnp.where(turn >= 2, -1, 1).astype(turn.dtype), found.shoulder),
        jnp.where(free, jnp.where((turn == 1) | (turn == 3), -1, 1).astype(turn.dtype), found.elbow),
        jnp.where(free, jnp.zeros_like(found.margin), found.margin),
        found.fold._replace(sign=jnp.where(free, 0, found.fold.sign)),
    )
    place = _in_slots(signs, plus(0.0, table.links[0].a), places_of(problem, found), setting)
    pairs = joints_of(problem, jax.tree.map(lambda x: x[None], goal.rotation), place)
    joints = tuple(Angle(sine, cosine, ()) for sine, cosine in pairs)
    continuum = jnp.broadcast_to(free, place.margin.shape)
    return Branch(joints, goal, place.margin, continuum, fold=place.fold)


def _one_line(goal: Pose, setting: Setting) -> jax.Array:
    """Whether axes 1 and 6 are one line."""
    x, y, _ = goal.position
    u, v = goal.rotation[0][2], goal.rotation[1][2]
    tolerance = setting.zero_tolerance
    return (u * u + v * v <= tolerance**2) & (x * x + y * y <= tolerance**2)


def _in_slots(signs: OffsetWristSigns, first: Scalar, place: Place, setting: Setting) -> Place:
    """The candidates in their slots: front or back, up or down, and then by joint 6.

    Args:
        signs: Of the arm.
        first: a1.
        place: The candidates.
        setting: Tolerances.
    """
    # A number that grows with the angle in (-pi, pi].
    key = pin(jnp.where(place.six_sin >= 0, 1 - place.six_cos, place.six_cos - 1))
    ahead = safe.sign(place.x + first)
    back = ahead * safe.sign(first) < 0
    # Where E is positive the elbow is right of the line from axis 2 to W.
    down = place.elbow * ahead * (signs.up * signs.sin_alpha1) > 0
    group = pin(jnp.where(back, 1, 0).astype(key.dtype) + jnp.where(down, 2, 0))
    live = pin(jnp.where(place.margin >= -(setting.rounding**0.5), jnp.ones_like(key), 0))
    places = column(range(SLOTS), key)
    # Of each candidate (first axis) against each (second axis).
    sooner = places[:, None] < places[None]
    before = (key[:, None] < key[None]) | ((key[:, None] == key[None]) & sooner)
    ahead_of = (live[:, None] > 0) & (group[:, None] == group[None]) & before
    rank = pin(jnp.sum(jnp.where(ahead_of, jnp.ones_like(key), 0), axis=0))
    seated = (live > 0) & (rank < 4)
    waiting = pin(jnp.where(seated, jnp.zeros_like(key), 1))
    beyond = pin(jnp.sum(jnp.where(sooner, waiting[:, None], 0), axis=0))
    # Slots of a branch are filled from its first; the others go to candidates that wait, in order.
    free, target = jnp.zeros_like(key[:1]), group + 4 * rank
    for g in range(4):
        taken = jnp.minimum(jnp.sum(jnp.where(seated & (group == g), 1, 0), axis=0, keepdims=True), 4)
        taken = pin(taken.astype(key.dtype))
        mine = (waiting > 0) & (beyond >= free) & (beyond < free + 4 - taken)
        target = jnp.where(mine, g + 4 * (taken + beyond - free), target)
        free = pin(free + 4 - taken)
    target = pin(target)
    numbers, form = jax.tree.flatten(place)
    here = (target[:, None] == places[None])[None]
    moved = jnp.sum(jnp.where(here, jnp.stack(numbers)[:, :, None], 0), axis=1)
    return jax.tree.unflatten(form, [pin(x) for x in moved])


def reversed_stacked(
    signs: OffsetWristSigns, links: tuple[Link, ...], goal: Pose, setting: Setting
) -> Branch:
    """All slots of an arm with axes 2 and 3 meeting and 4 parallel to 5, as in `stacked`."""
    table, turned = reverse(links, goal)
    slots = stacked(signs, table, turned, setting._replace(fallback=(*setting.fallback[::-1],)))
    return slots._replace(joints=slots.joints[::-1], seen=goal)


def _each(slots: Branch, setting: Setting) -> tuple[Branch, ...]:
    """Each slot by itself."""

    def slot(k: int) -> Branch:
        joints = tuple(setting.angle(joint.sin[k], joint.cos[k]) for joint in slots.joints)
        return Branch(joints, slots.seen, slots.margin[k], slots.continuum[k])

    return tuple(map(slot, range(SLOTS)))


def branches(
    signs: OffsetWristSigns, links: tuple[Link, ...], goal: Pose, setting: Setting
) -> tuple[Branch, ...]:
    """All slots for one goal; arguments as in `pieper`."""
    return _each(stacked(signs, links, goal, setting), setting)


def reversed_branches(
    signs: OffsetWristSigns, links: tuple[Link, ...], goal: Pose, setting: Setting
) -> tuple[Branch, ...]:
    """All slots of the reversed arm."""
    return _each(reversed_stacked(signs, links, goal, setting), setting)
