"""Every family over its whole class: what made the goal is found, and what is found is right."""

import functools

import arm_patterns
import arms
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import ikjax

TYPES = (np.float64, np.float32)
FAMILY = {
    "wrist": "pieper",
    "point": "position",
    "SCARA": "scara",
    "turret": "turret",
    "five axes": "five_axis",
    "wrist first": "pieper_reversed",
    "offset wrist, reversed": "offset_wrist_reversed",
    "offset wrist": "offset_wrist",
    "skew wrist": "pieper",
}


def family(name: str) -> str:
    for part in (
        "wrist first",
        "skew wrist",
        "offset wrist, reversed",
        "offset wrist",
        "SCARA",
        "turret",
        "five axes",
    ):
        if part in name:
            return FAMILY[part]
    if "parallel" in name and "," in name and name[0] in "1234":
        return "parallel_axes"
    if name.endswith(("wrist", "point")):
        return FAMILY[name[-5:]]
    return "planar_position" if len(arm_patterns.TABLE[name]["kinds"]) == 2 else "planar_pose"


def _promised(arm, goals, dtype):
    """How far a valid slot may be off: what `valid` promises, and the rounding of its joints."""
    tolerance = arms.TOLERANCE[np.dtype(dtype).name] + 40 * np.finfo(dtype).eps
    return tolerance, tolerance * (arms.reach(arm) + np.linalg.norm(goals[..., :3, 3], axis=-1))[:, None]


def _wrong(arm, sol, goals, dtype):
    rounded = goals.astype(dtype).astype(float)
    gap, turn = arm_patterns.errors(arm, sol.q, rounded[:, None])
    angle, length = _promised(arm, rounded, dtype)
    # Slides may be long: their rounding counts over what they span.
    spread = 8 * np.finfo(dtype).eps * np.abs(sol.q).max(-1)
    return sol.valid & ((gap > length + spread) | (turn > angle))


@pytest.mark.parametrize("name", arm_patterns.NAMES)
def test_the_family_is_recognized(name):
    arm = arm_patterns.build(name)
    assert arm.family == family(name)
    assert len(set(arm.branches)) == len(arm.branches) >= 1
    assert "NO" not in ikjax.explain(arm)


LONGEST = ("offset wrist", "offset wrist, shared", "offset wrist, reversed")
"""Compiled for more than 20 s."""

SOLVED = [
    pytest.param(name, marks=pytest.mark.slow if name in LONGEST else ()) for name in arm_patterns.NAMES
]

PARTS = {"random": slice(0, 384), "right": slice(384, 448), "far": slice(448, 512)}


@functools.cache
def _solved(name, dtype=np.float64):
    """An arm, the joints, goals and slots of random joints, of right angles, and of goals out of reach."""
    arm = arm_patterns.build(name)
    rng = np.random.default_rng(7)
    turning = np.array([kind == "R" for kind in arm.kinds])
    quarter = rng.integers(-1, 3, (64, arm.n)) * np.pi / 2
    right = np.where(turning, quarter - arms.leaves(arm)["theta"], rng.integers(-1, 2, (64, arm.n)) * 0.2)
    q = np.concatenate([arm_patterns.joints(arm, 384), right, arm_patterns.joints(arm, 64, seed=5)])
    goals = arms.numpy_fk(arm, q)
    far = goals[PARTS["far"]]
    far[:, :3, 3] += 20 * arms.reach(arm) * far[:, :3, 0]
    if arm.task.startswith("planar"):
        far[:, :3, 3] = arms.leaves(arm)["base"][:3, 3] + 20 * arms.leaves(arm)["base"][:3, 0]
    return arm, q, goals, arms.solve_by_hand(arm, goals, dtype=dtype)


def _part(part, name, dtype=np.float64):
    arm, q, goals, sol = _solved(name, dtype)
    rows = PARTS[part]
    return arm, q[rows], goals[rows], ikjax.Solutions(**{k: v[rows] for k, v in vars(sol).items()})


