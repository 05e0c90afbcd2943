"""The numbers of an arm that a design study varies: their names, bounds and ties.

A logistic function keeps each number between its bounds, lower + width / (1 + exp(-z)), so that any
optimizer may move any z. Ties are linear equations between numbers. They are met by shifting z along the
rows of the equations, and the bounds hold as before. Base and tool move by a twist: a shift and a turn
(rotation vector) about their own origin, in the axes of the world and of the last link.

Source: the shift that meets the ties is the entropic projection onto them, found by Newton's method on its
dual, which is convex (Bregman 1967).
"""

import dataclasses
import functools
import re
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ikjax.arm.arm import Arm
from ikjax.arm.recognition import free_parameters
from ikjax.arm.recognition.free_parameters import COLUMNS
from ikjax.core import pose as poses
from ikjax.core import safe
from ikjax.core.linear import solve_symmetric
from ikjax.ik.redundancy import pose_product

TWIST = ("x", "y", "z", "rx", "ry", "rz")
NEWTON_STEPS = 40
"""Newton steps towards the ties; each changes a dual variable by 2 at most."""


@dataclasses.dataclass(frozen=True)
class Parameters:
    """What varies, between which bounds and constraints; hashable, so that it may be static under jit."""

    names: tuple[str, ...]
    """"a2", "d4", "base.x", ..., "tool.rz"; shifts [m] and turns [rad] of base and tool count from zero."""
    lower: Any
    """(k,) a tuple; empty in a plan, whose bounds are data, and traced inside a program."""
    upper: Any
    """(k,) likewise."""
    ties: tuple[tuple[float, ...], ...] = ()
    """A row for each tie: its coefficients, one for each name, and then the right-hand side."""
    inequalities: tuple[tuple[float, ...], ...] = ()
    """A row for each linear constraint: its coefficients, and then the greatest value of their sum."""

    def with_bounds(self, bounds: Any) -> "Parameters":
        """The same with other bounds, (2, k); none of them for ()."""
        lower, upper = bounds if len(bounds) else ((), ())
        return dataclasses.replace(self, lower=lower, upper=upper)

    def values(self, z: jax.Array) -> jax.Array:
        """The numbers (k,) of coordinates z (k,): within bounds, and on the ties."""
        lower = jnp.asarray(self.lower, z.dtype)
        width = jnp.asarray(self.upper, z.dtype) - lower
        return lower + width * jax.nn.sigmoid(self._on_ties(z))

    def violations(self, values: jax.Array) -> jax.Array:
        """How far each linear constraint is above zero at numbers (k,): (c,)."""
        table = jnp.asarray(np.reshape(self.inequalities, (-1, len(self.names) + 1)), values.dtype)
        return (table[:, :-1] * values[None]).sum(-1) - table[:, -1]

    def coordinates(self, values) -> np.ndarray:
        """z of numbers (k,); a number at a bound or beyond is moved inside, by a thousandth of the width."""
        lower, upper = np.array(self.lower), np.array(self.upper)
        share = np.clip((np.asarray(values, float) - lower) / (upper - lower), 1e-3, 1 - 1e-3)
        return np.log(share) - np.log1p(-share)

    def random(self, rng: np.random.Generator, count: int) -> np.ndarray:
        """z of numbers spread evenly between the bounds, not yet on the ties: (count, k)."""
        share = rng.uniform(0.02, 0.98, (count, len(self.names)))
        return np.log(share) - np.log1p(-share)

    def of(self, arm: Arm) -> np.ndarray:
        """The numbers (k,) of an arm as it is."""
        return np.array([0.0 if "." in name else free_parameters.number(arm, name) for name in self.names])

    def put(self, arm: Arm, values: jax.Array) -> Arm:
        """The arm with the numbers (k,) in their places; they may be traced."""
        leaves = self._columns(arm, values)
        for mount in ("base", "tool"):
            if self._varies(mount):
                leaves[mount] = self._mount(arm, mount, values)
        return dataclasses.replace(arm, **leaves)

    def arm_and_goals(self, arm: Arm, goals: jax.Array, values: jax.Array) -> tuple[Arm, jax.Array]:
        """An arm and goals (..., 4, 4) whose joints are those of `put`'s arm for the goals as given.

        Base and tool are fixed and the goals move instead. More of the arm is then constant while the kernel
        is compiled, and derivatives are taken in the goals: a fraction of the work.
        """
        leaves = self._columns(arm, values)
        if self._varies("base"):
            back = pose_product(_given(arm, "base", values), pose_inverse(self._mount(arm, "base", values)))
            goals = pose_product(back, goals)
        if self._varies("tool") and arm.task == "pose":
            on = pose_product(pose_inverse(self._mount(arm, "tool", values)), _given(arm, "tool", values))
            goals = pose_product(goals, on)
        elif self._varies("tool"):
            # Where a goal's orientation is free, the tool cannot be made part of it.
            leaves["tool"] = self._mount(arm, "tool", values)
        return dataclasses.replace(arm, **leaves), goals

    def _columns(self, arm: Arm, values: jax.Array) -> dict[str, Any]:
        """The columns of the DH table in which something varies."""
        leaves: dict[str, Any] = {}
        for column in COLUMNS:
            at = {name: i for i, name in enumerate(self.names) if name.rstrip("0123456789") == column}
            if at:
                rows = jnp.array([int(name[len(column) :]) - 1 for name in at])
                leaf = jnp.asarray(getattr(arm, column), values.dtype)
                leaves[column] = leaf.at[rows].set(values[jnp.array(list(at.values()))])
        return leaves

    def _varies(self, mount: str) -> bool:
        return any(name.startswith(f"{mount}.") for name in self.names)

    def _mount(self, arm: Arm, mount: str, values: jax.Array) -> jax.Array:
        names = [f"{mount}.{part}" for part in TWIST]
        zero = jnp.zeros_like(values[0])
        twist = [values[self.names.index(name)] if name in self.names else zero for name in names]
        return moved_by_twist(_given(arm, mount, values), twist)

    def _on_ties(self, z: jax.Array) -> jax.Array:
        """Coordinates shifted by the rows of the ties, so that the numbers meet them."""
        if not self.ties:
            return z
        table = jnp.asarray(np.array(self.ties), z.dtype)
        lower, upper = (jnp.asarray(ends, z.dtype) for ends in (self.lower, self.upper))
        rows = table[:, :-1] * (upper - lower)[None]
        wanted = table[:, -1] - (table[:, :-1] * lower[None]).sum(-1)
        size = jnp.sqrt((rows * rows).sum(-1))
        rows, wanted = rows / size[:, None], wanted / size
        count, tiny = len(table), float(jnp.finfo(z.dtype).tiny) ** 0.5

        def shifted(z, dual):
            return z + (rows * dual[:, None]).sum(0)

        def newton_step(dual, z):
            share = jax.nn.sigmoid(shifted(z, dual))
            residual = (rows * share[None]).sum(-1) - wanted
            derivative = jax.lax.stop_gradient(share * (1 - share))[None]
            hessian = [
                [(rows[i : i + 1] * derivative * rows[j : j + 1]).sum() for j in range(count)]
                for i in range(count)
            ]
            for i in range(count):
                hessian[i][i] = hessian[i][i] + tiny
            step = solve_symmetric(hessian, [residual[i] for i in range(count)])
            return dual - jnp.clip(jnp.stack(step), -2, 2)

        fixed = jax.lax.stop_gradient(z)
        dual = jax.lax.fori_loop(
            0, NEWTON_STEPS, lambda _, dual: newton_step(dual, fixed), jnp.zeros(count, z.dtype)
        )
        # One more step carries the derivative: by the implicit function theorem it is that of the equations.
        return shifted(z, newton_step(dual, z))


