"""Every real answer of an arm to a goal, at 50 digits: shares nothing with ikjax but the DH table.

The arm is C0 J1 C1 J2 ... Jn Cn: rigid constants, and between them joints that turn about or slide along z.
A turn is stored as exp(i q), a slide as its length. G is the goal without C0 and Cn: J1 C1 ... Jn.

Upper bound: all joints but one are eliminated, and the condition F that is left is a polynomial of known
degree in that joint (in its cos and sin, where it turns). F is only ever evaluated: its coefficients come
from samples, one sample more than they need confirms the degree, and `mpmath.polyroots` gives all roots.
A real root fixes the other joints, or leaves one of degree 1 in cos and sin: two answers.
Lower bound: whoever counts an answer puts it into forward kinematics.

Source: Pieper, The kinematics of manipulators under computer control (1968); the elimination is ours.
"""

import functools
import inspect
import itertools

import mpmath
import numpy as np

mp = mpmath.mp.clone()
mp.dps = 50

REAL, NOT_REAL = 1e-30, 1e-12
"""How far a root may be from the unit circle, or the real line, to be on it; and must be, to be off it."""
APART = 1e-6
"""Roots closer than this are too near a fold."""
ORIGIN = np.array([0, 0, 0, 1], object)


class NearFoldError(Exception):
    """It is not certain which roots are real."""


def inverse(T) -> np.ndarray:
    back = T.copy()
    back[:3, :3] = T[:3, :3].T
    back[:3, 3] = -(back[:3, :3] @ T[:3, 3])
    return back


def J(x, kind="R") -> np.ndarray:
    """The motion of a joint at a value."""
    T = np.eye(4, dtype=int).astype(object)
    if kind == "R":
        T[:2, :2] = [[x.real, -x.imag], [x.imag, x.real]]
    else:
        T[2, 3] = x
    return T


def moved(kinds, C, joints) -> np.ndarray:
    """J1 C1 J2 C2 ..., as far as they go."""
    T = J(mp.mpc(1))
    for kind, part, x in zip(kinds, C, joints, strict=False):
        T = T @ J(x, kind) @ part
    return T


def rho_squared(v):
    """Squared distance from the z axis."""
    return v[0] * v[0] + v[1] * v[1]


def between(u, v):
    """The turn about z that takes u to the direction of v."""
    z = mp.mpc(v[0], v[1]) * mp.mpc(u[0], -u[1])
    if abs(z) < APART**2:
        raise NearFoldError
    return z / abs(z)


@functools.cache
def nodes(kind, degree) -> tuple:
    """Where a polynomial is sampled, and what turns samples into coefficients, highest first."""
    count = 2 * degree + 1
    points = [mp.expjpi(mp.mpf(2 * k) / count) if kind == "R" else mp.mpf(k - degree) for k in range(count)]
    powers = mp.matrix([[x ** (count - 1 - m) for m in range(count)] for x in points])
    return points, np.array((powers**-1).tolist(), object)


# From mpmath 1.4 on the other order is deprecated; before, it is the only one.
LOWEST_FIRST = {"asc": True} if "asc" in inspect.signature(mp.polyroots).parameters else {}


def roots(kind, F, degree) -> list:
    """The real zeros of F: of that degree in cos and sin of a turn, of twice that degree in a slide."""

    def polynomial(x):
        return F(x) * (x**degree if kind == "R" else 1)

    points, weights = nodes(kind, degree)
    samples = np.array([polynomial(x) for x in points], object)
    coefficients = list(weights @ samples)
    witness = mp.expjpi(mp.mpf(1) / 7) if kind == "R" else mp.mpf(1) / 3
    value = sum(c * witness**k for k, c in enumerate(reversed(coefficients)))
    missed = abs(value - polynomial(witness))
    assert missed < 1e-40 * (1 + max(map(abs, samples))), "F is of a higher degree"
    start = [mp.mpc(complex(x)) for x in np.roots([complex(c) for c in coefficients])]
    # Corrections below 1e-50 of roots 1e-6 apart: each approximation is the one root of its own disc.
    ordered = coefficients[::-1] if LOWEST_FIRST else coefficients
    found = mp.polyroots(ordered, **LOWEST_FIRST, maxsteps=40, extraprec=120, cleanup=False, roots_init=start)
    off = [abs(abs(x) - 1) if kind == "R" else abs(mp.im(x)) for x in found]
    near = min(abs(x - y) for x, y in itertools.combinations(found, 2))
    if near < APART or any(REAL <= gap <= NOT_REAL for gap in off):
        raise NearFoldError
    return [x if kind == "R" else mp.re(x) for x, gap in zip(found, off, strict=True) if gap < REAL]


