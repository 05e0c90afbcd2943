"""The rivals, each as one call on a batch of goals; a package that is not installed is reported as absent.

An adapter converts the goals to the rival's own frames and input type before the timed call, and the answers
to (N, S, n) arrays after it. All three compute in float64.
"""

import dataclasses
import importlib
from collections.abc import Callable
from typing import Any

import check
import numpy as np

THREADS = 2
"""For rivals with threads: the cores of the benchmark machine."""

TOLERANCE = 1e-6
"""Of a pose, in `check.tally_answers`: a thousand times our own tolerance in float64."""


@dataclasses.dataclass(frozen=True)
class Rival:
    """One package on one arm, with a batch of goals in its own form."""

    name: str
    package: str
    """Its name for pip."""
    how: str
    """The call that is timed, and what was done to the goals before."""
    solve: Callable[[], Any]
    """Solves the whole batch: this is what is timed."""
    unpack: Callable[[Any], tuple[np.ndarray, np.ndarray]]
    """Answers (N, S, n) and which of them were given (N, S), from what `solve` returned."""
    comparable: bool = True
    """Whether it does the same work as the others, so that our rates are divided by its rate."""


class AbsentError(Exception):
    """The package is not installed, or has not this arm."""


def _load(module: str):
    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise AbsentError(f"{module} is not installed ({error})") from error


def _ragged(batch: list) -> tuple[np.ndarray, np.ndarray]:
    """A list of (k, 6) arrays, one a goal, as padded answers and mask."""
    most = max(1, max(len(rows) for rows in batch))
    answers = np.full((len(batch), most, 6), np.nan)
    for row, found in zip(answers, batch, strict=True):
        if len(found):
            row[: len(found)] = found
    return answers, np.arange(most) < np.array([len(rows) for rows in batch])[:, None]


def eaik_robot(arm):
    """EAIK's own arm."""
    dh_robot = _load("eaik.IK_DH").DhRobot
    if not check.is_plain(arm):
        raise AbsentError("the adapter knows no base, tool or joint zeros")
    dh = check.table(arm)
    return dh_robot(dh["alpha"], dh["a"], dh["d"])


def eaik(arm, goals: np.ndarray) -> Rival:
    """EAIK (Ostermeier, Kuelz, Althoff 2025), C++: `IK_batched`; least-squares rows are no answers."""
    robot = eaik_robot(arm)
    poses = [np.ascontiguousarray(T) for T in goals]

    def unpack(found):
        return _ragged([np.atleast_2d(s.Q)[~np.asarray(s.is_LS, bool)] if len(s.Q) else () for s in found])

    how = f"IK_batched(list, {THREADS})"
    return Rival("EAIK", "eaik", how, lambda: robot.IK_batched(poses, THREADS), unpack)


OPW = {
    "puma560": {
        "a2": 0.0203,
        "b": -0.15005,
        "c2": 0.4318,
        "c3": 0.4318,
        "offsets": (0, -np.pi / 2, np.pi / 2, 0, 0, 0),
        "flip_axes": (False, True, True, False, True, False),
    },
}
"""Arms as py-opw-kinematics describes them, in our own frames and joint zeros."""


def opw(arm, goals: np.ndarray, *, sigma: bool = False) -> Rival:
    """py-opw-kinematics, Rust: `reach`, every branch.

    It has no option to leave out its smallest singular values. Without `sigma` it gets joint limits that no
    branch can meet: it then computes none of them, and its joints do not depend on limits.
    """
    package = _load("py_opw_kinematics")
    if arm.name not in OPW:
        raise AbsentError(f"{arm.name} has no ortho-parallel basis with a spherical wrist in its table")
    robot = package.Robot(package.KinematicModel(**OPW[arm.name]), degrees=False)
    q = np.random.default_rng(1).uniform(-np.pi, np.pi, (8, 6))
    _same_frames(np.stack([robot.forward(tuple(row)).as_matrix() for row in q]), check.fk(arm, q))
    poses = package.RigidTransform.from_matrix(goals)
    limits = None if sigma else np.tile([10.0, 11.0], (6, 1))

    def unpack(found):
        if not sigma and np.isfinite(found.sigma_min).any():
            raise RuntimeError("singular values were computed after all")
        return found.joints, np.isfinite(found.joints).all(-1)

    how = f"reach(threads={THREADS}), {'with' if sigma else 'without'} singular values"
    return Rival(
        "OPW with sigma" if sigma else "OPW",
        "py-opw-kinematics",
        how,
        lambda: robot.reach(poses, joint_limits=limits, threads=THREADS),
        unpack,
        comparable=not sigma,
    )


SSIK = {"puma560": "ssik.prebuilt.unimation.puma560_ik", "ur5": "ssik.prebuilt.universal_robots.ur5_ik"}


def ssik(arm, goals: np.ndarray) -> Rival:
    """ssik, its prebuilt arm: `solve`, a goal at a time, without joint limits; its native backend.

    Its base may be turned by pi about z and its tool otherwise: goals are converted, and the
    conversion is checked on its own forward kinematics.
    """
    if arm.name not in SSIK:
        raise AbsentError(f"no prebuilt {arm.name}")
    module = _load(SSIK[arm.name])
    q = np.random.default_rng(1).uniform(-np.pi, np.pi, (8, 6))
    theirs, ours = np.stack([module.fk(row) for row in q]), check.fk(arm, q)
    for base in (np.eye(4), np.diag([-1.0, -1.0, 1.0, 1.0])):
        tool = np.linalg.solve(base @ ours[0], theirs[0])
        if np.abs(base @ ours @ tool - theirs).max() < 1e-9:
            break
    _same_frames(theirs, base @ ours @ tool)
    poses = list(base @ goals @ tool)
    turned = base[0, 0] < 0 or np.abs(tool - np.eye(4)).max() > 1e-9
    how = f"solve(T, respect_limits=False), goals {'converted to' if turned else 'already in'} its frames"
    return Rival(
        "ssik",
        "ssik",
        how,
        lambda: [module.solve(T, respect_limits=False) for T in poses],
        lambda found: _ragged([[s.q for s in solutions] for solutions in found]),
    )


def _same_frames(theirs: np.ndarray, ours: np.ndarray) -> None:
    gap = np.abs(theirs - ours).max()
    if not gap < 1e-9:
        raise RuntimeError(f"the rival's forward kinematics differ from ours by {gap:.1e}")
