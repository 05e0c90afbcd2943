"""A certified float32 map counts what a float64 map counts, where float32 alone does not."""

import dataclasses

import numpy as np
import pytest

import ikjax

COUNTS = tuple(
    f"{name}{end}" for name in ("reachable", "solutions", "branches", "mask") for end in ("", "_within")
)
STRAIGHT = {"gx4_351s": (1, 0.0), "puma560": (2, -np.arctan2(0.4318, 0.0203))}
"""A joint of each arm, and where it stretches the arm."""


def at_the_edge(arm, count: int = 400):
    """Points that an arm just reaches or just does not, by micrometers, each in one of eight orientations."""
    rng = np.random.default_rng(5)
    low, high = np.clip(np.array(arm.limits).T, -np.pi, np.pi)
    q = rng.uniform(low, high, (count, arm.n))
    elbow, angle = STRAIGHT[arm.name]
    q[:, elbow] = angle
    q[::3, 0] = high[0]
    goals = np.array(ikjax.fk(arm, q))
    hand = goals[:, :3, 2] * float(np.asarray(arm.d)[-1] if arm.n == 6 else 0)
    points = goals[:, :3, 3] - hand + np.resize(hand[:8], hand.shape)
    return ikjax.maps.surface(points * (1 + rng.uniform(-3e-6, 3e-6, (count, 1)))), goals[:8, :3, :3]


@pytest.mark.parametrize("name", ["gx4_351s", pytest.param("puma560", marks=pytest.mark.slow)])
def test_a_certified_map_counts_as_float64_does(name):
    arm = ikjax.robots.get(name)
    points, turns = at_the_edge(arm)
    wide, narrow, certified = (
        ikjax.sweep(arm, points, turns, statistics=COUNTS, **options).to_numpy()
        for options in ({"dtype": "float64"}, {"dtype": "float32"}, {"dtype": "float32", "certify": True})
    )
    assert (narrow["solutions_within"] != wide["solutions_within"]).sum() > 20
    for key in COUNTS:
        np.testing.assert_array_equal(certified[key], wide[key], err_msg=key)


def test_sums_and_turns_of_the_tool_are_certified_too(tmp_path):
    arm = ikjax.robots.gx4_351s()
    points, turns = at_the_edge(arm, 64)
    names = ("solutions", "mean_manipulability", "best_margin", "mask")
    wide, certified = (
        ikjax.sweep(arm, points, turns, free_rolls=3, statistics=names, **options)
        for options in ({"dtype": "float64"}, {"dtype": "float32", "certify": True, "out": tmp_path / "map"})
    )
    np.testing.assert_array_equal(certified.solutions, wide.solutions)
    np.testing.assert_array_equal(certified.to_numpy()["mask"], wide.to_numpy()["mask"])
    for name in ("mean_manipulability", "best_margin"):
        np.testing.assert_allclose(certified.to_numpy()[name], wide.to_numpy()[name], atol=1e-5)
    assert "float32, certified in float64" in certified.summary()
    # What was stored is enough to make it again.
    again = ikjax.ReachMap.load(tmp_path / "map")
    resumed = ikjax.sweep(
        again.arm, again.positions, turns, free_rolls=3, statistics=names, dtype="float32", certify=True,
        out=tmp_path / "map", resume=True,
    )  # fmt: skip
    assert resumed.units.kept == resumed.units.total


def test_what_cannot_be_certified_is_refused():
    arm, points = ikjax.robots.gx4_351s(), ikjax.maps.grid((0, 0, 0), (0.1, 0, 0), 0.1)
    with pytest.raises(ValueError, match="certify is for float32 sweeps, got dtype float64"):
        ikjax.sweep(arm, points, 8, dtype="float64", certify=True)
    with pytest.raises(ValueError, match="certify needs a statistic that counts, got best_margin"):
        ikjax.sweep(arm, points, 8, dtype="float32", certify=True, statistics="best_margin")


def test_arms_alike_in_float32_are_certified_each_as_given():
    arm = ikjax.robots.gx4_351s().astype("float64")
    shorter = dataclasses.replace(arm, a=arm.a.at[1].add(-1e-8))
    assert (shorter.astype("float32").a == arm.astype("float32").a).all()
    stretched = np.array(ikjax.fk(arm, np.array([0.3, 0, 0.05, 0])))
    points, turns = ikjax.maps.surface(stretched[None, :3, 3]), stretched[None, :3, :3]
    options = {"dtype": "float32", "certify": True, "statistics": "reachable"}
    found = [int(ikjax.sweep(each, points, turns, **options).reachable.sum()) for each in (arm, shorter)]
    assert found == [1, 0]
