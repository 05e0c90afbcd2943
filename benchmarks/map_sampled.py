"""The rival map: random joints, forward kinematics, and a mark on the cell that contains the pose.

Maps of reachability are made in this way by Zacharias, Borst and Hirzinger (IROS 2007), Vahrenkamp, Asfour
and Dillmann (Simox) and RM4D (Rudorfer, arXiv 2410.06968, 2024). Here it is as fast as we could make it: one
fused loop of jax in float32 computes joints, pose and cell, and numpy sets the marks while the next batch is
computed.

A cell is a cube about a position of the grid, with all rotations whose tool axis is in one pixel of HEALPix
and whose turn about that axis is nearest. A mark means that some pose of the cell was sampled, not that its
middle, which is the goal of our map, is reached.
"""

import functools
import math
import time

import check
import jax
import jax.numpy as jnp
import numpy as np

from ikjax.core import vector
from ikjax.core.trig import atan2, sincos
from ikjax.core.xla import wide_vectors

BATCH = 500_000


class Sampler:
    """Marks cells of a box grid x a Hopf grid, for an arm of revolute joints."""

    def __init__(self, arm, grid, orientations):
        self.arm, self.grid, self.orientations = arm.astype("float32").baked(), grid, orientations
        self.hits = np.zeros(grid.count * orientations.count, bool)
        self.samples, self.seconds = 0, 0.0
        self._cells = (
            jax.jit(self.sampled_cells, compiler_options=wide_vectors()).lower(np.uint32(0)).compile()
        )

    def check(self) -> None:
        """Raise unless poses agree with `check.fk` and the middle of every cell is in that cell."""
        q = self.joints(np.uint32(0))
        rotation, position = forward(self.arm, q)
        poses = check.fk(self.arm, np.stack(q, -1)[:1000].astype(float))
        gap = [np.abs(np.asarray(position[i])[:1000] - poses[:, i, 3]).max() for i in range(3)]
        gap += [
            np.abs(np.asarray(rotation[i][j])[:1000] - poses[:, i, j]).max()
            for i in range(3)
            for j in range(3)
        ]
        turns = np.moveaxis(self.orientations.rotations.astype(np.float32), 0, -1)
        points = np.moveaxis(self.grid.points().reshape(-1, 3).astype(np.float32), 0, -1)
        first = self.cell(tuple(map(tuple, turns)), tuple(np.float32(x) for x in self.grid.origin))
        last = self.cell(tuple(map(tuple, turns[..., -1])), tuple(points))
        size = self.orientations.count
        same = (first == np.arange(size)).all() and (
            last == np.arange(len(points[0])) * size + size - 1
        ).all()
        if not same or max(gap) > 1e-5:
            raise RuntimeError(f"the sampler is wrong: cells {same}, poses off by {max(gap):.1e}")

    def sample_until(self, samples: int) -> None:
        """Draw until there are at least this many samples."""
        started = time.perf_counter()
        batches = range(self.samples // BATCH, -(-samples // BATCH))
        waiting = None
        for number in [*batches, None]:
            ready = waiting
            # The next batch is computed while this one is marked.
            waiting = None if number is None else self._cells(np.uint32(number * BATCH))
            if ready is not None:
                self.hits[np.asarray(ready)] = True
        self.samples = max(self.samples, -(-samples // BATCH) * BATCH)
        self.seconds += time.perf_counter() - started

    def marks(self) -> np.ndarray:
        """(*grid.shape, orientations) bool."""
        return self.hits.reshape(*self.grid.shape, self.orientations.count)

    def joints(self, first) -> list[jax.Array]:
        """A batch, uniform within the limits; a joint without limits covers one turn."""
        number = first + jnp.arange(BATCH, dtype=jnp.uint32)
        low, high = np.asarray(self.arm.limits, np.float32).T
        low, high = np.where(np.isfinite(low), low, -np.pi), np.where(np.isfinite(high), high, np.pi)
        parts = enumerate(zip(low, high, strict=True))
        return [np.float32(a) + np.float32(b - a) * uniform(number, k) for k, (a, b) in parts]

    def sampled_cells(self, first) -> jax.Array:
        """Cells (BATCH,) of a batch."""
        return self.cell(*forward(self.arm, self.joints(first)))

    def cell(self, rotation, position) -> jax.Array:
        """The number of the cell of each pose."""
        place = jnp.zeros(jnp.shape(position[0]), jnp.int32)
        for k, size in enumerate(self.grid.shape):
            step = (position[k] - np.float32(self.grid.origin[k])) * np.float32(1 / self.grid.spacing)
            place = place * size + jnp.clip(jnp.rint(step).astype(jnp.int32), 0, size - 1)
        return place * self.orientations.count + orientation(self.orientations, rotation)


def uniform(number, stream: int) -> jax.Array:
    """Random numbers on [0, 1) by hashing their index: jax's own take twice as long as all the rest.

    Source: Wellons, hash-prospector, triple32.
    """
    x = number * np.uint32(0x9E3779B9) + np.uint32(0x85EBCA6B * (stream + 1) & 0xFFFFFFFF)
    for shift, factor in ((17, 0xED5AD4BB), (11, 0xAC4C1B51), (15, 0x31848BAB)):
        x = (x ^ (x >> np.uint32(shift))) * np.uint32(factor)
    x = x ^ (x >> np.uint32(14))
    return (x >> np.uint32(8)).astype(jnp.float32) * np.float32(2**-24)


def forward(arm, q):
    """Rotation and position in scalars, one array each; the arm's numbers are constants."""
    table = [np.asarray(getattr(arm, name), np.float32) for name in ("a", "alpha", "d", "theta")]
    pose = _parts(arm.base)
    for angle, a, alpha, d, theta in zip(q, *table, strict=True):
        s, c = sincos(angle + theta)
        sa, ca = np.float32(_round(math.sin(alpha))), np.float32(_round(math.cos(alpha)))
        pose = _after(pose, ((c, -s * ca, s * sa), (s, c * ca, -c * sa), (0.0, sa, ca)), (a * c, a * s, d))
    return _after(pose, *_parts(arm.tool))


def _round(x: float) -> float:
    """Exact values at right angles: pi / 2 rounded to float32 has a cosine of 4e-8."""
    return round(x) if abs(x - round(x)) < 1e-6 else x


def _parts(pose):
    pose = np.asarray(pose, np.float32)
    return tuple(tuple(row[:3]) for row in pose[:3]), tuple(pose[:3, 3])


def _after(pose, turn, shift):
    rotation, position = pose
    moved = tuple(
        p + functools.reduce(_plus, (r * t for r, t in zip(row, shift, strict=True)))
        for row, p in zip(rotation, position, strict=True)
    )
    columns = tuple(zip(*turn, strict=True))
    turned = tuple(
        tuple(
            functools.reduce(_plus, (r * t for r, t in zip(row, column, strict=True))) for column in columns
        )
        for row in rotation
    )
    return turned, moved


def _plus(a, b):
    return a + b


def orientation(hopf, rotation) -> jax.Array:
    """The rotation of a Hopf grid in whose cell each rotation is."""
    chosen = pixel(hopf.side, *(row[2] for row in rotation))
    # The first two columns of the rotation from z to the middle of the pixel, from a table: computing them
    # needs integer divisions, which are not vectorized.
    tilts = hopf.rotations.reshape(-1, hopf.turns, 3, 3)[:, 0, :, :2].astype(np.float32)
    one, two = ([jnp.asarray(tilts[:, i, k])[chosen] for i in range(3)] for k in range(2))
    x, y, _ = zip(*rotation, strict=True)
    s, c = vector.dot(two, x) - vector.dot(one, y), vector.dot(one, x) + vector.dot(two, y)
    turn = jnp.rint(atan2(s, c) * np.float32(hopf.turns / math.tau)).astype(jnp.int32)
    turn = jnp.where(turn < 0, turn + hopf.turns, turn)
    return chosen * hopf.turns + jnp.where(turn == hopf.turns, 0, turn)


def pixel(n: int, x, y, z):
    """HEALPix's pixel, in rings, of directions: Gorski et al., ApJ 622 (2005), section 5.

    Args:
        n: Pixels along a side of a diamond.
        x, y, z: Unit vectors.
    """
    quarter = atan2(y, x) * np.float32(2 / math.pi)
    quarter = jnp.where(quarter < 0, quarter + 4, quarter)
    # The equatorial belt: rising and falling lines bound the pixels.
    rising = jnp.floor(n * (0.5 + quarter - 0.75 * z)).astype(jnp.int32)
    falling = jnp.floor(n * (0.5 + quarter + 0.75 * z)).astype(jnp.int32)
    ring = n + 1 + rising - falling
    odd = 1 - (ring & 1)
    belt_place = (rising + falling - n + odd + 1) >> 1
    belt_place = jnp.where(belt_place >= 4 * n, belt_place - 4 * n, belt_place)
    belt = 2 * n * (n - 1) + (ring - 1) * 4 * n + belt_place
    # The polar caps.
    part = quarter - jnp.floor(quarter)
    # n sqrt(3 (1 - |z|)), from the other components: near a pole 1 - |z| has lost its digits.
    wide = n * jnp.sqrt(3 * (x * x + y * y) / (1 + jnp.abs(z)))
    up, down = jnp.floor(part * wide).astype(jnp.int32), jnp.floor((1 - part) * wide).astype(jnp.int32)
    rank = up + down + 1
    cap_place = jnp.floor(quarter * rank).astype(jnp.int32)
    cap_place = jnp.where(cap_place == 4 * rank, 0, cap_place)
    north = 2 * rank * (rank - 1) + cap_place
    south = 12 * n * n - 2 * rank * (rank + 1) + cap_place
    return jnp.where(jnp.abs(z) <= 2 / 3, belt, jnp.where(z > 0, north, south))
