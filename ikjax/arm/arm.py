"""The arm: DH numbers as differentiable leaves, and the few facts that are fixed when it is built.


Source of the conventions: standard DH after Spong, Robot Modeling and Control, section 3.2;
modified DH after Craig, Introduction to Robotics, 3rd ed., section 3.4.
"""

import dataclasses
import math
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ikjax.arm import dh, printing
from ikjax.arm.axes_to_dh import Axes, Rewritten, rewritten, size_of
from ikjax.arm.recognition import free_parameters, recognize
from ikjax.arm.recognition.rules import RULES
from ikjax.arm.recognition.signs import named_signs
from ikjax.core import pose as poses
from ikjax.core import text
from ikjax.core.known import as_array, constants, is_traced
from ikjax.core.tolerances import AXIS_LADDER, COMPLETE, FACT, LARGEST_AXIS_TOLERANCE, TABLE_SPREAD
from ikjax.core.trig import Scalar
from ikjax.core.warn import warn

Number = jax.Array | np.ndarray


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True, eq=False)
class Arm:
    """A serial arm with n joints, in standard DH with a base and a tool.

    Link i maps frame i + 1 to frame i: Rz(theta) Tz(d) Tx(a) Rx(alpha), where the joint adds q[i]
    to `theta` (R) or to `d` (P). All leaves may be traced, batched by vmap and differentiated;
    build one with `Arm.from_dh`, vary it with `dataclasses.replace(arm, a=...)`.
    """

    a: Number
    """(n,) link lengths [m]."""
    alpha: Number
    """(n,) link twists [rad]."""
    d: Number
    """(n,) link offsets [m]."""
    theta: Number
    """(n,) joint angles at q = 0 [rad]."""
    base: Number
    """(4, 4) T_world_base."""
    tool: Number
    """(4, 4) T_flange_tool: the tool in the frame of the last link."""
    limits: Number
    """(n, 2) lower and upper joint limit [rad, m]; infinite where there is none."""
    coupling: Number | None = dataclasses.field(default=None, kw_only=True)
    """(n, n) from motor values, which are what `q` holds, to joint values; None is the identity."""
    correction: Number | None = dataclasses.field(default=None, kw_only=True)
    """(n + 1, 6) what the arm as given is off by after the base and after each link: shift [m], rotation
    vector [rad]. The table holds the arm as recognized; None is nothing."""

    kinds: str = dataclasses.field(metadata={"static": True})
    """The joints from base to tool, "R" or "P" each."""
    name: str = dataclasses.field(metadata={"static": True})
    family: str | None = dataclasses.field(metadata={"static": True})
    """The closed form that solves this arm, or None; a promise about the twists."""
    signs: tuple = dataclasses.field(metadata={"static": True})
    """What the family's kernel must know besides the numbers: its NamedTuple of `arm.recognition.signs`."""
    branches: tuple[str, ...] = dataclasses.field(metadata={"static": True})
    """What each slot means, in slot order."""
    task: str = dataclasses.field(metadata={"static": True})
    """What a goal controls: "pose", "position", "planar_pose" or "planar_position"."""

    def __post_init__(self):
        # Files name arms, and names go into tables, errors and logs: there they are one line each.
        object.__setattr__(self, "name", text.line(self.name))
        object.__setattr__(self, "branches", tuple(map(text.line, self.branches)))
        # Whoever builds an arm may give a plain tuple.
        object.__setattr__(self, "signs", named_signs(self.family, self.signs))

    @staticmethod
    def from_dh(
        *,
        a,
        alpha,
        d,
        convention: str,
        theta=None,
        kinds: str | None = None,
        limits=None,
        base=None,
        tool=None,
        name: str = "arm",
        family: str | None = None,
        coupling=None,
        correction=None,
        axis_tolerance: float | None = None,
        dtype=None,
    ) -> "Arm":
        """An arm from its DH table; the closed form is recognized here, once.

        Args:
            a, alpha, d: (n,) link lengths [m], twists [rad], offsets [m]. In the modified
                convention row i holds a(i-1) and alpha(i-1), as in Craig's tables. A table of far larger
                lengths than the arm has is rewritten, with the rest in `correction`.
            convention: "standard" or "modified"; there is no default, because a wrong guess is silent.
            theta: (n,) joint angles at q = 0 [rad], zero by default.
            kinds: "R" or "P" for each joint; all "R" by default.
            limits: (n, 2) lower, upper [rad, m]. None, or infinities, where there are none.
            base: (4, 4) T_world_base. tool: (4, 4), mounted on the last link.
            name: For people.
            family: The closed form to use instead of the first that fits. Needed when a length or
                an offset is traced; the twists must be concrete numbers either way.
            coupling: (n, n) from motor values to joint values, where joints are driven together;
                `q`, `limits` and `q_now` are motor values.
            correction: (n + 1, 6) what the arm is off by after the base and after each link.
            axis_tolerance: Axes that are parallel, square or meeting to so much [rad, and as a share of the
                arm's size] are recognized as such, the rest is kept in `correction`: for calibrated
                tables. None takes the table at its word.
            dtype: Of the leaves; by default JAX's own (float64 when x64 is on).

        Raises:
            ValueError: A missing or wrong shape, a NaN, limits that cross, an unknown convention,
                or a named family that the arm does not belong to.
        """
        n = dh.count_joints(a=a, alpha=alpha, d=d)
        kinds = dh.check_kinds(kinds, n)
        columns = {"a": a, "alpha": alpha, "d": d, "theta": np.zeros(n) if theta is None else theta}
        columns = {name: dh.row(name, column, n) for name, column in columns.items()}
        base = dh.check_pose("base", np.eye(4) if base is None else base)
        tool = dh.check_pose("tool", np.eye(4) if tool is None else tool)
        limits, coupling = dh.check_limits(limits, kinds), dh.check_coupling(coupling, n)
        columns, base, up = dh.to_standard(convention, columns, base)
        leaves = {**columns, "base": base, "tool": tool, "limits": limits, "coupling": coupling}
        leaves["correction"] = dh.check_correction(correction, n)
        if axis_tolerance is None and correction is None and _spread_out(kinds, columns):
            return _nearest(_axes_of(kinds, columns, tool), leaves, 0.0, family, up, name, dtype)
        if axis_tolerance is None:
            arm = _built(kinds, leaves, family, up, name, dtype)
            if family is None:
                _warn_of_rounded_twists(arm, leaves, up)
            return arm
        if correction is not None:
            raise ValueError("correction is what axis_tolerance= finds: give one or the other")
        if is_traced(leaves):
            raise ValueError("axis_tolerance= needs concrete numbers: build the arm outside jit")
        return _nearest(_axes_of(kinds, columns, tool), leaves, axis_tolerance, family, up, name, dtype)

    @staticmethod
    def from_urdf(
        source,
        base: str | None = None,
        tip: str | None = None,
        *,
        axis_tolerance: float | None = None,
        coupling=None,
        name: str | None = None,
        family: str | None = None,
        dtype=None,
    ) -> "Arm":
        """An arm from the joints between two links of a URDF file; needs the extra `urdf`.

        Files hold rounded numbers. Axes that are parallel, square or meeting to the tolerance are
        recognized as such; what they are off by is kept in `correction`, and `solve` answers for the
        arm as the file has it. Joints that mimic others become `coupling`, where parallel neighbors
        combine to one joint a motor: `q` then holds the values of the joints that lead.

        Args:
            source: A path, or the XML itself. Meshes are never opened and nothing is fetched.
            base, tip: Names of links; by default the root, and the one leaf.
            axis_tolerance: How far axes may be off [rad], and as a share of the arm's size; at most 0.02. By
                default the least of 1e-5, 1e-4 and 1e-3 that gives the arm a family.
            coupling, name, family, dtype: As in `from_dh`.

        Warns:
            Where a turning joint has no limits, or the last joints look like a gripper's.

        Raises:
            ArmFileError: A file that is not sound, or holds what is no serial arm of turning and
                sliding joints: with its line and the element.
        """
        from ikjax.arm.urdf.reader import axes_of, read_chain

        chain = read_chain(source, base, tip)
        given, driven, ranges = axes_of(chain)
        if coupling is not None and driven is not None:
            raise ValueError("coupling is what the file's mimic joints say: leave it out")
        coupling = dh.check_coupling(driven if coupling is None else coupling, len(given.kinds))
        limits = dh.check_limits(ranges, given.kinds)
        leaves = {"limits": limits, "coupling": coupling, "base": np.eye(4)}
        up = -1 if given.along[0][2] < -1e-9 else 1
        return _nearest(given, leaves, axis_tolerance, family, up, name or chain.name, dtype)

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.kinds)

    @property
    def dtype(self):
        """Floating type of the leaves."""
        return self.alpha.dtype

    @property
    def complete(self) -> bool:
        """Whether the slots hold every solution.

        Not without a family, nor where the arm is off its family by more than 3e-4 [rad, or share of its
        lengths]: beside a fold the arm as given may then reach a pose that the arm as recognized does not. Of
        2,000 goals of an arm that is off by 1e-3, 2 to 7 missed a solution, and none at 1e-4.
        """
        if self.family is None or is_traced(self.correction):
            return False
        if self.correction is None:
            return True
        return _largest(np.asarray(self.correction, float), {"a": self.a, "d": self.d}) <= COMPLETE

    @property
    def free(self) -> tuple[str, ...]:
        """Numbers of the table that may move a little and the family stays: "a2", "d4", ...

        Base and tool always may. Found by moving each; see `arm.recognition.free_parameters`.
        """
        return free_parameters.free(self)

    def astype(self, dtype) -> "Arm":
        """The same arm with leaves of another floating type.

        Where that is wider, what was rounded to the narrower one is what it stood for: right angles between
        axes are right angles, and base and tool are rotations, to the last digit. Otherwise no goal would be
        reached to 1e-9.
        """
        arm = jax.tree.map(lambda leaf: as_array(leaf, dtype), self)
        if arm.base.dtype.itemsize <= self.base.dtype.itemsize:
            return arm
        if not is_traced(self):
            with jax.ensure_compile_time_eval():
                return arm._unrounded(self)
        return arm._unrounded(self)

    def _unrounded(self, narrow: "Arm") -> "Arm":
        dtype = self.dtype
        square = np.asarray(math.pi / 2, dtype) * jnp.round(self.alpha / np.asarray(math.pi / 2, dtype))
        rounded = abs(self.alpha - square) <= math.pi * float(jnp.finfo(narrow.dtype).eps)
        return dataclasses.replace(
            self,
            alpha=jnp.where(rounded, square, self.alpha),
            base=poses.rigid(self.base),
            tool=poses.rigid(self.tool),
        )

    def baked(self) -> "Arm":
        """The same arm as plain numpy numbers, which a kernel folds in as constants; traced leaves stay.

        For one arm and very many goals; every change of a number compiles anew.
        """
        return constants(self)

    def split(self, whole: bool = False) -> tuple[tuple, list]:
        """The arm as what a kernel gains by knowing, hashable, and the numbers it need not know.

        Known are the twists, the correction and whatever is 0, 1 or -1: arms that agree in those share a
        compile. With `whole` everything is known but traced leaves. The name is in neither part.
        """
        arm = dataclasses.replace(self, name="").baked()
        leaves, treedef = jax.tree.flatten(arm)
        known: list[tuple] = []
        rest: list[Number] = []
        for leaf in leaves:
            if is_traced(leaf):
                known.append((leaf.shape, leaf.dtype.name, None, b""))
                rest.append(leaf)
                continue
            keep = np.isin(leaf, (0, 1, -1)) | (leaf is arm.alpha) | (leaf is arm.correction) | whole
            known.append((leaf.shape, leaf.dtype.name, keep.tobytes(), leaf[keep].tobytes()))
            rest.append(leaf[~keep])
        return (treedef, tuple(known)), rest

    @staticmethod
    def join(known: tuple, rest: list) -> "Arm":
        """The arm of `split`, its numbers Python floats where they are known."""
        treedef, parts = known
        leaves = []
        for (shape, dtype, keep, values), others in zip(parts, rest, strict=True):
            if keep is None:
                leaves.append(others)
                continue
            keep = np.frombuffer(keep, bool)
            values = np.frombuffer(values, dtype)
            if keep.all():
                leaves.append(values.reshape(shape))
                continue
            leaf = np.empty(keep.shape, object)
            leaf[keep] = [float(x) for x in values]
            for i, place in enumerate(np.flatnonzero(~keep)):
                leaf[place] = others[i]
            leaves.append(leaf.reshape(shape))
        return jax.tree.unflatten(treedef, leaves)

    def __str__(self) -> str:
        return printing.paste(self)

    def __repr__(self) -> str:
        return f"<Arm {self.name}: {self.kinds}, family {self.family}>"


