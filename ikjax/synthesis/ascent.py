"""The compiled loops of `design` and `place`: gradient ascent from many starts in one program.

The outer loop takes the steps, the inner one goes over the starts. A start whose gradient is not finite does
not move in that step, and no other start is affected.

Source: the augmented Lagrangian for inequalities is that of Nocedal and Wright, Numerical Optimization, 17.4.
"""

import dataclasses
import functools
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import optax

from ikjax.arm.arm import Arm
from ikjax.arm.forward import reach
from ikjax.ik.margins import limited_margins, smooth_max, smooth_min
from ikjax.ik.redundancy import (
    Judge,
    joined_alternatives,
    pose_product,
    solve_alternatives,
    solve_at_samples,
    turned_goals,
)
from ikjax.synthesis.allowed import Allowed
from ikjax.synthesis.parameters import TWIST, Parameters, moved_by_twist, pose_inverse

Objective = Callable[[Arm, Any, Any], jax.Array]
Constraint = Callable[[Arm], jax.Array]


class ConstantArm:
    """An arm as a constant of a program; equal to another where all numbers are equal."""

    def __init__(self, arm: Arm):
        self.arm = arm.baked()
        leaves, form = jax.tree.flatten(self.arm)
        self._key = (form, tuple((x.shape, x.dtype.name, x.tobytes()) for x in leaves))

    def __hash__(self) -> int:
        return hash(self._key)

    def __eq__(self, other) -> bool:
        return isinstance(other, ConstantArm) and self._key == other._key


def starts_at_a_time(arm: Arm, most: int) -> int | None:
    """How many starts are evaluated at a time: `most`, and one by one (None) with a redundant joint.

    Its solver is a loop over values of that joint, which compiles for minutes when starts are a batch of it.
    """
    return None if arm.locked else max(1, most)


@dataclasses.dataclass(frozen=True)
class DesignPlan:
    """What is fixed while a design study runs; hashable, so that it may be static under jit."""

    constant: ConstantArm
    parameters: Parameters
    objective: Objective
    constraints: tuple[Constraint, ...]
    optimizer: optax.GradientTransformation
    limits: bool
    goal_batch_size: int | None
    """Rows of goals drawn for each step; None for all."""
    start_batch_size: int | None
    """See `starts_at_a_time`."""
    samples: int
    """Values of each redundant joint."""
    alternatives: tuple[tuple[float, ...], ...] | None = None
    """What the tool may be turned by, of which one must do: entries of poses, row by row; None without."""

    @property
    def alternatives_array(self) -> np.ndarray | None:
        return None if self.alternatives is None else np.reshape(self.alternatives, (-1, 4, 4))

    def with_bounds(self, bounds: jax.Array) -> "DesignPlan":
        """The plan with bounds (2, k), which are data: no program is compiled for their numbers."""
        return dataclasses.replace(self, parameters=self.parameters.with_bounds(bounds))

    def arm_at(self, z: jax.Array) -> Arm:
        return self.parameters.put(self.constant.arm, self.parameters.values(z))

    def score(self, z: jax.Array, goals: jax.Array, blur) -> jax.Array:
        arm = self.arm_at(z)
        others = self.alternatives_array
        # The tool is turned before it is moved: alternatives are seen from the tool that varies.
        turned = goals if others is None else turned_goals(goals, others)
        moved = self.parameters.arm_and_goals(self.constant.arm, turned, self.parameters.values(z))
        sol = solve_at_samples(*moved, self.samples, _judge(arm, self.limits))
        sol = sol if others is None else joined_alternatives(sol)
        return jnp.mean(self.objective(arm, sol, blur))

    def violations(self, z: jax.Array) -> jax.Array:
        """How far each constraint is above zero, (c,)."""
        arm = self.arm_at(z)
        own = [jnp.ravel(jnp.asarray(g(arm), z.dtype)) for g in self.constraints]
        return jnp.concatenate([*own, self.parameters.violations(self.parameters.values(z))])


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class State:
    """Where all starts of a design study are."""

    z: jax.Array
    """(starts, k)"""
    memory: Any
    """State of the optimizer."""
    multipliers: jax.Array
    """(starts, c) Lagrange multipliers."""


@functools.partial(jax.jit, static_argnums=0)
def initial_state(plan: DesignPlan, z: jax.Array, bounds: jax.Array) -> State:
    plan = plan.with_bounds(bounds)
    multipliers = jax.vmap(lambda z: jnp.zeros_like(plan.violations(z)))(z)
    return State(z, jax.vmap(plan.optimizer.init)(z), multipliers)