@pytest.mark.parametrize("dtype", TYPES)
@pytest.mark.parametrize("name", SOLVED)
def test_the_joints_that_made_the_goal_are_found_and_nothing_is_wrong(name, dtype):
    arm, q, goals, sol = _part("random", name, dtype)
    assert sol.q.shape == (384, len(arm.branches), arm.n)
    assert not _wrong(arm, sol, goals, dtype).any()
    off = np.abs(sol.q - q[:, None])
    off = np.where([kind == "R" for kind in arm.kinds], np.abs(arms.wrapped(off)), off).max(-1)
    near = np.where(sol.valid, off, np.inf).min(-1)
    least = arm_patterns.sigma_min(arm, q)
    if dtype == np.float64:
        assert sol.valid.any(-1).all()
        # The pose is right to the tolerance, and joints to that over the least singular value.
        assert (near[least > 1e-4] <= np.minimum(1e-8 / least, 1e-3)[least > 1e-4]).all()
    else:
        assert sol.valid.any(-1).mean() > 0.985
        assert (near[least >= np.median(least)] < 0.02).mean() > 0.98


@pytest.mark.parametrize("dtype", TYPES)
@pytest.mark.parametrize("name", SOLVED)
def test_everything_is_finite_and_joints_at_right_angles_are_not_answered_wrongly(name, dtype):
    arm, _, goals, sol = _part("right", name, dtype)
    assert not _wrong(arm, sol, goals, dtype).any()
    *_, whole = _solved(name, dtype)
    for field in ("q", "margin", "position_error", "rotation_error"):
        assert np.isfinite(getattr(whole, field)).all(), field


COMPILED = ("RRR, wrist", "2, 3, 4 parallel", "3R")


@pytest.mark.parametrize("name", COMPILED)
@pytest.mark.slow
def test_the_front_door_masks_and_joints_agree(name):
    arm = arm_patterns.build(name)
    q = arm_patterns.joints(arm, 200, seed=1)
    goals = arms.numpy_fk(arm, q)
    eager = ikjax.solve(arm, goals)
    assert eager.valid.any(-1).all()
    assert not _wrong(arm, jax.tree.map(np.asarray, eager), goals, np.float64).any()
    traced = jax.jit(lambda T: vars(ikjax.solve(arm, T)))(jnp.asarray(goals))
    sol = ikjax.Solutions(**{k: np.asarray(v) for k, v in traced.items()})
    assert sol.valid.any(-1).all()
    assert not _wrong(arm, sol, goals, np.float64).any()


@pytest.mark.parametrize("name", ("RRR, point", "3R", "2R"))
def test_what_the_task_leaves_out_is_not_looked_at(name):
    arm = arm_patterns.build(name)
    q = arm_patterns.joints(arm, 20)
    goals = arms.numpy_fk(arm, q)
    sol = arms.solve_by_hand(arm, goals)
    changed = goals.copy()
    turn = arms.numpy_pose([0, 0, 0], [0.3, -0.2, 0.4])[:3, :3]
    if arm.task == "planar_pose":
        changed[:, :3, 3] += 0.3 * arm_patterns.plane_normal(arm)
    else:
        changed[:, :3, :3] = turn @ goals[:, :3, :3]
    again = arms.solve_by_hand(arm, changed)
    np.testing.assert_array_equal(sol.valid, again.valid)
    np.testing.assert_allclose(sol.q, again.q, atol=1e-9)


# A generic table, and what has to be changed in it for each decomposition that EAIK 1.2.2 reports.
GENERIC = {
    "a": [0.10, 0.35, 0.08, 0.06, 0.05, 0],
    "alpha": [0.7, -1.1, 0.9, 1.2, -1.0, 0],
    "d": [0.40, 0.12, 0.05, 0.38, 0.07, 0.10],
}
AFTER, BEFORE = {"a4": 0, "a5": 0, "d5": 0}, {"a1": 0, "a2": 0, "d2": 0}
DECOMPOSITIONS = {
    "wrist": AFTER,
    "wrist, 1 meets 2": AFTER | {"a1": 0},
    "wrist, 2 meets 3": AFTER | {"a2": 0},
    "wrist, 1 parallel to 2": AFTER | {"alpha1": 0},
    "wrist, 2 parallel to 3": AFTER | {"alpha2": 0},
    "wrist, 1 meets 2, 2 parallel to 3": AFTER | {"a1": 0, "alpha2": 0},
    "wrist, 1 meets 2, 2 meets 3": AFTER | {"a1": 0, "a2": 0},
    "wrist first": BEFORE,
    "wrist first, 5 meets 6": BEFORE | {"a5": 0},
    "wrist first, 4 meets 5": BEFORE | {"a4": 0},
    "wrist first, 5 parallel to 6": BEFORE | {"alpha5": 0},
    "wrist first, 4 parallel to 5": BEFORE | {"alpha4": 0},
    "1, 2, 3 parallel, 5 meets 6": {"alpha1": 0, "alpha2": 0, "a5": 0},
    "2, 3, 4 parallel": {"alpha2": 0, "alpha3": 0},
    "2, 3, 4 parallel, 5 meets 6": {"alpha2": 0, "alpha3": 0, "a5": 0},
    "3, 4, 5 parallel": {"alpha3": 0, "alpha4": 0},
    "4, 5, 6 parallel, 1 meets 2": {"alpha4": 0, "alpha5": 0, "a1": 0},
}


