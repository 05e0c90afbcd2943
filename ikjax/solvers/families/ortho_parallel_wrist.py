"""Arms with axis 1 perpendicular to 2, axis 2 parallel to 3, and a spherical wrist.

Branches: 8. PUMA 560 and nearly every industrial 6-joint arm.

Frames: standard DH. s1, s4, s5 are the signs of sin(alpha1), sin(alpha4), sin(alpha5), c2 is the sign of
cos(alpha2), and `up` is +1 where axis 1 points up. Frame 1 has its origin on axis 2 and its z along it; the
arm's plane is its x, y plane.

Steps:
1. shoulder: the wrist center is at the distance `lateral` from the plane of axis 1 and x1: joint 1.
2. triangle: upper arm a2 and forearm (a3, -c2 d4 sin(alpha3)) reach it in the plane: joints 2, 3.
3. wrist: the rotation that is left: joints 4, 5, 6.

Bits:
1. front or back: the wrist is on the side of axis 1 where axis 2 is (a1), or on the other; along x1 if
   a1 = 0.
2. up or down: the elbow is above the line from shoulder to wrist, for an arm that faces its wrist.
3. noflip or flip: sin(t5) has the sign of sin(alpha4) d4 (of sin(alpha4) if d4 = 0), or the other.

Source: the three steps are Craig's, Introduction to Robotics, 3rd ed., section 4.7; Brandstotter,
Angerer, Hofbaur, An analytical solution of the inverse kinematics problem of industrial serial
manipulators with an ortho-parallel basis and a spherical wrist (2014), counts the same arms.
"""

import jax.numpy as jnp

from ikjax.arm.forward import Link
from ikjax.arm.recognition.signs import OrthoParallelWristSigns
from ikjax.core import safe, vector
from ikjax.core.pose import Pose
from ikjax.core.trig import Angle
from ikjax.solvers.context import Branch, Setting, bits
from ikjax.solvers.steps.shoulder import shoulder
from ikjax.solvers.steps.triangle import Triangle, leaned, triangle
from ikjax.solvers.steps.wrist import general_wrist, shortfall, square_wrist


def branches(
    signs: OrthoParallelWristSigns, links: tuple[Link, ...], goal: Pose, setting: Setting
) -> tuple[Branch, ...]:
    """All eight slots for one goal.

    Args:
        signs: Those of the family.
        links: The table, lengths in units of the reach.
        goal: Frame 6 without the last link's own d, a, alpha, seen from frame 0.
        setting: Fallback and tolerances.
    """
    up, s1, c2 = signs.up, signs.sin_alpha1, signs.cos_alpha2
    s4, s5, square = signs.sin_alpha4, signs.sin_alpha5, signs.square_wrist
    one, two, three, four, five = links[:5]
    x, y, z = goal.position
    lateral = s1 * (two.d + c2 * (three.d + four.d * three.cos_alpha))
    upper, fore_x, fore_y = two.a, three.a, -c2 * four.d * three.sin_alpha
    fore = safe.norm(fore_x, fore_y)
    # A wrist of other twists does not reach every rotation, so joints 2 and 3 may decide whether it does.
    noise = setting.correction_size if square else setting.length_uncertainty
    twists = (four.sin_alpha, four.cos_alpha, five.sin_alpha, five.cos_alpha)
    facing, pointing = safe.sign(one.a), s4 * safe.sign(four.d)
    slots: dict[int, Branch] = {}
    for slot in range(4):
        side, height, _ = bits(slot)
        base = shoulder(x, y, lateral, side * facing, setting)
        left = up * s1 * side * facing * height
        arm = triangle(base.ahead - one.a, s1 * (z - one.d), upper, fore, left, setting, noise)
        if not square:
            joints = _first_joints(base.turn, arm, (fore_x, fore_y), c2, setting)
            n = vector.transpose(setting.unwind(goal, links, joints).rotation)[2]
            # The derivative of the component of n along axis 4 with respect to the forearm's angle.
            tilt = c2 * three.sin_alpha * n[0]
            arm = leaned(arm, upper, fore, safe.divide(shortfall(n, twists), tilt), setting)
        joints = _first_joints(base.turn, arm, (fore_x, fore_y), c2, setting)
        seen = setting.unwind(goal, links, joints)
        across, _, along = vector.transpose(seen.rotation)
        if square:
            pair = square_wrist(along, across, (s4, s5), pointing, setting)
        else:
            pair = general_wrist(along, across, twists, pointing, setting)
        for flip, hand in enumerate(pair):
            margin = jnp.minimum(jnp.minimum(base.margin, arm.margin), hand.margin)
            continuum = base.continuum | arm.continuum | hand.continuum
            slots[slot + 4 * flip] = Branch(joints + hand.joints, seen, margin, continuum)
    return tuple(slots[slot] for slot in range(8))


def _first_joints(turn: Angle, arm: Triangle, fore, c2: int, setting: Setting) -> tuple[Angle, Angle, Angle]:
    """Joints 1, 2, 3. The third is the elbow's angle less the angle of the forearm's offset (a3, d4)."""
    per = safe.divide(1, safe.norm(*fore))
    sine = (arm.elbow_sin * fore[0] - arm.elbow_cos * fore[1]) * per
    cosine = (arm.elbow_cos * fore[0] + arm.elbow_sin * fore[1]) * per
    return turn, setting.angle(arm.shoulder_sin, arm.shoulder_cos), setting.angle(c2 * sine, cosine)
