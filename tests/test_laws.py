"""The laws of inverse kinematics, on real arms: what must be so whatever the equations are.

Read this first to see what the library promises. Each test states a law, makes another arm or other goals by
it, and compares all slots.
"""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest

import ikjax

QUICK = ("puma560", "gx4_351s")
MORE = ("ur5", "stanford", "so101", "planar_3r")
ARMS = [*QUICK, *(pytest.param(name, marks=pytest.mark.long) for name in MORE)]
MOVED = np.asarray(ikjax.pose(xyz=(0.3, -0.2, 0.5), rpy=(0.4, -0.7, 1.1)))
COUNT = 64

on_every_arm = pytest.mark.parametrize("name", ARMS)


def reached(name: str):
    """An arm, joints, and the goals that they reach: away from limits of the angle's range."""
    arm = ikjax.robots.get(name)
    q = np.random.default_rng(4).uniform(-1.5, 1.5, (COUNT, arm.n))
    return arm, q, ikjax.fk(arm, q)


def same_angle(a, b, kinds: str, atol: float):
    """Whether joints (..., n) are the same but for whole turns."""
    off = np.asarray(a) - np.asarray(b)
    turning = np.array([kind == "R" for kind in kinds])
    off = np.where(turning, off - 2 * np.pi * np.round(off / (2 * np.pi)), off)
    return np.abs(off).max(-1) < atol


def assert_same_slots(one, other, kinds: str):
    """Slot for slot: the same are valid, with the same joints."""
    assert np.asarray(one.valid).any(-1).all()
    np.testing.assert_array_equal(one.valid, other.valid)
    alike = same_angle(one.q, other.q, kinds, 1e-7)
    assert alike[np.asarray(one.valid)].all()


@on_every_arm
def test_the_joints_that_made_a_goal_are_among_its_slots(name):
    arm, q, goals = reached(name)
    sol = ikjax.solve(arm, goals)
    hit = same_angle(sol.q, q[:, None], arm.kinds, 1e-7) & np.asarray(sol.valid)
    assert hit.any(-1).all()


@on_every_arm
def test_forward_kinematics_of_every_valid_slot_is_the_goal(name):
    arm, _, goals = reached(name)
    sol = ikjax.solve(arm, goals)
    assert sol.valid.any(-1).all()
    off = np.abs(ikjax.fk(arm, sol.q) - goals[:, None])
    rows = {"pose": np.s_[:3, :], "position": np.s_[:3, 3:], "planar_pose": np.s_[:2, :]}[arm.task]
    assert off[np.asarray(sol.valid)][(slice(None), *rows)].max() < 1e-8


@on_every_arm
def test_moving_the_base_and_the_goals_together_changes_no_joint(name):
    arm, _, goals = reached(name)
    elsewhere = dataclasses.replace(arm, base=MOVED @ arm.base)
    assert_same_slots(ikjax.solve(arm, goals), ikjax.solve(elsewhere, MOVED @ goals), arm.kinds)


@on_every_arm
def test_a_tool_beyond_the_tool_changes_no_joint(name):
    arm, _, goals = reached(name)
    if arm.task != "pose" or arm.n < 6:
        pytest.skip("a tool that tilts is no tool of an arm with fewer joints")
    longer = dataclasses.replace(arm, tool=arm.tool @ MOVED)
    assert_same_slots(ikjax.solve(arm, goals), ikjax.solve(longer, goals @ MOVED), arm.kinds)


@on_every_arm
@pytest.mark.parametrize("scale", [1e-3, 1e3])
def test_the_unit_of_length_changes_nothing_but_lengths(name, scale):
    arm, _, goals = reached(name)

    def scaled(matrix):
        return jnp.asarray(matrix).at[..., :3, 3].multiply(scale)

    other = dataclasses.replace(
        arm, a=arm.a * scale, d=arm.d * scale, base=scaled(arm.base), tool=scaled(arm.tool)
    )
    one, two = ikjax.solve(arm, goals), ikjax.solve(other, scaled(goals))
    slides = np.array([scale if kind == "P" else 1.0 for kind in arm.kinds])
    assert_same_slots(one, dataclasses.replace(two, q=np.asarray(two.q) / slides), arm.kinds)
    np.testing.assert_allclose(two.margin, one.margin * scale, rtol=1e-6, atol=1e-9 * scale)


@on_every_arm
def test_another_zero_of_the_joints_shifts_the_joints_and_no_slot(name):
    """A bit is defined on the geometry: where a joint counts from is no part of it."""
    arm, _, goals = reached(name)
    shift = np.where([kind == "R" for kind in arm.kinds], np.linspace(0.3, 0.9, arm.n), 0.0)
    twin = dataclasses.replace(arm, theta=arm.theta + shift)
    one, two = ikjax.solve(arm, goals), ikjax.solve(twin, goals)
    assert_same_slots(one, dataclasses.replace(two, q=np.asarray(two.q) + shift), arm.kinds)


def reversed_arm(arm: ikjax.Arm) -> ikjax.Arm:
    """The same joints read from the tool to the base; each turns the other way.

    The inverse of a standard DH link, Rx(-alpha) Tx(-a) Tz(-d) Rz(-theta), parts into the end of one link of
    the reversed table and the beginning of the next.
    """
    a, alpha, d, theta = (np.asarray(x, float) for x in (arm.a, arm.alpha, arm.d, arm.theta))
    first = np.asarray(ikjax.pose(xyz=(-a[-1], 0, 0), rpy=(-alpha[-1], 0, 0)))
    return ikjax.Arm.from_dh(
        a=[*-a[-2::-1], 0],
        alpha=[*-alpha[-2::-1], 0],
        d=-d[::-1],
        theta=-theta[::-1],
        base=np.linalg.inv(arm.tool) @ first,
        tool=np.linalg.inv(arm.base),
        convention="standard",
    )


@pytest.mark.parametrize(
    ("name", "family"),
    [("puma560", "pieper_reversed"), pytest.param("ur5", "parallel_axes", marks=pytest.mark.long)],
)
def test_an_arm_read_from_its_tool_has_the_same_solutions(name, family):
    arm, q, goals = reached(name)
    backwards = reversed_arm(arm)
    assert backwards.family == family
    np.testing.assert_allclose(ikjax.fk(backwards, -q[:, ::-1]), np.linalg.inv(goals), atol=1e-12)
    one, two = ikjax.solve(arm, goals), ikjax.solve(backwards, jnp.linalg.inv(goals))
    np.testing.assert_array_equal(one.valid.sum(-1), two.valid.sum(-1))
    for k in range(COUNT):
        mine = np.asarray(one.q[k])[np.asarray(one.valid[k])]
        others = -np.asarray(two.q[k])[np.asarray(two.valid[k])][:, ::-1]
        met = same_angle(mine[:, None], others[None], arm.kinds, 1e-6)
        assert met.any(0).all() and met.any(1).all()
