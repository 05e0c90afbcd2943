"""Eager calls: goals in blocks of one size that fit the cache.

There is one program, whatever the number of goals. So the bits of an answer depend on its goal alone, and a
new number of goals compiles no new kernel. A block is too small for XLA to divide among threads; so several
pieces, of a few blocks each, run at once, on as many threads as the process has cores.

The arm's zeros and ones are known while tracing (`Arm.split`); its other numbers are arguments.
"""

import dataclasses
import functools
from collections import deque
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ikjax.arm.arm import Arm
from ikjax.core import cores
from ikjax.core.xla import divider, pinning, to_columns, to_rows, wide_vectors
from ikjax.ik.inline import FIELDS, Entries, from_rows, rows_of, slots_of
from ikjax.ik.results import Solutions

BLOCK, BLOCKS = 4096, 4
"""Goals in a block, and blocks in a piece."""

PIECE = BLOCK * BLOCKS

THREADS = cores.usable()
"""Pieces that run at once."""

AHEAD = 4
"""Pieces that may be running while the first of them is copied into the result."""


def solve_blocks(
    arm: Arm, goals: jax.Array, q_now: jax.Array | None, pose_tolerance: float | None
) -> Solutions:
    """`Solutions` of goals (N, 4, 4) and q_now (N, n); the bits of a row depend on that row alone."""
    # The limits do not enter the solutions: with zeros, arms that differ in their limits share a program.
    arm = dataclasses.replace(arm, limits=np.zeros((arm.n, 2), arm.dtype))
    return map_blocks(SolveBlock(pose_tolerance), arm, (goals, q_now))


def map_blocks(block: Callable[..., Any], arm: Arm, inputs):
    """Apply `block` to each `BLOCK` rows of the inputs.

    Args:
        block: (arm, rows of the inputs) -> rows of the result. Hashable by its value, because it selects the
            compiled program.
        arm: The arm.
        inputs: A tree of arrays (N, ...); fewer than `PIECE` rows are padded with zeros.

    Returns:
        The rows of all blocks, a tree of arrays (N, ...).
    """
    count = jax.tree.leaves(inputs)[0].shape[0]
    known, rest = arm.split()
    rest = [jnp.asarray(leaf) for leaf in rest]
    inputs = jax.tree.map(_padded, inputs)
    leaves, form = jax.tree.flatten((rest, _cut(inputs, 0, PIECE)))
    kernel = _compiled(block, known, form, tuple((x.shape, x.dtype.name) for x in leaves))
    if count <= PIECE:
        return jax.tree.map(lambda x: x[:count], kernel(rest, inputs, np.int32(-(-count // BLOCK))))
    # The last piece overlaps the one before. The goals in both get the same bits twice.
    starts = [*range(0, count - PIECE, PIECE), count - PIECE]
    result = None
    running: deque = deque()
    # `None` stands for a round at the end in which nothing is started any more.
    for start in [*starts, *[None] * AHEAD]:
        if start is not None:
            piece = pool().submit(run_to_end, kernel, rest, _cut(inputs, start, PIECE), np.int32(BLOCKS))
            running.append((start, piece))
        if running and (start is None or len(running) > AHEAD):
            row, piece = running.popleft()
            result = _empty(piece.result(), count) if result is None else result
            result = _with_piece(result, piece.result(), row)
    return result


def _padded(rows: jax.Array) -> jax.Array:
    """At least `PIECE` rows, by rows of zeros."""
    pad = PIECE - rows.shape[0]
    return rows if pad <= 0 else jnp.concatenate([rows, jnp.zeros((pad, *rows.shape[1:]), rows.dtype)])


@functools.cache
def pool() -> ThreadPoolExecutor:
    """The threads of the process that run pieces; made when they are first used."""
    return ThreadPoolExecutor(THREADS, thread_name_prefix="ikjax")


def run_to_end(kernel, *arguments):
    """What the kernel returns, when it is computed."""
    return jax.block_until_ready(kernel(*arguments))


@functools.partial(jax.jit, static_argnums=2)
def _cut(inputs, start, size: int):
    """`size` rows of a tree of arrays."""
    return jax.tree.map(lambda x: jax.lax.dynamic_slice_in_dim(x, start, size), inputs)


def _empty(piece, count: int):
    """Zeros like a piece, with `count` rows."""
    return jax.tree.map(lambda x: jnp.zeros((count, *x.shape[1:]), x.dtype), piece)


@functools.partial(jax.jit, donate_argnums=0)
def _with_piece(whole, piece, start):
    """The whole with the piece's rows from row `start` on."""
    return jax.tree.map(lambda w, p: jax.lax.dynamic_update_slice_in_dim(w, p, start, 0), whole, piece)


@functools.lru_cache(maxsize=256)
def _compiled(block, known, form, shapes):
    """The program of one piece, compiled by the caller: threads do not see its jax settings."""
    rest, inputs = jax.tree.unflatten(form, [jax.ShapeDtypeStruct(*s) for s in shapes])
    jitted = jax.jit(_piece, static_argnums=(0, 1), compiler_options=wide_vectors())
    return jitted.lower(block, known, rest, inputs, jax.ShapeDtypeStruct((), np.int32)).compile()


def _piece(block, known, rest, inputs, blocks):
    """The first `blocks` blocks of a piece; the rest stays zero."""
    arm = Arm.join(known, rest)

    def rows(i):
        return block(arm, _cut(inputs, i * BLOCK, BLOCK))

    shapes = jax.eval_shape(lambda: rows(0))
    empty = jax.tree.map(lambda s: jnp.zeros((PIECE, *s.shape[1:]), s.dtype), shapes)
    return jax.lax.fori_loop(0, blocks, lambda i, whole: _with_piece(whole, rows(i), i * BLOCK), empty)


def entries_in(goals: jax.Array) -> Entries:
    """The sixteen numbers of a block of goals (BLOCK, 4, 4), each an array (BLOCK,)."""
    columns = to_columns(goals)
    return tuple(tuple(columns[4 * i + j] for j in range(4)) for i in range(4))


@dataclasses.dataclass(frozen=True)
class SolveBlock:
    """`solve` of one block: its rows are goals (BLOCK, 4, 4), and q_now (BLOCK, n) or None."""

    pose_tolerance: float | None

    def __call__(self, arm: Arm, rows) -> Solutions:
        goals, q_now = rows
        entries = entries_in(goals)
        with pinning(divider(entries[0][3])):
            stacked = rows_of(arm, entries, q_now, self.pose_tolerance)
            if stacked is not None:
                return from_rows(stacked)
            slots = slots_of(arm, entries, q_now, self.pose_tolerance)
        q = to_rows([x for slot in slots for x in slot.q], BLOCK).reshape(BLOCK, len(slots), arm.n)
        rest = {name: to_rows([getattr(slot, name) for slot in slots], BLOCK) for name in FIELDS}
        return Solutions(q=q, is_pose=jnp.broadcast_to(slots[0].is_pose, (BLOCK,)), **rest)
