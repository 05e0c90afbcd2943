"""DH tables: what is accepted, and modified DH rewritten as standard DH with a base.

Storey: arm.
Source: Craig, Introduction to Robotics, 3rd ed., equation (3.6); Spong, Robot Modeling and
Control, equation (3.10).
"""

import numpy as np

MAX_LENGTH = 1e100
"""Beyond this a length [m] is a mistake: its square no longer fits a float64."""


def count_joints(**columns) -> int:
    """The common length of the DH columns."""
    sizes = {name: np.shape(value) for name, value in columns.items()}
    for name, shape in sizes.items():
        if len(shape) != 1 or shape[0] == 0:
            raise ValueError(f"{name} must have shape (n,) with n >= 1 joints, got {shape}")
    if len(set(sizes.values())) > 1:
        raise ValueError(f"a, alpha and d must have one length, got {sizes}")
    return sizes["a"][0]


def check_kinds(kinds: str | None, n: int) -> str:
    kinds = "R" * n if kinds is None else kinds
    if not isinstance(kinds, str) or len(kinds) != n or set(kinds) - {"R", "P"}:
        raise ValueError(f'kinds must be {n} letters "R" or "P", got {kinds!r}')
    return kinds


def _convert(name: str, value, xp):
    try:
        return xp.asarray(value, float)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{name} must hold real numbers, got {value!r}") from error


def row(name: str, value, n: int, xp):
    """One column of the table as an (n,) array of finite numbers."""
    value = _convert(name, value, xp)
    if value.shape != (n,):
        raise ValueError(f"{name} must have shape ({n},), got {value.shape}")
    if xp is np:
        bad = ~(np.abs(value) <= MAX_LENGTH)
        if bad.any():
            i = int(np.argmax(bad))
            raise ValueError(f"{name}[{i}] (joint {i + 1}) must be a finite number, got {value[i]}")
    return value


def check_pose(name: str, value, xp):
    """A (4, 4) rigid pose."""
    value = _convert(name, value, xp)
    if value.shape != (4, 4):
        raise ValueError(f"{name} must have shape (4, 4), got {value.shape}")
    if xp is np:
        if not np.isfinite(value).all():
            raise ValueError(f"{name} must hold finite numbers, got\n{value}")
        if not np.allclose(value[3], (0, 0, 0, 1), atol=1e-9):
            raise ValueError(f"{name} must have bottom row (0, 0, 0, 1), got {value[3]}: transposed?")
        rotation = value[:3, :3]
        gap = np.linalg.norm(rotation.T @ rotation - np.eye(3))
        if gap > 1e-5 or np.linalg.det(rotation) < 0:
            raise ValueError(f"{name} must hold a rotation, its R^T R - I has norm {gap:.1g}")
    return value


def check_limits(limits, n: int) -> np.ndarray:
    """(n, 2) limits; None stands for no limit."""
    if limits is None:
        return np.tile([-np.inf, np.inf], (n, 1))
    limits = _convert("limits", limits, np)
    if limits.shape != (n, 2):
        raise ValueError(f"limits must have shape ({n}, 2), got {limits.shape}")
    for i, (lower, upper) in enumerate(limits):
        if not lower <= upper:
            raise ValueError(f"limits[{i}] (joint {i + 1}) must be lower <= upper, got ({lower}, {upper})")
    return limits


def to_standard(convention: str, numbers: dict, base, xp) -> tuple[dict, object]:
    """The same arm in standard DH: what stood before the first joint goes into the base."""
    if convention == "standard":
        return numbers, base
    if convention != "modified":
        raise ValueError(f'convention must be "standard" or "modified", got {convention!r}')
    a, alpha = numbers["a"], numbers["alpha"]
    s, c, one, zero = xp.sin(alpha[0]), xp.cos(alpha[0]), xp.ones(()), xp.zeros(())
    before = [
        [one, zero, zero, a[0]],
        [zero, c, -s, zero],
        [zero, s, c, zero],
        [zero, zero, zero, one],
    ]
    before = xp.stack([xp.stack([xp.asarray(x) for x in line]) for line in before])
    base = (base[:, :, None] * before[None, :, :]).sum(1)
    shifted = {key: xp.concatenate([numbers[key][1:], xp.zeros(1)]) for key in ("a", "alpha")}
    return {**numbers, **shifted}, base
