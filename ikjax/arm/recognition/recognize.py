"""Which closed form an arm has: its table is checked against the rule of each family, in order.

The facts are measured once, from concrete numbers, when the arm is built.
"""

import re
from typing import NamedTuple

import jax
import numpy as np

from ikjax.arm.axes_to_dh import small_pose, twist_of
from ikjax.arm.recognition import lock
from ikjax.arm.recognition.facts import Check, Table
from ikjax.arm.recognition.rules import RULES, Judgement, nearly_split
from ikjax.core.tolerances import FACT
from ikjax.core.xla import is_traced


def tolerance_of(dtype) -> float:
    """The tolerance of facts for numbers that have been rounded to a type."""
    return max(FACT, 8 * float(np.finfo(dtype).eps))


class Verdict(NamedTuple):
    """The family of an arm, with what the arm stores of it; fields as in `Arm`."""

    family: str | None
    signs: tuple
    branches: tuple[str, ...]
    task: str
    evidence: dict[str, tuple[Check, ...]]
    """The checks of every family that was tried, in order."""
    locked: tuple[int, ...] = ()


NONE = Verdict(None, (), (), "pose", {})
"""No family was looked for."""


def recognize(
    kinds: str,
    numbers: dict,
    family: str | None = None,
    up: int = 1,
    tolerance: float = FACT,
    locked: tuple[int, ...] | None = None,
) -> Verdict:
    """The first family whose facts all hold.

    Of more than six joints, some at the ends are locked, and the others are recognized: as the family that
    comes first in the order of the rules, over all ways to lock.

    Args:
        kinds: The joints, "R" or "P" each.
        numbers: Standard DH columns `a, alpha, d`, and `theta` and `tool` where they are not zero and
            identity; lengths may be traced if `family` is given.
        family: The only family to try.
        up: +1 when axis 1 points up, -1 when down: what a branch calls up.
        tolerance: How far a fact may be off.
        locked: The joints to lock, counted from 0; by default every way is tried.

    Raises:
        ValueError: A traced twist, a traced length without `family`, an unknown family, or a
            named family whose facts do not hold.
    """
    if isinstance(numbers["alpha"], jax.core.Tracer):
        raise ValueError(
            "alpha must be concrete numbers when an arm is built: the family is decided from them. "
            "Build the arm outside jit and vary it with dataclasses.replace(arm, alpha=...)"
        )
    traced = any(isinstance(numbers[key], jax.core.Tracer) for key in ("a", "d"))
    if traced and family is None:
        raise ValueError("from_dh with traced lengths needs family=, one of " + ", ".join(RULES))
    if family is not None and family not in RULES:
        raise ValueError(f"family must be one of {', '.join(RULES)}, got {family!r}")
    ways = lock.choices(len(kinds)) if locked is None else [locked]
    best = Verdict(None, (), (), "pose", {})
    rank = len(RULES)
    for way in ways or [()]:
        solved, columns = lock.inner(kinds, numbers, way)
        direction = lock.inner_up(kinds, numbers, way, up)
        verdict = _first_family(solved, columns, family, direction, tolerance)._replace(locked=way)
        place = rank if verdict.family is None else list(RULES).index(verdict.family)
        if place < rank or not best.evidence:
            best, rank = verdict, place
    if best.family is None:
        if family is not None:
            raise ValueError(f"the arm is not of family {family}: {describe(best.evidence[family])}")
        return best._replace(locked=())
    return best


def _first_family(kinds: str, numbers: dict, family: str | None, up: int, tolerance: float) -> Verdict:
    """The first family that fits all joints of a table; arguments as in `recognize`."""
    table = _table(kinds, numbers, up, tolerance)
    seen: dict[str, tuple[Check, ...]] = {}
    for name, rule in RULES.items():
        if family not in (None, name):
            continue
        if not re.fullmatch(rule.kinds, kinds):
            seen[name] = (Check(f"it wants joints {rule.joints}", np.inf, False),)
            continue
        checks, signs, branches = rule.judge(table)
        seen[name] = tuple(checks)
        if all(check.holds for check in checks):
            return Verdict(name, signs, branches, rule.task, seen)
    return Verdict(None, (), (), "pose", seen)


