"""Arms of every pattern of joints, for the tests of the families that take whole classes of arms."""

import functools
import itertools

import arms
import numpy as np

import ikjax

TOOL = arms.numpy_pose([0.05, 0.1, 0.3], [0.3, 0.5, -1.0])
FLAT_TOOL = arms.numpy_pose([0.25, 0.1, 0], [0, 0, -1.0])
BEFORE_WRIST = {
    "": {},
    "meet": {"a1": 0},
    "parallel": {"alpha1": 180},
    "square": {"alpha1": -90},
    "2 and 3 parallel": {"alpha2": 180},
    "2 and 3 meet": {"a2": 0},
}


def _changed(changes, a, alpha, d) -> dict:
    table = {"a": list(a), "alpha": list(alpha), "d": list(d)}
    for entry, value in changes.items():
        table[entry[:-1]][int(entry[-1]) - 1] = value
    return table


def _regional() -> dict:
    table = {}
    for kinds in map("".join, itertools.product("RP", repeat=3)):
        for special, changes in BEFORE_WRIST.items():
            first = _changed(changes, [0.12, 0.4, 0.07], [70, 25, -80], [0.3, 0.11, 0.06])
            theta = [0.2, -0.5, 0.9]
            point = dict(kinds=kinds, theta=theta, base=arms.BASE, tool=TOOL, **first)
            whole = {
                "a": [*first["a"], 0, 0, 0.03],
                "alpha": [*first["alpha"], 90, -90, 20],
                "d": [*first["d"], 0.4, 0, 0.1],
            }
            wrist = dict(kinds=kinds + "RRR", theta=[*theta, 0.3, -1, 0.4], **whole)
            if not (special.startswith("2 and 3 parallel") and kinds in ("RPP", "PPP")):
                table[f"{kinds} {special}, wrist".replace(" ,", ",")] = wrist
            if special in ("", "meet") or kinds in ("RRR", "RRP"):
                table[f"{kinds} {special}, point".replace(" ,", ",")] = point
    # Slides that stay parallel move the wrist in a surface only.
    for name in [k for k in table if "parallel" in k and k[:2] == "PP" and "2 and 3" not in k]:
        del table[name]
    return table


