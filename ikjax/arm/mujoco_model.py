"""The axes of a serial chain in a MuJoCo model, as MuJoCo itself places them; needs the extra `mujoco`.

MuJoCo reads the file, with its defaults, attachments and references; here its compiled model is asked where
each joint's axis is when the joints of the chain are at zero.

Source: MuJoCo documentation, Computation, Kinematic tree; XML reference, joint (`ref`, `range`), equality,
tendon.
"""

import os
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from ikjax.arm import tips
from ikjax.arm.axes_to_dh import Axes
from ikjax.arm.urdf.gripper import Moved
from ikjax.arm.urdf.xml import ArmFileError, listing, quote, show
from ikjax.core.warn import warn


class MujocoChain(NamedTuple):
    """The moving joints between two bodies of a model."""

    name: str
    axes: Axes
    joint_names: tuple[str, ...]
    limits: list[tuple[float, float]]
    """[rad, m], in MuJoCo's own joint values."""


def read_model(
    source: Any,
    site: str | None = None,
    body: str | None = None,
    base: str | None = None,
    fixed_joints: Mapping[str, float] | None = None,
) -> MujocoChain:
    """The chain from a body to a site or another body.

    Args:
        source: An `MjModel` or `MjSpec`, a path of an MJCF or MJB file, or MJCF as text.
        site, body: Name of the tool's frame; by default it is guessed, see `ikjax.arm.tips`.
        base: Name of the body that the arm stands on, by default the world.
        fixed_joints: Joints of the chain by name that stay at a value [rad, m].

    Warns:
        Where the tip is guessed.

    Raises:
        ArmFileError: A model that holds no such chain, a ball or free joint in it, joints of it that an
            equality or a tendon couples.
        ImportError: The extra `mujoco` is not installed.
    """
    try:
        import mujoco
    except ImportError as error:
        raise ImportError('reading a MuJoCo model needs mujoco: pip install "ikjax[mujoco]"') from error
    model = _Model(mujoco, _compiled(mujoco, source))
    if site is not None and body is not None:
        raise ValueError(f"site= and body= both name the tool's frame: give one, got {site!r} and {body!r}")
    start = 0 if base is None else model.find("BODY", base, "base")
    if site is None and body is None:
        kind, frame = model.guess(start)
    else:
        kind, frame = ("SITE", site) if site is not None else ("BODY", str(body))
    place = model.find(kind, frame, "site" if kind == "SITE" else "body")
    end = int(model.m.site_bodyid[place]) if kind == "SITE" else place
    path = model.to_root(end)
    if start not in path:
        raise model.error(f"body {quote(model.name('BODY', end))} is not below base {quote(base or 'world')}")
    joints = model.joints_of(path[: path.index(start)][::-1])
    fixed = dict(fixed_joints or {})
    names = [model.name("JOINT", j) for j in joints]
    unknown = [name for name in fixed if name not in names]
    if unknown:
        raise model.error(
            f"fixed_joints names {listing(map(quote, unknown))}, no joint of the chain: it has "
            f"{listing(map(quote, names))}"
        )
    return _chain(mujoco, model, (kind, place), start, joints, fixed)


def _chain(mujoco, model: "_Model", tip: tuple[str, int], start: int, joints: list[int], fixed: dict):
    """The axes where the moving joints are at zero and the others at their values."""
    moving = [j for j in joints if model.name("JOINT", j) not in fixed]
    if not moving:
        raise model.error("no moving joint between base and tip")
    model.refuse_couplings(moving)
    m, data = model.m, mujoco.MjData(model.m)
    for j in moving:
        data.qpos[m.jnt_qposadr[j]] = 0
    for name, value in fixed.items():
        j = model.find("JOINT", name, "fixed_joints")
        lower, upper = model.limits(j)
        if not lower <= value <= upper:
            raise model.error(
                f"fixed_joints holds joint {quote(name)} at {value:g}, outside its limits "
                f"{lower:g} to {upper:g}"
            )
        data.qpos[m.jnt_qposadr[j]] = value
    mujoco.mj_kinematics(m, data)
    kind, place = tip
    world = _pose(*((data.site_xpos, data.site_xmat) if kind == "SITE" else (data.xpos, data.xmat)), place)
    foot = _pose(data.xpos, data.xmat, start)
    turn = foot[:3, :3]
    axes = Axes(
        "".join("R" if m.jnt_type[j] == int(mujoco.mjtJoint.mjJNT_HINGE) else "P" for j in moving),
        data.xaxis[moving] @ turn,
        (data.xanchor[moving] - foot[:3, 3]) @ turn,
        np.linalg.inv(foot) @ world,
    )
    names = tuple(model.name("JOINT", j) or f"joint{j}" for j in moving)
    return MujocoChain(model.label, axes, names, [model.limits(j) for j in moving])


def _pose(positions, rotations, place: int) -> np.ndarray:
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotations[place].reshape(3, 3), positions[place]
    return pose


