"""URDF files: a strict reader of the one serial chain from a base link to a tip link.

Kinematics only: meshes, masses, materials and plugins are skipped and never opened.
The file may come from anywhere: nothing is fetched, sizes are bounded, and what is not plainly
right is refused with file, line, element and reason. Branches off the chain must belong to
the one tree of named links and joints, but their joints may be of any type and their numbers are not read.

Source: the URDF specification, wiki.ros.org/urdf/XML/joint and wiki.ros.org/urdf/XML/link.
"""

import os
import re
from collections.abc import Iterable, Mapping
from typing import NamedTuple

import numpy as np

from ikjax.arm import tips
from ikjax.arm.axes_to_dh import Axes
from ikjax.arm.urdf.gripper import Moved, gripper
from ikjax.arm.urdf.mimic import one_joint_a_motor
from ikjax.arm.urdf.xml import ArmFileError, Element, is_xacro, listing, load, parse, quote, show
from ikjax.core.tolerances import LONGEST_LENGTH
from ikjax.core.warn import warn

MAX_JOINTS = 32
"""Of a chain. Longer ones are refused."""

KINDS = {"revolute": "R", "continuous": "R", "prismatic": "P"}
_NUMBER = re.compile(r"[+-]?(\d+(\.\d*)?|\.\d+)([eE][+-]?\d+)?", re.ASCII)
_WORD = re.compile(r"[^ \t\r\n]+")


class UrdfJoint(NamedTuple):
    """A moving joint of the chain."""

    name: str
    kind: str
    """ "R" or "P"."""
    origin: np.ndarray
    """(4, 4) the joint's frame in the child link of the moving joint before it, or in the base link."""
    axis: np.ndarray
    """(3,) unit vector in the joint's frame."""
    lower: float
    """Limit of the leader's value [rad or m], -inf where there is none."""
    upper: float
    """The same, inf where there is none."""
    leader: str
    """The joint that it mimics, or itself."""
    factor: float
    """Its value is that of the leader times this; an offset is part of the origin."""


class UrdfChain(NamedTuple):
    """The moving joints between two links, with the fixed ones folded in."""

    name: str
    base: str
    tip: str
    joints: tuple[UrdfJoint, ...]
    tool: np.ndarray
    """(4, 4) the tip link in the child link of the last moving joint."""

    @property
    def motors(self) -> tuple[str, ...]:
        """Names of the joints that mimic no other, from base to tip."""
        return tuple(joint.name for joint in self.joints if joint.leader == joint.name)


def read_chain(
    source: str | bytes | os.PathLike,
    base: str | None = None,
    tip: str | None = None,
    fixed_joints: Mapping[str, float] | None = None,
) -> UrdfChain:
    """The serial chain of a URDF file.

    Args:
        source: A path, or the XML itself: bytes, or a str that starts with "<".
        base: Name of the first link; by default the one link without a parent.
        tip: Name of the last link, below `base`; by default it is guessed, see `ikjax.arm.tips`.
        fixed_joints: Joints of the chain by name that stay at a value [rad, m].

    Warns:
        Where the tip is guessed, where a revolute joint has no limits, where an axis has no unit length, and
        where the last joints look like a gripper's.

    Raises:
        ArmFileError: The file is not plainly right, or does not hold such a chain.
        ImportError: The extra `urdf` is not installed.
        OSError: The file cannot be read.
    """
    robot, links, named = parse(*load(source))
    tree = _build_tree(robot, links, named.values())
    base, path = _path(tree, base, tip)
    names = {joint.element.attributes.get("name"): joint for joint in path if joint.kind != "fixed"}
    fixed = dict(fixed_joints or {})
    unknown = [name for name in fixed if name not in names]
    if unknown:
        raise tree.robot.error(
            f"fixed_joints names {listing(map(quote, unknown))}, no moving joint of the chain: "
            f"it has {listing(quote(str(name)) for name in names)}"
        )
    moving: list[_Joint] = []
    joints: list[UrdfJoint] = []
    pose = np.eye(4)
    for joint in path:
        pose = pose @ _origin(joint)
        if joint.kind != "fixed":
            leader, factor, offset = _leader(joint, names, fixed)
            kind, axis, (lower, upper) = KINDS[joint.kind], _axis(joint), _limits(joint)
            if leader in fixed:
                # At the value in the file's numbers, as are the limits.
                value = factor * float(fixed[leader]) + offset
                if joint.element.attributes.get("name") == leader and not lower <= value <= upper:
                    raise joint.element.error(
                        f"fixed_joints holds it at {value:g}, outside its limits {lower:g} to {upper:g}"
                    )
                pose = pose @ _moved(kind, axis, value)
                continue
            pose = pose @ _moved(kind, axis, offset)
            if factor == 0:
                continue
            moving.append(joint)
            lower, upper = sorted(((lower - offset) / factor, (upper - offset) / factor))
            joints.append(
                UrdfJoint(joint.element.required("name"), kind, pose, axis, lower, upper, leader, factor)
            )
            pose = np.eye(4)
    end = path[-1].child if path else base
    if not 1 <= len(joints) <= MAX_JOINTS:
        count = f"{len(joints)} moving joints, more than {MAX_JOINTS}," if joints else "no moving joint"
        raise tree.robot.error(f"{count} between links {quote(base)} and {quote(end)}")
    _warn_of_gripper(moving, joints)
    return UrdfChain(tree.robot.attributes.get("name") or "robot", base, end, tuple(joints), pose)


