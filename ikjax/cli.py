"""The command `ikjax`: info, solve, sweep, show, verify, doctor.

Outside the storeys: it may import everything, nothing imports it. Text for people by default, one
JSON object with --json. Exit codes: 0 found, 1 none found or a check failed, 2 bad input; `sweep` has more,
see its help.
"""

import argparse
import dataclasses
import json
import math
import pathlib
import platform
import sys
import warnings
from typing import Any, NoReturn

import jax
import numpy as np

import ikjax
from ikjax.study import compare, recipe
from ikjax.study.orientations import as_orientations
from ikjax.study.place import Place, StorageError
from ikjax.study.stop import OTHERS_ENDED, TIME_IS_UP, Stop
from ikjax.study.sweep import SweepStoppedError


def main(argv=None) -> int:
    """Run one command and return its exit code."""
    try:
        options = _parser().parse_args(argv)
    except SystemExit as finished:  # after --help, --version, or a mistake that was explained
        return int(finished.code or 0)
    # A program's own choice, which the library never makes: float64 is there when asked for.
    jax.config.update("jax_enable_x64", True)
    try:
        with warnings.catch_warnings():
            warnings.showwarning = lambda message, *_: _complain(message)
            return options.run(options)
    except BrokenPipeError:  # the reader, `head` say, has seen enough
        sys.stdout = None
        return 0
    except (ValueError, OSError, ImportError) as error:
        _complain(error)
        return 2


def _complain(message: object) -> None:
    """One line on stderr."""
    print(f"ikjax: {_plain(' '.join(str(message).split()))}", file=sys.stderr)


class _Parser(argparse.ArgumentParser):
    """A parser whose complaint is one line, without the usage."""

    def error(self, message: str) -> NoReturn:
        self.exit(2, f"{self.prog}: {_plain(message)}\n")


def _size(text: str) -> float:
    """A finite length above zero [m]."""
    if not 0 < float(text) < math.inf:
        raise argparse.ArgumentTypeError(f"{text!r} is not a positive number")
    return float(text)


def _count(text: str) -> int:
    """A whole number above zero, 1e6 too."""
    if not (1 <= float(text) <= 1e12 and float(text).is_integer()):
        raise argparse.ArgumentTypeError(f"{text!r} is not a number of goals")
    return int(float(text))


def _parser() -> argparse.ArgumentParser:
    top = _Parser(prog="ikjax", description="Closed-form inverse kinematics.")
    top.add_argument("--version", action="version", version=f"ikjax {ikjax.__version__}")
    commands = top.add_subparsers(required=True, metavar="COMMAND")

    def command(run, name: str, text: str) -> argparse.ArgumentParser:
        parser = commands.add_parser(name, help=text, description=text)
        parser.add_argument("--json", action="store_true", help="print one JSON object")
        parser.set_defaults(run=run)
        return parser

    info = command(_info, "info", "List the catalogue, or describe one arm.")
    info.add_argument("arm", nargs="?")

    solve = command(_solve, "solve", "Every branch of one goal.")
    solve.add_argument("arm")
    solve.add_argument("--xyz", nargs=3, type=float, required=True, metavar=("X", "Y", "Z"), help="[m]")
    turn = solve.add_mutually_exclusive_group()
    turn.add_argument("--rpy", nargs=3, type=float, metavar=("R", "P", "Y"), help="[rad]")
    turn.add_argument("--wxyz", nargs=4, type=float, metavar=("W", "X", "Y", "Z"))
    solve.add_argument("--q-now", nargs="+", type=float, help="joints [rad] that arbitrary ones follow")
    solve.add_argument("--limits", action="store_true", help="only what is within the joint limits counts")
    solve.add_argument("--radians", action="store_true", help="print radians, not degrees")
    _add_dtype(solve, "--float32")

    sweep = command(_sweep, "sweep", "Sweep an arm's workspace: a map, a picture, a summary.")
    sweep.formatter_class = argparse.RawDescriptionHelpFormatter
    sweep.epilog = SWEEP_ENDS
    sweep.add_argument("arm", metavar="ARM|STUDY.toml", help="an arm, a URDF file, or a file that says all")
    sweep.add_argument("--spacing", type=_size, help="between positions [m], 0.05 by default")
    sweep.add_argument("--orientations", type=int, help="even ones at every position, 512 by default")
    sweep.add_argument("--out", help="store the map here: a folder (zarr v3), or a URL such as s3://...")
    sweep.add_argument("--resume", action="store_true", help="go on with what is at --out, or start")
    sweep.add_argument("--force", action="store_true", help="replace a map; with --resume, another study's")
    sweep.add_argument("--max-hours", type=_size, help="stop at the end of a unit after so long")
    sweep.add_argument("--distributed", action="store_true", help="share the units with other processes")
    sweep.add_argument("--coordinator", metavar="HOST:PORT", help="where jax does not find it by itself")
    sweep.add_argument("--processes", type=int, metavar="N", help="likewise; and --process, 0 to N - 1")
    sweep.add_argument("--process", type=int, metavar="I", help=argparse.SUPPRESS)
    sweep.add_argument("--compare", metavar="MAP", help="an earlier map to compare with")
    sweep.add_argument("--picture", help="write a PNG here")
    _add_dtype(sweep, "--float64")

    show = command(_show, "show", "Summary and picture of a stored map.")
    show.add_argument("map")
    show.add_argument("--picture", help="write a PNG here")

    verify = command(_verify, "verify", "Solve goals made by an arm's own joints and judge every answer.")
    verify.add_argument("arm", nargs="*", help="all of the catalogue by default")
    verify.add_argument("-n", type=_count, default=100_000, dest="count", help="random goals an arm")
    verify.add_argument("--out", help="write the table here, as Markdown")
    _add_dtype(verify, "--float32")

    command(_doctor, "doctor", "Versions, devices, and a numeric self-check on this device.")
    return top


