"""`print(arm)`: the call of `Arm.from_dh` that builds the arm, to be pasted into Python."""

import functools
from collections.abc import Iterable

import jax
import numpy as np


def _number(x: float, dtype=np.float64) -> str:
    """The number to twelve digits (seven in float32), or as a multiple of pi / 12 where it is one."""
    if np.isinf(x):
        return "inf" if x > 0 else "-inf"
    digits, close = (7, 1e-6) if dtype == np.float32 else (12, 1e-12)
    twelfths = x / (np.pi / 12)
    k = round(twelfths)
    if k and abs(twelfths - k) < close and abs(k) <= 24:
        common = np.gcd(k, 12)
        top, bottom = k // common, 12 // common
        text = {1: "pi", -1: "-pi"}.get(top, f"{top} * pi")
        return text if bottom == 1 else f"{text} / {bottom}"
    return f"{x:.{digits}g}"


def _column(name: str, values: Iterable[str], width: list[int]) -> str:
    """One column of the table as a line, its entries under those of the other columns."""
    cells = [value.rjust(w) for value, w in zip(values, width, strict=True)]
    return f"    {name:<5} = [{', '.join(cells)}],"


def paste(arm) -> str:
    """The call of `Arm.from_dh` that builds this arm, with one column of the table on a line.

    Names of joints are a comment. A traced arm, which has no numbers to print, gives its repr.
    """
    try:
        leaves = {k: np.asarray(v, float) for k in _LEAVES if (v := getattr(arm, k)) is not None}
    except jax.errors.TracerArrayConversionError:
        return repr(arm)
    text = functools.partial(_number, dtype=arm.dtype)
    columns = {k: leaves[k] for k in ("a", "alpha", "d", "theta")}
    width = [max(len(text(c[i])) for c in columns.values()) for i in range(arm.n)]
    lines = ["from ikjax import Arm", "from numpy import array, inf, pi", ""]
    if arm.joint_names is not None:
        lines.append(f"# Joints: {', '.join(arm.joint_names)}")
    lines.append("arm = Arm.from_dh(")
    lines += [_column(name, map(text, values), width) for name, values in columns.items()]
    lines.append(f'    kinds = "{arm.kinds}", convention = "standard", name = {arm.name!r},')
    if np.isfinite(leaves["limits"]).any():
        pairs = ", ".join(f"({text(lo)}, {text(hi)})" for lo, hi in leaves["limits"])
        lines.append(f"    limits = [{pairs}],")
    if arm.locked:
        lines.append(f"    redundant = {[i + 1 for i in arm.locked]},")
    for key in ("base", "tool", "coupling", "correction"):
        if getattr(arm, key) is not None and not np.array_equal(leaves[key], np.eye(4)):
            rows = ", ".join("[" + ", ".join(text(v) for v in row) + "]" for row in leaves[key])
            lines.append(f"    {key} = array([{rows}]),")
    lines.append(")")
    return "\n".join(lines)


_LEAVES = ("a", "alpha", "d", "theta", "base", "tool", "limits", "coupling", "correction")
