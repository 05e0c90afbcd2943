"""The map that a sweep makes, in arrays and in words; and two of them compared."""

import dataclasses
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from ikjax.arm.arm import Arm
from ikjax.maps import statistics
from ikjax.maps.sets.orientations import Orientations
from ikjax.maps.sets.orientations import from_spec as orientations_from
from ikjax.maps.sets.positions import Grid, Shell
from ikjax.maps.sets.surface import Surface
from ikjax.maps.store import manifest, store
from ikjax.maps.store.lock import Lock
from ikjax.maps.store.storage import Place


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
    """Statistics of every position of a set, over one set of orientations.

    Of a stored map nothing but the axes and rotations is read before it is asked for; `reach.reachable`
    reads the whole array, `reach.arrays["reachable"][:, :, 3]` a slice.
    """

    arm: Arm
    positions: Grid | Shell | Surface
    orientations: Orientations
    free_rolls: int
    """Turns about the tool's z axis of which one has to be reached; 1 where it must not turn."""
    dtype: str
    """Floating type of the kernel that made it."""
    statistic_specs: Mapping[str, dict[str, Any]]
    """What the spec says of each statistic: "axes" are those after the positions'."""
    arrays: Mapping[str, Any]
    """The statistics by name, each (*positions.shape, ...): numpy arrays, or stored ones that are read when
    indexed."""
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
        """int32, positions.shape: orientations with a solution."""
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
    def orientation_count(self) -> int:
        """Number of orientations at every position."""
        return self.orientations.count

    @property
    def rotations(self) -> np.ndarray:
        """(m, 3, 3) the orientations; on a surface with normals as they are seen from it."""
        return self.orientations.rotations

    def reached(self, place: tuple[int, ...] | slice = slice(None), within: bool = True) -> np.ndarray:
        """Which orientations are reached, (..., m) bool; needs the statistic `mask_within` or `mask`.

        Args:
            place: Index of a position or of several; everything by default.
            within: Within the joint limits.
        """
        name = "mask_within" if within else "mask"
        if name not in self.arrays:
            raise ValueError(f"this map was made without {name}, it has {', '.join(self.arrays)}")
        return statistics.unpacked(np.asarray(self.arrays[name][place]), self.orientation_count)

    @property
    def goals(self) -> int:
        """Number of goals solved."""
        return self.positions.count * self.orientation_count

    @property
    def dexterity(self) -> np.ndarray:
        """Share of orientations reachable within the joint limits, 0 to 1."""
        return self.reachable_within / self.orientation_count

    def numbers(self) -> dict[str, Any]:
        """The headline figures, those that the statistics tell: see `summary` for their meaning."""
        told: dict[str, Any] = {
            "positions": self.positions.count,
            "orientations": self.orientation_count,
            "goals": self.goals,
        }
        if "reachable" in self.arrays:
            told["goals_reachable"] = float(self.reachable.sum() / self.goals)
        if "reachable_within" in self.arrays:
            told |= self._numbers_within()
        for end in ("", "_within"):
            if f"solutions{end}" in self.arrays and f"reachable{end}" in self.arrays:
                solutions, reached = self._read(f"solutions{end}"), self._read(f"reachable{end}")
                told[f"solutions_per_goal{end}"] = float(solutions.sum() / max(reached.sum(), 1))
        rate = self.goals / self.seconds if self.seconds else 0.0
        return {**told, "seconds": self.seconds, "goals_per_second": rate}

    def _numbers_within(self) -> dict[str, float]:
        hit, dexterity = self.reachable_within > 0, self.dexterity
        axis = np.asarray(self.arm.base, float)
        away = self.positions.points()[hit] - axis[:3, 3]
        across = away - (away @ axis[:3, 2])[:, None] * axis[:3, 2]
        volumes = {}
        if not isinstance(self.positions, Surface):
            volumes["volume"] = self.positions.volume(hit)
            volumes["dexterous_volume"] = self.positions.volume(dexterity >= 0.5)
        return {
            "reach": float(np.linalg.norm(across, axis=1).max(initial=0.0)),
            "height": float((away @ axis[:3, 2]).max(initial=0.0)),
            "positions_reachable": float(hit.mean()),
            "positions_dexterous": float((dexterity >= 0.5).mean()),
            "mean_dexterity": float(dexterity[hit].mean()) if hit.any() else 0.0,
            "best_dexterity": float(dexterity.max(initial=0.0)),
            "goals_reachable_within": float(self.reachable_within.sum() / self.goals),
            **volumes,
        }

    def summary(self) -> str:
        """The map in a few lines for people."""
        n = self.numbers()
        rolls = f", free to turn ({self.free_rolls} tried)" if self.free_rolls > 1 else ""
        lines = [
            f"{self.arm.name}: {n['goals']:,} goals, {self.positions.in_words()} "
            f"x {n['orientations']:,} orientations{rolls}"
        ]
        if "reach" in n:
            part = (
                "the points"
                if "volume" not in n
                else "the box"
                if isinstance(self.positions, Grid)
                else "them"
            )
            volume = f", {n['volume']:.3f} m^3" if "volume" in n else ""
            half = f"{n['dexterous_volume']:.3f} m^3" if volume else f"{n['positions_dexterous']:.1%} of them"
            lines += [
                f"  reach             {n['reach']:.3f} m from axis 1, up to {n['height']:+.3f} m",
                f"  positions reached {n['positions_reachable']:.1%} of {part}{volume}",
                f"  mean dexterity    {n['mean_dexterity']:.1%} of orientations where it reaches at all, "
                f"{n['best_dexterity']:.1%} at best",
                f"  half or more      of all orientations in {half}",
            ]
        within, anyhow = n.get("solutions_per_goal_within"), n.get("solutions_per_goal")
        if within is not None and anyhow is not None:
            lines.append(
                f"  solutions         {within:.2f} a reachable goal within limits, "
                f"{anyhow:.2f} without limits"
            )
        if "goals_reachable" in n and "goals_reachable_within" in n:
            lines.append(
                f"  limits cost       {n['goals_reachable']:.1%} of goals fall to "
                f"{n['goals_reachable_within']:.1%}"
            )
        kind = (
            f"{self.dtype}{', certified in float64' if manifest.is_certified(self.statistic_specs) else ''}"
        )
        lines.append(
            f"  speed             {n['goals_per_second'] / 1e6:.1f} million goals/s, {kind}, "
            f"{n['seconds']:.2f} s"
        )
        return "\n".join(lines)

    def to_numpy(self) -> dict[str, np.ndarray]:
        """Every statistic, read whole."""
        return {name: self._read(name) for name in self.arrays}

    def to_xarray(self) -> Any:
        """An `xarray.Dataset` of the statistics over the axes of the positions [m]."""
        try:
            import xarray
        except ImportError as error:
            raise ImportError("to_xarray needs xarray: pip install 'ikjax[xarray]'") from error
        coords = {name: (axes, array) for name, (array, axes) in self.positions.named().items()}
        values = {
            name: ((*self.positions.axes, *self.statistic_specs[name]["axes"]), value)
            for name, value in self.to_numpy().items()
        }
        facts = {"arm": self.arm.name, "orientations": self.orientation_count, "dtype": self.dtype}
        return xarray.Dataset(values, coords=coords, attrs={**facts, "ikjax_schema": manifest.SCHEMA})

    def save(self, out, *, chunk=None, force: bool = False) -> None:
        """Write the map as a zarr v3 group; see `store`.

        Args:
            out: A folder, or a URL that tensorstore knows.
            chunk: Positions of a chunk along each axis.
            force: Replace a map that is there.

        Raises:
            FileExistsError: Something is there.
        """
        fixed = manifest.fixed(self.positions, self.orientations)
        study = manifest.of_study(
            self.arm,
            self.positions,
            self.orientations,
            self.free_rolls,
            self.dtype,
            self.statistic_specs,
            fixed,
        )
        chunk = (
            manifest.default_chunk(self.positions.shape, self.orientation_count)
            if chunk is None
            else tuple(chunk)
        )
        head = manifest.Head(study, manifest.of_arm(self.arm), chunk, "sweeping", 0.0)
        place, values = Place(out), self.to_numpy()
        with Lock(place):
            disk = store.begin(place, head, fixed, resume=False, force=force, chunk_given=True)
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
        known = {name: np.asarray(arrays[name]) for name in head.spec["fixed"]}
        for name, array in known.items():
            if manifest.hash_of(array) != head.spec["fixed"][name]["sha256"]:
                raise ValueError(f"{place}: {name} is not that of its spec")
        return ReachMap(
            arm=manifest.to_arm(head.arm),
            positions=_positions(head.spec["positions"], known),
            orientations=orientations_from(head.spec["orientations"], known.get("rotations")),
            free_rolls=head.spec["free_rolls"],
            dtype=head.spec["dtype"],
            statistic_specs=head.spec["statistics"],
            arrays={name: arrays[name] for name in head.names},
            seconds=head.seconds,
        )


