"""The families: which facts each asks for, in the order in which an arm is tried against them.

`solvers.families.FAMILIES` holds the kernel of each.
"""

import itertools
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from ikjax.arm.recognition import signs as named
from ikjax.arm.recognition.facts import Check, Table
from ikjax.arm.recognition.signs import NEARLY, PairSplit, RegionalSplit
from ikjax.core.tolerances import NEARLY_SPLITS, SPLITS

Judgement = tuple[list[Check], tuple, tuple[str, ...]]
"""What was checked, the signs of the family (see `recognition.signs`), and the names of the slots."""


def _sign(x: float) -> int:
    return -1 if x < 0 else 1


def _slots(*bits: tuple[str, str]) -> tuple[str, ...]:
    """Names of the slots: bit k of the slot's number picks from the k-th pair."""
    return tuple(
        "/".join(pair[slot >> k & 1] for k, pair in enumerate(bits)) for slot in range(2 ** len(bits))
    )


SHOULDER, ELBOW, WRIST = ("front", "back"), ("up", "down"), ("noflip", "flip")


def _spherical_wrist(t: Table) -> list[Check]:
    return [
        t.zero("a", 4, "axes 4 and 5 meet"),
        t.zero("a", 5, "axes 5 and 6 meet"),
        t.zero("d", 5, "axes 4, 5 and 6 meet in one point"),
        t.not_parallel(4),
        t.not_parallel(5),
    ]


def _wrist_signs(t: Table) -> tuple[int, int, int]:
    square = int(max(abs(t.cos[3]), abs(t.cos[4])) <= t.tolerance)
    return _sign(t.sin[3]), _sign(t.sin[4]), square


def _ortho_parallel_wrist(t: Table) -> Judgement:
    checks = [
        t.perpendicular(1),
        t.parallel(2),
        *_spherical_wrist(t),
        t.apart("axes 2 and 3 apart", t.a[1]),
        t.apart("the wrist stands off axis 3", np.hypot(t.a[2], t.d[3] * t.sin[2])),
    ]
    signs = named.OrthoParallelWristSigns(t.up, _sign(t.sin[0]), _sign(t.cos[1]), *_wrist_signs(t))
    return checks, signs, _slots(SHOULDER, ELBOW, WRIST)


def _three_parallel(t: Table) -> Judgement:
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
    signs = named.ThreeParallelSigns(t.up, *map(_sign, (t.sin[0], t.cos[1], t.cos[2], t.sin[3], t.sin[4])))
    return checks, signs, _slots(SHOULDER, ELBOW, WRIST)


def _pieper(t: Table) -> Judgement:
    point = np.array([0.0, 0.0, t.d[3]])
    split = _split(t)
    checks = [*_spherical_wrist(t), t.moves_in_space(point)]
    signs = named.PieperSigns(split, *_wrist_signs(t))
    return checks, signs, _slots(*_regional_bits(t.kinds, split), WRIST)


def _from_the_tool(t: Table) -> Table:
    """The table of six joints read from the tool to the base."""
    order = np.arange(5)[::-1]
    return t._replace(
        kinds=t.kinds[::-1],
        sin=np.append(-t.sin[order], 0.0),
        cos=np.append(t.cos[order], 1.0),
        a=np.append(-t.a[order], 0.0),
        d=np.append(t.d[:0:-1], 0.0),
        theta=t.theta[::-1],
    )


def _pieper_reversed(t: Table) -> Judgement:
    checks, signs, names = _pieper(_from_the_tool(t))
    return [c._replace(fact=f"read from the tool to the base: {c.fact}") for c in checks], signs, names


def _position(t: Table) -> Judgement:
    split = _split(t)
    checks = [t.moves_in_space(t.tool)]
    return checks, named.PositionSigns(split), _slots(*_regional_bits(t.kinds, split))


def _deviations(t: Table) -> dict[RegionalSplit, float]:
    """How far the equation that is left for joint 3 is from each form in which it splits."""
    kinds = t.kinds[:2]
    if kinds == "RR":
        meet = {} if t.promised else {RegionalSplit.MEET: float(abs(t.a[0])) / t.size}
        return {**meet, RegionalSplit.PARALLEL: float(abs(t.sin[0]))}
    return {RegionalSplit.SLIDES: 0.0} if kinds == "PP" else {RegionalSplit.SQUARE: float(abs(t.cos[0]))}


