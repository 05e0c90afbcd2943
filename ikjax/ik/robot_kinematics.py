"""The interface of LeRobot's `RobotKinematics` over `track` and `project`, to be put in its place.

Joints in degrees, in the order of `joint_names`; those that are no joints of the arm, as a gripper's, are
kept.

Source of the interface: huggingface/lerobot, src/lerobot/model/kinematics.py, commit 1d6bc9d.
"""

import math
from collections.abc import Sequence
from typing import Any

import jax.numpy as jnp
import numpy as np

from ikjax.arm.arm import Arm
from ikjax.arm.forward import fk
from ikjax.ik.project import project
from ikjax.ik.track import track


class RobotKinematics:
    """Forward and inverse kinematics of an arm in degrees, as LeRobot's class of that name has it.

    Inverse kinematics goes on from the present joints, on the branch that they are on, to the pose of that
    branch that is nearest to the one asked for, within the limits: a target that moves a little moves the
    joints a little.

    Args:
        urdf_path: What `Arm.from_urdf` takes; or an `Arm`.
        target_frame_name: The link that is the tool. With an `Arm` it is not looked at.
        joint_names: Names of the entries of a joint vector, in their order. Further names than the arm's are
            kept, as the gripper's; by default those of the arm, and further entries are kept.

    Raises:
        ValueError: A joint of the arm that is not among `joint_names`; as `Arm.from_urdf`.
    """

    def __init__(
        self,
        urdf_path: Any,
        target_frame_name: str = "gripper_frame_link",
        joint_names: Sequence[str] | None = None,
    ):
        self.arm = (
            urdf_path if isinstance(urdf_path, Arm) else Arm.from_urdf(urdf_path, tip=target_frame_name)
        )
        self.target_frame_name = target_frame_name
        own = list(self.arm.to_dict(np.zeros(self.arm.n)))
        self.joint_names = own if joint_names is None else list(joint_names)
        missing = [name for name in own if name not in self.joint_names]
        if missing:
            raise ValueError(f"joint_names lacks {', '.join(missing)}, which move the tool")
        self._places = [self.joint_names.index(name) for name in own]

    def forward_kinematics(self, joint_pos_deg: np.ndarray) -> np.ndarray:
        """Pose of the target frame, (4, 4) T_base_tool.

        Args:
            joint_pos_deg: Joint values [deg], in the order of `joint_names`; (n,) or longer.
        """
        return np.array(fk(self.arm, self._joints(joint_pos_deg)), float)

    def inverse_kinematics(
        self,
        current_joint_pos: np.ndarray,
        desired_ee_pose: np.ndarray,
        position_weight: float = 1.0,
        orientation_weight: float = 0.01,
    ) -> np.ndarray:
        """Joint values for a pose, going on from the present ones.

        Args:
            current_joint_pos: Present joint values [deg], in the order of `joint_names`; (n,) or longer.
            desired_ee_pose: (4, 4) T_base_tool; its rotation may be off by 1e-2. Where it is no pose, the
                joints stay.
            position_weight: Of the squared distance [1/m^2]; positive.
            orientation_weight: Of the squared angle [1/rad^2]. At zero the point comes first, and of the
                joints that meet it those with the nearest orientation are taken.

        Returns:
            Joint values [deg], as long as `current_joint_pos`; entries that are no joints of the arm are
            kept.

        Raises:
            ValueError: Weights that are negative, or none for the position.
        """
        if not (position_weight > 0 and orientation_weight >= 0):
            raise ValueError(f"weights must be positive, got {position_weight} and {orientation_weight}")
        q0 = self._joints(current_joint_pos)
        goal = jnp.asarray(desired_ee_pose, q0.dtype)
        if orientation_weight == 0:
            near = project(self.arm, goal, priority="position")
            q = near.q if bool(near.converged) else q0
        else:
            length = math.sqrt(orientation_weight / position_weight)
            # No slack is large enough to leave the branch.
            q = track(self.arm, goal[None], q0, length, slack=jnp.inf).q[0]
        result = np.array(current_joint_pos, float)
        result[self._places] = np.rad2deg(np.asarray(q, float))
        return result

    def _joints(self, degrees: np.ndarray) -> jnp.ndarray:
        """The arm's own joints [rad]."""
        given = np.asarray(degrees, float)
        if given.ndim != 1 or len(given) <= max(self._places):
            raise ValueError(f"joints must be ({len(self.joint_names)},) numbers or more, got {given.shape}")
        return jnp.asarray(np.deg2rad(given[self._places]), self.arm.dtype)
