"""Statistics that need the joints of solutions: manipulability, least singular value, distance to limits.

They run in a pass whose values are pinned, many times slower than a pass of flags alone.

The Jacobian is that of the tool in the world frame. Its linear rows are divided by the reach and the columns
of prismatic joints multiplied by it, so that both measures have no unit and do not depend on the arm's size.
An arm whose task has fewer coordinates than it has joints would have only the rows of its task; an arm with
fewer joints than coordinates has a tall Jacobian, one with more has a wide one, of which the transpose is
taken.
Source: Yoshikawa, Manipulability of robotic mechanisms, IJRR 4 (1985).
"""

import functools
import math
from typing import Any

import jax
import jax.numpy as jnp

from ikjax.arm.arm import Arm
from ikjax.arm.forward import Chain, Joint, advance, fixed_pose, links, reach
from ikjax.arm.twists import Twist, motor_twists
from ikjax.core import pose as poses
from ikjax.core import safe, singular, vector
from ikjax.core.trig import Scalar
from ikjax.core.xla import one_by_one, pin, pinning
from ikjax.maps.kernel.flags import limit_share
from ikjax.maps.kernel.sample import Goal
from ikjax.solvers.context import Joints, Slide
from ikjax.solvers.pipeline import TURNING

Rows = list[list[Scalar]]
"""A matrix of scalars: a list of its rows, or of its columns where the name says so."""

STEPS = 6
"""Iterations of Laguerre's method for the least eigenvalue; near it each triples the number of digits."""


def jacobian_columns(arm: Arm, joints: Joints, tool: poses.Pose, size: Scalar) -> Rows:
    """Columns of the Jacobian in units of the reach.

    Args:
        arm: A baked arm.
        joints: Of one slot; a prismatic one in units of the reach of `arm`.
        tool: In the frame of the last link.
        size: The reach of the arm with this tool [m].

    Returns:
        n columns of six entries, linear before angular; of three for a task of positions.
    """
    unit = reach(arm)
    frame, frames_before = fixed_pose(arm.base), []
    for link, joint in zip(links(arm), joints, strict=True):
        frames_before.append(frame)
        if isinstance(joint, Slide):
            sine, cosine = math.sin(link.theta), math.cos(link.theta)
            moved = Joint(sine, cosine, link.d + unit * joint.value)
        else:
            moved = Joint(joint.sin, joint.cos, link.d)
        frame = _pinned_pose(advance(frame, link, moved))
    tip = poses.compose(frame, tool).position
    twists = motor_twists(arm, Chain(frames_before, frames_before, frame), tip)
    return [_column(arm, kind, twist, size) for kind, twist in zip(arm.kinds, twists, strict=True)]


def _pinned(x: Scalar) -> Scalar:
    """`pin`, but a number that is known while tracing stays known."""
    return x if isinstance(x, int | float) else pin(x)


def _pinned_pose(frame: poses.Pose) -> poses.Pose:
    rotation = tuple(tuple(map(_pinned, row)) for row in frame.rotation)
    return poses.Pose(rotation, tuple(map(_pinned, frame.position)))


def _column(arm: Arm, kind: str, twist: Twist, size: Scalar) -> list[Scalar]:
    """A joint's twist in units of the reach `size` [m]; `kind` is "R" or "P"."""
    linear_unit = 1.0 if kind == "P" else 1 / size
    entries = [vector.times(linear_unit, x) for x in twist.linear]
    if arm.task in TURNING:
        entries += [vector.times(size if kind == "P" else 1.0, x) for x in twist.angular]
    return [_pinned(x) for x in entries]


def manipulability(columns: Rows) -> Scalar:
    """Yoshikawa's manipulability: |det J| of a square Jacobian, sqrt(det J^T J) of a tall one.

    Args:
        columns: From `jacobian_columns`.
    """
    return singular.volume([tuple(map(jnp.asarray, column)) for column in _tall(columns)])


def sigma_min(columns: Rows) -> Scalar:
    """The least singular value of the Jacobian.

    It is the root of the least eigenvalue of J^T J, found by Laguerre's method. The iteration starts at zero,
    approaches the eigenvalue from below, and never passes it. Values below the square root of the type's
    rounding are noise, and may be zero. `core.singular` is exact there, but a sweep of a PUMA 560 would be
    2.7 times slower.

    Args:
        columns: From `jacobian_columns`.

    Source: Parlett, Laguerre's method applied to the matrix eigenvalue problem, Math. Comp. 18 (1964).
    """
    gram = _gram(_tall(columns))
    n = len(gram)

    def step(_, least):
        lower, pivots = _ldl_factors(gram, least)
        # A pivot that is not positive: the iterate is the eigenvalue up to rounding, so it stays.
        definite = jnp.asarray(True)
        for pivot in pivots:
            definite = definite & (pivot > 0)
        inverse = _ldl_inverse(lower, [safe.divide(1, jnp.where(definite, pivot, 1)) for pivot in pivots])
        # Laguerre's sums over all eigenvalues: traces of (J^T J - least)^-1 and of its square.
        first = sum(inverse[i][i] for i in range(n))
        second = sum(inverse[i][j] ** 2 * (1 if i == j else 2) for i in range(n) for j in range(i + 1))
        spread = safe.sqrt((n - 1) * (n * second - first * first))
        return pin(least + jnp.where(definite, safe.divide(n, first + spread), 0))

    return safe.sqrt(jax.lax.fori_loop(0, STEPS, step, jnp.zeros_like(pin(jnp.asarray(gram[0][0])))))


