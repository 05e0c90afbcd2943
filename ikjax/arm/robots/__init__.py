"""The catalogue: one table a robot, built by `ikjax.robots.NAME()`."""

import functools
import re
from collections.abc import Callable

from ikjax.arm.arm import Arm
from ikjax.arm.robots import tables
from ikjax.arm.robots.catalogue import CATALOGUE
from ikjax.arm.robots.textbook import (
    elbow_manipulator,
    motoman_l3,
    planar_2r,
    planar_3r,
    planar_prr,
    planar_rpr,
    puma560,
    stanford,
)


def names() -> tuple[str, ...]:
    """The robots in the catalogue, in alphabetical order."""
    return tuple(sorted({*CATALOGUE, *tables.tables()}))


def find(*words: str) -> tuple[str, ...]:
    """The robots whose name, title or maker has each of the words, in alphabetical order.

    Args:
        words: Parts of names: "ur", "abb", "crx"; upper and lower case are the same, spaces and signs are
            passed over. A word matches from the beginning of a name, or of a word of the title or the maker.
            None finds all.

    Returns:
        Names for `get`; empty where nothing is found.
    """
    asked = [_plain(word) for word in words]
    return tuple(name for name in names() if all(_matches(name, word) for word in asked))


def get(name: str) -> Arm:
    """A robot of the catalogue by name, with its default lengths where it has free ones.

    Args:
        name: One of `names()`: "puma560", "ur5e", ...

    Returns:
        The arm; its leaves have JAX's own floating type (float64 when x64 is on).

    Raises:
        ValueError: No such name; the nearest ones are listed.
    """
    _check(name)
    return CATALOGUE[name].build() if name in CATALOGUE else tables.build(name)


def poses(name: str) -> dict[str, tuple[float, ...]]:
    """The published poses of a robot by name: joint values [rad, m], within the joint limits.

    Args:
        name: One of `names()`.

    Returns:
        (n,) joint values for each pose; empty where none is published.

    Raises:
        ValueError: No such name; the nearest ones are listed.
    """
    _check(name)
    return dict(CATALOGUE[name].poses) if name in CATALOGUE else tables.poses(name)


def about(name: str) -> dict[str, str]:
    """What the catalogue says of a robot.

    Returns:
        Text by key: "title", "maker", "source"; "pose_source" and "note" where it has any.

    Raises:
        ValueError: No such name; the nearest ones are listed.
    """
    _check(name)
    if name in CATALOGUE:
        title, _, rest = (CATALOGUE[name].build.__doc__ or name).partition("\n")
        return {"title": title.rstrip("."), "maker": "", "source": " ".join(rest.split())}
    return {key: str(value) for key, value in tables.tables()[name].items() if key in _WORDS}


_WORDS = ("title", "maker", "source", "pose_source", "note")


def _plain(text: str) -> str:
    return re.sub(r"[^a-z0-9]+", "", text.lower())


def _matches(name: str, word: str) -> bool:
    facts = about(name)
    text = f"{facts['title']} {facts['maker']}"
    starts = [_plain(text[found.start() :]) for found in re.finditer(r"\w+", text)]
    return _plain(name).startswith(word) or any(start.startswith(word) for start in starts)


def _check(name: str) -> None:
    if name not in CATALOGUE and name not in tables.tables():
        near = [known for known in names() if _plain(name)[:3] in _plain(known)] if name else []
        listed = (
            f"near it the catalogue has {', '.join(near)}"
            if near
            else f"the catalogue has {', '.join(names())}"
        )
        raise ValueError(f"no robot {name!r}; {listed}")


def __getattr__(name: str) -> Callable[[], Arm]:
    """A robot of the tables as a function without arguments."""
    if name.startswith("_") or name not in tables.tables():
        raise AttributeError(f"module 'ikjax.robots' has no attribute {name!r}")
    return functools.partial(get, name)


def __dir__() -> list[str]:
    return sorted({*globals(), *names()})
