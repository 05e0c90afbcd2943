"""The `five_axis` arms for a goal that they need not reach: free, and with joint 2 or 4 locked at a limit.

Branches: those of `five_nearest`, and those of `five_axis` for each joint and limit. Frames and signs are the
same.

Where the nearest pose is not within the joint limits, the nearest one that is has a joint at a limit, as a
rule joint 2 or 4. The point is attained all the same: because the pitch is free, two links reach the foot of
the tool point that `five_nearest` gives for that side.

Steps:
1. hand: joint 1 and the foot, by `five_nearest`.
2. triangle of two links that end in the foot:
       joint 2 locked    axis 3 is fixed; link 3, and the hand
       joint 4 locked    link 2; and link 3 and the hand as one
3. roll: the best for the pitch that follows.
The foot of a tool point off axis 5 stays where the nearest hand has it, which is good enough to start a
refinement from.

Bits: front or back as in `five_axis`; then left or right: the bend of the triangle.

Source: ours.
"""

import jax
import jax.numpy as jnp

from ikjax.arm.forward import Link
from ikjax.arm.recognition.signs import FiveAxisSigns
from ikjax.core import safe
from ikjax.core.pose import Pose
from ikjax.core.tolerances import SHORT_HAND
from ikjax.core.trig import Scalar, SinCos
from ikjax.core.vector import plus, times
from ikjax.core.xla import pin
from ikjax.solvers.context import Joints, Setting
from ikjax.solvers.families.five_axis import joints_of
from ikjax.solvers.families.five_nearest import Hand, hand_of, roll_of, turned, wrist_of
from ikjax.solvers.steps.triangle import Triangle, triangle

LOCKABLE = (1, 3)
"""The joints that can be locked, counted from 0."""


def branches(
    signs: FiveAxisSigns,
    links: tuple[Link, ...],
    goal: Pose,
    setting: Setting,
    limits: dict[int, list[SinCos]],
) -> list[Joints]:
    """Joints of both sides and both bends, (limits, bends, sides, ...).

    First those of `five_nearest`, with one limit in the place of none. Then those of each joint in `limits`,
    which are DH angles.

    Limits, bends and sides are leading axes of one array, so that a program contains the steps once.
    """
    like = goal.position[0]
    goal = jax.tree.map(lambda x: jnp.asarray(x)[None, None, None], goal)

    def along(axis: int, values: list[Scalar]) -> Scalar:
        stacked = jnp.stack([jnp.asarray(x, like.dtype) for x in values])
        return jnp.expand_dims(stacked, [k for k in range(3 + like.ndim) if k != axis])

    side = along(2, [1, -1]) * safe.sign(links[0].a)
    hand = hand_of(signs, links, goal, side, setting)
    bends = along(1, [1, -1])
    answers = [_free(signs, links, hand, setting, side * bends)]
    for joint, angles in limits.items():
        if not angles:
            continue
        sine, cosine = (along(0, list(x)) for x in zip(*angles, strict=True))
        bent = _bent(signs, links, hand, setting, joint, (sine, cosine), bends)
        shoulder, elbow, pitch = ((pin(x), pin(y)) for x, y in bent)
        roll = setting.angle(*roll_of(signs, hand.rotation, pitch, links[3], setting))
        # Its margin is not used.
        arm = Triangle(shoulder[0], shoulder[1], elbow[0], elbow[1], jnp.inf, False)
        answers.append(joints_of(signs, hand.base, arm, pitch, roll, setting))
    return answers


def _free(
    signs: FiveAxisSigns, links: tuple[Link, ...], hand: Hand, setting: Setting, side: Scalar
) -> Joints:
    """The branches of `five_nearest`; `side` is the side of joint 1 times the height of the elbow."""
    _, two, three, four = links[:4]
    ahead, aside = turned(wrist_of(signs, four, setting), hand.pitch)
    (x, y), left = hand.foot, signs.up * signs.sin_alpha1 * side
    arm = triangle(x - ahead, y - aside, two.a, three.a, left, setting)
    return joints_of(signs, hand.base, arm, hand.pitch, setting.angle(*hand.roll), setting)


def _bent(
    signs: FiveAxisSigns,
    links: tuple[Link, ...],
    hand: Hand,
    setting: Setting,
    joint: int,
    angle: SinCos,
    left: Scalar,
) -> tuple[SinCos, SinCos, SinCos]:
    """Shoulder, elbow and pitch, with one joint at an angle.

    Args:
        signs, links, setting: As in `branches`.
        hand: Joint 1 and the foot.
        joint: The one that is locked.
        angle: Its DH angle.
        left: +1 bends the triangle to the left, -1 to the right.
    """
    _, two, three, four = links[:4]
    (x, y), wrist = hand.foot, wrist_of(signs, four, setting)
    if joint == 1:
        length, lean = _polar(*wrist)
        x, y = x - times(two.a, angle[1]), y - times(two.a, angle[0])
        far = triangle(x, y, three.a, length, left, setting)
        fore = far.shoulder_sin, far.shoulder_cos
        return angle, _difference(fore, angle), _difference(_sum(fore, (far.elbow_sin, far.elbow_cos)), lean)
    tip = times(float(signs.cos_alpha23), angle[0]), angle[1]
    ahead, aside = turned(wrist, tip)
    length, lean = _polar(plus(three.a, ahead), aside)
    far = triangle(x, y, two.a, length, left, setting)
    shoulder, elbow = (far.shoulder_sin, far.shoulder_cos), _difference((far.elbow_sin, far.elbow_cos), lean)
    return shoulder, elbow, _sum(_sum(shoulder, elbow), tip)


def _polar(x: Scalar, y: Scalar) -> tuple[Scalar, SinCos]:
    """Length and direction of a link in the plane."""
    size = safe.sqrt(plus(times(x, x), times(y, y)))
    if isinstance(size, float):
        return max(size, SHORT_HAND), (y / size, x / size) if size > SHORT_HAND else (0.0, 1.0)
    known = size > SHORT_HAND
    sine, cosine = jnp.where(known, safe.divide(y, size), 0), jnp.where(known, safe.divide(x, size), 1)
    return jnp.maximum(size, SHORT_HAND), (sine, cosine)


def _sum(one: SinCos, other: SinCos) -> SinCos:
    """Of two angles."""
    return (
        plus(times(one[0], other[1]), times(one[1], other[0])),
        plus(times(one[1], other[1]), times(-1.0, times(one[0], other[0]))),
    )


def _difference(one: SinCos, other: SinCos) -> SinCos:
    """Of two angles."""
    return _sum(one, (times(-1.0, other[0]), other[1]))
