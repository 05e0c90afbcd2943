"""Goals that no value of the redundant joint reaches, searched between the values.

Each slot of a goal is a curve over the redundant joint. Its level is the lesser of the clearances of the fold
and of the joint limits, in reaches and radians: continuous, and not negative where the slot counts. Every
local maximum of the samples that may rise above zero is searched by halving its bracket. A goal is settled as
reached by a value that reaches it; as not reached where the levels of all slots stay below zero.

A maximum is taken to rise, from one sample to the next, no more than `STEEPER` times as much as the levels
there differ. So it is a search and no proof.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

WIDTH = 16
"""Values at which the slots of each goal are evaluated in one call."""

ROWS = 512
"""Goals in one call."""

MAXIMA = WIDTH // 2
"""Local maxima that are searched at once, of one goal."""

STEEPER = 4.0
"""A choice: a curve may be steeper between two samples than on average."""

HALVINGS = 24
"""Each halves the bracket of a maximum: 1e-8 rad of the 0.2 rad that two of 64 samples are apart."""

Evaluate = Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]
"""From places of goals (n,) and values (n, WIDTH), n at most `ROWS`, to the levels of slots and whether they
count, (n, WIDTH, slots, kinds) each. A kind says what counts: with the limits or without."""


class _Brackets(NamedTuple):
    """Maxima that are searched, (n, MAXIMA) each but for the first two. A goal of many has several rows."""

    goal: np.ndarray
    """(n,) place of the goal."""
    kind: np.ndarray
    """(n,)"""
    slot: np.ndarray
    low: np.ndarray
    middle: np.ndarray
    high: np.ndarray
    best: np.ndarray
    """The level in the middle."""
    hopeful: np.ndarray
    """bool: it may still rise above zero."""


def is_reached(evaluate: Evaluate, wanted: np.ndarray, samples: np.ndarray) -> np.ndarray:
    """Whether some value of the redundant joint reaches each goal.

    Args:
        evaluate: The slots of goals at values of their own.
        wanted: (goals, kinds) bool, of which goals that is asked.
        samples: (m,) values from the least to the greatest, m a multiple of `WIDTH`.

    Returns:
        (goals, kinds) bool, false where it is not asked.
    """
    reached, found = np.zeros(wanted.shape, bool), []
    asked = np.flatnonzero(wanted.any(1))
    for first in range(0, len(asked), ROWS):
        goals = asked[first : first + ROWS]
        parts = [
            evaluate(goals, np.broadcast_to(part, (len(goals), WIDTH))) for part in samples.reshape(-1, WIDTH)
        ]
        level, counts = (np.concatenate(each, axis=1) for each in zip(*parts, strict=True))
        reached[goals] = counts.any((1, 2)) & wanted[goals]
        for kind in range(wanted.shape[1]):
            left = wanted[goals, kind] & ~reached[goals, kind]
            found.append(_brackets(goals[left], kind, level[left, :, :, kind], samples))
    if found:
        whole = _Brackets(*map(np.concatenate, zip(*found, strict=True)))
        hit = _hits(evaluate, whole)
        reached[whole.goal[hit], whole.kind[hit]] = True
    return reached


def _brackets(goals: np.ndarray, kind: int, level: np.ndarray, samples: np.ndarray) -> _Brackets:
    """The maxima of levels (n, m, slots) that may rise above zero."""
    edge = np.full_like(level[:, :1], np.nan)
    before, after = np.concatenate([edge, level[:, :-1]], 1), np.concatenate([level[:, 1:], edge], 1)
    # Of a maximum at an end of the range there is one neighbor.
    is_maximum = ~(level < before) & ~(level < after)
    steps = np.where(is_maximum, _steps_to_zero(level, np.fmin(before, after)), np.inf).reshape(
        len(level), -1
    )
    hopeful = np.sort(np.where(steps <= STEEPER, np.arange(steps.shape[1]), steps.shape[1]), axis=1)
    # As many rows for each goal as its maxima fill.
    most = -(-(hopeful < steps.shape[1]).sum(1) // MAXIMA)
    rows = np.repeat(np.arange(len(goals)), most)
    first = MAXIMA * (np.arange(len(rows)) - np.repeat(np.cumsum(most) - most, most))
    hopeful = np.pad(hopeful, [(0, 0), (0, MAXIMA)], constant_values=steps.shape[1])
    best = hopeful[rows[:, None], first[:, None] + np.arange(MAXIMA)]
    is_one = best < steps.shape[1]
    best = np.where(is_one, best, 0)
    place, slot = best // level.shape[2], best % level.shape[2]
    low, middle, high = (samples[np.clip(place + k, 0, len(samples) - 1)] for k in (-1, 0, 1))
    peak = level[rows[:, None], place, slot]
    return _Brackets(goals[rows], np.full(len(rows), kind), slot, low, middle, high, peak, is_one)


def _steps_to_zero(level: np.ndarray, lowest: np.ndarray) -> np.ndarray:
    """How many steps of the samples a level is below zero, where it rose from the lowest of its neighbors."""
    with np.errstate(divide="ignore", invalid="ignore"):
        steps = np.maximum(-level, 0) / (level - lowest)
    return np.where(np.isnan(steps), np.inf, steps)


def _hits(evaluate: Evaluate, brackets: _Brackets) -> np.ndarray:
    """Whether a slot counts somewhere in the brackets of each row, (n,) bool."""
    hit = np.zeros(len(brackets.goal), bool)
    left, now = np.arange(len(hit)), brackets
    for _ in range(HALVINGS):
        ends = range(0, len(left), ROWS)
        rounds = [_halved(evaluate, _Brackets(*(x[k : k + ROWS] for x in now))) for k in ends]
        if not rounds:
            break
        found = np.concatenate([each for each, _ in rounds])
        now = _Brackets(*map(np.concatenate, zip(*(each for _, each in rounds), strict=True)))
        hit[left[found]] = True
        going_on = ~found & now.hopeful.any(1)
        left, now = left[going_on], _Brackets(*(x[going_on] for x in now))
    return hit


def _halved(evaluate: Evaluate, now: _Brackets) -> tuple[np.ndarray, _Brackets]:
    """Whether a slot counts half-way to the ends of its brackets, (n,), and brackets half as wide."""
    lower, upper = (now.low + now.middle) / 2, (now.middle + now.high) / 2
    row, column = np.arange(len(now.goal))[:, None], np.arange(WIDTH)
    own = row, column, np.concatenate([now.slot, now.slot], 1), now.kind[:, None]
    level, counts = (x[own] for x in evaluate(now.goal, np.concatenate([lower, upper], 1)))
    found = (counts & np.concatenate([now.hopeful, now.hopeful], 1)).any(1)
    left, right, best = level[:, :MAXIMA], level[:, MAXIMA:], now.best
    go_left = (left > best) & (left >= right)
    go_right = (right > best) & ~go_left
    peak, lowest = (extreme(best, extreme(left, right)) for extreme in (np.maximum, np.minimum))
    hopeful = now.hopeful & (_steps_to_zero(peak, lowest) <= STEEPER)
    return found, now._replace(
        low=np.where(go_left, now.low, np.where(go_right, now.middle, lower)),
        middle=np.where(go_left, lower, np.where(go_right, upper, now.middle)),
        high=np.where(go_left, now.middle, np.where(go_right, now.high, upper)),
        best=peak,
        hopeful=hopeful,
    )