def on_circle(kind, M, right, radius_squared) -> list:
    """All (s, (x, y)) with M (x, y) = right(s) and x^2 + y^2 = radius_squared(s).

    Where M is singular one combination of its rows has s alone, and leaves a line to meet the circle.
    """
    det = M[0, 0] * M[1, 1] - M[0, 1] * M[1, 0]
    if abs(det) > REAL:
        adjugate = np.array([[M[1, 1], -M[0, 1]], [-M[1, 0], M[0, 0]]], object)
        found = roots(kind, lambda s: rho_squared(adjugate @ right(s)) - det**2 * radius_squared(s), 2)
        return [(s, adjugate @ right(s) / det) for s in found]
    column = max((0, 1), key=lambda k: rho_squared(M[:, k]))
    row = max((0, 1), key=lambda k: rho_squared(M[k]))
    pairs = []
    for s in roots(kind, lambda s: right(s) @ (M[1, column], -M[0, column]), 1):
        line, wanted = M[row] * mp.sqrt(radius_squared(s)), right(s)[row]
        for z in roots("R", lambda z, m=line, w=wanted: m @ (z.real, z.imag) - w, 1):
            pairs.append((s, mp.sqrt(radius_squared(s)) * np.array([z.real, z.imag], object)))
    return pairs


def regional(kinds, C, p, W) -> list:
    """The first three joints that bring p, which C3 carries, to W."""
    tip = C[3] @ p

    def h(s):
        return C[2] @ (J(s, kinds[2]) @ tip)

    def slide(s):
        return (W[2] - C[1][2] @ h(s)) / C[1][2, 2]

    # Joint 2 moves h to g and keeps |g| and z; what joint 1 does not change is then linear in x and y of g.
    def unchanged(v, g):
        return np.array([v @ v - g @ g, v[2]] if kinds[0] == "R" else v[:2], object)

    def right(s):
        level = h(s) * (0, 0, 1, 1)
        return unchanged(W, h(s)) - unchanged(C[1] @ level, level)

    if kinds[:2] == "RP":
        found = roots(kinds[2], lambda s: rho_squared(C[1] @ (J(slide(s), "P") @ h(s))) - rho_squared(W), 2)
        pairs = [(slide(s), s) for s in found]
    else:
        units = np.array([[0, 0, 0, 1], [1, 0, 0, 1], [0, 1, 0, 1]], object)
        origin, x, y = (unchanged(C[1] @ g, g) for g in units)
        M = np.array([x - origin, y - origin], object).T
        pairs = [(between(h(s), g), s) for s, g in on_circle(kinds[2], M, right, lambda s: rho_squared(h(s)))]
    ways = []
    for second, s in pairs:
        v = C[1] @ (J(second, kinds[1]) @ h(s))
        ways.append((between(v, W) if kinds[0] == "R" else W[2] - v[2], second, s))
    return ways


def pieper(kinds, C, G) -> list:
    """Axes 4, 5 and 6 meet."""
    o, along = C[4][:3, 3], C[4][:3, 2]
    center = np.array([0, 0, o[2] - along[2] * (o[:2] @ along[:2]) / rho_squared(along), 1], object)
    last = inverse(C[5]) @ (inverse(C[4]) @ center)
    assert rho_squared(last) < REAL**2, "the axes do not meet"
    ways = []
    for joints in regional(kinds, C, center, G @ last):
        T = inverse(moved(kinds, C[1:4], joints)) @ G
        for five in roots("R", lambda z, T=T: (C[4][2] @ J(z) @ C[5])[2] - T[2, 2], 1):
            four = between((C[4] @ J(five) @ C[5])[:, 2], T[:, 2])
            six = inverse(J(four) @ C[4] @ J(five) @ C[5]) @ T
            ways.append((*joints, four, five, mp.mpc(six[0, 0], six[1, 0])))
    return ways


def planar(kinds, C, G) -> list:
    """Two or three joints in a plane that the turns are square to; the last one turns."""
    tip = C[2] @ ORIGIN
    W = G @ (tip if len(kinds) == 2 else ORIGIN)
    if kinds[0] == "P":
        found = roots("P", lambda s: rho_squared(inverse(J(s, "P") @ C[1]) @ W) - rho_squared(tip), 1)
        ways = [(s, between(tip, inverse(J(s, "P") @ C[1]) @ W)) for s in found]
    else:
        found = roots(kinds[1], lambda s: rho_squared(C[1] @ (J(s, kinds[1]) @ tip)) - rho_squared(W), 1)
        ways = [(between(C[1] @ (J(s, kinds[1]) @ tip), W), s) for s in found]
    if len(kinds) == 2:
        return ways
    rest = [inverse(moved(kinds, C[1:3], way)) @ G for way in ways]
    return [(*way, mp.mpc(T[0, 0], T[1, 0])) for way, T in zip(ways, rest, strict=True)]


