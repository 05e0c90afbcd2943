"""The loops of a design study: one program for all steps and starts.

Starts are laps of a loop within a loop over steps. A start whose slope is not finite stands
still for that step and disturbs no other.

Source: the augmented Lagrangian for inequalities is that of Nocedal and Wright, Numerical Optimization, 17.4.
"""

import dataclasses
import functools
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import optax

from ikjax.arm.arm import Arm
from ikjax.arm.forward import reach
from ikjax.ik.margins import limited_margins, smooth_max, smooth_min
from ikjax.ik.solve import solve
from ikjax.synthesis.parameters import TWIST, Parameters, inverse, moved, product

Objective = Callable[[Arm, Any, Any], jax.Array]
Constraint = Callable[[Arm], jax.Array]


class Known:
    """An arm as a constant of a program: equal where all its numbers are."""

    def __init__(self, arm: Arm):
        self.arm = arm.baked()
        leaves, form = jax.tree.flatten(self.arm)
        self._key = (form, tuple((x.shape, x.dtype.name, x.tobytes()) for x in leaves))

    def __hash__(self) -> int:
        return hash(self._key)

    def __eq__(self, other) -> bool:
        return isinstance(other, Known) and self._key == other._key


@dataclasses.dataclass(frozen=True)
class Plan:
    """What is fixed while a study runs; hashable."""

    known: Known
    parameters: Parameters
    objective: Objective
    constraints: tuple[Constraint, ...]
    optimizer: optax.GradientTransformation
    limits: bool
    batch: int | None
    together: int
    """Starts that are worked on at a time."""

    def made(self, z: jax.Array) -> Arm:
        return self.parameters.put(self.known.arm, self.parameters.values(z))

    def score(self, z: jax.Array, goals: jax.Array, blur) -> jax.Array:
        arm = self.made(z)
        sol = solve(*self.parameters.apart(self.known.arm, goals, self.parameters.values(z)))
        sol = limited_margins(arm, sol) if self.limits else sol
        return jnp.mean(self.objective(arm, sol, blur))

    def over(self, z: jax.Array) -> jax.Array:
        """How far each constraint is above zero, (c,)."""
        arm = self.made(z)
        own = [jnp.ravel(jnp.asarray(g(arm), z.dtype)) for g in self.constraints]
        return jnp.concatenate([*own, self.parameters.over(self.parameters.values(z))])


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class State:
    z: jax.Array
    """(starts, k)"""
    memory: Any
    """Of the optimizer."""
    multipliers: jax.Array
    """(starts, c)"""


@functools.partial(jax.jit, static_argnums=0)
def started(plan: Plan, z: jax.Array) -> State:
    multipliers = jax.vmap(lambda z: jnp.zeros_like(plan.over(z)))(z)
    return State(z, jax.vmap(plan.optimizer.init)(z), multipliers)


@functools.partial(jax.jit, static_argnums=0)
def chunk(plan: Plan, state: State, goals, keys, blurs, pull):
    """A few steps of every start: the state, and scores (steps, starts)."""

    def loss(z, multipliers, goals, blur):
        score, over = plan.score(z, goals, blur), plan.over(z)
        push = jnp.maximum(multipliers + pull * over, 0)
        cost = ((push**2 - multipliers**2) / (2 * pull)).sum()
        return cost - score, score

    def step(state: State, each):
        key, blur = each
        some = goals
        if plan.batch is not None:
            some = goals[jax.random.choice(key, len(goals), (plan.batch,), replace=False)]

        def slope(one):
            z, multipliers = one
            (value, score), slope = jax.value_and_grad(loss, has_aux=True)(z, multipliers, some, blur)
            sound = jnp.isfinite(value) & jnp.isfinite(slope).all()
            return jnp.where(sound, slope, 0), score

        slopes, scores = jax.lax.map(slope, (state.z, state.multipliers), batch_size=plan.together)
        # Optimizers promote as they please, whatever the caller is strict about.
        with jax.numpy_dtype_promotion("standard"), jax.numpy_rank_promotion("allow"):
            updates, memory = jax.vmap(plan.optimizer.update)(slopes, state.memory, state.z)
            moved = optax.apply_updates(state.z, updates)
        moved = jnp.where(jnp.isfinite(moved), moved, state.z)
        return State(moved, memory, state.multipliers), scores

    state, scores = jax.lax.scan(step, state, (keys, blurs))
    over = jax.vmap(plan.over)(state.z)
    multipliers = jnp.maximum(state.multipliers + pull * over, 0)
    return dataclasses.replace(state, multipliers=multipliers), scores


@functools.partial(jax.jit, static_argnums=0)
def judged(plan: Plan, z: jax.Array, goals: jax.Array):
    """Numbers (m, k), exact scores (m,) and greatest violations (m,), inf for NaN, of every z."""

    def judge(z):
        over = plan.over(z)
        return plan.score(z, goals, 0), jnp.max(jnp.where(jnp.isnan(over), jnp.inf, over), initial=-jnp.inf)

    exact, over = jax.lax.map(judge, z, batch_size=plan.together)
    return jax.vmap(plan.parameters.values)(z), exact, over


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
        # Optimizers promote as they please, whatever the caller is strict about.
        with jax.numpy_dtype_promotion("standard"), jax.numpy_rank_promotion("allow"):
            updates, memory = jax.vmap(_ADAM.update)(slopes, memory, values)
            moved = jnp.clip(values + rate * units * updates, lower, upper)
        return (moved, memory, best), None

    nowhere = jnp.full(len(values), -jnp.inf, values.dtype)
    best = Best(values, jnp.zeros(len(values), jnp.int32), nowhere)
    start: Any = (values, jax.vmap(_ADAM.init)(values), best)
    return jax.lax.scan(step, start, (blurs, rates))[0][2]