def _decomposed(name) -> ikjax.Arm:
    table = {key: np.array(column, float) for key, column in GENERIC.items()}
    for entry, value in DECOMPOSITIONS[name].items():
        table[entry[:-1]][int(entry[-1]) - 1] = value
    return ikjax.Arm.from_dh(**table, convention="standard", name=name)


@pytest.mark.parametrize("name", DECOMPOSITIONS)
def test_every_arm_that_eaik_decomposes_is_solved(name):
    arm = _decomposed(name)
    q = arm_patterns.joints(arm, 200)
    sol = arms.solve_by_hand(arm, arms.numpy_fk(arm, q))
    assert sol.valid.any(-1).all()
    near = np.where(sol.valid, np.abs(arms.wrapped(sol.q - q[:, None])).max(-1), np.inf).min(-1)
    assert (near[arm_patterns.sigma_min(arm, q) > 1e-4] < 1e-4).all()


@pytest.mark.parametrize("name", DECOMPOSITIONS)
def test_eaik_finds_the_same_set(name):
    eaik = pytest.importorskip("eaik.IK_DH")
    arm = _decomposed(name)
    p = arms.leaves(arm)
    robot = eaik.DhRobot(p["alpha"], p["a"], p["d"])
    assert robot.hasKnownDecomposition()
    q = arm_patterns.joints(arm, 100, seed=3)
    goals = arms.numpy_fk(arm, q)
    sol = arms.solve_by_hand(arm, goals)
    compared = 0
    for i, goal in enumerate(goals):
        theirs = np.atleast_2d(np.asarray(robot.IK(goal).Q, float))
        # Their rows are judged by forward kinematics, because some exact ones are marked least squares.
        exact = np.abs(arms.numpy_fk(arm, theirs) - goal).max((-1, -2)) < 1e-6
        theirs, ours = theirs[exact], sol.q[i][sol.valid[i]]
        if arm_patterns.sigma_min(arm, np.concatenate([ours, theirs])).min() < 1e-3:
            continue  # near a fold a double answer may be counted once or twice
        off = np.abs(arms.wrapped(ours[:, None] - theirs[None])).max(-1)
        assert off.min(1).max() < 1e-4, f"goal {i}: a slot that they do not have"
        assert off.min(0).max() < 1e-4, f"goal {i}: an answer of theirs that is no slot"
        compared += 1
    assert compared >= 5


QUARTICS = ("RRR, point", "RRR square, point", "RRR 2 and 3 parallel, point", "RRP, point")


@pytest.mark.parametrize("name", QUARTICS)
def test_whether_the_quartic_rises_is_the_sign_of_the_regional_determinant(name):
    arm = arm_patterns.build(name)
    q = arm_patterns.joints(arm, 500)
    sol = arms.solve_by_hand(arm, arms.numpy_fk(arm, q))
    determinant = np.linalg.det(arms.numpy_jacobian(arm, sol.q)[..., :3, :])
    clear = sol.valid & (np.abs(determinant) > 1e-4)
    signs = np.sign(determinant) * [1, -1, 1, -1]
    assert clear.sum() > 500 and len(set(signs[clear])) == 1


def _regular(arm, sol):
    """Goals that are regular in every valid slot."""
    least = np.where(sol.valid, arm_patterns.sigma_min(arm, sol.q), np.inf).min(-1)
    return least > np.median(least) / 2


@pytest.mark.parametrize("name", SOLVED)
def test_no_answer_is_given_twice(name):
    arm, _, _, sol = _part("random", name)
    turning = [kind == "R" for kind in arm.kinds]
    off = sol.q[:, :, None] - sol.q[:, None]
    off = np.where(turning, np.abs(arms.wrapped(off)), np.abs(off)).max(-1)
    both = sol.valid[:, :, None] & sol.valid[:, None] & ~np.eye(len(arm.branches), dtype=bool)
    assert np.where(both, off, np.inf)[_regular(arm, sol)].min(initial=np.inf) > 1e-5


