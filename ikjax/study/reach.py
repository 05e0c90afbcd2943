"""The map a sweep makes: what it says, in arrays and in words.

Storey: study.
"""

import dataclasses
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from ikjax.arm.arm import Arm
from ikjax.study import layout, spec, store
from ikjax.study.goals import Grid
from ikjax.study.lock import Lock
from ikjax.study.place import Place


class Units(NamedTuple):
    """What a sweep found at `out` when it began."""

    total: int
    """Work units of the whole map."""
    kept: int
    """Units that were there and whole."""
    missing: int
    """Units of which a chunk was not there."""
    damaged: int
    """Units of which a chunk was not as it had been written."""

    def __str__(self) -> str:
        return f"{self.kept} of {self.total} units kept, {self.missing} missing, {self.damaged} damaged"


@dataclasses.dataclass(frozen=True, eq=False)
class ReachMap:
    """Statistics of every position of a grid, over one set of orientations.

    Of a stored map nothing but the axes and rotations is read before it is asked for; `reach.reachable`
    reads the whole array, `reach.arrays["reachable"][:, :, 3]` a slice.
    """

    arm: Arm
    grid: Grid
    rotations: np.ndarray
    """(m, 3, 3) the orientations."""
    dtype: str
    """Floating type of the kernel that made it."""
    arrays: Mapping[str, Any]
    """The statistics by name, each grid.shape: numpy arrays, or stored ones that are read when indexed."""
    seconds: float
    """What the sweep took, without the compile; of one gone on with, what all would take at its last rate."""
    units: Units | None = None
    """Of a sweep into a store: what was there before."""

    def _read(self, name: str) -> np.ndarray:
        if name not in self.arrays:
            raise ValueError(f"this map was made without {name}, it has {', '.join(self.arrays)}")
        return np.asarray(self.arrays[name])

    @property
    def reachable(self) -> np.ndarray:
        """int32, grid.shape: orientations with a solution."""
        return self._read("reachable")

    @property
    def solutions(self) -> np.ndarray:
        """int32: solutions, summed over orientations."""
        return self._read("solutions")

    @property
    def reachable_within(self) -> np.ndarray:
        """int32: orientations with a solution within the joint limits."""
        return self._read("reachable_within")

    @property
    def solutions_within(self) -> np.ndarray:
        """int32: solutions within the joint limits."""
        return self._read("solutions_within")

    @property
    def best_margin(self) -> np.ndarray:
        """float32: greatest margin of any orientation and slot [m], limits left out."""
        return self._read("best_margin")

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
        reachable, within = self.reachable, self.reachable_within
        hit, dexterity = within > 0, within / self.orientations
        axis = np.asarray(self.arm.base, float)
        away = self.grid.points()[hit] - axis[:3, 3]
        across = away - (away @ axis[:3, 2])[:, None] * axis[:3, 2]
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
            "goals_reachable": float(reachable.sum() / self.goals),
            "goals_reachable_within": float(within.sum() / self.goals),
            "solutions_per_goal": float(self.solutions.sum() / max(reachable.sum(), 1)),
            "solutions_per_goal_within": float(self.solutions_within.sum() / max(within.sum(), 1)),
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

    def to_numpy(self) -> dict[str, np.ndarray]:
        """Every statistic, read whole."""
        return {name: self._read(name) for name in self.arrays}

    def to_xarray(self) -> Any:
        """An `xarray.Dataset` of the statistics over x, y and z [m]."""
        try:
            import xarray
        except ImportError as error:
            raise ImportError("to_xarray needs xarray: pip install 'ikjax[xarray]'") from error
        axes = {name: (name, self.grid.axis(k), {"units": "m"}) for k, name in enumerate(layout.AXES)}
        values = {name: (layout.AXES, value) for name, value in self.to_numpy().items()}
        facts = {"arm": self.arm.name, "orientations": self.orientations, "dtype": self.dtype}
        return xarray.Dataset(values, coords=axes, attrs={**facts, "ikjax_schema": spec.SCHEMA})

    def save(self, out, *, chunk=None) -> None:
        """Write the map as a zarr v3 group; see `store`.

        Args:
            out: A folder, or a URL that tensorstore knows. A finished map there is replaced.
            chunk: Positions (3,) of a chunk.

        Raises:
            FileExistsError: Something else than a finished map is there.
        """
        study = spec.of_study(self.arm, self.grid, self.rotations, self.dtype, tuple(self.arrays))
        chunk = layout.default_chunk(self.grid.shape, self.orientations) if chunk is None else tuple(chunk)
        head = layout.Head(study, spec.of_arm(self.arm), chunk, "sweeping", 0.0)
        fixed = layout.fixed(self.grid, self.rotations)
        place, values = Place(out), self.to_numpy()
        with Lock(place):
            disk = store.begin(place, head, fixed, resume=False, chunk_given=True)
            for number in range(len(disk.units)):
                box = disk.box(number)
                disk.settle(number, disk.put(number, {name: value[box] for name, value in values.items()}))
            disk.say("complete", self.seconds)

    @staticmethod
    def load(out) -> "ReachMap":
        """A stored map; its statistics are read when they are asked for.

        Raises:
            ValueError: No map there, of another schema, unfinished, or damaged: the message says which. A
                chunk that is damaged is found when it is read.
        """
        place = Place(out)
        head, arrays = store.read(place)
        rotations = np.asarray(arrays["rotations"])
        if spec.hash_of(rotations) != head.spec["rotations"]["sha256"]:
            raise ValueError(f"{place}: rotations are not those of its spec")
        grid = head.spec["grid"]
        return ReachMap(
            arm=spec.to_arm(head.arm),
            grid=Grid(tuple(grid["origin"]), grid["spacing"], tuple(grid["shape"])),
            rotations=rotations,
            dtype=head.spec["dtype"],
            arrays={name: arrays[name] for name in head.spec["statistics"]},
            seconds=head.seconds,
        )
