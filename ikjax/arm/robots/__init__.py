"""The catalogue: one table a robot.

Storey: arm. `names()` lists them; `get(name)` and `robots.NAME()` build one.
"""

from collections.abc import Callable

from ikjax.arm.arm import Arm
from ikjax.arm.robots import industrial, textbook, universal

_ROBOTS: dict[str, Callable[[], Arm]] = {
    build.__name__: build for module in (textbook, universal, industrial) for build in module.ROBOTS
}
globals().update(_ROBOTS)


def names() -> tuple[str, ...]:
    """The robots in the catalogue, in alphabetical order."""
    return tuple(sorted(_ROBOTS))


def get(name: str) -> Arm:
    """A robot of the catalogue by name.

    Raises:
        ValueError: No such name; the names are listed.
    """
    if name not in _ROBOTS:
        raise ValueError(f"no robot {name!r}; the catalogue has {', '.join(names())}")
    return _ROBOTS[name]()
