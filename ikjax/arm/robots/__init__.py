"""The catalogue: one table a robot, built by `ikjax.robots.NAME()`.

Storey: arm.
"""

from collections.abc import Callable

from ikjax.arm.arm import Arm
from ikjax.arm.robots.industrial import irb120, irb2400, kr6_r900, lrmate200id, rx160
from ikjax.arm.robots.scara import gx4_351s
from ikjax.arm.robots.textbook import (
    elbow_manipulator,
    planar_2r,
    planar_3r,
    planar_prr,
    planar_rpr,
    puma560,
    stanford,
)
from ikjax.arm.robots.universal import ur3e, ur5, ur5e, ur10e

_ROBOTS: dict[str, Callable[[], Arm]] = {
    "elbow_manipulator": elbow_manipulator,
    "gx4_351s": gx4_351s,
    "irb120": irb120,
    "irb2400": irb2400,
    "kr6_r900": kr6_r900,
    "lrmate200id": lrmate200id,
    "planar_2r": planar_2r,
    "planar_3r": planar_3r,
    "planar_prr": planar_prr,
    "planar_rpr": planar_rpr,
    "puma560": puma560,
    "rx160": rx160,
    "stanford": stanford,
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
