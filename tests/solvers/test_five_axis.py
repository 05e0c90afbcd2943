"""Five joints: how many answers there are, goals out of reach, and the ladders to each singularity."""

import dataclasses
import functools
import itertools

import arm_patterns
import arms
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import ikjax
from ikjax.ik.inline import entries_of, slots_of

ROBOTS = {"motoman_l3": 4, "katana_6m180": 4, "vx300": 4, "so101": 2}
NAMES = tuple(name for name in arm_patterns.NAMES if name.startswith("five axes"))
QUARTER = np.pi / 2


def made(name, q):
    """An arm of the catalogue or the table, and goals made by joints on the arm as given."""
    arm = ikjax.robots.get(name) if name in ROBOTS else arm_patterns.build(name)
    return arm, np.array(ikjax.fk(arm, q))


def random_joints(count, seed=0):
    return np.random.default_rng(seed).uniform(-np.pi, np.pi, (count, 5))


@pytest.mark.parametrize("name", ROBOTS)
def test_a_goal_has_four_answers_and_two_with_a_lateral_offset(name):
    q = random_joints(100)
    arm, goals = made(name, q)
    sol = arms.solve_by_hand(arm, goals)
    assert (sol.valid.sum(-1) == ROBOTS[name]).all()
    near = np.where(sol.valid, np.abs(arms.wrapped(sol.q - q[:, None])).max(-1), np.inf).min(-1)
    assert near.max() < 1e-8
    assert np.where(sol.valid, sol.position_error, 0).max() < 1e-12


def test_the_roll_axis_along_the_first_gives_the_lateral_arm_four_answers():
    arm = arms.dh("mine", a=[0, 0.12, 0.13, 0, 0], alpha=[90, 0, 0, 90, 0], d=[0.1, 0, 0, 2e-4, 0.1])
    q = random_joints(50)
    q[:, 1:3] = [0.3, 0.5]
    q[:, 3] = -q[:, 1] - q[:, 2] + np.random.default_rng(1).integers(0, 2, 50) * np.pi
    goals = arms.numpy_fk(arm, q)
    assert np.abs(goals[:, 2, 2]).min() > 1 - 1e-12
    assert (arms.solve_by_hand(arm, goals).valid.sum(-1) == 4).all()
    q[:, 3] += 0.3
    assert (arms.solve_by_hand(arm, arms.numpy_fk(arm, q)).valid.sum(-1) == 2).all()


@pytest.mark.parametrize("name", [*NAMES, "so101"])
def test_a_goal_out_of_the_arms_five_dimensions_is_not_valid(name):
    arm, goals = made(name, random_joints(100))
    aside = arms.numpy_pose([0, 0, 0], [0.02, 0.03, -0.01])[:3, :3]
    # Turned further in place, about an axis that is not the last.
    goals[:, :3, :3] = goals[:, :3, :3] @ aside
    sol = arms.solve_by_hand(arm, goals)
    assert not sol.valid.any()
    assert np.isfinite(sol.q).all() and np.isfinite(sol.margin).all()


@pytest.mark.parametrize("name", NAMES)
def test_front_and_up_are_sides_that_can_be_seen(name):
    q = random_joints(200)
    arm, goals = made(name, q)
    sol = arms.solve_by_hand(arm, goals)
    frames = arms.numpy_fk(arm, sol.q, frames=True)
    seen = np.linalg.inv(frames[..., 1, :, :]) @ frames[..., 4, :, :]
    elbow = np.linalg.inv(frames[..., 1, :, :]) @ frames[..., 2, :, :]
    wrist = np.linalg.inv(frames[..., 1, :, :]) @ frames[..., 3, :, :]
    p = arms.leaves(arm)
    ahead = (seen[..., 0, 3] + p["a"][0]) * (1 if p["a"][0] >= 0 else -1)
    # Where the foot is near axis 1, the direction of axis 5 has more weight.
    clear = sol.valid & (np.abs(ahead) > 0.3)
    front = np.array([True, False, True, False])
    if p["alpha"][3] % np.pi == QUARTER and not p["d"][1:4].any():
        assert ((ahead > 0) == front)[clear].all()
    left = wrist[..., 0, 3] * elbow[..., 1, 3] - wrist[..., 1, 3] * elbow[..., 0, 3]
    # Left of the line, seen along axis 2, for an arm that faces its wrist; slots 2 and 3 are the other side.
    same = np.sign(left[:, :2]) == -np.sign(left[:, 2:])
    assert same[sol.valid[:, :2] & sol.valid[:, 2:]].all()