def _built(
    kinds: str, leaves: dict, family: str | None, up: int, name: str, dtype, closed_form: bool = True
) -> Arm:
    """The arm of finished leaves, its family recognized where it may have one."""
    verdict = recognize.recognize(kinds, leaves, family, up) if closed_form else recognize.NONE
    split = recognize.split_exactly(kinds, leaves, verdict)
    if split is not leaves:
        leaves, verdict = split, recognize.recognize(kinds, split, family, up)
    dtype = jnp.result_type(float) if dtype is None else dtype
    arrays: dict[str, Any] = {
        key: None if value is None else jnp.asarray(value, dtype) for key, value in leaves.items()
    }
    return Arm(
        **arrays,
        kinds=kinds,
        name=name,
        family=verdict.family,
        signs=verdict.signs,
        branches=verdict.branches,
        task=verdict.task,
    )


def _axes_of(kinds: str, columns: dict, tool: np.ndarray) -> Axes:
    frames = dh.frames(kinds, columns)
    return Axes(kinds, frames[:-1, :3, 2], frames[:-1, :3, 3], frames[-1] @ tool)


def _spread_out(kinds: str, columns: dict) -> bool:
    """Whether a table counts by lengths far beyond the arm's own, as common normals of axes that are parallel
    but for rounding make it do: in float32 they would cancel to millimetres."""
    if is_traced(columns):
        return False
    largest = max(np.abs(columns["a"]).max(), np.abs(columns["d"]).max())
    return bool(largest > TABLE_SPREAD * size_of(_axes_of(kinds, columns, np.eye(4))))


