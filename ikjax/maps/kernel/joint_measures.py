"""Statistics that need the joints of solutions: how well the arm moves there, how far its limits are.

They run in a loop whose values are pinned, many times slower than one of masks alone.

The Jacobian is that of the tool in the world, its linear rows divided by the reach and the
columns of sliding joints multiplied by it, so that both measures are numbers without a unit that do not
depend on the arm's size. An arm that moves its tool in fewer ways than there are joints would have only
its task's rows; one with fewer joints than ways, its columns.
Source: Yoshikawa, Manipulability of robotic mechanisms, IJRR 4 (1985).
"""

import functools
import itertools
import math
from typing import Any

import jax
import jax.numpy as jnp

from ikjax.arm.arm import Arm
from ikjax.arm.forward import Chain, Joint, advance, fixed_pose, links, reach
from ikjax.arm.twists import Twist, motor_twists
from ikjax.core import pose as poses
from ikjax.core import safe, vector
from ikjax.core.trig import Scalar
from ikjax.core.xla import one_by_one, pin, pinning
from ikjax.maps.kernel.flags import distance
from ikjax.maps.kernel.sample import Goal
from ikjax.solvers.context import Joints, Slide
from ikjax.solvers.pipeline import TURNING

Rows = list[list[Scalar]]

STEPS = 6
"""Laguerre's steps to the least eigenvalue; near it each triples the digits."""


def jacobian_columns(arm: Arm, joints: Joints) -> Rows:
    """Columns of the Jacobian in units of the reach: six entries each, three for a task of positions."""
    size = reach(arm)
    frame, before = fixed_pose(arm.base), []
    for link, joint in zip(links(arm), joints, strict=True):
        before.append(frame)
        if isinstance(joint, Slide):
            sine, cosine = math.sin(link.theta), math.cos(link.theta)
            stands = Joint(sine, cosine, link.d + size * joint.value)
        else:
            stands = Joint(joint.sin, joint.cos, link.d)
        frame = poses.Pose(*_held(advance(frame, link, stands)))
    tip = poses.compose(frame, fixed_pose(arm.tool)).position
    twists = motor_twists(arm, Chain(before, before, frame), tip)
    return [_column(arm, kind, twist, size) for kind, twist in zip(arm.kinds, twists, strict=True)]


def _held(frame: poses.Pose) -> tuple:
    def one(x: Scalar) -> Scalar:
        return x if isinstance(x, int | float) else pin(x)

    return tuple(tuple(map(one, row)) for row in frame.rotation), tuple(map(one, frame.position))


def _column(arm: Arm, kind: str, twist: Twist, size: float) -> list[Scalar]:
    per = 1.0 if kind == "P" else 1 / size
    entries = [vector.times(per, x) for x in twist.linear]
    if arm.task in TURNING:
        entries += [vector.times(size if kind == "P" else 1.0, x) for x in twist.angular]
    return [x if isinstance(x, int | float) else pin(x) for x in entries]


def manipulability(columns: Rows) -> Scalar:
    """The volume that unit joint rates span: |det J| of a square Jacobian, sqrt(det J^T J) of a tall one."""
    n, rows = len(columns), len(columns[0])
    if n == rows == 3:
        return abs(vector.dot(vector.cross(tuple(columns[0]), tuple(columns[1])), tuple(columns[2])))
    if n == rows == 6:
        return abs(_determinant_of_twists(columns))
    pivots = _factors(_gram(columns), 0.0)[1]
    return math.prod([safe.sqrt(pivot) for pivot in pivots[1:]], start=safe.sqrt(pivots[0]))


def _determinant_of_twists(columns: Rows) -> Scalar:
    """By Laplace's expansion: three columns' linear halves against the other three's angular ones."""
    linear, angular = ([tuple(c[part]) for c in columns] for part in (slice(0, 3), slice(3, 6)))
    total: Scalar = 0.0
    for chosen in itertools.combinations(range(6), 3):
        others = [k for k in range(6) if k not in chosen]
        sign = -1.0 if sum(chosen) % 2 == 0 else 1.0  # of the columns' new order, by 0 + 1 + 2 = 3
        minor = pin(_triple([linear[k] for k in chosen]))
        total = total + sign * minor * _triple([angular[k] for k in others])
    return total


def _triple(rows: list[vector.Vector]) -> Scalar:
    return vector.dot(vector.cross(rows[0], rows[1]), rows[2])


def sigma_min(columns: Rows) -> Scalar:
    """The least singular value of the Jacobian.

    The least eigenvalue of J^T J by Laguerre's method from zero, which comes from below and never passes it.
    What is below the square root of the type's rounding is noise, and may be zero.
    Source: Parlett, Laguerre's method applied to the matrix eigenvalue problem, Math. Comp. 18 (1964).
    """
    gram = _gram(columns)
    n = len(gram)

    def step(_, least):
        lower, pivots = _factors(gram, least)
        whole = jnp.asarray(True)
        for pivot in pivots:
            whole = whole & (pivot > 0)
        inverse = _inverse(lower, [safe.divide(1, jnp.where(whole, pivot, 1)) for pivot in pivots])
        first = sum(inverse[i][i] for i in range(n))
        second = sum(inverse[i][j] ** 2 * (1 if i == j else 2) for i in range(n) for j in range(i + 1))
        spread = safe.sqrt((n - 1) * (n * second - first * first))
        return pin(least + jnp.where(whole, safe.divide(n, first + spread), 0))

    return safe.sqrt(jax.lax.fori_loop(0, STEPS, step, jnp.zeros_like(pin(jnp.asarray(gram[0][0])))))


