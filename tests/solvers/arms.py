"""The one table of arms that the cross-cutting tests run over: the catalogue, and arms made to be awkward."""

import functools
import zlib

import jax.numpy as jnp
import numpy as np

import ikjax
from ikjax.ik.inline import entries_of, gathered, slots_of

DEG = np.pi / 180


def numpy_pose(xyz, rpy) -> np.ndarray:
    """T from a position and fixed-axis roll, pitch, yaw, in numpy alone."""
    (cr, cp, cy), (sr, sp, sy) = np.cos(rpy), np.sin(rpy)
    x = np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
    y = np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
    z = np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]])
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = z @ y @ x, xyz
    return T


BASE = numpy_pose([0.3, -0.2, 0.5], [0.4, -0.3, 1.1])
UPSIDE_DOWN = numpy_pose([-0.1, 0.4, 1.5], [np.pi - 0.3, 0.2, -0.7])
TOOL = numpy_pose([0.05, -0.02, 0.13], [-0.6, 0.5, 2.0])
SHIFT = [0.3, -1.2, 2.0, -0.7, 0.4, 2.9]


def dh(name, a, alpha, d, theta=None, base=None, tool=None, kinds=None) -> ikjax.Arm:
    """An arm from a standard table, its twists in degrees."""
    return ikjax.Arm.from_dh(
        a=a,
        alpha=np.multiply(alpha, DEG),
        d=d,
        theta=theta,
        kinds=kinds,
        base=base,
        tool=tool,
        convention="standard",
        name=name,
    )


def _awkward() -> dict[str, functools.partial]:
    table = {
        # ortho_parallel_wrist
        "every_offset": dict(
            a=[0.12, -0.45, 0.09, 0, 0, 0.05],
            alpha=[90, 0, -90, 90, -90, 40],
            d=[0.3, 0.07, -0.11, 0.4, 0, 0.06],
            theta=SHIFT,
            base=BASE,
            tool=TOOL,
        ),
        "skew_wrist": dict(
            a=[0.1, 0.5, 0.06, 0, 0, 0],
            alpha=[-90, 180, 90, 60, -70, 0],
            d=[0.2, 0.05, 0.04, -0.45, 0, 0.1],
            theta=SHIFT,
        ),
        "skew_forearm": dict(
            a=[-0.15, 0.5, 0.05, 0, 0, 0],
            alpha=[-90, 0, 70, -90, -90, 0],
            d=[0.1, -0.08, 0.03, 0.4, 0, 0.1],
            tool=TOOL,
        ),
        "no_d4": dict(
            a=[0.05, 0.4, 0.35, 0, 0, 0],
            alpha=[90, 180, 90, -90, 90, 0],
            d=[0.4, 0, 0.06, 0, 0, 0.08],
        ),
        "equal_links": dict(
            a=[0, 0.4, 0, 0, 0, 0],
            alpha=[90, 0, 90, -90, 90, 0],
            d=[0, 0, 0, 0.4, 0, 0.1],
        ),
        "equal_bent_links": dict(
            a=[0.1, -0.5, 0.3, 0, 0, 0],
            alpha=[-90, 180, -90, 90, 90, 0],
            d=[0.2, 0.1, 0.05, 0.4, 0, 0],
            base=UPSIDE_DOWN,
        ),
        "skew_everything": dict(
            a=[-0.1, -0.4, -0.08, 0, 0, 0.03],
            alpha=[90, 180, -110, 120, 50, 15],
            d=[0.2, 0.05, -0.07, -0.38, 0, 0.09],
            theta=SHIFT,
            base=UPSIDE_DOWN,
            tool=TOOL,
        ),
        # three_parallel
        "parallel_every_offset": dict(
            a=[0.11, 0.45, -0.38, 0.07, 0, 0.04],
            alpha=[-90, 0, 0, 90, 90, 30],
            d=[0.2, 0.05, -0.08, 0.12, 0.09, 0.07],
            theta=SHIFT,
            base=BASE,
            tool=TOOL,
        ),
        "parallel_second_reversed": dict(
            a=[-0.1, 0.42, 0.36, -0.06, 0, 0],
            alpha=[90, 180, 0, -90, 90, 0],
            d=[0.15, 0.03, 0.11, 0.1, -0.08, 0.06],
        ),
        "parallel_third_reversed": dict(
            a=[0, -0.42, 0.36, 0, 0, 0],
            alpha=[90, 0, 180, -90, -90, 0],
            d=[0.15, 0, 0, 0.1, 0.08, 0.06],
        ),
        "parallel_both_reversed": dict(
            a=[0.08, 0.4, 0.4, 0.09, 0, -0.05],
            alpha=[-90, 180, 180, 90, -90, -60],
            d=[-0.2, 0.1, 0.04, -0.12, 0.1, -0.06],
            theta=SHIFT,
            base=UPSIDE_DOWN,
            tool=TOOL,
        ),
    }
    return {name: functools.partial(dh, name, **columns) for name, columns in table.items()}


