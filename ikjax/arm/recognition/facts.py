"""Facts about an arm's axes (parallel, perpendicular, meeting, apart), each measured against a threshold.

Joints and axes are counted from 1 in names and messages.
"""

import itertools
from typing import NamedTuple

import numpy as np

from ikjax.arm.dh import link_frames, link_matrix


class Check(NamedTuple):
    """One fact that a family needs, and how far the arm is from it."""

    fact: str
    """In words, with the unit of the deviation."""
    deviation: float
    holds: bool
    wanted: str = ""
    """The threshold, as text."""


class Table(NamedTuple):
    """A standard DH table for the rules: its twists are concrete, its lengths may be traced."""

    kinds: str
    sin: np.ndarray
    """(n,) sines of the twists."""
    cos: np.ndarray
    """(n,) cosines of the twists."""
    a: np.ndarray
    d: np.ndarray
    theta: np.ndarray
    tool: np.ndarray
    """(3,) the tool point in the frame of the last link."""
    promised: bool
    """The lengths are traced: facts about `a` and `d` count as true, because the caller named the family."""
    tolerance: float
    """How far a fact may be off: sines and cosines, and shares of the size."""
    up: int
    """+1 when axis 1 points up in the world the arm is built into, -1 when down."""

    @property
    def size(self) -> float:
        """Sum of the table's lengths [m]: the unit of every length here."""
        return max(float(np.abs(self.a).sum() + np.abs(self.d).sum()), 1e-300)

    @property
    def at_most(self) -> str:
        """The threshold, as text."""
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
        """Directions and points, (n, 3) each, of the joints' axes when all DH angles and slides are zero."""
        frames = self.frames(-np.where(self.turns, self.theta, 0.0))
        return frames[:-1, :3, 2], frames[:-1, :3, 3]

    @property
    def turns(self) -> np.ndarray:
        """(n,) whether each joint is revolute."""
        return np.array([kind == "R" for kind in self.kinds])

    def all_parallel(self, which: list[int]) -> Check:
        """Axes, counted from 0, against the first of them."""
        along, _ = self.axes()
        off = max(float(np.linalg.norm(np.cross(along[which[0]], along[i]))) for i in which)
        names = ", ".join(str(i + 1) for i in which)
        return Check(f"axes {names} parallel", off, off <= self.tolerance, self.at_most)

    def moves_in_space(self, point: np.ndarray) -> Check:
        """The first three joints move a point, given in the frame after joint 3, in all directions."""
        size = self.size + float(np.linalg.norm(point))
        return self._dependence("the first three joints move the point in space", 3, point, size)

    def moves_freely(self) -> Check:
        """All six joints together move the tool in all directions."""
        return self._dependence("the joints move the tool freely", 6, np.zeros(3), self.size)

    def _dependence(self, what: str, count: int, point: np.ndarray, size: float) -> Check:
        """Whether the Jacobian of the first joints is regular somewhere: its largest determinant of eight."""
        if self.promised:
            return Check(f"{what}, promised", 0.0, True)
        # A single random pose might be near a singularity of an arm that moves freely elsewhere.
        rng = np.random.default_rng(0)
        largest = 0.0
        for _ in range(8):
            q = rng.uniform(-np.pi, np.pi, len(self.kinds))
            largest = max(largest, abs(np.linalg.det(self._motions(q, count, point, size))))
        return Check(f"{what}, greatest determinant", largest, largest > 1e-6, "> 1e-06")

    def _motions(self, q: np.ndarray, count: int, point: np.ndarray, size: float) -> np.ndarray:
        """(count, count) the Jacobian of a point in units of the size; with its rotation if count is 6.

        Source: Spong, Robot Modeling and Control, equations (4.56)-(4.57).
        """
        frames = self.frames(q)
        tip = (frames[count] @ np.append(point, 1))[:3]
        columns = []
        for kind, frame in zip(self.kinds[:count], frames, strict=False):
            axis, none = frame[:3, 2], np.zeros(3)
            linear = np.cross(axis, tip - frame[:3, 3]) / size if kind == "R" else axis
            columns.append(np.concatenate([linear, axis if kind == "R" else none])[:count])
        return np.stack(columns, axis=1)

    def frames(self, q: np.ndarray) -> np.ndarray:
        """(n + 1, 4, 4) the base and the frame after each link at q; slides are in units of the size."""
        turns, slides = np.where(self.turns, q, 0.0), np.where(self.turns, 0.0, q * self.size)
        rows = zip(self.theta + turns, self.d + slides, self.a, self.sin, self.cos, strict=True)
        return link_frames(itertools.starmap(link_matrix, rows))
