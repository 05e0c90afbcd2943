"""`ikjax solve`, `ikjax project` and `ikjax track`: joints of one goal, or of a CSV file of goals."""

from typing import Any, NamedTuple

import numpy as np

import ikjax
from ikjax.arm.recognition import lock
from ikjax.cli import table, whole_arm
from ikjax.cli.output import print_result


class Shown(NamedTuple):
    """How the joints of an arm are printed."""

    units: list[str]
    """Of each joint."""
    scales: np.ndarray
    """What radians and metres are multiplied by."""
    digits: list[int]
    names: tuple[str, ...]

    @property
    def headings(self) -> list[str]:
        """For tables: q1 [deg], ..."""
        return [f"q{i} [{unit}]" for i, unit in enumerate(self.units, 1)]

    @property
    def columns(self) -> list[str]:
        """For CSV files: the joints' own names."""
        return [f"{name} [{unit}]" for name, unit in zip(self.names, self.units, strict=True)]

    def row(self, q) -> str:
        """Joints (n,) as cells of a table."""
        values = zip(np.asarray(q, float) * self.scales, self.digits, strict=True)
        return "".join(f"{round(x, digits) + 0.0:11.{digits}f}" for x, digits in values)

    def cells(self, q) -> list[str]:
        """Joints (n,) as cells of a CSV file."""
        return [f"{x:.12g}" for x in np.asarray(q, float) * self.scales]


def shown(options, arm: ikjax.Arm) -> Shown:
    """Angles as the command prints them, slides in metres."""
    angle = ("rad", 1.0, 4) if options.radians else ("deg", 180 / np.pi, 2)
    kinds = [angle if kind == "R" else ("m", 1.0, 4) for kind in arm.kinds]
    units, scales, digits = zip(*kinds, strict=True)
    return Shown(list(units), np.array(scales), list(digits), arm.joint_names or lock.numbered(arm.n))


def _joints(options, arm: ikjax.Arm, name: str, count: int | None = None) -> np.ndarray | None:
    """Joints that an option gives, in radians and metres; None where it is not given."""
    given = getattr(options, name)
    if given is None:
        return None
    scales = shown(options, arm).scales
    wanted = arm.n if count is None else count
    if len(given) != wanted:
        flag = {"start": "from"}.get(name, name)
        raise ValueError(f"--{flag} takes {wanted} values for {arm.name}, got {len(given)}")
    return np.asarray(given) / (scales if count is None else scales[list(arm.locked)])


def _goals(options, arm: ikjax.Arm) -> tuple[np.ndarray, bool]:
    """The goals (n, 4, 4) of the options, and whether they come from a file."""
    if (options.xyz is None) == (options.goals is None):
        raise ValueError("give a goal with --xyz, or a CSV file of goals with --goals")
    if options.goals is not None:
        goals = table.read_goals(options.goals, whole_arm.angle_unit(options), whole_arm.turn_of(options))
    else:
        goals = np.asarray(ikjax.pose(options.xyz, **whole_arm.turn_of(options)))[None]
    goals = goals.astype(np.float32 if options.other_dtype else np.float64)
    ikjax.check_goals(arm, goals)
    return goals, options.goals is not None


def _angle(options) -> tuple[str, float]:
    return ("rad", 1.0) if options.radians else ("deg", 180 / np.pi)