@functools.partial(jax.jit, static_argnums=0)
def take_steps(plan: DesignPlan, state: State, goals, keys, blurs, penalty, bounds):
    """A few steps of every start, and then one update of the multipliers.

    Args:
        plan: What is fixed.
        state: Of all starts.
        goals: (rows, ..., 4, 4).
        keys: (steps,) random keys, for drawing rows of goals.
        blurs: (steps,) [m].
        penalty: Weight of the squared constraints.
        bounds: (2, k) lower and upper bounds of what varies.

    Returns:
        The state, and blurred scores (steps, starts).
    """
    plan = plan.with_bounds(bounds)

    def loss(z, multipliers, goals, blur):
        score, violations = plan.score(z, goals, blur), plan.violations(z)
        updated = jnp.maximum(multipliers + penalty * violations, 0)
        cost = ((updated**2 - multipliers**2) / (2 * penalty)).sum()
        return cost - score, score

    def step(state: State, inputs):
        key, blur = inputs
        batch = goals
        if plan.goal_batch_size is not None:
            batch = goals[jax.random.choice(key, len(goals), (plan.goal_batch_size,), replace=False)]

        def gradient_of(start):
            z, multipliers = start
            (value, score), gradient = jax.value_and_grad(loss, has_aux=True)(z, multipliers, batch, blur)
            finite = jnp.isfinite(value) & jnp.isfinite(gradient).all()
            return jnp.where(finite, gradient, 0), score

        starts = (state.z, state.multipliers)
        gradients, scores = jax.lax.map(gradient_of, starts, batch_size=plan.start_batch_size)
        # Optimizers promote types implicitly; a caller's strict settings must not stop them.
        with jax.numpy_dtype_promotion("standard"), jax.numpy_rank_promotion("allow"):
            updates, memory = jax.vmap(plan.optimizer.update)(gradients, state.memory, state.z)
            moved = optax.apply_updates(state.z, updates)
        moved = jnp.where(jnp.isfinite(moved), moved, state.z)
        return State(moved, memory, state.multipliers), scores

    state, scores = jax.lax.scan(step, state, (keys, blurs))
    violations = jax.vmap(plan.violations)(state.z)
    multipliers = jnp.maximum(state.multipliers + penalty * violations, 0)
    return dataclasses.replace(state, multipliers=multipliers), scores


@functools.partial(jax.jit, static_argnums=0)
def evaluate_exactly(plan: DesignPlan, z: jax.Array, goals: jax.Array, bounds: jax.Array):
    """Numbers (m, k), exact scores (m,) and greatest violations (m,), inf for NaN, of every z."""
    plan = plan.with_bounds(bounds)

    def evaluate(z):
        violations = plan.violations(z)
        greatest = jnp.max(jnp.where(jnp.isnan(violations), jnp.inf, violations), initial=-jnp.inf)
        return plan.score(z, goals, 0), greatest

    exact, greatest = jax.lax.map(evaluate, z, batch_size=plan.start_batch_size)
    return jax.vmap(plan.parameters.values)(z), exact, greatest


@dataclasses.dataclass(frozen=True)
class PlacementPlan:
    """What is fixed while placements are polished; hashable, so that it may be static under jit."""

    constant: ConstantArm
    free_coordinates: tuple[str, ...]
    """Which coordinates of a placement move; see `synthesis.search_space`."""
    limits: bool
    start_batch_size: int | None
    """Placements evaluated at a time; see `starts_at_a_time`."""
    samples: int
    """Values of each redundant joint."""

    def moved_base(self, base: jax.Array, values: jax.Array) -> jax.Array:
        """The base's pose as `SearchSpace.base_poses` has it: turned about z, then tilted and shifted."""
        given = dict(zip(self.free_coordinates, values, strict=True))
        x, y, z, rx, ry, rz = (given.get(name, jnp.zeros_like(values[0])) for name in TWIST)
        zero = jnp.zeros_like(values[0])
        turned = moved_by_twist(base, (zero, zero, zero, zero, zero, rz))
        return moved_by_twist(turned, (x, y, z, rx, ry, zero))

    def smooth_score(self, values: jax.Array, data: "PlacementData", blur: jax.Array):
        """The smooth score; and the exact number of goals reached and worst margin [m]."""
        goals, real = data.goals, data.real
        arm = self.constant.arm
        # The base is fixed and the goals move instead: more of the arm is then constant in the kernel.
        base = jnp.asarray(arm.base, values.dtype)
        back = pose_product(base, pose_inverse(self.moved_base(base, values)))
        judge = _judge(arm, self.limits)
        sol = solve_alternatives(arm, pose_product(back, goals), data.alternatives, self.samples, judge)
        best = smooth_max(sol.margin, blur)
        # Where all goals are reached the share is constant; the worst margin still has a gradient.
        worst = smooth_min(best, blur, where=real) / float(reach(arm))
        score = jnp.sum(jnp.where(real, jax.nn.sigmoid(best / blur), 0)) + worst / 2
        count = jnp.sum(sol.valid.any(-1) & real, dtype=jnp.int32)
        return score, (count, jnp.min(jnp.where(real, jnp.max(sol.margin, axis=-1), jnp.inf)))

    def exact_margins(self, data: "PlacementData") -> tuple[jax.Array, jax.Array]:
        """Whether each goal is reached, (g,), and the margin of its best branch [m], (g,)."""

        def of_one(goal):
            judge = _judge(self.constant.arm, self.limits)
            sol = solve_alternatives(self.constant.arm, goal, data.alternatives, self.samples, judge)
            return sol.valid.any(-1), sol.margin.max(-1)

        return jax.lax.map(of_one, data.goals, batch_size=self.start_batch_size)

    def is_allowed(self, values: jax.Array, data: "PlacementData") -> jax.Array:
        """Whether the base may stand where the coordinates put it."""
        given = dict(zip(self.free_coordinates, values, strict=True))
        shift = [given.get(name, jnp.zeros_like(values[0])) for name in TWIST[:3]]
        home = jnp.asarray(self.constant.arm.base, values.dtype)
        return data.allowed.at_one(jnp.stack([home[k, 3] + shift[k] for k in range(3)]))


