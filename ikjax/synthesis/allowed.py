"""Where a base may stand: in one of several regions, away from boxes and from the points of parts."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from scipy.spatial import cKDTree

from ikjax.maps.sets.surface import Surface

MOST_POINTS = 4096
"""Points of parts that polishing looks at; of more, every n-th. Results are checked with all of them."""


class Allowed(NamedTuple):
    """The places that a base may have; arrays alone, so that a program does not depend on the numbers."""

    regions: Any
    """(r, 2, 3) corners [m], of which one must hold the base; none where it may stand anywhere."""
    boxes: Any
    """(b, 2, 3) corners [m] of what it must keep out of."""
    points: Any
    """(p, 3) of parts [m]."""
    clearance: Any
    """() least distance from boxes and points [m]."""
    to_world: Any
    """(4, 4) from the frame of the search to the world; the identity without a rail."""

    def at(self, places: np.ndarray) -> np.ndarray:
        """Whether each place (..., 3) is allowed, on the host and with all points."""
        world = places @ self.to_world[:3, :3].T + self.to_world[:3, 3]
        good = self._in_regions_and_out_of_boxes(np, world)
        if len(self.points):
            good &= cKDTree(self.points).query(world)[0] >= self.clearance
        return good

    def at_one(self, place):
        """Whether a place (3,) is allowed, traced."""
        world = jnp.stack([
            sum(self.to_world[i, k] * place[k] for k in range(3)) + self.to_world[i, 3] for i in range(3)
        ])  # fmt: skip
        good = self._in_regions_and_out_of_boxes(jnp, world)
        gap = self.points - world[None]
        return good & ((gap * gap).sum(-1) >= self.clearance**2).all()

    def _in_regions_and_out_of_boxes(self, xp: Any, world):
        at = world[..., None, :]
        slack = 1e-9
        good = xp.ones(world.shape[:-1], bool)
        if len(self.regions):
            inside = (at >= self.regions[:, 0] - slack) & (at <= self.regions[:, 1] + slack)
            good = inside.all(-1).any(-1)
        if len(self.boxes):
            off = xp.maximum(xp.maximum(self.boxes[:, 0] - at, at - self.boxes[:, 1]), 0)
            touching = (off == 0).all(-1)
            near = (off * off).sum(-1) < self.clearance**2
            good = good & ~(touching | near).any(-1)
        return good

    def for_program(self, dtype) -> "Allowed":
        """The same of a floating type, with at most `MOST_POINTS` points."""
        step = max(1, -(-len(self.points) // MOST_POINTS))
        thin = self._replace(points=self.points[::step])
        return Allowed(*(np.asarray(x, dtype) for x in thin))


def allowed(
    regions: Sequence[np.ndarray],
    keep_out: Sequence | np.ndarray | None,
    parts: np.ndarray | Surface | None,
    clearance: float,
    to_world: np.ndarray,
) -> Allowed:
    """Where a base may stand, of checked arguments of `place`.

    Args:
        regions: (2, 3) corners each.
        keep_out: Boxes (b, 2, 3), or one (2, 3).
        parts: Points (p, 3).
        clearance: [m]
        to_world: (4, 4).

    Raises:
        ValueError: Boxes of a wrong shape or corners out of order, points of a wrong shape, a negative
            clearance, or a clearance of nothing.
    """
    boxes = np.zeros((0, 2, 3)) if keep_out is None else np.asarray(keep_out, float)
    boxes = boxes[None] if boxes.ndim == 2 else boxes
    if boxes.ndim != 3 or boxes.shape[1:] != (2, 3) or not (boxes[:, 0] <= boxes[:, 1]).all():
        raise ValueError(f"keep_out must be boxes (b, 2, 3), lower corners first, got shape {boxes.shape}")
    points = parts.points() if isinstance(parts, Surface) else parts
    points = np.zeros((0, 3)) if points is None else np.asarray(points, float)
    if points.ndim != 2 or points.shape[1] != 3 or not np.isfinite(points).all():
        raise ValueError(f"parts must be points (p, 3), got shape {points.shape}")
    if not 0 <= clearance < np.inf:
        raise ValueError(f"clearance must be a length, zero or more, got {clearance}")
    if clearance == 0 and len(points):
        raise ValueError("parts need a clearance [m]")
    corners = np.array(list(regions), float).reshape(-1, 2, 3)
    return Allowed(corners, boxes, points, np.asarray(float(clearance)), to_world)