def _compiled(mujoco, source: Any):
    """The model of whatever holds one."""
    if isinstance(source, mujoco.MjModel):
        return source
    if isinstance(source, mujoco.MjSpec):
        return source.compile()
    if isinstance(source, str) and source.lstrip("\ufeff \t\r\n").startswith("<"):
        return _read(mujoco.MjModel.from_xml_string, source)
    path = os.fsdecode(source)
    if not os.path.exists(path):
        raise FileNotFoundError(f"no such file: {show(path, None)}")
    binary = path.endswith(".mjb")
    return _read(mujoco.MjModel.from_binary_path if binary else mujoco.MjModel.from_xml_path, path)


def _read(read, source: str):
    try:
        return read(source)
    except ValueError as error:
        raise ArmFileError(f"MuJoCo cannot read the model: {error}") from error


class _Model:
    """A compiled model, asked by names."""

    def __init__(self, mujoco, model):
        self.mujoco, self.m = mujoco, model
        # Names are one block of bytes; the model's own comes first.
        self.label = bytes(model.names).split(b"\0", 1)[0].decode() or "arm"

    def error(self, reason: str) -> ArmFileError:
        return ArmFileError(f"{show(self.label)}: {reason}")

    def name(self, kind: str, place: int) -> str:
        kinds = self.mujoco.mjtObj
        return self.mujoco.mj_id2name(self.m, getattr(kinds, f"mjOBJ_{kind}"), place) or ""

    def find(self, kind: str, name: str, argument: str) -> int:
        place = self.mujoco.mj_name2id(self.m, getattr(self.mujoco.mjtObj, f"mjOBJ_{kind}"), name)
        if place < 0:
            count = {"BODY": self.m.nbody, "SITE": self.m.nsite, "JOINT": self.m.njnt}[kind]
            known = [quote(self.name(kind, i)) for i in range(count) if self.name(kind, i)]
            raise self.error(f"{argument}={quote(name)} is none of {listing(known) or 'none'}")
        return int(place)

    def to_root(self, body: int) -> list[int]:
        path = [body]
        while path[-1]:
            path.append(int(self.m.body_parentid[path[-1]]))
        return path

    def joints_of(self, bodies: list[int]) -> list[int]:
        """The joints of bodies from base to tip; a ball or a free joint raises."""
        joints: list[int] = []
        for body in bodies:
            first = int(self.m.body_jntadr[body])
            for j in range(first, first + int(self.m.body_jntnum[body])):
                kind = self.mujoco.mjtJoint(int(self.m.jnt_type[j]))
                if kind not in (self.mujoco.mjtJoint.mjJNT_HINGE, self.mujoco.mjtJoint.mjJNT_SLIDE):
                    raise self.error(
                        f"joint {quote(self.name('JOINT', j))} of body {quote(self.name('BODY', body))} is "
                        f"{kind.name[6:].lower()}, not hinge or slide: choose base= beyond it"
                    )
                joints.append(j)
        return joints

    def limits(self, joint: int) -> tuple[float, float]:
        if not self.m.jnt_limited[joint]:
            return -np.inf, np.inf
        lower, upper = map(float, self.m.jnt_range[joint])
        return lower, upper

    def guess(self, start: int) -> tuple[str, str]:
        """Kind and name of the likeliest tip below a body."""
        order = [b for b in range(start, self.m.nbody) if start in self.to_root(b)]
        links: list[tips.Link] = []
        frames: list[tuple[str, str]] = []
        leader = self._leaders()
        for b in order:
            parent = -1 if b == start else order.index(int(self.m.body_parentid[b]))
            first, count = int(self.m.body_jntadr[b]), int(self.m.body_jntnum[b])
            own = range(first, first + count) if b != start else range(0)
            name = self.name("BODY", b)
            moved = tuple(Moved(self.name("JOINT", j), name, "R", -np.inf, np.inf) for j in own)
            links.append(tips.Link(name, parent, moved, leader.get(first, f"\0{b}")))
            frames.append(("BODY", name))
        for s in range(self.m.nsite):
            if int(self.m.site_bodyid[s]) in order and self.name("SITE", s):
                parent = order.index(int(self.m.site_bodyid[s]))
                links.append(tips.Link(self.name("SITE", s), parent))
                frames.append(("SITE", self.name("SITE", s)))
        guess = tips.guess_tip(links)
        if isinstance(guess, list):
            ends = listing(quote(links[end].name) for end in guess)
            raise self.error(f"no longest chain of joints: give site= or body=; the longest end at {ends}")
        kind, name = frames[guess.link]
        if not name:
            raise self.error("the last body has no name: give site= or body=")
        warn(tips.report(show(self.label), f"{kind.lower()} {quote(name)}", guess, f"{kind.lower()}="))
        return kind, name

    def _leaders(self) -> dict[int, str]:
        """The joints that an equality or a fixed tendon couples, each with a name for its group."""
        groups: dict[int, str] = {}
        for e in range(self.m.neq):
            if self.m.eq_type[e] == int(self.mujoco.mjtEq.mjEQ_JOINT) and self.m.eq_obj2id[e] >= 0:
                for j in (int(self.m.eq_obj1id[e]), int(self.m.eq_obj2id[e])):
                    groups[j] = f"\0equality {min(self.m.eq_obj1id[e], self.m.eq_obj2id[e])}"
        for t in range(self.m.ntendon):
            joints = self._tendon_joints(t)
            if len(joints) > 1:
                groups.update((j, groups.get(j, f"\0tendon {t}")) for j in joints)
        return groups

    def _wraps(self, tendon: int) -> range:
        first = int(self.m.tendon_adr[tendon])
        return range(first, first + int(self.m.tendon_num[tendon]))

    def _tendon_joints(self, tendon: int) -> list[int]:
        hit = int(self.mujoco.mjtWrap.mjWRAP_JOINT)
        return [int(self.m.wrap_objid[w]) for w in self._wraps(tendon) if self.m.wrap_type[w] == hit]

    def _tendon_bodies(self, tendon: int) -> list[int]:
        """The bodies that a spatial tendon passes."""
        kinds, bodies = self.mujoco.mjtWrap, []
        for w in self._wraps(tendon):
            kind, place = kinds(int(self.m.wrap_type[w])), int(self.m.wrap_objid[w])
            if kind == kinds.mjWRAP_SITE:
                bodies.append(int(self.m.site_bodyid[place]))
            elif kind in (kinds.mjWRAP_SPHERE, kinds.mjWRAP_CYLINDER):
                bodies.append(int(self.m.geom_bodyid[place]))
        return bodies

    def _moved_apart(self, bodies: list[int], moving: list[int]) -> bool:
        """Whether a joint of the chain moves some of the bodies relative to others."""
        above = [set(self.to_root(body)) for body in bodies]
        return any(0 < sum(int(self.m.jnt_bodyid[j]) in path for path in above) < len(above) for j in moving)

    def refuse_couplings(self, moving: list[int]) -> None:
        """Raise where an equality or a tendon couples a joint of the chain to anything."""
        for e in range(self.m.neq):
            if not self.m.eq_active0[e]:
                continue
            touched = self._equality_touches(e, moving)
            if touched:
                name = self.name("EQUALITY", e) or f"number {e}"
                raise self.error(
                    f"equality {quote(name)} couples {touched}: choose the ends of the chain on one side of "
                    "it, hold the joint with fixed_joints={name: value}, or switch the equality off"
                )
        for t in range(self.m.ntendon):
            joints = self._tendon_joints(t)
            held = [j for j in joints if j in moving]
            if len(joints) > 1 and held:
                together = listing(quote(self.name("JOINT", j)) for j in joints)
                raise self.error(
                    f"tendon {quote(self.name('TENDON', t) or f'number {t}')} couples joints {together}: "
                    "choose the ends of the chain on one side of it, or hold joints with fixed_joints="
                )
            bodies = self._tendon_bodies(t)
            if self.m.tendon_limited[t] and bodies and self._moved_apart(bodies, moving):
                raise self.error(
                    f"tendon {quote(self.name('TENDON', t) or f'number {t}')} has a range and is stretched "
                    "by joints of the chain, which a chain cannot express: take the range off"
                )

    def _equality_touches(self, e: int, moving: list[int]) -> str:
        """What an equality couples of the chain, in words; empty where nothing."""
        m, kinds = self.m, self.mujoco.mjtEq
        kind = kinds(int(m.eq_type[e]))
        first, second = int(m.eq_obj1id[e]), int(m.eq_obj2id[e])
        if kind == kinds.mjEQ_JOINT:
            both = [j for j in (first, second) if j >= 0]
            held = any(j in moving for j in both)
            return f"joint {' to '.join(quote(self.name('JOINT', j)) for j in both)}" if held else ""
        if kind == kinds.mjEQ_TENDON:
            tendons = [t for t in (first, second) if t >= 0]
            joints = [j for t in tendons for j in self._tendon_joints(t) if j in moving]
            spatial = any(self._moved_apart(self._tendon_bodies(t), moving) for t in tendons)
            words = listing(quote(self.name("TENDON", t)) for t in tendons)
            return f"tendon {words}" if joints or spatial else ""
        if kind not in (kinds.mjEQ_CONNECT, kinds.mjEQ_WELD):
            return ""
        ends = [first, second]
        if m.eq_objtype[e] == int(self.mujoco.mjtObj.mjOBJ_SITE):
            ends = [int(m.site_bodyid[s]) for s in ends]
        # A mocap body is moved by hand, to pull an arm along: it holds nothing.
        if any(m.body_mocapid[b] >= 0 for b in ends) or not self._moved_apart(ends, moving):
            return ""
        return f"bodies {' and '.join(quote(self.name('BODY', b)) for b in ends)}"
