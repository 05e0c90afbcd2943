import math
import warnings

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import ikjax
from ikjax.core import pose as poses

pose_error = jax.jit(ikjax.pose_error)


def turn(axis, angle):
    """Rotation about x, y or z, written out."""
    c, s = np.cos(angle), np.sin(angle)
    plane = np.roll([0, 1, 2], -"xyz".index(axis))[1:]
    matrix = np.eye(3)
    matrix[np.ix_(plane, plane)] = [[c, -s], [s, c]]
    return matrix


def random_poses(rng, count):
    array = np.tile(np.eye(4), (count, 1, 1))
    array[:, :3, 3] = rng.uniform(-1, 1, (count, 3))
    for place in array:
        place[:3, :3] = np.linalg.multi_dot(
            [turn(axis, angle) for axis, angle in zip("zyx", rng.uniform(-3, 3, 3), strict=True)]
        )
    return array


def test_roll_pitch_yaw_turn_about_fixed_axes_in_that_order(dtype):
    got = ikjax.pose(np.array([1, 2, 3], dtype), rpy=np.array([0.3, -1.1, 2.0], dtype))
    assert got.dtype == dtype
    np.testing.assert_allclose(got[:3, :3], turn("z", 2.0) @ turn("y", -1.1) @ turn("x", 0.3), atol=3e-7)
    np.testing.assert_array_equal(got[:, 3], [1, 2, 3, 1])
    np.testing.assert_array_equal(got[3], [0, 0, 0, 1])


@pytest.mark.parametrize("axis", "xyz")
def test_a_quaternion_has_its_scalar_first(axis):
    half = np.zeros(4)
    half[0], half[1 + "xyz".index(axis)] = math.cos(0.35), math.sin(0.35)
    for wxyz in (half, -half, 1.0009 * half):
        got = ikjax.pose(wxyz=wxyz)
        np.testing.assert_allclose(got[:3, :3], turn(axis, 0.7), atol=1e-15)
    np.testing.assert_array_equal(ikjax.pose(wxyz=half), ikjax.pose(wxyz=-half))


def test_a_quaternion_may_have_its_scalar_last(rng):
    wxyz = rng.standard_normal((5, 4))
    wxyz /= np.linalg.norm(wxyz, axis=1)[:, None]
    np.testing.assert_array_equal(ikjax.pose(xyzw=np.roll(wxyz, -1, axis=1)), ikjax.pose(wxyz=wxyz))


def test_a_rotation_vector_turns_about_itself_by_its_length(rng, dtype):
    from scipy.spatial.transform import Rotation

    # As a pendant of Universal Robots shows it, in degrees, and angles from tiny to more than a turn.
    vectors = rng.standard_normal((8, 3))
    vectors *= (
        np.array([0, 1e-9, 1e-4, 1, 3, math.pi, 6, 6.2])[:, None] / np.linalg.norm(vectors, axis=1)[:, None]
    )
    vectors = np.concatenate([vectors, np.radians([[149.49, -12.78, 72.64]])])
    got = ikjax.pose(rotvec=vectors.astype(dtype))
    assert got.dtype == dtype
    np.testing.assert_allclose(
        got[:, :3, :3], Rotation.from_rotvec(vectors).as_matrix(), atol=12 * np.finfo(dtype).eps
    )


@pytest.mark.parametrize("size", [0.0, 1e-12, 1e-8, 2e-8, 0.5, math.pi])
def test_the_derivatives_of_a_rotation_vector_are_right_at_zero_and_everywhere(size):
    def turned(v):
        return ikjax.pose(rotvec=v)[:3, :3]

    v = size * np.array([0.6, 0.0, 0.8])
    forward, backward = jax.jacfwd(turned)(v), jax.jacrev(turned)(v)
    h = 1e-6
    for k, unit in enumerate(np.eye(3)):
        wanted = (np.asarray(turned(v + h * unit)) - np.asarray(turned(v - h * unit))) / (2 * h)
        np.testing.assert_allclose(forward[..., k], wanted, atol=1e-9)
    np.testing.assert_allclose(backward, forward, atol=1e-15)
    assert np.isfinite(jax.jacfwd(jax.jacrev(turned))(v)).all()


