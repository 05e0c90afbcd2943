"""How many goals are reached from each place on a grid: by solving, or by looking them up in a map.

A base that is shifted by p and turned by t about z sees its goals shifted back by p and turned
back by t; so one program, with the arm where it is, serves all of them. In a map this is inverse
reachability: each goal, seen from a base, is looked up.

Source: Vahrenkamp, Asfour and Dillmann, Robot placement based on reachability inversion, ICRA 2013.
"""

import functools
import itertools

import jax
import jax.numpy as jnp
import numpy as np

from ikjax.arm.arm import Arm
from ikjax.arm.forward import reach
from ikjax.core.pose import Pose, clean
from ikjax.core.xla import divider, pinning, wide_vectors
from ikjax.ik.inline import is_small
from ikjax.maps.kernel.sample import Goal
from ikjax.maps.reach_map import ReachMap
from ikjax.maps.sets.hopf import Hopf
from ikjax.maps.sets.positions import Grid
from ikjax.solvers.pipeline import solve_scalars
from ikjax.synthesis.ascent import Known

BLOCK = 2**14
"""Goals seen from bases that are worked on at a time."""

WIDTHS = (32, 256)
"""Goals of a block: a power of two between these, so that few programs are compiled."""

CALL = 4096
"""Placements of a call."""

LOOK = 2**20
"""Numbers of a map that are looked up at a time."""


