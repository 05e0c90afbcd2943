"""Every family over one table of arms: sound, complete, and slots that keep their meaning."""

import dataclasses
import itertools

import arms
import jax.numpy as jnp
import numpy as np
import oracle
import pytest

import ikjax

TYPES = (np.float64, np.float32)
COUNT = 500


@pytest.fixture(scope="module", params=arms.NAMES)
def case(request):
    """An arm, random joints, their goals, and the slots of each type."""
    arm = arms.build(request.param)
    q = arms.joints(request.param, COUNT)
    goals = arms.numpy_fk(arm, q)
    return arm, q, goals, {dtype: arms.solve_by_hand(arm, goals, dtype=dtype) for dtype in TYPES}


@pytest.mark.parametrize("dtype", TYPES)
class TestEveryArm:
    def test_a_valid_slot_closes(self, case, dtype):
        arm, _, goals, slots = case
        assert slots[dtype].valid.any()
        assert not arms.wrong(arm, slots[dtype], goals, dtype).any()

    def test_a_valid_slot_closes_at_60_digits(self, case, dtype):
        arm, _, goals, slots = case
        for i in range(3):
            goal = goals[i].astype(dtype)
            for q in slots[dtype].q[i][slots[dtype].valid[i]]:
                gap, turn = oracle.error(arm, q, goal)
                allowed = arms.TOLERANCE[np.dtype(dtype).name] + 40 * np.finfo(dtype).eps
                assert gap < allowed * (arms.reach(arm) + np.linalg.norm(goal[:3, 3])) and turn < allowed

    def test_the_joints_that_made_the_goal_are_among_the_slots(self, case, dtype):
        arm, q, _, slots = case
        lost = arms.missing(arm, slots[dtype], q, dtype)
        assert not lost.any(), q[lost][0].tolist()

    def test_the_errors_it_reports_are_those_it_has(self, case, dtype):
        arm, _, goals, slots = case
        gap, turn = arms.errors(arm, slots[dtype].q, goals[:, None].astype(dtype))
        noise = 200 * np.finfo(dtype).eps
        np.testing.assert_allclose(slots[dtype].position_error, gap, rtol=1e-3, atol=noise * arms.reach(arm))
        np.testing.assert_allclose(slots[dtype].rotation_error, turn, rtol=1e-2, atol=noise)

    def test_outputs_are_finite_and_angles_canonical(self, case, dtype):
        *_, slots = case
        top = np.asarray(np.pi, dtype)
        for field in ("q", "margin", "position_error", "rotation_error"):
            assert getattr(slots[dtype], field).dtype == dtype
            assert np.isfinite(getattr(slots[dtype], field)).all()
        assert ((slots[dtype].q > -top) & (slots[dtype].q <= top)).all()

    def test_valid_slots_differ(self, case, dtype):
        arm, _, _, slots = case
        q, valid = slots[dtype].q, slots[dtype].valid
        regular = np.where(valid, arms.sigma_min(arm, q), 1).min(-1) > 1e-2
        assert regular.sum() > 50
        off = np.abs(arms.wrapped(q[:, :, None] - q[:, None])).max(-1) + 9 * np.eye(8)
        off = np.where(valid[:, :, None] & valid[:, None], off, 9)
        assert off[regular].min() > 1e-3


def test_valid_slots_have_a_clearance_and_the_others_none(case):
    arm, _, _, slots = case
    sol = slots[np.float64]
    clear = np.abs(sol.margin) > 1e-8 * arms.reach(arm)
    np.testing.assert_array_equal(sol.valid[clear], (sol.margin > 0)[clear])


def test_float32_agrees_with_float64(case):
    arm, _, _, slots = case
    one, other = slots[np.float32], slots[np.float64]
    clear = (np.abs(other.margin) > 1e-4).all(-1)
    assert clear.sum() > COUNT / 2
    np.testing.assert_array_equal(one.valid[clear], other.valid[clear])
    least = arms.sigma_min(arm, other.q)
    regular = other.valid & (least > 1e-2) & clear[:, None]
    off = np.abs(arms.wrapped(one.q - other.q)).max(-1)
    assert (off[regular] < 20 * 64 * np.finfo(np.float32).eps / least[regular]).all()