def _tall(columns: Rows) -> Rows:
    """The columns, or those of the transpose where there are more of them than rows."""
    return columns if len(columns) <= len(columns[0]) else [list(row) for row in zip(*columns, strict=True)]


def _gram(columns: Rows) -> Rows:
    """The lower triangle of J^T J, as its rows."""

    def dot(u, v) -> Scalar:
        total: Scalar = 0.0
        for a, b in zip(u, v, strict=True):
            total = vector.plus(total, vector.times(a, b))
        return _pinned(total)

    return [[dot(columns[i], columns[j]) for j in range(i + 1)] for i in range(len(columns))]


def _ldl_factors(gram: Rows, shift: Scalar) -> tuple[Rows, list[Scalar]]:
    """L without its diagonal of ones, and the diagonal of D, of gram - shift * I = L D L^T."""
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


def _ldl_inverse(lower: Rows, per_pivot: list[Scalar]) -> Rows:
    """The lower triangle of (L D L^T)^-1, of L and the reciprocals of D."""
    n = len(lower)
    # M = L^-1, its diagonal of ones left out.
    inverted: Rows = []
    for i in range(n):
        row: list[Scalar] = []
        for j in range(i):
            entry_below = -lower[i][j]
            for k in range(j + 1, i):
                entry_below = entry_below - lower[i][k] * inverted[k][j]
            row.append(pin(entry_below))
        inverted.append(row)

    def entry(i: int, j: int) -> Scalar:
        # Of M^T D^-1 M. M is lower triangular, so the sum begins at max(i, j) = i.
        total = per_pivot[i] * (1.0 if i == j else inverted[i][j])
        for k in range(i + 1, n):
            total = total + per_pivot[k] * inverted[k][i] * inverted[k][j]
        return pin(total)

    return [[entry(i, j) for j in range(i + 1)] for i in range(n)]


LARGEST = 8.0
"""Larger values are averaged as this."""


def unit_of_mean(slots: int, trials: int) -> float:
    """The unit to which values are rounded before they are summed for a mean: sums of 32 goals fit 31 bits.

    Args:
        slots: Of the arm.
        trials: Of each goal.
    """
    return 2.0 ** -min(20, 23 - math.ceil(math.log2(slots * trials)))


def best_of_slots(goal: Goal, what: str, inside: bool) -> jax.Array:
    """The greatest value among a goal's solutions; 0 without a solution.

    Args:
        goal: (positions, orientations)
        what: A name in `MEASURES`.
        inside: Only solutions within the joint limits count.

    Returns:
        (positions, orientations) in the kernel's type.
    """
    values = zip(_measure_at_slots(goal, what), goal.flags(inside), strict=True)
    return functools.reduce(jnp.maximum, [jnp.where(flag, value, 0) for value, flag in values])


def sum_of_slots(goal: Goal, what: str, inside: bool, unit: float) -> jax.Array:
    """The sum of values over a goal's solutions, each rounded to whole units.

    Args:
        goal: (positions, orientations)
        what: A name in `MEASURES`.
        inside: Only solutions within the joint limits count.
        unit: From `unit_of_mean`.

    Returns:
        (positions, orientations) int32.
    """
    units = jnp.zeros(goal.shape, jnp.int32)
    for value, flag in zip(_measure_at_slots(goal, what), goal.flags(inside), strict=True):
        rounded = jnp.round(jnp.minimum(value, LARGEST) / unit)
        units = units + jnp.where(flag, rounded, 0).astype(jnp.int32)
    return units


MEASURES = {"manipulability": manipulability, "sigma_min": sigma_min}


def _measure_at_slots(goal: Goal, what: str) -> list[jax.Array]:
    """The measure of that name at each slot, valid or not; computed once a goal."""

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
            return MEASURES[what](jacobian_columns(goal.arm, tuple(joints), goal.tool_pose, goal.whole_reach))

    if what not in goal.cache:
        goal.cache[what] = list(one_by_one(measure, jnp.stack([jnp.stack(row(slot)) for slot in goal.slots])))
    return goal.cache[what]


def best_limit_share(goal: Goal) -> jax.Array:
    """The greatest `limit_share` among a goal's solutions, (positions, orientations); -inf without one."""
    greatest = jnp.full(goal.shape, -jnp.inf, goal.slots[0].margin.dtype)
    for slot in goal.slots:
        greatest = jnp.where(
            slot.valid, jnp.maximum(greatest, limit_share(goal.arm, slot, goal.limits)), greatest
        )
    return greatest
