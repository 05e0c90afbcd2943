"""The numbers of an arm that a sweep's program is called with: where it stands, its tool, its limits.

The rest of the arm is constant in the program, because a kernel is faster when it knows it. Another tool,
another mount or other limits then compile nothing.
"""

import dataclasses
from typing import Any, NamedTuple

import numpy as np

from ikjax.arm.arm import Arm
from ikjax.arm.forward import Joint, advance, corrections, fixed_pose, links, reach
from ikjax.core import pose as poses
from ikjax.core.pose import Pose
from ikjax.ik.redundancy import middles
from ikjax.maps.kernel.flags import LimitTests, limit_kinds, limit_tests
from ikjax.solvers.pipeline import TURNING

Number = Any


class Mounted(NamedTuple):
    """Arrays of the kernel's type, or tracers of them."""

    from_world: Number
    """(3, 4) T_base_world."""
    from_tool: Number
    """(3, 4) T_tool_tip, where the tip is the frame that the last joint turns."""
    tip_tool: Number
    """(3, 4) T_tip_tool."""
    reach: Number
    """() of the arm with its tool [m]."""
    limits: LimitTests
    redundancy: Number
    """(m, k) values of the redundant joints that are tried [rad, m]."""

    def in_scalars(self) -> "Mounted":
        """The same with poses and rows of limits in scalars.

        Made outside of the loops, so that a loop is handed numbers: taken out of the arrays inside, they
        would be instructions of the kernel, which XLA does not vectorize beyond some number of them.
        """
        ends, shares = (
            tuple(tuple(row[k] for k in range(table.shape[1])) for row in table) for table in self.limits
        )
        return self._replace(
            from_world=pose_of(self.from_world),
            from_tool=pose_of(self.from_tool),
            tip_tool=pose_of(self.tip_tool),
            limits=LimitTests(ends, shares),
        )


class Parts(NamedTuple):
    """An arm in two parts."""

    bare: Arm
    """Baked: what the program knows. Its base is the identity, of its limits it has the kinds, and where the
    tool is data it ends in the tip."""
    mounted: Mounted | None
    """None where all numbers are in `bare`."""
    has_tool: bool
    """Whether the tool is data. It is not of arms whose closed form depends on where the tool point is: those
    of fewer than six joints, or whose goals are points."""
    has_offset: bool = False
    """Whether the tool point is off the tip. Where it is not, the first joints depend on the position alone,
    and a kernel that knows this is twice as fast."""


def parts_of(arm: Arm, samples: int) -> Parts:
    """The two parts of an arm of the kernel's type.

    Args:
        arm: Baked.
        samples: Values of each redundant joint.
    """
    dtype, has_tool = arm.dtype, arm.task in TURNING and arm.n >= 6
    base, tool = fixed_pose(arm.base), fixed_pose(arm.tool)
    changes: dict[str, Any] = {
        "base": np.eye(4),
        "limits": np.array([kind.value for kind in limit_kinds(arm)]),
    }
    ends = corrections(arm)
    if ends is not None:
        base = poses.compose(base, ends[0])
        changes["correction"] = np.array(arm.correction)
        changes["correction"][0] = 0
    tip_tool = poses.IDENTITY
    if has_tool:
        last = links(arm)[-1]
        tip_tool = advance(poses.IDENTITY, last, Joint(0.0, 1.0, last.d))
        if ends is not None:
            tip_tool = poses.compose(tip_tool, ends[-1])
            changes["correction"][-1] = 0
        tip_tool = poses.compose(tip_tool, tool)
        changes["tool"] = np.eye(4)
        for column in ("a", "alpha", "d"):
            changes[column] = np.array(getattr(arm, column))
            changes[column][-1] = 0
    redundancy = np.asarray(middles(arm, samples, dtype)) if arm.locked else np.zeros((1, 0))
    mounted = Mounted(
        _rows(poses.inverse(base)).astype(dtype),
        _rows(poses.inverse(tip_tool)).astype(dtype),
        _rows(tip_tool).astype(dtype),
        np.asarray(reach(arm), dtype),
        limit_tests(arm),
        redundancy.astype(dtype),
    )
    bare = dataclasses.replace(arm, **{key: value.astype(dtype) for key, value in changes.items()})
    has_offset = has_tool and bool(mounted.from_tool[:, 3].any())
    return Parts(bare.baked(), mounted, has_tool, has_offset)


def _rows(pose: Pose) -> np.ndarray:
    """The first three rows of a pose of known numbers."""
    return np.array([[*row, x] for row, x in zip(pose.rotation, pose.position, strict=True)], float)


def pose_of(rows: Number) -> Pose:
    """A pose in scalars of its rows (3, 4)."""
    rotation = tuple(tuple(rows[i, j] for j in range(3)) for i in range(3))
    return Pose(rotation, tuple(rows[i, 3] for i in range(3)))