def test_quaternion_and_position_in_one_array_there_and_back(rng):
    both = rng.normal(size=(5, 7))
    both[:, :4] /= np.linalg.norm(both[:, :4], axis=-1, keepdims=True)
    T = ikjax.pose(wxyz_xyz=both)
    np.testing.assert_allclose(T, ikjax.pose(both[:, 4:], wxyz=both[:, :4]), atol=1e-15)
    back = np.array(ikjax.to_wxyz_xyz(T))
    back[:, :4] *= np.sign((back[:, :4] * both[:, :4]).sum(-1, keepdims=True))
    np.testing.assert_allclose(back, both, atol=1e-14)
    with pytest.raises(ValueError, match="wxyz_xyz holds one"):
        ikjax.pose(np.zeros(3), wxyz_xyz=both[0])
    with pytest.raises(ValueError, match="length"):
        ikjax.pose(wxyz_xyz=2 * both)


def test_rotations_of_scipy_are_taken_as_they_are(rng):
    turned = Rotation.from_rotvec(rng.normal(size=(4, 3)))
    T = ikjax.pose(np.ones(3), matrix=turned)
    np.testing.assert_array_equal(T[:, :3, :3], turned.as_matrix())
    arm = ikjax.robots.puma560()

    class Pose:
        def as_matrix(self):
            return T

    np.testing.assert_array_equal(ikjax.solve(arm, Pose()).q, ikjax.solve(arm, T).q)


def test_a_whole_pose_as_a_matrix_brings_its_position(rng):
    given = random_poses(rng, 4)
    np.testing.assert_array_equal(ikjax.pose(matrix=given), given)


@pytest.mark.parametrize("digits", [3, 4, 6])
def test_a_rounded_matrix_is_made_a_rotation_where_that_is_asked_for(rng, digits):
    exact = random_poses(rng, 4)
    rounded = np.round(exact, digits)
    assert np.abs(ikjax.pose(matrix=rounded) - rounded).max() == 0
    for given in (rounded, rounded[:, :3, :3]):
        got = np.asarray(ikjax.pose(matrix=given, orthonormalize=True))
        turn = got[:, :3, :3]
        np.testing.assert_allclose(np.swapaxes(turn, 1, 2) @ turn, np.tile(np.eye(3), (4, 1, 1)), atol=1e-15)
        u, _, v = np.linalg.svd(rounded[:, :3, :3])
        np.testing.assert_allclose(turn, u @ v, atol=1e-14)
        np.testing.assert_array_equal(got[:, :3, 3], given[:, :3, 3] if given.shape[-1] == 4 else 0)


def test_under_jit_what_is_far_from_a_rotation_is_left_alone_with_finite_gradients(dtype):
    def turned(matrix):
        return ikjax.pose(matrix=matrix, orthonormalize=True)[..., :3, :3]

    bad = np.stack([1e30 * np.ones((3, 3)), np.zeros((3, 3)), np.eye(3) * 1.001]).astype(dtype)
    got, derivatives = jax.jit(lambda m: (turned(m), jax.vmap(jax.jacrev(turned))(m)))(bad)
    np.testing.assert_array_equal(got[:2], bad[:2])
    np.testing.assert_allclose(got[2], np.eye(3), atol=4 * np.finfo(dtype).eps)
    assert np.isfinite(derivatives).all()


@pytest.mark.parametrize("form", ["rpy", "rotvec"])
def test_angles_in_degrees_are_noticed_and_turns_are_not(form):
    with pytest.warns(UserWarning, match=rf"^{form} holds 180 rad, which is 28.6 turns: degrees\?$") as seen:
        ikjax.pose(**{form: [[0, 0, 0], [180, 0, -90]]})
    assert len(seen) == 1 and seen[0].filename == __file__
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        ikjax.pose(**{form: [2 * math.pi, -2 * math.pi, 1.0]})
        jax.jit(lambda angles: ikjax.pose(**{form: angles}))(np.array([180.0, 0, 0]))
        jax.vmap(lambda angle: ikjax.pose(**{form: [angle, 0.0, 0.0]}))(np.array([180.0, 0]))


