"""Points of a surface as the positions of a sweep: how much of a part an arm can work on.

With normals the orientations of a sweep are seen from the surface: z points into it, against
the normal. Points come as an array, as a table in a file (CSV), or from a mesh (STL), which is read
as the data that it is.
"""

import dataclasses
import pathlib
import struct
from typing import Any

import numpy as np

from ikjax.core.vector import Matrix, Vector
from ikjax.maps.sets.protocol import frozen

LARGEST = 2**30
"""Bytes of a file."""

MOST = 10**8
"""Points that a mesh is cut into."""


@dataclasses.dataclass(frozen=True, eq=False)
class Surface:
    """Points, perhaps with normals."""

    xyz: np.ndarray
    """(n, 3) [m], read-only."""
    normals: np.ndarray | None = None
    """(n, 3) unit vectors that point out of the part, read-only."""

    axes = ("point",)

    def __post_init__(self):
        object.__setattr__(self, "xyz", frozen(self.xyz))
        object.__setattr__(self, "normals", None if self.normals is None else frozen(self.normals))

    def __eq__(self, other) -> bool:
        if not isinstance(other, Surface) or self.named().keys() != other.named().keys():
            return False
        pairs = zip(self.named().values(), other.named().values(), strict=True)
        return all(np.array_equal(a, b) for (a, _), (b, _) in pairs)

    @property
    def shape(self) -> tuple[int, ...]:
        """Of every statistic."""
        return (len(self.xyz),)

    @property
    def count(self) -> int:
        """Number of points."""
        return len(self.xyz)

    def points(self) -> np.ndarray:
        """All positions [m], (n, 3)."""
        return self.xyz

    def frames(self) -> np.ndarray | None:
        """(n, 3, 3) what orientations are seen from, its z axis against the normal; or None."""
        return None if self.normals is None else _frames(-self.normals)

    def named(self) -> dict[str, tuple[np.ndarray, tuple[str, ...]]]:
        """What a map says of its axis: arrays and the names of their dimensions."""
        arrays: dict[str, tuple[np.ndarray, tuple[str, ...]]] = {"points": (self.xyz, ("point", "xyz"))}
        if self.normals is not None:
            arrays["normals"] = (self.normals, ("point", "xyz"))
        return arrays

    def tables(self, dtype) -> tuple[Any, ...]:
        """Arrays that `at` looks up, of the kernel's type."""
        frames = self.frames()
        points = (self.xyz.astype(dtype),)
        return points if frames is None else (*points, frames.reshape(-1, 9).astype(dtype))

    def at(self, tables: tuple[Any, ...], index: tuple[Any, ...], xp, dtype) -> Vector:
        """The positions of whole numbers."""
        rows = tables[0][index[0]]
        return tuple(rows[..., k] for k in range(3))

    def frame_at(self, tables: tuple[Any, ...], index: tuple[Any, ...]) -> Matrix | None:
        """The frames of whole numbers, where there are normals."""
        if self.normals is None:
            return None
        rows = tables[1][index[0]]
        return tuple(tuple(rows[..., 3 * i + j] for j in range(3)) for i in range(3))

    def in_words(self) -> str:
        return f"{self.count:,} points of a surface"


def surface(points, normals=None, *, scale: float = 1.0, spacing: float | None = None) -> Surface:
    """Points for a reach study.

    Args:
        points: (n, 3) [m]; or a file: `.csv` of three columns, or of six with normals, `#` before what is
            no number; or `.stl`, whose triangles give their middles and normals.
        normals: (n, 3) of any length but zero, pointing out of the part.
        scale: Metres in a unit of the points: 0.001 for a file in millimetres.
        spacing: Triangles are cut into equal ones until no edge is longer [m].

    Raises:
        ValueError: Wrong shapes, numbers that are not finite, normals of no length, a file that is none
            of these.
        OSError: No such file.
    """
    for name, number in (("scale", scale), ("spacing", spacing)):
        if number is not None and not 0 < number < np.inf:
            raise ValueError(f"{name} must be a positive number, got {number}")
    if isinstance(points, str | pathlib.Path):
        if normals is not None:
            raise ValueError("normals come from the file, or with an array of points")
        points, normals = _read(pathlib.Path(points), np.inf if spacing is None else spacing / scale)
    xyz = np.array(points, float) * scale
    if xyz.ndim != 2 or xyz.shape[1:] != (3,) or len(xyz) == 0:
        raise ValueError(f"points must have shape (n, 3), got {xyz.shape}")
    if not np.isfinite(xyz).all():
        raise ValueError(f"points[{int(np.argmin(np.isfinite(xyz).all(1)))}] is not finite")
    if normals is None:
        return Surface(xyz)
    directions = np.array(normals, float)
    if directions.shape != xyz.shape:
        raise ValueError(f"normals must have shape {xyz.shape}, got {directions.shape}")
    with np.errstate(invalid="ignore", over="ignore"):
        size = np.linalg.norm(directions, axis=1, keepdims=True)
    bad = ~((size > 1e-300) & (size < 1e300))[:, 0]
    if bad.any():
        raise ValueError(f"normals[{int(np.argmax(bad))}] must have a direction, got {directions[bad][0]}")
    return Surface(xyz, directions / size)


