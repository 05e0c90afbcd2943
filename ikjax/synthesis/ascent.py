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
from ikjax.ik.margins import limited_margins
from ikjax.ik.solve import solve
from ikjax.synthesis.parameters import Parameters

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
    optimiser: optax.GradientTransformation
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
    """Of the optimiser."""
    multipliers: jax.Array
    """(starts, c)"""


@functools.partial(jax.jit, static_argnums=0)
def started(plan: Plan, z: jax.Array) -> State:
    multipliers = jax.vmap(lambda z: jnp.zeros_like(plan.over(z)))(z)
    return State(z, jax.vmap(plan.optimiser.init)(z), multipliers)


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
        # Optimisers promote as they please, whatever the caller is strict about.
        with jax.numpy_dtype_promotion("standard"), jax.numpy_rank_promotion("allow"):
            updates, memory = jax.vmap(plan.optimiser.update)(slopes, state.memory, state.z)
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
