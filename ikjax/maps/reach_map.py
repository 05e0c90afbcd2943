"""The map that a sweep makes, as arrays and in words; and the comparison of two maps."""

import dataclasses
import os
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from ikjax.arm.arm import Arm
from ikjax.arm.recognition import lock
from ikjax.core.text import line
from ikjax.maps import statistics
from ikjax.maps.sets.orientations import Orientations
from ikjax.maps.sets.orientations import from_spec as orientations_from_spec
from ikjax.maps.sets.positions import Grid, Shell
from ikjax.maps.sets.surface import Surface
from ikjax.maps.store import manifest, store
from ikjax.maps.store.lock import Lock
from ikjax.maps.store.storage import Storage


class Measured(NamedTuple):
    """What positions of a box grid are measured by."""

    name: str
    unit: str
    whole: str
    """What all of them are."""


MEASURES = {
    3: Measured("volume", "m^3", "the box"),
    2: Measured("area", "m^2", "the layer"),
    1: Measured("length", "m", "the line"),
}
"""By the dimension of the grid."""


class Units(NamedTuple):
    """What a sweep found at `out` when it started."""

    total: int
    """Work units of the whole map."""
    kept: int
    """Units that were there and could be read."""
    missing: int
    """Units of which at least one chunk was missing."""
    damaged: int
    """Units whose chunks were all there, but not as they had been written."""

    def __str__(self) -> str:
        if self.missing == self.total:
            return f"new map, {self.total} unit{'s' if self.total > 1 else ''}"
        return f"{self.kept} of {self.total} units kept, {self.missing} missing, {self.damaged} damaged"