def _others() -> dict:
    lengths = dict(
        a=[0.11, 0.37, 0.29, 0.08, 0.05, 0.03],
        d=[0.3, 0.1, 0.07, 0.12, 0.09, 0.1],
        theta=[0.1, 0.2, 0.3, 0.4, 0.5, 0.6],
        base=arms.BASE,
        tool=TOOL,
        kinds="RRRRRR",
    )
    table = {
        "skew wrist": dict(
            kinds="RRRRRR",
            a=[0.12, 0.4, 0.07, 0, 0, 0],
            alpha=[70, 25, -80, 60, -70, 0],
            d=[0.3, 0.11, 0.06, 0.4, 0, 0.1],
        ),
        "2R": dict(kinds="RR", a=[0.4, 0.3], alpha=[0, 0], d=[0, 0], base=arms.BASE),
        "2R, second reversed": dict(kinds="RR", a=[0.4, 0.3], alpha=[180, 0], d=[0.1, 0], tool=FLAT_TOOL),
        "3R": dict(kinds="RRR", a=[0.4, 0.3, 0.2], alpha=[0, 0, 0], d=[0, 0, 0], base=arms.BASE, tool=TOOL),
        "3R, second reversed": dict(kinds="RRR", a=[0.4, 0.3, 0.2], alpha=[180, 180, 0], d=[0.2, 0, 0.1]),
        "RPR": dict(kinds="RPR", a=[0.1, 0, 0.5], alpha=[90, -90, 0], d=[0, 0, 0], theta=[0.2, 0, 0.3]),
        "PRR": dict(kinds="PRR", a=[0.1, 0.7, 0.5], alpha=[90, 0, 0], d=[0, 0, 0]),
        "RRP": dict(kinds="RRP", a=[0.6, 0.1, 0], alpha=[0, -90, 0], d=[0, 0, 0], tool=FLAT_TOOL),
        "PRP": dict(kinds="PRP", a=[0.1, 0.2, 0], alpha=[90, 90, 0], d=[0, 0, 0]),
        "PPR": dict(kinds="PPR", a=[0, 0.2, 0.3], alpha=[90, 90, 0], d=[0, 0, 0], theta=[0, np.pi / 2, 0]),
        "RP": dict(kinds="RP", a=[0.1, 0], alpha=[90, 0], d=[0, 0]),
        "PR": dict(kinds="PR", a=[0.1, 0.4], alpha=[90, 0], d=[0, 0]),
        "PP": dict(kinds="PP", a=[0.1, 0.4], alpha=[90, 0], d=[0, 0]),
        "turret": dict(
            kinds="RRRR",
            a=[0.05, 0.22, 0.13, 0.1],
            alpha=[90, 0, 180, 20],
            d=[0.2, 0.03, -0.01, 0.05],
            theta=[0.1, 0.2, 0.3, 0.4],
            base=arms.BASE,
            tool=TOOL,
        ),
        "leaning turret": dict(
            kinds="RRRR", a=[0.05, 0.22, 0.13, 0.1], alpha=[70, 0, 0, 20], d=[0.2, 0.03, -0.01, 0.05]
        ),
        "five axes": dict(
            kinds="RRRRR", a=[0, 0.4, 0.3, 0, 0], alpha=[-90, 0, 0, 90, 0], d=[0, 0, 0, 0, 0.1]
        ),
        "five axes, lateral": dict(
            kinds="RRRRR",
            a=[0.06, 0.4, -0.3, 0.05, 0.02],
            alpha=[90, 180, 0, -90, 30],
            d=[0.3, 0.05, 0.02, 0.04, 0.1],
            theta=[0.1, 0.2, 0.3, 0.4, 0.5],
            base=arms.BASE,
            tool=TOOL,
        ),
        "five axes, leaning": dict(
            kinds="RRRRR",
            a=[-0.06, 0.4, 0.3, 0.05, 0.02],
            alpha=[70, 0, 180, -60, 30],
            d=[0.3, 0.05, 0.02, 0.04, 0.1],
            theta=[0.1, 0.2, 0.3, 0.4, 0.5],
            base=arms.UPSIDE_DOWN,
            tool=TOOL,
        ),
        "five axes, roll first": dict(
            kinds="RRRRR",
            a=[0, 0.3, 0.4, 0.1, 0],
            alpha=[90, 0, 180, -90, 0],
            d=[0.1, 0.02, 0.02, 0, 0.2],
            base=arms.BASE,
        ),
        "2, 3, 4 parallel": dict(alpha=[70, 0, 180, 80, -75, 20], **lengths),
        "3, 4, 5 parallel": dict(alpha=[70, -80, 0, 180, 65, 20], **lengths),
        "4, 5, 6 parallel": dict(alpha=[70, -80, 50, 0, 180, 20], **lengths),
        "1, 2, 3 parallel": dict(alpha=[0, 180, 70, -80, 60, 20], **lengths),
        "2, 3, 4 parallel, split": dict(
            kinds="RRRRRR",
            a=[0.11, 0.37, 0.29, 0.08, 0, 0],
            alpha=[90, 0, 0, 90, -75, 0],
            d=[0.3, 0.1, 0.07, 0.12, 0.09, 0.1],
        ),
        "4, 5, 6 parallel, split": dict(
            kinds="RRRRRR",
            a=[0.11, 0, 0.29, 0.2, 0.3, 0],
            alpha=[90, 60, 90, 0, 0, 0],
            d=[0.3, 0, 0.07, 0.12, 0.09, 0.1],
        ),
    }
    offset = dict(kinds="RRRRRR", theta=[0.1, 0.2, 0.3, 0.4, 0.5, 0.6], base=arms.BASE, tool=TOOL)
    table |= {
        "offset wrist": dict(
            a=[0.11, 0.37, 0.08, 0, 0.06, 0.03],
            alpha=[70, 180, -80, 60, -75, 20],
            d=[0.3, 0.1, 0.07, 0.32, 0.09, 0.1],
            **offset,
        ),
        "offset wrist, shared": dict(
            a=[0, 0.54, 0, 0, 0, 0],
            alpha=[-90, 0, -90, 90, -90, 0],
            d=[0.2, 0, 0, 0.54, -0.15, 0.16],
            **offset,
        ),
        "offset wrist, reversed": dict(
            a=[0.06, 0, 0.08, 0.37, 0.11, 0.03],
            alpha=[75, -60, 80, 0, -70, 20],
            d=[0.2, 0.09, 0.32, 0.07, 0.1, 0.1],
            **offset,
        ),
    }
    for kinds, alpha in {
        "RRPR": [0, 180, 0, 0],
        "RRRP": [0, 0, 180, 0],
        "PRRR": [0, 0, 180, 0],
        "RPRR": [0, 180, 0, 0],
    }.items():
        a = {"PRRR": [0.1, 0.22, 0.13, 0.05], "RPRR": [0.1, 0.12, 0.13, 0.05]}
        a = a.get(kinds, [0.22, 0.13, 0.05, 0])
        table[f"SCARA {kinds}"] = dict(
            kinds=kinds, a=a, alpha=alpha, d=[0.2, 0, 0, 0.05], base=arms.BASE, tool=TOOL
        )
    for kinds in ("RRRRRR", "RRRRRP", "RRRPRR", "RRRRPR"):
        table[f"wrist first, {kinds}"] = dict(
            kinds=kinds,
            a=[0, 0, 0.4, 0.07, 0.12, 0.03],
            alpha=[90, -80, 35, -80, 70, 20],
            d=[0.3, 0, 0.06, 0.4, 0.1, 0.1],
            theta=[0.2, -0.5, 0.9, 0.1, 0.2, 0.3],
            base=arms.BASE,
            tool=TOOL,
        )
    return table


