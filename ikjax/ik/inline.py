"""`solve` as a plain elementwise graph, for use inside a jit.

What the caller does not use is never computed.

XLA on a CPU computes a sum or a product again for every array that needs it (`core.xla`). For masks that is
the fastest way: one fused loop. For joints it is many times slower. And near a singularity, where an angle is
made of rounding errors, two copies of it that are rounded differently do not fit together. So the kernel is
traced twice: once without pins for the masks, and once with its shared values pinned for everything else. XLA
drops what is not used.

A square root near zero turns half its digits into noise, and the masks and the joints must see the same
noise. Such roots are computed once for both, from a third trace of which nothing else is used. A kernel that
is too large for one fused loop is traced once, pinned.
"""

import functools
import math
import operator
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp

from ikjax.arm.arm import Arm, once_for_each_arm
from ikjax.arm.forward import reach
from ikjax.core.pose import Pose, clean
from ikjax.core.xla import (
    AgreedRoots,
    divider,
    hidden,
    is_traced,
    pinning,
    quick_to_compile,
    stored,
    through_one_number,
)
from ikjax.ik.results import Solutions
from ikjax.solvers.families import KERNELS
from ikjax.solvers.pipeline import Slot, each_slot, margin_rows, solve_rows, solve_scalars

FIELDS = ("valid", "margin", "continuum", "position_error", "rotation_error")


Entries = tuple[tuple[jax.Array, ...], ...]
"""The sixteen numbers of a goal, four rows of four, each an array (...)."""


def entries_of(goals: jax.Array) -> Entries:
    """The entries of goals (..., 4, 4)."""
    return tuple(tuple(goals[..., i, j] for j in range(4)) for i in range(4))


def slots_of(
    arm: Arm,
    entries: Entries,
    q_now: jax.Array | None,
    pose_tolerance: float | None,
    redundancy: jax.Array | None = None,
) -> tuple[Slot, ...]:
    """Every slot of every goal, measured by forward kinematics; each field is one array (...).

    Args:
        arm: An arm with a family.
        entries: The goals' numbers.
        q_now: (..., n) joint values for joints that are arbitrary; zero where it is None.
        pose_tolerance: See `solve`.
        redundancy: (..., k) values of the joints in `Arm.locked`, or the arm angle; None where there is none.
    """
    goal, proper = _proper(arm, entries)
    free, finite = _finite(redundancy)
    slots = solve_scalars(arm, goal, _fallback(arm, q_now), pose_tolerance, free)
    return _masked(arm, slots, proper, finite, entries[0][3].dtype)


def rows_of(
    arm: Arm,
    entries: Entries,
    q_now: jax.Array | None,
    pose_tolerance: float | None,
    redundancy: jax.Array | None = None,
) -> Slot | None:
    """As `slots_of`, but with the slots as the first axis of one; None where the family has no such form."""
    if KERNELS[str(arm.family)].stacked is None:
        return None
    goal, proper = _proper(arm, entries)
    free, finite = _finite(redundancy)
    rows = solve_rows(arm, goal, _fallback(arm, q_now), pose_tolerance, free)
    finite = None if finite is None else finite[None]
    (rows,) = _masked(arm, (rows,), proper[None], finite, entries[0][3].dtype)
    return rows._replace(is_pose=proper)


def margins_of(arm: Arm, entries: Entries, fold: tuple, redundancy: jax.Array | None = None) -> jax.Array:
    """The margins of `rows_of` with their derivatives, from the fold that it gave, (S, ...)."""
    goal, proper = _proper(arm, entries)
    free, finite = _finite(redundancy)
    margin = margin_rows(arm, goal, fold, free)
    known = proper[None] if finite is None else (proper & finite)[None]
    return jnp.where(known, margin, jax.lax.stop_gradient(margin))


def _fallback(arm: Arm, q_now: jax.Array | None) -> tuple[jax.Array, ...] | None:
    return None if q_now is None else tuple(q_now[..., i] for i in range(arm.n))


def _proper(arm: Arm, entries: Entries) -> tuple[Pose, jax.Array]:
    """The goal as an orthonormal pose, and whether it was one."""
    rotation, position = tuple(row[:3] for row in entries[:3]), tuple(row[3] for row in entries[:3])
    goal, proper = clean(Pose(rotation, position), reach(arm))
    for entry, wanted in zip(entries[3], (0, 0, 0, 1), strict=True):
        proper &= entry == wanted
    return goal, proper


def _finite(redundancy: jax.Array | None) -> tuple[tuple[jax.Array, ...], jax.Array | None]:
    """What is given beside the goal, zero in place of what is not finite, and where all of it is."""
    if redundancy is None:
        return (), None
    given = tuple(redundancy[..., j] for j in range(redundancy.shape[-1]))
    finite = functools.reduce(operator.and_, map(jnp.isfinite, given))
    return tuple(jnp.where(finite, value, 0) for value in given), finite


def _masked(
    arm: Arm, slots: tuple[Slot, ...], proper: jax.Array, finite: jax.Array | None, dtype
) -> tuple[Slot, ...]:
    """Slots that are masked where their goal is no pose, or a redundant joint not finite."""
    # A goal that is no pose gets the largest errors, without derivatives.
    size = jax.lax.stop_gradient(jnp.asarray(reach(arm), dtype))

    def of_pose(slot: Slot) -> Slot:
        return slot._replace(
            valid=slot.valid & proper,
            margin=jnp.where(proper, slot.margin, -size),
            continuum=slot.continuum & proper,
            position_error=jnp.where(proper, slot.position_error, size),
            rotation_error=jnp.where(proper, slot.rotation_error, math.pi),
            is_pose=proper,
        )

    slots = tuple(map(of_pose, slots))
    if finite is None:
        return slots
    return tuple(
        slot._replace(
            valid=slot.valid & finite,
            margin=jnp.where(finite, slot.margin, -size),
            continuum=slot.continuum & finite,
        )
        for slot in slots
    )