def _split(t: Table) -> RegionalSplit:
    """How the equation that is left for joint 3 splits: see `solvers.steps.regional.three_joints`."""
    deviations = _deviations(t)
    for split, off in deviations.items():
        if off <= t.tolerance:
            return split
    split = min(deviations, key=lambda key: deviations[key])
    nearly = deviations[split] <= NEARLY_SPLITS["nearly in float32"]
    return NEARLY[split] if nearly else RegionalSplit.NONE


def nearly_split(t: Table, family: str) -> tuple[str, int, float] | None:
    """The number of the table that alone keeps an equation from splitting, by very little.

    Returns:
        Its column, its row counted from 0, and the value at which the equation splits; or None.
    """
    if family not in ("pieper", "pieper_reversed", "position"):
        return None
    place = 4 if family == "pieper_reversed" else 0
    deviations = _deviations(_from_the_tool(t) if place else t)
    split = min(deviations, key=lambda key: deviations[key])
    if not t.tolerance < deviations[split] <= SPLITS["regional"]:
        return None
    if split == RegionalSplit.MEET:
        return "a", place, 0.0
    quarter = float(np.round(np.arctan2(t.sin[place], t.cos[place]) / (np.pi / 2)))
    return "alpha", place, quarter * np.pi / 2


def _regional_bits(kinds: str, split: RegionalSplit) -> list[tuple[str, str]]:
    second, third = ("j2+", "j2-"), ("j3+", "j3-")
    turning = kinds[2] == "R"
    if split.is_full:
        quartic = turning or kinds[:2] == "RR"
        return [("rising", "falling"), ("low", "high")] if quartic else [third]
    if split == RegionalSplit.SLIDES:
        return [third] if turning else []
    return [second, third] if turning or split == RegionalSplit.MEET else [second]


def _along(t: Table, which: list[int]) -> tuple[int, ...]:
    """Signs of axes, counted from 0, relative to the first of them."""
    along, _ = t.axes()
    return tuple(_sign(float(along[i] @ along[which[0]])) for i in which)


def _parallel_axes(t: Table) -> Judgement:
    """Three in a row; the place where they are nearest to parallel is the one that is reported."""
    rows = {place: list(range(place - 1, place + 2)) for place in (2, 3, 4, 1)}
    place = min(rows, key=lambda p: t.all_parallel(rows[p]).deviation)
    which = rows[place]
    along, points = t.axes()
    checks = [t.all_parallel(which), t.moves_freely()]
    for i in which[:2]:
        between = points[i + 1] - points[i]
        apart = float(np.linalg.norm(np.cross(along[which[0]], between)))
        checks.append(t.apart(f"axes {i + 1} and {i + 2} apart", apart))
    off, off_first = (x / t.size for x in _proportional(place, along, points))
    # The quartic needs no care where joint B is nearly alone: with a1 off by 1e-4 and 0.01, or alpha1 by
    # 1e-4, none of 4,000 goals was lost.
    b_alone = bool(off_first <= SPLITS["parallel_axes"] and off_first < off)
    off = off_first if b_alone else off
    bounds = {
        PairSplit.EXACTLY: t.tolerance,
        PairSplit.WITHIN_1E_5: SPLITS["parallel_axes"],
        PairSplit.NEARLY: NEARLY_SPLITS["nearly"],
        PairSplit.NEARLY_IN_FLOAT32: NEARLY_SPLITS["nearly in float32"],
    }
    split = next((split for split, most in bounds.items() if off <= most), PairSplit.NONE)
    pairs = [("b+", "b-"), ("a+", "a-")] if split.is_split else [("rising", "falling"), ("low", "high")]
    pairs = pairs[::-1] if b_alone else pairs
    signs = named.ParallelAxesSigns(place, split, b_alone, *_along(t, which))
    return checks, signs, _slots(("left", "right"), *pairs)


def _proportional(place: int, along: np.ndarray, points: np.ndarray) -> tuple[float, float]:
    """Determinants of the coefficients of joints B and A in `solvers.families.parallel_axes`.

    Those of A depend on the goal; that of 4, 5, 6 is given as a share of their largest for any goal. That of
    2, 3, 4 vanishes for single goals only.
    """
    if place in (1, 3):
        along, points = along[::-1], points[::-1]
    if place in (2, 3):
        return _area(along[4], along[5], points[5] - points[4], seen=along[1]), np.inf
    return (
        _area(along[2], along[1], points[2] - points[1], seen=along[3]),
        _area(along[0], along[1], points[1] - points[0]),
    )


