"""`check_goals`: are these goals poses? `explain`: how is this arm solved?

Host side: both look at values.
"""

import math

import jax
import numpy as np
from jax.typing import ArrayLike

from ikjax.arm.arm import Arm
from ikjax.arm.forward import reach, whole_turns
from ikjax.arm.recognition import lock, recognize
from ikjax.core.pose import HasMatrix
from ikjax.core.tolerances import MILLIMETRES, NEARLY_ROTATION, ROTATION, VALID
from ikjax.core.warn import warn
from ikjax.ik.refusal import refusal, what_was_found
from ikjax.ik.select import within_limits
from ikjax.ik.solve import as_goals, solve
from ikjax.solvers.families import FAMILIES
from ikjax.solvers.pipeline import as_solved

MOST_NAMED = 20
"""Goals that an error names, at most."""


def check_goals(arm: Arm, goals: ArrayLike) -> None:
    """Raise unless every goal is a pose; `solve` would mask those that are not.

    Args:
        arm: The arm.
        goals: T_world_tool, (..., 4, 4).

    Raises:
        ValueError: Naming the goals (up to twenty) that are not finite, whose bottom row is not (0, 0, 0, 1),
            or whose rotation is off by more than 1e-5, with what was found. Also inside jit, vmap or grad.

    Warns:
        Where a goal is more than ten reaches from the base, as one in millimetres is.
    """
    if isinstance(goals, jax.core.Tracer):
        raise ValueError("check_goals looks at values, so it cannot stand inside jit, vmap or grad")
    matrices = np.asarray(as_goals(goals), float)
    flat, batch = matrices.reshape(-1, 4, 4), matrices.shape[:-2]

    def first(bad: np.ndarray, named: bool = True) -> tuple[str, np.ndarray]:
        """The name of the first bad goal, with those of the others or their number, and the goal."""
        found = np.flatnonzero(bad)
        names = [str(list(map(int, np.unravel_index(i, batch)))) if batch else "" for i in found[:MOST_NAMED]]
        rest = [*names[1:], *(["..."] if len(found) > MOST_NAMED else [])]
        listed = f": {', '.join(rest)}" if named else ""
        others = f" (and {len(found) - 1} more{listed})" if len(found) > 1 else ""
        return f"goals{names[0]}{others}", flat[found[0]]

    bad = ~np.isfinite(flat).all((1, 2))
    if bad.any():
        name, goal = first(bad)
        raise ValueError(f"{name} must hold finite numbers, got\n{goal}")
    bad = (flat[:, 3] != (0, 0, 0, 1)).any(1)
    if bad.any():
        name, goal = first(bad)
        hint = ": transposed?" if np.any(goal[3, :3]) else ""
        raise ValueError(f"{name} must have bottom row (0, 0, 0, 1), got {goal[3]}{hint}")
    rotation = flat[:, :3, :3]
    with np.errstate(over="ignore", invalid="ignore"):  # entries of 1e308, for example, overflow
        error = np.linalg.norm(np.swapaxes(rotation, 1, 2) @ rotation - np.eye(3), axis=(1, 2))
    bad = ~(error <= ROTATION)
    if bad.any():
        name, _ = first(bad)
        rounded = error[bad][0] <= NEARLY_ROTATION
        remedy = ": take the nearest with pose(matrix=..., orthonormalize=True)" if rounded else ""
        raise ValueError(f"{name} must hold a rotation, its R^T R - I has norm {error[bad][0]:.1g}{remedy}")
    bad = np.linalg.det(rotation) < 0
    if bad.any():
        name, _ = first(bad)
        raise ValueError(f"{name} must hold a rotation, got a reflection (determinant -1)")
    size = float(reach(arm.baked()))
    distance = np.linalg.norm(flat[:, :3, 3] - np.asarray(arm.base, float)[:3, 3], axis=1)
    far = distance > MILLIMETRES * size
    if far.any() and size > 0:
        name, _ = first(far, named=False)
        warn(
            f"{name} lies {distance[far][0]:.4g} m from the base, the arm reaches {size:.3g} m: "
            "are these millimetres?"
        )