@dataclasses.dataclass(frozen=True, eq=False)
class ReachMap:
    """Statistics of every position of a set, over one set of orientations.

    Of a stored map only the axes and rotations are read at once: `reach.reachable` reads a whole array,
    `reach.arrays["reachable"][:, :, 3]` a slice.
    """

    arm: Arm
    """The arm that was swept."""
    positions: Grid | Shell | Surface
    orientations: Orientations
    free_rolls: int
    """Turns about the tool's z axis of which one has to be reached; 1 where the tool must not turn."""
    dtype: str
    """Floating type of the kernel that made it, "float32" or "float64"."""
    statistic_specs: Mapping[str, dict[str, Any]]
    """The spec of each statistic by name: its "dtype", the names "axes" and sizes "shape" of its axes after
    those of the positions, and what else tells it from another of its name."""
    arrays: Mapping[str, Any]
    """The statistics by name, each (*positions.shape, ...): numpy arrays, or stored ones that are read when
    indexed."""
    seconds: float
    """Duration without compiling; of a resumed sweep, what all units would take at its last rate."""
    units: Units | None = None
    """Of a sweep into a store: what was there before. Else None."""
    redundancy_samples: int = 1
    """Values of each redundant joint of which one has to reach a goal; 1 where there is none."""
    title: str = ""
    """What tells it from other maps, for pictures and pages; empty where nothing was said."""

    def __post_init__(self):
        object.__setattr__(self, "title", line(self.title))

    @property
    def heading(self) -> str:
        """The title, with the arm's name before it."""
        return f"{self.arm.name}, {self.title}" if self.title else self.arm.name

    def __repr__(self) -> str:
        rolls = f" x {self.free_rolls} free rolls" if self.free_rolls > 1 else ""
        lines = [
            f"<ReachMap of {self.heading}: {self.positions.in_words()}",
            f"  {self.orientation_count:,} orientations{rolls}, {self.dtype}",
            f"  statistics: {', '.join(self.arrays)}",
        ]
        if isinstance(self.arrays.get("reachable_within"), np.ndarray):  # a stored one is not read for this
            lines.append(f"  {(self.reachable_within > 0).mean():.1%} of the positions are reached")
        return "\n".join(lines) + ">"

    def _read(self, name: str) -> np.ndarray:
        """A statistic, read whole; ValueError where the map was made without it."""
        if name not in self.arrays:
            raise ValueError(f"this map was made without {name}, it has {', '.join(self.arrays)}")
        return np.asarray(self.arrays[name])

    @property
    def reachable(self) -> np.ndarray:
        """int32 (*positions.shape): number of orientations with a solution."""
        return self._read("reachable")

    @property
    def solutions(self) -> np.ndarray:
        """int32 (*positions.shape): number of solutions over all orientations."""
        return self._read("solutions")

    @property
    def reachable_within(self) -> np.ndarray:
        """int32 (*positions.shape): number of orientations with a solution within the joint limits."""
        return self._read("reachable_within")

    @property
    def solutions_within(self) -> np.ndarray:
        """int32 (*positions.shape): number of solutions within the joint limits over all orientations."""
        return self._read("solutions_within")

    @property
    def best_margin(self) -> np.ndarray:
        """float32 (*positions.shape): greatest margin [m] of any orientation and slot, without limits."""
        return self._read("best_margin")

    @property
    def orientation_count(self) -> int:
        """Number of orientations at every position."""
        return self.orientations.count

    @property
    def rotations(self) -> np.ndarray:
        """The orientations (m, 3, 3); on a surface with normals, in the frame of the surface."""
        return self.orientations.rotations

    def reached(self, place: tuple[int, ...] | slice = slice(None), within: bool = True) -> np.ndarray:
        """Which orientations are reached, bool (..., m); needs the statistic `mask_within` or `mask`.

        Args:
            place: Index of a position or of several; everything by default.
            within: Only solutions within the joint limits count.

        Raises:
            ValueError: The map was made without that statistic.
        """
        name = "mask_within" if within else "mask"
        if name not in self.arrays:
            raise ValueError(f"this map was made without {name}, it has {', '.join(self.arrays)}")
        return statistics.unpacked_mask(np.asarray(self.arrays[name][place]), self.orientation_count)

    @property
    def goals(self) -> int:
        """Number of goals solved."""
        return self.positions.count * self.orientation_count

    @property
    def dexterity(self) -> np.ndarray:
        """Share of orientations reachable within the joint limits, 0 to 1, (*positions.shape)."""
        return self.reachable_within / self.orientation_count

    def numbers(self) -> dict[str, Any]:
        """The headline figures by name, as far as the statistics give them: see `summary` for their meaning.

        Volumes are in m^3, areas of one layer in m^2, lengths of one line in m. `reach` and `height` [m] are
        measured from the base of axis 1, across and along that axis; the rest are numbers, shares from 0 to
        1, and seconds.
        """
        figures: dict[str, Any] = {
            "positions": self.positions.count,
            "orientations": self.orientation_count,
            "goals": self.goals,
        }
        if "reachable" in self.arrays:
            figures["goals_reachable"] = float(self.reachable.sum() / self.goals)
        if "reachable_within" in self.arrays:
            figures |= self._numbers_within()
        for end in ("", "_within"):
            if f"solutions{end}" in self.arrays and f"reachable{end}" in self.arrays:
                solutions, reached = self._read(f"solutions{end}"), self._read(f"reachable{end}")
                figures[f"solutions_per_goal{end}"] = float(solutions.sum() / max(reached.sum(), 1))
        if statistics.LIMITED_BY in self.arrays:
            lost = self._read(statistics.LIMITED_BY).reshape(-1, self.arm.n).sum(0, dtype=np.int64)
            figures[statistics.LIMITED_BY] = (lost / self.goals).tolist()
        rate = self.goals / self.seconds if self.seconds else 0.0
        return {**figures, "seconds": self.seconds, "goals_per_second": rate}

    def _numbers_within(self) -> dict[str, float]:
        """The figures of what is reachable within the joint limits."""
        hit, dexterity = self.reachable_within > 0, self.dexterity
        base = np.asarray(self.arm.base, float)
        offset = self.positions.points()[hit] - base[:3, 3]
        height = offset @ base[:3, 2]
        across = offset - height[:, None] * base[:3, 2]
        volumes = {}
        if isinstance(self.positions, Grid):
            measure = MEASURES.get(self.positions.dimension)
            if measure is not None:
                volumes[measure.name] = self.positions.size(hit)
                volumes[f"dexterous_{measure.name}"] = self.positions.size(dexterity >= 0.5)
        elif not isinstance(self.positions, Surface):
            volumes["volume"] = self.positions.volume(hit)
            volumes["dexterous_volume"] = self.positions.volume(dexterity >= 0.5)
        return {
            "reach": float(np.linalg.norm(across, axis=1).max(initial=0.0)),
            "height": float(height.max(initial=0.0)),
            "positions_reachable": float(hit.mean()),
            "positions_dexterous": float((dexterity >= 0.5).mean()),
            "mean_dexterity": float(dexterity[hit].mean()) if hit.any() else 0.0,
            "best_dexterity": float(dexterity.max(initial=0.0)),
            "goals_reachable_within": float(self.reachable_within.sum() / self.goals),
            **volumes,
        }

    def summary(self) -> str:
        """The headline figures in a few lines for people."""
        n = self.numbers()
        rolls = f", free to turn ({self.free_rolls} tried)" if self.free_rolls > 1 else ""
        redundant = " and ".join(self.arm.redundant)
        values = f", {self.redundancy_samples} values of {redundant}" if redundant else ""
        lines = [
            f"{self.heading}: {n['goals']:,} goals, {self.positions.in_words()} "
            f"x {n['orientations']:,} orientations{rolls}{values}"
        ]
        if "reach" in n:
            measure = next((each for each in MEASURES.values() if each.name in n), None)
            part = "the points" if measure is None else measure.whole
            part = part if isinstance(self.positions, Grid | Surface) else "them"
            volume, half = "", f"{n['positions_dexterous']:.1%} of them"
            if measure is not None:
                volume = f", {n[measure.name]:.3f} {measure.unit}"
                half = f"{n[f'dexterous_{measure.name}']:.3f} {measure.unit}"
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
                f"{anyhow:.2f} without limits{', at all values together' if redundant else ''}"
            )
        if "goals_reachable" in n and "goals_reachable_within" in n:
            lines.append(
                f"  limits cost       {n['goals_reachable']:.1%} of goals fall to "
                f"{n['goals_reachable_within']:.1%}"
            )
        if statistics.LIMITED_BY in n:
            lines.append(f"  of these          {self._limits_in_words(n[statistics.LIMITED_BY])}")
        kind = (
            f"{self.dtype}{', certified in float64' if manifest.is_certified(self.statistic_specs) else ''}"
        )
        lines.append(
            f"  speed             {n['goals_per_second'] / 1e6:.1f} million goals/s, {kind}, "
            f"{n['seconds']:.2f} s"
        )
        return "\n".join(lines)

    def _limits_in_words(self, lost: list[float]) -> str:
        """Which joint's limits cost goals that no other limits cost, the most first."""
        names = self.arm.joint_names or lock.numbered(self.arm.n)
        order = sorted(range(self.arm.n), key=lambda i: -lost[i])
        words = [f"{names[i]} {lost[i]:.2%}" for i in order if lost[i] > 0]
        return f"lost to one joint alone: {', '.join(words)}" if words else "none is lost to one joint alone"

    def to_numpy(self) -> dict[str, np.ndarray]:
        """Every statistic, read whole."""
        return {name: self._read(name) for name in self.arrays}

    def to_xarray(self) -> Any:
        """An `xarray.Dataset` of the statistics over the axes of the positions [m].

        Raises:
            ImportError: xarray is not installed.
        """
        try:
            import xarray
        except ImportError as error:
            raise ImportError("to_xarray needs xarray: pip install 'ikjax[xarray]'") from error
        coords = {name: (axes, array) for name, (array, axes) in self.positions.named().items()}
        values = {
            name: ((*self.positions.axes, *self.statistic_specs[name]["axes"]), value)
            for name, value in self.to_numpy().items()
        }
        facts: dict[str, Any] = {
            "arm": self.arm.name,
            "title": self.title,
            "tool": np.asarray(self.arm.tool, float).ravel().tolist(),
            "base": np.asarray(self.arm.base, float).ravel().tolist(),
            "branches": list(self.arm.branches),
            "joints": list(self.arm.joint_names or lock.numbered(self.arm.n)),
            "units": "m, rad; tool is T_flange_tool, base T_world_base, row by row",
            "orientations": self.orientation_count,
            "free_rolls": self.free_rolls,
            "dtype": self.dtype,
        }
        return xarray.Dataset(values, coords=coords, attrs={**facts, "ikjax_schema": manifest.SCHEMA})

    def save(
        self, out: str | os.PathLike, *, chunk: Sequence[int] | None = None, force: bool = False
    ) -> None:
        """Write the map as a zarr v3 group; see `maps.store.store`.

        Args:
            out: A folder, or a URL that tensorstore knows.
            chunk: Positions of a chunk along each axis; by default about 2^26 goals.
            force: Replace a map that is there.

        Raises:
            FileExistsError: Something is there.
            StorageError: It cannot be written.
            ValueError: Another process is writing there.
        """
        spec, fixed = manifest.describe(self)
        chunk = (
            manifest.default_chunk(self.positions.shape, self.orientation_count)
            if chunk is None
            else tuple(chunk)
        )
        head = manifest.Head(spec, manifest.arm_spec(self.arm), chunk, "sweeping", 0.0, self.title)
        storage, values = Storage(out), self.to_numpy()
        with Lock(storage):
            disk = store.begin(storage, head, fixed, resume=False, force=force, chunk_given=True)
            for number in range(len(disk.units)):
                box = disk.box(number)
                disk.settle(number, disk.put(number, {name: value[box] for name, value in values.items()}))
            disk.write_state("complete", self.seconds)

    @staticmethod
    def load(out: str | os.PathLike) -> "ReachMap":
        """A stored map; its statistics are read when they are asked for.

        Args:
            out: A folder, or a URL that tensorstore knows.

        Raises:
            ValueError: There is no map, or it has another schema, is unfinished or damaged: the message says
                which. A damaged chunk is found when it is read.
            StorageError: It cannot be read.
        """
        storage = Storage(out)
        head, arrays = store.read(storage)
        fixed = {name: np.asarray(arrays[name]) for name in head.spec["fixed"]}
        for name, array in fixed.items():
            if manifest.array_hash(array) != head.spec["fixed"][name]["sha256"]:
                raise ValueError(f"{storage}: {name} is not that of its spec")
        return ReachMap(
            arm=manifest.arm_from_spec(head.arm),
            positions=_positions_from_spec(head.spec["positions"], fixed),
            orientations=orientations_from_spec(head.spec["orientations"], fixed.get("rotations")),
            free_rolls=head.spec["free_rolls"],
            dtype=head.spec["dtype"],
            statistic_specs=head.spec["statistics"],
            arrays={name: arrays[name] for name in head.names},
            seconds=head.seconds,
            redundancy_samples=head.spec.get(manifest.SAMPLES, 1),
            title=head.title,
        )


