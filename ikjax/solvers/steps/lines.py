"""The arm as axes in space: where each joint turns or slides when all DH angles and slides are zero.

For families whose joints may be in any order. Every pose is a product of exponentials: of motions about fixed
axes.

Source: the product of exponentials is Brockett's (1984); Lynch and Park, Modern Robotics, section 4.1.
"""

from typing import NamedTuple

from ikjax.arm.forward import Joint, Link, advance, known_sincos
from ikjax.core import pose as poses
from ikjax.core import vector
from ikjax.core.pose import Pose
from ikjax.core.trig import Scalar
from ikjax.core.vector import Vector, minus, plus, times


class Axis(NamedTuple):
    """The axis of a joint, seen from frame 0."""

    along: Vector
    """Its direction."""
    point: Vector
    """Any point of it."""


def axes_of(links: tuple[Link, ...]) -> tuple[tuple[Axis, ...], Pose]:
    """The axes of all joints at DH zero, and the last frame there."""
    frame, axes = poses.IDENTITY, []
    for link in links:
        axes.append(Axis(tuple(row[2] for row in frame.rotation), frame.position))
        sine, cosine = (0.0, 1.0) if link.kind == "R" else known_sincos(link.theta)
        frame = advance(frame, link, Joint(sine, cosine, link.d))
    return tuple(axes), frame


def turned(along: Vector, sine: Scalar, cosine: Scalar, v: Vector) -> Vector:
    """A vector turned about a unit direction (Rodrigues' formula)."""
    part = vector.scale(vector.dot(along, v), along)
    rest = vector.subtract(v, part)
    return vector.add(
        part, vector.add(vector.scale(cosine, rest), vector.scale(sine, vector.cross(along, v)))
    )


def moved(axis: Axis, sine: Scalar, cosine: Scalar, point: Vector) -> Vector:
    """A point turned about an axis."""
    return vector.add(axis.point, turned(axis.along, sine, cosine, vector.subtract(point, axis.point)))


def pose_turned(axis: Axis, sine: Scalar, cosine: Scalar, pose: Pose) -> Pose:
    """A frame turned about an axis."""
    columns = (turned(axis.along, sine, cosine, column) for column in vector.transpose(pose.rotation))
    return Pose(vector.transpose(tuple(columns)), moved(axis, sine, cosine, pose.position))


def component(along: Vector, axis: Vector, v: Vector) -> tuple[Scalar, Scalar, Scalar]:
    """(c, s, rest): along . (v turned about axis by t) = c cos(t) + s sin(t) + rest."""
    rest = times(vector.dot(along, axis), vector.dot(axis, v))
    return plus(vector.dot(along, v), minus(rest)), vector.dot(along, vector.cross(axis, v)), rest


def seen_from(frame: Pose, axis: Axis) -> Axis:
    """An axis in the coordinates of a frame."""
    back = vector.transpose(frame.rotation)
    offset = vector.subtract(axis.point, frame.position)
    return Axis(vector.rotate(back, axis.along), vector.rotate(back, offset))
