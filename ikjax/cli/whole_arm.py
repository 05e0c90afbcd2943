"""The arm as it stands in a cell: a robot by its name or file, and what is said of it beside that.

    base, tip         links of a file where the arm starts and ends
    axis_tolerance    as in `Arm.from_urdf`
    fixed_joints      joints that do not move, by name, with their values [rad, m]
    tool              T_tip_tool: from the file's tip, or the catalogue's flange, to the point that works
    mount             T_world_base: where the robot stands

Options of a command and keys of a study file have the same names. Angles of options are in degrees unless
--radians is given.
"""

import argparse
import dataclasses
import math
import os
import pathlib
import warnings
from collections.abc import Mapping
from typing import Any, cast

import numpy as np

from ikjax.arm import robots
from ikjax.arm.arm import Arm
from ikjax.arm.axes_to_dh import Axes, rewritten
from ikjax.arm.forward import frames
from ikjax.arm.load import is_mujoco
from ikjax.arm.recognition import lock, recognize
from ikjax.core.pose import pose
from ikjax.core.tolerances import AXIS_LADDER, FACT

FILE_KEYS = ("base", "tip")
"""Only a file's arm has links."""
KEYS = (*FILE_KEYS, "axis_tolerance", "fixed_joints", "tool", "mount")


def add_options(parser: argparse.ArgumentParser) -> None:
    """The options that every command takes of an arm."""
    group = parser.add_argument_group("the arm as it stands in the cell")
    group.add_argument("--base", metavar="LINK", help="where a file's arm begins; by default the root")
    group.add_argument("--tip", metavar="LINK", help="where it ends; by default the one leaf")
    group.add_argument("--axis-tolerance", type=float, help="how far its axes may be off, 1e-5 by default")
    group.add_argument(
        "--fixed-joints",
        nargs="+",
        metavar="NAME=VALUE",
        help="joints that do not move [deg, m]; without names joint1, joint2, ...",
    )
    numbers: dict[str, Any] = {"nargs": "+", "type": float, "metavar": ("X Y Z", "R P Y")}
    group.add_argument("--tool", **numbers, help="from the tip or flange to the tool: [m], then [deg]")
    group.add_argument("--mount", **numbers, help="where the robot stands in the world: [m], then [deg]")
    group.add_argument("--radians", action="store_true", help="angles in radians, given and printed")


def angle_unit(options) -> float:
    """One unit of the command's angles [rad]."""
    return 1.0 if options.radians else math.pi / 180


def turn_of(options) -> dict[str, Any]:
    """The orientation that the options of a goal give, as an argument of `ikjax.pose`."""
    forms = {"rpy": angle_unit(options), "wxyz": 1.0, "xyzw": 1.0, "rotvec": angle_unit(options)}
    given = {form: getattr(options, form) for form in forms}
    return {form: np.asarray(x) * forms[form] for form, x in given.items() if x is not None}


def from_options(options, name: str) -> Arm:
    """The arm of that name, file or study file, as the options of a command say.

    Raises:
        ValueError, OSError: As `find_arm`.
    """
    if name.lower().endswith(".toml"):
        from ikjax.cli.study_file import arm_of

        return arm_of(name, options)
    return find_arm(name, angle=angle_unit(options), **given_by(options))


def given_by(options) -> dict[str, Any]:
    """What the options of `add_options` say of the arm, as arguments of `find_arm`."""
    given = {key: value for key in KEYS if (value := getattr(options, key, None)) is not None}
    for key in ("tool", "mount"):
        if key in given:
            given[key] = six_numbers(f"{key}=", given[key], angle_unit(options))
    if "fixed_joints" in given:
        given["fixed_joints"] = dict(map(_named_value, given["fixed_joints"]))
    return given


def six_numbers(name: str, values, unit: float) -> np.ndarray:
    """A pose (4, 4) from three numbers, a position [m], or six: with roll, pitch and yaw in `unit` [rad]."""
    values = np.asarray(values, float)
    if values.shape not in ((3,), (6,)):
        raise ValueError(f"{name} takes 3 numbers (x y z) or 6 (and roll pitch yaw), got {values.size}")
    rpy = None if len(values) == 3 else values[3:] * unit
    return np.asarray(pose(values[:3], rpy=rpy), float)


def _named_value(text: str) -> tuple[str, float]:
    name, equals, value = text.rpartition("=")
    try:
        if not equals:
            raise ValueError
        return name, float(value)
    except ValueError:
        raise ValueError(f"fixed_joints= takes NAME=VALUE, got {text!r}") from None


