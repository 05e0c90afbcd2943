"""Which closed form an arm has: facts about its axes, measured once from concrete numbers.

Storey: arm. `RULES` is the ordered list of families an arm is tried against; `solvers.FAMILIES`
holds the kernel of each.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax
import numpy as np

TOLERANCE = 1e-10
"""How far [rad, or as a share of the reach] a fact may be off and still hold.

Well below the 1e-9 that `valid` allows, so that an arm that is recognised can be solved.
"""


def tolerance_of(dtype) -> float:
    """The tolerance for numbers that have been rounded to a type."""
    return max(TOLERANCE, 8 * float(np.finfo(dtype).eps))


class Check(NamedTuple):
    """One fact a family asks for, and how far the arm is from it."""

    fact: str
    deviation: float
    holds: bool
    wanted: str = ""
    """The threshold, as text."""


class Verdict(NamedTuple):
    family: str | None
    signs: tuple[int, ...]
    branches: tuple[str, ...]
    evidence: dict[str, tuple[Check, ...]]
    """Every family tried, with its checks, in order."""


class Table(NamedTuple):
    """Concrete twists, and lengths that are only promised while they are traced."""

    sin: np.ndarray
    cos: np.ndarray
    a: np.ndarray
    d: np.ndarray
    promised: bool
    """The lengths are traced: `a` and `d` are not looked at, the family is taken at its word."""
    tolerance: float
    up: int
    """+1 when axis 1 points up in the world the arm is built into, -1 when down."""

    @property
    def size(self) -> float:
        """Rough reach of the arm [m], the scale of every length."""
        return max(float(np.abs(self.a).sum() + np.abs(self.d).sum()), 1e-300)

    @property
    def at_most(self) -> str:
        return f"<= {self.tolerance:.2g}"

    def perpendicular(self, i: int) -> Check:
        """Axis i against axis i + 1, counted from 1."""
        off = float(abs(self.cos[i - 1]))
        return Check(f"axis {i} perpendicular to axis {i + 1}", off, off <= self.tolerance, self.at_most)

    def parallel(self, i: int) -> Check:
        off = float(abs(self.sin[i - 1]))
        return Check(f"axis {i} parallel to axis {i + 1}", off, off <= self.tolerance, self.at_most)

    def not_parallel(self, i: int) -> Check:
        off = float(abs(self.sin[i - 1]))
        return Check(
            f"axis {i} not parallel to axis {i + 1}, sine of their angle", off, off > 1e-3, "> 0.001"
        )

    def zero(self, name: str, i: int, meaning: str) -> Check:
        """A length of the table is zero."""
        off = float(abs(getattr(self, name)[i - 1])) / self.size
        return self._length(f"{name}{i} = 0 ({meaning})", off, off <= self.tolerance, self.at_most)

    def apart(self, what: str, distance: float) -> Check:
        """A distance is not zero."""
        off = float(abs(distance)) / self.size
        return self._length(what, off, off > 1e-6, "> 1e-06")

    def _length(self, fact: str, off: float, holds: bool, wanted: str) -> Check:
        if self.promised:
            return Check(f"{fact}, promised", 0.0, True)
        return Check(f"{fact}, share of the reach", off, holds, wanted)


def _sign(x: float) -> int:
    return -1 if x < 0 else 1


def _slots(*bits: tuple[str, str]) -> tuple[str, ...]:
    """Names of the slots: bit k of the slot's number picks from the k-th pair."""
    return tuple(
        "/".join(pair[slot >> k & 1] for k, pair in enumerate(bits)) for slot in range(2 ** len(bits))
    )


SHOULDER, ELBOW, WRIST = ("front", "back"), ("up", "down"), ("noflip", "flip")