def moved_by_twist(mount: jax.Array, twist: Sequence[jax.Array]) -> jax.Array:
    """A pose shifted, and turned about its own origin, in the axes that it is given in."""
    x, y, z = twist[3:]
    angle = safe.norm(x, y, z)
    half = angle / 2
    small = half < 1e-3
    # Below a half angle of 1e-3 the series of sin(half) / half is used. The second `where` keeps the quotient
    # finite there: reverse mode would multiply an infinite derivative by zero.
    divisor = jnp.where(small, 1, half)
    share = jnp.where(small, 1 - (x * x + y * y + z * z) / 24, jnp.sin(divisor) / divisor) / 2
    rotation = poses.from_quaternion((jnp.cos(half), share * x, share * y, share * z))
    turn = jnp.stack([jnp.stack(row) for row in rotation])
    spun = jnp.stack([sum(turn[i, k] * mount[k, :3] for k in range(3)) for i in range(3)])
    return mount.at[:3, :3].set(spun).at[:3, 3].add(jnp.stack(twist[:3]))


def _given(arm: Arm, mount: str, like: jax.Array) -> jax.Array:
    return jnp.asarray(getattr(arm, mount), like.dtype)


def pose_inverse(pose: jax.Array) -> jax.Array:
    return poses.to_matrix(poses.inverse(poses.from_matrix(pose)))


