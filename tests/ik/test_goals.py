"""Every row of the table of goals in RELIABILITY: what is raised, what is masked, what is answered."""

import warnings

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import ikjax
from ikjax.arm.forward import reach

ARM = ikjax.robots.get("puma560")
Q = np.array([0.3, -0.5, 0.4, 0.7, -0.6, 0.2])


def goal(dtype=np.float64) -> np.ndarray:
    """A plain goal that all eight slots reach."""
    return np.array(ikjax.fk(ARM, Q), dtype)


def solve(goals):
    return ikjax.solve(ARM, goals)


def changed(**entries) -> np.ndarray:
    """The plain goal with entries such as R=..., p=..., bottom=... replaced."""
    T = goal()
    T[:3, :3] = entries.get("R", T[:3, :3])
    T[:3, 3] = entries.get("p", T[:3, 3])
    T[3] = entries.get("bottom", T[3])
    return T


def stretched(size) -> np.ndarray:
    """A rotation whose R^T R - I has about this norm."""
    R = goal()[:3, :3].copy()
    R[:, 0] *= 1 + size / 2
    return R


MASKED = {
    "NaN in the position": changed(p=[np.nan, 0, 0]),
    "NaN in the rotation": changed(R=np.full((3, 3), np.nan)),
    "Inf": changed(p=[0, np.inf, 0]),
    "minus Inf": changed(p=[0, 0, -np.inf]),
    "all NaN": np.full((4, 4), np.nan),
    "rotation off by 1e-4": changed(R=stretched(1e-4)),
    "rotation off by 1": changed(R=stretched(1.0)),
    "huge rotation": changed(R=np.full((3, 3), 1e308)),
    "reflection": changed(R=goal()[:3, :3] @ np.diag([1, 1, -1])),
    "zero rotation": changed(R=np.zeros((3, 3))),
    "rank 1": changed(R=np.ones((3, 3)) / 3),
    "bottom row": changed(bottom=[0, 0, 0, 2]),
    "NaN in the bottom row": changed(bottom=[np.nan, 0, 0, 1]),
    "transposed": goal().T,
    "1e308": changed(p=[1e308, -1e308, 1e308]),
    "1000 times the reach": changed(p=[900.0, 0, 0]),
}
RAISED = {
    "NaN in the position": "must hold finite numbers",
    "NaN in the rotation": "must hold finite numbers",
    "Inf": "must hold finite numbers",
    "minus Inf": "must hold finite numbers",
    "all NaN": "must hold finite numbers",
    "rotation off by 1e-4": r"must hold a rotation, its R\^T R - I has norm 0\.0001",
    "rotation off by 1": r"R\^T R - I has norm",
    "huge rotation": r"R\^T R - I has norm",
    "reflection": "reflection",
    "zero rotation": r"R\^T R - I has norm 2",
    "rank 1": r"R\^T R - I has norm",
    "bottom row": r"bottom row \(0, 0, 0, 1\)",
    "NaN in the bottom row": "must hold finite numbers",
    "transposed": r"bottom row \(0, 0, 0, 1\), got .*: transposed\?",
}
FINITE = ("q", "margin", "position_error", "rotation_error")


@pytest.mark.filterwarnings("error")
class TestMasked:
    @pytest.mark.parametrize("case", MASKED)
    def test_it_is_masked_and_its_neighbors_keep_their_bits(self, case, dtype):
        with np.errstate(over="ignore"):
            bad = MASKED[case].astype(dtype)
        good = np.tile(goal(dtype), (9, 1, 1))
        batch = good.copy()
        batch[4] = bad
        sol, wanted = solve(batch), solve(good)
        assert not sol.valid[4].any()
        others = np.arange(9) != 4
        assert wanted.valid.all()
        for field, values in vars(sol).items():
            np.testing.assert_array_equal(
                np.asarray(values)[others], np.asarray(getattr(wanted, field))[others]
            )
        for field in FINITE:
            assert np.isfinite(getattr(sol, field)[4]).all(), field

    @pytest.mark.parametrize("case", RAISED)
    def test_the_host_check_raises_and_names_it(self, case):
        with pytest.raises(ValueError, match=rf"(?s)goals\[1\] .*{RAISED[case]}"):
            ikjax.check_goals(ARM, np.stack([goal(), MASKED[case], goal()]))


def test_a_good_batch_passes_the_host_check():
    assert ikjax.check_goals(ARM, np.tile(goal(), (2, 3, 1, 1))) is None