def solved(arm: Arm, goals: np.ndarray, points: np.ndarray, turns: np.ndarray, limits: bool):
    """How many goals each base reaches, and by how much it fails or holds.

    Args:
        arm: An arm with a family.
        goals: (g, 4, 4) poses, of the type to work in.
        points: (c, 3) positions of bases [m].
        turns: (t,) about z [rad].
        limits: Whether the joint limits count.

    Returns:
        Goals reached (c, t), int; the worst goal's margin [m], limits left out, (c, t).
    """
    lowest, highest = WIDTHS
    width = int(np.clip(2 ** np.ceil(np.log2(len(goals))), lowest, highest))
    count = _counter(Known(arm), limits, width)
    numbers = np.zeros((len(points), len(turns)), np.int64)
    worst = np.full(numbers.shape, np.inf)
    stay = np.asarray(arm.base, float)[:3, 3]
    for t, turn in enumerate(turns):
        rotation, position = _seen(goals, turn)
        shift = points @ _about_z(-turn).T - stay
        parts = itertools.product(range(0, len(goals), width), range(0, len(points), CALL))
        for first, at in parts:
            # Padding repeats the first goal, so that no margin has to be masked out of the minimum: see the
            # notes at the end of `core.xla`.
            some = first + np.arange(width)
            here = np.count_nonzero(some < len(goals))
            some = np.where(some < len(goals), some, first)
            table = np.concatenate([rotation[some].reshape(-1, 9), position[some]], 1, dtype=goals.dtype).T
            bases = np.zeros((3, CALL), goals.dtype)
            these = len(shift[at : at + CALL])
            bases[:, :these] = shift[at : at + CALL].T
            found = count(table, np.int32(here), bases, np.int32(-(-these * width // BLOCK)))
            hits, margins = (np.asarray(x)[:these] for x in found)
            numbers[at : at + CALL, t] += hits
            worst[at : at + CALL, t] = np.minimum(worst[at : at + CALL, t], margins)
    return numbers, worst


@functools.lru_cache(16)
def _counter(known: Known, limits: bool, width: int):
    arm, deep = known.arm, BLOCK // width

    def count(table, here, bases, blocks):
        some = (jnp.arange(width, dtype=jnp.int32) < here)[None]
        rotation = tuple(tuple(table[3 * i + j][None] for j in range(3)) for i in range(3))

        def block(b, totals):
            at = jax.lax.dynamic_slice_in_dim(bases, b * deep, deep, 1)[:, :, None]
            shape = (deep, width)
            position = tuple(
                jnp.broadcast_to(table[9 + k][None], shape) - jnp.broadcast_to(at[k], shape) for k in range(3)
            )
            every = tuple(tuple(jnp.broadcast_to(x, shape) for x in row) for row in rotation)
            goal, proper = clean(Pose(every, position), reach(arm))
            with pinning(None if is_small(arm) else divider(position[0])):
                slots = solve_scalars(arm, goal)
            flags = Goal(arm, slots, divider(position[0]), shape, {}).flags(limits)
            hit = functools.reduce(jnp.logical_or, flags) & proper & some
            margin = functools.reduce(jnp.maximum, [slot.margin for slot in slots])
            found = jnp.sum(hit, axis=1, dtype=jnp.int32), jnp.min(jnp.broadcast_to(margin, shape), axis=1)
            return tuple(
                jax.lax.dynamic_update_slice_in_dim(total, part, b * deep, 0)
                for total, part in zip(totals, found, strict=True)
            )

        start = jnp.zeros(CALL, jnp.int32), jnp.zeros(CALL, table.dtype)
        return jax.lax.fori_loop(0, blocks, block, start)

    return jax.jit(count, compiler_options=wide_vectors())


def looked_up(
    found: ReachMap, arm: Arm, goals: np.ndarray, points: np.ndarray, turns: np.ndarray, limits: bool
) -> np.ndarray:
    """The share of goals (c, t) that a map has as reached, at its nearest position and orientation.

    A map without a mask of its orientations gives each goal the share of orientations reached at its
    position. Nothing is reached outside of a map.

    Raises:
        ValueError: A map of another arm, of free rolls, of positions that are no grid, or without counts.
    """
    grid = _checked(found, arm, limits)
    end = "_within" if limits else ""
    exact = f"mask{end}" in found.arrays
    known = (
        found.reached(within=limits) if exact else found.arrays[f"reachable{end}"] / found.orientation_count
    )
    known = np.asarray(known)
    from_map, base = np.asarray(found.arm.base, float), np.asarray(arm.base, float)
    view = from_map[:3, :3] @ base[:3, :3].T
    shares = np.zeros((len(points), len(turns)))
    at_a_time = max(1, LOOK // len(goals))
    size = np.array(grid.shape)
    for t, turn in enumerate(turns):
        rotation, position = _seen(goals, turn)
        facing = _nearest(found, view @ rotation) if exact else None
        shift = points @ _about_z(-turn).T
        for first in range(0, len(points), at_a_time):
            some = slice(first, first + at_a_time)
            seen = (position[None] - shift[some][:, None]) @ view.T + from_map[:3, 3]
            cell = np.rint((seen - np.array(grid.origin)) / grid.spacing)
            inside = ((cell >= 0) & (cell < size)).all(-1)
            i, j, k = np.moveaxis(np.where(inside[..., None], cell, 0).astype(np.int64), -1, 0)
            value = known[i, j, k, facing[None]] if facing is not None else known[i, j, k]
            shares[some, t] = np.where(inside, value, 0).mean(1)
    return shares


def amid(shares: np.ndarray) -> np.ndarray:
    """How good the neighbors of candidates (x, y, z, t) are: in the middle of many alike it is best."""
    for _ in range(3):
        for axis in range(3):
            ends = [(1, 1) if k == axis else (0, 0) for k in range(shares.ndim)]
            wide = np.moveaxis(np.pad(shares, ends, mode="edge"), axis, 0)
            shares = np.moveaxis((wide[:-2] + wide[1:-1] + wide[2:]) / 3, 0, axis)
    return shares


def _checked(found: ReachMap, arm: Arm, limits: bool) -> Grid:
    """The positions of a map that serves."""
    if not isinstance(found, ReachMap):
        raise ValueError(f"reach must be a ReachMap, as from ikjax.sweep, got {type(found).__name__}")
    if not isinstance(found.positions, Grid):
        raise ValueError(
            f"reach_map must be a map over a grid of positions, got one over {found.positions.in_words()}"
        )
    if found.free_rolls != 1:
        raise ValueError(f"reach_map must be a map of 1 roll, as goals ask for, got {found.free_rolls}")
    name = "reachable_within" if limits else "reachable"
    if not {name, name.replace("reachable", "mask")} & set(found.arrays):
        raise ValueError(f"reach must have {name} or its mask, it has {', '.join(found.arrays)}")
    same = found.arm.kinds == arm.kinds
    for leaf in ("a", "alpha", "d", "theta", "tool", *(["limits"] if limits else [])):
        one, other = (np.asarray(getattr(x, leaf), float) for x in (found.arm, arm))
        same = same and one.shape == other.shape and np.allclose(one, other, rtol=0, atol=1e-6)
    if not same:
        raise ValueError(f"reach must be a map of {arm.name}, got one of another arm, {found.arm.name}")
    return found.positions


def _nearest(found: ReachMap, rotations: np.ndarray) -> np.ndarray:
    """Indices (g,) of a map's orientations that are nearest to rotations (g, 3, 3)."""
    if isinstance(found.orientations, Hopf):
        return found.orientations.nearest(rotations)
    table = found.rotations.reshape(-1, 9).T
    flat = rotations.reshape(-1, 9)
    step = max(1, LOOK // table.shape[1])
    parts = [np.argmax(flat[at : at + step] @ table, axis=1) for at in range(0, len(flat), step)]
    return np.concatenate(parts)


def _seen(goals: np.ndarray, turn: float) -> tuple[np.ndarray, np.ndarray]:
    """Rotations and positions of goals as a base sees them that is turned about z."""
    back = _about_z(-turn)
    wide = np.asarray(goals, float)
    return back @ wide[:, :3, :3], wide[:, :3, 3] @ back.T


def _about_z(angle: float) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
