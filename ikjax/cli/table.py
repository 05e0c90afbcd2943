"""CSV files of goals in and of joints out.

The first line names the columns; a unit may follow in brackets: "x [mm]", "roll [deg]". Without one, lengths
are in metres and angles in the command's unit. Goals have the columns x, y, z and, where they turn, roll,
pitch, yaw or qw, qx, qy, qz; other columns are passed over. Without names there are three columns, or six.
"""

import csv
import math
import pathlib
import re
import sys
from collections.abc import Iterable, Sequence

import numpy as np

from ikjax.core.pose import pose

UNITS = {"m": 1.0, "mm": 1e-3, "cm": 1e-2, "rad": 1.0, "deg": math.pi / 180, "": 1.0}
XYZ, RPY, WXYZ = ("x", "y", "z"), ("roll", "pitch", "yaw"), ("qw", "qx", "qy", "qz")
MOST_BYTES = 2**28
"""Largest file that is read."""
_HEADING = re.compile(r"\s*([^\[\]]*?)\s*(?:\[\s*(\w*)\s*\])?\s*")


def read_goals(file: str, angle: float, turn: dict | None = None) -> np.ndarray:
    """The goals of a CSV file.

    Args:
        file: Its path, or "-" for standard input.
        angle: One unit of angles without a unit of their own [rad].
        turn: The orientation of goals that have a position alone, as arguments of `ikjax.pose`; the
            identity by default.

    Returns:
        T_world_tool, (n, 4, 4).

    Raises:
        ValueError: Naming the line and the column that is wrong.
        OSError: The file cannot be read.
    """
    rows = [row for row in csv.reader(_lines(file)) if any(cell.strip() for cell in row)]
    if not rows:
        raise ValueError(f"{file}: no goals")
    names, scales, first = _columns(file, rows[0], angle)
    numbers = np.array([_row(file, k, row, names) for k, row in enumerate(rows[first:], first + 1)])
    if not len(numbers):
        raise ValueError(f"{file}: no goals below the names of the columns")
    numbers = numbers * scales
    place = {name: k for k, name in enumerate(names)}

    def some(wanted: tuple[str, ...]) -> np.ndarray | None:
        there = [name for name in wanted if name in place]
        if there and len(there) < len(wanted):
            raise ValueError(f"{file}: column {(set(wanted) - set(there)).pop()} is missing")
        return numbers[:, [place[name] for name in wanted]] if there else None

    xyz, rpy, wxyz = some(XYZ), some(RPY), some(WXYZ)
    if xyz is None:
        raise ValueError(f"{file}: goals need columns x, y, z, got {', '.join(map(str.strip, rows[0]))}")
    if rpy is not None or wxyz is not None:
        return np.asarray(pose(xyz, rpy=rpy, wxyz=wxyz), float)
    return np.asarray(pose(xyz, **(turn or {})), float)


def _lines(file: str) -> list[str]:
    if file == "-":
        return sys.stdin.read().splitlines()
    path = pathlib.Path(file)
    if path.stat().st_size > MOST_BYTES:
        raise ValueError(f"{file}: more than {MOST_BYTES} bytes are no list of goals")
    return path.read_text(encoding="utf-8-sig").splitlines()


def _columns(file: str, row: list[str], angle: float) -> tuple[list[str], np.ndarray, int]:
    """Names of the columns, what their numbers are multiplied by, and the first row of numbers."""
    if all(map(_is_number, row)):
        if len(row) not in (3, 6):
            raise ValueError(
                f"{file}: {len(row)} columns without names; name them in the first line, such as "
                f"{','.join((*XYZ, *WXYZ))}"
            )
        names = [*XYZ, *RPY][: len(row)]
        return names, np.array([1.0, 1, 1, angle, angle, angle])[: len(row)], 0
    names, scales = [], []
    for cell in row:
        match = _HEADING.fullmatch(cell)
        name, unit = (match[1].lower(), match[2]) if match else (cell, None)
        if unit is not None and unit not in UNITS and name in (*XYZ, *RPY):
            raise ValueError(
                f"{file}: column {cell.strip()!r}: the units are {', '.join(filter(None, UNITS))}"
            )
        names.append(name)
        scales.append(angle if name in RPY and not unit else UNITS.get(unit or "", 1.0))
    return names, np.array(scales), 1


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True


def _row(file: str, line: int, row: list[str], names: list[str]) -> list[float]:
    """The numbers of a row; NaN in columns that goals do not use."""
    if len(row) != len(names):
        raise ValueError(f"{file}, row {line}: {len(names)} columns are named, got {len(row)}")
    numbers = []
    for name, cell in zip(names, row, strict=True):
        used = name in (*XYZ, *RPY, *WXYZ)
        if used and not (_is_number(cell) and math.isfinite(float(cell))):
            raise ValueError(f"{file}, row {line}: {name} must be a finite number, got {cell.strip()!r}")
        numbers.append(float(cell) if used else math.nan)
    return numbers


def write(file: str, names: Sequence[str], rows: Iterable[Sequence]) -> None:
    """A CSV file, or standard output for "-"."""
    if file == "-":
        csv.writer(sys.stdout, lineterminator="\n").writerows([names, *rows])
        return
    with open(file, "w", newline="", encoding="utf-8") as out:
        csv.writer(out, lineterminator="\n").writerows([names, *rows])
