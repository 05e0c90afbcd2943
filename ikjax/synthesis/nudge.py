"""The last steps of a search for a place to stand: up the slope of margins, from many places at once.

What is climbed is smooth; what is kept is the best place on the way by the exact score, and
the first is among them. So a place never gets worse.
"""

import dataclasses
import functools
from typing import Any

import jax
import jax.numpy as jnp
import optax

from ikjax.ik.margins import limited_margins, smooth_max, smooth_min
from ikjax.ik.solve import solve
from ikjax.solvers.pipeline import reach
from ikjax.synthesis.ascent import Known
from ikjax.synthesis.parameters import TWIST, inverse, moved, product


@dataclasses.dataclass(frozen=True)
class Hill:
    """What is fixed while places are nudged; hashable."""

    known: Known
    climbs: tuple[str, ...]
    """Which numbers of a place move; see `synthesis.search_space`."""
    limits: bool
    together: int
    """Places that are worked on at a time."""

    def base(self, base: jax.Array, values: jax.Array) -> jax.Array:
        """Where the base stands, as `Room.bases` has it: turned about z first, then tilted and shifted."""
        numbers = dict(zip(self.climbs, values, strict=True))
        x, y, z, rx, ry, rz = (numbers.get(name, jnp.zeros_like(values[0])) for name in TWIST)
        still = jnp.zeros_like(values[0])
        turned = moved(base, (still, still, still, still, still, rz))
        return moved(turned, (x, y, z, rx, ry, still))

    def height(self, values: jax.Array, goals: jax.Array, blur: jax.Array):
        """The smooth score, and what is exact: how many goals are reached, the worst margin [m]."""
        arm = self.known.arm
        # The base stands still and the goals move instead: the kernel then knows more of its arm.
        base = jnp.asarray(arm.base, values.dtype)
        sol = solve(arm, product(product(base, inverse(self.base(base, values))), goals))
        sol = limited_margins(arm, sol) if self.limits else sol
        best = smooth_max(sol.margin, blur)
        # Where all goals are reached the share is flat, and the worst of them leads on.
        worst = smooth_min(best, blur) / float(reach(arm))
        score = jnp.sum(jax.nn.sigmoid(best / blur)) + worst / 2
        count = jnp.sum(sol.valid.any(-1), dtype=jnp.int32)
        return score, (count, jnp.min(jnp.max(sol.margin, axis=-1)))


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Best:
    values: jax.Array
    """(m, k)"""
    count: jax.Array
    """(m,) of goals reached."""
    worst: jax.Array
    """(m,) [m]"""


# It soon forgets how steep the share was, once that is flat.
_ADAM = optax.scale_by_adam(b1=0.8, b2=0.9)


@functools.partial(jax.jit, static_argnums=0)
def nudged(hill: Hill, values, goals, units, lower, upper, blurs, rates):
    """The best place that each start comes by, itself among them.

    Args:
        hill: What is climbed.
        values: (m, k) where to start.
        goals: (g, 4, 4).
        units: (k,) what a step of one is of each number.
        lower, upper: (k,) bounds.
        blurs, rates: (steps + 1,) of each step; the last is only looked at.
    """

    def slope(values, blur):
        if len(blurs) == 1:  # nobody moves, so no slope need be compiled
            return jnp.zeros_like(values), *hill.height(values, goals, blur)[1]
        climb = jax.value_and_grad(hill.height, has_aux=True)
        (_, exact), slope = climb(values, goals, blur)
        return jnp.where(jnp.isfinite(slope).all(), slope, 0), *exact

    def step(state, each):
        values, memory, best = state
        blur, rate = each
        slopes, count, worst = jax.lax.map(lambda v: slope(v, blur), values, batch_size=hill.together)
        better = (count > best.count) | ((count == best.count) & (worst > best.worst))
        best = jax.tree.map(
            lambda new, old: jnp.where(better.reshape(-1, *[1] * (new.ndim - 1)), new, old),
            Best(values, count, worst),
            best,
        )
        # Optimisers promote as they please, whatever the caller is strict about.
        with jax.numpy_dtype_promotion("standard"), jax.numpy_rank_promotion("allow"):
            updates, memory = jax.vmap(_ADAM.update)(slopes, memory, values)
            moved = jnp.clip(values + rate * units * updates, lower, upper)
        return (moved, memory, best), None

    nowhere = jnp.full(len(values), -jnp.inf, values.dtype)
    best = Best(values, jnp.zeros(len(values), jnp.int32), nowhere)
    start: Any = (values, jax.vmap(_ADAM.init)(values), best)
    return jax.lax.scan(step, start, (blurs, rates))[0][2]