def _area(axis: np.ndarray, u: np.ndarray, v: np.ndarray, seen: np.ndarray | None = None) -> float:
    """Area of the parallelogram of two vectors seen along an axis, times sin^2 of the axis and `seen`."""
    size = 1.0 if seen is None else float(np.sum(np.cross(axis, seen) ** 2))
    return abs(float(axis @ np.cross(u, v))) * size


def _offset_wrist(t: Table) -> Judgement:
    fore = t.a[2], t.d[3] * t.sin[2]
    checks = [
        t.not_parallel(1),
        t.parallel(2),
        t.zero("a", 4, "axes 4 and 5 meet"),
        t.not_parallel(4),
        t.moves_freely(),
        t.apart("axes 2 and 3 apart", t.a[1]),
        t.apart("where axes 4 and 5 meet stands off axis 3", np.hypot(*fore)),
    ]
    shared = int(not t.promised and _shares_joint_6(t))
    signs = named.OffsetWristSigns(t.up, _sign(t.sin[0]), _sign(t.cos[1]), shared)
    places = [f"/{k}" for k in range(1, 5)]
    names = tuple(f"{pair}{place}" for place in places for pair in _slots(SHOULDER, ELBOW))
    return checks, signs, names


def _shares_joint_6(t: Table) -> bool:
    """Whether half a turn of joint 1 leaves the equation for joint 6 what it is.

    Axes 1 and 2 meet squarely, the point where axes 4 and 5 meet is in the arm's plane, and axis 4 is square
    to axis 2 and points along the forearm, or across it and square to axis 5.
    """
    lateral = t.d[1] + t.cos[1] * (t.d[2] + t.cos[2] * t.d[3])
    along, across = t.d[3] * t.sin[2] / t.size, t.a[2] / t.size
    off = max(abs(t.a[0]) / t.size, abs(t.cos[0]), abs(lateral) / t.size, abs(t.cos[2]))
    return off <= t.tolerance and (
        abs(across) <= t.tolerance or max(abs(along), abs(t.cos[3])) <= t.tolerance
    )


def _offset_wrist_reversed(t: Table) -> Judgement:
    checks, signs, names = _offset_wrist(_from_the_tool(t))
    return [c._replace(fact=f"read from the tool to the base: {c.fact}") for c in checks], signs, names


def _scara(t: Table) -> Judgement:
    turning = [i for i, kind in enumerate(t.kinds) if kind == "R"]
    along, points = t.axes()
    checks = [t.all_parallel([0, 1, 2, 3])]
    for i, j in itertools.pairwise(turning):
        apart = float(np.linalg.norm(np.cross(along[0], points[j] - points[i])))
        checks.append(t.apart(f"axes {i + 1} and {j + 1} apart", apart))
    signs = named.ScaraSigns(*(_sign(float(a @ along[turning[0]])) for a in along))
    return checks, signs, _slots(("left", "right"))


def _turret(t: Table) -> Judgement:
    along, points = t.axes()
    checks = [t.not_parallel(1), t.all_parallel([1, 2, 3])]
    for i in (1, 2):
        apart = float(np.linalg.norm(np.cross(along[1], points[i + 1] - points[i])))
        checks.append(t.apart(f"axes {i + 1} and {i + 2} apart", apart))
    return checks, named.TurretSigns(*_along(t, [1, 2, 3])), _slots(("left", "right"))


def _five_axis(t: Table) -> Judgement:
    checks = [
        t.not_parallel(1),
        t.parallel(2),
        t.parallel(3),
        t.not_parallel(4),
        t.apart("axes 2 and 3 apart", t.a[1]),
        t.apart("axes 3 and 4 apart", t.a[2]),
    ]
    signs = named.FiveAxisSigns(t.up, *map(_sign, (t.sin[0], t.cos[1], t.cos[2], t.sin[3])))
    return checks, signs, _slots(SHOULDER, ELBOW)


