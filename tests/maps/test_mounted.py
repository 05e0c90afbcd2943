"""Where an arm stands, its tool and its limits are data of a sweep's program."""

import dataclasses

import jax
import numpy as np
import pytest

import ikjax
from ikjax.maps.kernel import program
from ikjax.maps.kernel.mounted import Parts

MOUNT = np.asarray(ikjax.pose(xyz=(0.2, -0.1, 0.3), rpy=(0.1, -0.2, 2.0)))
TOOL = np.asarray(ikjax.pose(xyz=(0.02, 0.05, 0.2), rpy=(0.4, 0.3, -0.2)))
COARSE = {"orientations": 24, "dtype": "float64"}


def mounted(arm, mount=MOUNT, tool=TOOL, **changes):
    base, flange = np.asarray(arm.base), np.asarray(arm.tool)
    return dataclasses.replace(arm, base=mount @ base, tool=flange @ tool, **changes)


def box(arm):
    """A few positions around the arm's middle."""
    center = np.asarray(ikjax.fk(arm, np.full(arm.n, 0.3)))[:3, 3]
    return ikjax.maps.grid(center - 0.1, center + 0.1, 0.1)


def narrowed():
    """An arm with limits of every kind: none, wide, narrow, a narrow gap, one alone."""
    arm = ikjax.robots.puma560()
    limits = [[-np.inf, np.inf], [-2, 0.5], [-0.02, 0.03], [-3.1, 3.12], [-9, 9], [0.5, np.inf]]
    return mounted(arm, limits=np.array(limits))


def sliding():
    """An arm with a slide that has one limit, and a correction."""
    arm = ikjax.robots.stanford()
    limits = np.array(arm.limits)
    limits[2] = -np.inf, 0.4
    correction = np.random.default_rng(0).normal(0, 2e-4, (7, 6))
    return mounted(arm, limits=limits, correction=correction)


def point():
    """Three joints, whose goals are points."""
    arm = ikjax.Arm.from_dh(
        a=(0, 0.4, 0.3),
        alpha=(np.pi / 2, 0, 0),
        d=(0.3, 0, 0),
        convention="standard",
        limits=[[-1, 2], [-1, 2], [-0.9, 0.8]],
    )
    return mounted(arm, tool=np.eye(4))


def coupled():
    """An arm whose second motor turns joint 3 too, by half of its own turn."""
    arm = ikjax.robots.puma560()
    coupling = np.eye(6)
    coupling[2, 1] = 0.5
    return mounted(arm, coupling=coupling)


ARMS = {
    "narrowed": narrowed,
    "sliding": sliding,
    "coupled": coupled,
    "seven": lambda: mounted(ikjax.robots.xarm7()),
    "wide": lambda: mounted(ikjax.robots.xarm6()),
    "five": lambda: mounted(ikjax.robots.so101()),
    "point": point,
}


FLAGS = ["reachable", "solutions_within", "best_margin", "limited_by"]
JOINTS = ["branches", "mask_within", "best_limit_share", "best_manipulability", "mean_sigma_min_within"]


@pytest.mark.parametrize("name", ["narrowed", *(pytest.param(x, marks=pytest.mark.slow) for x in ARMS)])
def test_a_program_that_is_told_of_mount_tool_and_limits_counts_as_one_that_knows_them(
    name, monkeypatch, request
):
    arm = ARMS[name]()
    is_slow = request.node.get_closest_marker("slow") is not None
    names = [*FLAGS, "reachable_within", *(JOINTS if is_slow else [])]
    options = {"redundancy_samples": 3} if arm.locked else {}
    # The family of xArm 6 adds an axis of its own to batches.
    with jax.numpy_rank_promotion("allow" if name == "wide" else "raise"):
        told = ikjax.sweep(arm, box(arm), **COARSE, statistics=names, **options)
        monkeypatch.setattr(program, "parts_of", lambda arm, samples: Parts(arm, None, has_tool=False))
        knows = ikjax.sweep(arm, box(arm), **COARSE, statistics=names, **options)
    for each in names:
        one, other = told.arrays[each], knows.arrays[each]
        if one.dtype.kind in "iu":
            np.testing.assert_array_equal(one, other, err_msg=each)
        else:
            # Means are of rounded values, margins are stored in float32.
            np.testing.assert_allclose(one, other, rtol=1e-5, atol=2e-6, err_msg=each)
    assert name == "five" or 0 < told.reachable_within.sum() < told.reachable.sum() < told.goals


@pytest.mark.slow
@pytest.mark.parametrize("rolls", [1, 3])
def test_a_surface_is_seen_from_the_mount(rolls, monkeypatch):
    arm = mounted(ikjax.robots.ur5())
    points = np.random.default_rng(0).uniform((0, -0.4, -0.1), (0.8, 0.4, 0.7), (40, 3))
    normals = np.random.default_rng(1).normal(size=(40, 3))
    place = ikjax.maps.surface(points, normals=normals / np.linalg.norm(normals, axis=1, keepdims=True))
    told = ikjax.sweep(arm, place, **COARSE, free_rolls=rolls)
    monkeypatch.setattr(program, "parts_of", lambda arm, samples: Parts(arm, None, has_tool=False))
    knows = ikjax.sweep(arm, place, **COARSE, free_rolls=rolls)
    for name, value in told.arrays.items():
        np.testing.assert_allclose(value, knows.arrays[name], rtol=1e-5, atol=2e-6, err_msg=name)
    assert 0 < told.reachable.sum() < told.goals


def test_of_fewer_than_six_joints_the_tool_is_a_part_of_the_program():
    arm = ikjax.robots.so101().baked()
    assert not program.parts_of(arm, 1).has_tool
    assert program.parts_of(ikjax.robots.ur5().baked(), 1).has_tool
    assert not program.parts_of(ikjax.robots.puma560().baked(), 1).has_offset