def run_solve(options) -> int:
    arm = whole_arm.from_options(options, options.arm)
    goals, many = _goals(options, arm)
    start = _joints(options, arm, "start")
    given = None if options.redundancy is None else _joints(options, arm, "redundancy", len(arm.locked))
    given = given[0] if given is not None and len(given) == 1 else given
    q_now = None if start is None else start.astype(goals.dtype)
    sol = ikjax.solve(arm, goals, q_now=q_now, redundancy=given)
    inside = ikjax.within_limits(arm, sol, q_now)
    look = shown(options, arm)
    rows: list[list[dict[str, Any]]] = [
        [
            {
                "slot": slot,
                "branch": name,
                "valid": bool(sol.valid[k, slot]),
                "within_limits": bool(inside.valid[k, slot]),
                "margin": float(sol.margin[k, slot]),
                "continuum": bool(sol.continuum[k, slot]),
                "q": np.asarray(inside.q[k, slot], float).tolist(),
            }
            for slot, name in enumerate(arm.branches)
        ]
        for k in range(len(goals))
    ]
    nearest = None
    if start is not None:
        nearest = np.asarray(_nearest_slots(arm, inside, start))
    reached = np.asarray((inside if options.limits else sol).valid).any(-1)
    if options.csv:
        _write_solutions(options, look, rows)
    lines = _in_lines(arm, look, rows, nearest, many)
    if options.explain:
        for k, goal in enumerate(goals):
            lines += ["", f"goal {k}"] if many else [""]
            lines.append(ikjax.explain(arm, goal, redundancy=given, q_now=q_now))
    if many:
        data: dict[str, Any] = {
            "arm": arm.name,
            "goals": [
                {"goal": goal.tolist(), "branches": each} for goal, each in zip(goals, rows, strict=True)
            ],
        }
    else:
        data = {"arm": arm.name, "goal": goals[0].tolist(), "branches": rows[0]}
    if nearest is not None:
        data["nearest"] = [None if k < 0 else int(k) for k in nearest] if many else int(nearest[0])
    print_result(options, "\n".join(lines), {**data, "units": JSON_UNITS})
    return 0 if reached.all() else 1


JSON_UNITS = {"angle": "rad", "length": "m"}
"""Of every number in JSON, whatever the units of the options are."""


def _nearest_slots(arm: ikjax.Arm, sol: ikjax.Solutions, start: np.ndarray) -> np.ndarray:
    """Of each goal the slot whose joints are nearest to given ones, by the largest move; -1 without one."""
    move = np.abs(np.asarray(sol.q, float) - start).max(-1)
    move = np.where(np.asarray(sol.valid), move, np.inf)
    return np.where(np.isfinite(move).any(-1), move.argmin(-1), -1)


def _in_lines(arm: ikjax.Arm, look: Shown, rows: list[list[dict]], nearest, many: bool) -> list[str]:
    """What `solve` prints: a table of one goal, or a line for each goal."""
    if many:
        lines = [f"{arm.name}: {len(rows)} goals", "goal  branches  within limits"]
        for k, each in enumerate(rows):
            note = (
                "" if nearest is None or nearest[k] < 0 else f"  nearest: {look.row(each[nearest[k]]['q'])}"
            )
            counts = sum(row["valid"] for row in each), sum(row["within_limits"] for row in each)
            lines.append(f"{k:4}  {counts[0]:8}  {counts[1]:13}{note}")
        if nearest is not None:
            lines[1] += f"  joints: {', '.join(look.headings)}"
        return lines
    one = rows[0]
    count, within = sum(row["valid"] for row in one), sum(row["within_limits"] for row in one)
    lines = [f"{arm.name}: {count} of {len(one)} branches reach the goal, {within} within the joint limits"]
    joints = "".join(f"{heading:>11}" for heading in look.headings)
    width = max(map(len, ("branch", *arm.branches)))
    lines.append(f"slot  {'branch':{width}} valid  limits {joints}  margin [mm]")
    for row in one:
        marks = f"{'yes' if row['valid'] else '-':5}  {'yes' if row['within_limits'] else '-':6} "
        note = "  one joint is arbitrary" if row["continuum"] else ""
        note += "  nearest" if nearest is not None and nearest[0] == row["slot"] else ""
        lines.append(
            f"{row['slot']:4}  {row['branch']:{width}} {marks}{look.row(row['q'])} "
            f"{1000 * row['margin']:12.1f}{note}"
        )
    return lines


def _write_solutions(options, look: Shown, rows: list[list[dict]]) -> None:
    names = ["goal", "slot", "branch", "within_limits", "margin [m]", *look.columns]
    cells = [
        [
            k,
            row["slot"],
            row["branch"],
            int(row["within_limits"]),
            f"{row['margin']:.9g}",
            *look.cells(row["q"]),
        ]
        for k, each in enumerate(rows)
        for row in each
        if row["valid"]
    ]
    table.write(options.csv, names, cells)


