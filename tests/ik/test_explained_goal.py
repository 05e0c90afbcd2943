"""`explain(arm, goal)`: what each branch of one goal lacks, in numbers that can be checked."""

import re

import numpy as np
import pytest

import ikjax


def lines_of(arm, goal, **values):
    head, *rows = ikjax.explain(arm, goal, **values).splitlines()
    assert [row.split(", ")[0].strip() for row in rows] == [f"branch {k}" for k in range(len(arm.branches))]
    return head, rows


def test_each_branch_is_within_beyond_or_out_of_reach():
    arm = ikjax.robots.puma560()
    goal = ikjax.pose((0.4, 0.2, 0.3), rpy=(np.pi, 0, 0.5))
    sol = ikjax.solve(arm, goal)
    inside = ikjax.within_limits(arm, sol)
    head, rows = lines_of(arm, goal)
    assert "8 of 8 branches reach the goal, 1 within the limits" in head
    lower, upper = np.degrees(np.asarray(arm.limits)).T
    for k, row in enumerate(rows):
        if inside.valid[k]:
            assert "within the limits, q" in row
            continue
        found = re.findall(r"q(\d) = (\S+) deg, (\S+) deg beyond its limit", row)
        q = np.degrees(np.asarray(sol.q[k]))
        turned = np.abs((q + 180) % 360 - 180)
        some_turn = [q + turn for turn in (-360, 0, 360)]
        inside_by_turns = np.any([(lower - 1e-9 <= x) & (x <= upper + 1e-9) for x in some_turn], axis=0)
        wrong = np.flatnonzero(~inside_by_turns).tolist()
        assert [int(i) - 1 for i, _, _ in found] == wrong and wrong
        for i, value, beyond in found:
            i = int(i) - 1
            assert abs(abs((float(value) + 180) % 360 - 180) - turned[i]) < 0.1
            past = max(lower[i] - float(value), float(value) - upper[i])
            assert float(beyond) == pytest.approx(past, abs=0.1)


def test_a_turn_that_brings_a_joint_nearer_its_limit_is_taken():
    """-170 deg is 190 deg, which is 10 deg beyond a limit of 180 deg, and not 260 deg from one at 90 deg."""
    arm = ikjax.Arm.from_dh(
        a=[0.5, 0.4],
        alpha=[0, 0],
        d=[0, 0],
        convention="standard",
        limits=np.radians([[90, 180], [-170, 170]]),
    )
    goal = ikjax.fk(arm, np.radians([-170, 30]))
    _, rows = lines_of(arm, goal)
    assert any("q1 = 190 deg, 10 deg beyond its limit" in row for row in rows)


def test_slides_are_in_millimetres_and_what_is_out_of_reach_says_how_far():
    arm = ikjax.robots.gx4_351s()
    _, rows = lines_of(arm, ikjax.pose((0.3, 0.1, -0.3), rpy=(0, 0, 0.5)))
    assert all("q3 = -300 mm, 150 mm beyond its limit" in row for row in rows)
    _, rows = lines_of(arm, ikjax.pose((0.6, 0, -0.05)))
    assert all("out of reach, 250 mm from its fold" in row for row in rows)


@pytest.mark.slow
def test_redundant_joints_and_named_joints_are_told():
    arm = ikjax.robots.fer()
    goal = ikjax.fk(arm, [0.1, -0.4, 0.3, -2.0, 0.2, 1.6, 0.3])
    text = ikjax.explain(arm, goal, redundancy=0.3)
    assert "within the limits, q" in text


def test_what_it_does_not_take_is_refused():
    arm = ikjax.robots.puma560()
    for goal, says in (
        (np.stack([np.eye(4)] * 2), "one goal"),
        (np.full((4, 4), np.nan), "finite"),
    ):
        with pytest.raises(ValueError, match=says):
            ikjax.explain(arm, goal)
    with pytest.raises(ValueError, match="go with a goal"):
        ikjax.explain(arm, redundancy=0.3)
    unlimited = ikjax.robots.planar_2r(0.5, 0.4)
    assert "which no joint has" in ikjax.explain(unlimited, ikjax.position(0.6, 0.1, 0.0))