def test_a_planar_goal_in_degrees_is_noticed_by_the_name_of_its_angle():
    with pytest.warns(UserWarning, match=r"^phi holds 90 rad") as seen:
        ikjax.planar_pose(0.1, 0.2, [90, 1.0])
    assert len(seen) == 1


def test_a_rotation_matrix_is_taken_as_it_is():
    matrix = turn("y", 0.4)
    np.testing.assert_array_equal(ikjax.pose([1.0, 0, 0], matrix=matrix)[:3, :3], matrix)


def test_positions_and_orientations_broadcast():
    got = jax.eval_shape(lambda xyz, rpy: ikjax.pose(xyz, rpy=rpy), np.zeros((5, 1, 3)), np.zeros((2, 3)))
    assert got.shape == (5, 2, 4, 4)
    assert jax.eval_shape(ikjax.pose, np.zeros((0, 3))).shape == (0, 4, 4)
    assert jax.eval_shape(ikjax.position, np.zeros(3), 0.0, 1.0).shape == (3, 4, 4)


def test_planar_goals_turn_about_z(dtype):
    got = ikjax.planar_pose(1.0, 2.0, 0.7, dtype=dtype)
    assert got.dtype == dtype
    np.testing.assert_allclose(got[:3, :3], turn("z", 0.7), atol=1e-7)
    np.testing.assert_array_equal(got[:, 3], [1, 2, 0, 1])


def test_a_position_has_no_orientation_to_speak_of(dtype):
    got = ikjax.position(1.0, 2.0, 3.0, dtype=dtype)
    assert got.dtype == dtype
    np.testing.assert_array_equal(got, [[1, 0, 0, 1], [0, 1, 0, 2], [0, 0, 1, 3], [0, 0, 0, 1]])


@pytest.mark.parametrize(
    ("given", "text"),
    [
        ({"rpy": np.zeros(3), "wxyz": np.ones(4)}, "give one orientation, got rpy and wxyz"),
        ({"xyz": np.zeros(7)}, r"xyz must have shape \(\.\.\., 3\), got \(7,\)"),
        ({"xyz": 1.0}, r"xyz must have shape \(\.\.\., 3\), got \(\)"),
        ({"rpy": np.zeros(4)}, r"rpy must have shape \(\.\.\., 3\), got \(4,\)"),
        ({"wxyz": np.array([1.0, 0, 0])}, r"wxyz must have shape \(\.\.\., 4\), got \(3,\)"),
        ({"wxyz": np.zeros(4)}, "wxyz must have length 1 within 1e-3, it is off by 1"),
        ({"wxyz": np.array([1.01, 0, 0, 0])}, "off by 0.01"),
        ({"wxyz": np.array([np.nan, 0, 0, 0])}, "off by nan"),
        ({"xyzw": np.array([1.01, 0, 0, 0])}, "xyzw must have length 1 within 1e-3, it is off by 0.01"),
        ({"rotvec": np.zeros(4)}, r"rotvec must have shape \(\.\.\., 3\), got \(4,\)"),
        ({"rotvec": np.zeros(3), "matrix": np.eye(3)}, "give one orientation, got rotvec and matrix"),
        ({"matrix": np.zeros((3, 4))}, r"matrix must have shape .*3, 3\), .*9\) or .*4, 4\), got \(3, 4\)"),
        ({"matrix": np.zeros(3)}, r"matrix must have shape .* got \(3,\)"),
        ({"matrix": np.eye(4), "xyz": np.zeros(3)}, "give one position"),
        ({"matrix": np.eye(4) + np.eye(4)[:, ::-1]}, "bottom rows .*: transposed"),
        ({"orthonormalize": True}, "orthonormalize goes with matrix="),
        (
            {"matrix": 1.01 * np.eye(3), "orthonormalize": True},
            r"within 0\.01, its R\^T R - I has norm 0\.035",
        ),
        ({"matrix": np.full((3, 3), np.nan), "orthonormalize": True}, "norm nan"),
        ({"matrix": np.diag([1, 1, -1]), "orthonormalize": True}, "got a reflection"),
    ],
)
def test_a_mistake_is_named(given, text):
    with pytest.raises(ValueError, match=text):
        ikjax.pose(**given)