@pytest.mark.parametrize("name", SOLVED)
def test_margin_is_positive_where_a_slot_is_valid_and_negative_out_of_reach(name):
    arm, _, _, sol = _part("random", name)
    assert (sol.margin[sol.valid & _regular(arm, sol)[:, None]] > 0).all()
    *_, far = _part("far", name)
    if "P" not in arm.kinds:  # a slide reaches anywhere along itself
        assert not far.valid.any() and (far.margin.max(-1) < 0).all()


def _slow(*names):
    return [pytest.param(name, marks=pytest.mark.slow) for name in names]


@pytest.mark.parametrize(
    "name",
    [
        "RRR, wrist",
        *_slow("RRP, point", "RPR, wrist", "wrist first, RRRRRR", "3, 4, 5 parallel"),
    ],
)
def test_margin_of_a_quartic_is_the_distance_from_its_fold(name):
    # The gradient of a distance has norm one.
    arm = arm_patterns.build(name)
    goals, reach = arm_patterns.arms.numpy_fk(arm, arm_patterns.joints(arm, 1000)), arms.reach(arm)
    goals[:, :3, 3] *= np.linspace(0.7, 1.6, 1000)[:, None]

    def margins(k, by):
        moved = goals.copy()
        moved[:, k, 3] += by * reach
        return np.asarray(arms.solve_by_hand(arm, moved).margin)

    gradient_norm = np.linalg.norm(
        [(margins(k, 1e-6) - margins(k, -1e-6)) / (2e-6 * reach) for k in range(3)], axis=0
    )
    margin = margins(0, 0.0) / reach
    for near in ((margin > 0) & (margin < 3e-3), (margin < 0) & (margin > -3e-3)):
        assert near.sum() > 20
        assert 0.9 < np.median(gradient_norm[near]) < 1.15


@pytest.mark.parametrize("name", ["RRR meet, wrist", "RRP meet, point", "RRR square, point"])
def test_joint_1_follows_q_now_where_it_is_arbitrary(name):
    arm = arm_patterns.build(name)
    q = arm_patterns.joints(arm, 1)[0]
    every_frame = arms.numpy_fk(arm, q, frames=True)
    base = every_frame[0]
    goals = arms.numpy_fk(arm, q)[None]
    center = every_frame[4] if arm.n == 6 else goals[0]
    # The point that joint 1 turns is moved onto its axis, and the goal with it.
    shift = base[:3, :3] @ np.diag([1, 1, 0]) @ base[:3, :3].T @ (base[:3, 3] - center[:3, 3])
    goals[0, :3, 3] += shift
    now = np.full(arm.n, 0.3)
    sol = arms.solve_by_hand(arm, goals, now[None])
    assert not (sol.valid & ~sol.continuum).any()
    np.testing.assert_allclose(sol.q[sol.valid][:, 0], 0.3, atol=1e-9)


@pytest.mark.parametrize(
    "name", ["2R", "2R, second reversed", "3R", "3R, second reversed", "SCARA RRPR", "turret"]
)
def test_left_and_right_are_sides_of_the_line_from_first_joint_to_last(name):
    arm, _, _, sol = _part("random", name)
    turning = [i for i, kind in enumerate(arm.kinds) if kind == "R"]
    turning = turning[1:] if arm.family == "turret" else turning
    frames = arms.numpy_fk(arm, sol.q, frames=True)
    ends = [frames[..., i, :3, 3] for i in turning]
    last = ends[2] if len(ends) > 2 else arms.numpy_fk(arm, sol.q)[..., :3, 3]
    up = frames[..., turning[0], :3, 2]
    side = np.einsum("...i,...i->...", np.cross(last - ends[0], ends[1] - ends[0]), up)
    assert (side[:, 0] > 0)[sol.valid[:, 0]].all() and (side[:, 1] < 0)[sol.valid[:, 1]].all()


COMMON = {
    "position": {"a": [0.05, 0.5, 0.4], "alpha": [-90, 0, 0], "d": [0.4, 0, 0]},
    "pieper": {
        "a": [0.05, 0.5, 0, 0, 0, 0],
        "alpha": [-80, 0, -90, 90, -90, 0],
        "d": [0.4, 0, 0, 0.4, 0, 0.08],
    },
}


