"""Joints that mimic others: the arm moves as the file says, with one joint a motor, or is refused."""

import jax
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import ikjax
from ikjax.arm.urdf.xml import ArmFileError


class Joint:
    """A joint of a file, with what drives it."""

    def __init__(self, name, xyz, axis, kind="revolute", rpy=(0, 0, 0), mimic=None, limits=(-2, 2)):
        self.name, self.xyz, self.axis, self.kind = name, xyz, np.array(axis, float), kind
        self.rpy, self.mimic, self.limits = rpy, mimic, limits

    def xml(self, i):
        def three(values):
            return " ".join(map(str, values))

        leader = ""
        if self.mimic:
            name, factor, offset = self.mimic
            leader = f'<mimic joint="{name}" multiplier="{factor}" offset="{offset}"/>'
        return (
            f'<joint name="{self.name}" type="{self.kind}"><parent link="l{i}"/><child link="l{i + 1}"/>'
            f'<origin xyz="{three(self.xyz)}" rpy="{three(self.rpy)}"/><axis xyz="{three(self.axis)}"/>'
            f'<limit lower="{self.limits[0]}" upper="{self.limits[1]}"/>{leader}</joint>'
        )

    def pose(self, value):
        origin, motion = np.eye(4), np.eye(4)
        origin[:3, :3], origin[:3, 3] = Rotation.from_euler("xyz", self.rpy).as_matrix(), self.xyz
        if self.kind == "prismatic":
            motion[:3, 3] = value * self.axis
        else:
            motion[:3, :3] = Rotation.from_rotvec(value * self.axis).as_matrix()
        return origin @ motion


def file_of(joints):
    links = "".join(f'<link name="l{i}"/>' for i in range(len(joints) + 1))
    return f'<robot name="r">{links}{"".join(joint.xml(i) for i, joint in enumerate(joints))}</robot>'


def stands(joints, motors):
    """The tip, joint by joint as the specification has it."""
    by_name, frame = {joint.name: joint for joint in joints}, np.eye(4)

    def value(joint):
        if joint.mimic is None:
            return motors[joint.name]
        name, factor, offset = joint.mimic
        return factor * value(by_name[name]) + offset

    for joint in joints:
        frame = frame @ joint.pose(value(joint))
    return frame


Y, Z = (0, 1, 0), (0, 0, 1)
END = Joint("end", (0.05, 0.02, 0.03), Z, rpy=(0.3, 0.2, 0.1))
PALLETISER = [
    Joint("j1", (0, 0, 0.1), Z),
    Joint("j2", (0.03, 0, 0), Y),
    Joint("j3", (0, 0.01, 0.135), Y),
    Joint("j4", (0.147, 0, 0.02), Y, mimic=("j3", -1, 0)),
]
CHAINS = {
    "a parallelogram": PALLETISER,
    "a parallelogram and a wrist": [*PALLETISER, END, Joint("roll", (0.02, 0, 0.1), (1, 0, 0))],
    "an axis that points the other way": [
        *PALLETISER[:3],
        Joint("j4", (0.147, 0.03, 0), (0, -1, 0), mimic=("j3", 1, 0)),
        END,
    ],
    "an offset": [*PALLETISER[:3], Joint("j4", (0.147, 0, 0), Y, mimic=("j3", -1, 0.4)), END],
    "a follower before its leader": [
        PALLETISER[0],
        Joint("j2", (0.1, 0, 0.2), Y, mimic=("j4", -1, 0.1)),
        Joint("j4", (0.25, 0, 0.05), Y),
        Joint("j5", (0.3, 0, 0), Y),
        END,
    ],
    "two on one leader, whose first link stays level": [
        Joint("j1", (0, 0, 0.1), Z),
        Joint("j2", (0, 0, 0.2), Y),
        Joint("j2b", (0.3, 0, 0), Y, mimic=("j2", -1, 0)),
        Joint("j3", (0.1, 0, 0), Y),
        END,
    ],
    "a follower of a follower": [
        *PALLETISER,
        Joint("j5", (0.1, 0, 0.05), Y, mimic=("j4", -1, 0.2)),
        Joint("j6", (0.2, 0, 0), Y, mimic=("j5", -1, 0)),
        END,
    ],
    "followers on one axis": [
        Joint("j1", (0, 0, 0.1), Z),
        Joint("j2", (0, 0, 0.1), Z, mimic=("j1", 0.5, 0)),
        END,
    ],
    "a telescope": [
        Joint("lift", (0, 0, 0.2), Z, "prismatic"),
        Joint("arm", (0.1, 0, 0.1), (1, 0, 0), "prismatic"),
        Joint("arm2", (0.2, 0, 0), (1, 0, 0), "prismatic", mimic=("arm", 1, 0.1)),
        Joint("arm3", (0.2, 0, 0), (-1, 0, 0), "prismatic", mimic=("arm", -0.5, 0)),
        END,
    ],
    "a multiplier of zero is a fixed joint": [
        PALLETISER[0],
        Joint("j2", (0.1, 0, 0.2), Y, mimic=("j1", 0, 0.7)),
        END,
    ],
}