def test_neighbors_cancel(rng):
    def laws(*matrices):
        first, second, third = (poses.from_matrix(matrix) for matrix in matrices)
        pairs = {
            "as matrices": (poses.compose(first, second), poses.from_matrix(matrices[0] @ matrices[1])),
            "associative": (
                poses.compose(poses.compose(first, second), third),
                poses.compose(first, poses.compose(second, third)),
            ),
            "inverse on the right": (poses.compose(first, poses.inverse(first)), poses.IDENTITY),
            "inverse on the left": (poses.compose(poses.inverse(first), first), poses.IDENTITY),
        }
        return {law: [poses.to_matrix(side) for side in sides] for law, sides in pairs.items()}

    for law, (left, right) in jax.jit(laws)(*(random_poses(rng, 10) for _ in range(3))).items():
        np.testing.assert_allclose(left, np.broadcast_to(right, left.shape), atol=1e-14, err_msg=law)
    assert poses.compose(poses.IDENTITY, poses.IDENTITY) == poses.IDENTITY


def test_scalars_and_matrices_are_two_forms_of_one_thing(rng):
    given = random_poses(rng, 6).reshape(2, 3, 4, 4)
    there_and_back = jax.jit(lambda matrix: poses.to_matrix(poses.from_matrix(matrix)))
    np.testing.assert_array_equal(there_and_back(given), given)


def test_the_error_is_right_to_rounding_at_both_ends(rng):
    angles = np.array([0.0, 1e-12, 1e-7, 1.0, math.pi / 2, math.pi - 1e-7, math.pi])
    for axis in "xyz":
        first = random_poses(rng, len(angles))
        motion = np.tile(np.eye(4), (len(angles), 1, 1))
        motion[:, :3, :3] = [turn(axis, angle) for angle in angles]
        motion[:, :3, 3] = 0, 3e-9, 4e-9
        second = first @ motion
        distance, turned = pose_error(first, second)
        np.testing.assert_allclose(turned, angles, atol=1e-15, rtol=1e-15)
        np.testing.assert_allclose(distance, 5e-9, atol=1e-15)


def test_the_error_has_finite_derivatives_everywhere():
    def error(turned, moved):
        zero = jnp.zeros_like(turned)
        pose = ikjax.pose(jnp.stack([moved, zero, zero]), rpy=jnp.stack([turned, zero, zero]))
        return ikjax.pose_error(pose, jnp.eye(4))

    turned = np.array([0, 1e-12, 1, math.pi - 1e-12, math.pi])
    moved = np.array([0, 1e-12, 1, 1e3, 0])
    derivatives = jax.jit(jax.vmap(jax.jacrev(error, (0, 1))))(turned, moved)
    (nothing, by_distance), (by_angle, nothing_either) = derivatives
    np.testing.assert_array_equal([nothing, nothing_either], 0)
    np.testing.assert_allclose(by_distance, [0, 1, 1, 1, 0], atol=1e-12)
    np.testing.assert_allclose(by_angle[:4], [0, 1, 1, 1], atol=1e-12)
    assert abs(by_angle[4]) <= 1 + 1e-12


def test_the_error_of_many_pairs_broadcasts(rng):
    distance, angle = pose_error(random_poses(rng, 3), np.eye(4))
    assert distance.shape == angle.shape == (3,)
    assert np.all(angle >= 0) and np.all(angle <= math.pi)