PARTS = {"": TWIST, "xyz": TWIST[:3], "turn": TWIST[3:], **{part: (part,) for part in TWIST}}


def choose_parameters(
    arm: Arm, vary: Mapping, ties: Sequence[str] = (), inequalities: Sequence[str] = ()
) -> Parameters:
    """The numbers named in `vary`, with their bounds, and the ties and inequalities between them.

    Args:
        arm: An arm with a family.
        vary: From names to (lower, upper) or (lower, upper, mask), each one value or one for each entry. A
            name is that of a number, "d4"; of a column, "a", which means all its free numbers, or those of
            the mask; or of a mount: "base", "base.xyz", "base.turn", "base.x" ... "base.rz", and "tool"
            likewise, in metres and radians from where it is.
        ties: Equations such as "a2 + 2 d4 = 1"; numbers of the table that do not vary keep their value.
        inequalities: Such as "a2 + 2 d4 <= 1", likewise.

    Raises:
        ValueError: An unknown name, invalid bounds, a number that would leave the family within its bounds,
            ties or inequalities that cannot be read, ties that cannot be met. The message says what may vary.
    """
    bounds: dict[str, tuple[float, float]] = {}
    for name, value in vary.items():
        for entry, low, high in _entries(arm, name, value):
            if entry in bounds:
                raise ValueError(f"vary names {entry} twice")
            if not (np.isfinite([low, high]).all() and low < high):
                raise ValueError(
                    f"vary[{name!r}] must hold finite lower < upper for {entry}, got {low}, {high}"
                )
            bounds[entry] = (low, high)
    if not bounds:
        raise ValueError(f"vary must name what may move: {_what_may_vary(arm)}")
    _check_family(arm, bounds)
    lower, upper = zip(*bounds.values(), strict=True)
    names = tuple(bounds)
    made = Parameters(
        names,
        lower,
        upper,
        tuple(_coefficients(arm, names, text, _TIE) for text in ties),
        tuple(_coefficients(arm, names, text, _INEQUALITY) for text in inequalities),
    )
    _check_ties(made, ties)
    return made


def _entries(arm: Arm, name: str, value) -> list[tuple[str, float, float]]:
    """Names of single numbers with their bounds."""
    mount, _, part = name.partition(".")
    if mount in ("base", "tool") and part in PARTS:
        names = [f"{mount}.{each}" for each in PARTS[part]]
    elif name in COLUMNS:
        names = [f"{name}{i + 1}" for i in range(arm.n)]
    else:
        try:
            free_parameters.number(arm, name)
        except ValueError as error:
            raise ValueError(f"vary: {error}; {_what_may_vary(arm)}") from error
        names = [name]
    try:
        low, high, *mask = value
        low, high = (np.broadcast_to(np.asarray(x, float), len(names)).tolist() for x in (low, high))
        mask = np.broadcast_to(np.asarray(mask[0], bool), len(names)) if mask else None
    except (TypeError, ValueError) as error:
        raise ValueError(
            f"vary[{name!r}] must be (lower, upper) or (lower, upper, mask), numbers or {len(names)} of "
            f"them, got {value!r}"
        ) from error
    if mask is None:
        mask = np.isin(names, arm.free) if name in COLUMNS else np.full(len(names), True)
    return [row for row, chosen in zip(zip(names, low, high, strict=True), mask, strict=True) if chosen]