AWKWARD = _awkward()
CATALOGUE = ("elbow_manipulator", "irb120", "irb2400", "kr6_r900", "lrmate200id", "puma560", "rx160")
CATALOGUE += ("ur10e", "ur3e", "ur5", "ur5e")
"""Some of the catalogue's arms of these families; `make verify` judges every one of the catalogue."""
NAMES = (*CATALOGUE, *AWKWARD)

DISTINCT = (
    "puma560",
    "elbow_manipulator",
    "ur5",
    "irb2400",
    "kr6_r900",
    "lrmate200id",
    *AWKWARD,
)
"""Without the arms that differ from another one in their lengths alone."""


@functools.cache
def build(name: str) -> ikjax.Arm:
    """An arm of the table."""
    return AWKWARD[name]() if name in AWKWARD else ikjax.robots.get(name)


def leaves(arm: ikjax.Arm) -> dict[str, np.ndarray]:
    return {k: np.asarray(getattr(arm, k), float) for k in ("a", "alpha", "d", "theta", "base", "tool")}


def numpy_fk(arm: ikjax.Arm, q: np.ndarray, frames: bool = False):
    """Forward kinematics written down from the DH definition, with nothing of ikjax in it."""
    p = leaves(arm)
    q = np.asarray(q, float)
    T = np.broadcast_to(p["base"], (*q.shape[:-1], 4, 4))
    every = [T]
    for i in range(q.shape[-1]):
        turns = arm.kinds[i] == "R"
        t = p["theta"][i] + (q[..., i] if turns else 0 * q[..., i])
        s, c, z, o = np.sin(t), np.cos(t), np.zeros_like(t), np.ones_like(t)
        sa, ca = np.sin(p["alpha"][i]), np.cos(p["alpha"][i])
        link = np.stack(
            [
                np.stack([c, -s * ca, s * sa, p["a"][i] * c], -1),
                np.stack([s, c * ca, -c * sa, p["a"][i] * s], -1),
                np.stack([z, z + sa, z + ca, p["d"][i] + (z if turns else q[..., i])], -1),
                np.stack([z, z, z, o], -1),
            ],
            -2,
        )
        T = T @ link
        every.append(T)
    return np.stack(every, -3) if frames else T @ p["tool"]


def numpy_jacobian(arm: ikjax.Arm, q: np.ndarray) -> np.ndarray:
    """(..., 6, n), linear rows and slides in units of the reach."""
    every = numpy_fk(arm, q, frames=True)
    tip = numpy_fk(arm, q)[..., None, :3, 3]
    axis, origin = every[..., :-1, :3, 2], every[..., :-1, :3, 3]
    turning = np.concatenate([np.cross(axis, tip - origin) / reach(arm), axis], -1)
    sliding = np.concatenate([axis, 0 * axis], -1)
    columns = np.where([[kind == "R"] for kind in arm.kinds], turning, sliding)
    return np.swapaxes(columns, -1, -2)


def reach(arm: ikjax.Arm) -> float:
    p = leaves(arm)
    return float(np.abs(p["a"]).sum() + np.abs(p["d"]).sum() + np.abs(p["tool"][:3, 3]).sum())


def sigma_min(arm: ikjax.Arm, q: np.ndarray) -> np.ndarray:
    """Least singular value of the Jacobian with lengths in reaches."""
    return np.linalg.svd(numpy_jacobian(arm, q), compute_uv=False)[..., -1]


