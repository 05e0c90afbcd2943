"""The sweep: every position with every orientation, counted inside one fused loop.

Storey: study. Goals are made from integers inside jit and nothing but statistics leaves it. The
four counts of 32 goals travel as bit fields of one 32-bit sum, because a loop with one result is
fused and a loop with four is computed four times.
"""

import functools
import math
import sys
import time
from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np

from ikjax.arm.arm import Arm
from ikjax.core.pose import Pose
from ikjax.ik.blocks import wide_vectors
from ikjax.ik.graph import holder, is_small
from ikjax.ik.solve import check_family
from ikjax.solvers.family import TOLERANCE, Slot, solve_scalars
from ikjax.study.goals import Grid, even_rotations
from ikjax.study.limits import within
from ikjax.study.reach import ReachMap

POSITIONS, ORIENTATIONS = 64, 512
"""Goals in a tile: so many positions with so many orientations each."""

GROUP = 32
"""Goals whose counts share one 32-bit sum: fields of 6, 9, 6 and 9 bits."""

TILES = 64
"""Blocks of positions in one call; between calls there is progress to show."""


MOST_POSITIONS = 2**31 - POSITIONS * TILES
"""Positions are numbered in 32 bits."""


def sweep(
    arm: Arm,
    positions: Grid,
    orientations,
    *,
    dtype=None,
    progress: bool = False,
) -> ReachMap:
    """Which of `positions` x `orientations` the arm reaches, in how many ways, how safely.

    Args:
        arm: An arm with a family.
        positions: `ikjax.grid(...)` or `ikjax.around(arm, spacing)`.
        orientations: A number, for that many even ones over all rotations, or rotations (m, 3, 3).
        dtype: float32 or float64 of the kernel; by default the arm's.
        progress: Show a bar with rate and time left on stderr.

    Returns:
        A `ReachMap`: counts for every position, exact at each goal up to rounding at folds.

    Raises:
        ValueError: An arm of no family, or orientations that are no rotations.
    """
    check_family(arm)
    if arm.task.startswith("planar"):
        raise ValueError(
            f"{arm.name} moves in a plane (task {arm.task!r}), so a map in space says nothing of it"
        )
    rotations = _rotations(orientations)
    dtype = np.dtype(arm.dtype if dtype is None else dtype)
    if dtype.name not in TOLERANCE:
        raise ValueError(f"dtype must be float32 or float64, got {dtype}")
    if positions.count > MOST_POSITIONS:
        raise ValueError(
            f"positions must be at most {MOST_POSITIONS:,} in one sweep, got {positions.count:,}"
        )
    if jnp.zeros((), dtype).dtype != dtype:
        raise ValueError(f"dtype {dtype} needs jax_enable_x64")
    unit = _compile_unit(arm, positions, rotations, dtype)
    step = POSITIONS * TILES
    started = time.perf_counter()
    pieces, waiting = [], None
    for start in _with_progress(range(0, positions.count, step), positions.count * len(rotations), progress):
        # One call is always under way while the one before it is fetched.
        ready, waiting = waiting, unit(np.int32(start // POSITIONS))
        if ready is not None:
            pieces.append(jax.device_get(ready))
    pieces.append(jax.device_get(waiting))
    seconds = time.perf_counter() - started
    counts, margin = (
        np.concatenate([p[k].reshape(-1, *p[k].shape[2:]) for p in pieces])[: positions.count] for k in (0, 1)
    )
    reachable, solutions, reachable_within, solutions_within = (
        counts[:, k].reshape(positions.shape) for k in range(4)
    )
    return ReachMap(
        arm=arm,
        grid=positions,
        rotations=rotations,
        dtype=dtype.name,
        reachable=reachable,
        solutions=solutions,
        reachable_within=reachable_within,
        solutions_within=solutions_within,
        best_margin=margin.reshape(positions.shape).astype(np.float32),
        seconds=seconds,
    )


def _rotations(orientations) -> np.ndarray:
    if np.ndim(orientations) == 0:
        return even_rotations(int(orientations))
    rotations = np.asarray(orientations, float)
    if rotations.ndim != 3 or rotations.shape[1:] != (3, 3) or len(rotations) == 0:
        raise ValueError(f"orientations must be a number or rotations (m, 3, 3), got {rotations.shape}")
    gap = np.linalg.norm(np.swapaxes(rotations, 1, 2) @ rotations - np.eye(3), axis=(1, 2))
    bad = ~(gap <= 1e-5) | (np.linalg.det(rotations) < 0)
    if bad.any():
        i = int(np.argmax(bad))
        raise ValueError(f"orientations[{i}] must be a rotation, its R^T R - I has norm {gap[i]:.1g}")
    return rotations


def _compile_unit(arm: Arm, positions: Grid, rotations: np.ndarray, dtype) -> Callable:
    """The statistics of `TILES` blocks of positions, as a function of the first block's number."""
    arm = arm.astype(dtype).baked()
    count = len(rotations)
    padded = -(-count // GROUP) * GROUP
    width = min(ORIENTATIONS, padded)
    tiles = -(-padded // width)
    # The last tile is filled up with rotations that do not count.
    filled = np.resize(rotations, (tiles * width, 3, 3)).astype(dtype)
    table = jnp.asarray(filled.reshape(tiles, width, 9))
    real = jnp.asarray((np.arange(tiles * width) < count).reshape(tiles, 1, width))

    def block(statistic, number):
        place = _positions(positions, number, dtype)

        def tile(rotation_and_real):
            rotation, real = rotation_and_real
            r = [rotation[:, k].reshape(1, width) for k in range(9)]
            goal = Pose((tuple(r[0:3]), tuple(r[3:6]), tuple(r[6:9])), place)
            hold = None if is_small(arm) else holder(r[0] + place[0])
            return statistic(arm, solve_scalars(arm, goal, hold=hold), real)

        return jax.lax.map(tile, (table, real))

    def unit(first):
        numbers = first + jnp.arange(TILES, dtype=jnp.int32)
        # Two loops, because in one XLA would keep every square root that both results need.
        counts = jax.lax.map(lambda n: block(_counts, n).sum(0), numbers)
        return counts, jax.lax.map(lambda n: block(_best_margin, n).max(0), numbers)

    options = wide_vectors()
    return jax.jit(unit, compiler_options=options).lower(np.int32(0)).compile()


def _positions(positions: Grid, number, dtype):
    """The positions of a block, as three columns; numbers past the end repeat the last."""
    index = jnp.minimum(number * POSITIONS + jnp.arange(POSITIONS, dtype=jnp.int32), positions.count - 1)
    _, ny, nz = positions.shape
    steps = (index // (ny * nz), index // nz % ny, index % nz)
    spacing = dtype.type(positions.spacing)
    return tuple(
        (dtype.type(origin) + spacing * step.astype(dtype)).reshape(POSITIONS, 1)
        for origin, step in zip(positions.origin, steps, strict=True)
    )


def _counts(arm: Arm, slots: tuple[Slot, ...], real) -> jax.Array:
    """Counts (positions, 4) of one tile."""
    valid = [slot.valid & real for slot in slots]
    inside = [v & within(arm, slot) for v, slot in zip(valid, slots, strict=True)]
    fields = []
    for flags in (valid, inside):
        number = functools.reduce(jnp.add, [flag.astype(jnp.int32) for flag in flags])
        fields += [(number > 0).astype(jnp.int32), number]
    code = fields[0] + (fields[1] << 6) + (fields[2] << 15) + (fields[3] << 21)
    groups = code.reshape(code.shape[0], -1, GROUP).sum(-1, dtype=jnp.int32)
    counts = [groups & 63, groups >> 6 & 511, groups >> 15 & 63, groups >> 21 & 511]
    return jnp.stack([count.sum(-1) for count in counts], axis=-1)


def _best_margin(arm: Arm, slots: tuple[Slot, ...], real) -> jax.Array:
    """Greatest margin (positions,) of one tile."""
    margin = functools.reduce(jnp.maximum, [slot.margin for slot in slots])
    return jnp.where(real, margin, -jnp.inf).max(-1)


def _with_progress(starts: range, goals: int, show: bool):
    if not show:
        yield from starts
        return
    from tqdm import tqdm

    scale = goals / max(len(starts), 1)
    bar = tqdm(total=goals, unit=" goals", unit_scale=True, file=sys.stderr, mininterval=0.5)
    with bar:
        for start in starts:
            yield start
            bar.update(min(math.ceil(scale), goals - bar.n))