def _positions(said: dict, known: dict[str, np.ndarray]) -> Grid | Shell | Surface:
    """The set of positions that a spec describes."""
    if said["kind"] == "Surface":
        return Surface(known["points"], known.get("normals"))
    if said["kind"] == "Shell":
        return Shell(tuple(said["center"]), tuple(said["radii"]), said["directions"])
    return Grid(tuple(said["origin"]), said["spacing"], tuple(said["shape"]))


FIGURES = (
    ("goals", "{:,.0f}"),
    ("reach", "{:.3f} m"),
    ("height", "{:+.3f} m"),
    ("volume", "{:.3f} m^3"),
    ("mean_dexterity", "{:.2%}"),
    ("best_dexterity", "{:.2%}"),
    ("dexterous_volume", "{:.3f} m^3"),
    ("solutions_per_goal", "{:.3f}"),
    ("solutions_per_goal_within", "{:.3f}"),
    ("goals_per_second", "{:,.0f}"),
)


def compare(then: ReachMap, now: ReachMap) -> dict[str, Any]:
    """The figures of both by name, as [then, now]; on one grid also `positions_that_differ`."""
    before, after = then.numbers(), now.numbers()
    shared = [name for name, _ in FIGURES if name in before and name in after]
    figures: dict[str, Any] = {name: [before[name], after[name]] for name in shared}
    if (
        then.positions == now.positions
        and then.orientation_count == now.orientation_count
        and "reach" in shared
    ):
        differ = then.reachable_within != now.reachable_within
        figures["positions_that_differ"] = int(differ.sum())
    return figures


def in_words(figures: dict[str, Any], then: str) -> str:
    """What `compare` found, a line a figure."""
    lines = [f"compared with {then}"]
    for name, form in FIGURES:
        if name not in figures:
            continue
        before, after = figures[name]
        share = f" ({after / before - 1:+.1%})" if before and before != after else ""
        lines.append(f"  {name.replace('_', ' '):26} {form.format(before)} -> {form.format(after)}{share}")
    if "positions_that_differ" in figures:
        lines.append(f"  {'positions that differ':26} {figures['positions_that_differ']:,}")
    else:
        lines.append("  positions or orientations are others, so they are not compared one by one")
    return "\n".join(lines)