def _frames(z: np.ndarray) -> np.ndarray:
    """Right-handed frames (n, 3, 3) of given third axes.

    Source: Duff et al., Building an orthonormal basis, revisited, JCGT 6 (2017).
    """
    sign = np.where(z[:, 2] < 0, -1.0, 1.0)
    a = -1 / (sign + z[:, 2])
    b = z[:, 0] * z[:, 1] * a
    x = np.stack([1 + sign * z[:, 0] ** 2 * a, sign * b, -sign * z[:, 0]], axis=-1)
    y = np.stack([b, sign + z[:, 1] ** 2 * a, -z[:, 1]], axis=-1)
    return np.stack([x, y, z], axis=-1)


def _read(path: pathlib.Path, longest: float) -> tuple[np.ndarray, np.ndarray | None]:
    kind = path.suffix.lower()
    if kind not in (".csv", ".stl"):
        raise ValueError(f"{path}: points are read from .csv and .stl")
    if path.stat().st_size > LARGEST:
        raise ValueError(f"{path}: more than {LARGEST} bytes")
    data = path.read_bytes()
    if kind == ".csv":
        return _read_table(path, data)
    triangles = _read_stl(path, data)
    edges = triangles[:, 1:] - triangles[:, :1]
    # The stored normals are often zero or rough; the order of the corners says the same.
    normals = np.cross(edges[:, 0], edges[:, 1])
    size = np.linalg.norm(normals, axis=1)
    flat = ~(size > 0)
    if flat.all():
        raise ValueError(f"{path}: no triangle has an area")
    triangles, normals = triangles[~flat], normals[~flat]
    parts = np.ceil(np.linalg.norm(triangles - np.roll(triangles, 1, axis=1), axis=2).max(1) / longest)
    parts = np.maximum(parts, 1)
    if (parts**2).sum() > MOST:
        raise ValueError(f"{path}: spacing asks for {(parts**2).sum():.2g} points, more than {MOST:,}")
    pieces = [
        (middles @ triangles[parts == n], normals[parts == n], middles)
        for n in np.unique(parts)
        for middles in [_middles(int(n))]
    ]
    points = np.concatenate([found.reshape(-1, 3) for found, _, _ in pieces])
    return points, np.concatenate([np.repeat(n, len(middles), axis=0) for _, n, middles in pieces])


def _middles(n: int) -> np.ndarray:
    """Of n * n equal parts of a triangle, as weights (n * n, 3) of its corners."""
    i, j = np.indices((n, n)).reshape(2, -1)
    upright, inverted = i + j < n, i + j < n - 1
    first = np.stack([i, j], axis=-1) + 1 / 3
    second = np.stack([i, j], axis=-1) + 2 / 3
    two = np.concatenate([first[upright], second[inverted]]) / n
    return np.concatenate([two, 1 - two.sum(1, keepdims=True)], axis=1)


def _read_table(path: pathlib.Path, data: bytes) -> tuple[np.ndarray, np.ndarray | None]:
    try:
        lines = [line for line in data.decode().splitlines() if line.partition("#")[0].strip()]
        rows = np.loadtxt(lines, delimiter=",", ndmin=2) if lines else np.empty((0, 0))
    except ValueError as error:
        raise ValueError(f"{path}: no table of numbers: {error}") from error
    if rows.size == 0 or rows.shape[1] not in (3, 6):
        raise ValueError(f"{path}: must have 3 or 6 columns, got shape {rows.shape}")
    return rows[:, :3], rows[:, 3:] if rows.shape[1] == 6 else None


def _read_stl(path: pathlib.Path, data: bytes) -> np.ndarray:
    """Corners (n, 3, 3) of the triangles of an STL file, in the file's units."""
    if len(data) >= 84:
        (count,) = struct.unpack_from("<I", data, 80)
        # Some binary files begin with "solid" too, so their length decides.
        if count and len(data) == 84 + 50 * count:
            record = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("more", "<u2")])
            return np.frombuffer(data, record, count, 84)["corners"].astype(float)
    lines = [line.split() for line in data.decode("ascii", "replace").splitlines()]
    words = [line[1:4] for line in lines if line[:1] == ["vertex"]]
    try:
        corners = np.array(words, float)
    except ValueError:
        corners = np.empty(0)
    if lines[:1] == [] or lines[0][:1] != ["solid"] or corners.size == 0 or corners.size % 9:
        raise ValueError(f"{path}: neither a binary nor a text STL file, or not whole")
    return corners.reshape(-1, 3, 3)