@pytest.mark.slow
@pytest.mark.parametrize("family", COMMON)
def test_an_arm_with_parallel_axes_and_no_offsets_is_answered(family):
    """The equation for joint 3 is the same for its negative; of its other two roots many are complex."""
    table = {**COMMON[family], "alpha": np.deg2rad(COMMON[family]["alpha"])}
    arm = ikjax.Arm.from_dh(**table, convention="standard")
    assert arm.family == family
    q = np.random.default_rng(0).uniform(-3, 3, (4000, arm.n))
    goals = ikjax.fk(arm, q)
    assert np.asarray(ikjax.solve(arm, goals).valid).any(-1).all()
    # float32 misses what rounding hides near singularities.
    rough = ikjax.solve(arm.astype(np.float32), np.asarray(goals, np.float32))
    assert (~np.asarray(rough.valid).any(-1)).sum() <= 12


RIGHT_ANGLES = {
    "stretched beside axis 1": ([0, 0.3, 0.3, 0, 0, 0], [90, -90, 30, -90, -90, 0], [0.4, 0, 0, 0, 0, 0.1]),
    "slanted": ([0, 0.3, 0.3, 0, 0, 0], [30, 30, 180, 90, -90, 90], [0, 0, 0, 0, 0, 0.1]),
    "axis 4 along axis 1": (
        [0.1, 0.3, 0.2, 0.4, 0.3, 0.1],
        [90, -90, 90, 0, 0, 90],
        [0.2, 0.1, 0.15, 0.1, 0, 0.1],
    ),
    "4, 5, 6 parallel": ([0, 0.3, 0, 0.4, 0.3, 0.1], [30, -90, 90, 0, 0, 90], [0.2, 0, 0.15, 0.1, 0, 0.1]),
}


@pytest.mark.parametrize("name", RIGHT_ANGLES)
def test_special_arms_at_right_angles_are_answered(name):
    """Two singularities at once: a step that needs a regular Jacobian, or joint 2 at zero, has no answer."""
    a, alpha, d = RIGHT_ANGLES[name]
    arm = ikjax.Arm.from_dh(a=a, alpha=np.deg2rad(alpha), d=d, convention="standard")
    q = np.random.default_rng(0).integers(-1, 3, (4096, 6)) * np.pi / 2
    goals = np.asarray(ikjax.fk(arm, q))
    sol = ikjax.solve(arm, goals)
    assert np.asarray(sol.valid).any(-1).all()
    assert not _wrong(arm, sol, goals, np.float64).any()
    if name != "axis 4 along axis 1":
        return
    # Beside them too: a joint is known to rounding over the sine of an angle, and the elbow is straight.
    rng = np.random.default_rng(9)
    q = rng.integers(-1, 3, q.shape) * np.pi / 2 + 10 ** rng.uniform(-12, -3, q.shape)
    assert np.asarray(ikjax.solve(arm, ikjax.fk(arm, q)).valid).any(-1).all()


BESIDE_AXIS_2 = {
    "axes 1 and 2 parallel": ([0.25, 0.3, 0.2, 0.4, 0.3, 0.1], [0, 90, 90, 0, 0, 30]),
    "no special relation": ([0.1, 0.3, 0.2, 0.4, 0.3, 0.1], [90, -90, 90, 0, 0, 90]),
}


@pytest.mark.parametrize("name", BESIDE_AXIS_2)
def test_three_parallel_axes_nearly_along_the_joint_before_them_are_answered(name):
    """There the angle between them by its cosine has lost half its digits, and its derivatives are zero."""
    a, alpha = BESIDE_AXIS_2[name]
    arm = ikjax.Arm.from_dh(
        a=a, alpha=np.deg2rad(alpha), d=[0.2, 0.1, 0.15, 0.1, 0, 0.1], convention="standard"
    )
    assert arm.family == "parallel_axes"
    rng = np.random.default_rng(0)
    step = np.repeat(10.0 ** np.arange(-11.0, 0), 372)
    q = rng.uniform(-np.pi, np.pi, (len(step), 6))
    q[:, 2] = np.pi * rng.integers(0, 2, len(step)) + step
    sol = ikjax.solve(arm, ikjax.fk(arm, q))
    valid = np.asarray(sol.valid)
    # Joint 2 is known to rounding over the step. Where the arm is stretched as far as that, a fold may hide.
    assert (~valid.any(-1)).sum() <= 2
    off = np.abs((np.asarray(sol.q) - q[:, None] + np.pi) % (2 * np.pi) - np.pi).max(-1)
    found = (valid & (off < 1e-3)).any(-1)
    assert found[step >= 1e-7].all()
