"""Arms with more joints than a pose has freedoms: which of them are locked, and the table of the others.

A joint at an end of the arm that is locked at a value is a part of the base or of the tool. The joints
between are then six, and a family solves them as those of any other arm.
"""

from collections.abc import Sequence

import jax
import numpy as np

from ikjax.arm import dh

FREEDOMS = 6
"""Of a pose: so many joints are solved."""

MOST_JOINTS = 9
"""Of an arm whose joints are locked to leave six."""


def choices(n: int) -> list[tuple[int, ...]]:
    """The joints, counted from 0, that may be locked to leave six in a row: those at the tool first.

    Empty where there is nothing to lock.
    """
    surplus = n - FREEDOMS
    if not 0 < n - FREEDOMS <= MOST_JOINTS - FREEDOMS:
        return []
    return [(*range(first), *range(first + FREEDOMS, n)) for first in range(surplus + 1)]


def place(n: int, redundant: str | int | Sequence[str | int], names: Sequence[str] | None) -> tuple[int, ...]:
    """The joints, counted from 0, that a user asks to be locked.

    Args:
        n: Number of joints.
        redundant: One joint or several, by name or by number, counted from 1.
        names: The joints' names; "joint1", "joint2", ... always do.

    Raises:
        ValueError: No such joints, or joints that do not leave six in a row.
    """
    if n <= FREEDOMS:
        raise ValueError(f"redundant= is for arms of {FREEDOMS + 1} joints or more, this one has {n}")
    known: dict[str | int, int] = {i + 1: i for i in range(n)}
    for names_of_joints in (numbered(n), names or ()):
        known |= {name: i for i, name in enumerate(names_of_joints)}
    asked = [redundant] if isinstance(redundant, str | int) else list(redundant)
    unknown = [joint for joint in asked if joint not in known]
    if unknown:
        listed = ", ".join(names or numbered(n))
        raise ValueError(f"redundant={redundant!r}: there is no joint {unknown[0]!r}; the arm has {listed}")
    locked = tuple(sorted({int(known[joint]) for joint in asked}))
    if locked not in choices(n):
        ways = " or ".join(" and ".join(str(i + 1) for i in way) for way in choices(n))
        wanted = f"joint {ways}, which leaves six in a row" if ways else f"{MOST_JOINTS} joints at most"
        raise ValueError(f"redundant={redundant!r}: of {n} joints, wanted {wanted}")
    return locked


def numbered(n: int) -> tuple[str, ...]:
    """Names of joints that have none: "joint1", "joint2", ..."""
    return tuple(f"joint{i + 1}" for i in range(n))


def between(n: int, locked: Sequence[int]) -> range:
    """The joints, counted from 0, that are left between those locked at either end."""
    first = next(i for i in range(n) if i not in locked)
    return range(first, first + n - len(locked))


def inner(kinds: str, numbers: dict, locked: Sequence[int]) -> tuple[str, dict]:
    """Kinds and DH columns of the joints that are left; tool and base are no part of them."""
    if not locked:
        return kinds, numbers
    rows = between(len(kinds), locked)
    cut = slice(rows.start, rows.stop)
    columns = {key: numbers[key][cut] for key in ("a", "alpha", "d", "theta") if key in numbers}
    return kinds[cut], columns


def inner_up(kinds: str, numbers: dict, locked: Sequence[int], up: int) -> int:
    """+1 where the first axis that is left points up in the world, -1 where it points down.

    Beyond a turning joint that is locked it has no direction of its own in the world: then +1.
    """
    count = between(len(kinds), locked).start if locked else 0
    if not count:
        return up
    table = [numbers.get(key, np.zeros(len(kinds))) for key in ("theta", "d", "a", "alpha")]
    base = numbers.get("base")
    traced = any(isinstance(x, jax.core.Tracer) for x in (*table, base))
    if base is None or traced or "R" in kinds[:count]:
        return 1
    rows = zip(*(np.asarray(column, float)[:count] for column in table), strict=True)
    links = [dh.link_matrix(theta, d, a, np.sin(alpha), np.cos(alpha)) for theta, d, a, alpha in rows]
    return -1 if (np.asarray(base, float) @ dh.link_frames(links)[-1])[2, 2] < -1e-9 else 1