def _ortho_parallel_wrist(t: Table) -> tuple[list[Check], tuple[int, ...]]:
    checks = [
        t.perpendicular(1),
        t.parallel(2),
        t.zero("a", 4, "axes 4 and 5 meet"),
        t.zero("a", 5, "axes 5 and 6 meet"),
        t.zero("d", 5, "axes 4, 5 and 6 meet in one point"),
        t.not_parallel(4),
        t.not_parallel(5),
        t.apart("axes 2 and 3 apart", t.a[1]),
        t.apart("the wrist stands off axis 3", np.hypot(t.a[2], t.d[3] * t.sin[2])),
    ]
    square = int(max(abs(t.cos[3]), abs(t.cos[4])) <= t.tolerance)
    signs = (t.up, *map(_sign, (t.sin[0], t.cos[1], t.sin[3], t.sin[4])), square)
    return checks, signs


def _three_parallel(t: Table) -> tuple[list[Check], tuple[int, ...]]:
    checks = [
        t.perpendicular(1),
        t.parallel(2),
        t.parallel(3),
        t.perpendicular(4),
        t.perpendicular(5),
        t.zero("a", 5, "axes 5 and 6 meet"),
        t.apart("axes 2 and 3 apart", t.a[1]),
        t.apart("axes 3 and 4 apart", t.a[2]),
    ]
    return checks, (t.up, *map(_sign, (t.sin[0], t.cos[1], t.cos[2], t.sin[3], t.sin[4])))


class Rule(NamedTuple):
    kinds: str
    judge: Callable[[Table], tuple[list[Check], tuple[int, ...]]]
    branches: tuple[str, ...]
    summary: str


RULES = {
    "ortho_parallel_wrist": Rule(
        "RRRRRR",
        _ortho_parallel_wrist,
        _slots(SHOULDER, ELBOW, WRIST),
        "axis 1 perpendicular to 2, axis 2 parallel to 3, the last three axes meeting in a point",
    ),
    "three_parallel": Rule(
        "RRRRRR",
        _three_parallel,
        _slots(SHOULDER, ELBOW, WRIST),
        "axis 1 perpendicular to 2, axes 2, 3 and 4 parallel, 5 perpendicular to 4, 6 meeting 5 squarely",
    ),
}


def recognise(
    kinds: str,
    numbers: dict,
    family: str | None = None,
    up: int = 1,
    tolerance: float = TOLERANCE,
) -> Verdict:
    """The first family whose facts all hold.

    Args:
        kinds: The joints.
        numbers: Standard DH columns `a, alpha, d`; lengths may be traced if `family` is given.
        family: The only one to try.
        up: +1 when axis 1 points up, -1 when down: what a branch calls up.
        tolerance: How far a fact may be off.

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
    alpha = np.asarray(numbers["alpha"], float)
    a, d = (np.zeros(len(kinds)) if traced else np.asarray(numbers[k], float) for k in ("a", "d"))
    table = Table(np.sin(alpha), np.cos(alpha), a, d, traced, tolerance, up)
    evidence: dict[str, tuple[Check, ...]] = {}
    for name, rule in RULES.items():
        if family not in (None, name):
            continue
        if kinds != rule.kinds:
            evidence[name] = (Check(f"it wants joints {rule.kinds}", np.inf, False),)
            continue
        checks, signs = rule.judge(table)
        evidence[name] = tuple(checks)
        if all(check.holds for check in checks):
            return Verdict(name, signs, rule.branches, evidence)
    if family is not None:
        raise ValueError(f"the arm is not of family {family}: {describe(evidence[family])}")
    return Verdict(None, (), (), evidence)


def describe(checks: tuple[Check, ...]) -> str:
    """What stands in the way, with its measured deviation."""
    failed = [c for c in checks if not c.holds]
    if len(failed) == 1 and np.isinf(failed[0].deviation):
        return failed[0].fact
    return "; ".join(f"{c.fact}: {c.deviation:.3g}, wanted {c.wanted}" for c in failed)


def found(kinds: str, numbers: dict, tolerance: float = TOLERANCE) -> str:
    """Which neighbouring axes are parallel, perpendicular and meeting, in words."""
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
