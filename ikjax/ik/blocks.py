"""`solve` for an eager call: in blocks that fit the cache, every field of every slot.

Storey: ik. XLA on a CPU computes in scalars, not in vectors, whatever is written with a stride. So
- an inner loop leaves one array a component, and only then are those packed into (N, S, n);
- the arm's zeros and ones are known while tracing (`Arm.split`), its other numbers are not.
"""

import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np

from ikjax.arm.arm import Arm
from ikjax.ik.graph import FIELDS, slots_of
from ikjax.ik.solutions import Solutions

BLOCK, BLOCKS = 2048, 2
"""Goals in a block, and blocks that are packed at once."""

CHUNK = BLOCK * BLOCKS


def wide_vectors() -> dict[str, str]:
    """Compiler options for kernels of ours: XLA's own choice is 256 bits, half of what AVX-512 has."""
    return {"xla_cpu_prefer_vector_width": "512"} if jax.default_backend() == "cpu" else {}


def solve_blocks(arm: Arm, goals: jax.Array, q_now, tolerance: float | None) -> Solutions:
    """`Solutions` of (N, 4, 4) goals; the bits of a row do not depend on N or on its place."""
    count = goals.shape[0]
    if count < CHUNK:
        pad = CHUNK - count
        unit = jnp.broadcast_to(jnp.eye(4, dtype=goals.dtype), (pad, 4, 4))
        goals = jnp.concatenate([goals, unit])
        if q_now is not None:
            q_now = jnp.concatenate([q_now, jnp.zeros((pad, arm.n), q_now.dtype)])
    # Neither the name nor the limits enter the solutions, so they need not part compiles.
    plain = dataclasses.replace(arm, name="", limits=np.zeros((arm.n, 2), arm.dtype))
    known, rest = plain.split()
    solved = _compiled()(known, tolerance, rest, goals, q_now)
    return solved if count >= CHUNK else jax.tree.map(lambda x: x[:count], solved)


@functools.cache
def _compiled():
    return jax.jit(_in_chunks, static_argnums=(0, 1), compiler_options=wide_vectors())


def _in_chunks(known, tolerance, rest, goals, q_now) -> Solutions:
    arm = Arm.join(known, rest)
    count = goals.shape[0]

    def components(block):
        goals, q_now = block
        slots = slots_of(arm, goals, q_now, tolerance)
        full = [(slot.q, tuple(getattr(slot, field) for field in FIELDS)) for slot in slots]
        return jax.tree.map(lambda x: jnp.broadcast_to(x, goals.shape[:1]), full)

    def packed(start) -> Solutions:
        cut = jax.tree.map(
            lambda x: jax.lax.dynamic_slice_in_dim(x, start, CHUNK).reshape(BLOCKS, BLOCK, *x.shape[1:]),
            (goals, q_now),
        )
        slots = jax.lax.map(components, cut)
        slots = jax.tree.map(lambda x: x.reshape(CHUNK), slots)
        q = jnp.stack([x for q, _ in slots for x in q]).T
        columns = zip(*(fields for _, fields in slots), strict=True)
        rest = {name: jnp.stack(column).T for name, column in zip(FIELDS, columns, strict=True)}
        return Solutions(q=q.reshape(CHUNK, len(slots), -1), **rest)

    def body(i, out):
        # The last chunk overlaps the one before: its goals get the same bits twice.
        start = jnp.minimum(i * CHUNK, count - CHUNK)
        return jax.tree.map(
            lambda whole, piece: jax.lax.dynamic_update_slice_in_dim(whole, piece, start, 0),
            out,
            packed(start),
        )

    shapes = jax.eval_shape(lambda: packed(0))
    empty = jax.tree.map(lambda s: jnp.zeros((count, *s.shape[1:]), s.dtype), shapes)
    return jax.lax.fori_loop(0, -(-count // CHUNK), body, empty)
