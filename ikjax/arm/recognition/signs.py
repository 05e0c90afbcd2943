"""What each family's kernel must know about an arm besides its numbers: one NamedTuple a family.

The rules in `recognition.rules` decide them once, from concrete twists and lengths, and the arm carries them
as `Arm.signs`. They are static: arms of other signs have other programs.
"""

import enum
from collections.abc import Iterable
from typing import Any, NamedTuple


class RegionalSplit(enum.StrEnum):
    """How the equation for joint 3 splits when joints 1 and 2 are eliminated.

    See `solvers.steps.regional`. "Nearly": by no more than `NEARLY_SPLITS`, so that the roots of the equation
    that does not split come in close pairs.
    """

    NONE = ""
    """It is of the full degree."""
    MEET = "meet"
    """Axes 1 and 2 turn and meet: the squared distance from where they meet has joint 3 alone."""
    PARALLEL = "parallel"
    """Axes 1 and 2 turn and are parallel: the height along them has joint 3 alone."""
    SQUARE = "square"
    """One of joints 1 and 2 turns, the other slides at a right angle to its axis: the coordinate along that
    axis has joint 3 alone."""
    SLIDES = "slides"
    """Joints 1 and 2 both slide: the coordinate square to both has joint 3 alone."""
    NEARLY_MEET = "nearly meet"
    NEARLY_PARALLEL = "nearly parallel"
    NEARLY_SQUARE = "nearly square"

    @property
    def is_full(self) -> bool:
        """Whether the equation is solved at its full degree."""
        return self == RegionalSplit.NONE or self.is_nearly

    @property
    def is_nearly(self) -> bool:
        """Whether it nearly splits."""
        return self in NEARLY.values()


NEARLY = {
    RegionalSplit.MEET: RegionalSplit.NEARLY_MEET,
    RegionalSplit.PARALLEL: RegionalSplit.NEARLY_PARALLEL,
    RegionalSplit.SQUARE: RegionalSplit.NEARLY_SQUARE,
}
"""The member that says that an equation nearly splits in such a way."""


class PairSplit(enum.StrEnum):
    """How the two equations for joints A and B of `parallel_axes` split: whether a combination of them has A
    alone, which it has where the coefficients of B are proportional."""

    NONE = ""
    """There is none; the two are solved for B, which leaves a quartic for A."""
    EXACTLY = "exactly"
    """Within the tolerance of a fact."""
    WITHIN_1E_5 = "within 1e-5"
    """Within `SPLITS`: solved as if they split, and then by Newton's method."""
    NEARLY = "nearly"
    """The quartic's roots come in close pairs in both types."""
    NEARLY_IN_FLOAT32 = "nearly in float32"
    """They do in float32 alone."""

    @property
    def is_split(self) -> bool:
        """Whether the equations are solved one after the other."""
        return self in (PairSplit.EXACTLY, PairSplit.WITHIN_1E_5)

    @property
    def is_nearly(self) -> bool:
        """Whether they nearly split."""
        return self in (PairSplit.NEARLY, PairSplit.NEARLY_IN_FLOAT32)


class OrthoParallelWristSigns(NamedTuple):
    up: int
    """+1 where axis 1 points up in the world that the arm was built into."""
    sin_alpha1: int
    """+1 where alpha1 is 90 degrees, -1 where it is -90."""
    cos_alpha2: int
    """Axis 3 against axis 2: +1 parallel, -1 antiparallel."""
    sin_alpha4: int
    """The sign of sin(alpha4)."""
    sin_alpha5: int
    """The sign of sin(alpha5)."""
    square_wrist: int
    """1 where alpha4 and alpha5 are both right angles, else 0."""


class ThreeParallelSigns(NamedTuple):
    up: int
    """+1 where axis 1 points up in the world that the arm was built into."""
    sin_alpha1: int
    """+1 where alpha1 is 90 degrees, -1 where it is -90."""
    cos_alpha2: int
    """Axis 3 against axis 2: +1 parallel, -1 antiparallel."""
    cos_alpha3: int
    """Axis 4 against axis 3: +1 parallel, -1 antiparallel."""
    sin_alpha4: int
    """+1 where alpha4 is 90 degrees, -1 where it is -90."""
    sin_alpha5: int
    """+1 where alpha5 is 90 degrees, -1 where it is -90."""

    @property
    def cos_alpha23(self) -> int:
        """Axis 4 against axis 2."""
        return self.cos_alpha2 * self.cos_alpha3


class PieperSigns(NamedTuple):
    """Of `pieper`, and of `pieper_reversed` for its table read from the tool to the base."""

    split: RegionalSplit
    """How the equation for joint 3 splits."""
    sin_alpha4: int
    """The sign of sin(alpha4)."""
    sin_alpha5: int
    """The sign of sin(alpha5)."""
    square_wrist: int
    """1 where alpha4 and alpha5 are both right angles, else 0."""