_NEAREST_IS_CLOSED_FORM = (
    "project starts from each branch with the goal's point held and the nearest orientation that allows; "
    "with limits also with joint 2 or 4 at one, or joint 5 beyond its gap; that the best of where they "
    "lead is the nearest of all poses was measured on samples, not proved."
)
_MINIMUM_IS_LOCAL = (
    "no small move improves where they end; that it is the nearest of all poses is not proved."
)
_CLAMPED = (
    "project starts from each branch, clamped where it does not reach, and from 28 fixed joints where poses "
    f"are asked for or limits set: {_MINIMUM_IS_LOCAL}"
)
_SCATTERED = f"project starts from 64 fixed joints spread over the limits: {_MINIMUM_IS_LOCAL}"


def _explained(arm: Arm, goal, redundancy, q_now) -> str:
    """What every branch of one goal needs."""
    check_goals(arm, goal)
    pose = as_goals(goal)
    if pose.ndim != 2:
        raise ValueError(f"explain takes one goal (4, 4), got {pose.shape}")
    sol = solve(arm, pose, q_now=q_now, redundancy=redundancy)
    inside = within_limits(arm, sol, q_now)
    valid, within = np.asarray(sol.valid), np.asarray(inside.valid)
    x, y, z = np.asarray(pose, float)[:3, 3]
    lines = [
        f"{arm.name} at ({x:g}, {y:g}, {z:g}) m: {valid.sum()} of {valid.size} branches reach the goal, "
        f"{within.sum()} within the limits."
    ]
    for k, name in enumerate(arm.branches):
        if not valid[k]:
            words = f"out of reach, {_length(-float(sol.margin[k]))} from its fold"
        elif within[k]:
            words = f"within the limits, {_closest_limit(arm, np.asarray(inside.q[k], float))}"
        else:
            words = _beyond(arm, np.asarray(sol.q[k], float))
        lines.append(f"  branch {k}, {name}: {words}")
    return "\n".join(lines)


def _length(meters: float) -> str:
    return f"{1000 * meters:.3g} mm"


def _joint(arm: Arm, i: int, value: float) -> str:
    """A value or a difference of a joint."""
    return f"{math.degrees(value):.4g} deg" if arm.kinds[i] == "R" else f"{1000 * value:.4g} mm"


def _joint_name(arm: Arm, i: int) -> str:
    return f"q{i + 1}" if arm.joint_names is None else f"q{i + 1} ({arm.joint_names[i]})"