def three_turns(left, A, right, B) -> list:
    """All (x, y, z) with left J(x) A = right J(y) B J(z), for rows of poses."""

    def U(x):
        return left @ J(x) @ A

    # J(z) does not change the last two entries of a row, which are linear in cos and sin of y.
    constant, *parts = ((right @ J(mp.mpc(*y)) @ B)[2:] for y in ((0, 0), (1, 0), (0, 1)))
    M = np.array([part - constant for part in parts], object).T
    found = on_circle("R", M, lambda x: U(x)[2:] - constant, lambda x: 1)
    return [(x, mp.mpc(*y), between(U(x), right @ J(mp.mpc(*y)) @ B)) for x, y in found]


def parallel(place, kinds, C, G) -> list:
    """Three axes are parallel, from the place-th on: the third row of their product is known."""
    if place in (1, 3):
        return mirrored(lambda *arm: parallel(5 - place, *arm), kinds, C, G)
    ways = []
    if place == 2:
        found = three_turns(inverse(C[1])[2], G, (C[2] @ C[3] @ C[4])[2], C[5])
        for back, five, six in found:
            one = mp.conj(back)
            B = inverse(J(one) @ C[1]) @ G @ inverse(C[4] @ J(five) @ C[5] @ J(six))
            ways += [(one, *middle, five, six) for middle in planar("RRR", C[1:], B)]
    else:
        found = three_turns((C[4] @ C[5])[2] @ inverse(G), C[1], inverse(C[3])[2], inverse(C[2]))
        for one, *back in found:
            first = (one, mp.conj(back[1]), mp.conj(back[0]))
            B = inverse(moved(kinds, C[1:4], first)) @ G
            ways += [(*first, *rest) for rest in planar("RRR", C[3:], B)]
    return ways


def mirrored(solve, kinds, C, G) -> list:
    """The same arm read from the tool to the base."""
    found = solve(kinds[::-1], [inverse(part) for part in C[::-1]], inverse(G))
    back = {"R": mp.conj, "P": lambda x: -x}
    return [tuple(back[k](x) for k, x in zip(kinds, way[::-1], strict=True)) for way in found]


def scara(kinds, C, G) -> list:
    """J1 C1 J2 C2 P3 C3 J4: the slide gives the height."""
    slide = (G[2, 3] - (C[1] @ C[2] @ C[3])[2, 3]) / (C[1] @ C[2])[2, 2]
    closed = [C[0], C[1], C[2] @ J(slide, "P") @ C[3]]
    return [(one, two, slide, four) for one, two, four in planar("RRR", closed, G)]


def turret(kinds, C, G) -> list:
    """Joint 1 turns the direction that axes 2, 3 and 4 share to the goal's."""
    one = between((C[1] @ C[2] @ C[3])[:, 2], G[:, 2])
    return [(one, *rest) for rest in planar("RRR", C[1:], inverse(J(one) @ C[1]) @ G)]


def five_axis(kinds, C, G) -> list:
    """Joint 1 has two conditions: the part of the third row of J2 to J5 that joint 5 does not change."""
    left, right = inverse(C[1])[2], (C[2] @ C[3] @ C[4])[2]

    def off(z):
        return (left @ J(mp.conj(z)) @ G - right)[2:]

    constant, *parts = (off(mp.mpc(*z)) for z in ((0, 0), (1, 0), (0, 1)))
    sizes = [sum(abs(part[k] - constant[k]) ** 2 for part in parts) for k in (0, 1)]
    k = 0 if sizes[0] > sizes[1] else 1
    ways = []
    for one in roots("R", lambda z: off(z)[k], 1):
        gap = abs(off(one)[1 - k])
        if REAL <= gap <= NOT_REAL:
            raise NearFoldError
        if gap < REAL:
            five = between(left @ J(mp.conj(one)) @ G, right)
            B = inverse(J(one) @ C[1]) @ G @ inverse(C[4] @ J(five))
            ways += [(one, *middle, five) for middle in planar("RRR", C[1:], B)]
    return ways


def answers(arm, C, goal) -> list[tuple]:
    """Every real answer, joint by joint; NearFoldError where their number is not certain."""
    G = inverse(C[0]) @ goal @ inverse(C[-1])
    if arm.family == "position":
        return regional(arm.kinds, C, ORIGIN, G @ C[3] @ ORIGIN)
    if arm.family in ("three_parallel", "parallel_axes"):
        straight = [abs(np.sin(float(alpha))) < 1e-12 for alpha in arm.alpha]
        place = next(i for i in range(4) if straight[i] and straight[i + 1]) + 1
        return parallel(place, arm.kinds, C, G)
    if arm.family == "pieper_reversed":
        return mirrored(pieper, arm.kinds, C, G)
    families = {"planar_pose": planar, "planar_position": planar, "scara": scara, "turret": turret}
    families |= {"five_axis": five_axis}
    return families.get(arm.family, pieper)(arm.kinds, C, G)
