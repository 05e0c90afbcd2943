"""DH tables: checks of what the user gives, the DH matrix, and modified DH rewritten as standard DH.

The matrix here is numpy's, for recognition and for rewriting tables on the host; that of the kernels is
`arm.forward.advance`.

Source: Craig, Introduction to Robotics, 3rd ed., equation (3.6); Spong, Robot Modeling and
Control, equation (3.10).
"""

import itertools
from collections.abc import Iterable, Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ikjax.core import vector
from ikjax.core.tolerances import EXACT_ROTATION, LONGEST_LENGTH, NEARLY_ROTATION
from ikjax.core.typing import ArrayInput
from ikjax.core.warn import warn_of_degrees, warn_of_millimetres


def count_joints(**columns: ArrayInput) -> int:
    """The common length of the DH columns.

    Raises:
        ValueError: A column that is no row of numbers, or columns of different lengths.
    """
    sizes = {name: np.shape(value) for name, value in columns.items()}
    for name, shape in sizes.items():
        if len(shape) != 1 or shape[0] == 0:
            raise ValueError(f"{name} must have shape (n,) with n >= 1 joints, got {shape}")
    if len(set(sizes.values())) > 1:
        raise ValueError(f"a, alpha and d must have one length, got {sizes}")
    return sizes["a"][0]


def check_kinds(kinds: str | None, n: int) -> str:
    """The kinds of n joints, all revolute by default."""
    kinds = "R" * n if kinds is None else kinds
    if not isinstance(kinds, str) or len(kinds) != n or set(kinds) - {"R", "P"}:
        raise ValueError(f'kinds must be {n} letters "R" or "P", got {kinds!r}')
    return kinds


def _convert(name: str, value):
    """An array of real numbers; a numpy array, whose values can be checked, unless it is traced."""
    xp = jnp if isinstance(value, jax.core.Tracer) else np
    try:
        if np.iscomplexobj(value):
            raise TypeError
        return xp.asarray(value, float)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{name} must hold real numbers, got {value!r}") from error


def column(name: str, value: Any, n: int):
    """One column of the table as an (n,) array of finite numbers.

    Warns:
        Where its angles are probably in degrees, or its lengths in millimetres.
    """
    value = _convert(name, value)
    if value.shape != (n,):
        raise ValueError(f"{name} must have shape ({n},), got {value.shape}")
    if isinstance(value, np.ndarray):
        bad = ~(np.abs(value) <= LONGEST_LENGTH)
        if bad.any():
            i = int(np.argmax(bad))
            raise ValueError(f"{name}[{i}] (joint {i + 1}) must be a finite number, got {value[i]}")
        if name in ("alpha", "theta"):
            warn_of_degrees(name, value)
        else:
            # The sum: offsets along nearly parallel axes, as calibrations have them, are long and cancel.
            warn_of_millimetres(name, value.sum())
    return value


def check_pose(name: str, value: Any):
    """A (4, 4) rigid pose. A rounded rotation is made orthonormal again, or no goal would be met."""
    value = _convert(name, value)
    if value.shape != (4, 4):
        raise ValueError(f"{name} must have shape (4, 4), got {value.shape}")
    if isinstance(value, np.ndarray):
        if not np.isfinite(value).all():
            raise ValueError(f"{name} must hold finite numbers, got\n{value}")
        if not np.allclose(value[3], (0, 0, 0, 1), atol=1e-9):
            raise ValueError(f"{name} must have bottom row (0, 0, 0, 1), got {value[3]}: transposed?")
        rotation = value[:3, :3]
        gap = np.linalg.norm(rotation.T @ rotation - np.eye(3))
        if gap > 1e-5 or np.linalg.det(rotation) < 0:
            rounded = EXACT_ROTATION < gap <= NEARLY_ROTATION
            remedy = ": take the nearest with pose(matrix=..., orthonormalize=True)" if rounded else ""
            raise ValueError(f"{name} must hold a rotation, its R^T R - I has norm {gap:.1g}{remedy}")
        if gap > EXACT_ROTATION:
            value = value.copy()
            value[:3, :3] = vector.orthonormal(tuple(map(tuple, rotation.tolist())))
    return value


def check_limits(limits: Any, kinds: str) -> np.ndarray:
    """(n, 2) limits; infinities where there are none, for all joints if `limits` is None."""
    n = len(kinds)
    if limits is None:
        return np.tile([-np.inf, np.inf], (n, 1))
    limits = _convert("limits", limits)
    if limits.shape != (n, 2):
        raise ValueError(f"limits must have shape ({n}, 2), got {limits.shape}")
    for i, (lower, upper) in enumerate(limits):
        if not lower <= upper:
            raise ValueError(f"limits[{i}] (joint {i + 1}) must be lower <= upper, got ({lower}, {upper})")
    # Up to two turns either way are taken as radians.
    warn_of_degrees("limits", limits.T, turns=2, kinds=kinds)
    return limits


