"""Why an arm has no closed form, and what would help: one line for an error message, or the full account.

Host side: it looks at the arm's numbers.
"""

import math
import re

import numpy as np

from ikjax.arm import dh
from ikjax.arm.arm import Arm
from ikjax.arm.axes_to_dh import Axes, rewritten, small_pose
from ikjax.arm.recognition import lock, recognize
from ikjax.arm.recognition.facts import Check
from ikjax.core.xla import is_traced

LADDER = ("1e-5", "1e-4", "1e-3", "0.01", "0.02")
"""Tolerances of `Arm.from_dh` and `Arm.from_urdf` that are tried, up to the largest that they take."""

SMALL = 1e-3
"""Up to this tolerance the first family in the order of the rules is preferred, which is the fastest; beyond
it, the least correction."""

_SHARE = ", share of the reach"
_REVERSED = "read from the tool to the base: "


def refusal(arm: Arm) -> str:
    """One line for an error message: the fact that fails and by how much, then what to do instead."""
    verdict = f"{arm.name} has no closed form here"
    remedy = "project() takes any arm"
    if is_traced(arm):
        return f"{verdict}. {remedy}; explain(arm) says why, outside jit"
    if ways := lock.choices(arm.n):
        if arm.coupling is not None:
            return f"{verdict}: of coupled joints none can be given. {remedy}"
        reasons = "; ".join(f"with {_names(arm, locked)} given, {_reason(arm, locked)}" for locked in ways)
        return f"{verdict}: {reasons}. {remedy}"
    families = _families(arm.kinds)
    if not families:
        return f"{verdict}: no family has joints {arm.kinds}. {remedy}"
    numbers, given = _numbers(arm), _axes(arm)
    loosened, nearest = _with_looser_tolerance(given, families), ""
    if loosened:
        family, off, tolerance = loosened
        remedy += f"; within {off:.2g} it is {family}: build it with axis_tolerance={tolerance}"
    else:
        family = _nearest_family(given, families)
        nearest = f"for {family}, the nearest, "
    failed = _failed(arm.kinds, numbers, family, recognize.tolerance_of(arm.dtype))
    if not failed:
        return f"{verdict}. {remedy}"
    more = f" (and {len(failed) - 1} more)" if len(failed) > 1 else ""
    worst = _in_words(max(failed, key=_distance), _size(numbers))
    return f"{verdict}: {nearest}{worst}{more}. {remedy}; explain(arm) says more"


def _families(kinds: str) -> list[str]:
    """The families that such joints may have."""
    return [name for name, rule in recognize.RULES.items() if re.fullmatch(rule.kinds, kinds)]


def _names(arm: Arm, locked: tuple[int, ...]) -> str:
    names = arm.joint_names or lock.numbered(arm.n)
    return " and ".join(names[i] for i in locked)


def _reason(arm: Arm, locked: tuple[int, ...]) -> str:
    """What keeps the joints between from the family that is nearest to them."""
    numbers, tolerance = _numbers(arm), recognize.tolerance_of(arm.dtype)
    kinds, inner = lock.inner(arm.kinds, numbers, locked)
    families = _families(kinds)
    if not families:
        return f"no family has joints {kinds}"
    failed = {name: _failed(kinds, inner, name, tolerance) for name in families}
    family = min(families, key=lambda name: sum(map(_distance, failed[name])))
    if not failed[family]:
        return f"the others are {family}, if the arm is built anew"
    worst = max(failed[family], key=_distance)
    words, first = _in_words(worst, _size(inner)), lock.between(arm.n, locked).start
    # The family counts from the first joint that is left.
    words = re.sub(r"\b\d\b(?=[, ])(?! mm| deg)", lambda digit: str(int(digit[0]) + first), words)
    return f"the others are not {family}: {words}"


def _with_looser_tolerance(given: Axes, families: list[str]) -> tuple[str, float, str] | None:
    """The family that a looser tolerance gives, by how much the arm is off it, and that tolerance."""
    best = None
    for tolerance in LADDER:
        if best and float(tolerance) > SMALL:
            break
        table = rewritten(given, float(tolerance))
        numbers = {**table.columns, "tool": table.tool}
        family = recognize.recognize(given.kinds, numbers).family
        if family and (not best or families.index(family) < families.index(best[0])):
            shift, turn = np.abs(table.correction[:, :3]).max(), np.abs(table.correction[:, 3:]).max()
            best = family, max(float(turn), float(shift) / _size(numbers)), tolerance
    return best