SWEEP_ENDS = f"""\
Beside a map in a folder lies its diary, MAP.log. Exit codes:
  0    swept, and something is reached
  1    swept, and nothing is reached
  2    bad input, a map of another study, another writer at work
  3    the map cannot be written; the units before that are whole
  {TIME_IS_UP}    --max-hours are over; go on with --resume
  {OTHERS_ENDED}    another process of --distributed ended early; go on with --resume
  130  stopped by SIGINT (Ctrl-C), 143 by SIGTERM; go on with --resume
"""


def _add_dtype(parser: argparse.ArgumentParser, flag: str) -> None:
    parser.add_argument(flag, action="store_true", dest="other_dtype", help=f"compute in {flag[2:]}")


def _plain(text: str) -> str:
    """Text without control characters, which a name could use to write over the terminal."""
    return "".join(c if c.isprintable() or c == "\n" else repr(c)[1:-1] for c in text)


def _say(options, text: str, data: dict) -> None:
    print(json.dumps(data, allow_nan=False) if options.json else _plain(text))


def _verify(options) -> int:
    dtype = np.float32 if options.other_dtype else np.float64
    reports = [
        ikjax.verify(recipe.find_arm(name), options.count, dtype=dtype)
        for name in options.arm or ikjax.robots.names()
    ]
    head = ("arm", "family", "type", "goals", "success", "wrong", "none", "missing", "singular", "worst")
    rows = [[*map(str, report[:-1]), f"{report.worst:.1e}"] for report in reports]
    lines = ["| " + " | ".join(row) + " |" for row in (head, ["---"] * len(head), *rows)]
    if options.out:
        pathlib.Path(options.out).write_text("\n".join(lines) + "\n")
    width = [max(len(row[k]) for row in (head, *rows)) for k in range(len(head))]
    text = ["  ".join(cell.ljust(w) for cell, w in zip(row, width, strict=True)) for row in (head, *rows)]
    _say(options, "\n".join(text), {report.arm: report._asdict() for report in reports})
    return 0 if all(report.wrong == report.none == 0 for report in reports) else 1


def _info(options) -> int:
    if options.arm is None:
        arms = [ikjax.robots.get(name) for name in ikjax.robots.names()]
        lines = [f"{arm.name:20} {arm.kinds:7} {arm.family}" for arm in arms]
        catalogue = {arm.name: {"kinds": arm.kinds, "family": arm.family} for arm in arms}
        _say(options, "\n".join(lines), catalogue)
        return 0
    arm = recipe.find_arm(options.arm)
    table = {key: np.asarray(getattr(arm, key)).tolist() for key in ("a", "alpha", "d", "theta")}
    limits = [[x if np.isfinite(x) else None for x in pair] for pair in np.asarray(arm.limits).tolist()]
    data = {"name": arm.name, "kinds": arm.kinds, "family": arm.family, "branches": arm.branches}
    poses = ikjax.robots.poses(options.arm) if options.arm in ikjax.robots.names() else {}
    stands = {name: np.asarray(ikjax.fk(arm, q))[:3, 3].tolist() for name, q in poses.items()}
    lines = [str(arm), "", ikjax.explain(arm)]
    if poses:  # a URDF file names none
        lines.append(f"Named poses ({len(poses)}):")
    for name, q in poses.items():
        lines.append(f"  {name:18} flange at ({_row(stands[name])}) m, q = ({_row(q)})")
    named = {name: {"q": q, "xyz": stands[name]} for name, q in poses.items()}
    _say(options, "\n".join(lines), {**data, **table, "limits": limits, "poses": named})
    return 0


