"""Points of a surface as the positions of a sweep: how much of a part an arm can work on.

With normals, the orientations of a sweep are given in a frame of the surface at each point, whose z axis
points into the surface, against the normal. Points come as an array, from a table in a file (CSV), or from a
mesh (STL). The methods of a set are described in `maps.sets.protocol`.
"""

import dataclasses
import pathlib
import struct
from types import ModuleType

import numpy as np
from numpy.typing import ArrayLike

from ikjax.core.vector import Matrix, Vector
from ikjax.maps.sets.protocol import Index, NamedArrays, Tables, read_only

LARGEST = 2**30
"""Most bytes of a file."""

MOST = 10**8
"""Most points that a mesh is cut into."""


@dataclasses.dataclass(frozen=True, eq=False)
class Surface:
    """Points, perhaps with normals."""

    xyz: np.ndarray
    """(n, 3) [m], read-only."""
    normals: np.ndarray | None = None
    """(n, 3) unit vectors that point out of the part, read-only."""

    axes = ("point",)

    def __post_init__(self):
        object.__setattr__(self, "xyz", read_only(self.xyz))
        object.__setattr__(self, "normals", None if self.normals is None else read_only(self.normals))

    def __eq__(self, other) -> bool:
        if not isinstance(other, Surface) or self.named().keys() != other.named().keys():
            return False
        pairs = zip(self.named().values(), other.named().values(), strict=True)
        return all(np.array_equal(a, b) for (a, _), (b, _) in pairs)

    @property
    def shape(self) -> tuple[int, ...]:
        """(number of points,)"""
        return (len(self.xyz),)

    @property
    def count(self) -> int:
        """Number of points."""
        return len(self.xyz)

    def points(self) -> np.ndarray:
        """All positions [m], (n, 3)."""
        return self.xyz

    def frames(self) -> np.ndarray | None:
        """Frames (n, 3, 3) in which orientations are given, z against the normal; None without normals."""
        return None if self.normals is None else _frames(-self.normals)

    def named(self) -> NamedArrays:
        """The points and normals, as a map stores them."""
        arrays: NamedArrays = {"points": (self.xyz, ("point", "xyz"))}
        if self.normals is not None:
            arrays["normals"] = (self.normals, ("point", "xyz"))
        return arrays

    def tables(self, dtype: np.dtype) -> Tables:
        """Arrays that `at` looks up, of the kernel's type."""
        frames = self.frames()
        points = (self.xyz.astype(dtype),)
        return points if frames is None else (*points, frames.reshape(-1, 9).astype(dtype))

    def at(self, tables: Tables, index: tuple[Index, ...], xp: ModuleType, dtype: np.dtype) -> Vector:
        """The positions [m] of whole numbers."""
        rows = tables[0][index[0]]
        return tuple(rows[..., k] for k in range(3))

    def frame_at(self, tables: Tables, index: tuple[Index, ...]) -> Matrix | None:
        """The frames of whole numbers, three rows of three scalars; None without normals."""
        if self.normals is None:
            return None
        rows = tables[1][index[0]]
        return tuple(tuple(rows[..., 3 * i + j] for j in range(3)) for i in range(3))

    def in_words(self) -> str:
        """The set in a few words for people."""
        return f"{self.count:,} points of a surface"


def surface(
    points: ArrayLike | str | pathlib.Path,
    normals: ArrayLike | None = None,
    *,
    scale: float = 1.0,
    spacing: float | None = None,
) -> Surface:
    """Points of a surface, as the positions of a sweep.

    Args:
        points: (n, 3) [m]; or a file: `.csv` with three columns, or six with normals, `#` before
            comments, and perhaps a first line x,y,z or x,y,z,nx,ny,nz; or `.stl`, whose triangles give their
            centroids and normals.
        normals: (n, 3) of any length but zero, pointing out of the part; not with a file.
        scale: Meters in a unit of the points: 0.001 for a file in millimeters.
        spacing: Triangles are cut into equal ones until no edge is longer [m]; by default they are not cut.

    Raises:
        ValueError: Wrong shapes, numbers that are not finite, normals of length zero, or a file that is none
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
    """Right-handed frames (n, 3, 3) with given z axes (n, 3), unit vectors.

    Source: Duff et al., Building an orthonormal basis, revisited, JCGT 6 (2017).
    """
    sign = np.where(z[:, 2] < 0, -1.0, 1.0)
    a = -1 / (sign + z[:, 2])
    b = z[:, 0] * z[:, 1] * a
    x = np.stack([1 + sign * z[:, 0] ** 2 * a, sign * b, -sign * z[:, 0]], axis=-1)
    y = np.stack([b, sign + z[:, 1] ** 2 * a, -z[:, 1]], axis=-1)
    return np.stack([x, y, z], axis=-1)


def _read(path: pathlib.Path, longest: float) -> tuple[np.ndarray, np.ndarray | None]:
    """Points (n, 3) of a file, in its units, and normals (n, 3) of any length or None.

    Args:
        path: A table or a mesh.
        longest: Edges of triangles are at most so long, in the file's units.
    """
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
    degenerate = ~(size > 0)
    if degenerate.all():
        raise ValueError(f"{path}: no triangle has an area")
    triangles, normals = triangles[~degenerate], normals[~degenerate]
    parts = np.ceil(np.linalg.norm(triangles - np.roll(triangles, 1, axis=1), axis=2).max(1) / longest)
    parts = np.maximum(parts, 1)
    if (parts**2).sum() > MOST:
        raise ValueError(f"{path}: spacing asks for {(parts**2).sum():.2g} points, more than {MOST:,}")
    all_points, all_normals = [], []
    for n in np.unique(parts):
        weights = _centroids(int(n))
        all_points.append((weights @ triangles[parts == n]).reshape(-1, 3))
        all_normals.append(np.repeat(normals[parts == n], len(weights), axis=0))
    return np.concatenate(all_points), np.concatenate(all_normals)


def _centroids(n: int) -> np.ndarray:
    """Centroids of n * n equal parts of a triangle, as weights (n * n, 3) of its corners."""
    i, j = np.indices((n, n)).reshape(2, -1)
    upright, inverted = i + j < n, i + j < n - 1
    first = np.stack([i, j], axis=-1) + 1 / 3
    second = np.stack([i, j], axis=-1) + 2 / 3
    two = np.concatenate([first[upright], second[inverted]]) / n
    return np.concatenate([two, 1 - two.sum(1, keepdims=True)], axis=1)


def _read_table(path: pathlib.Path, data: bytes) -> tuple[np.ndarray, np.ndarray | None]:
    """Points (n, 3) and normals (n, 3) or None, of the bytes of a CSV file."""
    try:
        lines = [line for line in data.decode().splitlines() if line.partition("#")[0].strip()]
        names = [cell.strip().lower() for cell in lines[0].split(",")] if lines else []
        if names in (["x", "y", "z"], ["x", "y", "z", "nx", "ny", "nz"]):
            lines = lines[1:]
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
        # Some binary files begin with "solid" too, so the length decides.
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