def test_the_host_check_names_the_others():
    with pytest.raises(ValueError, match=r"goals\[0, 1\] \(and 2 more: \[0, 2\], \[1, 0\]\)"):
        batch = np.tile(goal(), (2, 3, 1, 1))
        batch[0, 1:, 0, 0], batch[1, 0, 1, 3] = np.nan, np.inf
        ikjax.check_goals(ARM, batch)


@pytest.mark.parametrize("name", ["puma560", "ur5e", "so101", "gx4_351s", "planar_3r"])
def test_every_reachable_goal_in_millimetres_is_noticed_and_none_in_metres(name, rng):
    arm = ikjax.robots.get(name)
    q = rng.uniform(-2, 2, (200, arm.n)) * np.where([kind == "R" for kind in arm.kinds], 1, 0.05)
    goals = np.array(ikjax.fk(arm, q))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        ikjax.check_goals(arm, goals)
    goals[:, :3, 3] *= 1000
    for goal in goals:
        with pytest.warns(UserWarning, match=r"^goals lies .* m from the base.*are these millimetres\?$"):
            ikjax.check_goals(arm, goal)
    with pytest.warns(UserWarning, match=r"goals\[0\] \(and 199 more\) lies") as seen:
        ikjax.check_goals(arm, goals)
    assert len(seen) == 1 and seen[0].filename == __file__


@pytest.mark.filterwarnings("error")
def test_goals_are_far_from_the_base_not_from_the_origin_of_the_world():
    base = np.eye(4)
    base[0, 3] = 500.0
    arm = ikjax.Arm.from_dh(a=[0.5, 0.5], alpha=[0, 0], d=[0, 0], convention="standard", base=base)
    ikjax.check_goals(arm, ikjax.fk(arm, np.array([0.3, 0.4])))


def test_a_rounded_goal_is_refused_with_the_remedy_and_a_wild_one_without():
    for size, remedy in ((1e-3, True), (0.1, False)):
        with pytest.raises(ValueError, match=r"R\^T R - I has norm") as error:
            ikjax.check_goals(ARM, changed(R=stretched(size)))
        assert ("orthonormalize=True" in str(error.value)) == remedy
    rounded = goal().round(3)
    meant = ikjax.pose(matrix=rounded, orthonormalize=True)
    ikjax.check_goals(ARM, meant)
    assert solve(meant).valid.all()


class TestDegrees:
    """Joints given in degrees are noticed."""

    def test_a_place_in_degrees_is_noticed_by_solve_and_nearest(self):
        sol = solve(goal())
        for call in (lambda q: ikjax.solve(ARM, goal(), q), lambda q: ikjax.nearest(ARM, sol, q)):
            with pytest.warns(UserWarning, match=r"^q_now holds 45 rad.*degrees\?$") as seen:
                call(np.array([0.0, -45.0, 90.0, 0.0, 30.0, 0.0]))
            assert len(seen) == 1 and seen[0].filename == __file__

    @pytest.mark.filterwarnings("error")
    def test_turns_slides_and_traced_places_are_not(self):
        sol = solve(goal())
        ikjax.solve(ARM, goal(), np.full(6, 8 * np.pi))
        ikjax.nearest(ARM, sol, np.full(6, -8 * np.pi))
        jax.jit(lambda q: ikjax.nearest(ARM, sol, q))(np.full(6, 90.0))
        place = goal()
        jax.eval_shape(lambda q: ikjax.solve(ARM, place, q), np.full(6, 90.0))
        captured = jax.numpy.zeros(6)
        jax.eval_shape(lambda T: ikjax.solve(ARM, T, captured), place)
        arm = ikjax.robots.get("gx4_351s")
        ikjax.nearest(arm, ikjax.solve(arm, ikjax.fk(arm, np.zeros(4))), np.array([0.0, 0.0, -200.0, 0.0]))


@pytest.mark.parametrize("tiny", [1e-308, 5e-324, -1e-300])
def test_a_vanishing_entry_counts_as_zero_or_itself(tiny):
    small, zero = goal(), goal()
    small[2, 3], zero[2, 3] = tiny, 0
    sol, wanted = solve(small), solve(zero)
    np.testing.assert_array_equal(sol.valid, wanted.valid)
    assert sol.valid.any()
    np.testing.assert_allclose(sol.q, wanted.q, atol=1e-12)


