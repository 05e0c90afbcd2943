"""Joint 3 from the equation that is left when joints 1 and 2 are eliminated.

A part of `regional.three_joints`.

Branches: 4 of a quartic on the circle; 2 of an equation of the first degree on the circle or of the second in
a slide; 1 of one of the first degree in a slide.

The margin of a quartic's root is how far the point would have to move for the polynomial to vanish midway
between the root and the nearest root of the other kind (rising or falling), to first order: the absolute
value of the polynomial there, over the norm of its gradient with respect to the point. Near a double root
that is the distance from the fold. Where a pair of roots is complex it is negative.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax.numpy as jnp

from ikjax.core import safe
from ikjax.core.roots import CircleRoot, CircleRoots, circle_quartic, cosine_sine, harmonics_at
from ikjax.core.trig import Angle, Scalar
from ikjax.core.vector import times
from ikjax.core.xla import agreed, agreed_root, pin
from ikjax.solvers.context import Setting, Slide
from ikjax.solvers.steps.regional.point_chain import Chain, Poly


class Third(NamedTuple):
    """A candidate for joint 3."""

    joint: Angle | Slide
    u: Scalar
    """cos(t3), or q3 of a slide."""
    v: Scalar
    """sin(t3), or 0."""
    margin: Scalar
    free: Scalar = False
    """Joint 3 is arbitrary."""
    rise: int = 0
    """1 where its equation rises there, -1 where it falls; 0 where that is not used."""


GradientNorm = Callable[[Scalar, Scalar], Scalar]
"""The norm of the gradient of a polynomial with respect to the wanted point, at (U, V)."""


def roots(chain: Chain, p: Poly, setting: Setting, span: Scalar | None = None) -> list[Third]:
    """Joint 3 from a polynomial of the first degree on the circle, or up to the second in a slide.

    Args:
        chain: The three links.
        p: The polynomial, in units of a length; or of a squared distance, if `span` is given.
        setting: Fallback and tolerances.
        span: The distance whose square is in the polynomial.
    """

    def distance(change: Scalar, sign: Scalar) -> Scalar:
        return change if span is None else distance_moved(span, change, sign)

    if chain.kinds[2] == "P":
        return _slide_roots(p, setting, lambda change, _: distance(change, -1))
    thirds = []
    # One harmonic on the circle: two roots, told apart by the sign of the derivative.
    for side in (1, -1):
        root = cosine_sine(p.u, p.v, times(-1.0, p.one), side, noise=setting.length_uncertainty)
        turn = setting.filled(2, root.free, root.sin, root.cos)
        margin = distance(root.margin, safe.sign(p.one))
        thirds.append(Third(turn, turn.cos, turn.sin, margin, root.free))
    return thirds


def distance_moved(span: Scalar, change: Scalar, sign: Scalar) -> Scalar:
    """How far a point moves outwards (sign 1) or inwards (-1) for a change of its squared distance."""
    # sqrt(span^2 + change) - span without cancellation.
    after = safe.sqrt(jnp.maximum(span * span + sign * change, 0))
    return safe.divide(change, span + after)


def _slide_roots(p: Poly, setting: Setting, length: Callable[[Scalar, Scalar], Scalar]) -> list[Third]:
    """Joint 3 as the roots of a polynomial in a slide: one or two.

    Args:
        p: The polynomial.
        setting: Tolerances.
        length: From a change of the polynomial, and the slide, to how far the point moves for it.
    """
    # Of the first degree by the arm's own numbers, which decides the number of slots.
    if isinstance(p.uu, float) and p.uu == 0:
        q = pin(safe.divide(times(-1.0, p.one), p.u))
        return [Third(Slide(q), q, 0.0, jnp.inf)]
    # The quadratic formula about the vertex.
    thirds = []
    per = safe.divide(1, p.uu)
    middle = -p.u * per / 2
    gap = middle * middle - p.one * per
    for side in (1, -1):
        q = pin(middle + safe.sign(p.uu) * side * agreed_root(gap))
        thirds.append(Third(Slide(q), q, 0.0, length(abs(p.uu) * gap, middle), rise=side))
    return thirds


def second_degree(chain: Chain, p: Poly, setting: Setting, gradient_norm: GradientNorm) -> list[Third]:
    """Joint 3 from a polynomial of the second degree: a quartic on the circle, a quadratic in a slide.

    Args:
        chain: The three links.
        p: The polynomial.
        setting: Tolerances.
        gradient_norm: Of the polynomial, with respect to the wanted point, at (U, V).
    """
    if chain.kinds[2] == "P":
        return _slide_roots(
            p, setting, lambda change, q: change / jnp.maximum(gradient_norm(q, 0.0), setting.zero_tolerance)
        )
    return circle_roots(chain, harmonics_of(p), setting, lambda sine, cosine: gradient_norm(cosine, sine))


def harmonics_of(p: Poly):
    """A polynomial in (cos, sin) as the harmonics of `core.roots`: cos^2 and sin^2 become cos(2t)."""
    return (
        (p.uu - p.vv) / 2,
        p.uv / 2,
        p.u / 2,
        p.v / 2,
        p.one + (p.uu + p.vv) / 2,
    )


def half_angle_harmonics(c: list[Scalar]):
    """A quartic in q = tan(t / 2), times cos(t / 2)^4, as harmonics.

    Args:
        c: Its coefficients, the constant first.
    """
    return (
        (c[0] - c[2] + c[4]) / 8,
        (c[1] - c[3]) / 8,
        (c[0] - c[4]) / 4,
        (c[1] + c[3]) / 8,
        (3 * c[0] + c[2] + 3 * c[4]) / 8,
    )


def circle_roots(
    chain: Chain, harmonics, setting: Setting, gradient_norm: Callable[[Scalar, Scalar], Scalar]
) -> list[Third]:
    """Joint 3 from a quartic on the circle.

    Args:
        chain: The three links.
        harmonics: The polynomial.
        setting: Tolerances.
        gradient_norm: From sine and cosine to the norm of its gradient with respect to the wanted point.
    """
    harmonics = tuple(jnp.asarray(c) for c in harmonics)
    # `circle_quartic` expects coefficients of size about one.
    scale = sum(abs(c) for c in harmonics)
    weight = safe.divide(1, scale)
    harmonics = tuple(agreed(c * weight) for c in harmonics)
    four = circle_quartic(harmonics)
    thirds = []

    def length(value: Scalar, sine: Scalar, cosine: Scalar) -> Scalar:
        return value / jnp.maximum(weight * gradient_norm(sine, cosine), setting.zero_tolerance)

    in_order = (four.rising[0], four.falling[0], four.rising[1], four.falling[1])
    for root, rise in zip(in_order, (1, -1, 1, -1), strict=True):
        sine, cosine = root.sin, root.cos
        margin = clearance(harmonics, four, root, length)
        if chain.kinds[2] == "P":
            # q = tan(t / 2), in the one of its two forms that does not cancel.
            q = jnp.where(cosine > 0, safe.divide(sine, 1 + cosine), safe.divide(1 - cosine, sine))
            thirds.append(Third(Slide(q), q, 0.0, margin, rise=rise))
            continue
        turn = setting.angle(sine, cosine)
        thirds.append(Third(turn, turn.cos, turn.sin, margin, rise=rise))
    return thirds


Length = Callable[[Scalar, Scalar, Scalar], Scalar]
"""From a value of a polynomial at a sine and a cosine to how far the goal must move to make it zero."""


def clearance(harmonics, four: CircleRoots, root: CircleRoot, length: Length) -> Scalar:
    """How far the goal is from where this root becomes a double root; see the margin in the header.

    Args:
        harmonics: The polynomial.
        four: All its roots.
        root: One of them.
        length: From a value of the polynomial to how far the goal must move to make it zero.
    """
    value, _ = harmonics_at(harmonics, root.sin, root.cos)
    outside = -length(abs(value), root.sin, root.cos)
    return jnp.where(root.real, _least_between(harmonics, four, root, length), outside)


def _least_between(harmonics, four: CircleRoots, root: CircleRoot, length: Length) -> Scalar:
    """The least absolute value of the polynomial midway to a real root of the other kind, as a length."""
    rises = any(root is r for r in four.rising)
    others, rise = (four.falling, 1) if rises else (four.rising, -1)
    least: Scalar = jnp.inf
    for other in others:
        cosine = root.cos * other.cos + root.sin * other.sin
        sine = root.cos * other.sin - root.sin * other.cos
        # Half the angle between the two roots.
        half_cos = safe.sqrt((1 + cosine) / 2)
        half_sin = safe.sign(sine) * safe.sqrt((1 - cosine) / 2)
        middle = (
            root.sin * half_cos + root.cos * half_sin,
            root.cos * half_cos - root.sin * half_sin,
        )
        # Between a root where it rises and the next one, where it falls, the sign of the polynomial is known.
        # Another sign means that other roots lie between: then this one is no neighbor.
        size = rise * safe.sign(sine) * harmonics_at(harmonics, *middle)[0]
        least = jnp.where(other.real & (size >= 0), jnp.minimum(least, length(size, *middle)), least)
    return jnp.minimum(least, 1)
