"""The list of robots: a function under the decorator `robot` enters itself, with its named poses."""

from collections.abc import Callable
from typing import NamedTuple, TypeVar

from ikjax.arm.arm import Arm

Build = TypeVar("Build", bound=Callable[..., Arm])


class Entry(NamedTuple):
    """A robot of the catalogue."""

    build: Callable[..., Arm]
    poses: dict[str, tuple[float, ...]]
    """Joint values [rad, m] by name."""


CATALOGUE: dict[str, Entry] = {}


def robot(**poses: tuple[float, ...]) -> Callable[[Build], Build]:
    """Decorator: enter a function that builds an arm in the catalogue under its own name.

    Args:
        poses: The published poses by name, in the arm's own joint values [rad, m].
    """

    def enter(build: Build) -> Build:
        named = {name: tuple(float(x) for x in q) for name, q in poses.items()}
        CATALOGUE[build.__name__] = Entry(build, named)
        return build

    return enter