def test_minus_zero_is_zero(dtype):
    # Axis-aligned: nearly every entry is a zero, and angles sit at pi and pi / 2.
    plus = np.asarray(ikjax.fk(ARM, np.array([0, -np.pi / 2, np.pi / 2, 0, np.pi / 2, 0])))
    plus = (np.round(plus, 12) + 0.0).astype(dtype)
    minus = np.where(plus == 0, -0.0, plus).astype(dtype)
    minus[3] = plus[3]
    assert np.signbit(minus).sum() > np.signbit(plus).sum()
    sol, wanted = solve(minus), solve(plus)
    assert wanted.valid.any()
    np.testing.assert_array_equal(sol.valid, wanted.valid)
    np.testing.assert_allclose(sol.q, wanted.q, atol=1e-5 if dtype == np.float32 else 1e-12)


@pytest.mark.parametrize("size", [1e-12, 1e-6])
def test_a_rotation_slightly_off_is_made_one(size):
    sol = solve(changed(R=stretched(size)))
    assert sol.valid.all()
    np.testing.assert_allclose(sol.q, solve(goal()).q, atol=10 * size)
    ikjax.check_goals(ARM, changed(R=stretched(size)))


@pytest.mark.parametrize("shape", [(7,), (3, 4), (4,), (), (5, 3, 4), (4, 4, 3)])
def test_a_wrong_shape_raises(shape):
    text = str(shape).replace("(", r"\(").replace(")", r"\)")
    for call in (solve, lambda goals: ikjax.check_goals(ARM, goals)):
        with pytest.raises(ValueError, match=rf"goals must have shape \(\.\.\., 4, 4\), got {text}"):
            call(np.zeros(shape))


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (np.eye(4, dtype=complex), "must hold real numbers, got complex128"),
        (np.eye(4).astype(object), "must hold real numbers, got object"),
        (np.eye(4).astype(str), "must hold real numbers, got <U"),
        ("nonsense", "must hold real numbers"),
        (None, "must hold real numbers, got object"),
        (np.eye(4, dtype=np.float16), "use float32 or float64"),
        ([[1.0, 2.0], [3.0]], r"goals must be one array \(\.\.\., 4, 4\)"),
    ],
)
def test_a_wrong_type_raises(value, text):
    for call in (solve, lambda goals: ikjax.check_goals(ARM, goals)):
        with pytest.raises(ValueError, match=text):
            call(value)


@pytest.mark.parametrize("make", [lambda T: T.astype(int), lambda T: T.astype(bool), lambda T: T.tolist()])
def test_integers_bools_and_lists_are_converted(make):
    T = np.eye(4)
    T[0, 3] = T[1, 3] = 0
    value = make(T)
    sol, wanted = solve(value), solve(np.asarray(value, float))
    assert sol.q.dtype == np.float64
    np.testing.assert_array_equal(sol.q, wanted.q)
    np.testing.assert_array_equal(sol.valid, wanted.valid)


@pytest.mark.parametrize("batch", [(), (0,), (3, 0), (2, 1, 3, 1, 2)])
def test_any_batch_axes_will_do(batch, dtype):
    sol = solve(np.broadcast_to(goal(dtype), (*batch, 4, 4)))
    assert sol.q.shape == (*batch, 8, 6) and sol.q.dtype == dtype
    for field in ("valid", "margin", "continuum", "position_error", "rotation_error"):
        assert getattr(sol, field).shape == (*batch, 8)
    assert sol.valid.all()
    ikjax.check_goals(ARM, np.broadcast_to(goal(dtype), (*batch, 4, 4)))


def test_identity_and_axis_aligned_orientations_have_all_eight():
    for signs in ([1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]):
        for turn in (np.eye(3), np.eye(3)[[1, 2, 0]], np.eye(3)[[2, 0, 1]]):
            assert solve(changed(R=turn * signs, p=[0.4, 0.3, 0.2])).valid.all()


def test_angles_have_one_form_at_pi(dtype):
    # Joint 6 at pi, made from either side.
    for q6 in (np.pi, -np.pi):
        sol = solve(np.asarray(ikjax.fk(ARM, np.array([*Q[:5], q6])), dtype))
        assert (sol.q > -np.asarray(np.pi, dtype)).all() and (sol.q <= np.asarray(np.pi, dtype)).all()
        near = np.abs(np.abs(np.asarray(sol.q)[:, 5]) - np.pi) < 1e-5
        assert near.any()


