"""Goals and answers of other libraries: jaxlie, scipy, MuJoCo, MJX, and plain wxyz + xyz."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import ikjax

ARM = ikjax.robots.ur5e()
Q = np.array([0.3, -1.5, 0.9, 0.7, -1.6, 0.2])


def goal():
    return np.asarray(ikjax.fk(ARM, Q))


def same(sol):
    """Whether the same slots are answered as for the goal as a matrix, to rounding."""
    wanted = ikjax.solve(ARM, goal())
    np.testing.assert_array_equal(sol.valid, wanted.valid)
    assert wanted.valid.sum() == 8
    np.testing.assert_allclose(sol.q, wanted.q, atol=1e-7)


def test_a_pose_of_jaxlie_is_a_goal():
    jaxlie = pytest.importorskip("jaxlie")
    same(ikjax.solve(ARM, jaxlie.SE3.from_matrix(jnp.asarray(goal()))))


def test_jaxlie_and_wxyz_xyz_pass_to_and_fro():
    jaxlie = pytest.importorskip("jaxlie")
    poses = ikjax.fk(ARM, np.random.default_rng(0).uniform(-3, 3, (20, 6)))
    lie = jaxlie.SE3(ikjax.to_wxyz_xyz(poses))
    np.testing.assert_allclose(lie.as_matrix(), poses, atol=1e-12)
    np.testing.assert_allclose(ikjax.pose(wxyz_xyz=lie.wxyz_xyz), poses, atol=1e-12)
    np.testing.assert_allclose(ikjax.pose(matrix=lie), poses, atol=1e-12)
    np.testing.assert_allclose(ikjax.pose(lie.translation(), matrix=lie.rotation()), poses, atol=1e-12)
    np.testing.assert_allclose(jaxlie.SE3.from_matrix(poses).as_matrix(), poses, atol=1e-12)


@pytest.mark.slow
def test_a_gradient_passes_through_jaxlie_and_the_solver():
    jaxlie = pytest.importorskip("jaxlie")
    start = jaxlie.SE3.from_matrix(jnp.asarray(goal()))
    # jaxlie mixes types.
    loose = jax.numpy_dtype_promotion("standard")

    @jax.jit
    @jax.grad
    def slope(twist):
        return ikjax.solve(ARM, jaxlie.SE3.exp(twist) @ start).q[0, 2]

    def elbow(twist):
        return float(ikjax.solve(ARM, jaxlie.SE3.exp(twist) @ start).q[0, 2])

    step = 1e-6
    with loose:
        central = [(elbow(step * e) - elbow(-step * e)) / (2 * step) for e in jnp.eye(6)]
        np.testing.assert_allclose(slope(jnp.zeros(6)), central, atol=1e-6)


def test_a_rotation_of_scipy_is_taken():
    same(ikjax.solve(ARM, ikjax.pose(goal()[:3, 3], matrix=Rotation.from_matrix(goal()[:3, :3]))))


# The UR5e's flange as a body that hangs in the world, with a site turned about it.
MODEL = """
<mujoco><worldbody><body name="flange" pos="{}" quat="{}">
  <geom size="0.01"/><site name="tip" pos="0 0 0.1" euler="0 30 0"/>
</body>
<body pos="3 0 0"><joint axis="0 0 1"/><geom size="0.01"/></body></worldbody></mujoco>
"""


def model():
    mujoco = pytest.importorskip("mujoco")
    wxyz, xyz = np.split(np.asarray(ikjax.to_wxyz_xyz(goal())), [4])
    return mujoco, mujoco.MjModel.from_xml_string(MODEL.format(*(" ".join(map(str, x)) for x in (xyz, wxyz))))


def test_positions_quaternions_and_flat_matrices_of_mujoco_are_taken():
    mujoco, compiled = model()
    data = mujoco.MjData(compiled)
    mujoco.mj_kinematics(compiled, data)
    body = data.body("flange")
    same(ikjax.solve(ARM, ikjax.pose(body.xpos, wxyz=body.xquat)))
    same(ikjax.solve(ARM, ikjax.pose(body.xpos, matrix=body.xmat)))
    sites = ikjax.pose(data.site_xpos, matrix=data.site_xmat)
    assert sites.shape == (1, 4, 4)
    tip = np.eye(4)
    tip[:3, :3], tip[2, 3] = Rotation.from_euler("y", 30, degrees=True).as_matrix(), 0.1
    np.testing.assert_allclose(sites[0], goal() @ tip, atol=1e-9)
    # And back: MuJoCo writes a quaternion first.
    answer = np.asarray(ikjax.to_wxyz_xyz(sites[0]))
    np.testing.assert_allclose(answer[4:], data.site_xpos[0], atol=1e-12)
    assert abs(answer[:4] @ Rotation.from_matrix(sites[0, :3, :3]).as_quat(scalar_first=True)) > 1 - 1e-12


@pytest.mark.slow
def test_data_of_mjx_is_a_goal_within_a_jit():
    mjx = pytest.importorskip("mujoco.mjx")
    _, compiled = model()
    with jax.numpy_dtype_promotion("standard"), jax.numpy_rank_promotion("allow"):
        there, data = mjx.put_model(compiled), mjx.make_data(compiled)

    @jax.jit
    def answer(data):
        data = mjx.kinematics(there, data)
        return ikjax.solve(ARM, ikjax.pose(data.xpos[1], matrix=data.xmat[1]))

    # MJX mixes types and ranks.
    with jax.numpy_dtype_promotion("standard"), jax.numpy_rank_promotion("allow"):
        sol = answer(data)
    assert sol.valid.sum() == 8
    # MJX may compute in float32.
    np.testing.assert_allclose(sol.q, ikjax.solve(ARM, goal()).q, atol=1e-4)


def test_nine_numbers_are_a_rotation_row_by_row():
    R = Rotation.random(5, random_state=0).as_matrix()
    np.testing.assert_array_equal(ikjax.pose(matrix=R.reshape(5, 9)), ikjax.pose(matrix=R))
    with pytest.raises(ValueError, match=r"shape \(\.\.\., 3, 3\), \(\.\.\., 9\) or"):
        ikjax.pose(matrix=np.zeros(8))
