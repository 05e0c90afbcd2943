"""Arms whose last three axes meet in a point, after any three joints, turning or sliding.

Branches: twice those of `regional.three_joints`; 8, 4 or 2.

Frames: standard DH, a4 = a5 = d5 = 0. The wrist center is at (0, 0, d4) in frame 3. s4, s5 are the signs of
sin(alpha4), sin(alpha5).

Steps:
1. regional: joints 1, 2, 3 bring the wrist center where the goal has it.
2. wrist: the rotation that is left: joints 4, 5, 6.

Bits: those of `regional.three_joints`, then noflip or flip as in `ortho_parallel_wrist`.

The reversed arm, whose first three axes meet, is this one read from the tool to the base: the same links and
joints in the other order, seen from frames turned by half a turn about x.

Source: Pieper, The kinematics of manipulators under computer control (1968), after Craig, Introduction to
Robotics, 3rd ed., section 4.6; the reversed arm is ours.
"""

import jax.numpy as jnp

from ikjax.arm.forward import Link
from ikjax.arm.recognition.signs import PieperSigns
from ikjax.core import pose as poses
from ikjax.core import safe, vector
from ikjax.core.pose import Pose
from ikjax.core.vector import minus
from ikjax.solvers.context import Branch, Setting
from ikjax.solvers.steps.regional import three_joints
from ikjax.solvers.steps.wrist import general_wrist, square_wrist


def branches(signs: PieperSigns, links: tuple[Link, ...], goal: Pose, setting: Setting) -> tuple[Branch, ...]:
    """All slots for one goal.

    Arguments as in `ortho_parallel_wrist`.
    """
    s4, s5 = signs.sin_alpha4, signs.sin_alpha5
    four, five = links[3], links[4]
    twists = (four.sin_alpha, four.cos_alpha, five.sin_alpha, five.cos_alpha)
    pointing = s4 * safe.sign(four.d)
    ways = three_joints.regional(links[:3], (0.0, 0.0, four.d), goal.position, signs.split, setting)
    plain: list[Branch] = []
    flipped: list[Branch] = []
    for way in ways:
        seen = setting.unwind(goal, links, way.joints)
        across, _, along = vector.transpose(seen.rotation)
        if signs.square_wrist:
            pair = square_wrist(along, across, (s4, s5), pointing, setting)
        else:
            pair = general_wrist(along, across, twists, pointing, setting)
        for hand, slots in zip(pair, (plain, flipped), strict=True):
            margin = jnp.minimum(way.margin, hand.margin)
            free = way.continuum | hand.continuum
            slots.append(Branch(way.joints + hand.joints, seen, margin, free))
    return (*plain, *flipped)


def reversed_branches(
    signs: PieperSigns, links: tuple[Link, ...], goal: Pose, setting: Setting
) -> tuple[Branch, ...]:
    """All slots of an arm whose first three axes meet in a point."""
    table, turned = reverse(links, goal)
    fallback = (*setting.fallback[::-1],)
    slots = branches(signs, table, turned, setting._replace(fallback=fallback))
    return tuple(slot._replace(joints=slot.joints[::-1], seen=goal) for slot in slots)


def reverse(links: tuple[Link, ...], goal: Pose) -> tuple[tuple[Link, ...], Pose]:
    """The table read from the tool to the base, and the base seen from the tool.

    The inverse of Rz(t) Tz(d) Tx(a) Rx(alpha) is, half a turn about x before and after,
    Tx(-a) Rx(-alpha) Rz(t) Tz(d): each link keeps its joint and passes its length and twist to the next.
    """
    rows = []
    for k in range(len(links) - 1, -1, -1):
        before = links[k - 1] if k else Link("R", 0.0, 0.0, 1.0, 0.0, 0.0)
        rows.append(
            links[k]._replace(
                a=minus(before.a), sin_alpha=minus(before.sin_alpha), cos_alpha=before.cos_alpha
            )
        )
    first = rows[-1]
    rows[-1] = first._replace(d=0.0)
    back = poses.inverse(goal)
    turned = tuple(
        tuple(c if (i == 0) == (j == 0) else -c for j, c in enumerate(row))
        for i, row in enumerate(back.rotation)
    )
    x, y, z = back.position
    goal = Pose(turned, (x, -y, -z))
    # The last reversed link is that of joint 1; its offset is subtracted from the goal.
    off = vector.scale(first.d, tuple(row[2] for row in goal.rotation))
    return tuple(rows), Pose(goal.rotation, vector.subtract(goal.position, off))