def axes_of(chain: UrdfChain) -> tuple[Axes, np.ndarray | None, list[tuple[float, float]]]:
    """A chain's axes, one for each motor, and how the motors drive them.

    Returns:
        The axes; (n, n) from motor values to joint values, or None where every joint has its own motor; and
        the limits of the motors.

    Raises:
        ArmFileError: Joints that mimic others in a way that needs more joints than motors.
    """
    frame, along, points = np.eye(4), [], []
    for joint in chain.joints:
        frame = frame @ joint.origin
        along.append(frame[:3, :3] @ joint.axis)
        points.append(frame[:3, 3])
    kinds = "".join(joint.kind for joint in chain.joints)
    given = Axes(kinds, np.array(along), np.array(points), frame @ chain.tool)
    motors = chain.motors
    limits = [_motor_limits(chain, motor) for motor in motors]
    if len(motors) == len(kinds):
        return given, None, limits
    rows = np.array([[joint.factor * (joint.leader == motor) for motor in motors] for joint in chain.joints])
    given, rows = one_joint_a_motor(given, rows)
    if len(rows) != len(motors):
        first = next(joint for joint in chain.joints if joint.leader != joint.name)
        raise ArmFileError(
            f"{show(chain.name)}: joint {quote(first.name)} mimics {quote(first.leader)}: among parallel "
            f"neighbors such joints become one a motor, here {len(rows)} are left for {len(motors)} motors. "
            f"Choose base= and tip= on one side of it, or fixed_joints={{{quote(first.leader)}: value}}"
        )
    return given, rows, limits


def _motor_limits(chain: UrdfChain, motor: str) -> tuple[float, float]:
    """The values that a joint and those that mimic it all allow."""
    leader = next(joint for joint in chain.joints if joint.name == motor)
    lower, upper = leader.lower, leader.upper
    for joint in chain.joints:
        # Files often leave the limits of joints that mimic others at 0 and 0: those count as none.
        if joint.leader == motor and joint.lower < joint.upper:
            lower, upper = max(lower, joint.lower), min(upper, joint.upper)
    if lower > upper:
        raise ArmFileError(
            f"{show(chain.name)}: joints that mimic {quote(motor)} leave no value within limits"
        )
    return lower, upper


class _Joint(NamedTuple):
    """A joint of the file, with its type and the names of its links."""

    element: Element
    kind: str
    parent: str
    child: str


class _Tree(NamedTuple):
    """The links and joints of a file."""

    robot: Element
    above: dict[str, _Joint]
    """The joint that carries each link."""
    below: dict[str, list[_Joint]]
    """The joints that each link carries."""


def _build_tree(robot: Element, links: Iterable[str], joints: Iterable[Element]) -> _Tree:
    """Every link with the joints at it; a link with two parents is refused, a cycle only by `_root`."""
    tree = _Tree(robot, {}, {link: [] for link in links})
    if not tree.below:
        raise robot.error("no links")
    for element in joints:
        parent, child = (_end(element, side, tree.below) for side in ("parent", "child"))
        joint = _Joint(element, element.required("type"), parent, child)
        first = tree.above.setdefault(child, joint)
        if first is not joint:
            raise element.error(f"link {quote(child)} has a parent already, by {first.element.label}")
        tree.below[parent].append(joint)
    return tree


