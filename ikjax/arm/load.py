"""An arm from whatever holds one: a file, a name of the catalogue or of robot_descriptions, a model."""

import importlib
import os
from typing import Any

from ikjax.arm import robots
from ikjax.arm.arm import Arm
from ikjax.arm.urdf.xml import ArmFileError, quote


def load(source: Any, **options: Any) -> Arm:
    """An arm in one line.

    Args:
        source: A name of the catalogue ("ur5e"); a name of robot_descriptions ("panda_description",
            "panda_mj_description", extra `descriptions`); a path of a URDF, xacro, MJCF or MJB file, or the
            XML as text; a `yourdfpy.URDF`; a `mujoco.MjModel` or `MjSpec`.
        options: As `Arm.from_urdf` takes them (`base`, `tip`, `fixed_joints`, ...), or `Arm.from_mujoco`
            (`base`, `site`, `body`, ...). An arm of the catalogue takes none.

    Returns:
        The arm; its `joint_names` are those of the file.

    Warns:
        As `Arm.from_urdf` and `Arm.from_mujoco`: among others where the tip is guessed.

    Raises:
        ValueError: No such name; as the two.
        ArmFileError: As the two; a description that robot_descriptions cannot get, as when the network is off
            and its cache does not hold it.
        ImportError: An extra is not installed.
        OSError: The file cannot be read.
    """
    if isinstance(source, str) and _is_name(source):
        if source in robots.names():
            if options:
                raise ValueError(f"an arm of the catalogue takes no options, got {', '.join(options)}")
            return robots.get(source)
        if not source.endswith("_description"):
            raise ValueError(
                f"no arm {source!r}: give a file, a name of the catalogue (ikjax.robots.find()), or one of "
                "robot_descriptions, which ends in _description"
            )
        source = _described(source)
    return Arm.from_mujoco(source, **options) if is_mujoco(source) else Arm.from_urdf(source, **options)


def _is_name(source: str) -> bool:
    return source.isidentifier() and not os.path.exists(source)


def _described(name: str) -> str:
    """The path of a description's file, which robot_descriptions gets once and keeps."""
    try:
        importlib.import_module("robot_descriptions")
    except ImportError as error:
        raise ImportError(
            f'{name} is got by robot_descriptions: pip install "ikjax[descriptions]"'
        ) from error
    try:
        module = importlib.import_module(f"robot_descriptions.{name}")
    except ModuleNotFoundError as error:
        raise ValueError(f"robot_descriptions has no {quote(name)}") from error
    except Exception as error:
        # What git raises where the network is off is a type of GitPython's own.
        raise ArmFileError(f"robot_descriptions cannot get {quote(name)}: {error}") from error
    if hasattr(module, "MJCF_PATH"):
        return str(module.MJCF_PATH)
    # Expands xacro where the description is one, with the arguments that it wants.
    return str(importlib.import_module("robot_descriptions._xacro").get_urdf_path(module))


def is_mujoco(source: Any) -> bool:
    """Whether MuJoCo reads it: a model, a path with its suffix, or XML whose first element says so."""
    if type(source).__module__.split(".")[0] == "mujoco":
        return True
    if isinstance(source, bytes):
        return b"<mujoco" in source
    if isinstance(source, str) and source.lstrip("\ufeff \t\r\n").startswith("<"):
        return "<mujoco" in source
    if isinstance(source, str | os.PathLike):
        name = os.fsdecode(source)
        if name.lower().endswith(".xml"):
            with open(name, "rb") as file:
                return b"<mujoco" in file.read(2**16)
        return name.lower().endswith((".mjb", ".mjcf"))
    return False
