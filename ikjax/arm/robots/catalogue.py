"""The list in which every robot's table enters itself: its name, how to build it, its named poses."""

from collections.abc import Callable
from typing import NamedTuple, TypeVar

from ikjax.arm.arm import Arm

Build = TypeVar("Build", bound=Callable[..., Arm])


class Entry(NamedTuple):
    build: Callable[..., Arm]
    poses: dict[str, tuple[float, ...]]


CATALOGUE: dict[str, Entry] = {}


def robot(**poses: tuple[float, ...]) -> Callable[[Build], Build]:
    """Enter the table below in the catalogue, with its published poses in its own joints [rad, m]."""

    def enter(build: Build) -> Build:
        named = {name: tuple(float(x) for x in q) for name, q in poses.items()}
        CATALOGUE[build.__name__] = Entry(build, named)
        return build

    return enter
