"""Eager calls: in blocks that fit the cache, every field of every slot.

There is one program, whatever the number of goals, so that the bits of an answer depend on its
goal alone and a new number of goals compiles no kernel. Blocks run on as many threads as the process has
cores, because one of them is too small for XLA to share out.

The arm's zeros and ones are known while tracing (`Arm.split`), its other numbers are not.
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
from ikjax.ik.inline import FIELDS, Entries, slots_of
from ikjax.ik.results import Solutions

BLOCK, BLOCKS = 4096, 4
"""Goals in a block, and blocks in a piece."""

PIECE = BLOCK * BLOCKS

THREADS = cores.usable()
"""Pieces that run at once."""

AHEAD = 4
"""Pieces that may be under way while the first of them is put in its place."""


def solve_blocks(arm: Arm, goals: jax.Array, q_now, tolerance: float | None) -> Solutions:
    """`Solutions` of (N, 4, 4) goals; the bits of a row do not depend on N or on its place."""
    # The limits do not enter the solutions, so they need not part compiles.
    arm = dataclasses.replace(arm, limits=np.zeros((arm.n, 2), arm.dtype))
    return in_blocks(Solving(tolerance), arm, (goals, q_now))


def in_blocks(block: Callable[..., Any], arm: Arm, inputs):
    """What `block` makes of each `BLOCK` of rows, put together.

    Args:
        block: Hashable by its value, because it chooses the program: (arm, rows of the inputs) -> rows.
        arm: The arm.
        inputs: A tree of arrays (N, ...); rows of zeros are added where they are few.
    """
    count = jax.tree.leaves(inputs)[0].shape[0]
    known, rest = arm.split()
    rest = [jnp.asarray(leaf) for leaf in rest]
    inputs = jax.tree.map(_padded, inputs)
    leaves, form = jax.tree.flatten((rest, _cut(inputs, 0, PIECE)))
    kernel = _compiled(block, known, form, tuple((x.shape, x.dtype.name) for x in leaves))
    if count <= PIECE:
        return jax.tree.map(lambda x: x[:count], kernel(rest, inputs, np.int32(-(-count // BLOCK))))
    # The last piece overlaps the one before: its goals get the same bits twice.
    starts = [*range(0, count - PIECE, PIECE), count - PIECE]
    whole = None
    waiting: deque = deque()
    for start in [*starts, *[None] * AHEAD]:
        if start is not None:
            piece = pool().submit(finished, kernel, rest, _cut(inputs, start, PIECE), np.int32(BLOCKS))
            waiting.append((start, piece))
        if waiting and (start is None or len(waiting) > AHEAD):
            place, piece = waiting.popleft()
            whole = _placed(_empty(piece.result(), count) if whole is None else whole, piece.result(), place)
    return whole


def _padded(rows: jax.Array) -> jax.Array:
    """At least one piece."""
    pad = PIECE - rows.shape[0]
    return rows if pad <= 0 else jnp.concatenate([rows, jnp.zeros((pad, *rows.shape[1:]), rows.dtype)])


@functools.cache
def pool() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(THREADS, thread_name_prefix="ikjax")


def finished(kernel, *arguments):
    return jax.block_until_ready(kernel(*arguments))


@functools.partial(jax.jit, static_argnums=2)
def _cut(inputs, start, size: int):
    return jax.tree.map(lambda x: jax.lax.dynamic_slice_in_dim(x, start, size), inputs)


def _empty(piece, count: int):
    return jax.tree.map(lambda x: jnp.zeros((count, *x.shape[1:]), x.dtype), piece)


@functools.partial(jax.jit, donate_argnums=0)
def _placed(whole, piece, start):
    return jax.tree.map(lambda w, p: jax.lax.dynamic_update_slice_in_dim(w, p, start, 0), whole, piece)


@functools.lru_cache(maxsize=256)
def _compiled(block, known, form, shapes):
    """The program of one piece. Compiled here, because threads do not see the caller's settings."""
    rest, inputs = jax.tree.unflatten(form, [jax.ShapeDtypeStruct(*s) for s in shapes])
    jitted = jax.jit(_piece, static_argnums=(0, 1), compiler_options=wide_vectors())
    return jitted.lower(block, known, rest, inputs, jax.ShapeDtypeStruct((), np.int32)).compile()


def _piece(block, known, rest, inputs, blocks):
    """The first `blocks` blocks of a piece; the rest is left zero."""
    arm = Arm.join(known, rest)

    def rows(i):
        return block(arm, _cut(inputs, i * BLOCK, BLOCK))

    shapes = jax.eval_shape(lambda: rows(0))
    empty = jax.tree.map(lambda s: jnp.zeros((PIECE, *s.shape[1:]), s.dtype), shapes)
    return jax.lax.fori_loop(0, blocks, lambda i, whole: _placed(whole, rows(i), i * BLOCK), empty)


def entries_in(goals: jax.Array) -> Entries:
    """The sixteen numbers of a block of goals (BLOCK, 4, 4), each an array (BLOCK,)."""
    columns = to_columns(goals)
    return tuple(tuple(columns[4 * i + j] for j in range(4)) for i in range(4))


@dataclasses.dataclass(frozen=True)
class Solving:
    """`solve`, block by block."""

    tolerance: float | None

    def __call__(self, arm: Arm, rows) -> Solutions:
        goals, q_now = rows
        entries = entries_in(goals)
        with pinning(divider(entries[0][3])):
            slots = slots_of(arm, entries, q_now, self.tolerance)
        q = to_rows([x for slot in slots for x in slot.q], BLOCK).reshape(BLOCK, len(slots), arm.n)
        rest = {name: to_rows([getattr(slot, name) for slot in slots], BLOCK) for name in FIELDS}
        return Solutions(q=q, is_pose=jnp.broadcast_to(slots[0].is_pose, (BLOCK,)), **rest)
