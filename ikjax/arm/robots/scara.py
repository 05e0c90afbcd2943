"""SCARA arms: four joints on parallel axes, three of them revolute and one prismatic."""

import numpy as np

from ikjax.arm.arm import Arm
from ikjax.arm.robots.catalogue import robot

DEG = np.pi / 180


@robot(zero=(0, 0, 0, 0))
def gx4_351s() -> Arm:
    """Epson GX4-351S, table top, to the shaft's lower end when it is up; the base's height is left out.

    Joint 3 is zero at the top and negative below, as Epson counts it. Epson's pages name no range for
    joint 4 that we could read, so it has none.

    Source: Epson, GX series, Standard Work Envelope: arms 220 and 130 mm, 140 and 142 deg, 150 mm.
    Poses: where every joint stands at 0 pulses, after Epson, GX series, Work Envelope Setting by Pulse
    Range: both arms along x, the shaft at its upper end.
    """
    return Arm.from_dh(
        a=[0.22, 0.13, 0, 0],
        alpha=[0, 0, 0, 0],
        d=[0, 0, 0, 0],
        kinds="RRPR",
        limits=[(-140 * DEG, 140 * DEG), (-142 * DEG, 142 * DEG), (-0.15, 0), (-np.inf, np.inf)],
        convention="standard",
        name="gx4_351s",
    )
