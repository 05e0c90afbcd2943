"""The edges: singular alone and together, exactly on the fold, one ulp beside it, and the gradients there."""

import functools
import itertools

import arms
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import ikjax

TYPES = (np.float64, np.float32)
LADDER = np.array([0.0, *(s * 10.0**-k for k in range(1, 17) for s in (1, -1))])
KINDS = [kind for kind in itertools.product((0, 1), repeat=3) if any(kind)]
PER_STEP = 16


def wrist_center(arm, q):
    """The point that joint 1 has to bring into the arm's plane, seen from axis 1's frame: (..., 3)."""
    every = arms.numpy_fk(arm, q, frames=True)
    point = every[..., 4 if arm.family == "ortho_parallel_wrist" else 5, :3, 3]
    base = arms.leaves(arm)["base"]
    return (point - base[:3, 3]) @ base[:3, :3]


def straight_elbow(arm) -> float:
    """Value of joint 3 at which shoulder, elbow and wrist (or axis 4) are in line."""
    p = arms.leaves(arm)
    if arm.family == "three_parallel":
        return -p["theta"][2]
    side = np.cos(p["alpha"][1])
    ahead, aside = p["a"][2], -side * p["d"][3] * np.sin(p["alpha"][2])
    return -side * np.arctan2(aside, ahead) - p["theta"][2]


def onto_shoulder(arm, q):
    """q with joint 2 changed so that the wrist comes as near axis 1 as its offset lets it, where it can."""
    p = arms.leaves(arm)
    every = arms.numpy_fk(arm, q, frames=True)
    point = every[..., 4 if arm.family == "ortho_parallel_wrist" else 5, :3, 3]
    frame = every[..., 1, :, :]
    x, y, _ = np.moveaxis(np.einsum("...ji,...j->...i", frame[..., :3, :3], point - frame[..., :3, 3]), -1, 0)
    span = np.hypot(x, y)
    able = span >= abs(p["a"][0])
    cosine = np.where(able, -p["a"][0] / np.where(able, span, 1), 0)
    turn = np.arccos(cosine) - np.arctan2(y, x)
    q = q.copy()
    q[..., 1] += np.where(able, turn, 0)
    return q


def singular(arm, kind) -> np.ndarray:
    """Joints on every step of the ladder away from the singularities asked for, (steps, 6)."""
    wrist, elbow, shoulder = kind
    theta = arms.leaves(arm)["theta"]
    rng = np.random.default_rng(sum(4**i * k for i, k in enumerate(kind)))
    step = np.repeat(LADDER, PER_STEP)
    q = rng.uniform(-np.pi, np.pi, (len(step), 6))
    half = np.pi * rng.integers(0, 2, (2, len(step)))
    # The two that come together do not come at the same pace.
    other = rng.permutation(step)
    if elbow:
        q[:, 2] = straight_elbow(arm) + half[0] + step
    if wrist:
        q[:, 4] = half[1] - theta[4] + (other if elbow else step)
    if shoulder:
        q = onto_shoulder(arm, q)
        q[:, 1] += step
    return q


def _assert_answered(arm, q, dtype):
    goals = arms.numpy_fk(arm, q)
    sol = arms.solve_by_hand(arm, goals, dtype=dtype)
    for field in ("q", "margin", "position_error", "rotation_error"):
        assert np.isfinite(getattr(sol, field)).all(), field
    top = np.asarray(np.pi, dtype)
    assert ((sol.q > -top) & (sol.q <= top)).all()
    assert not arms.wrong(arm, sol, goals, dtype).any()
    lost = ~sol.valid.any(-1)
    assert not lost.any(), (
        f"{lost.sum()} of {len(q)} reachable goals have no answer, the first of q = {q[lost][0].tolist()}: "
        f"margin {sol.margin[lost][0].max():.3g}, off by {sol.position_error[lost][0].min():.3g} m, "
        f"{sol.rotation_error[lost][0].min():.3g} rad"
    )
    return sol


@functools.cache
def ladders(name) -> np.ndarray:
    """Joints on the ladders to every singularity, alone and together."""
    return np.concatenate([singular(arms.build(name), kind) for kind in KINDS])


