"""What a sweep counts as near is what `project` comes near, goal by goal."""

import numpy as np
import pytest

import ikjax
from ikjax.maps import statistics


@pytest.mark.slow
def test_near_counts_the_orientations_that_the_closed_form_comes_near():
    arm = ikjax.robots.so101()
    grid, turns = ikjax.maps.grid((-0.4, -0.3, -0.1), (0.5, 0.4, 0.4), 0.1), ikjax.maps.even_rotations(40)
    near = [
        ikjax.maps.Near(0.001, 0.4),
        ikjax.maps.Near(0.03, 3.2, name="point"),
        ikjax.maps.Near(0.001, 0.0, name="none"),
    ]
    swept = ikjax.sweep(arm, grid, turns, dtype="float64", statistics=[*near, "reachable_within"])
    goals = np.broadcast_to(np.eye(4), (*grid.shape, 40, 4, 4)).copy()
    goals[..., :3, :3], goals[..., :3, 3] = turns, grid.points()[..., None, :]
    closed = ikjax.project(arm, goals, steps=0).branches
    for each in near:
        within = (closed.position_error <= each.position) & (closed.rotation_error <= each.rotation)
        count = np.asarray(within.any(-1).sum(-1))
        np.testing.assert_array_equal(swept.to_numpy()[each.name], count)
        assert each.name == "none" or 0.02 < count.sum() / 40 / grid.count < 0.98


def test_what_is_near_is_no_angle_below_zero_and_no_doubt():
    with pytest.raises(ValueError, match="rotation must be a tolerance"):
        ikjax.maps.Near(0.01, -0.1)
    with pytest.raises(ValueError, match="name must be"):
        ikjax.maps.Near(0.01, 0.1, name="Near enough")
    with pytest.raises(ValueError, match="certify does not support Near"):
        statistics.certified(planned("reachable", ikjax.maps.Near(0.001, 0.4)))


def planned(*wanted) -> statistics.Plan:
    return statistics.plan(ikjax.robots.so101(), wanted, orientations=8)


def test_tolerances_are_part_of_what_a_map_says():
    specs = [planned(ikjax.maps.Near(0.01, angle)).specs()["near"] for angle in (0.1, 0.2)]
    assert specs[0] != specs[1] and specs[0]["near"] == [0.01, 0.1]