LONG = pytest.mark.long


@pytest.mark.parametrize(
    ("name", "dtype"),
    [
        # Each is a program of its own: by default in one type.
        ("puma560", np.float32),
        *(
            pytest.param(*case, marks=pytest.mark.slow)
            for case in (
                ("puma560", np.float64),
                ("parallel_both_reversed", np.float64),
                ("ur5", np.float32),
                ("ur5", np.float64),
                ("skew_everything", np.float32),
            )
        ),
        pytest.param("skew_everything", np.float64, marks=LONG),
        pytest.param("parallel_both_reversed", np.float32, marks=LONG),
    ],
)
def test_the_front_door_agrees_with_the_plain_graph(name, dtype):
    arm = arms.build(name)
    goals = arms.numpy_fk(arm, arms.joints(name, 200))
    sol, wanted = arms.solve(arm, goals, dtype=dtype), arms.solve_by_hand(arm, goals, dtype=dtype)
    clear = (np.abs(wanted.margin) > 1e-4).all(-1)
    assert clear.sum() > 100
    np.testing.assert_array_equal(sol.valid[clear], wanted.valid[clear])
    least = arms.sigma_min(arm, wanted.q)
    regular = wanted.valid & (least > 1e-2) & clear[:, None]
    off = np.abs(arms.wrapped(sol.q - wanted.q)).max(-1)
    assert (off[regular] < 20 * 64 * np.finfo(dtype).eps / least[regular]).all()


def newton(arm, goal, starts) -> np.ndarray:
    """Every joint vector that damped Newton finds from many starts, unique up to whole turns."""
    q = starts.copy()
    size = arms.reach(arm)
    for _ in range(80):
        T = arms.numpy_fk(arm, q)
        slip = T[:, :3, :3].swapaxes(-1, -2)
        turn = goal[:3, :3] @ slip
        vee = np.stack(
            [turn[:, 2, 1] - turn[:, 1, 2], turn[:, 0, 2] - turn[:, 2, 0], turn[:, 1, 0] - turn[:, 0, 1]], -1
        )
        error = np.concatenate([(goal[:3, 3] - T[:, :3, 3]) / size, vee / 2], -1)
        J = arms.numpy_jacobian(arm, q)
        damping = 1e-2 * (error**2).sum(-1)[:, None, None] * np.eye(6)
        move = np.linalg.solve(
            J.swapaxes(-1, -2) @ J + damping + 1e-14 * np.eye(6), (J.swapaxes(-1, -2) @ error[..., None])
        )
        q = q + np.clip(move[..., 0], -0.7, 0.7)
    gap, angle = arms.errors(arm, q, goal)
    found = arms.wrapped(q[(gap < 1e-10 * size) & (angle < 1e-10)])
    unique: list[np.ndarray] = []
    for one in found:
        if all(np.abs(arms.wrapped(one - other)).max() > 1e-5 for other in unique):
            unique.append(one)
    return np.array(unique)


@pytest.mark.parametrize("name", ["puma560", "ur5", *arms.AWKWARD])
def test_no_solution_that_newton_finds_is_missing(name):
    arm = arms.build(name)
    q = arms.joints(name, 40, seed=7)
    goals = arms.numpy_fk(arm, q)
    sol = arms.solve_by_hand(arm, goals)
    regular = (np.abs(sol.margin) > 1e-3).all(-1) & (
        np.where(sol.valid, arms.sigma_min(arm, sol.q), 1).min(-1) > 1e-2
    )
    starts = np.random.default_rng(3).uniform(-np.pi, np.pi, (300, 6))
    total = 0
    for i in np.flatnonzero(regular)[:2]:
        found = newton(arm, goals[i], starts)
        slots = sol.q[i][sol.valid[i]]
        off = np.abs(arms.wrapped(found[:, None] - slots)).max(-1)
        assert (off.min(1) < 1e-6).all()
        total += len(found)
        assert len(found) <= sol.valid[i].sum()
    assert total >= 4


SIGNS = list(itertools.product((1, -1), repeat=5))
HALF = [signs for signs in SIGNS if np.prod(signs) == 1]
"""Any four of the signs come in every pattern."""