def _end(joint: Element, side: str, links: Iterable[str]) -> str:
    """The name of a joint's "parent" or "child" link."""
    if side not in joint.children:
        raise joint.error(f"<{side}> is missing")
    name = joint.children[side].required("link")
    if name not in links:
        raise joint.children[side].error(f"{side} link {quote(name)} does not exist")
    return name


def _root(tree: _Tree) -> str:
    """The one link without a parent, above all others."""
    roots = [link for link in tree.below if link not in tree.above]
    reached = {link for root in roots for link in _walk(tree, root)}
    if len(reached) < len(tree.below):
        link, seen = next(link for link in tree.below if link not in reached), set()
        while link not in seen:
            seen.add(link)
            link = tree.above[link].parent
        raise tree.above[link].element.error(f"link {quote(link)} is in a cycle")
    if len(roots) > 1:
        raise tree.robot.error(f"{len(roots)} root links, expected one: {listing(map(quote, roots))}")
    return roots[0]


def _walk(tree: _Tree, start: str) -> dict[str, int]:
    """A link and all below it, each with the number of moving joints on the way."""
    counts, todo = {start: 0}, [start]
    while todo:
        link = todo.pop()
        for joint in tree.below[link]:
            counts[joint.child] = counts[link] + (joint.kind != "fixed")
            todo.append(joint.child)
    return counts


def _path(tree: _Tree, base: str | None, tip: str | None) -> tuple[str, list[_Joint]]:
    """The base link, and the joints from there to the tip."""
    root = _root(tree)
    base = root if base is None else base
    for key, name in {"base": base, "tip": tip}.items():
        if name is not None and name not in tree.below:
            raise tree.robot.error(f"{key}={quote(name)} is none of {listing(map(quote, tree.below))}")
    counts = _walk(tree, base)
    link = _guessed(tree, base, counts) if tip is None else tip
    if link not in counts:
        raise tree.robot.error(f"tip link {quote(link)} is not below base link {quote(base)}")
    path: list[_Joint] = []
    while link != base:
        path.append(tree.above[link])
        link = path[-1].parent
    return base, [_supported(joint) for joint in path[::-1]]


def _guessed(tree: _Tree, base: str, counts: dict[str, int]) -> str:
    """The tip link where none is given: the one leaf, or a guess, which is reported."""
    leaves = [link for link in counts if not tree.below[link]]
    order = list(counts)
    place = {link: i for i, link in enumerate(order)}
    links = []
    for link in order:
        if link == base:
            links.append(tips.Link(link, -1))
            continue
        joint = tree.above[link]
        name = joint.element.attributes.get("name") or ""
        moved = () if joint.kind == "fixed" else (Moved(name, link, "R", -np.inf, np.inf),)
        mimics = joint.element.children.get("mimic")
        leader = name if mimics is None else mimics.attributes.get("joint") or name
        links.append(tips.Link(link, place[joint.parent], moved, leader))
    guess = tips.guess_tip(links)
    if len(leaves) == 1 and (isinstance(guess, list) or not guess.left_out):
        return leaves[0]
    if isinstance(guess, list):
        listed = listing(f"{quote(leaf)} ({counts[leaf]} moving joints)" for leaf in leaves)
        raise tree.robot.error(f"{len(leaves)} leaf links below {quote(base)}, give one as tip=: {listed}")
    tip = order[guess.link]
    warn(tips.report(str(tree.robot.error("")).rstrip(": "), quote(tip), guess))
    return tip


def _supported(joint: _Joint) -> _Joint:
    if joint.kind != "fixed" and joint.kind not in KINDS:
        raise joint.element.error(f"type {quote(joint.kind)} must be one of fixed, {', '.join(KINDS)}")
    return joint


def _leader(
    joint: _Joint, chain: dict[str | None, _Joint], fixed: Mapping[str, float]
) -> tuple[str, float, float]:
    """The joint that this one mimics in the end, or itself, and the factor and offset to that one's value.

    One that is fixed mimics no other.
    """
    factor, offset, seen = 1.0, 0.0, set()
    while "mimic" in joint.element.children and joint.element.attributes.get("name") not in fixed:
        mimic = joint.element.children["mimic"]
        name = mimic.required("joint")
        seen.add(joint.element.attributes.get("name"))
        if name in seen:
            raise mimic.error(f"mimics {quote(name)}, which mimics it")
        if name not in chain:
            raise mimic.error(
                f"mimics {quote(name)}, no moving joint of the chain: choose base= and tip= with both on one "
                "side, or take the <mimic> out to have it move by itself"
            )
        multiplier, shift = (_numbers(mimic, key, default)[0] for key, default in _MIMIC)
        joint, offset, factor = chain[name], offset + factor * shift, factor * multiplier
    return joint.element.required("name"), factor, offset


