"""Which numbers of an arm may move without leaving its family, found by moving them.

Numbers are named by column and joint, counted from 1, as in a printed table: "a2", "alpha4",
"d6", "theta3". Nothing is assumed about a family: its facts are checked again on the numbers as moved.
"""

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from ikjax.arm.recognition import recognize

if TYPE_CHECKING:
    from ikjax.arm.arm import Arm

COLUMNS = ("a", "alpha", "d", "theta")
STEP = 1e-2
"""How far a number is moved to see whether it may: [rad], and as a share of the arm's size."""


def free(arm: "Arm") -> tuple[str, ...]:
    """Names of the numbers of the table that may move a little, one by one, and the family stays.

    Raises:
        ValueError: An arm of no family, or one whose numbers are traced.
    """
    kept = []
    for name in (f"{column}{i + 1}" for column in COLUMNS for i in range(arm.n)):
        value, step = number(arm, name), STEP * (1.0 if name[:-1] in ("alpha", "theta") else _size(arm))
        if all(why_not(arm, {name: value + way * step}) is None for way in (-1, 1)):
            kept.append(name)
    return tuple(kept)


def number(arm: "Arm", name: str) -> float:
    """The number of that name.

    Raises:
        ValueError: No such number.
    """
    column, i = _place(arm, name)
    return float(np.asarray(getattr(arm, column))[i])


def why_not(arm: "Arm", changes: Mapping[str, float]) -> str | None:
    """What keeps the arm out of its family when numbers of its table are changed; None if nothing does.

    Raises:
        ValueError: A name that is none, an arm of no family.
    """
    before = _verdict(arm, {})
    after = _verdict(arm, changes)
    failed = [check for check in after[0] if not check.holds]
    if failed:
        return recognize.describe(after[0])
    return None if before[1:] == after[1:] else "an axis would point the other way, and with it the branches"


def _verdict(arm: "Arm", changes: Mapping[str, float]):
    if arm.family is None:
        raise ValueError(f"{arm.name} has no family that its numbers could leave: `explain(arm)` says why")
    numbers = {key: np.array(getattr(arm, key), float) for key in (*COLUMNS, "tool")}
    for name, value in changes.items():
        column, i = _place(arm, name)
        numbers[column][i] = value
    tolerance = recognize.tolerance_of(arm.dtype)
    return recognize.judged(arm.kinds, numbers, str(arm.family), tolerance)


def _place(arm: "Arm", name: str) -> tuple[str, int]:
    column = name.rstrip("0123456789")
    row = name[len(column) :]
    if column not in COLUMNS or not row or not 1 <= int(row) <= arm.n:
        raise ValueError(f"{name!r} is no number of {arm.name}: it has a1 to theta{arm.n}")
    return column, int(row) - 1


def _size(arm: "Arm") -> float:
    return float(np.abs(np.asarray(arm.a, float)).sum() + np.abs(np.asarray(arm.d, float)).sum())