def check_coupling(coupling: Any, n: int):
    """(n, n) with an inverse; None for the identity."""
    if coupling is None:
        return None
    coupling = _convert("coupling", coupling)
    if coupling.shape != (n, n):
        raise ValueError(f"coupling must have shape ({n}, {n}), got {coupling.shape}")
    if isinstance(coupling, np.ndarray):
        if not np.isfinite(coupling).all():
            raise ValueError(f"coupling must hold finite numbers, got\n{coupling}")
        if np.linalg.cond(coupling) > 1e6:
            raise ValueError(f"coupling must have an inverse, got\n{coupling}")
        if np.array_equal(coupling, np.eye(n)):
            return None
    return coupling


def check_correction(correction: Any, n: int):
    """(n + 1, 6) shifts [m] and rotation vectors of at most 0.05 rad, or None.

    Up to that angle the series of `arm.forward` and `arm.twists` are exact to rounding.
    """
    if correction is None:
        return None
    correction = _convert("correction", correction)
    if correction.shape != (n + 1, 6):
        raise ValueError(f"correction must have shape ({n + 1}, 6), got {correction.shape}")
    if isinstance(correction, np.ndarray) and not np.abs(correction[:, 3:]).max() <= 0.05:
        raise ValueError(f"correction must turn by 0.05 rad at most, got {np.abs(correction[:, 3:]).max()}")
    return correction


def link_matrix(theta: float, d: float, a: float, sin_alpha: float, cos_alpha: float) -> np.ndarray:
    """(4, 4) T_(i-1)_i of one row of a standard DH table: Rz(theta) Tz(d) Tx(a) Rx(alpha), in numpy.

    The twist is given by its sine and cosine, which may have been set to exactly 0, 1 or -1.

    Source: Spong, Robot Modeling and Control, equation (3.10).
    """
    s, c, sa, ca = np.sin(theta), np.cos(theta), sin_alpha, cos_alpha
    return np.array(
        [
            [c, -s * ca, s * sa, a * c],
            [s, c * ca, -c * sa, a * s],
            [0, sa, ca, d],
            [0, 0, 0, 1.0],
        ]
    )


def link_frames(links: Iterable[np.ndarray]) -> np.ndarray:
    """(n + 1, 4, 4) the base, which is the identity, and the frame after each link, from n link matrices."""
    return np.stack(list(itertools.accumulate(links, np.matmul, initial=np.eye(4))))


def frames(columns: Mapping[str, np.ndarray]) -> np.ndarray:
    """(n + 1, 4, 4) the base and the frame after each link of a standard table at q = 0."""
    rows = zip(*(columns[key] for key in ("theta", "d", "a", "alpha")), strict=True)
    return link_frames(link_matrix(theta, d, a, np.sin(alpha), np.cos(alpha)) for theta, d, a, alpha in rows)


def to_standard(convention: str, numbers: dict, base) -> tuple[dict, object, int]:
    """The same arm in standard DH: what comes before the first joint goes into the base.

    Row i of a modified table, Tx(a(i-1)) Rx(alpha(i-1)) Rz(theta(i)) Tz(d(i)), is regrouped so that each
    joint is followed by its own twist.

    Returns:
        The columns, the base, and +1 where axis 1 points up in the world, -1 where it points down. A level
        axis rounds to either: its own direction then counts as up. So does that of a traced base.

    Raises:
        ValueError: An unknown convention.

    Source: Craig, Introduction to Robotics, 3rd ed., equation (3.6).
    """
    if convention not in ("standard", "modified"):
        raise ValueError(f'convention must be "standard" or "modified", got {convention!r}')
    a, alpha = numbers["a"], numbers["alpha"]
    modified = convention == "modified"
    tilt = alpha[0] if modified else 0.0
    concrete = isinstance(base, np.ndarray) and not isinstance(tilt, jax.core.Tracer)
    # The z component of axis 1 in the world.
    up = -1 if concrete and base[2, 2] * np.cos(tilt) - base[2, 1] * np.sin(tilt) < -1e-9 else 1
    if not modified:
        return numbers, base, up
    xp = jnp if any(isinstance(x, jax.core.Tracer) for x in (base, a, alpha)) else np
    s, c, zero, one = xp.sin(tilt), xp.cos(tilt), xp.zeros(()), xp.ones(())
    rows = [[one, zero, zero, a[0]], [zero, c, -s, zero], [zero, s, c, zero], [zero, zero, zero, one]]
    before = xp.stack([xp.stack([xp.asarray(x) for x in line]) for line in rows])
    base = (base[:, :, None] * before[None, :, :]).sum(1)
    shifted = {}
    for name in ("a", "alpha"):
        xp = jnp if isinstance(numbers[name], jax.core.Tracer) else np
        shifted[name] = xp.concatenate([numbers[name][1:], xp.zeros(1)])
    return {**numbers, **shifted}, base, up