def _planar(t: Table) -> Judgement:
    along, points = t.axes()
    turning = [i for i, kind in enumerate(t.kinds) if kind == "R"]
    up = along[turning[0]] if turning else np.cross(along[0], along[1])
    checks = [t.all_parallel(turning)] if turning else []
    for i, kind in enumerate(t.kinds):
        if kind == "P":
            off = abs(float(along[i] @ up))
            fact = f"slide {i + 1} within the plane of the turning axes"
            checks.append(Check(fact, off, off <= t.tolerance, t.at_most))
    tip = (t.frames(-np.where(t.turns, t.theta, 0.0))[-1] @ np.append(t.tool, 1))[:3]
    ends = [*points, tip]
    for i in range(2):
        # A link between two turns, or from the last turn to the point, must have a length.
        if (t.kinds + "R")[i : i + 2] == "RR":
            apart = float(np.linalg.norm(np.cross(up, ends[i + 1] - ends[i])))
            checks.append(t.apart(f"axis {i + 1} and what follows it apart", apart))
    slides = [along[i] for i, kind in enumerate(t.kinds) if kind == "P"]
    if len(slides) == 2 and t.kinds != "PRP":
        off = float(np.linalg.norm(np.cross(*slides)))
        checks.append(Check("the slides in different directions, sine", off, off > 1e-3, "> 0.001"))
    pair = ("left", "right") if t.kinds in ("RR", "RRR") else ("long", "short")
    bits = [pair] if len(slides) < 2 else []
    ways_up = [_sign(float(a @ up)) for a in along]
    if len(t.kinds) == 2:
        return checks, named.PlanarPositionSigns(*ways_up), _slots(*bits)
    return checks, named.PlanarPoseSigns(*ways_up), _slots(*bits)


class Rule(NamedTuple):
    kinds: str
    """The joints, as a regular expression."""
    joints: str
    """The same in words."""
    judge: Callable[[Table], Judgement]
    summary: str
    task: str = "pose"
    wide: bool = False
    """Its polynomial has too high a degree for float32: it is computed in float64 where that is on, and
    without it `Arm.complete` is False."""


RULES = {
    "ortho_parallel_wrist": Rule(
        "RRRRRR",
        "RRRRRR",
        _ortho_parallel_wrist,
        "axis 1 perpendicular to 2, axis 2 parallel to 3, the last three axes meeting in a point",
    ),
    "three_parallel": Rule(
        "RRRRRR",
        "RRRRRR",
        _three_parallel,
        "axis 1 perpendicular to 2, axes 2, 3 and 4 parallel, 5 perpendicular to 4, 6 meeting 5 squarely",
    ),
    "pieper": Rule(
        "[RP]{3}RRR",
        "R or P three times, then RRR",
        _pieper,
        "the last three axes meeting in a point, after any three joints",
    ),
    "pieper_reversed": Rule(
        "RRR[RP]{3}",
        "RRR, then R or P three times",
        _pieper_reversed,
        "the first three axes meeting in a point, before any three joints",
    ),
    "parallel_axes": Rule(
        "RRRRRR",
        "RRRRRR",
        _parallel_axes,
        "three consecutive axes parallel, the others anyhow",
    ),
    "offset_wrist": Rule(
        "RRRRRR",
        "RRRRRR",
        _offset_wrist,
        "axis 2 parallel to 3, axes 4 and 5 meeting, the others anyhow",
        wide=True,
    ),
    "offset_wrist_reversed": Rule(
        "RRRRRR",
        "RRRRRR",
        _offset_wrist_reversed,
        "axes 2 and 3 meeting, axis 4 parallel to 5, the others anyhow",
        wide=True,
    ),
    "scara": Rule(
        "RRPR|RRRP|PRRR|RPRR",
        "RRR with a P among them",
        _scara,
        "four parallel axes, one of them sliding",
    ),
    "five_axis": Rule(
        "RRRRR",
        "RRRRR",
        _five_axis,
        "axes 2, 3 and 4 parallel, axes 1 and 5 anyhow",
    ),
    "turret": Rule(
        "RRRR",
        "RRRR",
        _turret,
        "a turning base before three parallel axes",
    ),
    "planar_pose": Rule(
        "(?=.*R)[RP]{3}",
        "R or P three times, one R at least",
        _planar,
        "three joints that move in one plane",
        task="planar_pose",
    ),
    "planar_position": Rule(
        "[RP]{2}",
        "R or P twice",
        _planar,
        "two joints that move in one plane",
        task="planar_position",
    ),
    "position": Rule(
        "[RP]{3}",
        "R or P three times",
        _position,
        "any three joints that move the tool point in space",
        task="position",
    ),
}