@pytest.mark.parametrize("dtype", TYPES)
@pytest.mark.parametrize("name", arms.DISTINCT)
def test_every_singular_goal_has_an_answer(name, dtype):
    _assert_answered(arms.build(name), ladders(name), dtype)


@pytest.mark.parametrize(
    ("name", "dtype"),
    [
        ("ur5", np.float32),
        pytest.param("skew_wrist", np.float64, marks=pytest.mark.slow),
        pytest.param("ur5", np.float64, marks=pytest.mark.slow),
        pytest.param("skew_wrist", np.float32, marks=pytest.mark.slow),
        *(pytest.param("parallel_every_offset", dtype, marks=pytest.mark.long) for dtype in TYPES),
    ],
)
def test_masks_of_a_jit_hold_for_the_joints_beside_them(name, dtype):
    """There the two come from two programs: see `ik.inline`."""
    arm = arms.build(name)
    goals = arms.numpy_fk(arm, ladders(name)).astype(dtype)
    solve = jax.jit(lambda T: vars(ikjax.solve(arm.astype(dtype), T)))
    sol = ikjax.Solutions(**{k: np.asarray(v) for k, v in solve(jnp.asarray(goals)).items()})
    assert not arms.wrong(arm, sol, goals, dtype).any()
    assert sol.valid.any(-1).all()


def right_angles(arm) -> np.ndarray:
    """All 4^6 configurations whose DH angles are multiples of a right angle."""
    grid = np.array(list(itertools.product(np.arange(-1, 3) * np.pi / 2, repeat=6)))
    return grid - arms.leaves(arm)["theta"]


@pytest.mark.parametrize("dtype", TYPES)
@pytest.mark.parametrize("name", arms.DISTINCT)
def test_joints_at_right_angles_have_an_answer(name, dtype):
    arm = arms.build(name)
    _assert_answered(arm, right_angles(arm), dtype)


@pytest.mark.parametrize("dtype", TYPES)
@pytest.mark.parametrize("name", ["puma560", "ur5"])
def test_joints_at_right_angles_have_an_answer_from_the_front_door(name, dtype):
    arm = arms.build(name)
    goals = arms.numpy_fk(arm, right_angles(arm))
    sol = arms.solve(arm, goals, dtype=dtype)
    assert sol.valid.any(-1).all()
    assert np.isfinite(sol.q).all()
    assert not arms.wrong(arm, sol, goals, dtype).any()


NOW = np.array([0.3, -0.4, 0.5, 0.7, -0.6, 0.2])


def _at_now(arm, dtype, joint, shown, changes):
    """Slots of a goal made by joints that agree with NOW nowhere but where the slots may look."""
    q = np.tile([1.1, -0.9, 1.3, -0.4, 0.8, 2.0], (8, 1)) + np.linspace(-0.2, 0.2, 8)[:, None]
    for i, value in changes.items():
        q[:, i] = value
    sol = arms.solve_by_hand(arm, arms.numpy_fk(arm, q), np.tile(NOW, (8, 1)), dtype)
    free = sol.valid & sol.continuum
    assert free.any(-1).all()
    off = np.abs(arms.wrapped(shown(sol.q) - shown(NOW)))[free]
    assert off.max() < (1e-12 if dtype == np.float64 else 1e-5), f"joint {joint} does not follow q_now"


