"""Joints at the end of a chain that look like a gripper's, by their names or by their range.

By their names it is a guess that chooses the tip where none is given; by their range, for a warning only.
"""

import math
import re
from collections.abc import Sequence
from typing import NamedTuple

_FINGER = re.compile(r"jaw|finger|claw|knuckle|thumb|pinc|tong(?!ue)")
_HAND = re.compile(r"grip|hand(?!le|rail)")
# The joint that carries a gripper, and links that do not move relative to it.
_CARRIER = re.compile(r"wrist|roll|pitch|yaw|rotat|twist|flex|ankle|foot|fixed|static|base|palm|mount")

_OPENS = math.radians(150), 0.2
"""The joints of a gripper have a smaller range [rad, m]."""

_SLIDES = 0.1
"""[m] So has a prismatic finger without a telling name, at the end of `_ENOUGH` joints or more."""

_ENOUGH = 5


class Moved(NamedTuple):
    """A moving joint and the link that it moves."""

    joint: str
    link: str
    kind: str
    """ "R" or "P"."""
    lower: float
    upper: float

    @property
    def travel(self) -> float:
        return self.upper - self.lower


def gripper(chain: Sequence[Moved]) -> int:
    """How many joints at the end are probably a gripper's; never all."""
    count = 0
    while count < len(chain) and is_finger(chain[-1 - count]):
        count += 1
    if count == 0 and len(chain) >= _ENOUGH and _opens(chain[-1]):
        count = 1
    return count if count < len(chain) else 0


def is_finger(moved: Moved) -> bool:
    """Whether a joint has a finger's name, or moves a link that has one."""
    # A joint that is named by both its links, "a_to_b", belongs to the second.
    joint, link = moved.joint.lower().rpartition("_to_")[2], moved.link.lower()
    if _CARRIER.search(joint):
        return False
    named = _FINGER.search(joint) or (_FINGER.search(link) and not _CARRIER.search(link))
    return bool(named or (_HAND.search(joint) and moved.travel < _OPENS[moved.kind == "P"]))


def _opens(moved: Moved) -> bool:
    """Whether a joint moves from about zero to one side only, by a small range, as no wrist does."""
    if _CARRIER.search(f"{moved.joint} {moved.link}".lower()):
        return False
    if moved.kind == "P":
        return 0 < moved.travel <= _SLIDES
    nearer = min(abs(moved.lower), abs(moved.upper))
    return 0 < moved.travel < _OPENS[0] and nearer <= 0.15 * moved.travel
