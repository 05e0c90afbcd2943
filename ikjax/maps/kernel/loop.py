"""The loop of a sweep: positions with every orientation, reduced inside one fused loop.

A loop with one result is fused and a loop with four is computed four times: so what counts a
goal's slots shares one number of that goal, the bits of its slots, and what needs joints shares a loop in
which every value is kept.
"""

import itertools

import jax
import jax.numpy as jnp
import numpy as np

from ikjax.arm.arm import Arm
from ikjax.core import vector
from ikjax.core.pose import Pose
from ikjax.core.xla import divider, pinning
from ikjax.maps.kernel.accumulators import (
    Group,
    added,
    blank,
    over_rolls,
    reduced,
    start,
    value_of,
    without_doubtful,
)
from ikjax.maps.kernel.sample import Goal
from ikjax.maps.sets.surface import Surface
from ikjax.solvers.pipeline import solve_scalars

POSITIONS, ORIENTATIONS = 64, 512
"""Goals in a tile: so many positions with so many orientations each."""

FEW = 8
"""Positions of a tile whose joints are needed, so that what is kept of them fits the cache."""

BLOCKS = 64
"""At most so many blocks of positions in one call."""

CALL = POSITIONS * BLOCKS
"""At most so many positions in one call."""


def loop(arm, positions, orientations, rolls, dtype, groups, size, tables, index, first, blocks, tiles):
    """Totals of every word, (CALL, k)."""
    most, width = size
    count = orientations.count
    columns = tuple(index[:, k] for k in range(index.shape[1]))
    place = positions.at(tables[0], columns, jnp, dtype)
    frame = positions.frame_at(tables[0], columns) if isinstance(positions, Surface) else None
    places = jnp.stack([jnp.broadcast_to(x, (CALL,)) for x in (*place, *sum(frame or (), ()))])
    turn = jnp.minimum(first, count - 1) + jnp.arange(most * width, dtype=jnp.int32)
    real = (turn < count).reshape(most, 1, width)
    rows = orientations.at(tables[1], jnp.minimum(turn, count - 1), jnp, dtype)
    # As arrays that the loops below are handed: inside them it would be made again for every goal.
    table = jnp.stack([jnp.broadcast_to(x, turn.shape) for row in rows for x in row])
    table = jnp.moveaxis(table.reshape(9, most, width), 1, 0)

    def total(group: Group) -> tuple[jax.Array, ...]:
        deep = FEW if any(lane.pinned for word in group.words for lane in word.lanes) else POSITIONS

        def block(b, wholes):
            here = jax.lax.dynamic_slice_in_dim(places, b * deep, deep, 1)[:, :, None]

            def tile(t, totals):
                r = jax.lax.dynamic_index_in_dim(table, t, keepdims=False)[:, None, :]
                rotation = rows_of([r[k] for k in range(9)])
                if frame is not None:
                    rotation = vector.matmul(rows_of([here[k] for k in range(3, 12)]), rotation)
                goal = Pose(rotation, tuple(here[k] for k in range(3)))
                # Where tiles are full there is nothing to leave out, and XLA sees more.
                mask = jax.lax.dynamic_index_in_dim(real, t, keepdims=False) if count % width else None
                values = each_goal(arm, group, goal, rolls, dtype, (deep, width))
                found = zip(group.words, totals, values, strict=True)
                return tuple(
                    added(word, total, reduced(word, value, mask), t) for word, total, value in found
                )

            parts = tuple(start(word, deep, most * width, dtype) for word in group.words)
            # A loop of one turn costs a tenth of the whole.
            parts = tile(0, parts) if most == 1 else jax.lax.fori_loop(0, tiles, tile, parts)
            placed = zip(wholes, parts, strict=True)
            return tuple(jax.lax.dynamic_update_slice_in_dim(*pair, b * deep, 0) for pair in placed)

        wholes = tuple(start(word, CALL, most * width, dtype) for word in group.words)
        return jax.lax.fori_loop(0, blocks * (POSITIONS // deep), block, wholes)

    return tuple(itertools.chain.from_iterable(map(total, groups)))


def rows_of(nine: list[jax.Array]) -> vector.Matrix:
    return tuple(tuple(nine[3 * i : 3 * i + 3]) for i in range(3))


def each_goal(arm: Arm, group: Group, goal: Pose, rolls: int, dtype, shape) -> tuple[jax.Array, ...]:
    """The numbers of each goal, (positions, orientations), over all rolls about its own z axis."""

    def values(rotation) -> tuple[jax.Array, ...]:
        like = jnp.broadcast_to(rotation[0][0] + goal.position[0], shape)
        policy = divider(like)
        turned = Pose(rotation, goal.position)
        with pinning(policy if group.pinned else None):
            slots = solve_scalars(arm, turned)
        seen = Goal(arm, slots, policy, shape, {}, turned)
        if group.coded:
            kinds = {lane.inside for word in group.words for lane in word.lanes}
            seen = seen.coded(sorted(kinds), group.doubt is not None)
        return tuple(value_of(word, seen, dtype) for word in group.words)

    return without_doubtful(group, _over_rolls(values, group, goal, rolls, dtype, shape))


def _over_rolls(values, group: Group, goal: Pose, rolls: int, dtype, shape) -> tuple[jax.Array, ...]:
    if rolls == 1:
        return values(goal.rotation)
    steps = np.arange(rolls) * (2 * np.pi / rolls)
    turns = jnp.asarray(np.stack([np.cos(steps), np.sin(steps)], -1).astype(dtype))

    def roll(k, totals):
        c, s = turns[k, 0], turns[k, 1]
        x, y, z = vector.transpose(goal.rotation)
        turned = (
            vector.add(vector.scale(c, x), vector.scale(s, y)),
            vector.subtract(vector.scale(c, y), vector.scale(s, x)),
            z,
        )
        found = zip(group.words, totals, values(vector.transpose(turned)), strict=True)
        return tuple(over_rolls(word, total, value) for word, total, value in found)

    return jax.lax.fori_loop(0, rolls, roll, tuple(blank(word, shape, dtype) for word in group.words))