def run_project(options) -> int:
    arm = whole_arm.from_options(options, options.arm)
    goals, _ = _goals(options, arm)
    near = ikjax.project(
        arm, goals, characteristic_length=options.characteristic_length, priority=options.priority
    )
    look, (unit, scale) = shown(options, arm), _angle(options)
    # What `solve` calls reached, by what is left.
    result = [
        {
            "q": np.asarray(near.q[k], float).tolist(),
            "position_error": float(near.position_error[k]),
            "rotation_error": float(near.rotation_error[k]),
            "cost": float(near.cost[k]),
            "converged": bool(near.converged[k]),
        }
        for k in range(len(goals))
    ]
    lines = [
        f"{arm.name}: the nearest pose within the joint limits, 1 rad counting as "
        f"{options.characteristic_length:g} m"
    ]
    joints = "".join(f"{heading:>11}" for heading in look.headings)
    lines.append(f"goal  {joints}  off by [mm]  turned by [{unit}]")
    for k, row in enumerate(result):
        note = "" if row["converged"] else "  not converged"
        lines.append(
            f"{k:4}  {look.row(row['q'])} {1000 * row['position_error']:12.3f} "
            f"{scale * row['rotation_error']:16.3f}{note}"
        )
    if options.csv:
        names = ["goal", *look.columns, "position_error [m]", f"rotation_error [{unit}]", "converged"]
        cells = [
            [k, *look.cells(row["q"]), f"{row['position_error']:.9g}",
             f"{scale * row['rotation_error']:.9g}", int(row["converged"])]
            for k, row in enumerate(result)
        ]  # fmt: skip
        table.write(options.csv, names, cells)
    data = {"arm": arm.name, "goals": goals.tolist(), "projections": result, "units": JSON_UNITS}
    print_result(options, "\n".join(lines), data)
    return 0 if all(row["converged"] for row in result) else 1


def run_track(options) -> int:
    arm = whole_arm.from_options(options, options.arm)
    turn = whole_arm.turn_of(options)
    goals = table.read_goals(options.goals, whole_arm.angle_unit(options), turn)
    goals = goals.astype(np.float32 if options.other_dtype else np.float64)
    ikjax.check_goals(arm, goals)
    start = _joints(options, arm, "start")
    if start is None:
        start = _best_start(arm, goals[0])
    path = ikjax.track(
        arm, goals, start.astype(goals.dtype), characteristic_length=options.characteristic_length
    )
    look, (unit, scale) = shown(options, arm), _angle(options)
    flags = {key: np.asarray(getattr(path, key)) for key in ("reached", "followed", "jumped")}
    off, turned = np.asarray(path.position_error, float), np.asarray(path.rotation_error, float)
    counts = ", ".join(f"{int(flag.sum())} {key}" for key, flag in flags.items())
    lines = [f"{arm.name}: {len(goals)} goals, {counts}"]
    joints = "".join(f"{heading:>11}" for heading in look.headings)
    lines.append(f"goal  {joints}  off by [mm]  turned by [{unit}]")
    for k, q in enumerate(np.asarray(path.q, float)):
        note = "  jumped" if flags["jumped"][k] else ""
        lines.append(f"{k:4}  {look.row(q)} {1000 * off[k]:12.3f} {scale * turned[k]:16.3f}{note}")
    if options.csv:
        names = ["goal", *look.columns, "position_error [m]", f"rotation_error [{unit}]", *flags]
        cells = [
            [k, *look.cells(q), f"{off[k]:.9g}", f"{scale * turned[k]:.9g}",
             *(int(flag[k]) for flag in flags.values())]
            for k, q in enumerate(np.asarray(path.q, float))
        ]  # fmt: skip
        table.write(options.csv, names, cells)
    data = {
        "arm": arm.name,
        "q": np.asarray(path.q, float).tolist(),
        **{key: flag.tolist() for key, flag in flags.items()},
        "position_error": off.tolist(),
        "rotation_error": turned.tolist(),
        "units": JSON_UNITS,
    }
    print_result(options, "\n".join(lines), data)
    return 0 if flags["reached"].all() and not flags["jumped"].any() else 1


def _best_start(arm: ikjax.Arm, goal: np.ndarray) -> np.ndarray:
    """Joints at the first goal, where none are given: the nearest pose's."""
    return np.asarray(ikjax.project(arm, goal).q, float)
