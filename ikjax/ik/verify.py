"""`verify`: test a closed form on the user's own arm, by goals made of its joints and forward kinematics.

The four rates are those of OpenRAVE's `--iktests`: success, wrong, none, missing.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import DTypeLike

from ikjax.arm.arm import Arm
from ikjax.arm.forward import fk, frames, reach
from ikjax.arm.twists import jacobian
from ikjax.core.tolerances import FOUND_AGAIN, REGULAR, VALID
from ikjax.ik.multistart import sampling_ranges
from ikjax.ik.solve import check_family, solve

BATCH = 20_000
"""Goals that are solved at a time."""


class VerifyReport(NamedTuple):
    """Counts of goals, by what `solve` answered."""

    arm: str
    family: str
    dtype: str
    goals: int
    success: int
    """Goals with a valid slot, every one of them right, and the joints that made the goal among them (asked
    of regular configurations only)."""
    wrong: int
    """Goals with a valid slot that does not reach its goal."""
    none: int
    """Goals without a valid slot, though reachable."""
    missing: int
    """Goals answered and right, but without the joints that made the goal, at a regular configuration."""
    singular: int
    """Further goals, made by joints at right angles and near them; wrong and none count these too."""
    worst: float
    """Greatest position error of a valid slot, as a share of reach + |p|."""

    def __str__(self) -> str:
        return (
            f"{self.arm} ({self.family}, {self.dtype}): {self.goals:,} goals, {self.singular:,} more at "
            f"right angles: wrong {self.wrong:,}, none {self.none:,}, missing {self.missing:,}; "
            f"worst error {self.worst:.1g}"
        )


def verify(arm: Arm, count: int = 100_000, *, dtype: DTypeLike | None = None, seed: int = 0) -> VerifyReport:
    """Solve goals made of random joints, and count right, wrong and missing answers.

    Args:
        arm: An arm with a family.
        count: Number of random goals. A tenth as many again are made by joints at right angles, exactly and
            off by 1e-1 to 1e-16 rad.
        dtype: float32 or float64; by default JAX's own.
        seed: Of the random joints.

    Returns:
        The counts.

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
    for size, is_singular in _batches(count, singular):
        q = _random_joints(arm, size, rng)
        q = _at_right_angles(arm, q, rng) if is_singular else q
        wrong, none, missing, error = _judge(arm, q, dtype)
        missing = missing & (not is_singular)
        right = ~(wrong | none | missing) & (not is_singular)
        tally += wrong.sum(), none.sum(), missing.sum(), right.sum()
        worst = max(worst, error)
    wrongs, nones, missings, successes = map(int, tally)
    return VerifyReport(
        arm.name, str(arm.family), dtype.name, count, successes, wrongs, nones, missings, singular, worst
    )


def _batches(count: int, singular: int):
    """Sizes of the batches, and whether a batch is of joints near right angles."""
    for total, is_singular in ((count, False), (singular, True)):
        for start in range(0, total, BATCH):
            yield min(BATCH, total - start), is_singular


def _random_joints(arm: Arm, size: int, rng) -> np.ndarray:
    """Joint values within the limits, (size, n)."""
    low, high = (np.asarray(end, float) for end in sampling_ranges(arm))
    return rng.uniform(low, high, (size, arm.n))


def _at_right_angles(arm: Arm, q: np.ndarray, rng) -> np.ndarray:
    """q (N, n) with some turning joints moved to where their DH angle is near a multiple of a right angle."""
    steps = 10.0 ** -rng.integers(1, 17, q.shape) * rng.choice([-1, 0, 1], q.shape)
    square = rng.integers(-1, 3, q.shape) * np.pi / 2 - np.asarray(arm.theta, float) + steps
    chosen = (rng.random(q.shape) < 0.6) & np.array([kind == "R" for kind in arm.kinds])
    return np.where(chosen, square, q)


