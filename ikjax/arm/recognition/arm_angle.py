"""Which arms of seven joints have an arm angle: those with a spherical shoulder and a spherical wrist.

Source: Shimizu, Kakuya, Yoon, Kitagaki, Uchiyama, Analytical inverse kinematic computation for 7-DOF
redundant manipulators with joint limits and its application to redundancy resolution, IEEE Transactions on
Robotics 24(5), 2008; the offsets at the elbow are ours.
"""

import itertools

import numpy as np

from ikjax.arm.recognition.facts import Check
from ikjax.arm.recognition.signs import ArmAngleSigns
from ikjax.core.xla import is_traced

JOINTS = 7

ZEROS = (("a", 1), ("a", 2), ("d", 2), ("d", 4), ("a", 5), ("a", 6), ("d", 6))
"""Numbers of the table that are zero: the shoulder's and the wrist's axes meet, and the elbow is flat."""

BRANCHES = tuple(f"j2{two}/j4{four}/j6{six}" for six, four, two in itertools.product("+-", repeat=3))
"""The signs of joints 2 and 6 from where they are straight, and of the bend of the elbow about axis 4."""


def checks(kinds: str, numbers: dict, tolerance: float) -> list[Check]:
    """The facts that such an arm needs, of standard DH columns with concrete numbers."""
    if kinds != "R" * JOINTS:
        return [Check(f"it wants {JOINTS} turning joints", np.inf, False)]
    a, d, alpha = (np.asarray(numbers[key], float) for key in ("a", "d", "alpha"))
    size = max(float(np.abs(a).sum() + np.abs(d).sum()), 1e-300)
    wanted = f"<= {tolerance:.2g}"
    off = np.abs(np.cos(alpha[:6]))
    found = [
        Check(f"axis {i + 1} perpendicular to axis {i + 2}", float(x), bool(x <= tolerance), wanted)
        for i, x in enumerate(off)
    ]
    for name, i in ZEROS:
        share = abs(float({"a": a, "d": d}[name][i - 1])) / size
        found.append(Check(f"{name}{i} = 0, as a share of the arm's size", share, share <= tolerance, wanted))
    for what, length in (("upper arm", np.hypot(a[2], d[2])), ("forearm", np.hypot(a[3], d[4]))):
        found.append(
            Check(f"the {what} has a length, as a share", length / size, length > 1e-6 * size, "> 1e-06")
        )
    return found


def signs_of(kinds: str, numbers: dict, tolerance: float) -> ArmAngleSigns | None:
    """What the kernel must know of such an arm; None of any other, and of one whose numbers are traced."""
    columns = {key: numbers[key] for key in ("a", "d", "alpha")}
    if is_traced(columns) or not all(check.holds for check in checks(kinds, columns, tolerance)):
        return None
    return ArmAngleSigns(
        tuple(int(x) for x in np.round(np.sin(np.asarray(numbers["alpha"], float)[:6]))), False
    )
