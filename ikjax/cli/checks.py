"""`ikjax verify` and `ikjax doctor`: arms checked on many goals, and this device on a few."""

import pathlib
import platform
import sys
from typing import Any

import jax
import numpy as np

import ikjax
from ikjax.cli import whole_arm
from ikjax.cli.output import print_result
from ikjax.core.text import markdown


def run_verify(options) -> int:
    dtype = np.float32 if options.other_dtype else np.float64
    reports = [
        ikjax.verify(whole_arm.from_options(options, name), options.count, dtype=dtype)
        for name in options.arm or ikjax.robots.names()
    ]
    head = ("arm", "family", "type", "goals", "success", "wrong", "none", "missing", "singular", "worst")
    rows = [[*map(str, report[:-1]), f"{report.worst:.1e}"] for report in reports]
    table = (head, ["---"] * len(head), *([markdown(row[0]), *row[1:]] for row in rows))
    lines = ["| " + " | ".join(row) + " |" for row in table]
    if options.out:
        pathlib.Path(options.out).write_text("\n".join(lines) + "\n", encoding="utf-8")
    width = [max(len(row[k]) for row in (head, *rows)) for k in range(len(head))]
    text = ["  ".join(cell.ljust(w) for cell, w in zip(row, width, strict=True)) for row in (head, *rows)]
    print_result(options, "\n".join(text), {report.arm: report._asdict() for report in reports})
    return 0 if all(report.wrong == report.none == 0 for report in reports) else 1


def run_doctor(options) -> int:
    checks = [check for dtype in ("float32", "float64") for check in _self_check(np.dtype(dtype))]
    data: dict[str, Any] = {
        "python": platform.python_version(),
        "platform": platform.platform(),
        "ikjax": ikjax.__version__,
        **{name: sys.modules[name].__version__ for name in ("jax", "jaxlib", "numpy")},
        "devices": [str(device) for device in jax.devices()],
        "float64": "on for this command; off in a program until jax_enable_x64 is set",
        "checks": checks,
    }
    lines = [f"{name:9} {value}" for name, value in data.items() if name != "checks"]
    for check in checks:
        mark = "ok  " if check["ok"] else "FAIL"
        lines.append(f"{mark} {check['what']}: {check['worst']:.2g}, allowed {check['allowed']:.2g}")
    print_result(options, "\n".join(lines), data)
    return 0 if all(check["ok"] for check in checks) else 1


def _self_check(dtype: np.dtype) -> list[dict]:
    """Trigonometry against numpy's long double, and a thousand goals of one arm."""
    from ikjax.core import trig

    rng = np.random.default_rng(0)
    x, y = (rng.normal(size=10_000).astype(dtype) for _ in range(2))
    angles = (x * dtype.type(1e4)).astype(dtype)
    exact = [v.astype(np.longdouble) for v in (x, y, angles)]
    trig_allowed = 3e-7 if dtype == np.float32 else 6.7e-16

    def check(what: str, worst, allowed: float) -> dict:
        worst = float(worst)
        return {"what": f"{dtype} {what}", "worst": worst, "allowed": allowed, "ok": worst <= allowed}

    sine, cosine = jax.jit(trig.sincos)(angles)
    angle = jax.jit(trig.atan2)(y, x)
    arm = ikjax.robots.get("puma560").astype(dtype)
    q = rng.uniform(-np.pi, np.pi, (1000, 6)).astype(dtype)
    sol = ikjax.solve(arm, ikjax.fk(arm, q))
    position_error, rotation_error = ikjax.pose_error(ikjax.fk(arm, sol.q), ikjax.fk(arm, q)[:, None])
    small = dtype == np.float32  # near a singularity its poses no longer determine the joints
    tolerance = 2e-5 if small else 1e-9
    pose_error = np.maximum(np.asarray(position_error) / 2, np.asarray(rotation_error))
    joint_gap = np.abs(np.asarray(trig.wrap(sol.q - q[:, None]))).max(-1).min(-1)
    return [
        check("sin", np.abs(np.asarray(sine) - np.sin(exact[2])).max(), trig_allowed),
        check("cos", np.abs(np.asarray(cosine) - np.cos(exact[2])).max(), trig_allowed),
        check("atan2 [rad]", np.abs(np.asarray(angle) - np.arctan2(exact[1], exact[0])).max(), trig_allowed),
        check("pose of every valid branch", np.where(sol.valid, pose_error, 0).max(), tolerance * 2),
        check("goals without a branch, share", (~np.asarray(sol.valid)).all(-1).mean(), 0.0),
        check("generating joints not found, share", (joint_gap > 1e-2).mean(), 0.01 if small else 0.0),
    ]
