"""Eager calls: goals in blocks of one size that fit the cache.

More goals than `FEW` are solved by one program, whatever their number. So the bits of an answer depend on its
goal alone, and a new number of goals compiles no new kernel. A block is too small for XLA to divide among
threads; so several pieces, of a few blocks each, run at once, on as many threads as the process has cores.

A control loop has one goal, or a few. Up to `FEW` are one small block, and one is a program of its own. XLA
rounds differently in programs of other shapes: the masks of the three agree, the numbers to rounding.

The arm's zeros and ones are known while tracing (`Arm.split`); its other numbers are arguments.
"""

import dataclasses
import functools
import math
from collections import deque
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ikjax.arm.arm import Arm, once_for_each_arm
from ikjax.core import cores
from ikjax.core.xla import (
    constant,
    divider,
    divider_once,
    pinning,
    quick_to_compile,
    to_columns,
    to_rows,
    unstacked,
    wide_vectors,
)
from ikjax.ik.inline import FIELDS, Entries, from_rows, parts, rows_of, slots_of
from ikjax.ik.results import Solutions

BLOCK, BLOCKS = 4096, 4
"""Goals in a block, and blocks in a piece."""

PIECE = BLOCK * BLOCKS

FEW = 64
"""The most goals of a call that is one small block."""

THREADS = cores.usable()
"""Pieces that run at once."""

AHEAD = 4
"""Pieces that may be running while the first of them is copied into the result."""


def solve_eagerly(
    arm: Arm,
    goals: jax.Array,
    q_now: jax.Array | None,
    pose_tolerance: float | None,
    redundancy: jax.Array | None,
) -> Solutions:
    """`Solutions` of goals (..., 4, 4), q_now (..., n) and redundancy (..., k).

    The bits of a row depend on that row alone.
    """
    inputs = goals, q_now, redundancy
    return map_rows(SolveBlock(pose_tolerance), without_limits(arm), inputs, goals.shape[:-2])


@once_for_each_arm
def without_limits(arm: Arm) -> Arm:
    """The arm with limits of zero: where limits do not enter, arms that differ in them share a program."""
    return dataclasses.replace(arm, limits=constant(np.zeros((arm.n, 2), arm.dtype)))


def map_rows(block: Callable[..., Any], arm: Arm, inputs, batch: tuple[int, ...]):
    """`map_blocks` of inputs (*batch, ...), which gives its result the same batch axes; fast for few rows."""
    count = math.prod(batch)

    def rows(x):
        return x.reshape(count, *x.shape[len(batch) :])

    if count > FEW or count == 0:
        result = map_blocks(block, arm, jax.tree.map(rows, inputs))
        return jax.tree.map(lambda x: x.reshape(*batch, *x.shape[1:]), result)
    known, rest = parts(arm)
    # In numpy, because each call of jax costs as much as the whole program of one goal.
    inputs = jax.tree.map(lambda x: rows(np.asarray(x)), inputs)
    if count == 1:
        return _few_program()(block, known, batch, rest, inputs)
    return _first_rows(_padded_to_few(block, known, rest, inputs), batch)


def map_few(block: Callable[..., Any], arm: Arm, inputs):
    """`map_blocks` of up to `FEW` rows, with one program for any number of them."""
    known, rest = parts(arm)
    count = jax.tree.leaves(inputs)[0].shape[0]
    result = _padded_to_few(block, known, rest, jax.tree.map(np.asarray, inputs))
    return jax.tree.map(lambda x: x[:count], result)


def _padded_to_few(block: Callable[..., Any], known, rest, inputs):
    """The rows of a block of `FEW`, of inputs that may have fewer."""
    inputs = jax.tree.map(lambda x: np.pad(x, [(0, FEW - len(x)), *[(0, 0)] * (x.ndim - 1)]), inputs)
    return _few_program()(block, known, (FEW,), rest, inputs)


@functools.cache
def _few_program() -> Callable[..., Any]:
    """The program of one block. Not made at import: the compiler's options depend on the devices, and to
    ask for these is what `jax.distributed.initialize` and a fork must come before."""
    return jax.jit(_few, static_argnums=(0, 1, 2), compiler_options=quick_to_compile())


def _few(block, known, batch: tuple[int, ...], rest, inputs):
    """One block of as many rows as the batch has, with its axes."""
    return _first_rows(block(Arm.join(known, rest), inputs), batch)


@functools.partial(jax.jit, static_argnums=1)
def _first_rows(whole, batch: tuple[int, ...]):
    """As many rows as the batch has, with its axes."""
    return jax.tree.map(lambda x: x[: math.prod(batch)].reshape(*batch, *x.shape[1:]), whole)


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
    known, rest = parts(arm)
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
    in_columns, in_rows = unstacked(block)

    def rows(i):
        return in_columns(arm, _cut(inputs, i * BLOCK, BLOCK))

    shapes = jax.eval_shape(lambda: rows(0))
    empty = jax.tree.map(lambda s: jnp.zeros((PIECE, *s.shape[1:]), s.dtype), shapes)
    return in_rows(
        jax.lax.fori_loop(0, blocks, lambda i, whole: _with_piece(whole, rows(i), i * BLOCK), empty)
    )


def entries_in(goals: jax.Array) -> Entries:
    """The sixteen numbers of a block of goals (N, 4, 4), each an array (N,)."""
    columns = to_columns(goals)
    return tuple(tuple(columns[4 * i + j] for j in range(4)) for i in range(4))


@dataclasses.dataclass(frozen=True)
class SolveBlock:
    """`solve` of one block: rows of goals (N, 4, 4), q_now (N, n) or None, redundancy (N, k) or None."""

    pose_tolerance: float | None

    def __call__(self, arm: Arm, rows) -> Solutions:
        return self.in_rows(self.in_columns(arm, rows))

    def in_columns(self, arm: Arm, rows) -> "Solutions | Columns":
        """The solutions with an array of its own for each number of each slot; of a family with `stacked`,
        in rows."""
        goals, q_now, redundancy = rows
        count = goals.shape[0]
        entries = entries_in(goals)
        with pinning((divider_once if count <= FEW else divider)(entries[0][3])):
            whole = rows_of(arm, entries, q_now, self.pose_tolerance, redundancy)
            if whole is not None:
                return from_rows(whole)
            slots = slots_of(arm, entries, q_now, self.pose_tolerance, redundancy)
        fields = {name: [getattr(slot, name) for slot in slots] for name in FIELDS}
        columns = Columns([slot.q for slot in slots], fields, jnp.asarray(slots[0].is_pose))
        return jax.tree.map(lambda x: jnp.broadcast_to(x, (count,)), columns)

    def in_rows(self, columns: "Solutions | Columns") -> Solutions:
        """The solutions in rows."""
        if isinstance(columns, Solutions):
            return columns
        count = columns.is_pose.shape[0]
        q = to_rows([x for slot in columns.q for x in slot], count).reshape(count, len(columns.q), -1)
        rest = {name: to_rows(x, count) for name, x in columns.fields.items()}
        return Solutions(q=q, is_pose=columns.is_pose, **rest)


class Columns(NamedTuple):
    """Numbers of a block of goals, each an array (N,)."""

    q: list[Sequence[jax.Array]]
    """The joints of each slot."""
    fields: dict[str, list[jax.Array]]
    """Of each of `FIELDS`, that of each slot."""
    is_pose: jax.Array