class TestQuaternions:
    def test_zero_raises(self):
        with pytest.raises(ValueError, match="wxyz must have length 1"):
            ikjax.pose([0.4, 0.3, 0.2], wxyz=[0.0, 0.0, 0.0, 0.0])

    def test_a_length_within_1e_3_is_normalized(self):
        wxyz = np.array([0.5, 0.5, -0.5, 0.5])
        sol = solve(ikjax.pose([0.4, 0.3, 0.2], wxyz=wxyz * 1.0009))
        assert sol.valid.all()
        np.testing.assert_allclose(sol.q, solve(ikjax.pose([0.4, 0.3, 0.2], wxyz=wxyz)).q, atol=1e-12)
        with pytest.raises(ValueError, match=r"off by 0\.002"):
            ikjax.pose([0.4, 0.3, 0.2], wxyz=wxyz * 1.002)

    def test_q_and_minus_q_are_one(self):
        wxyz = np.array([0.1, 0.7, -0.5, 0.5]) / np.linalg.norm([0.1, 0.7, -0.5, 0.5])
        one, other = (solve(ikjax.pose([0.4, 0.3, 0.2], wxyz=s * wxyz)) for s in (1, -1))
        np.testing.assert_array_equal(one.q, other.q)


TYPED = np.array([[0.969, 0.247, 0], [0, 0, -1], [-0.247, 0.969, 0]])
"""Three decimals: R^T R - I has norm 4e-5."""


class TestNoPose:
    def test_it_is_as_far_off_as_can_be_and_said_to_be_no_pose(self, dtype):
        batch = np.tile(goal(dtype), (len(MASKED) + 1, 1, 1))
        with np.errstate(over="ignore"):
            batch[1:] = [bad.astype(dtype) for bad in MASKED.values()]
        sol = solve(batch)
        # A pose out of reach is one, in numbers that its type has.
        far = np.array([name == "1000 times the reach" or name == "1e308" for name in MASKED])
        far &= np.isfinite(batch[1:]).all((1, 2))
        np.testing.assert_array_equal(sol.is_pose, [True, *far])
        size = float(reach(ARM.baked()))
        lost = ~np.asarray(sol.is_pose)
        np.testing.assert_allclose(sol.margin[lost], -size, rtol=1e-6)
        np.testing.assert_allclose(sol.position_error[lost], size, rtol=1e-6)
        np.testing.assert_allclose(sol.rotation_error[lost], np.pi, rtol=1e-6)
        assert not sol.continuum[lost].any()
        inside = ikjax.limited_margins(ARM, sol)
        assert (np.asarray(inside.margin)[lost] < 0).all()

    def test_its_gradients_are_zero(self):
        goals = jnp.asarray(np.stack([goal(), MASKED["rotation off by 1e-4"], MASKED["reflection"]]))

        def total(arm, goals):
            sol = ikjax.solve(arm, goals)
            return sol.margin.sum() + sol.q.sum()

        gradients = jax.jit(jax.grad(total, (0, 1)))
        _, of_goals = gradients(ARM, goals)
        assert np.abs(of_goals[0]).max() > 0.1
        np.testing.assert_array_equal(of_goals[1:], 0)
        of_arm, _ = gradients(ARM, goals[np.array([1, 2, 1])])
        for leaf in jax.tree.leaves(of_arm):
            np.testing.assert_array_equal(leaf, 0)

    def test_require_names_it_and_the_remedy_and_what_is_only_out_of_reach(self):
        far = goal()
        far[:3, 3] *= 10
        batch = np.stack([goal(), goal().T, far, changed(R=TYPED)])
        with pytest.raises(
            ValueError,
            match=r"(?s)2 of 4 goals are no poses: goal 1, 3\. .*"
            r"pose\(matrix=T, orthonormalize=True\).*transposed\?.*1 of 4 goals have no solution: goal 2 .*-",
        ):
            solve(batch).require()
        with pytest.raises(ValueError, match=r"no solution: goal 0") as caught:
            solve(far[None]).require()
        assert "poses" not in str(caught.value)
        with pytest.raises(ValueError, match=r"norm 4e-05: take the nearest with pose\(matrix="):
            ikjax.check_goals(ARM, changed(R=TYPED))

    def test_inside_a_jit_it_is_said_too(self):
        batch = jnp.asarray(np.stack([goal(), goal().T, changed(R=TYPED)]))
        sol = jax.jit(jax.vmap(lambda T: ikjax.solve(ARM, T)))(batch)
        np.testing.assert_array_equal(sol.is_pose, [True, False, False])
        assert sol.is_pose.shape == (3,) and solve(batch.reshape(3, 1, 4, 4)).is_pose.shape == (3, 1)


def test_a_report_of_verification_reads_as_one_line():
    report = ikjax.VerifyReport("puma560", "ortho_parallel_wrist", "float64", 1000, 999, 0, 0, 1, 100, 2e-15)
    assert str(report) == (
        "puma560 (ortho_parallel_wrist, float64): 1,000 goals, 100 more at right angles: "
        "wrong 0, none 0, missing 1; worst error 2e-15"
    )
