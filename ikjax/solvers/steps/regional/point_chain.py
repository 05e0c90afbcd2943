"""A point carried by three joints, as polynomials in the value of joint 3.

A part of `regional.three_joints`, whose frames and letters are used here.
"""

from typing import NamedTuple

from ikjax.arm.forward import Link, known_sincos
from ikjax.core.trig import Scalar
from ikjax.core.vector import Vector, plus, times


class Poly(NamedTuple):
    """one + u U + v V + uu U^2 + uv U V + vv V^2, with (U, V) = (cos t3, sin t3) or (q3, 0).

    Coefficients that are known to be zero are Python numbers, so that the operations below leave them out.
    """

    one: Scalar
    u: Scalar = 0.0
    v: Scalar = 0.0
    uu: Scalar = 0.0
    uv: Scalar = 0.0
    vv: Scalar = 0.0

    def plus(self, other: "Poly") -> "Poly":
        return Poly(*map(plus, self, other))

    def times(self, factor: Scalar) -> "Poly":
        return Poly(*(times(factor, c) for c in self))

    def less(self, other: "Poly") -> "Poly":
        return self.plus(other.times(-1.0))

    def square(self) -> "Poly":
        """The square of a polynomial of the first degree."""
        one, u, v = self[:3]
        return Poly(
            times(one, one),
            times(2.0, times(one, u)),
            times(2.0, times(one, v)),
            times(u, u),
            times(2.0, times(u, v)),
            times(v, v),
        )

    def at(self, u: Scalar, v: Scalar) -> Scalar:
        """The value at (U, V)."""
        low = plus(plus(self.one, times(self.u, u)), times(self.v, v))
        high = plus(times(times(self.uu, u), u), times(times(self.uv, u), v))
        return plus(plus(low, high), times(times(self.vv, v), v))

    def rate_at(self, u: Scalar, v: Scalar, turning: bool) -> Scalar:
        """The derivative with respect to joint 3."""
        if not turning:
            return plus(self.u, times(2.0, times(self.uu, u)))
        # dU = -V and dV = U
        low = plus(times(self.v, u), times(-1.0, times(self.u, v)))
        mixed = times(self.uv, u * u - v * v)
        return plus(plus(low, mixed), times(2.0, times(plus(self.vv, times(-1.0, self.uu)), u * v)))

    def at_half_angle(self, sine: Scalar, cosine: Scalar) -> Scalar:
        """The value at a slide of tan(t / 2), times cos(t / 2)^2, which is finite at t = pi."""
        return (self.one * (1 + cosine) + self.u * sine + self.uu * (1 - cosine)) / 2


class Chain(NamedTuple):
    """The point, seen along the three links, as polynomials in the value of joint 3."""

    kinds: str
    links: tuple[Link, ...]
    h: tuple[Poly, Poly, Poly]
    """The point seen from the link that joint 2 carries; without q2 where that slides."""
    h_squared: Poly
    """h1^2 + h2^2 + h3^2"""
    across_squared: Poly
    """h1^2 + h2^2"""


def chain_of(links: tuple[Link, ...], point: Vector) -> Chain:
    """The polynomials of an arm.

    Args:
        links: The first three.
        point: The point, given in frame 3.
    """
    _, two, three = links
    kinds = "".join(link.kind for link in links)
    # The point after link 3's own length, twist and offset, before joint 3 moves it.
    s, c = three.sin_alpha, three.cos_alpha
    along = plus(three.a, point[0])
    aside = plus(times(c, point[1]), times(-s, point[2]))
    above = plus(plus(three.d, times(s, point[1])), times(c, point[2]))
    # Joint 3 turns it about z, or slides it along z: f.
    if kinds[2] == "R":
        f1, f2, f3 = Poly(0.0, along, times(-1.0, aside)), Poly(0.0, aside, along), Poly(above)
    else:
        sine, cosine = known_sincos(three.theta)
        f1 = Poly(plus(times(cosine, along), times(-sine, aside)))
        f2 = Poly(plus(times(sine, along), times(cosine, aside)))
        f3 = Poly(above, 1.0)
    # Link 2's own length, twist and offset: h.
    s, c = two.sin_alpha, two.cos_alpha
    h1 = f1.plus(Poly(two.a))
    h2 = f2.times(c).less(f3.times(s))
    h3 = f2.times(s).plus(f3.times(c)).plus(Poly(two.d))
    if kinds[2] == "R":
        # |h|^2 = |f|^2 + a2^2 + d2^2 and terms of the first degree: joint 3 turns f and leaves |f| as it is.
        size = plus(plus(times(along, along), times(aside, aside)), times(above, above))
        size = plus(plus(size, times(two.a, two.a)), times(two.d, two.d))
        cross = f1.times(times(2.0, two.a)).plus(f2.times(s).plus(f3.times(c)).times(times(2.0, two.d)))
        h_squared = cross.plus(Poly(size))
        across_squared = h_squared.less(h3.square())
    else:
        across_squared = h1.square().plus(h2.square())
        h_squared = across_squared.plus(h3.square())
    return Chain(kinds, links, (h1, h2, h3), h_squared, across_squared)
