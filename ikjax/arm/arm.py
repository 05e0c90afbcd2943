"""The arm: DH numbers as differentiable leaves, and the few facts that are fixed when it is built.

Storey: arm.
Source of the conventions: standard DH after Spong, Robot Modeling and Control, section 3.2;
modified DH after Craig, Introduction to Robotics, 3rd ed., section 3.4.
"""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np

from ikjax.arm import dh, structure, table
from ikjax.core.trig import Scalar

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

    kinds: str = dataclasses.field(metadata={"static": True})
    """The joints from base to tool, "R" or "P" each."""
    name: str = dataclasses.field(metadata={"static": True})
    family: str | None = dataclasses.field(metadata={"static": True})
    """The closed form that solves this arm, or None; a promise about the twists."""
    signs: tuple = dataclasses.field(metadata={"static": True})
    """What the family's kernel must know about the twists: signs of their sines and cosines."""
    branches: tuple[str, ...] = dataclasses.field(metadata={"static": True})
    """What each slot means, in slot order."""
    task: str = dataclasses.field(metadata={"static": True})
    """What a goal controls: "pose", "position", "planar_pose" or "planar_position"."""

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
        dtype=None,
    ) -> "Arm":
        """An arm from its DH table; the closed form is recognised here, once.

        Args:
            a, alpha, d: (n,) link lengths [m], twists [rad], offsets [m]. In the modified
                convention row i holds a(i-1) and alpha(i-1), as in Craig's tables.
            convention: "standard" or "modified"; there is no default, because a wrong guess is silent.
            theta: (n,) joint angles at q = 0 [rad], zero by default.
            kinds: "R" or "P" for each joint; all "R" by default.
            limits: (n, 2) lower, upper [rad, m]. None, or infinities, where there are none.
            base: (4, 4) T_world_base. tool: (4, 4), mounted on the last link.
            name: For people.
            family: The closed form to use instead of the first that fits. Needed when a length or
                an offset is traced; the twists must be concrete numbers either way.
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
        limits = dh.check_limits(limits, n)
        columns, base, up = dh.to_standard(convention, columns, base)
        verdict = structure.recognise(kinds, {**columns, "tool": tool}, family, up)
        dtype = jnp.result_type(float) if dtype is None else dtype
        leaves = {**columns, "base": base, "tool": tool, "limits": limits}
        return Arm(
            **{key: jnp.asarray(value, dtype) for key, value in leaves.items()},
            kinds=kinds,
            name=name,
            family=verdict.family,
            signs=verdict.signs,
            branches=verdict.branches,
            task=verdict.task,
        )

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.kinds)

    @property
    def dtype(self):
        """Floating type of the leaves."""
        return self.alpha.dtype

    def astype(self, dtype) -> "Arm":
        """The same arm with leaves of another floating type."""
        return jax.tree.map(lambda leaf: jnp.asarray(leaf, dtype), self)

    def baked(self) -> "Arm":
        """The same arm as plain numpy numbers, which a kernel folds in as constants.

        For one arm and very many goals; every change of a number compiles anew.
        """
        return jax.tree.map(np.asarray, self)

    def split(self) -> tuple[tuple, list]:
        """The arm as what a kernel gains by knowing, hashable, and the numbers it need not know.

        Known are the twists and whatever is 0, 1 or -1: arms that agree in those share a compile.
        """
        leaves, treedef = jax.tree.flatten(self.baked())
        known, rest = [], []
        for leaf in leaves:
            keep = np.isin(leaf, (0, 1, -1)) | (leaf is leaves[1])
            known.append((leaf.shape, leaf.dtype.name, keep.tobytes(), leaf[keep].tobytes()))
            rest.append(leaf[~keep])
        return (treedef, tuple(known)), rest

    @staticmethod
    def join(known: tuple, rest: list) -> "Arm":
        """The arm of `split`, its numbers Python floats where they are known."""
        treedef, parts = known
        leaves = []
        for (shape, dtype, keep, values), others in zip(parts, rest, strict=True):
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
        return table.paste(self)

    def __repr__(self) -> str:
        return f"<Arm {self.name}: {self.kinds}, family {self.family}>"


def numbers(leaf: Number) -> tuple[Scalar, ...]:
    """The entries of a 1-D leaf: Python floats where they are known, else array scalars."""
    if isinstance(leaf, np.ndarray):
        return tuple(x if isinstance(x, jax.Array) else float(x) for x in leaf)
    return tuple(leaf[i] for i in range(leaf.shape[0]))
