"""The check of every answer, ours and the rivals': forward kinematics in numpy, from the DH table.

It is independent of ikjax's own forward kinematics, computes in float64 whatever the solver's type, and is
the same for all solvers. Each goal falls into one of four classes (OpenRAVE's words):
    wrong     some answer that was given as valid does not reach the goal
    none      no answer
    missing   the joints that made the goal are not among the answers
    success   everything else
"""

import dataclasses

import numpy as np

CHUNK = 8192
"""Goals that are checked at a time, so that the arrays stay in the cache."""

SLACK = 1.01
"""Factor on the tolerance: an answer that the solver accepted at its edge is not wrong by our rounding."""


def table(arm) -> dict[str, np.ndarray]:
    """The arm as float64 numbers; the arm is one built in float64."""
    names = ("a", "alpha", "d", "theta", "base", "tool")
    return {name: np.asarray(getattr(arm, name), np.float64) for name in names}


def is_plain(arm) -> bool:
    """Whether base and tool are the identity and the joints count from the DH zero."""
    dh = table(arm)
    return not dh["theta"].any() and all((dh[name] == np.eye(4)).all() for name in ("base", "tool"))


def reach(arm) -> float:
    """Sum of the lengths in the table and the tool [m]."""
    dh = table(arm)
    return float(sum(np.abs(x).sum() for x in (dh["a"], dh["d"], dh["tool"][:3, 3])))


def frames(arm, q: np.ndarray) -> list[np.ndarray]:
    """T_world_i for i = 0 ... n and then the tool, each (..., 4, 4), of joints q (..., n)."""
    dh = table(arm)
    found = [np.broadcast_to(dh["base"], (*q.shape[:-1], 4, 4))]
    for i in range(q.shape[-1]):
        angle = q[..., i] + dh["theta"][i]
        s, c = np.sin(angle), np.cos(angle)
        sa, ca = np.sin(dh["alpha"][i]), np.cos(dh["alpha"][i])
        link = np.zeros((*angle.shape, 4, 4))
        link[..., 0, 0], link[..., 0, 1], link[..., 0, 2] = c, -s * ca, s * sa
        link[..., 1, 0], link[..., 1, 1], link[..., 1, 2] = s, c * ca, -c * sa
        link[..., 2, 1], link[..., 2, 2] = sa, ca
        link[..., 0, 3], link[..., 1, 3], link[..., 2, 3] = dh["a"][i] * c, dh["a"][i] * s, dh["d"][i]
        link[..., 3, 3] = 1
        found.append(found[-1] @ link)
    return [*found, found[-1] @ dh["tool"]]


def fk(arm, q: np.ndarray) -> np.ndarray:
    """Poses (N, 4, 4) of joints (N, n), a chunk at a time."""
    return np.concatenate([frames(arm, q[i : i + CHUNK])[-1] for i in range(0, len(q), CHUNK)])


def random_goals(arm, count: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Joints (count, n), even on (-pi, pi), and the poses they make."""
    q = np.random.default_rng(seed).uniform(-np.pi, np.pi, (count, arm.n))
    return q, fk(arm, q)


@dataclasses.dataclass(frozen=True)
class Tally:
    """Goals of each class, and the worst errors of all answers."""

    success: int
    wrong: int
    none: int
    missing: int
    answers: int
    position_error: float
    """[m]"""
    rotation_error: float
    """[rad]"""


def tally_answers(arm, goals, made_by, answers, given, tolerance: float) -> Tally:
    """Check every answer against its goal, and the joints that made the goal against the answers.

    Args:
        arm: The arm, in float64; all its joints turn.
        goals: (N, 4, 4) in the type in which the solver got them.
        made_by: (N, n) joints that made them; None if unknown, and then no goal counts as missing.
        answers: (N, S, n).
        given: (N, S) bool, which slots are answers.
        tolerance: Of a pose: [rad], and as a share of (reach + |p|).
    """
    size = reach(arm)
    counts, worst = np.zeros(5, int), np.zeros(2)
    for i in range(0, len(goals), CHUNK):
        at = slice(i, i + CHUNK)
        goal = np.asarray(goals[at], np.float64)
        mask = np.asarray(given[at])
        row, slot = np.nonzero(mask)
        q = np.asarray(answers[at], np.float64)
        gap, turn = _errors(frames(arm, q[row, slot])[-1], goal[row])
        allowed = SLACK * tolerance * (size + np.linalg.norm(goal[row, :3, 3], axis=-1))
        good = (gap <= allowed) & (turn <= SLACK * tolerance)  # NaN is not good
        wrong = np.bincount(row[~good], minlength=len(goal)) > 0
        none = ~mask.any(1)
        missing = np.zeros(len(goal), bool)
        if made_by is not None:
            missing = ~_recovered(arm, made_by[at], q, mask, tolerance) & ~none & ~wrong
        success = ~(wrong | none | missing)
        counts += [int(kind.sum()) for kind in (success, wrong, none, missing, mask)]
        if len(row):
            worst = np.fmax(worst, [np.max(gap), np.max(turn)])
    return Tally(*map(int, counts), *map(float, worst))


def _errors(reached: np.ndarray, goal: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Distance and angle; the angle from the Frobenius norm, which is sqrt(8) sin(angle / 2)."""
    gap = np.linalg.norm(reached[:, :3, 3] - goal[:, :3, 3], axis=-1)
    slip = np.linalg.norm(reached[:, :3, :3] - goal[:, :3, :3], axis=(1, 2))
    return gap, 2 * np.arcsin(np.minimum(slip / np.sqrt(8), 1))


def _recovered(arm, made_by, q, mask, tolerance) -> np.ndarray:
    """Whether some answer is the joints that made the goal, within the tolerance.

    Joints that differ by less than tolerance / sigma_min move the tool by less than the tolerance,
    to first order: near a singularity no solver can do better, and sigma_min is large elsewhere.
    """
    gap = np.abs((q - made_by[:, None] + np.pi) % (2 * np.pi) - np.pi).max(-1)
    nearest = np.where(mask, gap, np.inf).min(1)
    found = nearest <= tolerance
    doubtful = np.flatnonzero(~found & np.isfinite(nearest))
    sigma = np.linalg.svd(_jacobian(arm, made_by[doubtful]), compute_uv=False)[:, -1]
    found[doubtful] = nearest[doubtful] * sigma <= 2 * tolerance
    return found


def _jacobian(arm, q: np.ndarray) -> np.ndarray:
    """Geometric Jacobian (N, 6, n), its linear rows in units of the reach."""
    *links, tool = frames(arm, q)
    axes = np.stack([T[:, :3, 2] for T in links[:-1]], axis=-1)
    levers = np.stack([tool[:, :3, 3] - T[:, :3, 3] for T in links[:-1]], axis=-1)
    return np.concatenate([np.cross(axes, levers, axis=1) / reach(arm), axes], axis=1)