@pytest.mark.parametrize("some", [HALF, pytest.param(SIGNS, marks=pytest.mark.long)], ids=["half", "all"])
@pytest.mark.parametrize("family", ["ortho_parallel_wrist", "three_parallel"])
@pytest.mark.parametrize("up", [1, -1])
def test_every_pattern_of_signs_is_solved(family, up, some):
    """Twists and lengths of either sign, axes antiparallel, an arm that stands or hangs."""
    rng = np.random.default_rng(11)
    for signs in some:
        flat = [(1 - s) * 90 for s in signs]
        square = [s * 90 for s in signs]
        a = rng.uniform(0.05, 0.5, 6) * rng.choice([-1, 1], 6)
        d = rng.uniform(0.05, 0.5, 6) * rng.choice([-1, 1], 6)
        if family == "three_parallel":
            alpha = [square[0], flat[1], flat[2], square[3], square[4], 20]
            a[4] = 0
        else:
            alpha = [square[0], flat[1], square[2] * 0.8, square[3], square[4], 20]
            a[3] = a[4] = d[4] = 0
        arm = ikjax.Arm.from_dh(
            a=a,
            alpha=np.multiply(alpha, arms.DEG),
            d=d,
            theta=rng.uniform(-3, 3, 6),
            base=arms.BASE if up == 1 else arms.UPSIDE_DOWN,
            tool=arms.TOOL,
            convention="standard",
        )
        assert arm.family == family and arm.signs[0] == up
        q = rng.uniform(-np.pi, np.pi, (64, 6))
        goals = arms.numpy_fk(arm, q)
        sol = arms.solve_by_hand(arm, goals)
        assert not arms.wrong(arm, sol, goals, np.float64).any(), signs
        assert not arms.missing(arm, sol, q, np.float64).any(), signs


def reversed_joint(arm, i) -> ikjax.Arm:
    """The same mechanism with the direction of joint i turned round; all x axes stay."""
    p = {k: v.copy() for k, v in arms.leaves(arm).items()}
    p["theta"][i], p["d"][i] = -p["theta"][i], -p["d"][i]
    p["alpha"][i] += np.pi
    if i:
        p["alpha"][i - 1] += np.pi
    else:
        p["base"] = p["base"] @ np.diag([1.0, -1.0, -1.0, 1.0])
    if i == arm.n - 1:  # the last link's own twist turns the tool: turn it back
        p["alpha"][i] -= 2 * np.pi
    p["alpha"] = np.remainder(p["alpha"] + np.pi, 2 * np.pi) - np.pi
    return ikjax.Arm.from_dh(**p, convention="standard", name=f"{arm.name} with joint {i + 1} reversed")


CHANGED = ("every_offset", "skew_wrist", "kr6_r900", "ur5", "parallel_both_reversed")


@pytest.mark.parametrize(
    ("name", "joint"),
    [
        pytest.param(name, joint, marks=pytest.mark.slow if (i + joint) % 2 else ())
        for i, name in enumerate(CHANGED)
        for joint in range(6)
    ],
)
class TestSlotsKeepTheirMeaning:
    def _compare(self, arm, other, sign, shift):
        q = arms.joints(arm.name, 100, seed=9)
        goals = arms.numpy_fk(arm, q)
        np.testing.assert_allclose(arms.numpy_fk(other, sign * q - shift), goals, atol=1e-12)
        one, two = arms.solve_by_hand(arm, goals), arms.solve_by_hand(other, goals)
        clear = (np.abs(one.margin) > 1e-6).all(-1)
        np.testing.assert_array_equal(one.valid[clear], two.valid[clear])
        least = arms.sigma_min(arm, one.q)
        off = np.abs(arms.wrapped(sign * one.q - shift - two.q)).max(-1)
        both = one.valid & two.valid & (least > 1e-3)
        assert both.any()
        assert (off[both] < 1e-13 / least[both] + 1e-9).all()
        np.testing.assert_allclose(two.margin, one.margin, atol=1e-12)

    def test_when_a_joint_turns_the_other_way(self, name, joint):
        arm = arms.build(name)
        other = reversed_joint(arm, joint)
        assert other.family == arm.family
        self._compare(arm, other, np.where(np.arange(6) == joint, -1, 1), np.zeros(6))

    def test_when_a_joint_counts_from_elsewhere(self, name, joint):
        arm = arms.build(name)
        shift = np.where(np.arange(6) == joint, 1.3, 0)
        other = dataclasses.replace(arm, theta=arm.theta + jnp.asarray(shift))
        self._compare(arm, other, np.ones(6), shift)


