"""A sweep's program, compiled once for an arm, its sets and its statistics, and called many times.

Its inputs are whole numbers that say which positions and orientations; its outputs are reduced results.
"""

import dataclasses
import functools
import time
from collections.abc import Callable
from typing import Any

import jax
import numpy as np
from jax.sharding import Mesh, NamedSharding, PartitionSpec

from ikjax.core.xla import one_thread
from ikjax.ik.batched import THREADS
from ikjax.ik.inline import is_small
from ikjax.maps.kernel.accumulators import JOIN_CALLS, Accumulator, passes_for
from ikjax.maps.kernel.certify import Between, Certifier, certified_channels, certifying_program
from ikjax.maps.kernel.loop import BLOCKS, CALL, ORIENTATIONS, POSITIONS, LoopSpec, loop, trials_of
from ikjax.maps.kernel.mounted import Mounted, Parts, parts_of
from ikjax.maps.kernel.sample import GOALS_PER_WORD
from ikjax.maps.sets.positions import Grid
from ikjax.maps.sets.protocol import Tables
from ikjax.maps.statistics import Plan
from ikjax.maps.store import manifest
from ikjax.solvers.pipeline import as_solved

TILES = 64
"""At most so many tiles of orientations of each block of positions in one call; between calls there is
progress to show."""

_CACHE_SIZE = 8
"""Programs that are kept; the oldest is dropped first."""
_compiled: dict[str, tuple[Callable, tuple[Callable, Between | None] | None]] = {}
"""By fingerprint: the loop, and what certifies, if anything does."""