def _excess(arm: Arm, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The joints (n,) at the whole turns that are nearest to their limits, and how far beyond they are.

    Inside it is negative: minus the distance from the nearer limit.
    """
    lower, upper = np.asarray(arm.limits, float).T
    whole = np.array([bool(flag) for flag in whole_turns(arm.baked())])
    turns = 2 * np.pi * np.arange(-4, 5)[:, None] * whole
    values = q + turns
    beyond = np.maximum(lower - values, values - upper)
    best = beyond.argmin(0)
    columns = np.arange(len(q))
    return values[best, columns], beyond[best, columns]


def _beyond(arm: Arm, q: np.ndarray) -> str:
    values, beyond = _excess(arm, q)
    wrong = [i for i in range(arm.n) if beyond[i] > 0]
    # What rounding alone puts beyond a limit is the joint that comes nearest to one.
    wrong = wrong or [int(np.argmax(beyond))]
    parts = [
        f"{_joint_name(arm, i)} = {_joint(arm, i, values[i])}, {_joint(arm, i, beyond[i])} beyond its limit"
        for i in wrong
    ]
    return f"needs {'; and '.join(parts)}"


def _closest_limit(arm: Arm, q: np.ndarray) -> str:
    room = -np.maximum(*(np.asarray(arm.limits, float).T - q) * [[1], [-1]])
    if not np.isfinite(room).any():
        return "which no joint has"
    i = int(np.argmin(room))
    return f"{_joint_name(arm, i)} the nearest to one, by {_joint(arm, i, max(room[i], 0.0))}"


def _other_locks(arm: Arm) -> list[str]:
    """What other redundant joints would leave."""
    if not arm.locked:
        return []
    names = arm.joint_names or lock.numbered(arm.n)
    numbers = {key: np.asarray(getattr(arm, key)) for key in ("a", "alpha", "d", "theta")}
    lines = ["The joints between are six, counted from the first of them in what follows. Instead:"]
    for locked in lock.choices(arm.n):
        if locked == arm.locked:
            continue
        family = recognize.recognize(
            arm.kinds, numbers, tolerance=recognize.tolerance_of(arm.dtype), locked=locked
        ).family
        given = " and ".join(names[i] for i in locked)
        lines.append(f"  {given} given: {family or 'no closed form here'}")
    return lines


def explain(
    arm: Arm,
    goal: ArrayLike | HasMatrix | None = None,
    *,
    redundancy: ArrayLike | None = None,
    q_now: ArrayLike | None = None,
) -> str:
    """Which closed form solves the arm, why, and what its branches are; or what keeps it from a goal.

    For an arm without a closed form: why there is none, and what would help. Host side.

    Args:
        arm: The arm.
        goal: T_world_tool, (4, 4). With it the text has a line for each branch instead: within the limits and
            how far from them, or which joints would have to be where and how far that is beyond their limits,
            or how far the branch is from its fold.
        redundancy: Values of redundant joints, as in `solve`.
        q_now: Present joints, as in `solve`.

    Returns:
        Text to print. Angles are in degrees, lengths in millimetres.

    Raises:
        ValueError: A goal that is no pose, or an arm without a closed form with a goal.
    """
    if goal is not None:
        return _explained(arm, goal, redundancy, q_now)
    if redundancy is not None or q_now is not None:
        raise ValueError("redundancy and q_now go with a goal")
    if arm.family is None:
        return f"{refusal(arm)}.\n{what_was_found(arm)}\n{_SCATTERED}"
    rule = recognize.RULES[arm.family]
    given = f", {' and '.join(arm.redundant)} given" if arm.locked else ""
    lines = [f"{arm.name} is solved by {arm.family}{given}: {rule.summary}.", *_other_locks(arm), "Because:"]
    numbers = {key: np.asarray(getattr(arm, key)) for key in ("a", "alpha", "d", "theta", "tool")}
    tolerance = recognize.tolerance_of(arm.dtype)
    checks = recognize.evidence(arm.kinds, numbers, arm.family, tolerance, arm.locked)
    for check in checks:
        mark = "yes" if check.holds else "NO"
        lines.append(f"  {mark:3} {check.fact}: {check.deviation:.2g}")
    if arm.correction is not None:
        off = np.abs(np.asarray(arm.correction, float))
        lines.append(
            f"As given, its axes are off by up to {off[:, 3:].max():.2g} rad and {off[:, :3].max():.2g} m; "
            "solve answers for the arm as given."
        )
        unnoticed = [name for name in VALID if as_solved(arm.astype(name)).correction is None]
        if unnoticed:
            lines.append(
                f"In {' and '.join(unnoticed)} that is less than a hundredth of what `valid` allows, and is "
                "left out."
            )
    if not arm.complete:
        lines.append("complete = False: beside its folds the arm as given may have solutions in no slot.")
    if arm.coupling is not None:
        lines.append("Joints are coupled: q holds motor values.")
    nearest = _NEAREST_IS_CLOSED_FORM if FAMILIES[arm.family].nearest else _CLAMPED
    lines.append(_SCATTERED if arm.locked else nearest)
    lines.append(f"Branches ({len(arm.branches)}):")
    lines += [f"  {slot}  {name}" for slot, name in enumerate(arm.branches)]
    return "\n".join(lines)