def heading(arm, goals):
    """Unit vectors from axis 1 towards the wrist, level; PUMA's wrist is the tool point."""
    level = goals[:, :3, 3] * [1, 1, 0]
    return level / np.linalg.norm(level, axis=-1, keepdims=True)


@pytest.mark.parametrize("name", ["puma560", "irb120", "irb2400", "kr6_r900", "lrmate200id", "rx160"])
def test_names_say_where_the_arm_is(name):
    arm = arms.build(name)
    q = arms.joints(name, 300, seed=4)
    goals = arms.numpy_fk(arm, q)
    sol = arms.solve_by_hand(arm, goals)
    every = np.asarray(ikjax.frames(arm, sol.q))
    elbow, wrist = every[..., 2, :3, 3], every[..., 4, :3, 3]
    axis2 = every[..., 1, :3, 2]
    shoulder = every[..., 1, :3, 3]
    # The plane of the arm holds axis 1 and x1: how far along each of them things are.
    level = np.cross(axis2, [0, 0, 1.0])
    if arms.leaves(arm)["a"][0] != 0:
        stands = every[..., 1, :3, 3] * [1, 1, 0]
        side = np.sign((stands * wrist).sum(-1) - 0)
    else:
        x1 = every[..., 1, :3, 0]
        side = np.sign((x1 * wrist).sum(-1))
    line = wrist - shoulder
    line -= axis2 * (line * axis2).sum(-1, keepdims=True)
    bend = elbow - shoulder
    bend -= axis2 * (bend * axis2).sum(-1, keepdims=True)
    ahead = level * np.sign((level * line).sum(-1, keepdims=True))
    # Positive when the elbow is counterclockwise of the line, seen with the wrist ahead to the right.
    lift = np.cross(line, bend)
    lift = (lift * np.cross(ahead, [0, 0, 1.0])).sum(-1)
    assert arm.branches[0].startswith("front/up")
    checked = 0
    for slot, branch in enumerate(arm.branches):
        shoulder_word, elbow_word, _ = branch.split("/")
        valid = sol.valid[:, slot]
        wanted = 1 if shoulder_word == "front" else -1
        assert (side[valid, slot] == wanted).all(), branch
        # An arm that reaches over its own shoulder faces away: `up` is defined for one that faces its wrist.
        faces = valid & (np.abs((line * [0, 0, 1.0]).sum(-1))[:, slot] < 0.2)
        faces &= (np.sign((line * wrist * [1, 1, 0]).sum(-1)) > 0)[:, slot]
        above = np.sign(lift[faces, slot])
        assert (above == (1 if elbow_word == "up" else -1)).all(), branch
        checked += faces.sum()
    assert checked > 100


class TestRivals:
    def _sets_equal(self, arm, goal, slots, theirs):
        theirs = np.asarray(theirs, float)
        off = np.abs(arms.wrapped(slots[:, None] - theirs[None])).max(-1)
        assert off.min(1).max() < 1e-6, "a slot that they do not have"
        assert off.min(0).max() < 1e-6, "an answer of theirs that is no slot"

    @pytest.mark.parametrize("name", ["puma560", "ur5"])
    def test_eaik_finds_the_same_set(self, name):
        eaik = pytest.importorskip("eaik.IK_DH")
        arm = arms.build(name)
        p = arms.leaves(arm)
        robot = eaik.DhRobot(p["alpha"], p["a"], p["d"])
        goals = arms.numpy_fk(arm, arms.joints(name, 40, seed=21))
        sol = arms.solve_by_hand(arm, goals)
        for i in range(len(goals)):
            if np.abs(sol.margin[i]).min() < 1e-4:
                continue
            answer = robot.IK(goals[i])
            theirs = np.asarray(answer.Q)[~np.asarray(answer.is_LS)]
            self._sets_equal(arm, goals[i], sol.q[i][sol.valid[i]], theirs)