def _gram(columns: Rows) -> Rows:
    """The lower triangle of J^T J."""

    def dot(u, v) -> Scalar:
        total: Scalar = 0.0
        for a, b in zip(u, v, strict=True):
            total = vector.plus(total, vector.times(a, b))
        return total if isinstance(total, int | float) else pin(total)

    return [[dot(columns[i], columns[j]) for j in range(i + 1)] for i in range(len(columns))]


def _factors(gram: Rows, shift: Scalar) -> tuple[Rows, list[Scalar]]:
    """L without its diagonal of ones, and D, of gram - shift = L D L^T."""
    lower: Rows = []
    pivots: list[Scalar] = []
    for i, row in enumerate(gram):
        scaled: list[Scalar] = []
        for j in range(i):
            entry = row[j]
            for k in range(j):
                entry = entry - scaled[k] * lower[j][k]
            scaled.append(entry)
        lower.append([pin(safe.divide(x, pivot)) for x, pivot in zip(scaled, pivots, strict=True)])
        pivot = row[i] - shift
        for x, y in zip(scaled, lower[i], strict=True):
            pivot = pivot - x * y
        pivots.append(pin(jnp.asarray(pivot)))
    return lower, pivots


def _inverse(lower: Rows, per_pivot: list[Scalar]) -> Rows:
    """The lower triangle of (L D L^T)^-1."""
    n = len(lower)
    # M = L^-1, its diagonal of ones left out.
    inverted: Rows = []
    for i in range(n):
        row: list[Scalar] = []
        for j in range(i):
            found = -lower[i][j]
            for k in range(j + 1, i):
                found = found - lower[i][k] * inverted[k][j]
            row.append(pin(found))
        inverted.append(row)

    def entry(i: int, j: int) -> Scalar:
        # M^T D^-1 M, of which rows from max(i, j) = i on count.
        total = per_pivot[i] * (1.0 if i == j else inverted[i][j])
        for k in range(i + 1, n):
            total = total + per_pivot[k] * inverted[k][i] * inverted[k][j]
        return pin(total)

    return [[entry(i, j) for j in range(i + 1)] for i in range(n)]


LARGEST = 8.0
"""Manipulabilities beyond are averaged as this."""


def unit_of_mean(slots: int, rolls: int) -> float:
    """What numbers are rounded to that are summed up for a mean: those of 32 goals fit 31 bits."""
    return 2.0 ** -min(20, 23 - math.ceil(math.log2(slots * rolls)))


def best(goal: Goal, what: str, inside: bool) -> jax.Array:
    """The greatest of a goal's solutions; 0 without one."""
    values = zip(_of_slots(goal, what), goal.flags(inside), strict=True)
    return functools.reduce(jnp.maximum, [jnp.where(flag, value, 0) for value, flag in values])


def total(goal: Goal, what: str, inside: bool, unit: float) -> jax.Array:
    """The sum over a goal's solutions, in whole units."""
    found = jnp.zeros(goal.shape, jnp.int32)
    for value, flag in zip(_of_slots(goal, what), goal.flags(inside), strict=True):
        units = jnp.round(jnp.minimum(value, LARGEST) / unit)
        found = found + jnp.where(flag, units, 0).astype(jnp.int32)
    return found


MEASURES = {"manipulability": manipulability, "sigma_min": sigma_min}


def _of_slots(goal: Goal, what: str) -> list[jax.Array]:
    """How well the arm moves at each slot, valid or not; computed once a goal."""

    def row(slot) -> list[jax.Array]:
        pairs = [(j.value,) if isinstance(j, Slide) else (j.sin, j.cos) for j in slot.joints]
        return [jnp.broadcast_to(x, goal.shape) for pair in pairs for x in pair]

    def measure(numbers: jax.Array) -> jax.Array:
        left = list(numbers)
        joints: list[Any] = []
        for joint in goal.slots[0].joints:
            if isinstance(joint, Slide):
                joints.append(Slide(left.pop(0)))
            else:
                joints.append(type(joint)(left.pop(0), left.pop(0), ()))
        with pinning(goal.pin):
            return MEASURES[what](jacobian_columns(goal.arm, tuple(joints)))

    if what not in goal.kept:
        goal.kept[what] = list(one_by_one(measure, jnp.stack([jnp.stack(row(slot)) for slot in goal.slots])))
    return goal.kept[what]


def best_limit_share(goal: Goal) -> jax.Array:
    """The greatest of a goal's solutions; -inf without one."""
    found = jnp.full(goal.shape, -jnp.inf, goal.slots[0].margin.dtype)
    for slot in goal.slots:
        found = jnp.where(slot.valid, jnp.maximum(found, distance(goal.arm, slot)), found)
    return found
