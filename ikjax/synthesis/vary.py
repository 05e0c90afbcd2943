"""Reading what a design study may move: `vary`, `ties` and linear constraints as a user writes them.

Host side. Whatever would take the arm out of its family is refused here, before anything runs.
"""

import re
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from ikjax.arm.arm import Arm
from ikjax.arm.recognition import free_parameters
from ikjax.arm.recognition.free_parameters import COLUMNS
from ikjax.synthesis.parameters import TWIST, Parameters

PARTS = {"": TWIST, "xyz": TWIST[:3], "turn": TWIST[3:], **{part: (part,) for part in TWIST}}


def chosen(arm: Arm, vary: Mapping, ties: Sequence[str] = (), rules: Sequence[str] = ()) -> Parameters:
    """The numbers named in `vary`, with their bounds, and the ties and rules between them.

    Args:
        arm: An arm with a family.
        vary: From names to (lower, upper), or (lower, upper, mask), numbers or one for each entry. A
            name is that of a number, "d4"; of a column, "a", which stands for all of it that is free, or
            for what the mask says; or of a mount: "base", "base.xyz", "base.turn", "base.x" ... "base.rz",
            and "tool" likewise, in metres and radians from where it is.
        ties: Equations such as "a2 + 2 d4 = 1"; numbers of the table that do not vary stand for themselves.
        rules: Inequalities such as "a2 + 2 d4 <= 1", likewise.

    Raises:
        ValueError: A name that is none, bounds that are none, a number that would leave the family
            within its bounds, ties or rules that cannot be read, ties that cannot be met: the message says
            what may vary.
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
        raise ValueError(f"vary must name what may move: {_offer(arm)}")
    _check_family(arm, bounds)
    lower, upper = zip(*bounds.values(), strict=True)
    names = tuple(bounds)
    made = Parameters(
        names,
        lower,
        upper,
        tuple(_row(arm, names, text, _TIE) for text in ties),
        tuple(_row(arm, names, text, _RULE) for text in rules),
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
            raise ValueError(f"vary: {error}; {_offer(arm)}") from error
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
    return [row for row, kept in zip(zip(names, low, high, strict=True), mask, strict=True) if kept]


def _offer(arm: Arm) -> str:
    return f"free are {', '.join(arm.free)}, base and tool"


def _check_family(arm: Arm, bounds: Mapping[str, tuple[float, float]]) -> None:
    """Raise where a number, between its bounds, leaves the family; the others in the middle of theirs."""
    table = {name: pair for name, pair in bounds.items() if "." not in name}
    middle = {name: (low + high) / 2 for name, (low, high) in table.items()}
    for name, (low, high) in table.items():
        for share in (0.02, 0.3, 0.7, 0.98):
            value = low + share * (high - low)
            why = free_parameters.why_not(arm, {**middle, name: value})
            if why is not None:
                raise ValueError(
                    f"{name} = {value:.4g} takes {arm.name} out of the family {arm.family}: {why}. "
                    f"As it stands, {_offer(arm)}"
                )


class _Kind(NamedTuple):
    """What a row of factors stands for, in words, and the signs that may stand in it."""

    name: str
    must: str
    signs: Mapping[str, int]
    """And whether the left side counts or, for -1, the right."""


_TIE = _Kind("tie", "an equation such as 'a2 + d4 = 1'", {"=": 1})
_RULE = _Kind("constraint", "a function or an inequality such as 'a2 + d4 <= 1'", {"<=": 1, ">=": -1})


def _row(arm: Arm, names: tuple[str, ...], text: str, kind: _Kind) -> tuple[float, ...]:
    """Factors of the names, and what they sum up to, at most in an inequality."""
    sides = re.split("(<=|>=|=)", text)
    if len(sides) != 3 or sides[1] not in kind.signs:
        raise ValueError(f"a {kind.name} must be {kind.must}, got {text!r}")
    factors, total, way_round = np.zeros(len(names)), 0.0, kind.signs[sides[1]]
    for sign, side in zip((way_round, -way_round), sides[::2], strict=True):
        terms = re.findall(r"([+-]?)\s*([^+-]+)", side.strip())
        if not terms:
            raise ValueError(f"a {kind.name} must have something on both sides, got {text!r}")
        for way, term in terms:
            factor, name = _term(term, text, kind)
            factor *= sign * (-1 if way == "-" else 1)
            if name in names:
                factors[names.index(name)] += factor
            elif name is None or "." not in name:
                total -= factor * (1.0 if name is None else free_parameters.number(arm, name))
            else:
                raise ValueError(f"the {kind.name} {text!r} speaks of {name}, which does not vary")
    if not factors.any():
        raise ValueError(f"the {kind.name} {text!r} speaks of nothing that varies: {', '.join(names)}")
    return (*factors.tolist(), total)


def _term(term: str, text: str, kind: _Kind) -> tuple[float, str | None]:
    """A factor and a name, either of which may be left out."""
    found = re.fullmatch(r"(\d+\.?\d*|\.\d+)?\s*\*?\s*([a-z]+\.[a-z]+|[a-z]+\d+)?", term.strip())
    if not found or not term.strip():
        raise ValueError(f"cannot read {term.strip()!r} in the {kind.name} {text!r}")
    factor, name = found.groups()
    return float(factor or 1), name


def _check_ties(made: Parameters, ties: Sequence[str]) -> None:
    if not ties:
        return
    values = np.asarray(made.values(jnp.zeros(len(made.names))), float)
    for row, text in zip(np.array(made.ties), ties, strict=True):
        gap = row[:-1] @ values - row[-1]
        if not abs(gap) < 1e-5 * (1 + abs(row[-1])):
            raise ValueError(
                f"the tie {text!r} cannot be met within the bounds: it is off by {gap:.3g} at best"
            )