def on_the_ladder(arm, along, on_axis, elbow, seed):
    """Joints at a singularity, each moved by nothing or by 1e-1 to 1e-16.

    The foot of axis 5 beside axis 1, axis 5 along axis 1 (where both are square to axes 2 to 4), the elbow
    straight or folded, in any combination.
    """
    rng = np.random.default_rng(seed)
    p = arms.leaves(arm)
    q = rng.uniform(-np.pi, np.pi, (240, 5))
    if elbow is not None:
        q[:, 2] = elbow - p["theta"][2]
    signs = np.sign(np.cos(p["alpha"][1])), np.sign(np.cos(p["alpha"][1]) * np.cos(p["alpha"][2]))
    pitch = rng.integers(0, 2, 240) * np.pi

    def placed(second):
        joints = q.copy()
        joints[:, 1] = second
        if along:
            t = joints + p["theta"]
            joints[:, 3] = signs[1] * (pitch - t[:, 1] - signs[0] * t[:, 2]) - p["theta"][3]
        return joints

    def ahead(second):
        frames = arms.numpy_fk(arm, placed(second), frames=True)
        return (np.linalg.inv(frames[:, 1]) @ frames[:, 4])[:, 0, 3] + p["a"][0]

    if on_axis:
        grid = np.linspace(-np.pi, np.pi, 49)
        signs_there = np.sign([ahead(np.full(240, x)) for x in grid])
        changes = signs_there[1:] != signs_there[:-1]
        first, able = changes.argmax(0), changes.any(0)
        low, high, start = grid[first], grid[first + 1], signs_there[first, np.arange(240)]
        for _ in range(55):
            middle = (low + high) / 2
            before = np.sign(ahead(middle)) == start
            low, high = np.where(before, middle, low), np.where(before, high, middle)
        joints = placed(low)[able]
    else:
        joints = placed(q[:, 1])
    steps = 10.0 ** -rng.integers(1, 17, joints.shape) * rng.choice([-1, 0, 1], joints.shape)
    steps[: len(steps) // 4] = 0
    return joints + steps


SINGULAR = tuple(itertools.product((False, True), (False, True), (None, 0.0, np.pi)))


@functools.cache
def ladders(name):
    """Goals of all ladders to the singularities of an arm."""
    arm = arm_patterns.build(name)
    q = np.concatenate([on_the_ladder(arm, *how, seed) for seed, how in enumerate(SINGULAR)])
    return arms.numpy_fk(arm, q)


@pytest.mark.parametrize("name", NAMES)
def test_every_goal_on_the_ladders_to_the_singularities_is_answered(name, costly_dtype):
    arm, goals = arm_patterns.build(name), ladders(name)
    sol = arms.solve_by_hand(arm, goals, dtype=costly_dtype)
    for field in ("q", "margin", "position_error", "rotation_error"):
        assert np.isfinite(getattr(sol, field)).all(), field
    assert not arms.wrong(arm, sol, goals, costly_dtype).any()
    assert sol.valid.any(-1).all()


@pytest.mark.slow
def test_both_answers_beside_full_stretch_are_found_on_an_arm_whose_axes_are_not_quite_parallel():
    rng = np.random.default_rng(1)
    arm = ikjax.robots.so101()
    off = rng.uniform(-1, 1, (6, 6)) * np.repeat([1e-7, 4e-6], 3)
    arm = dataclasses.replace(arm, correction=jnp.asarray(off))
    q = random_joints(2000)
    near = 10 ** rng.uniform(-5, -1.5, 2000) * rng.choice([-1, 1], 2000)
    q[:, 2] = near + rng.integers(0, 2, 2000) * np.pi - arms.leaves(arm)["theta"][2]
    sol = arms.solve_by_hand(arm, np.array(ikjax.fk(arm, q)))
    assert sol.valid.any(-1).all()
    least = np.linalg.svd(arms.numpy_jacobian(arm, q), compute_uv=False)[:, -1]
    off = np.where(sol.valid, np.abs(arms.wrapped(sol.q - q[:, None])).max(-1), np.inf).min(-1)
    regular = least > 1e-6
    assert regular.sum() > 1500 and (off[regular] < 1e-8 / least[regular]).all()


def test_joint_1_follows_q_now_where_the_roll_axis_is_axis_1():
    arm = arm_patterns.build("five axes")
    q = np.array([[0.7, -QUARTER, 0.0, QUARTER, 0.4]])
    now = np.full((1, 5), 0.3)
    sol = arms.solve_by_hand(arm, arms.numpy_fk(arm, q), now)
    assert sol.valid.any() and sol.continuum[sol.valid].all()
    np.testing.assert_allclose(sol.q[sol.valid][:, 0], 0.3, atol=1e-12)


def test_margin_is_the_clearance_from_full_stretch_and_from_the_cylinder():
    arm = arms.dh("mine", a=[0, 0.4, 0.3, 0, 0], alpha=[-90, 0, 0, 90, 0], d=[0, 0, 0, 0.1, 0])
    for depth in (1e-2, 1e-5, 0.0, -1e-5, -1e-2):
        goal = arms.numpy_fk(arm, np.zeros((1, 5)))
        goal[0, 0, 3] -= depth
        sol = arms.solve_by_hand(arm, goal)
        np.testing.assert_allclose(sol.margin[0].max(), depth, atol=1e-15)
        assert sol.valid.any() == (depth >= 0)
    # The wrist beside axis 1 with the roll axis along it: no nearer than the offset.
    q = np.array([[0.2, -2.0, 1.5, 0.5, 0.3]])
    goal = arms.numpy_fk(arm, q)
    radius = np.hypot(*goal[0, :2, 3])
    for depth in (1e-2, 0.0, -1e-2):
        moved = goal.copy()
        moved[0, :2, 3] *= (0.1 + depth) / radius
        np.testing.assert_allclose(arms.solve_by_hand(arm, moved).margin[0].max(), depth, atol=1e-15)


def test_a_bad_goal_leaves_its_neighbors_as_they_are():
    arm, goals = made("vx300", random_joints(7))
    alone = arms.solve_by_hand(arm, goals)
    goals[3, 1, 2] = np.nan
    sol = arms.solve_by_hand(arm, goals)
    rest = np.arange(7) != 3
    assert not sol.valid[3].any() and np.isfinite(sol.q).all()
    np.testing.assert_array_equal(sol.q[rest], alone.q[rest])


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_gradients_are_finite_at_each_singularity(name):
    arm = arm_patterns.build(name)
    goals = jnp.asarray(ladders(name)[::25])

    def total(goals):
        slots = slots_of(arm, entries_of(goals), None, None)
        return sum(slot.margin.sum() + sum(x.sum() for x in slot.q) for slot in slots)

    assert np.isfinite(jax.grad(total)(goals)).all()