TABLE = {**_regional(), **_others()}
NAMES = tuple(TABLE)


@functools.cache
def build(name: str) -> ikjax.Arm:
    return arms.dh(name, **TABLE[name])


def joints(arm: ikjax.Arm, count: int, seed: int = 0) -> np.ndarray:
    """Random joint values; slides up to a metre either way."""
    rng = np.random.default_rng([seed, len(arm.name)])
    turning = np.array([kind == "R" for kind in arm.kinds])
    return rng.uniform(-1, 1, (count, arm.n)) * np.where(turning, np.pi, 1.0)


def errors(arm: ikjax.Arm, q, goals) -> tuple[np.ndarray, np.ndarray]:
    """Position error [m] and rotation error [rad] within the arm's task, in numpy float64."""
    found, goals = arms.numpy_fk(arm, q), np.asarray(goals, float)
    gap = found[..., :3, 3] - goals[..., :3, 3]
    if arm.task.startswith("planar"):
        up = plane_normal(arm)
        gap = gap - (gap @ up)[..., None] * up
    turn = np.zeros(gap.shape[:-1])
    if arm.task == "pose":
        chord = np.linalg.norm(found[..., :3, :3] - goals[..., :3, :3], axis=(-2, -1))
        turn = 2 * np.arcsin(np.minimum(chord / np.sqrt(8), 1))
    elif arm.task == "planar_pose":
        change = goals[..., :3, :3] @ np.swapaxes(found[..., :3, :3], -1, -2)
        axial = np.stack([change[..., i, j] - change[..., j, i] for i, j in ((2, 1), (0, 2), (1, 0))], -1)
        along = np.einsum("...ii->...", change) - np.einsum("i,...ij,j->...", up, change, up)
        turn = np.abs(np.arctan2(axial @ up, along))
    return np.linalg.norm(gap, axis=-1), turn


def plane_normal(arm: ikjax.Arm) -> np.ndarray:
    """Unit normal of the plane a planar arm moves in, in the world."""
    every = arms.numpy_fk(arm, np.zeros(arm.n), frames=True)
    along = every[:-1, :3, 2]
    if "R" in arm.kinds:
        return along[arm.kinds.index("R")]
    return np.cross(along[0], along[1]) / np.linalg.norm(np.cross(along[0], along[1]))


def rows(arm: ikjax.Arm) -> np.ndarray:
    """(m, 6): what of a twist the arm's task controls."""
    if arm.task == "pose":
        return np.eye(6)
    if arm.task == "position":
        return np.eye(6)[:3]
    up = plane_normal(arm)
    x = np.cross(up, [0.3, 0.5, 0.8])
    x /= np.linalg.norm(x)
    planar = np.zeros((3, 6))
    planar[0, :3], planar[1, :3], planar[2, 3:] = x, np.cross(up, x), up
    return planar if arm.task == "planar_pose" else planar[:2]


def sigma_min(arm: ikjax.Arm, q: np.ndarray) -> np.ndarray:
    """Least singular value of the task's Jacobian, lengths in reaches."""
    task = rows(arm) @ arms.numpy_jacobian(arm, q)
    return np.linalg.svd(task, compute_uv=False)[..., -1]
