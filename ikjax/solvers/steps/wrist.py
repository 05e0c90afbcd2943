"""The spherical wrist: three angles from a rotation.

Branches: 2 (noflip, flip).

Frames: standard DH. n and x are the third and first column of the rotation that the wrist must make,
N = Rz(t4) Rx(alpha4) Rz(t5) Rx(alpha5) Rz(t6).

Steps:
1. t5 from the component of n along axis 4.
2. t4 from the rest of n. Where axes 4 and 6 are parallel, t4 is arbitrary.
3. t6 from x, for the t4 that was chosen.

Bit: noflip has sin(t5) of the sign `side`, flip of the other sign.

Source: Craig, Introduction to Robotics, 3rd ed., section 4.6; the general twists are ours.
"""

from typing import NamedTuple

import jax.numpy as jnp

from ikjax.core import safe
from ikjax.core.trig import Angle, Scalar, choose, half_turn
from ikjax.core.vector import Vector
from ikjax.core.xla import agreed_root
from ikjax.solvers.context import Setting


class Wrist(NamedTuple):
    """One answer."""

    joints: tuple[Angle, Angle, Angle]
    margin: Scalar
    continuum: Scalar


def square_wrist(
    n: Vector, x: Vector, signs: tuple[int, int], side: Scalar, setting: Setting
) -> tuple[Wrist, Wrist]:
    """Both answers of a wrist whose twists alpha4, alpha5 are right angles of the given signs.

    Args:
        n, x: Third and first column of the rotation that the wrist must make.
        signs: sin(alpha4), sin(alpha5).
        side: Sign of sin(t5) in the first answer; the second turns t4 and t6 half round.
        setting: Its fallback is t4 where that is arbitrary, which is where axes 4 and 6 are parallel.
    """
    s4, s5 = signs
    angle, fallback, tolerance = setting.angle, setting.fallback[3], setting.zero_tolerance
    rho_squared = n[0] * n[0] + n[1] * n[1]
    free = rho_squared <= tolerance * tolerance
    weight = side * s5 * safe.reciprocal_sqrt(rho_squared)
    first = angle(jnp.where(free, fallback.sin, n[1] * weight), jnp.where(free, fallback.cos, n[0] * weight))
    sine, cosine = side * safe.sqrt(rho_squared), -s4 * s5 * n[2]
    middle = angle(sine, cosine)
    last = angle(
        s4 * s5 * (first.sin * x[0] - first.cos * x[1]),
        middle.cos * (first.cos * x[0] + first.sin * x[1]) + s4 * middle.sin * x[2],
    )
    mirrored = Angle(-middle.sin, middle.cos, -middle.value)
    flipped = (
        choose(free, first, half_turn(first)),
        mirrored,
        choose(free, last, half_turn(last)),
    )
    return Wrist((first, middle, last), jnp.inf, free), Wrist(flipped, jnp.inf, free)


def general_wrist(
    n: Vector,
    x: Vector,
    twists: tuple[Scalar, Scalar, Scalar, Scalar],
    side: Scalar,
    setting: Setting,
) -> tuple[Wrist, Wrist]:
    """Both answers of a wrist of any twists. It does not reach every rotation.

    Args:
        twists: sin(alpha4), cos(alpha4), sin(alpha5), cos(alpha5).
        The rest as in `square_wrist`.

    Returns:
        As `square_wrist`; the margin is in sines, |sin(alpha4) sin(alpha5)| at most.
    """
    s4, c4, s5, c5 = twists
    angle, fallback, tolerance = setting.angle, setting.fallback[3], setting.zero_tolerance
    along = c4 * c5 - n[2]
    cosine = jnp.clip(along * safe.divide(1, s4 * s5), -1, 1)
    margin = abs(s4 * s5) - jnp.abs(along)
    height = side * agreed_root((1 - cosine) * (1 + cosine))
    u, v = s5 * height, -(c4 * s5 * cosine + s4 * c5)
    rho_squared = (n[0] * n[0] + n[1] * n[1]) * (u * u + v * v)
    free = rho_squared <= tolerance**4
    weight = safe.reciprocal_sqrt(rho_squared)
    u, v = u * weight, v * weight
    answers = []
    for flip in (1, -1):
        sine = flip * height
        first = angle(
            jnp.where(free, fallback.sin, flip * (n[1] * u) - n[0] * v),
            jnp.where(free, fallback.cos, flip * (n[0] * u) + n[1] * v),
        )
        # x seen from the frame before joint 5, then before joint 6.
        ahead, aside = first.cos * x[0] + first.sin * x[1], first.cos * x[1] - first.sin * x[0]
        aside, up = c4 * aside + s4 * x[2], c4 * x[2] - s4 * aside
        ahead, aside = cosine * ahead + sine * aside, cosine * aside - sine * ahead
        aside = c5 * aside + s5 * up
        # (ahead, aside) has length one, except where t5 is clamped.
        size = safe.reciprocal_sqrt(ahead * ahead + aside * aside)
        last = angle(aside * size, jnp.where(size == 0, 1, ahead * size))
        answers.append(Wrist((first, angle(sine, cosine), last), margin, free))
    return answers[0], answers[1]


def shortfall(n: Vector, twists: tuple[Scalar, Scalar, Scalar, Scalar]) -> Scalar:
    """How much larger the component of n along axis 4 must be for a wrist of these twists to reach it.

    Zero where it reaches n as it is. Arguments as in `general_wrist`.
    """
    s4, c4, s5, c5 = twists
    along = c4 * c5 - n[2]
    return along - jnp.clip(along, -abs(s4 * s5), abs(s4 * s5))