@dataclasses.dataclass
class Kernel:
    """A compiled loop and how much of it to do in one call."""

    compiled: Callable
    """`loop`, over all devices of this process."""
    tables: tuple[tuple[Tables, Tables], Mounted | None]
    """What the sets of positions and of orientations look up, and the arm's numbers that are data, on every
    device."""
    accumulators: list[Accumulator]
    """What the program returns, in order."""
    orientations: int
    """Number of orientations of the sweep."""
    width: int
    """Orientations in a tile."""
    axes: int
    """Whole numbers that say where a position is."""
    tiles: int
    """Tiles of orientations in one call."""
    devices: int
    """Devices of this process."""
    blocks: int = BLOCKS
    """Blocks of positions on each device in one call."""
    certifier: Certifier | None = None
    """Solves doubtful goals again; None where nothing is certified."""

    @property
    def positions(self) -> int:
        """At most so many positions in one call."""
        return POSITIONS * self.blocks * self.devices

    def _per_device(self, count: int) -> int:
        """Positions on each device, of `count` in all: whole blocks."""
        return -(-count // (POSITIONS * self.devices)) * POSITIONS

    def first_orientations(self) -> range:
        """The first orientation of each call for the same positions."""
        return range(0, self.orientations, self.tiles * self.width)

    def accumulate(self, index: np.ndarray, first: int) -> dict[str, np.ndarray]:
        """One call: the results of each channel. Several may run at once, each on a thread of its own.

        Args:
            index: (n, axes) int32, places of at most `positions` positions.
            first: From `first_orientations`.

        Returns:
            By channel, (n, 1) int64 of counts and sums, (n, 1) of extremes in the kernel's type, and
            (n, words) uint32 of bits: 32 orientations a word.
        """
        count, results = len(index), dict[str, np.ndarray]()
        per_device = self._per_device(count)
        full = np.zeros((self.devices, CALL, self.axes), np.int32)
        for device in range(self.devices):
            part = index[device * per_device : (device + 1) * per_device]
            full[device, : len(part)] = part
        left = min(self.orientations - first, self.tiles * self.width)
        numbers = map(np.int32, (first, per_device // POSITIONS, -(-left // self.width)))
        returned = self.compiled(*self.tables, full.reshape(-1, self.axes), *numbers)
        for accumulator, array in zip(self.accumulators, jax.device_get(returned), strict=True):
            rows = np.asarray(array).reshape(self.devices, CALL, -1)[:, :per_device]
            rows = rows.reshape(-1, rows.shape[-1])[:count]
            names = accumulator.names
            if accumulator.reduce == "count":
                results |= {name: rows[:, k : k + 1].astype(np.int64) for k, name in enumerate(names)}
            elif accumulator.reduce == "sum":
                high, low = rows[:, :1].astype(np.int64), rows[:, 1:].astype(np.int64)
                results[names[0]] = (high << 16) + low
            elif accumulator.reduce == "bits":
                results[names[0]] = rows[:, : -(-left // GOALS_PER_WORD)]
            else:
                results[names[0]] = rows
        if self.certifier is not None:
            self.certifier.add_doubtful(results, index, first)
            self.certifier.add_between(results, index, first)
        return results

    def join_calls(self, one: dict[str, np.ndarray], other: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        """Results of two calls for the same positions in one, the earlier orientations first."""
        joined = {}
        for accumulator in self.accumulators:
            for name in accumulator.names:
                joined[name] = JOIN_CALLS[accumulator.reduce](one[name], other[name])
        return joined

    def tune_calls(self, seconds: float) -> float:
        """Measure the loop, and set `tiles` and `blocks` so that a call takes about so long.

        Args:
            seconds: Wanted for one call.

        Returns:
            The rate: goals per second on all threads.
        """
        times = []
        for _ in range(2):
            started = time.perf_counter()
            index = np.zeros((self.devices * CALL, self.axes), np.int32)
            jax.block_until_ready(self.compiled(*self.tables, index, *map(np.int32, (0, 1, 1))))
            times.append(time.perf_counter() - started)
        one = min(times)  # of one block with one tile
        self.tiles = int(np.clip(seconds / one, 1, self.tiles))
        self.blocks = int(np.clip(seconds / one / self.tiles, 1, BLOCKS))
        return THREADS * self.devices * POSITIONS * min(self.width, self.orientations) / one


def kernel_of(study: manifest.Study, plan: Plan) -> Kernel:
    """The compiled loop of a sweep. The program is cached for the next sweep of the same study.

    Another box grid needs no other program, unless one of its edges passes a power of two. Nor do another
    tool, another mount or other limits, unless a tool has an offset for the first time, or a joint gets or
    loses its limits, or a range comes to within 0.1 rad of nothing or of a turn. Programs know all numbers
    where doubtful goals are certified or `maps.Near` is asked for, and the tool of arms of fewer than six
    joints or whose goals are points.

    Positions are divided among this process's devices, each of which runs the same program.

    Args:
        study: Arm, sets, trials and type.
        plan: Its statistics and the channels that they need.
    """
    positions, orientations = study.positions, study.orientations
    dtype = np.dtype(study.dtype)
    arm = as_solved(study.arm.astype(dtype).baked())
    trials = trials_of(arm, study.free_rolls, study.redundancy_samples)
    # The program that certifies takes the tables and the arm as they are.
    as_data = isinstance(positions, Grid) and not plan.certify
    parts = Parts(arm, None, has_tool=False)
    if not plan.certify and not any(channel.needs_whole_arm for channel in plan.channels.values()):
        parts = parts_of(arm, study.redundancy_samples)
    tables = positions.tables(dtype), orientations.tables(dtype)
    if as_data:
        tables = tuple(map(_padded, tables[0])), tables[1]
    passes = passes_for(plan.channels, trials.number, is_small(arm), plan.certify, len(arm.locked) == 1)
    accumulators = [accumulator for this_pass in passes for accumulator in this_pass.accumulators]
    devices = jax.local_devices()
    mesh = Mesh(np.array(devices), ("goals",))
    width = min(ORIENTATIONS, -(-orientations.count // GOALS_PER_WORD) * GOALS_PER_WORD)
    tiles = min(TILES, -(-orientations.count // width))
    key = manifest.fingerprint(
        {
            # A certified sweep solves the arm as it was given too, not only as it is rounded to `dtype`.
            "arm": {
                **manifest.arm_spec(study.arm.astype("float64") if plan.certify else parts.bare),
                "name": "",
            },
            "mounted": [parts.mounted is not None, parts.has_tool, parts.has_offset],
            # Where a grid lies, its spacing and its edges are data.
            "sets": [
                "Grid" if as_data else manifest.set_spec(positions),
                manifest.set_spec(orientations),
            ],
            "shapes": [x.shape for part in tables for x in part],
            "trials": [study.free_rolls, study.redundancy_samples],
            "devices": len(devices),
            "dtype": dtype.name,
            "statistics": plan.specs(),
            "channels": list(plan.channels),
        }
    )
    if key not in _compiled:
        while len(_compiled) >= _CACHE_SIZE:
            _compiled.pop(next(iter(_compiled)))
        spec = LoopSpec(parts, positions, orientations, trials, dtype, passes, tiles, width)
        certified = certified_channels(passes)
        certifying = None
        if certified:
            certifying = certifying_program(study, certified), Between.of(study, certified)
        _compiled[key] = _compile_loop(spec, tables, mesh), certifying
    compiled, certifying = _compiled[key]
    placed = jax.device_put((tables, parts.mounted), NamedSharding(mesh, PartitionSpec()))
    kernel = Kernel(
        compiled, placed, accumulators, orientations.count, width, len(positions.shape), tiles, len(devices)
    )
    if certifying is not None:
        kernel.certifier = Certifier.of(certifying, positions, orientations, passes)
    return kernel


def _padded(column: np.ndarray) -> np.ndarray:
    """Coordinates along an axis, repeated to a power of two: a program is compiled for their number."""
    width = max(LEAST_COORDINATES, 2 ** int(np.ceil(np.log2(len(column)))))
    return np.pad(column, (0, width - len(column)), mode="edge")


LEAST_COORDINATES = 128
"""Grids of fewer positions along an axis share a program."""


def _compile_loop(spec: LoopSpec, tables: tuple[Tables, Tables], mesh: Mesh) -> Callable[..., Any]:
    """`loop` over all devices of the mesh, (devices * CALL, axes) places in, (devices * CALL, k) out."""
    each = functools.partial(loop, spec)
    shapes = jax.tree.map(lambda x: jax.ShapeDtypeStruct(x.shape, x.dtype), (tables, spec.parts.mounted))
    index = jax.ShapeDtypeStruct((mesh.size * CALL, len(spec.positions.shape)), np.int32)
    numbers = [jax.ShapeDtypeStruct((), np.int32)] * 3
    split, whole = PartitionSpec("goals"), PartitionSpec()
    inputs = (whole, whole, split, whole, whole, whole)
    # What is the same on all devices is so by construction; nothing is exchanged.
    sharded = jax.shard_map(each, mesh=mesh, in_specs=inputs, out_specs=split, check_vma=False)
    jitted = jax.jit(
        sharded,
        in_shardings=tuple(NamedSharding(mesh, part) for part in inputs),
        out_shardings=NamedSharding(mesh, split),
        compiler_options=one_thread(),
    )
    return jitted.lower(*shapes, index, *numbers).compile()