@pytest.mark.parametrize("dtype", TYPES)
class TestContinuum:
    def test_a_straight_wrist_leaves_joint_4_where_it_is(self, dtype):
        _at_now(arms.build("puma560"), dtype, 4, lambda q: q[..., 3], {4: 0.0})

    def test_parallel_axes_2_and_6_leave_the_pitch_where_it_is(self, dtype):
        # The sum of joints 2, 3, 4 is what is arbitrary, as long as the triangle closes.
        arm = arms.build("ur5")
        q = np.tile([1.1, -0.9, 1.3, -0.4, 0.0, 2.0], (4, 1))
        sol = arms.solve_by_hand(arm, arms.numpy_fk(arm, q), np.tile(NOW, (4, 1)), dtype)
        pitch = arms.wrapped(sol.q[..., 1:4].sum(-1) - NOW[1:4].sum())
        mine = sol.valid & sol.continuum
        assert mine.any(-1).all()
        assert np.abs(pitch[mine]).max() < (1e-12 if dtype == np.float64 else 1e-5)

    def test_a_wrist_on_axis_1_leaves_joint_1_where_it_is(self, dtype):
        _at_now(arms.build("irb120"), dtype, 1, lambda q: q[..., 0], {1: 0.0, 2: -np.arctan2(0.302, 0.07)})

    def test_equal_links_folded_leave_joint_2_where_it_is(self, dtype):
        # The wrist is then on axis 1 too: joints 1 and 2 are both arbitrary.
        arm = arms.build("equal_links")
        _at_now(arm, dtype, 2, lambda q: q[..., :2], {2: straight_elbow(arm) + np.pi})

    def test_a_straight_elbow_is_singular_but_no_continuum(self, dtype):
        arm = arms.build("puma560")
        q = np.tile([1.1, -0.9, straight_elbow(arm), -0.4, 0.8, 2.0], (4, 1))
        sol = arms.solve_by_hand(arm, arms.numpy_fk(arm, q), dtype=dtype)
        assert sol.valid.any(-1).all()
        assert not sol.continuum.any()

    def test_a_straight_elbow_gives_the_same_answer_twice(self, dtype):
        arm = arms.build("puma560")
        q = np.tile([1.1, -0.9, straight_elbow(arm), -0.4, 0.8, 2.0], (4, 1))
        sol = arms.solve_by_hand(arm, arms.numpy_fk(arm, q), dtype=dtype)
        near = np.abs(arms.wrapped(sol.q - q[:, None])).max(-1) < 100 * np.sqrt(np.finfo(dtype).eps)
        assert (near & sol.valid).sum(-1).tolist() == [2] * 4

    def test_a_wrist_on_axis_1_is_out_of_reach_with_a_lateral_offset(self, dtype):
        arm = arms.build("puma560")
        goal = np.eye(4)
        goal[:3, 3] = 0, 0, 0.5
        sol = arms.solve_by_hand(arm, goal[None], dtype=dtype)
        assert not sol.valid.any()
        np.testing.assert_allclose(sol.margin, -0.15005, rtol=1e-5)


FOLDS = {"stretched": "puma560", "beside axis 1": "puma560", "folded": "irb2400"}


def _through(fold):
    """An arm, and goals whose wrist crosses one of its folds, by how far it is inside [m]."""
    arm = arms.build(FOLDS[fold])
    p = arms.leaves(arm)
    upper, fore, side = p["a"][1], np.hypot(p["a"][2], p["d"][3]), p["d"][2]
    steps = np.concatenate([-(10.0 ** np.arange(-1, -17, -1.0)), [0.0], 10.0 ** np.arange(-16, 0.0)])
    if fold == "folded":
        steps = steps[steps > -0.05]  # the hole is 0.06 m wide
    goals = np.tile(np.eye(4), (len(steps), 1, 1))
    goals[:, :3, :3] = arms.numpy_pose([0, 0, 0], [0.3, -0.5, 0.9])[:3, :3]
    if fold == "stretched":
        goals[:, 0, 3], goals[:, 1, 3] = upper + fore - steps, side
    elif fold == "beside axis 1":
        goals[:, 0, 3], goals[:, 2, 3] = side + steps, 0.5
    else:
        goals[:, 0, 3], goals[:, 2, 3] = p["a"][0] + abs(upper - fore) + steps, p["d"][0]
        goals[:, :3, 3] += p["d"][5] * goals[:, :3, 2]
    return arm, steps, goals


