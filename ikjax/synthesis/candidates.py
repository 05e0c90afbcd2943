"""How many goals are reached from each candidate on a grid: by solving, or by looking them up in a map.

To shift a base by p and turn it by t about z is to shift the goals back by p and turn them back by t. So one
program, with the arm where it is, serves all candidates. With a map this is inverse reachability: each goal,
as seen from a base, is looked up.

Source: Vahrenkamp, Asfour and Dillmann, Robot placement based on reachability inversion, ICRA 2013.
"""

import functools
import itertools

import jax
import jax.numpy as jnp
import numpy as np

from ikjax.arm.arm import Arm
from ikjax.arm.forward import reach
from ikjax.core import vector
from ikjax.core.pose import Pose, clean
from ikjax.core.xla import divider, pinning, wide_vectors
from ikjax.ik.inline import is_small
from ikjax.ik.redundancy import middles
from ikjax.maps.kernel.sample import Goal
from ikjax.maps.reach_map import ReachMap
from ikjax.maps.sets.hopf import Hopf
from ikjax.maps.sets.positions import Grid
from ikjax.solvers.pipeline import solve_scalars
from ikjax.synthesis.ascent import ConstantArm

BLOCK = 2**14
"""Pairs of a goal and a base that are solved at a time."""

WIDTHS = (32, 256)
"""Goals of a block: a power of two between these, so that few programs are compiled."""

CALL = 4096
"""Bases of one call of the program."""

LOOK_UP = 2**20
"""Numbers of a map that are looked up at a time."""


