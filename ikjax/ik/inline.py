"""`solve` as a plain elementwise graph, for use inside a jit.

What the caller does not use is never computed.

XLA on a CPU computes a sum or a product again for every array that needs it. For a yes or a no that
is the fastest way there is: one fused loop. For joints it is many times slower, and near a
singularity, where an angle is made of rounding errors, two roundings of one angle do not belong
together. So the kernel is written down twice: free for the masks, and with its shared values held
for everything else. Whichever is not used is dropped. A square root near zero makes half the digits
noise, and noise of two roundings would not fit together: such roots are computed once for both, from
a third writing down of which nothing else is kept. A kernel that is too large for one loop is written
down once, held.
"""

import functools
import math
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp

from ikjax.arm.arm import Arm
from ikjax.arm.forward import reach
from ikjax.core.known import is_traced
from ikjax.core.pose import Pose, clean
from ikjax.core.xla import AgreedRoots, divider, hidden, pinning, through_one_number
from ikjax.ik.results import Solutions
from ikjax.solvers.families import FAMILIES
from ikjax.solvers.pipeline import Slot, solve_scalars

FIELDS = ("valid", "margin", "continuum", "position_error", "rotation_error")


Entries = tuple[tuple[jax.Array, ...], ...]
"""The sixteen numbers of a goal, four rows of four, each an array (...)."""


def entries_of(goals: jax.Array) -> Entries:
    """Of goals (..., 4, 4)."""
    return tuple(tuple(goals[..., i, j] for j in range(4)) for i in range(4))


def slots_of(arm: Arm, entries: Entries, q_now, tolerance) -> tuple[Slot, ...]:
    """Measured slots of goals, each field one array (...)."""
    rotation, position = tuple(row[:3] for row in entries[:3]), tuple(row[3] for row in entries[:3])
    goal, proper = clean(Pose(rotation, position), reach(arm))
    for entry, wanted in zip(entries[3], (0, 0, 0, 1), strict=True):
        proper &= entry == wanted
    now = None if q_now is None else tuple(q_now[..., i] for i in range(arm.n))
    slots = solve_scalars(arm, goal, now, tolerance)
    # What stands for a goal that is no pose is as far off as can be, and nothing moves it.
    size = jax.lax.stop_gradient(jnp.asarray(reach(arm), entries[0][3].dtype))

    def known(slot: Slot) -> Slot:
        return slot._replace(
            valid=slot.valid & proper,
            margin=jnp.where(proper, slot.margin, -size),
            continuum=slot.continuum & proper,
            position_error=jnp.where(proper, slot.position_error, size),
            rotation_error=jnp.where(proper, slot.rotation_error, math.pi),
            is_pose=proper,
        )

    return tuple(map(known, slots))


def is_small(arm: Arm) -> bool:
    """Whether the arm's kernel can be one fused loop: not where its zeros and ones are not known."""
    return FAMILIES[str(arm.family)].small and arm.correction is None and not is_traced(arm)


def jit_with_arm(f: Callable[..., Any]) -> Callable[..., Any]:
    """`jax.jit` of f(arm, *arrays) to which an arm stays known that is.

    Called eagerly, one program serves all arms of the same zeros, ones and twists. Within an outer jit, or
    under `grad` and `vmap`, all leaves that are not traced are constants.
    """

    @functools.partial(jax.jit, static_argnums=0, inline=True)
    def of_known(known, rest, *arrays):
        # A program of its own, which other callers use again: nothing of the caller's policy enters it.
        with pinning(None):
            return f(Arm.join(known, rest), *arrays)

    @functools.wraps(f)
    def call(arm: Arm, *arrays):
        return of_known(*arm.split(whole=is_traced((arm, arrays))), *arrays)

    return call


def solve_here(arm: Arm, goals: jax.Array, q_now, tolerance) -> Solutions:
    """`Solutions` as a plain elementwise graph."""
    entries, policy = entries_of(goals), divider(goals[..., 0, 3])
    if not is_small(arm):
        with pinning(policy):
            return gathered(slots_of(arm, entries, q_now, tolerance), goals.shape[:-2])
    roots = AgreedRoots(policy)
    apart = hidden(entries, goals[..., 0, 3])
    with pinning(None), roots.recorded():
        slots_of(arm, apart, q_now, tolerance)
    with pinning(None), roots.replayed():
        free = slots_of(arm, entries, q_now, tolerance)
    with pinning(policy), roots.replayed():
        pinned = slots_of(arm, entries, q_now, tolerance)
    masks = {name: _mask([getattr(slot, name) for slot in free], goals) for name in ("valid", "continuum")}
    return gathered(pinned, goals.shape[:-2], **masks)


def gathered(slots: tuple[Slot, ...], shape: tuple[int, ...], **instead: jax.Array) -> Solutions:
    """The slots as `Solutions` with batch axes `shape`; fields given in `instead` are not gathered."""

    def gather(values):
        return jnp.stack([jnp.broadcast_to(v, shape) for v in values], axis=-1)

    q = jnp.stack([gather(slot.q) for slot in slots], axis=-2)
    rest = {name: gather([getattr(slot, name) for slot in slots]) for name in FIELDS if name not in instead}
    return Solutions(q=q, is_pose=jnp.broadcast_to(slots[0].is_pose, shape), **rest, **instead)


def _mask(flags: list[jax.Array], goals: jax.Array) -> jax.Array:
    """Flags (...) as one array (..., S), through one number a goal."""
    code = through_one_number(flags, goals, goals.shape[:-2], divider(goals[..., 0, 3]))
    places = jnp.arange(len(flags), dtype=jnp.int32).reshape((1,) * (goals.ndim - 2) + (-1,))
    return (code[..., None] >> places & 1) == 1
