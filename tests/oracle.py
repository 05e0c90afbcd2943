"""Forward kinematics at 60 digits, straight from the DH leaves and nothing of ikjax's own."""

import mpmath
import numpy as np

mp = mpmath.mp.clone()
mp.dps = 60


def exact(array) -> mpmath.matrix:
    """The very numbers of a float array; what is exact already stays so."""
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


def slopes(arm, q) -> list[mpmath.matrix]:
    """How T_world_tool changes with each joint, by central differences, right to 30 digits and more."""
    step, q = mp.mpf("1e-20"), exact(q)

    def moved(i, by):
        return fk(arm, q + by * exact(np.eye(len(q))[i]))

    return [(moved(i, step) - moved(i, -step)) / (2 * step) for i in range(len(q))]


def error(arm, q, goal) -> tuple[float, float]:
    """How far the tool at q is from a goal: [m] and [rad]."""
    gap = fk(arm, q) - exact(goal)
    chord = mp.mnorm(gap[:3, :3], "f") / mp.sqrt(8)  # sin(angle / 2)
    return float(mp.norm(gap[:3, 3])), float(2 * mp.asin(min(chord, 1)))