_MIMIC = ("multiplier", "1"), ("offset", "0")


def _moved(kind: str, axis: np.ndarray, value: float) -> np.ndarray:
    """(4, 4) the motion of a joint."""
    pose = np.eye(4)
    if kind == "P":
        pose[:3, 3] = value * axis
    elif value:
        x, y, z = axis
        cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
        pose[:3, :3] += np.sin(value) * cross + (1 - np.cos(value)) * cross @ cross
    return pose


def _warn_of_gripper(path: list[_Joint], joints: list[UrdfJoint]) -> None:
    """Warn where the last joints are probably a gripper's and no part of the arm."""
    moved = [Moved(j.name, at.child, j.kind, j.lower, j.upper) for at, j in zip(path, joints, strict=True)]
    count = gripper(moved)
    if count:
        first = path[-count]
        others = listing(quote(joint.name) for joint in joints[len(joints) - count + 1 :])
        reason = f"looks like a gripper's{f', so does {others}' if others else ''}"
        reason += f": leave it out with tip={quote(first.parent)}"
        warn(str(first.element.error(reason)))


def _numbers(element: Element, key: str, default: str) -> list[float]:
    """An attribute that holds as many numbers as its default."""
    text = element.attributes.get(key, default)
    words, wanted = _WORD.findall(text), len(default.split())
    plain = len(words) == wanted and all(map(_NUMBER.fullmatch, words))
    values = [float(word) for word in words] if plain else []
    if not plain or not np.isfinite(values).all():
        hint = ": expand xacro first" if is_xacro(text) else ""
        rule = f"{key} of <{element.tag}> must hold {wanted} plain, finite decimal number{'s'[: wanted - 1]}"
        raise element.error(f"{rule}, got {quote(text)}{hint}")
    return values


def rotation_of(roll: float, pitch: float, yaw: float) -> np.ndarray:
    """(3, 3) Rz(yaw) Ry(pitch) Rx(roll): rotations [rad] about the fixed x, then y, then z."""
    (sr, sp, sy), (cr, cp, cy) = np.sin([roll, pitch, yaw]), np.cos([roll, pitch, yaw])
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )


def _origin(joint: _Joint) -> np.ndarray:
    """(4, 4) the joint's frame in its parent link."""
    pose = np.eye(4)
    element = joint.element.children.get("origin")
    if element is not None:
        pose[:3, 3] = _numbers(element, "xyz", "0 0 0")
        pose[:3, :3] = rotation_of(*_numbers(element, "rpy", "0 0 0"))
        if np.abs(pose[:3, 3]).max() > LONGEST_LENGTH:
            raise element.error(f"xyz of <origin> must be at most {LONGEST_LENGTH:g} m")
    return pose


def _axis(joint: _Joint) -> np.ndarray:
    """(3,) the unit axis in the joint's frame; x where the file has none, as specified."""
    element = joint.element.children.get("axis")
    if element is None:
        return np.array([1.0, 0.0, 0.0])
    element.required("xyz")
    axis = np.array(_numbers(element, "xyz", "1 0 0"))
    largest = float(np.abs(axis).max())
    if largest == 0:
        raise element.error("axis must not be zero")
    # The largest entry is divided out first, so that no square overflows or underflows.
    unit = axis / largest
    length = float(np.linalg.norm(unit))
    if abs(largest * length - 1) > 1e-6:
        warn(str(element.error(f"axis has length {largest * length:g}, normalized")))
    return unit / length


def _limits(joint: _Joint) -> tuple[float, float]:
    """The joint's own limits [rad or m], infinite where it has none."""
    if joint.kind == "continuous":
        return -np.inf, np.inf
    element = joint.element.children.get("limit")
    if element is None and "mimic" in joint.element.children:
        return -np.inf, np.inf
    if joint.kind == "revolute" and (element is None or not {"lower", "upper"} & element.attributes.keys()):
        warn(str(joint.element.error("no <limit> with lower or upper, taken as unlimited")))
        return -np.inf, np.inf
    if element is None:
        raise joint.element.error(f"a {joint.kind} joint needs a <limit>")
    lower, upper = (_numbers(element, key, "0")[0] for key in ("lower", "upper"))
    if lower > upper:
        raise element.error(f"limit must have lower <= upper, got {lower:g} and {upper:g}")
    return lower, upper
