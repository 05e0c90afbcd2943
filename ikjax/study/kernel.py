"""The loop of a sweep: positions with every orientation, counted inside one fused loop.

Storey: study. Nothing but statistics leaves it. The four counts of 32 goals travel as bit fields of one
32-bit sum, because a loop with one result is fused and a loop with four is computed four times.
"""

import functools
from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np

from ikjax.arm.arm import Arm
from ikjax.core.pose import Pose
from ikjax.ik.blocks import wide_vectors
from ikjax.ik.graph import holder, is_small
from ikjax.solvers.family import Slot, solve_scalars
from ikjax.study import spec
from ikjax.study.limits import within

POSITIONS, ORIENTATIONS = 64, 512
"""Goals in a tile: so many positions with so many orientations each."""

GROUP = 32
"""Goals whose counts share one 32-bit sum: fields of 6, 9, 6 and 9 bits."""

TILES = 64
"""Blocks of positions in one call; between calls there is progress to show."""

CALL = POSITIONS * TILES
"""Positions in one call."""

_KEPT = 8
_compiled: dict[str, Callable] = {}


def statistics_of(arm: Arm, rotations: np.ndarray, dtype: np.dtype, margin: bool) -> Callable:
    """The compiled loop: positions (CALL, 3) -> counts (CALL, 4) and, if asked for, margins (CALL,).

    It is kept for the next sweep of the same arm and orientations.
    """
    key = spec.fingerprint(
        {"arm": spec.of_arm(arm), "rotations": spec.hash_of(rotations), "dtype": dtype.name, "margin": margin}
    )
    if key not in _compiled:
        while len(_compiled) >= _KEPT:
            _compiled.pop(next(iter(_compiled)))
        _compiled[key] = _compile(arm, rotations, dtype, margin)
    return _compiled[key]


def _compile(arm: Arm, rotations: np.ndarray, dtype: np.dtype, margin: bool) -> Callable:
    arm = arm.astype(dtype).baked()
    count = len(rotations)
    padded = -(-count // GROUP) * GROUP
    width = min(ORIENTATIONS, padded)
    tiles = -(-padded // width)
    # The last tile is filled up with rotations that do not count.
    filled = np.resize(rotations, (tiles * width, 3, 3)).astype(dtype)
    table = jnp.asarray(filled.reshape(tiles, width, 9))
    real = jnp.asarray((np.arange(tiles * width) < count).reshape(tiles, 1, width))

    def block(statistic, positions):
        place = tuple(positions[:, k].reshape(POSITIONS, 1) for k in range(3))

        def tile(rotation_and_real):
            rotation, real = rotation_and_real
            r = [rotation[:, k].reshape(1, width) for k in range(9)]
            goal = Pose((tuple(r[0:3]), tuple(r[3:6]), tuple(r[6:9])), place)
            hold = None if is_small(arm) else holder(r[0] + place[0])
            return statistic(arm, solve_scalars(arm, goal, hold=hold), real)

        return jax.lax.map(tile, (table, real))

    def call(positions):
        blocks = positions.reshape(TILES, POSITIONS, 3)
        # Two loops, because in one XLA would keep every square root that both results need.
        counts = jax.lax.map(lambda p: block(_counts, p).sum(0, dtype=jnp.int32), blocks).reshape(CALL, 4)
        if not margin:
            return (counts,)
        return counts, jax.lax.map(lambda p: block(_best_margin, p).max(0), blocks).reshape(CALL)

    shape = jax.ShapeDtypeStruct((CALL, 3), dtype)
    return jax.jit(call, compiler_options=wide_vectors()).lower(shape).compile()


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
    return jnp.stack([count.sum(-1, dtype=jnp.int32) for count in counts], axis=-1)


def _best_margin(arm: Arm, slots: tuple[Slot, ...], real) -> jax.Array:
    """Greatest margin (positions,) of one tile."""
    margin = functools.reduce(jnp.maximum, [slot.margin for slot in slots])
    return jnp.where(real, margin, -jnp.inf).max(-1)