def _what_may_vary(arm: Arm) -> str:
    return f"free are {', '.join(arm.free)}, base and tool"


def _check_family(arm: Arm, bounds: Mapping[str, tuple[float, float]]) -> None:
    """Raise if a number between its bounds leaves the family, the others being in the middle of theirs."""
    columns = {name: pair for name, pair in bounds.items() if "." not in name}
    middle = {name: (low + high) / 2 for name, (low, high) in columns.items()}
    for name, (low, high) in columns.items():
        for share in (0.02, 0.3, 0.7, 0.98):
            value = low + share * (high - low)
            why = free_parameters.why_not(arm, {**middle, name: value})
            if why is not None:
                raise ValueError(
                    f"{name} = {value:.4g} takes {arm.name} out of the family {arm.family}: {why}. "
                    f"As it stands, {_what_may_vary(arm)}"
                )


class _Kind(NamedTuple):
    """A tie or an inequality: its name for messages, and the signs that it may have."""

    name: str
    must: str
    signs: Mapping[str, int]
    """Each sign with 1 where left minus right is constrained, or -1 for right minus left."""


_TIE = _Kind("tie", "an equation such as 'a2 + d4 = 1'", {"=": 1})
_INEQUALITY = _Kind("constraint", "a function or an inequality such as 'a2 + d4 <= 1'", {"<=": 1, ">=": -1})


def _coefficients(arm: Arm, names: tuple[str, ...], text: str, kind: _Kind) -> tuple[float, ...]:
    """Coefficients of the names, and the right-hand side: a linear equation or inequality, read from text."""
    sides = re.split("(<=|>=|=)", text)
    if len(sides) != 3 or sides[1] not in kind.signs:
        raise ValueError(f"a {kind.name} must be {kind.must}, got {text!r}")
    coefficients, total, direction = np.zeros(len(names)), 0.0, kind.signs[sides[1]]
    for side_sign, side in zip((direction, -direction), sides[::2], strict=True):
        terms = re.findall(r"([+-]?)\s*([^+-]+)", side.strip())
        if not terms:
            raise ValueError(f"a {kind.name} must have something on both sides, got {text!r}")
        for sign, term in terms:
            factor, name = _term(term, text, kind)
            factor *= side_sign * (-1 if sign == "-" else 1)
            if name in names:
                coefficients[names.index(name)] += factor
            elif name is None or "." not in name:
                total -= factor * (1.0 if name is None else free_parameters.number(arm, name))
            else:
                raise ValueError(f"the {kind.name} {text!r} speaks of {name}, which does not vary")
    if not coefficients.any():
        raise ValueError(f"the {kind.name} {text!r} speaks of nothing that varies: {', '.join(names)}")
    return (*coefficients.tolist(), total)


def _term(term: str, text: str, kind: _Kind) -> tuple[float, str | None]:
    """A factor and a name, either of which may be left out."""
    found = re.fullmatch(r"(\d+\.?\d*|\.\d+)?\s*\*?\s*([a-z]+\.[a-z]+|[a-z]+\d+)?", term.strip())
    if not found or not term.strip():
        raise ValueError(f"cannot read {term.strip()!r} in the {kind.name} {text!r}")
    factor, name = found.groups()
    return float(factor or 1), name


@functools.partial(jax.jit, static_argnums=0)
def _values_between(parameters: Parameters, bounds: jax.Array, z: jax.Array) -> jax.Array:
    return parameters.with_bounds(bounds).values(z)


def _check_ties(made: Parameters, ties: Sequence[str]) -> None:
    if not ties:
        return
    bounds = jnp.asarray([made.lower, made.upper], float)
    values = np.asarray(_values_between(made.with_bounds(()), bounds, jnp.zeros(len(made.names))), float)
    for row, text in zip(np.array(made.ties), ties, strict=True):
        residual = row[:-1] @ values - row[-1]
        if not abs(residual) < 1e-5 * (1 + abs(row[-1])):
            raise ValueError(
                f"the tie {text!r} cannot be met within the bounds: it is off by {residual:.3g} at best"
            )
