"""Facts about an arm's axes, each measured against a threshold."""

import itertools
from typing import NamedTuple

import numpy as np

from ikjax.arm.dh import link_frames, link_matrix


class Check(NamedTuple):
    """One fact a family asks for, and how far the arm is from it."""

    fact: str
    deviation: float
    holds: bool
    wanted: str = ""
    """The threshold, as text."""


class Table(NamedTuple):
    """Concrete twists, and lengths that are only promised while they are traced."""

    kinds: str
    sin: np.ndarray
    cos: np.ndarray
    a: np.ndarray
    d: np.ndarray
    theta: np.ndarray
    tool: np.ndarray
    """(3,) the tool point in the frame of the last link."""
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

    def axes(self) -> tuple[np.ndarray, np.ndarray]:
        """Directions and points (n, 3) of the joints' axes when all DH angles and slides are zero."""
        frames = self.frames(-np.where(self.turns, self.theta, 0.0))
        return frames[:-1, :3, 2], frames[:-1, :3, 3]

    @property
    def turns(self) -> np.ndarray:
        return np.array([kind == "R" for kind in self.kinds])

    def all_parallel(self, which: list[int]) -> Check:
        """Axes, counted from 0, against the first of them."""
        along, _ = self.axes()
        off = max(float(np.linalg.norm(np.cross(along[which[0]], along[i]))) for i in which)
        names = ", ".join(str(i + 1) for i in which)
        return Check(f"axes {names} parallel", off, off <= self.tolerance, self.at_most)

    def moves_in_space(self, point: np.ndarray) -> Check:
        """The first three joints move a point of the frame after joint 3 in all directions."""
        size = self.size + float(np.linalg.norm(point))
        return self._dependence("the first three joints move the point in space", 3, point, size)

    def moves_freely(self) -> Check:
        """All six joints together move the tool in all directions."""
        return self._dependence("the joints move the tool freely", 6, np.zeros(3), self.size)

    def _dependence(self, what: str, count: int, point: np.ndarray, size: float) -> Check:
        """Greatest determinant of the first joints' motions, over a few poses."""
        if self.promised:
            return Check(f"{what}, promised", 0.0, True)
        rng = np.random.default_rng(0)
        worst = 0.0
        for _ in range(8):
            q = rng.uniform(-np.pi, np.pi, len(self.kinds))
            worst = max(worst, abs(np.linalg.det(self._motions(q, count, point, size))))
        return Check(f"{what}, greatest determinant", worst, worst > 1e-6, "> 1e-06")

    def _motions(self, q: np.ndarray, count: int, point: np.ndarray, size: float) -> np.ndarray:
        """Columns of the Jacobian in units of the reach: of a point, and of its frame where count is 6."""
        frames = self.frames(q)
        tip = (frames[count] @ np.append(point, 1))[:3]
        columns = []
        for kind, frame in zip(self.kinds[:count], frames, strict=False):
            axis, none = frame[:3, 2], np.zeros(3)
            linear = np.cross(axis, tip - frame[:3, 3]) / size if kind == "R" else axis
            columns.append(np.concatenate([linear, axis if kind == "R" else none])[:count])
        return np.stack(columns, axis=1)

    def frames(self, q: np.ndarray) -> np.ndarray:
        """(n + 1, 4, 4) the base and the frame after each link at joint values q; slides in reaches."""
        turns, slides = np.where(self.turns, q, 0.0), np.where(self.turns, 0.0, q * self.size)
        rows = zip(self.theta + turns, self.d + slides, self.a, self.sin, self.cos, strict=True)
        return link_frames(itertools.starmap(link_matrix, rows))
