"""What a search for a place to stand found."""

import dataclasses

import numpy as np

from ikjax.arm.arm import Arm
from ikjax.maps.sets.positions import Grid


@dataclasses.dataclass(frozen=True, eq=False)
class Bases:
    """Places for the base of an arm, the best first, and how they were found.

    `dataclasses.replace(arm, base=bases.base[0])` is the arm at the first of them.
    """

    arm: Arm
    """The arm that was given, where it stood."""
    goals: np.ndarray
    """(..., 4, 4) as they were given."""
    base: np.ndarray
    """(k, 4, 4) T_world_base, ranked and distinct."""
    score: np.ndarray
    """(k,) what ranks them: the share of goals reached, and the worst margin as less than one goal."""
    share: np.ndarray
    """(k,) of the goals that are reached, by `solve` and, where limits count, `within_limits`."""
    reached: np.ndarray
    """(k, ...) bool: which goals."""
    worst_margin: np.ndarray
    """(k,) [m] of the goal that is worst off, by its best branch; negative where one is out of reach.
    Where limits count it ends at them too, see `limited_margins`."""
    start: np.ndarray
    """(k, 4, 4) where on the grid each was before it was polished."""
    start_score: np.ndarray
    """(k,) there."""
    start_share: np.ndarray
    """(k,) there."""
    grid: Grid
    """Positions of the candidates."""
    turns: np.ndarray
    """(t,) [rad] about z, from how the arm was given; zero alone where a turn changes nothing."""
    tried: np.ndarray
    """(*grid.shape, t) share of goals reached from every candidate: exact, or as the map has it."""

    def __len__(self) -> int:
        return len(self.base)

    def __str__(self) -> str:
        shape = self.reached.shape[1:]
        count = int(np.prod(shape))
        lines = [
            f"{self.arm.name}: {count:,} goals, {self.tried.size:,} bases tried "
            f"({self.grid.in_words()} x {len(self.turns)} turns)"
        ]
        if not self.reached.any():
            lines.append("  no base reaches any goal; these come nearest")
        for k in range(len(self)):
            number = int(self.reached[k].sum())
            before = round(self.start_share[k] * count)
            lines.append(
                f"  {k + 1:2}  {self._place(k)}: {number:,} goals ({self.share[k]:.1%}), "
                f"worst margin {1000 * self.worst_margin[k]:+.1f} mm; {before:,} before polishing"
            )
        return "\n".join(lines)

    def _place(self, k: int) -> str:
        base = np.asarray(self.base[k], float)
        x, y, z = base[:3, 3]
        turn = base[:3, :3] @ np.asarray(self.arm.base, float)[:3, :3].T
        about = np.degrees(np.arctan2(turn[1, 0] - turn[0, 1], turn[0, 0] + turn[1, 1]))
        tilt = np.degrees(np.arctan2(np.hypot(turn[0, 2], turn[1, 2]), turn[2, 2]))
        leaning = f", tilted {tilt:.1f} deg" if tilt > 0.05 else ""
        return f"x {x:+.3f}, y {y:+.3f}, z {z:+.3f} m, turned {about:+.1f} deg{leaning}"
