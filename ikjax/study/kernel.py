"""The loop of a sweep: positions with every orientation, reduced inside one fused loop.

Storey: study. Whole numbers go in, which say what positions and orientations, and nothing but totals
comes out. A loop with one result is fused and a loop with four is computed four times: so what counts a
goal's slots shares one number of that goal, the bits of its slots, and what needs joints shares a loop in
which every value is kept.
"""

import dataclasses
import functools
import itertools
import time
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh, NamedSharding, PartitionSpec

from ikjax.arm.arm import Arm
from ikjax.core import vector
from ikjax.core.pose import Pose
from ikjax.ik.blocks import wide_vectors
from ikjax.ik.graph import holder, is_small
from ikjax.solvers.family import solve_scalars
from ikjax.study import spec
from ikjax.study.goal import GROUP, Goal
from ikjax.study.orientations import Orientations
from ikjax.study.statistics import Plan
from ikjax.study.surface import Surface
from ikjax.study.words import (
    JOIN,
    Group,
    Word,
    added,
    blank,
    groups_of,
    over_rolls,
    reduced,
    start,
    value_of,
)

POSITIONS, ORIENTATIONS = 64, 512
"""Goals in a tile: so many positions with so many orientations each."""

FEW = 8
"""Positions of a tile whose values are held, so that they fit the cache."""

BLOCKS, TILES = 64, 64
"""At most so many blocks of positions, with so many tiles of orientations each, in one call; between calls
there is progress to show."""

CALL = POSITIONS * BLOCKS
"""At most so many positions in one call."""

_KEPT = 8
_compiled: dict[str, Callable] = {}


