"""Maps in float32 compared with float64, goal by goal, without and with `certify`.

A goal that differs is solved again in float64. Its distance to the nearest end of a branch, a fold or a joint
limit, shows whether rounding explains the difference.
"""

import sys

import map_child
import map_rates
import numpy as np
import report

import ikjax
from ikjax.arm.forward import reach as reach_of

ARMS = ("puma560", "ur5", "quartic")
GOALS, QUICK = 1e7, 3e5
MOST = 10**4
"""Goals that are solved again."""


def measure(given) -> str:
    """The table, as Markdown."""
    body = []
    for name in ARMS:
        body.append(_row(name, QUICK if given.quick else GOALS))
        print(" | ".join(body[-1]), file=sys.stderr, flush=True)
    head = [
        "arm",
        "goals",
        "reached",
        "float32 differs",
        "farthest from an end",
        "1 % of all are nearer than",
        "certified differs",
        "costs",
    ]
    return f"## float32 and float64\n\n{report.table(head, body)}"


def _row(name: str, goals: float) -> list[str]:
    arm = map_rates.arm_of(name)
    grid = map_child.grid_of(arm, goals)

    def swept(dtype: str, certify: bool = False) -> ikjax.ReachMap:
        sweep = {"statistics": ("reachable_within", "mask_within"), "dtype": dtype, "certify": certify}
        return ikjax.sweep(arm, grid, map_child.ORIENTATIONS, **sweep)

    narrow, wide, certified = swept("float32"), swept("float64"), swept("float32", certify=True)
    truth = wide.reached()
    apart = np.argwhere(narrow.reached() != truth)
    left = int((certified.reached() != truth).sum())
    rng = np.random.default_rng(0)
    far = clearance(arm, wide, rng.permutation(apart)[:MOST]).max(initial=0.0)
    # For comparison: the same distance of goals drawn from all that are reached.
    others = rng.permutation(np.argwhere(truth))[:MOST]
    return [
        name,
        f"{truth.size:,}",
        f"{truth.sum():,}",
        f"{len(apart):,}",
        f"{far:.1e}",
        f"{np.quantile(clearance(arm, wide, others), 0.01):.1e}",
        f"{left:,}",
        report.figure(certified.seconds / narrow.seconds, "x"),
    ]


def clearance(arm: ikjax.Arm, reach: ikjax.ReachMap, cells: np.ndarray) -> np.ndarray:
    """Distance of goals to the nearest end of a branch: a fold, in reaches, or a limit of a valid one [rad].

    Args:
        arm: In float64.
        reach: Its map.
        cells: (n, 4) indices of positions and orientations.
    """
    goals = np.broadcast_to(np.eye(4), (len(cells), 4, 4)).copy()
    goals[:, :3, :3] = reach.rotations[cells[:, 3]]
    goals[:, :3, 3] = reach.positions.points()[tuple(cells[:, :3].T)]
    sol = ikjax.solve(arm, goals)
    size = float(reach_of(arm))
    folds = np.abs(np.asarray(sol.margin)) / size
    low, high = np.asarray(arm.limits, float).T
    bounds = np.stack([low, high], axis=-1)
    # A range of a whole turn has no ends: any angle is in it.
    bounds[high - low >= 2 * np.pi] = np.inf
    gaps = np.asarray(sol.q)[..., None] - np.where(np.isfinite(bounds), bounds, np.nan)
    gaps = np.abs((gaps + np.pi) % (2 * np.pi) - np.pi)
    gaps = np.fmin.reduce(gaps, axis=(-2, -1), initial=np.inf)
    return np.minimum(folds, np.where(np.asarray(sol.valid), gaps, np.inf)).min(-1)
