"""The loop of a sweep: positions with every orientation, reduced inside one fused loop.

A loop with one result is fused, and a loop with four results is computed four times. So all flags of a goal
are read from one number of that goal, its bits; and channels that need joints share a pass in which every
value is pinned.

The loops are nested: pass, block of positions, tile of orientations, trial (a roll of the goal and a value of
the redundant joint).
"""

import dataclasses
import itertools
from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ikjax.arm.arm import Arm
from ikjax.core import pose as poses
from ikjax.core import vector
from ikjax.core.pose import Pose
from ikjax.core.xla import divider, pinning
from ikjax.ik.redundancy import middles
from ikjax.maps.kernel.accumulators import (
    Pass,
    add_tile,
    add_trial,
    after_trials,
    before_trials,
    drop_doubtful,
    empty_results,
    reduce_tile,
    value_per_goal,
)
from ikjax.maps.kernel.mounted import Mounted, Parts
from ikjax.maps.kernel.sample import Goal
from ikjax.maps.sets.orientations import Orientations
from ikjax.maps.sets.protocol import PositionSet, Tables
from ikjax.maps.sets.surface import Surface
from ikjax.solvers.pipeline import Measured, solve_scalars

POSITIONS, ORIENTATIONS = 64, 512
"""Goals in a tile: so many positions with so many orientations each."""

POSITIONS_WITH_JOINTS = 8
"""Positions of a tile whose joints are needed, so that their pinned values fit the processor's cache."""

BLOCKS = 64
"""At most so many blocks of positions in one call."""

CALL = POSITIONS * BLOCKS
"""At most so many positions in one call."""


class Trials(NamedTuple):
    """What is tried of each goal: it counts as reached if one of the trials is."""

    rolls: int
    """Rolls of each goal about its own z axis, at least 1."""
    redundancy: np.ndarray
    """(m, k) values of the redundant joints [rad, m]; (1, 0) where there are none."""

    @property
    def number(self) -> int:
        """Trials of each goal."""
        return self.rolls * len(self.redundancy)


def trials_of(arm: Arm, rolls: int, samples: int) -> Trials:
    """The trials of a sweep of an arm of the kernel's type.

    Args:
        arm: Baked.
        rolls: Rolls of each goal.
        samples: Values of each redundant joint.
    """
    values = middles(arm, samples, arm.dtype) if arm.locked else np.zeros((1, 0))
    return Trials(rolls, np.asarray(values))


@dataclasses.dataclass(frozen=True)
class LoopSpec:
    """What is fixed in the program of a sweep's loop."""

    parts: Parts
    """The arm, of type `dtype`: what of it is fixed, and what is data."""
    positions: PositionSet
    orientations: Orientations
    trials: Trials
    dtype: np.dtype
    """Floating type of the kernel."""
    passes: list[Pass]
    tiles: int
    """Tiles of orientations in one call, at most."""
    width: int
    """Orientations of a tile, a multiple of 32."""