class ArmAngleSigns(NamedTuple):
    """Of seven joints with a spherical shoulder and wrist, at a given arm angle; see `arm_angle`."""

    sin_alpha: tuple[int, ...]
    """The signs of sin(alpha1) to sin(alpha6), all right angles."""
    stereographic: bool
    """Which reference the arm angle has: one that is singular in one direction alone, or axis 1."""


class ParallelAxesSigns(NamedTuple):
    first_parallel: int
    """The first of the three parallel axes: 1, 2, 3 or 4."""
    split: PairSplit
    """How the equations for joints A and B split."""
    b_alone: bool
    """Whether it is B that a combination of the equations has alone, and not A."""
    first: int
    """Of the three parallel axes the first against itself: +1."""
    second: int
    """The second against the first: +1 parallel, -1 antiparallel."""
    third: int
    """The third against the first, likewise."""


class OffsetWristSigns(NamedTuple):
    """Of `offset_wrist`, and of `offset_wrist_reversed` for its table read from the tool to the base."""

    up: int
    """+1 where axis 1 points up in the world that the arm was built into."""
    sin_alpha1: int
    """The sign of sin(alpha1)."""
    cos_alpha2: int
    """Axis 3 against axis 2: +1 parallel, -1 antiparallel."""
    shared: int
    """1 where front and back share joint 6, so that the polynomial has degree 4, else 0."""


class ScaraSigns(NamedTuple):
    """Each axis against the first one that turns: +1 parallel, -1 antiparallel."""

    axis1: int
    axis2: int
    axis3: int
    axis4: int


class FiveAxisSigns(NamedTuple):
    up: int
    """+1 where axis 1 points up in the world that the arm was built into."""
    sin_alpha1: int
    """The sign of sin(alpha1)."""
    cos_alpha2: int
    """Axis 3 against axis 2: +1 parallel, -1 antiparallel."""
    cos_alpha3: int
    """Axis 4 against axis 3: +1 parallel, -1 antiparallel."""
    sin_alpha4: int
    """The sign of sin(alpha4)."""

    @property
    def cos_alpha23(self) -> int:
        """Axis 4 against axis 2."""
        return self.cos_alpha2 * self.cos_alpha3


class TurretSigns(NamedTuple):
    axis2: int
    """Axis 2 against itself: +1."""
    axis3: int
    """Axis 3 against axis 2: +1 parallel, -1 antiparallel."""
    axis4: int
    """Axis 4 against axis 2, likewise."""


class PlanarPoseSigns(NamedTuple):
    """Each axis against the plane's normal: +1 or -1. Slides are in the plane; their signs are not used."""

    axis1: int
    axis2: int
    axis3: int


class PlanarPositionSigns(NamedTuple):
    """Each axis against the plane's normal: +1 or -1. Slides are in the plane; their signs are not used."""

    axis1: int
    axis2: int


class PositionSigns(NamedTuple):
    split: RegionalSplit
    """How the equation for joint 3 splits."""


SIGNS: dict[str, Any] = {
    "ortho_parallel_wrist": OrthoParallelWristSigns,
    "three_parallel": ThreeParallelSigns,
    "pieper": PieperSigns,
    "pieper_reversed": PieperSigns,
    "parallel_axes": ParallelAxesSigns,
    "offset_wrist": OffsetWristSigns,
    "offset_wrist_reversed": OffsetWristSigns,
    "scara": ScaraSigns,
    "five_axis": FiveAxisSigns,
    "turret": TurretSigns,
    "planar_pose": PlanarPoseSigns,
    "planar_position": PlanarPositionSigns,
    "position": PositionSigns,
}
"""The NamedTuple of each family, in the order of `recognition.rules.RULES`."""


def named_signs(family: str | None, values: Iterable) -> tuple:
    """The signs of a family under their names, from any sequence of them (a stored map holds a list).

    Of no family, or an unknown one, the plain tuple.

    Raises:
        ValueError: Another number of signs than the family has, or no such split.
    """
    kind, values = SIGNS.get(str(family)), values if isinstance(values, tuple) else tuple(values)
    if kind is None or type(values) is kind:
        return values
    fields: tuple[str, ...] = kind._fields
    if len(values) != len(fields):
        raise ValueError(f"the signs of family {family} must be {', '.join(fields)}, got {values!r}")
    named = dict(zip(fields, values, strict=True))
    if "split" in named:
        named["split"] = kind.__annotations__["split"](named["split"])
    return kind(**named)