def evidence(
    kinds: str, numbers: dict, family: str, tolerance: float, locked: tuple[int, ...] = ()
) -> tuple[Check, ...]:
    """The checks of one family, whether they hold or not; arguments as in `recognize`."""
    return tuple(judged(kinds, numbers, family, tolerance, locked)[0])


def judged(
    kinds: str, numbers: dict, family: str, tolerance: float, locked: tuple[int, ...] = ()
) -> Judgement:
    """What the rule of a family says of a table, also if it does not fit; arguments as in `recognize`."""
    return RULES[family].judge(_table(*lock.inner(kinds, numbers, locked), 1, tolerance))


def split_exactly(kinds: str, leaves: dict, verdict: Verdict) -> dict:
    """The leaves with the number made exact that alone keeps the family's equation from splitting.

    Without this the roots of the quartic would come in pairs that are closer than rounding. What the number
    is changed by goes into the correction of its link, so that the arm stays the one that was given.
    """
    if verdict.family is None or any(is_traced(leaves[key]) for key in ("a", "alpha", "d", "correction")):
        return leaves
    change = nearly_split(_table(*lock.inner(kinds, leaves, verdict.locked), 1, FACT), verdict.family)
    if change is None:
        return leaves
    name, place, value = change
    place += lock.between(len(kinds), verdict.locked).start
    column, off = np.array(leaves[name], float), np.zeros((len(kinds) + 1, 6))
    if leaves["correction"] is not None:
        off = np.array(leaves["correction"], float)
    # Tx(a) Rx(alpha) is that of the exact number, followed by a small shift along x or rotation about it.
    rest = np.zeros(6)
    rest[0 if name == "a" else 3] = column[place] - value
    off[place + 1] = twist_of(small_pose(rest) @ small_pose(off[place + 1]))
    column[place] = value
    return {**leaves, name: column, "correction": off}


def _table(kinds: str, numbers: dict, up: int, tolerance: float) -> Table:
    traced = any(isinstance(numbers[key], jax.core.Tracer) for key in ("a", "d"))
    zeros = np.zeros(len(kinds))

    def column(name):
        value = numbers.get(name, zeros)
        return zeros if isinstance(value, jax.core.Tracer) else np.asarray(value, float)

    alpha = column("alpha")
    lengths = {"a": zeros, "d": zeros} if traced else {"a": column("a"), "d": column("d")}
    return Table(
        kinds=kinds,
        sin=np.sin(alpha),
        cos=np.cos(alpha),
        **lengths,
        theta=column("theta"),
        tool=_tool_point(numbers),
        promised=traced,
        tolerance=tolerance,
        up=up,
    )


def _tool_point(numbers: dict) -> np.ndarray:
    tool = numbers.get("tool", np.eye(4))
    return np.zeros(3) if isinstance(tool, jax.core.Tracer) else np.asarray(tool, float)[:3, 3]


def describe(checks: tuple[Check, ...]) -> str:
    """The facts that do not hold, with their measured deviations."""
    failed = [c for c in checks if not c.holds]
    if len(failed) == 1 and np.isinf(failed[0].deviation):
        return failed[0].fact
    return "; ".join(f"{c.fact}: {c.deviation:.3g}, wanted {c.wanted}" for c in failed)


def describe_axes(kinds: str, numbers: dict, tolerance: float = FACT) -> str:
    """Which neighboring axes are parallel, perpendicular or meeting, in words."""
    alpha, a = np.asarray(numbers["alpha"], float), np.asarray(numbers["a"], float)
    size = max(float(np.abs(a).sum() + np.abs(np.asarray(numbers["d"], float)).sum()), 1e-300)
    words = []
    for i in range(len(kinds) - 1):
        pair = f"{i + 1}-{i + 2}"
        meets = "meet" if abs(a[i]) <= tolerance * size else f"{abs(a[i]):.4g} m apart"
        if abs(np.sin(alpha[i])) <= tolerance:
            line = "coincide" if meets == "meet" else f"parallel, {meets}"
        elif abs(np.cos(alpha[i])) <= tolerance:
            line = f"perpendicular, {meets}"
        else:
            line = f"{np.degrees(alpha[i]):.4g} deg, {meets}"
        words.append(f"axes {pair} {line}")
    return "; ".join(words) if words else "one joint"