def loop(
    spec: LoopSpec,
    tables: tuple[Tables, Tables],
    mounted: Mounted | None,
    index: jax.Array,
    first: jax.Array,
    blocks: jax.Array,
    tiles: jax.Array,
) -> tuple[jax.Array, ...]:
    """Results of one call.

    Args:
        spec: What is fixed in the program.
        tables: What `positions.at` and `orientations.at` look up.
        mounted: The numbers of the arm that are data; None where none are.
        index: (CALL, axes) int32, the places of the positions.
        first: int32, the first orientation.
        blocks: int32, blocks of `POSITIONS` positions that are computed, at most `BLOCKS`.
        tiles: int32, tiles of orientations that are computed, at most `spec.tiles`.

    Returns:
        (CALL, k) for each accumulator of each pass, in this order, with the columns of `reduce_tile`. Rows
        beyond the blocks computed are empty.
    """
    positions, orientations, dtype = spec.positions, spec.orientations, spec.dtype
    most, width = spec.tiles, spec.width
    count = orientations.count
    columns = tuple(index[:, k] for k in range(index.shape[1]))
    place = positions.at(tables[0], columns, jnp, dtype)
    frame = positions.frame_at(tables[0], columns) if isinstance(positions, Surface) else None
    turn = jnp.minimum(first, count - 1) + jnp.arange(most * width, dtype=jnp.int32)
    real = (turn < count).reshape(most, 1, width)
    rotations = orientations.at(tables[1], jnp.minimum(turn, count - 1), jnp, dtype)
    tool, trials = None, spec.trials
    spot: tuple[jax.Array, ...] = (*place, *sum(frame or (), ()))
    posed = Pose(rotations, vector.ORIGIN)
    if mounted is not None:
        mounted = mounted.in_scalars()
        trials = trials._replace(redundancy=mounted.redundancy)
        distance, from_world = vector.norm(place), mounted.from_world
        place = vector.add(vector.rotate(from_world.rotation, place), from_world.position)
        tool = mounted.from_tool if spec.parts.has_tool else None
        if tool is not None and not spec.parts.has_offset:
            tool = tool._replace(position=vector.ORIGIN)
        if tool is not None and trials.rolls == 1:
            posed, tool = poses.compose(posed, tool), None
        if frame is None:
            posed = Pose(
                vector.matmul(from_world.rotation, posed.rotation),
                vector.rotate(from_world.rotation, posed.position),
            )
        else:
            frame = vector.matmul(from_world.rotation, frame)
        spot = (*place, distance, *sum(frame or (), ()))
    places = jnp.stack([jnp.broadcast_to(x, (CALL,)) for x in spot])
    # The rotations enter the loops below as an array: made inside, they would be made again for every goal.
    shift = posed.position if spec.parts.has_offset and trials.rolls == 1 else ()
    entries = (*sum(posed.rotation, ()), *shift)
    table = jnp.stack([jnp.broadcast_to(jnp.asarray(x, dtype), turn.shape) for x in entries])
    table = jnp.moveaxis(table.reshape(len(entries), most, width), 1, 0)

    def results_of(this_pass: Pass) -> tuple[jax.Array, ...]:
        accumulators = this_pass.accumulators
        needs_joints = any(channel.pinned for acc in accumulators for channel in acc.channels)
        depth = POSITIONS_WITH_JOINTS if needs_joints else POSITIONS

        def block(b, wholes):
            here = jax.lax.dynamic_slice_in_dim(places, b * depth, depth, 1)[:, :, None]

            def tile(t, totals):
                entries = jax.lax.dynamic_index_in_dim(table, t, keepdims=False)[:, None, :]
                rotation = rows_of([entries[k] for k in range(9)])
                offset = tuple(entries[9:]) or vector.ORIGIN
                if frame is not None:
                    surface = rows_of(list(here[-9:]))
                    rotation, offset = vector.matmul(surface, rotation), vector.rotate(surface, offset)
                position = vector.add(tuple(here[k] for k in range(3)), offset)
                goal = Pose(rotation, position)
                seen = None if mounted is None else Seen(mounted, here[3], tool, spec.parts.has_tool)
                # Where every tile is full no mask is needed, and XLA optimizes better without one.
                mask = jax.lax.dynamic_index_in_dim(real, t, keepdims=False) if count % width else None
                values = each_goal(spec.parts.bare, this_pass, goal, trials, dtype, (depth, width), seen)
                return tuple(
                    add_tile(acc, total, reduce_tile(acc, value, mask), t)
                    for acc, total, value in zip(accumulators, totals, values, strict=True)
                )

            parts = tuple(empty_results(acc, depth, most * width, dtype) for acc in accumulators)
            # A loop of one iteration costs a tenth of the whole call, so its body is written down instead.
            parts = tile(0, parts) if most == 1 else jax.lax.fori_loop(0, tiles, tile, parts)
            return tuple(
                jax.lax.dynamic_update_slice_in_dim(whole, part, b * depth, 0)
                for whole, part in zip(wholes, parts, strict=True)
            )

        wholes = tuple(empty_results(acc, CALL, most * width, dtype) for acc in accumulators)
        return jax.lax.fori_loop(0, blocks * (POSITIONS // depth), block, wholes)

    return tuple(itertools.chain.from_iterable(map(results_of, spec.passes)))


def rows_of(nine: list[jax.Array]) -> vector.Matrix:
    """A matrix of its nine entries, row by row."""
    return tuple(tuple(nine[3 * i : 3 * i + 3]) for i in range(3))


class Seen(NamedTuple):
    """What goals are of an arm of which some numbers are data."""

    mounted: Mounted
    distance: jax.Array
    """From the origin of the world [m]."""
    tool: Pose | None
    """T_tool_tip, if the goals are not yet those of the tip."""
    has_tool: bool
    """Whether the tool is data."""


def each_goal(
    arm: Arm,
    this_pass: Pass,
    goal: Pose,
    trials: Trials,
    dtype: np.dtype,
    shape: tuple[int, ...],
    seen: Seen | None = None,
) -> tuple[jax.Array, ...]:
    """The number of each goal for each accumulator of a pass, over all trials.

    Args:
        arm: Baked, of type `dtype`.
        this_pass: Which numbers.
        goal: T_world_tool in scalars, or what `seen` says: arrays that broadcast to `shape`.
        trials: Of each goal.
        dtype: Floating type of the kernel.
        shape: Of the goals: (positions, orientations), or (goals,).
        seen: Of an arm of which some numbers are data: goals are in the frame of its base.

    Returns:
        One array of that shape for each accumulator.
    """

    def values(rotation, free) -> tuple[jax.Array, ...]:
        like = jnp.broadcast_to(rotation[0][0] + goal.position[0], shape)
        policy = divider(like)
        turned = Pose(rotation, goal.position)
        of_whole = None
        if seen is not None:
            turned = turned if seen.tool is None else poses.compose(turned, seen.tool)
            of_whole = Measured(seen.mounted.reach, seen.distance)
        with pinning(policy if this_pass.pinned else None):
            slots = solve_scalars(arm, turned, free=free, of_whole=of_whole)
        solved = Goal(arm, slots, policy, shape, {}, turned, free)
        if seen is not None:
            tool = seen.mounted.tip_tool if seen.has_tool else None
            solved = solved._replace(limits=seen.mounted.limits, tool=tool, reach=seen.mounted.reach)
        if this_pass.packs_flags:
            kinds = {channel.inside for acc in this_pass.accumulators for channel in acc.channels}
            solved = solved.with_packed_flags(sorted(kinds), this_pass.doubt_name is not None)
        return tuple(value_per_goal(acc, solved, dtype) for acc in this_pass.accumulators)

    return drop_doubtful(this_pass, _over_trials(values, this_pass, goal, trials, dtype, shape))


def rolled_by(rotation: vector.Matrix, cosine: jax.Array, sine: jax.Array) -> vector.Matrix:
    """A rotation after a turn about its own z axis."""
    x, y, z = vector.transpose(rotation)
    turned = (
        vector.add(vector.scale(cosine, x), vector.scale(sine, y)),
        vector.subtract(vector.scale(cosine, y), vector.scale(sine, x)),
        z,
    )
    return vector.transpose(turned)


def _over_trials(
    values: Callable[[vector.Matrix, tuple[jax.Array, ...]], tuple[jax.Array, ...]],
    this_pass: Pass,
    goal: Pose,
    trials: Trials,
    dtype: np.dtype,
    shape: tuple[int, ...],
) -> tuple[jax.Array, ...]:
    """The numbers `values` of the goal's rotation and the redundant joints, combined over all trials."""
    rolls, (samples, redundant) = trials.rolls, trials.redundancy.shape
    if rolls == 1 and not redundant:
        return values(goal.rotation, ())
    steps = np.arange(rolls) * (2 * np.pi / rolls)
    turns = jnp.asarray(np.stack([np.cos(steps), np.sin(steps)], -1).astype(dtype))
    redundancy = jnp.asarray(trials.redundancy.astype(dtype))

    def rolled(k) -> vector.Matrix:
        if rolls == 1:
            return goal.rotation
        return rolled_by(goal.rotation, turns[k, 0], turns[k, 1])

    def trial(k, totals):
        at = k % samples
        numbers = values(rolled(k // samples), tuple(redundancy[at, j] for j in range(redundant)))
        return tuple(
            add_trial(acc, total, number, at == 0)
            for acc, total, number in zip(this_pass.accumulators, totals, numbers, strict=True)
        )

    start = tuple(before_trials(acc, shape, dtype) for acc in this_pass.accumulators)
    totals = jax.lax.fori_loop(0, trials.number, trial, start)
    return tuple(after_trials(acc, total) for acc, total in zip(this_pass.accumulators, totals, strict=True))
