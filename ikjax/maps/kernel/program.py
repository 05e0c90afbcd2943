"""A sweep's program, compiled once for an arm, its sets and its statistics, and called again and again.

Whole numbers go in, which say what positions and orientations, and nothing but totals
comes out.
"""

import dataclasses
import functools
import time
from collections.abc import Callable
from typing import Any

import jax
import numpy as np
from jax.sharding import Mesh, NamedSharding, PartitionSpec

from ikjax.arm.arm import Arm
from ikjax.core.xla import one_thread
from ikjax.ik.batched import THREADS
from ikjax.ik.inline import is_small
from ikjax.maps.kernel.accumulators import JOIN, Word, groups_of
from ikjax.maps.kernel.certify import Certifier, lanes_of, program
from ikjax.maps.kernel.loop import BLOCKS, CALL, ORIENTATIONS, POSITIONS, loop
from ikjax.maps.kernel.sample import GROUP
from ikjax.maps.sets.orientations import Orientations
from ikjax.maps.statistics import Plan
from ikjax.maps.store import manifest
from ikjax.solvers.pipeline import as_solved

TILES = 64
"""At most so many tiles of orientations of each block of positions in one call; between calls there is
progress to show."""

_KEPT = 8
_compiled: dict[str, tuple[Callable, Callable | None]] = {}


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
    certifier: Certifier | None = None

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

    def totals(self, index: np.ndarray, first: int) -> dict[str, np.ndarray]:
        """One call: totals of each lane, (n, k). Several may run at once, each on a thread of its own.

        Args:
            index: (n, axes) places of at most `positions` positions.
            first: From `firsts`.
        """
        count, totals = len(index), dict[str, np.ndarray]()
        share = self._share(count)
        full = np.zeros((self.devices, CALL, self.axes), np.int32)
        for device in range(self.devices):
            part = index[device * share : (device + 1) * share]
            full[device, : len(part)] = part
        left = min(self.orientations - first, self.tiles * self.width)
        numbers = map(np.int32, (first, share // POSITIONS, -(-left // self.width)))
        result = self.compiled(self.tables, full.reshape(-1, self.axes), *numbers)
        for word, array in zip(self.words, jax.device_get(result), strict=True):
            rows = np.asarray(array).reshape(self.devices, CALL, -1)[:, :share]
            rows = rows.reshape(-1, rows.shape[-1])[:count]
            if word.reduce == "count":
                totals |= {name: rows[:, k : k + 1].astype(np.int64) for k, name in enumerate(word.names)}
            elif word.reduce == "sum":
                high, low = rows[:, :1].astype(np.int64), rows[:, 1:].astype(np.int64)
                totals[word.names[0]] = (high << 16) + low
            elif word.reduce == "bits":
                totals[word.names[0]] = rows[:, : -(-left // GROUP)]
            else:
                totals[word.names[0]] = rows
        if self.certifier is not None:
            self.certifier.mend(totals, index, first)
        return totals

    def together(self, one: dict[str, np.ndarray], other: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        """Totals of two calls for the same positions, the earlier orientations first."""
        joined = {}
        for word in self.words:
            for name in word.names:
                joined[name] = JOIN[word.reduce](one[name], other[name])
        return joined

    def suit(self, seconds: float) -> float:
        """Measure the loop and let a call take about so long; goals a second on all threads."""
        times = []
        for _ in range(2):
            started = time.perf_counter()
            some = np.zeros((self.devices * CALL, self.axes), np.int32)
            jax.block_until_ready(self.compiled(self.tables, some, *map(np.int32, (0, 1, 1))))
            times.append(time.perf_counter() - started)
        one = min(times)
        self.tiles = int(np.clip(seconds / one, 1, self.tiles))
        self.blocks = int(np.clip(seconds / one / self.tiles, 1, BLOCKS))
        return THREADS * self.devices * POSITIONS * min(self.width, self.orientations) / one


def kernel_of(arm: Arm, positions, orientations: Orientations, rolls: int, dtype: np.dtype, plan: Plan):
    """The compiled loop; it is kept for the next sweep of the same arm, sets and statistics.

    Positions are shared out over this process's devices, each of which runs the same program.
    """
    given, arm = arm, as_solved(arm.astype(dtype).baked())
    place, turn = positions.tables(dtype), orientations.tables(dtype)
    groups = groups_of(plan.lanes, rolls, is_small(arm), plan.certify)
    words = [word for group in groups for word in group.words]
    devices = jax.local_devices()
    mesh = Mesh(np.array(devices), ("goals",))
    width = min(ORIENTATIONS, -(-orientations.count // GROUP) * GROUP)
    tiles = min(TILES, -(-orientations.count // width))
    key = manifest.fingerprint(
        {
            # Certified, the arm counts as it was given, and not only as it is rounded.
            "arm": manifest.of_arm(given.astype("float64") if plan.certify else arm),
            "sets": [manifest.of_set(positions), manifest.of_set(orientations)],
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
        each = functools.partial(loop, arm, positions, orientations, rolls, dtype, groups, (tiles, width))
        shapes = jax.tree.map(lambda x: jax.ShapeDtypeStruct(x.shape, x.dtype), (place, turn))
        index = jax.ShapeDtypeStruct((len(devices) * CALL, len(positions.shape)), np.int32)
        numbers = [jax.ShapeDtypeStruct((), np.int32)] * 3
        shared, whole = PartitionSpec("goals"), PartitionSpec()
        places = (whole, shared, whole, whole, whole)
        # What is the same on all devices is so by its making; nothing is exchanged.
        spread = jax.shard_map(each, mesh=mesh, in_specs=places, out_specs=shared, check_vma=False)
        jitted = jax.jit(
            spread,
            in_shardings=tuple(NamedSharding(mesh, place) for place in places),
            out_shardings=NamedSharding(mesh, shared),
            compiler_options=one_thread(),
        )
        again = lanes_of(groups)
        solved = program(given, positions, orientations, rolls, again) if again else None
        _compiled[key] = jitted.lower(shapes, index, *numbers).compile(), solved
    compiled, solved = _compiled[key]
    tables = jax.device_put((place, turn), NamedSharding(mesh, PartitionSpec()))
    kernel = Kernel(
        compiled, tables, words, orientations.count, width, len(positions.shape), tiles, len(devices)
    )
    if solved is not None:
        kernel.certifier = Certifier.of(solved, positions, orientations, groups)
    return kernel