def _nearest_family(given: Axes, families: list[str]) -> str:
    """The family with the least sum of deviations, over the facts that fail even at the largest tolerance."""
    table = rewritten(given, float(LADDER[-1]))
    numbers = {**table.columns, "tool": table.tool}
    failed = {name: _failed(given.kinds, numbers, name, float(LADDER[-1])) for name in families}
    return min(families, key=lambda name: sum(map(_distance, failed[name])))


def what_was_found(arm: Arm) -> str:
    """The arm's axes in words, and for each family why it is not this one."""
    if is_traced(arm):
        return "Families: " + ", ".join(recognize.RULES)
    numbers, tolerance = _numbers(arm), recognize.tolerance_of(arm.dtype)
    lines = [
        f"Found: joints {arm.kinds}; {recognize.describe_axes(arm.kinds, numbers, tolerance)}.",
        "Families:",
    ]
    for name, rule in recognize.RULES.items():
        lines.append(f"  {name}: {rule.summary}.")
        if not re.fullmatch(rule.kinds, arm.kinds):
            lines.append(f"    Not this arm: it wants joints {rule.joints}.")
            continue
        failed = _failed(arm.kinds, numbers, name, tolerance)
        facts = "; ".join(_in_words(check, _size(numbers)) for check in failed)
        lines.append(f"    {'Not this arm: ' + facts if facts else 'This arm, if it is built anew'}.")
    return "\n".join(lines)


def _numbers(arm: Arm) -> dict[str, np.ndarray]:
    """The arm's DH table and tool."""
    return {key: np.asarray(getattr(arm, key), float) for key in ("a", "alpha", "d", "theta", "tool")}


def _axes(arm: Arm) -> Axes:
    """The axes of the arm as given, without its base."""
    numbers = _numbers(arm)
    frames = dh.frames(numbers)
    links = np.linalg.inv(frames[:-1]) @ frames[1:]
    correction = np.zeros((arm.n + 1, 6)) if arm.correction is None else np.asarray(arm.correction, float)
    corrections = list(map(small_pose, correction))
    given = [corrections[0]]
    for link, correction_after in zip(links, corrections[1:], strict=True):
        given.append(given[-1] @ link @ correction_after)
    frames = np.stack(given)
    return Axes(arm.kinds, frames[:-1, :3, 2], frames[:-1, :3, 3], given[-1] @ numbers["tool"])


def _size(numbers: dict[str, np.ndarray]) -> float:
    """The sum of the lengths in the table [m], which lengths among the facts are shares of."""
    return max(float(np.abs(numbers["a"]).sum() + np.abs(numbers["d"]).sum()), 1e-300)


def _failed(kinds: str, numbers: dict, family: str, tolerance: float) -> list[Check]:
    """The facts of a family that do not hold."""
    return [check for check in recognize.evidence(kinds, numbers, family, tolerance) if not check.holds]


def _distance(check: Check) -> float:
    """How far a fact is from holding, in [0, 1]; what is degenerate counts as 1."""
    return 1.0 if check.wanted.startswith(">") else min(check.deviation, 1.0)


def _in_words(check: Check, size: float) -> str:
    """A fact that fails, in millimetres or degrees: "axes 5 and 6 are 76 mm apart"."""
    fact, length = check.fact.removesuffix(_SHARE), check.fact.endswith(_SHARE)
    if fact.startswith(_REVERSED):
        fact = fact.removeprefix(_REVERSED)
        if fact.startswith(("ax", "a4", "a5", "d5")):
            head, equals, meaning = fact.partition(" = 0 ")
            meaning = re.sub(r"\b\d\b", lambda digit: str(7 - int(digit[0])), meaning if equals else head)
            fact = f"{head} = 0 {meaning}" if equals else meaning
    if length:
        amount = f"{1000 * check.deviation * size:.3g} mm"
    elif check.wanted.startswith(">"):
        return f"{fact}: {check.deviation:.2g}, wanted {check.wanted}"
    else:
        amount = f"{math.degrees(math.asin(min(check.deviation, 1.0))):.3g} deg"
    if meet := re.search(r" = 0 \((ax.*) meet( in one point)?\)$", fact):
        return f"{meet[1]} {f'miss one point by {amount}' if meet[2] else f'are {amount} apart'}"
    if angle := re.match(r"(ax[ie]s \d[\d, ]*) (parallel|perpendicular)(.*)", fact):
        are = "are" if fact.startswith("axes") else "is"
        return f"{angle[1]} {are} {amount} from {angle[2]}{angle[3]}"
    return f"{fact}: {amount}"