@pytest.mark.parametrize("joints", CHAINS.values(), ids=CHAINS)
def test_the_arm_moves_as_the_file_says_with_one_joint_a_motor(joints, rng):
    arm = ikjax.Arm.from_urdf(file_of(joints))
    motors = [joint.name for joint in joints if joint.mimic is None]
    assert arm.n == len(motors)
    for q in rng.uniform(-2, 2, (5, arm.n)):
        wanted = stands(joints, dict(zip(motors, q, strict=True)))
        np.testing.assert_allclose(ikjax.fk(arm, q), wanted, atol=1e-12)
    q = jax.numpy.asarray(rng.uniform(-1, 1, arm.n))
    assert np.isfinite(ikjax.jacobian(arm, q)).all()


def test_a_parallelogram_is_solved_in_closed_form(rng):
    arm = ikjax.Arm.from_urdf(file_of(PALLETISER))
    assert (arm.n, arm.family) == (3, "position")
    q = rng.uniform(-1.5, 1.5, (20, 3))
    sol = ikjax.solve(arm, ikjax.fk(arm, q))
    miss = np.abs(np.asarray(sol.q) - q[:, None]).max(-1)
    assert (np.where(sol.valid, miss, 9).min(-1) < 1e-6).all()


def test_limits_are_those_of_the_leader_and_of_what_follows_it():
    follower = Joint("j4", (0.147, 0, 0), Y, mimic=("j3", -1, 0.5), limits=(-1, 1))
    arm = ikjax.Arm.from_urdf(file_of([*PALLETISER[:3], follower]))
    np.testing.assert_allclose(arm.limits, [(-2, 2), (-2, 2), (-0.5, 1.5)])
    # Exporters leave them at 0 and 0.
    follower.limits = (0, 0)
    np.testing.assert_allclose(ikjax.Arm.from_urdf(file_of([*PALLETISER[:3], follower])).limits[2], (-2, 2))
    follower.limits = (5, 6)
    with pytest.raises(ArmFileError, match='joints that mimic "j3" leave no value within limits'):
        ikjax.Arm.from_urdf(file_of([*PALLETISER[:3], follower]))


REFUSED = {
    "axes that are not parallel": [*PALLETISER[:3], Joint("j4", (0.1, 0, 0), (1, 0, 0), mimic=("j3", -1, 0))],
    "axes parallel to a thousandth": [
        *PALLETISER[:3],
        Joint("j4", (0.1, 0, 0), Y, rpy=(1e-3, 0, 0), mimic=("j3", -1, 0)),
    ],
    "a tool that stays level": [*PALLETISER, Joint("j5", (0.1, 0, 0), Y, mimic=("j2", -1, 0))],
    "a geared pair": [*PALLETISER[:3], Joint("j4", (0.1, 0, 0), Y, mimic=("j3", 2, 0))],
    "a turn that drives a slide": [
        *PALLETISER[:3],
        Joint("j4", (0.1, 0, 0), Y, "prismatic", mimic=("j3", 0.1, 0)),
    ],
}


@pytest.mark.parametrize("joints", REFUSED.values(), ids=REFUSED)
def test_what_needs_more_joints_than_motors_is_refused_with_a_way_out(joints):
    message = r'joint "j4" mimics "j3": .* 4 are left for 3 motors\. Choose base= and tip=|5 are left'
    with pytest.raises(ArmFileError, match=message):
        ikjax.Arm.from_urdf(file_of(joints))


def test_a_coupling_beside_the_files_own_is_refused():
    with pytest.raises(ValueError, match="coupling is what the file's mimic joints say"):
        ikjax.Arm.from_urdf(file_of(PALLETISER), coupling=np.eye(3))
