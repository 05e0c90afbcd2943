"""Arms of the textbooks."""

import numpy as np

from ikjax.arm.arm import Arm

DEG = np.pi / 180


def puma560() -> Arm:
    """Unimation PUMA 560.

    Source: Corke and Armstrong-Helouvry, A search for consensus among model parameters reported
    for the PUMA 560 robot (1994); limits as in Corke, Robotics, Vision and Control.
    """
    return Arm.from_dh(
        a=[0, 0.4318, 0.0203, 0, 0, 0],
        alpha=np.multiply([90, 0, -90, 90, -90, 0], DEG),
        d=[0, 0, 0.15005, 0.4318, 0, 0],
        limits=np.multiply([(-160, 160), (-45, 225), (-225, 45), (-110, 170), (-100, 100), (-266, 266)], DEG),
        convention="standard",
        name="puma560",
    )


def elbow_manipulator(a2: float = 0.4, a3: float = 0.3, a4: float = 0.1) -> Arm:
    """The lectures' elbow manipulator; its three lengths [m] are free, the defaults are ours.

    Source: ME/SE 740, lectures 15 and 18.
    """
    return Arm.from_dh(
        a=[0, a2, a3, a4, 0, 0],
        alpha=np.multiply([90, 0, 0, -90, 90, 0], DEG),
        d=[0, 0, 0, 0, 0, 0],
        convention="standard",
        name="elbow_manipulator",
    )
