import jax
import numpy as np
import oracle
import pytest

import ikjax
from ikjax.arm import dh, forward
from ikjax.arm.arm import Arm
from ikjax.core import pose as poses

DEG = np.pi / 180
BASE = np.array([[0, 0, 1, 0.1], [1, 0, 0, -0.2], [0, 1, 0, 0.3], [0, 0, 0, 1.0]])
TOOL = np.array([[0.6, 0, 0.8, 0.05], [0, 1, 0, 0.02], [-0.8, 0, 0.6, 0.13], [0, 0, 0, 1.0]])
ARMS = {
    "puma": ikjax.robots.puma560(),
    "stanford": Arm.from_dh(
        a=np.zeros(6),
        alpha=np.multiply([-90, 90, 0, -90, 90, 0], DEG),
        d=[0.412, 0.154, 0, 0, 0, 0.263],
        kinds="RRPRRR",
        convention="standard",
        name="stanford",
    ),
    "skew": Arm.from_dh(
        a=[0.1, -0.4, 0.05, 0.2],
        alpha=[0.3, -1.2, 2.0, -0.4],
        d=[0.3, 0.02, -0.1, 0.4],
        theta=[0.1, -0.2, 0.3, 2.9],
        kinds="PRRP",
        base=BASE,
        tool=TOOL,
        convention="standard",
        name="skew",
    ),
}


def everything(arm, q):
    """fk, frames and jacobian, compiled together and for this arm alone, which is quick."""
    arm = arm.baked()
    return jax.jit(lambda q: (ikjax.fk(arm, q), ikjax.frames(arm, q), ikjax.jacobian(arm, q)))(q)


def planar(first, second):
    return Arm.from_dh(a=[first, second], alpha=[0, 0], d=[0, 0], convention="standard", name="2R")


@pytest.mark.parametrize("name", ARMS)
def test_every_link_stands_and_moves_as_sixty_digits_say(name, dtype, rng):
    arm = ARMS[name].astype(dtype)
    q = rng.uniform(-3, 3, (2, 3, arm.n)).astype(dtype)
    tools, links, jacobians = everything(arm, q)
    assert tools.dtype == links.dtype == jacobians.dtype == dtype
    # Each of n links turns and adds: a few roundings each, on lengths of up to six metres.
    near = {"atol": 16 * arm.n * np.finfo(dtype).eps, "rtol": 0}
    for i in np.ndindex(2, 3):
        tool = oracle.fk(arm, q[i])
        np.testing.assert_allclose(links[i], [oracle.floats(T) for T in oracle.frames(arm, q[i])], **near)
        np.testing.assert_allclose(tools[i], oracle.floats(tool), **near)
        assert max(oracle.error(arm, q[i], tools[i])) < near["atol"]
        for column, derivative in zip(jacobians[i].T, oracle.derivatives(arm, q[i]), strict=True):
            spin = oracle.floats(derivative[:3, :3] * tool[:3, :3].T)
            turning = spin[2, 1], spin[0, 2], spin[1, 0]
            np.testing.assert_allclose(column, [*oracle.floats(derivative)[:3, 3], *turning], **near)


def test_a_sliding_joint_does_not_turn_the_tool():
    _, _, jacobian = everything(ARMS["skew"], np.array([0.1, 0.2, -0.3, 0.4]))
    np.testing.assert_array_equal(jacobian[3:, [0, 3]], 0)
    np.testing.assert_array_equal(jacobian[:, 0], [*BASE[:3, 2], 0, 0, 0])


@pytest.mark.parametrize("shape", [(), (0,), (1,), (2, 3)])
def test_any_batch_axes_may_lead(shape):
    arm = ARMS["stanford"]
    for f, item in ((ikjax.fk, (4, 4)), (ikjax.frames, (7, 4, 4)), (ikjax.jacobian, (6, 6))):
        assert jax.eval_shape(f, arm, np.zeros((*shape, 6))).shape == (*shape, *item)


@pytest.mark.parametrize("shape", [(), (5,), (7,), (6, 1)])
@pytest.mark.parametrize("f", [ikjax.fk, ikjax.frames, ikjax.jacobian])
def test_a_wrong_number_of_joints_is_named(f, shape):
    with pytest.raises(ValueError, match=r"q must have shape \(\.\.\., 6\) for puma560, got \("):
        f(ARMS["puma"], np.zeros(shape))


def test_two_links_in_a_plane_are_as_in_the_textbook(rng):
    l1, l2 = 0.7, 0.4
    arm = Arm.from_dh(a=[l1, l2], alpha=[0, 0], d=[0, 0], convention="standard")
    q = np.concatenate([rng.uniform(-3, 3, (20, 2)), [[1, 0], [1, np.pi]]])
    tool, _, jacobian = everything(arm, q)
    # Spong, Robot Modeling and Control, equations (1.1)-(1.2).
    x = l1 * np.cos(q[:, 0]) + l2 * np.cos(q.sum(1))
    y = l1 * np.sin(q[:, 0]) + l2 * np.sin(q.sum(1))
    np.testing.assert_allclose(tool, ikjax.planar_pose(x, y, q.sum(1)), atol=1e-15)
    # ME/SE 740, lecture 18.
    np.testing.assert_allclose(np.linalg.det(jacobian[:, :2]), l1 * l2 * np.sin(q[:, 1]), atol=1e-15)


def test_whole_turns_of_a_joint_change_nothing():
    q = np.array([0.3, -1.0, 2.0, 0.1, -0.5, 1.5])
    turns = 2 * np.pi * np.array([1, -1, 2, 3, -3, 1])
    first, second = everything(ARMS["puma"], np.stack([q, q + turns]))[0]
    np.testing.assert_allclose(first, second, atol=1e-14)


def test_links_can_be_put_on_and_taken_off_again(rng):
    arm = ARMS["skew"]
    frame, goal = (poses.from_matrix(T) for T in np.asarray(everything(arm, rng.uniform(-1, 1, (2, 4)))[0]))

    def there_and_back(frame, goal, sine, cosine, d):
        link, joint = forward.links(arm)[1], forward.Joint(sine, cosine, d)
        ahead = forward.advance(frame, link, joint)
        one = forward.advance(poses.IDENTITY, link, joint)
        return (
            (forward.strip(ahead, link, joint), frame),
            (poses.compose(one, forward.unwind(goal, link, joint)), goal),
            (poses.compose(frame, one), ahead),
        )

    for got, wanted in jax.jit(there_and_back)(frame, goal, np.sin(0.8), np.cos(0.8), 0.3):
        np.testing.assert_allclose(jax.tree.leaves(got), jax.tree.leaves(wanted), atol=1e-15)


@pytest.mark.parametrize("name", ARMS)
def test_a_table_in_numpy_places_the_links_where_the_kernels_do(name):
    arm = ARMS[name]
    columns = {key: np.asarray(getattr(arm, key), float) for key in ("a", "alpha", "d", "theta")}
    kernels = everything(arm, np.zeros(arm.n))[1]
    np.testing.assert_allclose(np.asarray(arm.base) @ dh.frames(columns), kernels, atol=1e-15)