def _positions_from_spec(spec: dict[str, Any], fixed: dict[str, np.ndarray]) -> Grid | Shell | Surface:
    """The set of positions that a spec describes; `Surface` needs the arrays that the map stores of it."""
    if spec["kind"] == "Surface":
        return Surface(fixed["points"], fixed.get("normals"))
    if spec["kind"] == "Shell":
        return Shell(tuple(spec["center"]), tuple(spec["radii"]), spec["directions"])
    return Grid(tuple(spec["origin"]), spec["spacing"], tuple(spec["shape"]))


FIGURES = (
    ("goals", "{:,.0f}"),
    ("reach", "{:.3f} m"),
    ("height", "{:+.3f} m"),
    ("volume", "{:.3f} m^3"),
    ("area", "{:.3f} m^2"),
    ("length", "{:.3f} m"),
    ("mean_dexterity", "{:.2%}"),
    ("best_dexterity", "{:.2%}"),
    ("dexterous_volume", "{:.3f} m^3"),
    ("dexterous_area", "{:.3f} m^2"),
    ("dexterous_length", "{:.3f} m"),
    ("solutions_per_goal", "{:.3f}"),
    ("solutions_per_goal_within", "{:.3f}"),
    ("goals_per_second", "{:,.0f}"),
)
"""Figures of `ReachMap.numbers` that are compared, and their formats."""


def compare(then: ReachMap, now: ReachMap) -> dict[str, Any]:
    """The figures of two maps by name, each as [then, now].

    Args:
        then: The earlier map, or the first.
        now: The later map, or the second.

    Returns:
        The figures that both maps have. If they have the same positions and as many orientations, also
        `positions_that_differ`: how many have another number of orientations reachable within limits.
    """
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
    """The figures of `compare` in words, one line for each.

    Args:
        figures: From `compare`.
        then: Name of the earlier map.
    """
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
