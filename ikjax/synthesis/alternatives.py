"""Goals that may be met in several ways: a free roll, a tool axis within a cone, a point alone."""

import numpy as np
from scipy.spatial.transform import Rotation

from ikjax.maps.sets.orientations import Orientations, as_orientations
from ikjax.maps.sweep import MOST_ROLLS


def checked_alternatives(
    free_rolls: int, alternatives: Orientations | int | np.ndarray | None
) -> np.ndarray | None:
    """What the tool may be turned by, (m, 4, 4): every alternative with every roll; None for nothing.

    Raises:
        ValueError: A number of rolls out of range, too many together, or rotations that are none.
    """
    if isinstance(free_rolls, bool) or not isinstance(free_rolls, int) or not 1 <= free_rolls <= MOST_ROLLS:
        raise ValueError(f"free_rolls must be a whole number from 1 to {MOST_ROLLS}, got {free_rolls}")
    if free_rolls == 1 and alternatives is None:
        return None
    turns = np.zeros((free_rolls, 3))
    turns[:, 2] = np.arange(free_rolls) * (2 * np.pi / free_rolls)
    rolls = Rotation.from_rotvec(turns).as_matrix()
    rotations = np.eye(3)[None] if alternatives is None else as_orientations(alternatives).rotations
    if len(rotations) * free_rolls > MOST_ALTERNATIVES:
        raise ValueError(
            f"alternatives x free_rolls must be at most {MOST_ALTERNATIVES}, got "
            f"{len(rotations) * free_rolls:,}"
        )
    poses = np.tile(np.eye(4), (len(rotations) * free_rolls, 1, 1))
    poses[:, :3, :3] = (rotations[:, None] @ rolls).reshape(-1, 3, 3)
    return poses


MOST_ALTERNATIVES = 1024
"""Of each goal: turns of the tool of which one must do."""
