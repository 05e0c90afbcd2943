"""Which parameters of an arm's DH table may change without leaving its family, by trying each.

Parameters are named by column and joint, counted from 1, as in a printed table: "a2", "alpha4",
"d6", "theta3". Nothing is assumed about a family: its facts are checked again on the changed table.
"""

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from ikjax.arm.recognition import recognize

if TYPE_CHECKING:
    from ikjax.arm.arm import Arm

COLUMNS = ("a", "alpha", "d", "theta")
STEP = 1e-2
"""How far a parameter is changed for the trial: [rad], and as a share of the arm's size."""


def free(arm: "Arm") -> tuple[str, ...]:
    """Names of the parameters that may change a little, one at a time, without leaving the family.

    Raises:
        ValueError: An arm of no family, or one whose numbers are traced.
    """
    names = []
    for name in (f"{column}{i + 1}" for column in COLUMNS for i in range(arm.n)):
        value, step = number(arm, name), STEP * (1.0 if name[:-1] in ("alpha", "theta") else _size(arm))
        if all(why_not(arm, {name: value + sign * step}) is None for sign in (-1, 1)):
            names.append(name)
    return tuple(names)


def number(arm: "Arm", name: str) -> float:
    """The value of the parameter of that name.

    Raises:
        ValueError: No such parameter.
    """
    column, i = _place(arm, name)
    return float(np.asarray(getattr(arm, column))[i])


def why_not(arm: "Arm", changes: Mapping[str, float]) -> str | None:
    """Why the arm leaves its family when parameters are changed; None if it stays.

    Args:
        arm: An arm with a family.
        changes: New values by name.

    Raises:
        ValueError: An unknown name, an arm of no family.
    """
    before = _verdict(arm, {})
    after = _verdict(arm, changes)
    failed = [check for check in after[0] if not check.holds]
    if failed:
        return recognize.describe(after[0])
    return None if before[1:] == after[1:] else "an axis would point the other way, and with it the branches"


def _verdict(arm: "Arm", changes: Mapping[str, float]):
    """What the rule of the arm's family says of the changed table."""
    if arm.family is None:
        raise ValueError(f"{arm.name} has no family that its numbers could leave: `explain(arm)` says why")
    numbers = {key: np.array(getattr(arm, key), float) for key in (*COLUMNS, "tool")}
    for name, value in changes.items():
        column, i = _place(arm, name)
        numbers[column][i] = value
    tolerance = recognize.tolerance_of(arm.dtype)
    return recognize.judged(arm.kinds, numbers, str(arm.family), tolerance, arm.locked)


def _place(arm: "Arm", name: str) -> tuple[str, int]:
    """The column of a parameter, and its row, counted from 0."""
    column = name.rstrip("0123456789")
    row = name[len(column) :]
    if column not in COLUMNS or not row or not 1 <= int(row) <= arm.n:
        raise ValueError(f"{name!r} is no number of {arm.name}: it has a1 to theta{arm.n}")
    return column, int(row) - 1


def _size(arm: "Arm") -> float:
    return float(np.abs(np.asarray(arm.a, float)).sum() + np.abs(np.asarray(arm.d, float)).sum())
