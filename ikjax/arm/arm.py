"""The arm: DH parameters as differentiable leaves, and the few facts that are fixed when it is built.

`Arm.from_dh`, `Arm.from_urdf` and `Arm.from_mujoco` build one. `Arm.split` and `Arm.join` part it into what a
compiled program knows of it and the numbers that the program is called with.

Source of the conventions: standard DH after Spong, Robot Modeling and Control, section 3.2;
modified DH after Craig, Introduction to Robotics, 3rd ed., section 3.4.
"""

import dataclasses
import functools
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypeVar, cast

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import DTypeLike

from ikjax.arm import dh, printing
from ikjax.arm.axes_to_dh import Axes, Rewritten, rewritten, size_of
from ikjax.arm.recognition import arm_angle, free_parameters, lock, recognize
from ikjax.arm.recognition.rules import RULES
from ikjax.arm.recognition.signs import ArmAngleSigns, named_signs
from ikjax.core import pose as poses
from ikjax.core import text
from ikjax.core.tolerances import AXIS_LADDER, COMPLETE, FACT, LARGEST_AXIS_TOLERANCE, TABLE_SPREAD
from ikjax.core.trig import Scalar
from ikjax.core.typing import ArrayInput
from ikjax.core.warn import warn
from ikjax.core.xla import as_array, constants, is_traced

Number = jax.Array | np.ndarray


Function = TypeVar("Function", bound=Callable)


def once_for_each_arm(f: Function) -> Function:
    """f(arm, *arguments), hashable ones, computed once for each arm of constants and then remembered."""
    remembered = functools.lru_cache(maxsize=128)(f)

    @functools.wraps(f)
    def call(arm: "Arm", *arguments, **named):
        return (remembered if arm._is_constant else f)(arm, *arguments, **named)

    return cast(Function, call)