@dataclasses.dataclass
class Kernel:
    """A compiled loop and how much of it to do in one call."""

    compiled: Callable
    tables: tuple[Any, ...]
    words: list[Word]
    orientations: int
    width: int
    """Orientations in a tile."""
    axes: int
    """Whole numbers that say where a position is."""
    tiles: int
    """Of orientations in one call."""
    devices: int
    blocks: int = BLOCKS
    """Of positions on each device in one call."""

    @property
    def positions(self) -> int:
        """In one call."""
        return POSITIONS * self.blocks * self.devices

    def _share(self, count: int) -> int:
        """Of so many positions, those on each device: whole blocks."""
        return -(-count // (POSITIONS * self.devices)) * POSITIONS

    def firsts(self) -> range:
        """The first orientation of each call for the same positions."""
        return range(0, self.orientations, self.tiles * self.width)

    def begin(self, index: np.ndarray, first: int) -> tuple[jax.Array, ...]:
        """One call: what is under way.

        Args:
            index: (n, axes) places of at most `positions` positions.
            first: From `firsts`.
        """
        share = self._share(len(index))
        full = np.zeros((self.devices, CALL, self.axes), np.int32)
        for device in range(self.devices):
            part = index[device * share : (device + 1) * share]
            full[device, : len(part)] = part
        blocks = np.int32(share // POSITIONS)
        left = -(-(self.orientations - first) // self.width)
        tiles = np.int32(min(self.tiles, left))
        return self.compiled(self.tables, full.reshape(-1, self.axes), np.int32(first), blocks, tiles)

    def fetched(self, result: tuple[jax.Array, ...], count: int, first: int) -> dict[str, np.ndarray]:
        """Totals of each lane, (count, k), of a call that is done."""
        totals: dict[str, np.ndarray] = {}
        for word, array in zip(self.words, jax.device_get(result), strict=True):
            rows = np.asarray(array).reshape(self.devices, CALL, -1)[:, : self._share(count)]
            rows = rows.reshape(-1, rows.shape[-1])[:count]
            if word.reduce == "count":
                totals |= {name: rows[:, k : k + 1].astype(np.int64) for k, name in enumerate(word.names)}
            elif word.reduce == "sum":
                high, low = rows[:, :1].astype(np.int64), rows[:, 1:].astype(np.int64)
                totals[word.names[0]] = (high << 16) + low
            elif word.reduce == "bits":
                left = min(self.orientations - first, self.tiles * self.width)
                totals[word.names[0]] = rows[:, : -(-left // GROUP)]
            else:
                totals[word.names[0]] = rows
        return totals

    def together(self, one: dict[str, np.ndarray], other: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        """Totals of two calls for the same positions, the earlier orientations first."""
        joined = {}
        for word in self.words:
            for name in word.names:
                joined[name] = JOIN[word.reduce](one[name], other[name])
        return joined

    def suit(self, seconds: float) -> float:
        """Measure the loop and let a call take about so long; goals a second."""
        times = []
        for _ in range(2):
            started = time.perf_counter()
            some = np.zeros((self.devices * CALL, self.axes), np.int32)
            jax.block_until_ready(self.compiled(self.tables, some, *map(np.int32, (0, 1, 1))))
            times.append(time.perf_counter() - started)
        one = min(times)
        self.tiles = int(np.clip(seconds / one, 1, self.tiles))
        self.blocks = int(np.clip(seconds / one / self.tiles, 1, BLOCKS))
        return self.devices * POSITIONS * min(self.width, self.orientations) / one


def kernel_of(arm: Arm, positions, orientations: Orientations, rolls: int, dtype: np.dtype, plan: Plan):
    """The compiled loop; it is kept for the next sweep of the same arm, sets and statistics.

    Positions are shared out over this process's devices, each of which runs the same program.
    """
    arm = arm.astype(dtype).baked()
    place, turn = positions.tables(dtype), orientations.tables(dtype)
    groups = groups_of(plan.lanes, rolls, len(arm.branches), is_small(arm))
    words = [word for group in groups for word in group.words]
    devices = jax.local_devices()
    mesh = Mesh(np.array(devices), ("goals",))
    width = min(ORIENTATIONS, -(-orientations.count // GROUP) * GROUP)
    tiles = min(TILES, -(-orientations.count // width))
    key = spec.fingerprint(
        {
            "arm": spec.of_arm(arm),
            "sets": [spec.of_set(positions), spec.of_set(orientations)],
            "shapes": [x.shape for x in (*place, *turn)],
            "rolls": rolls,
            "devices": len(devices),
            "dtype": dtype.name,
            "statistics": plan.told(),
        }
    )
    if key not in _compiled:
        while len(_compiled) >= _KEPT:
            _compiled.pop(next(iter(_compiled)))
        loop = functools.partial(_loop, arm, positions, orientations, rolls, dtype, groups, (tiles, width))
        shapes = jax.tree.map(lambda x: jax.ShapeDtypeStruct(x.shape, x.dtype), (place, turn))
        index = jax.ShapeDtypeStruct((len(devices) * CALL, len(positions.shape)), np.int32)
        numbers = [jax.ShapeDtypeStruct((), np.int32)] * 3
        shared, whole = PartitionSpec("goals"), PartitionSpec()
        places = (whole, shared, whole, whole, whole)
        # What is the same on all devices is so by its making; nothing is exchanged.
        spread = jax.shard_map(loop, mesh=mesh, in_specs=places, out_specs=shared, check_vma=False)
        jitted = jax.jit(
            spread,
            in_shardings=tuple(NamedSharding(mesh, place) for place in places),
            out_shardings=NamedSharding(mesh, shared),
            compiler_options=wide_vectors(),
        )
        _compiled[key] = jitted.lower(shapes, index, *numbers).compile()
    tables = jax.device_put((place, turn), NamedSharding(mesh, PartitionSpec()))
    return Kernel(
        _compiled[key], tables, words, orientations.count, width, len(positions.shape), tiles, len(devices)
    )


def _loop(arm, positions, orientations, rolls, dtype, groups, size, tables, index, first, blocks, tiles):
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
        deep = FEW if any(lane.held for word in group.words for lane in word.lanes) else POSITIONS

        def block(b, wholes):
            here = jax.lax.dynamic_slice_in_dim(places, b * deep, deep, 1)[:, :, None]

            def tile(t, totals):
                r = jax.lax.dynamic_index_in_dim(table, t, keepdims=False)[:, None, :]
                rotation = _rows([r[k] for k in range(9)])
                if frame is not None:
                    rotation = vector.matmul(_rows([here[k] for k in range(3, 12)]), rotation)
                goal = Pose(rotation, tuple(here[k] for k in range(3)))
                # Where tiles are full there is nothing to leave out, and XLA sees more.
                mask = jax.lax.dynamic_index_in_dim(real, t, keepdims=False) if count % width else None
                values = _over_rolls(arm, group, goal, rolls, dtype, (deep, width))
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


def _rows(nine: list[jax.Array]) -> vector.Matrix:
    return tuple(tuple(nine[3 * i : 3 * i + 3]) for i in range(3))


def _over_rolls(arm: Arm, group: Group, goal: Pose, rolls: int, dtype, shape) -> tuple[jax.Array, ...]:
    """The numbers of each goal, (positions, orientations), over all rolls about its own z axis."""

    def values(rotation) -> tuple[jax.Array, ...]:
        like = jnp.broadcast_to(rotation[0][0] + goal.position[0], shape)
        hold = holder(like)
        slots = solve_scalars(arm, Pose(rotation, goal.position), hold=hold if group.held else None)
        seen = Goal(arm, slots, hold, shape, {})
        if group.coded:
            seen = seen.coded(sorted({lane.inside for word in group.words for lane in word.lanes}))
        return tuple(value_of(word, seen, dtype) for word in group.words)

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
