"""Proof on the user's own arm: goals made by its joints, solved, and judged by forward kinematics.

The four rates are those of OpenRAVE's `--iktests`: success, wrong, none, missing.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ikjax.arm.arm import Arm
from ikjax.arm.forward import fk, frames, reach
from ikjax.arm.twists import jacobian
from ikjax.core.tolerances import FOUND_AGAIN, REGULAR, VALID
from ikjax.ik.multistart import ranges
from ikjax.ik.solve import check_family, solve

BATCH = 20_000


class VerifyReport(NamedTuple):
    """How many goals, and what became of them."""

    arm: str
    family: str
    dtype: str
    goals: int
    success: int
    """Answered, every valid slot right, and the joints that made the goal among them where asked."""
    wrong: int
    """A valid slot that does not reach its goal."""
    none: int
    """Reachable, and no valid slot."""
    missing: int
    """Answered and right, but without the joints that made the goal, which is regular there."""
    singular: int
    """Goals more, made by joints at right angles and near them; wrong and none count these too."""
    worst: float
    """Greatest position error of a valid slot, as a share of reach + |p|."""


def verify(arm: Arm, count: int = 100_000, *, dtype=None, seed: int = 0) -> VerifyReport:
    """The four rates of an arm.

    Args:
        arm: An arm with a family.
        count: Random goals; a tenth as many again are made by joints at right angles, exactly and off by
            1e-1 to 1e-16.
        dtype: float32 or float64; by default JAX's own.
        seed: Of the random joints.

    Raises:
        ValueError: An arm of no family, or fewer goals than one.
    """
    check_family(arm)
    if count < 1:
        raise ValueError(f"count must be 1 or more, got {count}")
    dtype = np.dtype(jnp.result_type(float) if dtype is None else dtype)
    arm = arm.astype(dtype)
    rng = np.random.default_rng(seed)
    tally = np.zeros(4, int)
    worst, singular = 0.0, max(count // 10, 1)
    for size, near in _parts(count, singular):
        q = _joints(arm, size, rng)
        q = _at_right_angles(arm, q, rng) if near else q
        wrong, none, missing, off = _judged(arm, q, dtype)
        missing = missing & (not near)
        tally += wrong.sum(), none.sum(), missing.sum(), 0 if near else (~(wrong | none | missing)).sum()
        worst = max(worst, off)
    wrong, none, missing, success = map(int, tally)
    return VerifyReport(
        arm.name, str(arm.family), dtype.name, count, success, wrong, none, missing, singular, worst
    )


def _parts(count: int, singular: int):
    for total, near in ((count, False), (singular, True)):
        for start in range(0, total, BATCH):
            yield min(BATCH, total - start), near


def _joints(arm: Arm, size: int, rng) -> np.ndarray:
    """Joint values within the limits."""
    low, high = (np.asarray(end, float) for end in ranges(arm))
    return rng.uniform(low, high, (size, arm.n))


def _at_right_angles(arm: Arm, q: np.ndarray, rng) -> np.ndarray:
    """Some turning joints on a multiple of a right angle of their DH angle, or beside it."""
    steps = 10.0 ** -rng.integers(1, 17, q.shape) * rng.choice([-1, 0, 1], q.shape)
    square = rng.integers(-1, 3, q.shape) * np.pi / 2 - np.asarray(arm.theta, float) + steps
    chosen = (rng.random(q.shape) < 0.6) & np.array([kind == "R" for kind in arm.kinds])
    return np.where(chosen, square, q)


def _judged(arm: Arm, q: np.ndarray, dtype):
    goals = np.asarray(fk(arm, q), float)
    sol = jax.tree.map(np.asarray, solve(arm, jnp.asarray(goals, dtype)))
    gap, turn, rows = _task(arm, np.asarray(fk(arm, sol.q), float), goals[:, None])
    size = float(reach(arm.baked()))
    scale = size + np.linalg.norm(goals[:, :3, 3], axis=-1)[:, None]
    # Joints are rounded on their way out, and forward kinematics on its way here.
    eps = float(np.finfo(dtype).eps)
    rounding = eps * (60 + 8 * np.abs(sol.q).max(-1) / size * np.array("P" in arm.kinds))
    allowed = VALID[dtype.name] + rounding
    wrong = sol.valid & ((gap > allowed * scale) | (turn > allowed))
    motions = np.array(jacobian(arm, q), float)
    motions[:, :3] /= size
    motions[:, :, [kind == "P" for kind in arm.kinds]] *= size
    least = np.linalg.svd(rows @ motions, compute_uv=False)[..., -1]
    turning = np.array([kind == "R" for kind in arm.kinds])
    off = sol.q - q[:, None]
    off = np.abs(off if arm.coupling is None else off @ np.asarray(arm.coupling, float).T)
    off = np.where(turning, np.abs((off + np.pi) % (2 * np.pi) - np.pi), off / size).max(-1)
    near = np.where(sol.valid, off, np.inf).min(-1)
    regular = least > REGULAR[dtype.name]
    none = ~sol.valid.any(-1)
    missing = regular & ~none & (near > FOUND_AGAIN[dtype.name] / np.maximum(least, 1e-300) + 1e3 * eps)
    worst = (gap / scale)[sol.valid].max(initial=0.0)
    return wrong.any(-1), none, missing & ~wrong.any(-1), float(worst)


def _task(arm: Arm, found: np.ndarray, goals: np.ndarray):
    """Position and rotation errors within the arm's task, and the rows of a twist that it controls."""
    gap, turn = found[..., :3, 3] - goals[..., :3, 3], np.zeros(found.shape[:-2])
    change = goals[..., :3, :3] @ np.swapaxes(found[..., :3, :3], -1, -2)
    axial = np.stack([change[..., i, j] - change[..., j, i] for i, j in ((2, 1), (0, 2), (1, 0))], -1)
    trace = np.einsum("...ii->...", change)
    if arm.task == "pose":
        return np.linalg.norm(gap, axis=-1), np.arctan2(np.linalg.norm(axial, axis=-1), trace - 1), np.eye(6)
    if arm.task == "position":
        return np.linalg.norm(gap, axis=-1), turn, np.eye(6)[:3]
    along = np.asarray(frames(arm, np.zeros(arm.n)), float)[:-1, :3, 2]
    up = along[arm.kinds.index("R")] if "R" in arm.kinds else np.cross(along[0], along[1])
    up = up / np.linalg.norm(up)
    x = np.cross(up, np.eye(3)[np.argmin(np.abs(up))])
    rows = np.zeros((3, 6))
    rows[0, :3], rows[1, :3], rows[2, 3:] = x / np.linalg.norm(x), np.cross(up, x / np.linalg.norm(x)), up
    gap = np.linalg.norm(gap - (gap @ up)[..., None] * up, axis=-1)
    if arm.task == "planar_position":
        return gap, turn, rows[:2]
    return gap, np.abs(np.arctan2(axial @ up, trace - np.einsum("i,...ij,j->...", up, change, up))), rows