def _judge(arm: Arm, limits: bool) -> Judge | None:
    """What solutions are taken for, where limits count and where they do not."""
    return functools.partial(limited_margins, arm) if limits else None


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class PlacementData:
    """The numbers of a placement, which no program depends on but for their shapes."""

    goals: jax.Array
    """(g, 4, 4), some of them padding."""
    real: jax.Array
    """(g,) bool: no padding."""
    alternatives: jax.Array | None
    """(m, 4, 4) of which one must do, or None; see `solve_alternatives`."""
    allowed: Allowed


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class BestPlacements:
    """The best placement so far of each start."""

    values: jax.Array
    """(m, k)"""
    count: jax.Array
    """(m,) of goals reached."""
    worst: jax.Array
    """(m,) worst margin [m]"""


@functools.partial(jax.jit, static_argnums=0)
def evaluate_placement(plan: PlacementPlan, data: PlacementData) -> tuple[jax.Array, jax.Array]:
    """`PlacementPlan.exact_margins` of goals as the arm sees them where it was given.

    Args:
        plan: What is fixed; its `start_batch_size` counts goals here.
        data: The goals; where the base may stand does not matter.
    """
    return plan.exact_margins(data)


# Short averages: the large gradients of the share must not slow the ascent once the share is constant.
_ADAM = optax.scale_by_adam(b1=0.8, b2=0.9)


@functools.partial(jax.jit, static_argnums=0)
def polish_placements(
    plan: PlacementPlan, values, data: PlacementData, units, lower, upper, blurs, rates
) -> BestPlacements:
    """The best placement that each start passes, the start itself included.

    Args:
        plan: What is fixed.
        values: (m, k) where to start.
        data: Goals and where the base may stand.
        units: (k,) a step of one, in each coordinate.
        lower, upper: (k,) bounds.
        blurs, rates: (steps + 1,) of each step; the last placement is only evaluated.
    """

    def evaluate(values, blur):
        if len(blurs) == 1:  # no step is taken, so that no gradient need be compiled
            return jnp.zeros_like(values), *plan.smooth_score(values, data, blur)[1]
        value_and_gradient = jax.value_and_grad(plan.smooth_score, has_aux=True)
        (_, exact), gradient = value_and_gradient(values, data, blur)
        return jnp.where(jnp.isfinite(gradient).all(), gradient, 0), *exact

    def step(state, inputs):
        values, memory, best = state
        blur, rate = inputs
        gradients, count, worst = jax.lax.map(
            lambda v: evaluate(v, blur), values, batch_size=plan.start_batch_size
        )
        # Where the base may not stand it may pass, but it does not stay.
        better = jax.vmap(lambda v: plan.is_allowed(v, data))(values) & (
            (count > best.count) | ((count == best.count) & (worst > best.worst))
        )
        best = jax.tree.map(
            lambda new, old: jnp.where(better.reshape(-1, *[1] * (new.ndim - 1)), new, old),
            BestPlacements(values, count, worst),
            best,
        )
        # Optimizers promote types implicitly; a caller's strict settings must not stop them.
        with jax.numpy_dtype_promotion("standard"), jax.numpy_rank_promotion("allow"):
            updates, memory = jax.vmap(_ADAM.update)(gradients, memory, values)
            moved = jnp.clip(values + rate * units * updates, lower, upper)
        return (moved, memory, best), None

    lowest = jnp.full(len(values), -jnp.inf, values.dtype)
    best = BestPlacements(values, jnp.zeros(len(values), jnp.int32), lowest)
    start: Any = (values, jax.vmap(_ADAM.init)(values), best)
    return jax.lax.scan(step, start, (blurs, rates))[0][2]