def _judge(arm: Arm, q: np.ndarray, dtype) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
    """Which goals of joints q (N, n) are wrong, unanswered and missing, each (N,); the worst error."""
    goals = np.asarray(fk(arm, q), float)
    free = q[:, arm.locked] if len(arm.locked) > 1 else q[:, arm.locked[0]] if arm.locked else None
    sol = jax.tree.map(np.asarray, solve(arm, jnp.asarray(goals, dtype), redundancy=free))
    distance, angle, rows = _task_errors(arm, np.asarray(fk(arm, sol.q), float), goals[:, None])
    size = float(reach(arm.baked()))
    scale = size + np.linalg.norm(goals[:, :3, 3], axis=-1)[:, None]
    # The rounding of q as it is returned, and of forward kinematics here.
    eps = float(np.finfo(dtype).eps)
    rounding = eps * (60 + 8 * np.abs(sol.q).max(-1) / size * np.array("P" in arm.kinds))
    allowed = VALID[dtype.name] + rounding
    wrong = sol.valid & ((distance > allowed * scale) | (angle > allowed))
    scaled = np.array(jacobian(arm, q), float)
    scaled[:, :3] /= size
    scaled[:, :, [kind == "P" for kind in arm.kinds]] *= size
    # Redundant joints are given: the others must be regular.
    solved = scaled[..., arm.solved.start : arm.solved.stop]
    sigma_min = np.linalg.svd(rows @ solved, compute_uv=False)[..., -1]
    turning = np.array([kind == "R" for kind in arm.kinds])
    off = sol.q - q[:, None]
    off = np.abs(off if arm.coupling is None else off @ np.asarray(arm.coupling, float).T)
    off = np.where(turning, np.abs((off + np.pi) % (2 * np.pi) - np.pi), off / size).max(-1)
    nearest = np.where(sol.valid, off, np.inf).min(-1)
    regular = sigma_min > REGULAR[dtype.name]
    none = ~sol.valid.any(-1)
    found_again = FOUND_AGAIN[dtype.name] / np.maximum(sigma_min, 1e-300) + 1e3 * eps
    missing = regular & ~none & (nearest > found_again)
    worst = (distance / scale)[sol.valid].max(initial=0.0)
    return wrong.any(-1), none, missing & ~wrong.any(-1), float(worst)


def _task_errors(arm: Arm, reached: np.ndarray, goals: np.ndarray):
    """Position and rotation errors within the arm's task, and the rows of a twist that it controls."""
    offset, no_angle = reached[..., :3, 3] - goals[..., :3, 3], np.zeros(reached.shape[:-2])
    change = goals[..., :3, :3] @ np.swapaxes(reached[..., :3, :3], -1, -2)
    axial = np.stack([change[..., i, j] - change[..., j, i] for i, j in ((2, 1), (0, 2), (1, 0))], -1)
    trace = np.einsum("...ii->...", change)
    if arm.task == "pose":
        angle = np.arctan2(np.linalg.norm(axial, axis=-1), trace - 1)
        return np.linalg.norm(offset, axis=-1), angle, np.eye(6)
    if arm.task == "position":
        return np.linalg.norm(offset, axis=-1), no_angle, np.eye(6)[:3]
    # A planar task: errors in the arm's plane, whose normal is `up`.
    along = np.asarray(frames(arm, np.zeros(arm.n)), float)[:-1, :3, 2]
    up = along[arm.kinds.index("R")] if "R" in arm.kinds else np.cross(along[0], along[1])
    up = up / np.linalg.norm(up)
    x = np.cross(up, np.eye(3)[np.argmin(np.abs(up))])
    x = x / np.linalg.norm(x)
    rows = np.zeros((3, 6))
    rows[0, :3], rows[1, :3], rows[2, 3:] = x, np.cross(up, x), up
    distance = np.linalg.norm(offset - (offset @ up)[..., None] * up, axis=-1)
    if arm.task == "planar_position":
        return distance, no_angle, rows[:2]
    angle = np.abs(np.arctan2(axial @ up, trace - np.einsum("i,...ij,j->...", up, change, up)))
    return distance, angle, rows