def joints(name: str, count: int, seed: int = 0) -> np.ndarray:
    """Random joint values in (-pi, pi]."""
    rng = np.random.default_rng([seed, zlib.crc32(name.encode())])
    return rng.uniform(-np.pi, np.pi, (count, 6))


def errors(arm: ikjax.Arm, q, goals) -> tuple[np.ndarray, np.ndarray]:
    """Position error [m] and rotation error [rad] of q against goals (..., 4, 4), in numpy float64."""
    found, goals = numpy_fk(arm, q), np.asarray(goals, float)
    gap = np.linalg.norm(found[..., :3, 3] - goals[..., :3, 3], axis=-1)
    chord = np.linalg.norm(found[..., :3, :3] - goals[..., :3, :3], axis=(-2, -1))
    return gap, 2 * np.arcsin(np.minimum(chord / np.sqrt(8), 1))


def wrapped(angle: np.ndarray) -> np.ndarray:
    """Angles near zero, whatever whole turns were in them."""
    return (np.asarray(angle, float) + np.pi) % (2 * np.pi) - np.pi


def solve(arm: ikjax.Arm, goals, dtype=np.float64) -> ikjax.Solutions:
    """`ikjax.solve`, fields in numpy."""
    sol = ikjax.solve(arm, jnp.asarray(np.asarray(goals), dtype))
    return ikjax.Solutions(**{k: np.asarray(v) for k, v in vars(sol).items()})


def typed(arm: ikjax.Arm, dtype) -> ikjax.Arm:
    """The arm as arrays of one type: Python numbers would turn float32 into float64 outside a jit."""
    return arm.astype(dtype)


def solve_by_hand(arm: ikjax.Arm, goals, q_now=None, dtype=np.float64) -> ikjax.Solutions:
    """The graph of `solve`, one operation at a time: nothing is compiled, so it is cheap for many arms.

    Goals are filled up to one of few shapes, because every operation is compiled once a shape.
    """
    goals = np.asarray(goals)
    batch, count = goals.shape[:-2], goals[..., 0, 0].size
    now = np.zeros((*batch, arm.n)) if q_now is None else np.asarray(q_now)
    full = np.arange(max(512, 1 << (count - 1).bit_length())) % count
    goals, now = (jnp.asarray(x.reshape(count, *x.shape[len(batch) :])[full], dtype) for x in (goals, now))
    slots = slots_of(typed(arm, dtype), entries_of(goals), now, None)
    sol = gathered(slots, goals.shape[:-2])
    fields = {k: np.asarray(v)[:count] for k, v in vars(sol).items()}
    return ikjax.Solutions(**{k: v.reshape(*batch, *v.shape[1:]) for k, v in fields.items()})


TOLERANCE = {"float32": 2e-5, "float64": 1e-9}


def wrong(arm: ikjax.Arm, sol: ikjax.Solutions, goals, dtype) -> np.ndarray:
    """(..., S) valid slots that do not reach their goal within what `valid` promises.

    The promise is measured in the solver's type, and the joints are rounded to it on their way out:
    12 eps rad of rounding in all, over at most the reach.
    """
    goals = np.asarray(goals, dtype).astype(float)
    gap, turn = errors(arm, sol.q, goals[..., None, :, :])
    allowed = TOLERANCE[np.dtype(dtype).name] + 40 * np.finfo(dtype).eps
    size = reach(arm) + np.linalg.norm(goals[..., :3, 3], axis=-1)[..., None]
    return sol.valid & ((gap > allowed * size) | (turn > allowed))


def missing(arm: ikjax.Arm, sol: ikjax.Solutions, q, dtype) -> np.ndarray:
    """(...) goals whose generating joints are in no valid slot, where the arm is regular enough to ask.

    A pose is right to some 64 eps, so joints are right to that over sigma_min; and where the fold is
    so near that the square of this error counts, to its square root.
    """
    eps, least = 64 * np.finfo(dtype).eps, sigma_min(arm, q)
    off = np.abs(wrapped(sol.q - np.asarray(q)[..., None, :])).max(-1)
    near = np.where(sol.valid, off, np.inf).min(-1)
    regular = least > (1e-6 if dtype == np.float64 else 1e-2)
    return regular & (near > np.minimum(20 * eps / least, np.sqrt(20 * eps)))
