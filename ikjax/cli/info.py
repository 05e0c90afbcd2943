"""`ikjax info` and `ikjax solve`: what an arm is, and every branch of one goal."""

import numpy as np

import ikjax
from ikjax.cli import study_file
from ikjax.cli.output import file_options, print_result, with_flags


def run_info(options) -> int:
    if options.arm is None:
        arms = [ikjax.robots.get(name) for name in ikjax.robots.names()]
        lines = [f"{arm.name:20} {arm.kinds:7} {arm.family}" for arm in arms]
        catalogue = {arm.name: {"kinds": arm.kinds, "family": arm.family} for arm in arms}
        print_result(options, "\n".join(lines), catalogue)
        return 0
    arm = study_file.find_arm(options.arm, **file_options(options))
    table = {key: np.asarray(getattr(arm, key)).tolist() for key in ("a", "alpha", "d", "theta")}
    limits = [[x if np.isfinite(x) else None for x in pair] for pair in np.asarray(arm.limits).tolist()]
    data = {"name": arm.name, "kinds": arm.kinds, "family": arm.family, "branches": arm.branches}
    poses = ikjax.robots.poses(options.arm) if options.arm in ikjax.robots.names() else {}
    flanges = {name: np.asarray(ikjax.fk(arm, q))[:3, 3].tolist() for name, q in poses.items()}
    lines = [str(arm), "", with_flags(options, ikjax.explain(arm))]
    if poses:  # a URDF file has none
        lines.append(f"Named poses ({len(poses)}):")
    for name, q in poses.items():
        lines.append(f"  {name:18} flange at ({_in_decimals(flanges[name])}) m, q = ({_in_decimals(q)})")
    named = {name: {"q": q, "xyz": flanges[name]} for name, q in poses.items()}
    print_result(options, "\n".join(lines), {**data, **table, "limits": limits, "poses": named})
    return 0


def _in_decimals(values) -> str:
    """Numbers to four decimals, without a minus before a zero."""
    return ", ".join(f"{round(x, 4) + 0.0:g}" for x in values)


def run_solve(options) -> int:
    dtype = np.float32 if options.other_dtype else np.float64
    arm = study_file.find_arm(options.arm, **file_options(options))
    turn = {form: getattr(options, form) for form in ("rpy", "wxyz", "xyzw", "rotvec")}
    goal = ikjax.pose(options.xyz, **turn, dtype=dtype)
    ikjax.check_goals(arm, goal)
    given = options.redundancy
    given = given[0] if given is not None and len(given) == 1 else given
    sol = ikjax.solve(arm, goal, q_now=options.q_now, redundancy=given)
    inside = ikjax.within_limits(arm, sol, options.q_now)
    angle = ("rad", 1.0, 4) if options.radians else ("deg", 180 / np.pi, 2)
    units = [angle if kind == "R" else ("mm", 1000.0, 1) for kind in arm.kinds]
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
    print_result(options, "\n".join(lines), {"arm": arm.name, "goal": goal.tolist(), "branches": rows})
    return 0 if (within if options.limits else count) else 1
