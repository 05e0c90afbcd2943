"""Arms with three parallel turning axes: SCARA, and a turning base before them.

Branches: 2. Task: "pose"; goals outside the arm's four-dimensional set are not valid.

Frames: axes at DH zero, seen from frame 0 (`steps.lines`).

Steps of a SCARA, which has one slide along the same direction, anywhere among the axes:
1. The height of the goal gives the slide.
2. planar: the three turning joints.

Steps of a turning base:
1. Joint 1 turns the direction of the three axes to where the goal has it.
2. planar: the three joints, in the plane that joint 1 has turned.

Bit: left or right: the elbow, against the line from the first of the three joints to the last.

Source: Craig, Introduction to Robotics, 3rd ed., section 4.4 for the plane; the rest is ours.
"""

from ikjax.arm.forward import Link
from ikjax.arm.recognition.signs import ScaraSigns, TurretSigns
from ikjax.core import safe, vector
from ikjax.core.pose import Pose
from ikjax.core.vector import Vector
from ikjax.solvers.context import Branch, Setting, Slide
from ikjax.solvers.families.planar import heading_of, plane_of, three_joints
from ikjax.solvers.steps.lines import axes_of, component, pose_turned


def branches(signs: ScaraSigns, links: tuple[Link, ...], goal: Pose, setting: Setting) -> tuple[Branch, ...]:
    """Both slots of a SCARA."""
    kinds = "".join(link.kind for link in links)
    k = kinds.index("P")
    axes, tip = axes_of(links)
    turning = [i for i in range(4) if i != k]
    plane = plane_of("RRR", tuple(axes[i] for i in turning))
    slide = signs[k] * vector.dot(plane.up, vector.subtract(goal.position, tip.position))
    three = setting._replace(fallback=tuple(setting.fallback[i] for i in turning))
    ways = three_joints(
        "RRR",
        tuple(axes[i] for i in turning),
        plane,
        tuple(signs[i] for i in turning),
        heading_of(plane, tip, goal),
        plane.point(goal.position),
        plane.point(tip.position),
        three,
    )
    slots = []
    miss = safe.norm(*vector.subtract(_carried(plane.up, tip, goal), plane.up))
    for way in ways:
        joints = list(way.joints)
        joints.insert(k, Slide(slide))
        slots.append(Branch(tuple(joints), goal, way.margin, way.continuum, miss))
    return tuple(slots)


def _carried(along: Vector, tip: Pose, goal: Pose) -> Vector:
    """A direction of the last frame, given as it is at DH zero, as the goal has it."""
    return vector.rotate(goal.rotation, vector.rotate(vector.transpose(tip.rotation), along))


def turret_branches(
    signs: TurretSigns, links: tuple[Link, ...], goal: Pose, setting: Setting
) -> tuple[Branch, ...]:
    """Both slots of a turning base before three parallel axes."""
    axes, tip = axes_of(links)
    along = axes[1].along
    # Where the goal has the direction that axes 2, 3, 4 share.
    wanted = _carried(along, tip, goal)
    cosine, sine, _ = component(wanted, axes[0].along, along)
    weight = safe.reciprocal_sqrt(sine * sine + cosine * cosine)
    free = weight <= setting.zero_tolerance
    turn = setting.filled(0, free, sine * weight, cosine * weight)
    seen = pose_turned(axes[0], -turn.sin, turn.cos, goal)
    # Any direction square to the axes will do for x.
    x = vector.cross(along, axes[0].along)
    x = vector.scale(safe.reciprocal_sqrt(vector.dot(x, x)), x)
    plane = plane_of("RRR", axes[1:])._replace(x=x, y=vector.cross(along, x))
    ways = three_joints(
        "RRR",
        axes[1:],
        plane,
        signs,
        heading_of(plane, tip, seen),
        plane.point(seen.position),
        plane.point(tip.position),
        setting._replace(fallback=setting.fallback[1:]),
    )
    # No joint changes the component of the direction along axis 1, nor moves the tip along the other three
    # axes.
    tilt = vector.dot(axes[0].along, vector.subtract(wanted, along))
    miss = safe.norm(tilt, vector.dot(along, vector.subtract(seen.position, tip.position)))
    return tuple(Branch((turn, *way.joints), goal, way.margin, way.continuum | free, miss) for way in ways)
