"""The spherical wrist: three angles from a rotation.

Storey: solvers. Branches: 2 (noflip, flip).

With n and x the third and first column of N = Rz(t4) Rx(alpha4) Rz(t5) Rx(alpha5) Rz(t6):
t5 from n along axis 4, then t4 from the rest of n, then t6 from x, which makes up for whatever
t4 was chosen when axes 4 and 6 line up.
Source: Craig, Introduction to Robotics, 3rd ed., section 4.6; the general twists are ours.
"""

from typing import NamedTuple

import jax.numpy as jnp

from ikjax.core import safe, vector
from ikjax.core.trig import Angle, Scalar, choose, half_turn
from ikjax.core.vector import Vector
from ikjax.solvers.branch import Setting


class Wrist(NamedTuple):
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
        setting: Fills t4 where it is arbitrary, that is where axes 4 and 6 line up.
    """
    s4, s5 = signs
    angle, now, tiny = setting.angle, setting.now[3], setting.tiny
    rho_squared = n[0] * n[0] + n[1] * n[1]
    free = rho_squared <= tiny * tiny
    weight = side * s5 * safe.reciprocal_sqrt(rho_squared)
    first = angle(jnp.where(free, now.sin, n[1] * weight), jnp.where(free, now.cos, n[0] * weight))
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
    """Both answers of a wrist of any twists; not every rotation is within its reach.

    Args:
        twists: sin(alpha4), cos(alpha4), sin(alpha5), cos(alpha5).
        The rest as in `square_wrist`.

    Returns:
        As `square_wrist`; the margin is in sines, |sin(alpha4) sin(alpha5)| at most.
    """
    s4, c4, s5, c5 = twists
    angle, now, tiny = setting.angle, setting.now[3], setting.tiny
    along = c4 * c5 - n[2]
    cosine = jnp.clip(along / (s4 * s5), -1, 1)
    margin = abs(s4 * s5) - jnp.abs(along)
    height = side * setting.root((1 - cosine) * (1 + cosine))
    answers = []
    for flip in (1, -1):
        sine = flip * height
        u, v = s5 * sine, -(c4 * s5 * cosine + s4 * c5)
        rho_squared = (n[0] * n[0] + n[1] * n[1]) * (u * u + v * v)
        free = rho_squared <= tiny**4
        weight = safe.reciprocal_sqrt(rho_squared)
        first = angle(
            jnp.where(free, now.sin, (n[1] * u - n[0] * v) * weight),
            jnp.where(free, now.cos, (n[0] * u + n[1] * v) * weight),
        )
        # Columns of Rz(t4) Rx(alpha4) Rz(t5) Rx(alpha5): x turns in the plane of the first two.
        a = (cosine, c4 * sine, s4 * sine)
        b = (-c5 * sine, c4 * c5 * cosine - s4 * s5, s4 * c5 * cosine + c4 * s5)
        ahead, aside = (_turned(first, w) for w in (a, b))
        x_aside, x_ahead = vector.dot(aside, x), vector.dot(ahead, x)
        # Of length one, except where t5 is clamped.
        size = safe.reciprocal_sqrt(x_aside * x_aside + x_ahead * x_ahead)
        last = angle(x_aside * size, jnp.where(size == 0, 1, x_ahead * size))
        answers.append(Wrist((first, angle(sine, cosine), last), margin, free))
    return answers[0], answers[1]


def shortfall(n: Vector, twists: tuple[Scalar, Scalar, Scalar, Scalar]) -> Scalar:
    """How much n must rise along axis 4 for a wrist of these twists to reach it; zero where it does."""
    s4, c4, s5, c5 = twists
    along = c4 * c5 - n[2]
    return along - jnp.clip(along, -abs(s4 * s5), abs(s4 * s5))


def _turned(about_z: Angle, v: Vector) -> Vector:
    return (
        about_z.cos * v[0] - about_z.sin * v[1],
        about_z.sin * v[0] + about_z.cos * v[1],
        v[2],
    )