def find_arm(
    name: str,
    folder: pathlib.Path | None = None,
    *,
    base: str | None = None,
    tip: str | None = None,
    axis_tolerance: float | None = None,
    fixed_joints: Mapping[str, float] | None = None,
    tool: np.ndarray | None = None,
    mount: np.ndarray | None = None,
    angle: float = 1.0,
) -> Arm:
    """An arm of the catalogue, or of a file, as it stands in the cell.

    A name that is not in the catalogue is a file's name if the file exists or the name ends in .urdf or .xml.
    Of a MuJoCo model, `tip` is a site or a body, and `base` a body.

    Args:
        name: Of the arm, or the path of the file.
        folder: Where a relative path starts.
        base, tip, axis_tolerance: As in `Arm.from_urdf`.
        fixed_joints: Values of joints that do not move; revolute ones in `angle`, others in metres.
        tool: (4, 4) from the tip of the file, or the flange, to the tool.
        mount: (4, 4) T_world_base.
        angle: One unit of the angles [rad].

    Raises:
        ValueError: Neither a file nor a name of the catalogue; an option of files given with such a name; a
            joint that the arm does not have.
        OSError: The file cannot be read.
    """
    options: dict[str, Any] = {"base": base, "tip": tip, "axis_tolerance": axis_tolerance}
    options = {key: value for key, value in options.items() if value is not None}
    path = pathlib.Path(name) if folder is None else folder / name
    known = name in robots.names()
    if not known and (name.lower().endswith((".urdf", ".xml")) or os.path.isfile(path)):
        arm = _of_file(path, options)
    elif known and options:
        raise ValueError(f"{'= and '.join(options)}= goes with a URDF file, {name} is of the catalogue")
    else:
        try:
            arm = robots.get(name)
        except ValueError as error:
            raise ValueError(f"no such file, and {error}") from None
    if fixed_joints:
        arm = with_fixed_joints(arm, fixed_joints, angle, axis_tolerance)
    if tool is not None:
        arm = with_tool(arm, tool)
    if mount is not None:
        arm = dataclasses.replace(arm, base=np.asarray(mount, arm.dtype) @ np.asarray(arm.base))
    return arm


def _of_file(path: pathlib.Path, options: dict[str, Any]) -> Arm:
    """The arm of a URDF file or of a MuJoCo model."""
    if not is_mujoco(str(path)):
        return Arm.from_urdf(path, **options)
    tip = options.pop("tip", None)
    if tip is None:
        return Arm.from_mujoco(str(path), **options)
    try:
        return Arm.from_mujoco(str(path), site=tip, **options)
    except ValueError as no_site:
        try:
            return Arm.from_mujoco(str(path), body=tip, **options)
        except ValueError:
            raise no_site from None


def with_tool(arm: Arm, T_tip_tool: np.ndarray) -> Arm:
    """The arm with a tool beyond the one that it has.

    An arm of few joints may have its closed form from where the tool is; then it is recognized anew.
    """
    tool = np.asarray(arm.tool, float) @ T_tip_tool
    moved = dataclasses.replace(arm, tool=np.asarray(tool, arm.dtype))
    if arm.family is None:
        return moved
    numbers: dict[str, Any] = {
        key: np.asarray(getattr(moved, key), float) for key in ("a", "alpha", "d", "theta", "tool")
    }
    tolerance = recognize.tolerance_of(arm.dtype)
    if all(x.holds for x in recognize.evidence(arm.kinds, numbers, arm.family, tolerance, arm.locked)):
        return moved
    leaves = {key: getattr(moved, key) for key in ("base", "limits", "coupling", "correction")}
    again = Arm.from_dh(
        **numbers, **leaves, convention="standard", kinds=arm.kinds, name=arm.name, dtype=arm.dtype
    )
    return dataclasses.replace(again, joint_names=arm.joint_names)


def with_fixed_joints(
    arm: Arm, values: Mapping[str, float], angle: float = 1.0, axis_tolerance: float | None = None
) -> Arm:
    """The arm of the other joints, where some do not move.

    Args:
        arm: Without coupled joints.
        values: By name; revolute joints in `angle`, others in metres.
        angle: One unit of the angles [rad].
        axis_tolerance: As in `Arm.from_dh`; 1e-3 at most by default.

    Raises:
        ValueError: A joint that the arm does not have, no joint left, or coupled joints.
    """
    names = arm.joint_names or lock.numbered(arm.n)
    if unknown := [name for name in values if name not in names]:
        raise ValueError(f"fixed_joints: no joint {', '.join(unknown)}; the arm has {', '.join(names)}")
    if arm.coupling is not None:
        raise ValueError("fixed_joints is for arms without coupled joints")
    rest = [i for i, name in enumerate(names) if name not in values]
    if not rest:
        raise ValueError("fixed_joints leaves no joint that moves")
    q = [values.get(name, 0.0) for name in names]
    q = [x * angle if kind == "R" else x for x, kind in zip(q, arm.kinds, strict=True)]
    at_origin = dataclasses.replace(arm, base=np.eye(4, dtype=arm.dtype))
    placed = np.asarray(frames(at_origin, q), float)
    axes = Axes(
        "".join(arm.kinds[i] for i in rest),
        placed[rest, :3, 2],
        placed[rest, :3, 3],
        placed[-1] @ np.asarray(arm.tool, float),
    )
    ladder = (FACT, *AXIS_LADDER) if axis_tolerance is None else (axis_tolerance,)
    tried = [_of_axes(arm, axes, rest, tolerance) for tolerance in ladder[:1]]
    while tried[-1].family is None and len(tried) < len(ladder):
        tried.append(_of_axes(arm, axes, rest, ladder[len(tried)]))
    best = tried[-1] if tried[-1].family is not None else tried[0]
    return dataclasses.replace(best, joint_names=tuple(names[i] for i in rest))


def _of_axes(arm: Arm, axes: Axes, rest: list[int], tolerance: float) -> Arm:
    """The arm of the axes that are left of another, of that name, base and limits."""
    table = rewritten(axes, tolerance)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of a table that a looser tolerance would make faster
        return Arm.from_dh(
            **cast(dict[str, Any], table.columns),
            convention="standard",
            kinds=axes.kinds,
            limits=np.asarray(arm.limits)[rest],
            base=np.asarray(arm.base, float) @ table.base,
            tool=table.tool,
            correction=None if np.abs(table.correction).max() <= FACT else table.correction,
            name=arm.name,
            dtype=arm.dtype,
        )
