"""The map a sweep makes: what it says, in arrays and in words.

Storey: study.
"""

import dataclasses

import numpy as np

from ikjax.arm.arm import Arm
from ikjax.study import store
from ikjax.study.goals import Grid

STATISTICS = ("reachable", "solutions", "reachable_within", "solutions_within", "best_margin")


@dataclasses.dataclass(frozen=True, eq=False)
class ReachMap:
    """Statistics of every position of a grid, over one set of orientations."""

    arm: Arm
    grid: Grid
    rotations: np.ndarray
    """(m, 3, 3) the orientations."""
    dtype: str
    """Floating type of the kernel that made it."""
    reachable: np.ndarray
    """int32, grid.shape: orientations with a solution."""
    solutions: np.ndarray
    """int32: solutions, summed over orientations."""
    reachable_within: np.ndarray
    """int32: orientations with a solution within the joint limits."""
    solutions_within: np.ndarray
    """int32: solutions within the joint limits."""
    best_margin: np.ndarray
    """float32: greatest margin of any orientation and slot [m], limits left out."""
    seconds: float
    """What the sweep took, without the compile."""

    @property
    def orientations(self) -> int:
        """Number of orientations at every position."""
        return len(self.rotations)

    @property
    def goals(self) -> int:
        """Number of goals solved."""
        return self.grid.count * self.orientations

    @property
    def dexterity(self) -> np.ndarray:
        """Share of orientations reachable within the joint limits, 0 to 1."""
        return self.reachable_within / self.orientations

    def numbers(self) -> dict[str, float]:
        """The headline figures: see `summary` for their meaning."""
        hit = self.reachable_within > 0
        axis = np.asarray(self.arm.base, float)
        away = self.grid.points()[hit] - axis[:3, 3]
        across = away - (away @ axis[:3, 2])[:, None] * axis[:3, 2]
        dexterity = self.dexterity
        return {
            "positions": self.grid.count,
            "orientations": self.orientations,
            "goals": self.goals,
            "reach": float(np.linalg.norm(across, axis=1).max(initial=0.0)),
            "height": float((away @ axis[:3, 2]).max(initial=0.0)),
            "positions_reachable": float(hit.mean()),
            "volume": float(hit.sum() * self.grid.spacing**3),
            "mean_dexterity": float(dexterity[hit].mean()) if hit.any() else 0.0,
            "best_dexterity": float(dexterity.max(initial=0.0)),
            "dexterous_volume": float((dexterity >= 0.5).sum() * self.grid.spacing**3),
            "goals_reachable": float(self.reachable.sum() / self.goals),
            "goals_reachable_within": float(self.reachable_within.sum() / self.goals),
            "solutions_per_goal": float(self.solutions.sum() / max(self.reachable.sum(), 1)),
            "solutions_per_goal_within": float(
                self.solutions_within.sum() / max(self.reachable_within.sum(), 1)
            ),
            "seconds": self.seconds,
            "goals_per_second": self.goals / self.seconds if self.seconds else 0.0,
        }

    def summary(self) -> str:
        """The map in a few lines for people."""
        n = self.numbers()
        return "\n".join(
            [
                f"{self.arm.name}: {n['goals']:,} goals, {n['positions']:,} positions "
                f"({self.grid.spacing * 1000:g} mm apart) x {n['orientations']:,} orientations",
                f"  reach             {n['reach']:.3f} m from axis 1, up to {n['height']:+.3f} m",
                f"  positions reached {n['positions_reachable']:.1%} of the box, {n['volume']:.3f} m^3",
                f"  mean dexterity    {n['mean_dexterity']:.1%} of orientations where it reaches at all, "
                f"{n['best_dexterity']:.1%} at best",
                f"  half or more      of all orientations in {n['dexterous_volume']:.3f} m^3",
                f"  solutions         {n['solutions_per_goal_within']:.2f} a reachable goal within limits, "
                f"{n['solutions_per_goal']:.2f} without limits",
                f"  limits cost       {n['goals_reachable']:.1%} of goals fall to "
                f"{n['goals_reachable_within']:.1%}",
                f"  speed             {n['goals_per_second'] / 1e6:.1f} million goals/s, {self.dtype}, "
                f"{n['seconds']:.2f} s",
            ]
        )

    def save(self, path) -> None:
        """Write the map as a zarr v3 group; see `store`.

        Raises:
            FileExistsError: Something else than a map stands at `path`.
        """
        arrays = {name: getattr(self, name) for name in STATISTICS}
        spec = {
            "arm": store.arm_to_spec(self.arm),
            "grid": dataclasses.asdict(self.grid),
            "dtype": self.dtype,
            "seconds": self.seconds,
        }
        store.write(path, spec, {**arrays, "rotations": self.rotations})

    @staticmethod
    def load(path) -> "ReachMap":
        """Read a map that `save` wrote.

        Raises:
            ValueError: No map there, of another schema, or damaged: the message says which.
        """
        spec, arrays = store.read(path, (*STATISTICS, "rotations"))
        grid = Grid(tuple(spec["grid"]["origin"]), spec["grid"]["spacing"], tuple(spec["grid"]["shape"]))
        arm = store.arm_from_spec(spec["arm"])
        return ReachMap(arm=arm, grid=grid, dtype=spec["dtype"], seconds=spec["seconds"], **arrays)