@functools.lru_cache(maxsize=1024)
def _lines(names: tuple[str, ...]) -> tuple[str, ...]:
    """The names as one line each. Kept, because jax builds an arm anew whenever one enters a program."""
    return tuple(map(text.line, names))


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
    """(n, n) matrix from motor values, which are what `q` holds, to joint values; None is the identity."""
    correction: Number | None = dataclasses.field(default=None, kw_only=True)
    """(n + 1, 6) what the arm as given is off by after the base and after each link: shift [m], rotation
    vector [rad]. The table holds the arm as recognized; None is no correction."""
    joint_names: tuple[str, ...] | None = dataclasses.field(
        default=None, kw_only=True, metadata={"static": True}
    )
    """Names of the joints in the arm's file, one for each entry of `q`; None where there are none.

    Of joints that are driven together it is the name of the one that leads.
    """
    locked: tuple[int, ...] = dataclasses.field(default=(), kw_only=True, metadata={"static": True})
    """The joints beyond the six that a pose asks for, counted from 0, at the ends of the arm. `solve` takes
    their values, and the family solves those between. Empty where there are none."""
    arm_angle_signs: ArmAngleSigns | None = dataclasses.field(
        default=None, kw_only=True, metadata={"static": True}
    )
    """What `solve(arm_angle=...)` must know of an arm with a spherical shoulder and a spherical wrist; None
    of any other."""

    kinds: str = dataclasses.field(metadata={"static": True})
    """The joints from base to tool, "R" (revolute) or "P" (prismatic) each."""
    name: str = dataclasses.field(metadata={"static": True})
    """For people: it is in no compiled program."""
    family: str | None = dataclasses.field(metadata={"static": True})
    """The closed form that solves this arm, or None; a promise about the twists that a new `alpha` keeps."""
    signs: tuple = dataclasses.field(metadata={"static": True})
    """What the family's kernel must know besides the numbers: its NamedTuple of `arm.recognition.signs`."""
    branches: tuple[str, ...] = dataclasses.field(metadata={"static": True})
    """What each slot means, in slot order."""
    task: str = dataclasses.field(metadata={"static": True})
    """What a goal controls: "pose", "position", "planar_pose" or "planar_position"."""

    def __post_init__(self):
        # Files name arms and joints, and names go into tables, errors and logs: there they are one line each.
        object.__setattr__(self, "name", _lines((self.name,))[0])
        object.__setattr__(self, "branches", _lines(tuple(self.branches)))
        if self.joint_names is not None:
            object.__setattr__(self, "joint_names", _lines(tuple(self.joint_names)))
        if not hasattr(self.signs, "_fields"):
            # Whoever builds an arm may give a plain tuple.
            object.__setattr__(self, "signs", named_signs(self.family, self.signs))

    @staticmethod
    def from_dh(
        *,
        a: ArrayInput,
        alpha: ArrayInput,
        d: ArrayInput,
        convention: str,
        theta: ArrayInput | None = None,
        kinds: str | None = None,
        limits: ArrayInput | None = None,
        base: ArrayInput | None = None,
        tool: ArrayInput | None = None,
        name: str = "arm",
        family: str | None = None,
        coupling: ArrayInput | None = None,
        correction: ArrayInput | None = None,
        axis_tolerance: float | None = None,
        redundant: str | int | Sequence[str | int] | None = None,
        dtype: DTypeLike | None = None,
    ) -> "Arm":
        """An arm from its DH table; the closed form is recognized here, once.

        Args:
            a, alpha, d: (n,) link lengths [m], twists [rad], offsets [m]. In the modified
                convention row i holds a(i-1) and alpha(i-1), as in Craig's tables. A table with far larger
                lengths than the arm has is rewritten, with the rest in `correction`.
            convention: "standard" or "modified"; there is no default, because a wrong guess is silent.
            theta: (n,) joint angles at q = 0 [rad], zero by default.
            kinds: "R" (revolute) or "P" (prismatic) for each joint; all "R" by default.
            limits: (n, 2) lower and upper limit of each joint [rad, m]. None, or infinities, where there are
                none.
            base: (4, 4) T_world_base; the identity by default.
            tool: (4, 4) T_flange_tool, in the frame of the last link; the identity by default.
            name: For people.
            family: The closed form to use instead of the first that fits. Needed when a length or
                an offset is traced; the twists must be concrete numbers either way.
            coupling: (n, n) from motor values to joint values, where joints are driven together;
                `q`, `limits` and `q_now` are motor values.
            correction: (n + 1, 6) what the arm is off by after the base and after each link: shift [m],
                rotation vector [rad] of at most 0.05 rad.
            axis_tolerance: Axes that are parallel, perpendicular or meeting to this tolerance [rad, and as a
                share of the arm's size] are recognized as such, and the rest becomes `correction`: for
                calibrated tables. At most 0.02. None takes the table at its word.
            redundant: Of more than six joints, the one (or those) at the ends whose value `solve` is given:
                "joint7" or 7, counted from 1. By default those that leave the fastest closed form.
            dtype: Of the leaves; by default JAX's own (float64 when x64 is on).

        Raises:
            ValueError: A missing or wrong shape, a NaN, limits that cross, an unknown convention,
                a named family that the arm does not belong to, `axis_tolerance` together with `correction`
                or with traced numbers, a `redundant` joint that does not leave six in a row.

        Warns:
            Where angles are probably in degrees or lengths in millimetres, and where rounded numbers keep
            the arm from a faster family.

        Source: Spong, Robot Modeling and Control, section 3.2 (standard); Craig, Introduction to Robotics,
        3rd ed., section 3.4 (modified).
        """
        n = dh.count_joints(a=a, alpha=alpha, d=d)
        kinds = dh.check_kinds(kinds, n)
        columns = {"a": a, "alpha": alpha, "d": d, "theta": np.zeros(n) if theta is None else theta}
        columns = {key: dh.column(key, column, n) for key, column in columns.items()}
        T_world_base = dh.check_pose("base", np.eye(4) if base is None else base)
        T_flange_tool = dh.check_pose("tool", np.eye(4) if tool is None else tool)
        limits, coupling = dh.check_limits(limits, kinds), dh.check_coupling(coupling, n)
        columns, T_world_base, up = dh.to_standard(convention, columns, T_world_base)
        leaves = {
            **columns,
            "base": T_world_base,
            "tool": T_flange_tool,
            "limits": limits,
            "coupling": coupling,
        }
        leaves["correction"] = dh.check_correction(correction, n)
        locked = None if redundant is None else lock.place(n, redundant, None)
        if axis_tolerance is None and correction is None and _spread_out(kinds, columns):
            axes = _axes_of(kinds, columns, T_flange_tool)
            return _nearest(axes, leaves, 0.0, family, up, name, dtype, locked)
        if axis_tolerance is None:
            arm = _built(kinds, leaves, family, up, name, dtype, locked)
            if family is None:
                _warn_of_rounded_twists(arm, leaves, up)
            return arm
        if correction is not None:
            raise ValueError("correction is what axis_tolerance= finds: give one or the other")
        if is_traced(leaves):
            raise ValueError("axis_tolerance= needs concrete numbers: build the arm outside jit")
        return _nearest(
            _axes_of(kinds, columns, T_flange_tool), leaves, axis_tolerance, family, up, name, dtype, locked
        )

    @staticmethod
    def from_urdf(
        source: Any,
        base: str | None = None,
        tip: str | None = None,
        *,
        fixed_joints: Mapping[str, float] | None = None,
        axis_tolerance: float | None = None,
        coupling: ArrayInput | None = None,
        name: str | None = None,
        family: str | None = None,
        redundant: str | int | Sequence[str | int] | None = None,
        dtype: DTypeLike | None = None,
    ) -> "Arm":
        """An arm from the joints between two links of a URDF file; needs the extra `urdf`.

        Files hold rounded numbers. Axes that are parallel, perpendicular or meeting to the tolerance are
        recognized as such; what they are off by becomes `correction`, and `solve` answers for the
        arm as the file has it. Joints that mimic others become `coupling`, where parallel neighbors
        combine to one joint a motor: `q` then holds the values of the joints that lead. Their names are
        `joint_names`, in the order of `q`.

        Args:
            source: A path, or the XML itself (bytes, or a str that starts with "<"), or a `yourdfpy.URDF`.
                Meshes are never opened and nothing is fetched. A path that ends in ".xacro" is expanded by
                the package xacro, which evaluates what it says.
            base, tip: Names of links; by default the root, and the one leaf. Where the tree branches, or ends
                in a gripper, the tip is guessed: the end of the longest chain of joints, without those that
                move several branches together by mimicking and those with a finger's name.
            fixed_joints: Joints of the chain by name that stay at a value [rad, m]; they are no part of `q`.
            axis_tolerance: How far axes may be off [rad], and as a share of the arm's size; at most 0.02. By
                default the least of 1e-5, 1e-4 and 1e-3 that gives the arm a family.
            coupling: As in `from_dh`, for a file whose joints mimic no others.
            name: For people; by default that of the file.
            family, dtype: As in `from_dh`.
            redundant: As in `from_dh`; also by the joint's name in the file.

        Warns:
            Where the tip is guessed, with what was left out; where a revolute joint has no limits, an axis
            has no unit length, or the last joints look like a gripper's.

        Raises:
            ArmFileError: A file that is not sound, or holds what is no serial arm of revolute and
                prismatic joints: with its line and the element.
            ValueError: `axis_tolerance` out of range, a `coupling` of a wrong shape or beside joints that
                mimic others, a named family that the arm does not belong to.
            ImportError: The extra `urdf` is not installed.
            OSError: The file cannot be read.

        Source: the URDF specification, wiki.ros.org/urdf/XML/joint.
        """
        from ikjax.arm.urdf.reader import axes_of, read_chain

        chain = read_chain(source, base, tip, fixed_joints)
        given, driven, ranges = axes_of(chain)
        if coupling is not None and driven is not None:
            raise ValueError("coupling is what the file's mimic joints say: leave it out")
        coupling = dh.check_coupling(driven if coupling is None else coupling, len(given.kinds))
        leaves = {"limits": dh.check_limits(ranges, given.kinds), "coupling": coupling, "base": np.eye(4)}
        asked = (axis_tolerance, family, redundant, name or chain.name, dtype)
        return _of_file(given, leaves, chain.motors, *asked)

    @staticmethod
    def from_mujoco(
        model: Any,
        *,
        site: str | None = None,
        body: str | None = None,
        base: str | None = None,
        fixed_joints: Mapping[str, float] | None = None,
        axis_tolerance: float | None = None,
        name: str | None = None,
        family: str | None = None,
        redundant: str | int | Sequence[str | int] | None = None,
        dtype: DTypeLike | None = None,
    ) -> "Arm":
        """An arm from the joints between two bodies of a MuJoCo model; needs the extra `mujoco`.

        MuJoCo reads the file. `q` are its own joint values (`qpos`), so that a joint's `ref` counts, and
        goals are in the world of the model as it stands, or in the frame of `base`. What rounded numbers
        leave between the axes is handled as in `from_urdf`.

        Args:
            model: A `mujoco.MjModel` or `mujoco.MjSpec`, the path of an MJCF or MJB file, or MJCF as text.
            site, body: Name of the tool's frame, one of the two. By default it is guessed as in `from_urdf`:
                joints that an equality or a tendon couples, and those with a finger's name, are left out.
            base: Name of the body that the arm stands on; by default the world.
            fixed_joints: Joints of the chain by name that stay at a value [rad, m]; they are no part of `q`.
            axis_tolerance, redundant: As in `from_urdf`.
            name: For people; by default that of the model.
            family, dtype: As in `from_dh`.

        Warns:
            Where the tip is guessed, with what was left out.

        Raises:
            ArmFileError: A model that MuJoCo refuses; a ball or free joint in the chain; joints of the chain
                that an equality or a tendon couples; chains of equal length and no tip given.
            ValueError: As `from_urdf`; `site` and `body` both.
            ImportError: The extra `mujoco` is not installed.
            OSError: The file cannot be read.

        Source: MuJoCo documentation, Computation, Kinematic tree.
        """
        from ikjax.arm.mujoco_model import read_model

        chain = read_model(model, site, body, base, fixed_joints)
        given = chain.axes
        leaves = {"limits": dh.check_limits(chain.limits, given.kinds), "coupling": None, "base": np.eye(4)}
        asked = (axis_tolerance, family, redundant, name or chain.name, dtype)
        return _of_file(given, leaves, chain.joint_names, *asked)

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.kinds)

    @property
    def solved(self) -> range:
        """The joints, counted from 0, that the family solves: all but those in `locked`."""
        return lock.between(self.n, self.locked)

    @property
    def redundant(self) -> tuple[str, ...]:
        """Names of the joints in `locked`, whose values `solve(redundancy=...)` is given."""
        return tuple(self._names[i] for i in self.locked)

    def to_dict(self, q: ArrayInput) -> dict[str, jax.Array]:
        """Values of joints by their names: "joint1", "joint2", ... where the arm has none.

        Args:
            q: (..., n) [rad, m].

        Returns:
            The joints' names and values (...), in the order of `q`.

        Raises:
            ValueError: The last axis has another length.
        """
        q = jnp.asarray(q)
        if q.ndim == 0 or q.shape[-1] != self.n:
            raise ValueError(f"q must have shape (..., {self.n}), got {q.shape}")
        return {name: q[..., i] for i, name in enumerate(self._names)}

    def from_dict(self, values: Mapping[str, ArrayInput]) -> jax.Array:
        """Joints (..., n) from values by their names, as `to_dict` returns them.

        Args:
            values: Each joint's value [rad, m], of shapes that broadcast. Further names are passed over: a
                robot's state holds those of its gripper too.

        Raises:
            ValueError: A joint of the arm is missing.
        """
        missing = [name for name in self._names if name not in values]
        if missing:
            raise ValueError(f"no value for {', '.join(missing)}; the arm has {', '.join(self._names)}")
        return jnp.stack(jnp.broadcast_arrays(*(jnp.asarray(values[name]) for name in self._names)), -1)

    @property
    def _names(self) -> tuple[str, ...]:
        return self.joint_names or lock.numbered(self.n)

    @property
    def dtype(self) -> np.dtype:
        """Floating type of the leaves."""
        return self.alpha.dtype

    @functools.cached_property
    def _is_constant(self) -> bool:
        """Whether no leaf can change: none is traced, or a numpy array that can be written."""
        return not any(
            leaf.flags.writeable if isinstance(leaf, np.ndarray) else isinstance(leaf, jax.core.Tracer)
            for leaf in jax.tree.leaves(self)
        )

    @property
    def complete(self) -> bool:
        """Whether the slots hold every solution.

        Not without a family, nor where the family needs float64 and jax_enable_x64 is off, nor where the arm
        is off its family by more than 3e-4 [rad, or share of its lengths]: beside a fold the arm as given may
        then reach a pose that the arm as recognized does not. Of 2,000 goals of an arm that is off by 1e-3, 2
        to 7 missed a solution, and none at 1e-4.
        """
        if self.family is None or is_traced(self.correction):
            return False
        if RULES[self.family].wide and jnp.result_type(float) == jnp.float32:
            return False
        if self.correction is None:
            return True
        return _largest(np.asarray(self.correction, float), {"a": self.a, "d": self.d}) <= COMPLETE

    @property
    def free(self) -> tuple[str, ...]:
        """The parameters of the table that may change a little without leaving the family: "a2", "d4", ...

        Base and tool always may. Each is tried by changing it; see `arm.recognition.free_parameters`.

        Raises:
            ValueError: An arm of no family, or one whose numbers are traced.
        """
        return free_parameters.free(self)

    def astype(self, dtype: DTypeLike) -> "Arm":
        """The same arm with leaves of another floating type.

        Where that is wider, the rounding to the narrower type is undone: twists that rounding alone keeps
        from a multiple of a right angle become one, and base and tool become rotations, to the last digit.
        Otherwise no goal would be reached to 1e-9.
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
        """The same arm with numpy leaves, which a program takes in as constants; traced leaves stay.

        For one arm and very many goals; a change of any number compiles again.
        """
        return constants(self)

    @once_for_each_arm
    def split(self, whole: bool = False) -> tuple[tuple, list]:
        """The arm in two parts: what a program is compiled for, and the numbers that it is called with.

        The first part holds the twists, the correction and whatever is 0, 1 or -1, because a kernel is faster
        when it knows them. Arms that agree in it share a compiled program. The names of the arm and of its
        joints are in neither part.

        Args:
            whole: Put all numbers into the first part, but for traced leaves.

        Returns:
            known: Hashable: the structure of the tree, and for each leaf its shape, its type, which entries
                are known, and their values.
            rest: For each leaf the entries that are not known.
        """
        arm = dataclasses.replace(self, name="", joint_names=None).baked()
        leaves, treedef = jax.tree.flatten(arm)
        known: list[tuple] = []
        rest: list[Number] = []
        for leaf in leaves:
            if is_traced(leaf):
                known.append((leaf.shape, leaf.dtype.name, None, b""))
                rest.append(leaf)
                continue
            fixed = np.isin(leaf, (0, 1, -1)) | (leaf is arm.alpha) | (leaf is arm.correction) | whole
            known.append((leaf.shape, leaf.dtype.name, fixed.tobytes(), leaf[fixed].tobytes()))
            rest.append(leaf[~fixed])
        return (treedef, tuple(known)), rest

    @staticmethod
    def join(known: tuple, rest: list) -> "Arm":
        """The arm of the two parts of `split`, without its names.

        A leaf of which some entries are known is a numpy array of objects: Python floats where they are
        known, scalars of jax elsewhere.
        """
        treedef, parts = known
        leaves = []
        for (shape, dtype, fixed, values), others in zip(parts, rest, strict=True):
            if fixed is None:
                leaves.append(others)
                continue
            fixed = np.frombuffer(fixed, bool)
            values = np.frombuffer(values, dtype)
            if fixed.all():
                leaves.append(values.reshape(shape))
                continue
            leaf = np.empty(fixed.shape, object)
            leaf[fixed] = [float(x) for x in values]
            for i, place in enumerate(np.flatnonzero(~fixed)):
                leaf[place] = others[i]
            leaves.append(leaf.reshape(shape))
        return jax.tree.unflatten(treedef, leaves)

    @property
    def is_joined(self) -> bool:
        """Whether it comes from `join` with leaves of which some entries are known and others not."""
        return any(getattr(leaf, "dtype", None) == np.dtype(object) for leaf in jax.tree.leaves(self))

    def __str__(self) -> str:
        return printing.paste(self)

    def __repr__(self) -> str:
        return f"<Arm {self.name}: {self.kinds}, family {self.family}>"


def _built(
    kinds: str,
    leaves: dict,
    family: str | None,
    up: int,
    name: str,
    dtype,
    locked: tuple[int, ...] | None,
    closed_form: bool = True,
) -> Arm:
    """The arm of checked leaves in standard DH; its family is looked for where `closed_form` says so."""
    if leaves["coupling"] is not None:
        if locked is not None:
            raise ValueError("redundant= is for arms without coupling")
        locked = ()
    verdict = recognize.NONE
    if closed_form:
        verdict = recognize.recognize(kinds, leaves, family, up, locked=locked)
    split = recognize.split_exactly(kinds, leaves, verdict)
    if split is not leaves:
        leaves, verdict = split, recognize.recognize(kinds, split, family, up, locked=verdict.locked)
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
        locked=verdict.locked,
        arm_angle_signs=None if leaves["coupling"] is not None else arm_angle.signs_of(kinds, leaves, FACT),
    )


def _axes_of(kinds: str, columns: dict, tool: np.ndarray) -> Axes:
    """The axes at q = 0 in the frame of the base, and the tool, a (4, 4) T_flange_tool, there."""
    frames = dh.frames(columns)
    return Axes(kinds, frames[:-1, :3, 2], frames[:-1, :3, 3], frames[-1] @ tool)


def _spread_out(kinds: str, columns: dict) -> bool:
    """Whether a table has lengths far beyond the arm's own, which cancel.

    The common normal of axes that are parallel but for rounding lies that far away. In float32 an error of
    millimetres would be left.
    """
    if is_traced(columns):
        return False
    largest = max(np.abs(columns["a"]).max(), np.abs(columns["d"]).max())
    return bool(largest > TABLE_SPREAD * size_of(_axes_of(kinds, columns, np.eye(4))))


def _warn_of_rounded_twists(arm: Arm, leaves: dict, up: int) -> None:
    """Warn where rounded numbers alone keep a table from a faster family; `axis_tolerance` would find it."""
    if arm.family is None:
        return  # `solve` refuses it, and says the same
    rank = list(RULES).index
    for each in AXIS_LADDER if RULES[arm.family].wide else AXIS_LADDER[:1]:
        faster = recognize.recognize(arm.kinds, leaves, None, up, each, arm.locked).family
        if faster is not None and rank(faster) < rank(arm.family):
            warn(
                f"{arm.name} is taken as {arm.family}; but for rounded numbers it is {faster}, which is "
                f"faster: build it with axis_tolerance={each:g}"
            )
            return


def _nearest(
    given: Axes,
    leaves: dict,
    axis_tolerance: float | None,
    family,
    up: int,
    name: str,
    dtype,
    locked: tuple[int, ...] | None,
) -> Arm:
    """The arm of axes in space, its table made exact to the least tolerance that gives it a family.

    Of the exact table and that of the first tolerance, the one with the faster family is taken. The looser
    tolerances are tried where neither has a family, or one of sixteen slots. All tolerances up to an
    `axis_tolerance` that is given are tried; a complete family comes before a faster one that is not.
    """
    if axis_tolerance is not None and not 0 <= axis_tolerance <= LARGEST_AXIS_TOLERANCE:
        raise ValueError(
            f"axis_tolerance must be between 0 and {LARGEST_AXIS_TOLERANCE}, got {axis_tolerance}"
        )
    ladder: tuple[float, ...] = AXIS_LADDER
    if axis_tolerance is not None:
        ladder = (*(rung for rung in AXIS_LADDER if rung < axis_tolerance), axis_tolerance)
    best: tuple[tuple[bool, int], Rewritten] | None = None
    none = (True, len(RULES))
    for each in (FACT, *(max(rung, FACT) for rung in ladder)):
        looser = axis_tolerance is None and each > ladder[0]
        if looser and best is not None and best[0] < none and not list(RULES.values())[best[0][1]].wide:
            break
        table = rewritten(given, each)
        numbers = {**table.columns, "tool": table.tool}
        recognized = recognize.recognize(given.kinds, numbers, None, up, locked=locked).family
        # Axes that are made parallel for the size of the numbers may be off by more than was asked for.
        off = _largest(table.correction, numbers)
        usable = recognized is not None and family in (None, recognized) and off <= 4 * each
        # The rank of a family is its place in RULES, where the faster ones come first.
        rank = (off > COMPLETE, list(RULES).index(str(recognized))) if usable else none
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
    return _built(given.kinds, leaves, family, up, name, dtype, locked, closed_form=best[0] < none)


def _of_file(
    given: Axes,
    leaves: dict,
    joint_names: tuple[str, ...],
    axis_tolerance,
    family,
    redundant,
    name: str,
    dtype,
) -> Arm:
    """The arm of the axes and the names of joints that a file holds."""
    up = -1 if given.along[0][2] < -1e-9 else 1
    locked = None if redundant is None else lock.place(len(given.kinds), redundant, joint_names)
    arm = _nearest(given, leaves, axis_tolerance, family, up, name, dtype, locked)
    return dataclasses.replace(arm, joint_names=joint_names)


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


def array_of(leaf: Number, dtype: DTypeLike) -> np.ndarray | jax.Array:
    """A 1-D leaf as one array; its entries may be known in part, see `numbers`."""
    entries = numbers(leaf)
    if all(isinstance(x, float) for x in entries):
        return np.array(entries, dtype)
    return jnp.stack([jnp.asarray(x, dtype) for x in entries])