def is_small(arm: Arm) -> bool:
    """Whether the arm's kernel can be one fused loop.

    It cannot where the arm's zeros and ones are traced, nor where base or tool differ from goal to goal.
    """
    small = KERNELS[str(arm.family)].small and not arm.locked
    return small and arm.correction is None and not is_traced(arm)


@once_for_each_arm
def in_type(arm: Arm, dtype) -> Arm:
    """The arm in the type of its goals, with constants for leaves where they are not traced."""
    return arm.baked().astype(dtype)


@once_for_each_arm
def parts(arm: Arm) -> tuple[tuple, list[jax.Array]]:
    """The parts of `Arm.split` of an arm of constants, the second one where the computation is."""
    known, rest = arm.split()
    return known, [jnp.asarray(leaf) for leaf in rest]


def jit_with_arm(f: Callable[..., Any], whole: bool = False, quick: bool = False) -> Callable[..., Any]:
    """`jax.jit` of f(arm, *arrays) in which those of the arm's numbers that are known stay known.

    Called eagerly, one program serves all arms of the same zeros, ones and twists; where `whole` is set, one
    arm. Where `quick` is set, it compiles quickly, for calls of few goals. Within an outer jit, or under
    `grad` and `vmap`, all leaves that are not traced are constants of the program.
    """

    def of_known(known, rest, *arrays):
        # Other callers use this program again, so the caller's pinning must not enter it.
        with pinning(None):
            return f(Arm.join(known, rest), *arrays)

    inlined = jax.jit(of_known, static_argnums=0, inline=True)

    @functools.cache
    def eager():
        return jax.jit(of_known, static_argnums=0, compiler_options=quick_to_compile()) if quick else inlined

    @functools.wraps(f)
    def call(arm: Arm, *arrays):
        traced = is_traced((arm, arrays))
        program = inlined if traced else eager()
        return program(*(arm.split(whole=True) if whole or traced else parts(arm)), *arrays)

    return call


def solve_inline(
    arm: Arm,
    goals: jax.Array,
    q_now: jax.Array | None,
    pose_tolerance: float | None,
    redundancy: jax.Array | None = None,
) -> tuple[Solutions, tuple[Slot, ...]]:
    """`Solutions` of goals (..., 4, 4) as a plain elementwise graph, without derivatives, and their slots."""
    entries = entries_of(goals)
    columns = stored(entries)
    policy = divider(columns[0][3])
    if not is_small(arm):
        with pinning(policy):
            rows = rows_of(arm, columns, q_now, pose_tolerance, redundancy)
            if rows is not None:
                return from_rows(rows), each_slot(rows)
            slots = slots_of(arm, columns, q_now, pose_tolerance, redundancy)
        return gathered(slots, goals.shape[:-2]), slots
    roots = AgreedRoots(policy)
    hidden_entries = hidden(entries, goals[..., 0, 3])
    with pinning(None), roots.recorded():
        slots_of(arm, hidden_entries, q_now, pose_tolerance, redundancy)
    with pinning(None), roots.replayed():
        unpinned = slots_of(arm, entries, q_now, pose_tolerance, redundancy)
    with pinning(policy), roots.replayed():
        pinned = slots_of(arm, columns, q_now, pose_tolerance, redundancy)
    flags = {name: [getattr(slot, name) for slot in unpinned] for name in ("valid", "continuum")}
    masks = {name: mask_of(values, goals[..., 0, 3]) for name, values in flags.items()}
    return gathered(pinned, goals.shape[:-2], **masks), pinned


def gathered(slots: tuple[Slot, ...], shape: tuple[int, ...], **instead: jax.Array) -> Solutions:
    """The slots as `Solutions` with batch axes `shape`; fields in `instead` replace those of the slots."""

    def gather(values):
        return jnp.stack([jnp.broadcast_to(v, shape) for v in values], axis=-1)

    q = jnp.stack([gather(slot.q) for slot in slots], axis=-2)
    rest = {name: gather([getattr(slot, name) for slot in slots]) for name in FIELDS if name not in instead}
    return Solutions(q=q, is_pose=jnp.broadcast_to(slots[0].is_pose, shape), **rest, **instead)


def from_rows(slot: Slot) -> Solutions:
    """Slots that are the first axis of one (S, ...), as `Solutions`."""
    q = jnp.moveaxis(jnp.stack(slot.q, axis=-1), 0, -2)
    is_pose = jnp.broadcast_to(slot.is_pose, q.shape[:-2])
    return Solutions(q=q, is_pose=is_pose, **{f: jnp.moveaxis(getattr(slot, f), 0, -1) for f in FIELDS})


def slots_as_array(slots: list[list[Any]]) -> jax.Array:
    """S lists of n numbers (...) as q (..., S, n)."""
    return jnp.stack([jnp.stack(slot, axis=-1) for slot in slots], axis=-2)


def joints_of(q: jax.Array) -> list[list[jax.Array]]:
    """The joints of q (..., S, n) as S lists of n numbers (...)."""
    return [[q[..., s, i] for i in range(q.shape[-1])] for s in range(q.shape[-2])]


def mask_of(flags: list[jax.Array], like: jax.Array) -> jax.Array:
    """S flags (...) as one array (..., S), read from the bits of one number for each goal."""
    code = through_one_number(flags, like, like.shape, divider(like))
    places = jnp.arange(len(flags), dtype=jnp.int32).reshape((1,) * like.ndim + (-1,))
    return (code[..., None] >> places & 1) == 1