def _row(values) -> str:
    """Numbers to four decimals, and no minus before a zero."""
    return ", ".join(f"{round(x, 4) + 0.0:g}" for x in values)


def _solve(options) -> int:
    dtype = np.float32 if options.other_dtype else np.float64
    arm = recipe.find_arm(options.arm)
    goal = ikjax.pose(options.xyz, rpy=options.rpy, wxyz=options.wxyz, dtype=dtype)
    ikjax.check_goals(arm, goal)
    sol = ikjax.solve(arm, goal, q_now=options.q_now)
    inside = ikjax.within_limits(arm, sol)
    turn = ("rad", 1.0, 4) if options.radians else ("deg", 180 / np.pi, 2)
    units = [turn if kind == "R" else ("mm", 1000.0, 1) for kind in arm.kinds]
    rows = []
    for slot, name in enumerate(arm.branches):
        rows.append(
            {
                "slot": slot,
                "branch": name,
                "valid": bool(sol.valid[slot]),
                "within_limits": bool(inside.valid[slot]),
                "margin": float(sol.margin[slot]),
                "continuum": bool(sol.continuum[slot]),
                "q": np.asarray(inside.q[slot], float).tolist(),
            }
        )
    count, within = int(sol.valid.sum()), int(inside.valid.sum())
    lines = [f"{arm.name}: {count} of {len(rows)} branches reach the goal, {within} within the joint limits"]
    joints = "".join(f"{f'q{i} [{unit}]':>11}" for i, (unit, _, _) in enumerate(units, 1))
    lines.append(f"slot  {'branch':18} valid  limits {joints}  margin [mm]")
    for row in rows:
        marks = f"{'yes' if row['valid'] else '-':5}  {'yes' if row['within_limits'] else '-':6} "
        values = zip(row["q"], units, strict=True)
        joints = "".join(f"{x * scale:11.{digits}f}" for x, (_, scale, digits) in values)
        note = "  one joint is arbitrary" if row["continuum"] else ""
        lines.append(
            f"{row['slot']:4}  {row['branch']:18} {marks}{joints} {1000 * row['margin']:12.1f}{note}"
        )
    _say(options, "\n".join(lines), {"arm": arm.name, "goal": goal.tolist(), "branches": rows})
    return 0 if (within if options.limits else count) else 1


def _check_places(options) -> None:
    """Raise now what a sweep would find out at its end: nothing to draw with, nowhere to write."""
    out = getattr(options, "out", None)
    if options.picture:
        pathlib.Path(options.picture).absolute().parent.mkdir(parents=True, exist_ok=True)
    if out:
        Place(out)
    if options.picture:
        from ikjax import plot

        kinds = plot.file_types()
        if pathlib.Path(options.picture).suffix[1:].lower() not in kinds:
            raise ValueError(f"--picture must end in one of {', '.join(kinds)}, got {options.picture!r}")


def _study(options) -> recipe.Recipe:
    """What is asked for, by a file or by options."""
    if options.arm.endswith(".toml"):
        for name in ("spacing", "orientations", "other_dtype"):
            if getattr(options, name):
                flag = "float64" if name == "other_dtype" else name
                raise ValueError(f"--{flag} is for {options.arm} to say")
        return recipe.read(options.arm)
    arm = recipe.find_arm(options.arm)
    orientations = 512 if options.orientations is None else options.orientations
    positions = ikjax.around(arm, options.spacing or 0.05)
    dtype = "float64" if options.other_dtype else "float32"
    return recipe.Recipe(arm, positions, orientations, 1, recipe.STATISTICS, None, dtype)


def _join(options) -> None:
    """Become one of several processes, before jax computes anything."""
    explicit = (options.coordinator, options.processes, options.process)
    if not options.distributed:
        if any(given is not None for given in explicit):
            raise ValueError("--coordinator, --processes and --process go with --distributed")
        return
    if not options.out:
        raise ValueError("--distributed needs --out, a place that all processes can write to")
    if any(given is None for given in explicit) and any(given is not None for given in explicit):
        raise ValueError("--coordinator, --processes and --process go together")
    try:
        jax.distributed.initialize(*explicit)
    except RuntimeError as error:
        raise ValueError(f"--distributed: {error}") from error


