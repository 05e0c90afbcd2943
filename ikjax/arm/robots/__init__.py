"""The catalogue: one table a robot, built by `ikjax.robots.NAME()`.

Storey: arm.
"""

from collections.abc import Callable

from ikjax.arm.arm import Arm
from ikjax.arm.robots.industrial import irb120, irb2400, kr6_r900, lrmate200id, rx160
from ikjax.arm.robots.textbook import elbow_manipulator, puma560
from ikjax.arm.robots.universal import ur3e, ur5, ur5e, ur10e

_ROBOTS: dict[str, Callable[[], Arm]] = {
    "elbow_manipulator": elbow_manipulator,
    "irb120": irb120,
    "irb2400": irb2400,
    "kr6_r900": kr6_r900,
    "lrmate200id": lrmate200id,
    "puma560": puma560,
    "rx160": rx160,
    "ur10e": ur10e,
    "ur3e": ur3e,
    "ur5": ur5,
    "ur5e": ur5e,
}


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
