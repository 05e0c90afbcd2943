"""`ikjax info` and `ikjax convert`: what an arm is."""

import os

import numpy as np

import ikjax
from ikjax.cli import whole_arm
from ikjax.cli.output import print_result, with_flags
from ikjax.cli.solving import shown


def run_info(options) -> int:
    words = options.find if options.find is not None else _as_words(options)
    if words is not None:
        arms = [ikjax.robots.get(name) for name in ikjax.robots.find(*words)]
        if not arms:
            raise ValueError(f"no arm of the catalogue has {' and '.join(words)}")
        lines = [f"{arm.name:20} {arm.kinds:7} {arm.family}" for arm in arms]
        catalogue = {arm.name: {"kinds": arm.kinds, "family": arm.family} for arm in arms}
        print_result(options, "\n".join(lines), catalogue)
        return 0
    arm = whole_arm.from_options(options, options.arm)
    look = shown(options, arm)
    poses = ikjax.robots.poses(options.arm) if options.arm in ikjax.robots.names() else {}
    if options.fixed_joints:
        poses = {}  # they are of all joints
    flanges = {name: np.asarray(ikjax.fk(arm, q))[:3, 3].tolist() for name, q in poses.items()}
    lines = [str(arm), "", with_flags(options, ikjax.explain(arm))]
    if poses:  # a URDF file has none
        end = "tool" if options.tool else "flange"
        lines.append(f"Named poses ({len(poses)}), q in {_units(look.units)}:")
    for name, q in poses.items():
        values = _in_decimals(np.asarray(q) * look.scales)
        lines.append(f"  {name:18} {end} at ({_in_decimals(flanges[name])}) m, q = ({values})")
    named = {name: {"q": q, "xyz": flanges[name]} for name, q in poses.items()}
    print_result(options, "\n".join(lines), {**arm_data(arm), "poses": named})
    return 0


def _as_words(options) -> tuple[str, ...] | None:
    """The words to look for in the catalogue: none at all, or one that is no arm and no file."""
    name = options.arm
    if name is None:
        return ()
    is_arm = name in ikjax.robots.names() or os.path.exists(name)
    return (name,) if not is_arm and name.isalnum() and ikjax.robots.find(name) else None


def _units(units: list[str]) -> str:
    return units[0] if len(set(units)) == 1 else ", ".join(units)


def _in_decimals(values) -> str:
    """Numbers to four decimals, without a minus before a zero."""
    return ", ".join(f"{round(x, 4) + 0.0:g}" for x in values)


def run_convert(options) -> int:
    """The arm as a call of `Arm.from_dh`, to be pasted into Python."""
    arm = whole_arm.from_options(options, options.arm)
    print_result(options, str(arm), arm_data(arm))
    return 0


def arm_data(arm: ikjax.Arm) -> dict:
    """An arm as JSON, in radians and metres."""
    leaves = ("a", "alpha", "d", "theta", "base", "tool", "coupling", "correction")
    table = {key: None if (x := getattr(arm, key)) is None else np.asarray(x).tolist() for key in leaves}
    limits = [[x if np.isfinite(x) else None for x in pair] for pair in np.asarray(arm.limits).tolist()]
    facts = {"name": arm.name, "kinds": arm.kinds, "family": arm.family, "branches": arm.branches}
    return {**facts, "joint_names": arm.joint_names, **table, "limits": limits}