def count_reached(
    arm: Arm,
    goals: np.ndarray,
    points: np.ndarray,
    turns: np.ndarray,
    limits: bool,
    samples: int,
    alternatives: np.ndarray | None = None,
):
    """How many goals each base reaches, and the worst margin.

    Args:
        arm: An arm with a family.
        goals: (g, 4, 4) poses, of the type to work in.
        points: (c, 3) positions of bases [m].
        turns: (t,) about z [rad].
        limits: Whether the joint limits count.
        samples: Values of each redundant joint.
        alternatives: (m, 4, 4) what the tool may be turned by, of which one must do.

    Returns:
        Goals reached (c, t), int; the worst goal's margin [m], limits ignored, (c, t).
    """
    lowest, highest = WIDTHS
    width = int(np.clip(2 ** np.ceil(np.log2(len(goals))), lowest, highest))
    count = _counting_program(ConstantArm(arm), limits, width, samples)
    numbers = np.zeros((len(points), len(turns)), np.int64)
    worst = np.full(numbers.shape, np.inf)
    home = np.asarray(arm.base, float)[:3, 3]
    rotations = None
    if alternatives is not None:
        rotations = alternatives[:, :3, :3].reshape(-1, 9).astype(goals.dtype)
    for t, turn in enumerate(turns):
        rotation, position = _goals_seen_from(goals, turn)
        shift = points @ _about_z(-turn).T - home
        parts = itertools.product(range(0, len(goals), width), range(0, len(points), CALL))
        for first, at in parts:
            # The last block is padded with its first goal, so that no margin has to be masked out of the
            # minimum: see the notes at the end of `core.xla`.
            rows = first + np.arange(width)
            goal_count = np.count_nonzero(rows < len(goals))
            rows = np.where(rows < len(goals), rows, first)
            table = np.concatenate([rotation[rows].reshape(-1, 9), position[rows]], 1, dtype=goals.dtype).T
            bases = np.zeros((3, CALL), goals.dtype)
            base_count = len(shift[at : at + CALL])
            bases[:, :base_count] = shift[at : at + CALL].T
            blocks = np.int32(-(-base_count * width // BLOCK))
            counted = count(table, np.int32(goal_count), bases, blocks, rotations)
            hits, margins = (np.asarray(x)[:base_count] for x in counted)
            numbers[at : at + CALL, t] += hits
            worst[at : at + CALL, t] = np.minimum(worst[at : at + CALL, t], margins)
    return numbers, worst


@functools.lru_cache(16)
def _counting_program(constant: ConstantArm, limits: bool, width: int, samples: int):
    """The compiled loop over blocks of `width` goals and as many bases as make up a block."""
    arm, depth = constant.arm, BLOCK // width
    redundancy = np.asarray(middles(arm, samples, arm.dtype)) if arm.locked else None

    def count(table, goal_count, bases, blocks, rotations):
        is_goal = (jnp.arange(width, dtype=jnp.int32) < goal_count)[None]
        rotation = tuple(tuple(table[3 * i + j][None] for j in range(3)) for i in range(3))

        def block(b, totals):
            at = jax.lax.dynamic_slice_in_dim(bases, b * depth, depth, 1)[:, :, None]
            shape = (depth, width)
            position = tuple(
                jnp.broadcast_to(table[9 + k][None], shape) - jnp.broadcast_to(at[k], shape) for k in range(3)
            )
            spread = tuple(tuple(jnp.broadcast_to(x, shape) for x in row) for row in rotation)
            goal, proper = clean(Pose(spread, position), reach(arm))

            def at_values(free, rotation):
                turned = goal
                if rotation is not None:
                    by = tuple(tuple(rotation[3 * i + j] for j in range(3)) for i in range(3))
                    turned = Pose(vector.matmul(goal.rotation, by), goal.position)
                with pinning(None if is_small(arm) else divider(position[0])):
                    slots = solve_scalars(arm, turned, free=free)
                flags = Goal(arm, slots, divider(position[0]), shape, {}).flags(limits)
                hit = functools.reduce(jnp.logical_or, flags)
                margin = functools.reduce(jnp.maximum, [slot.margin for slot in slots])
                return hit, jnp.broadcast_to(margin, shape)

            if redundancy is None and rotations is None:
                hit, margin = at_values((), None)
            else:
                hit, margin = _best_value(at_values, redundancy, rotations, shape, table.dtype)
            hit = hit & proper & is_goal
            part = jnp.sum(hit, axis=1, dtype=jnp.int32), jnp.min(margin, axis=1)
            return tuple(
                jax.lax.dynamic_update_slice_in_dim(total, new, b * depth, 0)
                for total, new in zip(totals, part, strict=True)
            )

        start = jnp.zeros(CALL, jnp.int32), jnp.zeros(CALL, table.dtype)
        return jax.lax.fori_loop(0, blocks, block, start)

    return jax.jit(count, compiler_options=wide_vectors())


def _best_value(at_values, redundancy: np.ndarray | None, rotations, shape: tuple[int, ...], dtype):
    """Whether a row of values (m, k) at a rotation (r, 9) reaches each goal, and the greatest margin."""
    table = jnp.zeros((1, 0), dtype) if redundancy is None else jnp.asarray(redundancy)
    samples = len(table)

    def value(m, best):
        at = m % samples
        rotation = None if rotations is None else rotations[m // samples]
        hit, margin = at_values(tuple(table[at, j] for j in range(table.shape[1])), rotation)
        return best[0] | hit, jnp.maximum(best[1], margin)

    start = jnp.zeros(shape, bool), jnp.full(shape, -jnp.inf, dtype)
    return jax.lax.fori_loop(0, samples * (1 if rotations is None else len(rotations)), value, start)


def look_up_shares(
    reach_map: ReachMap,
    arm: Arm,
    goals: np.ndarray,
    points: np.ndarray,
    turns: np.ndarray,
    limits: bool,
    alternatives: np.ndarray | None = None,
) -> np.ndarray:
    """The share of goals (c, t) that a map says are reached, at its nearest position and orientation.

    With a map that has no mask of its orientations, each goal counts as the share of orientations reached at
    its position. Outside of a map nothing is reached.

    Raises:
        ValueError: A map of another arm, of free rolls, of positions that are no grid, or without counts.
    """
    grid = _checked_grid(reach_map, arm, limits)
    end = "_within" if limits else ""
    exact = f"mask{end}" in reach_map.arrays
    if exact:
        table = np.asarray(reach_map.reached(within=limits))
    else:
        table = np.asarray(reach_map.arrays[f"reachable{end}"] / reach_map.orientation_count)
    from_map, base = np.asarray(reach_map.arm.base, float), np.asarray(arm.base, float)
    view = from_map[:3, :3] @ base[:3, :3].T
    shares = np.zeros((len(points), len(turns)))
    at_a_time = max(1, LOOK_UP // len(goals))
    size = np.array(grid.shape)
    for t, turn in enumerate(turns):
        rotation, position = _goals_seen_from(goals, turn)
        nearest = None
        if exact:
            turned = (
                rotation[:, None] if alternatives is None else rotation[:, None] @ alternatives[:, :3, :3]
            )
            nearest = _nearest_orientations(reach_map, (view @ turned).reshape(-1, 3, 3))
            nearest = nearest.reshape(len(goals), -1)
        shift = points @ _about_z(-turn).T
        for first in range(0, len(points), at_a_time):
            chosen = slice(first, first + at_a_time)
            seen = (position[None] - shift[chosen][:, None]) @ view.T + from_map[:3, 3]
            cell = np.rint((seen - np.array(grid.origin)) / grid.spacing)
            inside = ((cell >= 0) & (cell < size)).all(-1)
            i, j, k = np.moveaxis(np.where(inside[..., None], cell, 0).astype(np.int64), -1, 0)
            if nearest is None:
                value = table[i, j, k]
            else:
                value = functools.reduce(np.maximum, [table[i, j, k, each[None]] for each in nearest.T])
            shares[chosen, t] = np.where(inside, value, 0).mean(1)
    return shares


def smoothed(shares: np.ndarray) -> np.ndarray:
    """Shares (x, y, z, t) averaged over neighbors, so that of equal candidates the middle one is best."""
    for _ in range(3):
        for axis in range(3):
            ends = [(1, 1) if k == axis else (0, 0) for k in range(shares.ndim)]
            wide = np.moveaxis(np.pad(shares, ends, mode="edge"), axis, 0)
            shares = np.moveaxis((wide[:-2] + wide[1:-1] + wide[2:]) / 3, 0, axis)
    return shares


def _checked_grid(reach_map: ReachMap, arm: Arm, limits: bool) -> Grid:
    """The positions of a map, after a check that it can be used."""
    if not isinstance(reach_map, ReachMap):
        raise ValueError(f"reach_map must be a ReachMap, as from ikjax.sweep, got {type(reach_map).__name__}")
    if not isinstance(reach_map.positions, Grid):
        raise ValueError(
            f"reach_map must be a map over a grid of positions, got one over {reach_map.positions.in_words()}"
        )
    if reach_map.free_rolls != 1:
        raise ValueError(f"reach_map must be a map of 1 roll, as goals ask for, got {reach_map.free_rolls}")
    name = "reachable_within" if limits else "reachable"
    if not {name, name.replace("reachable", "mask")} & set(reach_map.arrays):
        raise ValueError(f"reach_map must have {name} or its mask, it has {', '.join(reach_map.arrays)}")
    same = reach_map.arm.kinds == arm.kinds
    for leaf in ("a", "alpha", "d", "theta", "tool", *(["limits"] if limits else [])):
        one, other = (np.asarray(getattr(x, leaf), float) for x in (reach_map.arm, arm))
        same = same and one.shape == other.shape and np.allclose(one, other, rtol=0, atol=1e-6)
    if not same:
        raise ValueError(
            f"reach_map must be a map of {arm.name}, got one of another arm, {reach_map.arm.name}"
        )
    return reach_map.positions


def _nearest_orientations(reach_map: ReachMap, rotations: np.ndarray) -> np.ndarray:
    """Indices (g,) of a map's orientations that are nearest to rotations (g, 3, 3)."""
    if isinstance(reach_map.orientations, Hopf):
        return reach_map.orientations.nearest(rotations)
    table = reach_map.rotations.reshape(-1, 9).T
    flat = rotations.reshape(-1, 9)
    step = max(1, LOOK_UP // table.shape[1])
    parts = [np.argmax(flat[at : at + step] @ table, axis=1) for at in range(0, len(flat), step)]
    return np.concatenate(parts)


def _goals_seen_from(goals: np.ndarray, turn: float) -> tuple[np.ndarray, np.ndarray]:
    """Rotations and positions of goals in the frame of a base that is turned about z."""
    back = _about_z(-turn)
    wide = np.asarray(goals, float)
    return back @ wide[:, :3, :3], wide[:, :3, 3] @ back.T


def _about_z(angle: float) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