def _warn_of_rounded_twists(arm: Arm, leaves: dict, up: int) -> None:
    """Say that a table is of a faster family but for rounded numbers, which `axis_tolerance` would
    forgive."""
    if arm.family is None:
        return  # `solve` refuses it, and says the same
    rank = list(RULES).index
    for each in AXIS_LADDER[:1]:
        near = recognize.recognize(arm.kinds, leaves, None, up, each).family
        if near is not None and rank(near) < rank(arm.family):
            warn(
                f"{arm.name} is taken as {arm.family}; but for rounded numbers it is {near}, which is "
                f"faster: build it with axis_tolerance={each:g}"
            )


def _nearest(
    given: Axes, leaves: dict, axis_tolerance: float | None, family, up: int, name: str, dtype
) -> Arm:
    """The arm of axes in space, its table exact to the least tolerance that gives it a family.

    Of the exact table and that of the first tolerance the one with the faster family is taken; looser ones
    are tried where neither has any.
    """
    if axis_tolerance is not None and not 0 <= axis_tolerance <= LARGEST_AXIS_TOLERANCE:
        raise ValueError(
            f"axis_tolerance must be between 0 and {LARGEST_AXIS_TOLERANCE}, got {axis_tolerance}"
        )
    ladder = AXIS_LADDER if axis_tolerance is None else (axis_tolerance,)
    best: tuple[int, Rewritten] | None = None
    none = len(RULES)
    for each in (FACT, *(max(rung, FACT) for rung in ladder)):
        if each > ladder[0] and best is not None and best[0] < none:
            break
        table = rewritten(given, each)
        numbers = {**table.columns, "tool": table.tool}
        found = recognize.recognize(given.kinds, numbers, None, up).family
        # Axes that are made parallel for the size of the numbers may be off by more than was asked for.
        within = _largest(table.correction, numbers) <= 4 * each
        rank = (
            none if found is None or family not in (None, found) or not within else list(RULES).index(found)
        )
        if best is None or rank < best[0]:
            best = rank, table
    assert best is not None
    table = best[1]
    small = np.abs(table.correction).max() <= FACT
    leaves = {
        **leaves,
        **table.columns,
        "base": leaves["base"] @ table.base,
        "tool": table.tool,
        "correction": None if small else table.correction,
    }
    return _built(given.kinds, leaves, family, up, name, dtype, closed_form=best[0] < none)


def _largest(correction: np.ndarray, columns: dict) -> float:
    """The largest entry of a correction [rad, or share of the lengths of a table]."""
    size = float(sum(np.abs(np.asarray(columns[key])).sum() for key in ("a", "d"))) or 1.0
    off = np.abs(correction)
    return float(max(off[:, :3].max() / size, off[:, 3:].max()))


def numbers(leaf: Number) -> tuple[Scalar, ...]:
    """The entries of a 1-D leaf: Python floats where they are known, else array scalars."""
    if isinstance(leaf, jax.core.Tracer):
        return tuple(leaf[i] for i in range(leaf.shape[0]))
    return tuple(x if isinstance(x, jax.Array) else float(x) for x in np.asarray(leaf))
