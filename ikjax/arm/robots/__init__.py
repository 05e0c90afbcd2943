"""The catalogue: one table a robot, built by `ikjax.robots.NAME()`."""

from ikjax.arm.arm import Arm
from ikjax.arm.robots.catalogue import CATALOGUE, Entry
from ikjax.arm.robots.five_joints import katana_6m180, so101, vx300
from ikjax.arm.robots.industrial import irb120, irb2400, kr6_r900, lrmate200id, rx160
from ikjax.arm.robots.offset_wrists import cobotta, crx10ia, gen3lite, gofa5, gofa10, hc10, link6, xarm6
from ikjax.arm.robots.scara import gx4_351s
from ikjax.arm.robots.seven_joints import fer, fr3, gen3, gen72, iiwa7, iiwa14, rm75, xarm7
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
from ikjax.arm.robots.universal import ur3e, ur5, ur5e, ur10e


def names() -> tuple[str, ...]:
    """The robots in the catalogue, in alphabetical order."""
    return tuple(sorted(CATALOGUE))


def get(name: str) -> Arm:
    """A robot of the catalogue by name, with its default lengths where it has free ones.

    Args:
        name: One of `names()`: "puma560", "ur5e", ...

    Returns:
        The arm; its leaves have JAX's own floating type (float64 when x64 is on).

    Raises:
        ValueError: No such name; the names are listed.
    """
    return _entry(name).build()


def poses(name: str) -> dict[str, tuple[float, ...]]:
    """The published poses of a robot by name: joint values [rad, m], within the joint limits.

    Args:
        name: One of `names()`.

    Returns:
        (n,) joint values for each pose; empty where none is published.

    Raises:
        ValueError: No such name; the names are listed.
    """
    return dict(_entry(name).poses)


def _entry(name: str) -> Entry:
    if name not in CATALOGUE:
        raise ValueError(f"no robot {name!r}; the catalogue has {', '.join(names())}")
    return CATALOGUE[name]