@pytest.mark.parametrize("dtype", TYPES)
@pytest.mark.parametrize("fold", FOLDS)
class TestFold:
    def test_margin_is_monotone_and_zero_on_the_fold(self, fold, dtype):
        arm, steps, goals = _through(fold)
        # Behind itself, the arm with a1 is further from that fold.
        margin = arms.solve_by_hand(arm, goals, dtype=dtype).margin[:, ::2].max(-1).astype(float)
        noise = 8 * np.finfo(dtype).eps
        assert (np.diff(margin) >= -noise).all()
        small = np.abs(steps) < 0.01  # another fold is nearer further in
        np.testing.assert_allclose(margin[small], steps[small], rtol=1e-4, atol=noise)

    def test_valid_is_what_forward_kinematics_measures(self, fold, dtype):
        arm, steps, goals = _through(fold)
        sol = arms.solve_by_hand(arm, goals, dtype=dtype)
        gap, turn = arms.errors(arm, sol.q, goals[:, None].astype(dtype))
        tolerance = arms.TOLERANCE[np.dtype(dtype).name]
        size = arms.reach(arm) + np.linalg.norm(goals[:, :3, 3], axis=-1)[:, None]
        share = np.maximum(gap / size, turn) / tolerance
        assert sol.valid[share < 0.9].all()
        assert not sol.valid[share > 1.1].any()
        assert sol.valid[np.abs(steps) < tolerance / 2][:, ::2].any(-1).all()
        assert not sol.valid[steps < -4 * tolerance][:, ::2].any()

    def test_both_slots_are_there_on_the_fold(self, fold, dtype):
        arm, steps, goals = _through(fold)
        sol = arms.solve_by_hand(arm, goals[steps == 0], dtype=dtype)
        count = sol.valid.sum()
        assert count >= 4
        assert count % 2 == 0


@pytest.mark.parametrize("dtype", TYPES)
@pytest.mark.parametrize("name", arms.DISTINCT)
def test_margin_far_away_is_finite_and_negative(name, dtype):
    arm = arms.build(name)
    goals = np.tile(np.eye(4), (4, 1, 1))
    goals[:, 0, 3] = 1e2, 1e5, 1e30, np.finfo(dtype).max
    sol = arms.solve_by_hand(arm, goals, dtype=dtype)
    assert np.isfinite(sol.margin).all()
    assert (sol.margin < -10).all()
    assert not sol.valid.any()


GRADIENTS = {"ur5": np.float32}
"""Compiled in the slow form, in this type; the long form tries more arms, and both types."""

MORE_GRADIENTS = (*GRADIENTS, "puma560", "skew_everything", "equal_links", "parallel_every_offset")


def _edge_goals(arm) -> np.ndarray:
    q = np.concatenate([singular(arm, kind)[:: PER_STEP // 2] for kind in KINDS])
    outside = arms.numpy_fk(arm, q[:16])
    outside[:, :3, 3] *= np.linspace(1, 50, 16)[:, None]
    broken = arms.numpy_fk(arm, q[:4])
    broken[0, 0, 0], broken[1, 0, 3], broken[2, :3, :3], broken[3, :3, :3] = np.nan, np.inf, 0, -np.eye(3)
    on_axis = np.tile(arms.leaves(arm)["base"] @ arms.leaves(arm)["tool"], (4, 1, 1))
    square = arms.numpy_fk(arm, right_angles(arm)[::37])
    return np.concatenate([arms.numpy_fk(arm, q), square, outside, broken, on_axis])


@pytest.mark.parametrize(
    ("name", "dtype"),
    [
        pytest.param(
            name, dtype, marks=pytest.mark.slow if GRADIENTS.get(name) is dtype else pytest.mark.long
        )
        for name in MORE_GRADIENTS
        for dtype in TYPES
    ],
)
def test_gradients_are_finite_at_every_edge(name, dtype):
    arm = arms.build(name)
    goals = jnp.asarray(_edge_goals(arm), dtype)
    plain = arms.typed(arm, dtype)

    def total(goals):
        sol = ikjax.solve(plain, goals, jnp.zeros((*goals.shape[:-2], 6), goals.dtype))
        return sol.q.sum() + sol.margin.sum()

    gradient = np.asarray(jax.jit(jax.grad(total))(goals))
    bad = ~np.isfinite(gradient).all((1, 2))
    assert not bad.any(), f"{bad.sum()} rows, the first {np.asarray(goals)[bad][0].tolist()}"
