"""Forward kinematics at 60 digits, from the DH leaves only, independent of ikjax's own."""

import math

import mpmath
import numpy as np

mp = mpmath.mp.clone()
mp.dps = 60


def exact(array) -> mpmath.matrix:
    """The exact numbers of a float array; an exact matrix is returned as it is."""
    return mp.matrix(array.tolist() if isinstance(array, mp.matrix) else np.asarray(array, float).tolist())


def floats(matrix) -> np.ndarray:
    return np.array(matrix.tolist(), float)


def link(theta, d, a, alpha) -> mpmath.matrix:
    """Spong, Robot Modeling and Control, equation (3.10)."""
    (c, s), (ca, sa) = ((mp.cos(x), mp.sin(x)) for x in (theta, alpha))
    return mp.matrix([[c, -s * ca, s * sa, a * c], [s, c * ca, -c * sa, a * s], [0, sa, ca, d], [0, 0, 0, 1]])


def frames(arm, q) -> list[mpmath.matrix]:
    """T_world_i for the base and every link."""
    a, alpha, d, theta, q = (exact(leaf) for leaf in (arm.a, arm.alpha, arm.d, arm.theta, q))
    chain = [exact(arm.base)]
    for i, kind in enumerate(arm.kinds):
        turn, slide = (q[i], 0) if kind == "R" else (0, q[i])
        chain.append(chain[-1] * link(theta[i] + turn, d[i] + slide, a[i], alpha[i]))
    return chain


def fk(arm, q) -> mpmath.matrix:
    """T_world_tool."""
    return frames(arm, q)[-1] * exact(arm.tool)


def derivatives(arm, q) -> list[mpmath.matrix]:
    """Derivative of T_world_tool in each joint, by central differences, with 30 digits or more."""
    step, q = mp.mpf("1e-20"), exact(q)

    def moved(i, by):
        return fk(arm, q + by * exact(np.eye(len(q))[i]))

    return [(moved(i, step) - moved(i, -step)) / (2 * step) for i in range(len(q))]


def error(arm, q, goal) -> tuple[float, float]:
    """Error of the tool at q from a goal: [m] and [rad]."""
    gap = fk(arm, q) - exact(goal)
    chord = mp.mnorm(gap[:3, :3], "f") / mp.sqrt(8)  # sin(angle / 2)
    return float(mp.norm(gap[:3, 3])), float(2 * mp.asin(min(chord, 1)))


def turn(axis, angle):
    """The motion (4, 4) by an angle [rad] about an axis through the origin: Rodrigues' formula."""
    x, y, z = axis
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    T = np.eye(4)
    T[:3, :3] += math.sin(angle) * cross + (1 - math.cos(angle)) * cross @ cross
    return T