def _sweep(options) -> int:
    _join(options)
    study = _study(options)
    _check_places(options)
    if (options.resume or options.force) and not options.out:
        flag = "--resume" if options.resume else "--force"
        raise ValueError(f"{flag} needs --out, the map to go on with or to replace")
    earlier = ikjax.ReachMap.load(options.compare) if options.compare else None
    # Read now: the earlier map may be the one that is replaced.
    earlier = earlier and dataclasses.replace(earlier, arrays=earlier.to_numpy())
    positions = math.prod(study.positions.shape)
    if positions >= 2**31:
        raise ValueError(f"--spacing asks for {positions:.2g} positions, 2^31 or more")
    leads = jax.process_index() == 0
    if leads and not options.json:
        count = as_orientations(study.orientations).count
        print(_plain(f"sweeping {study.arm.name}: {positions * count:,} goals"), file=sys.stderr)
    with Stop(options.max_hours) as stop:
        try:
            reach = ikjax.sweep(
                **study._asdict(),
                out=options.out,
                resume=options.resume,
                force=options.force,
                progress=leads and not options.json,
                stop=stop,
            )
        except SweepStoppedError as stopped:
            _complain(stopped)
            return stop.code or OTHERS_ENDED
        except StorageError as error:
            _complain(error)
            return 3
    return _report(options, reach, earlier) if leads else 0


def _show(options) -> int:
    _check_places(options)
    return _report(options, ikjax.ReachMap.load(options.map))


def _report(options, reach: ikjax.ReachMap, earlier: ikjax.ReachMap | None = None) -> int:
    text = reach.summary()
    data: dict[str, Any] = {"arm": reach.arm.name, **reach.numbers()}
    if reach.units is not None:
        text += f"\n  map               {options.out}: {reach.units}"
        data["units"] = reach.units._asdict()
    if options.picture:
        from ikjax import plot

        plot.reach_map(reach, options.picture)
        text += f"\n  picture           {options.picture}"
    if earlier is not None:
        data["compared"] = compare.compare(earlier, reach)
        text += f"\n{compare.in_words(data['compared'], options.compare)}"
    _say(options, text, data)
    return 0 if data["positions_reachable"] > 0 else 1


def _doctor(options) -> int:
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
    _say(options, "\n".join(lines), data)
    return 0 if all(check["ok"] for check in checks) else 1


def _self_check(dtype: np.dtype) -> list[dict]:
    """Trigonometry against numpy's long double, and a thousand goals of one arm."""
    from ikjax.core import trig

    rng = np.random.default_rng(0)
    x, y = (rng.normal(size=10_000).astype(dtype) for _ in range(2))
    far = (x * dtype.type(1e4)).astype(dtype)
    exact = [v.astype(np.longdouble) for v in (x, y, far)]
    trig_allowed = 3e-7 if dtype == np.float32 else 6.7e-16

    def check(what: str, worst, allowed: float) -> dict:
        worst = float(worst)
        return {"what": f"{dtype} {what}", "worst": worst, "allowed": allowed, "ok": worst <= allowed}

    sine, cosine = jax.jit(trig.sincos)(far)
    angle = jax.jit(trig.atan2)(y, x)
    arm = ikjax.robots.get("puma560").astype(dtype)
    q = rng.uniform(-np.pi, np.pi, (1000, 6)).astype(dtype)
    sol = ikjax.solve(arm, ikjax.fk(arm, q))
    reached, turned = ikjax.pose_error(ikjax.fk(arm, sol.q), ikjax.fk(arm, q)[:, None])
    small = dtype == np.float32  # its poses near a singularity do not hold the joints any more
    tolerance = 2e-5 if small else 1e-9
    off = np.maximum(np.asarray(reached) / 2, np.asarray(turned))
    missed = np.abs(np.asarray(trig.wrap(sol.q - q[:, None]))).max(-1).min(-1)
    return [
        check("sin", np.abs(np.asarray(sine) - np.sin(exact[2])).max(), trig_allowed),
        check("cos", np.abs(np.asarray(cosine) - np.cos(exact[2])).max(), trig_allowed),
        check("atan2 [rad]", np.abs(np.asarray(angle) - np.arctan2(exact[1], exact[0])).max(), trig_allowed),
        check("pose of every valid branch", np.where(sol.valid, off, 0).max(), tolerance * 2),
        check("goals without a branch, share", (~np.asarray(sol.valid)).all(-1).mean(), 0.0),
        check("generating joints not found, share", (missed > 1e-2).mean(), 0.01 if small else 0.0),
    ]


if __name__ == "__main__":
    sys.exit(main())
