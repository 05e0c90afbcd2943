"""Sweeps of arms with a redundant joint: a goal counts where some value of that joint reaches it."""

import functools

import numpy as np
import pytest

import ikjax
from ikjax.arm.forward import reach as reach_of
from ikjax.maps.kernel import between
from ikjax.maps.store import manifest

SAMPLES = 5
NAMES = (
    *("reachable", "reachable_within", "solutions_within", "best_margin_within", "widest_interval"),
    "widest_interval_within",
)


@functools.cache
def fer():
    return ikjax.robots.fer()


def study() -> dict:
    # 21 orientations do not fill a word, 18 positions do not fill a block.
    grid = ikjax.maps.grid((0.1, -0.3, 0.2), (0.7, 0.3, 0.5), 0.3)
    return {"positions": grid, "orientations": 21, "redundancy_samples": SAMPLES}


@functools.cache
def swept():
    return ikjax.sweep(fer(), **study(), dtype="float64", statistics=NAMES)


def values(samples=SAMPLES):
    low, high = np.asarray(fer().limits)[6]
    return low + (high - low) * (np.arange(samples) + 0.5) / samples


@functools.cache
def solved():
    """Solutions (positions, orientations, values, slots) of the goals of `study`."""
    reach = swept()
    goals = np.zeros((reach.positions.count, 21, 1, 4, 4))
    goals[..., :3, :3], goals[..., 3, 3] = reach.rotations[:, None], 1
    goals[..., :3, 3] = reach.positions.points().reshape(-1, 1, 1, 3)
    return ikjax.solve(fer(), goals, redundancy=values())


def longest_run(flags):
    """The most in a row that are set, along axis -2 of (..., values, slots), over slots."""
    longest = np.zeros(flags.shape[:-2], int)
    for first in range(flags.shape[-2]):
        for last in range(first + 1, flags.shape[-2] + 1):
            whole = flags[..., first:last, :].all(-2).any(-1)
            longest = np.where(whole, np.maximum(longest, last - first), longest)
    return longest


@pytest.mark.slow
def test_a_sweep_counts_what_solve_answers_at_some_value():
    sol, reach = solved(), swept()
    valid = np.asarray(sol.valid)
    inside = np.asarray(ikjax.within_limits(fer(), sol).valid)
    flat = {name: value.reshape(-1) for name, value in reach.to_numpy().items()}
    np.testing.assert_array_equal(flat["reachable"], valid.any((-1, -2)).sum(-1))
    np.testing.assert_array_equal(flat["reachable_within"], inside.any((-1, -2)).sum(-1))
    np.testing.assert_array_equal(flat["solutions_within"], inside.sum((1, 2, 3)))
    assert 0 < flat["reachable_within"].sum() < flat["reachable"].sum() < reach.goals
    # Some goals are reached at few values only.
    assert inside.any(-1).sum() < 0.8 * SAMPLES * inside.any((-1, -2)).sum()
    margin = np.where(inside, sol.margin, -np.inf).max((1, 2, 3))
    np.testing.assert_allclose(flat["best_margin_within"], margin, atol=1e-6)


@pytest.mark.slow
def test_the_widest_interval_is_the_longest_run_of_one_branch():
    sol, reach = solved(), swept()
    spacing = np.diff(np.asarray(fer().limits)[6])[0] / SAMPLES
    inside = np.asarray(ikjax.within_limits(fer(), sol).valid)
    for name, flags in (("widest_interval", np.asarray(sol.valid)), ("widest_interval_within", inside)):
        runs = longest_run(flags)
        np.testing.assert_allclose(reach.arrays[name].reshape(-1), runs.max(1) * spacing, rtol=1e-6)
        assert runs.max() > 1 and (runs == 1).any()
    # A branch that ends is not continued by another one.
    assert (longest_run(inside) < longest_run(inside.any(-1, keepdims=True))).any()


@pytest.mark.slow
def test_manipulability_is_that_of_all_seven_joints():
    names = ("best_manipulability_within", "mean_sigma_min_within")
    sol, reach = solved(), ikjax.sweep(fer(), **study(), dtype="float64", statistics=names)
    inside = np.asarray(ikjax.within_limits(fer(), sol).valid)
    jacobian = np.array(ikjax.jacobian(fer(), sol.q))
    jacobian[..., :3, :] /= float(reach_of(fer().baked()))
    singular = np.linalg.svd(jacobian, compute_uv=False)
    best = np.where(inside, singular.prod(-1), 0).max((1, 2, 3))
    np.testing.assert_allclose(reach.arrays[names[0]].reshape(-1), best, atol=1e-6)
    mean = np.where(inside, singular[..., -1], 0).sum((1, 2, 3)) / np.maximum(inside.sum((1, 2, 3)), 1)
    np.testing.assert_allclose(reach.arrays[names[1]].reshape(-1), mean, atol=1e-5)
    assert best.max() > 0.02 and mean.max() > 0.02


@pytest.mark.slow
@pytest.mark.parametrize("name", ["fer", "xarm7"])
def test_more_values_never_reach_less(name):
    """An odd multiple of the values holds all of them."""
    arm, options = ikjax.robots.get(name), {"dtype": "float32", "statistics": ("reachable", "mask_within")}
    few, more = (
        ikjax.sweep(arm, **{**study(), "redundancy_samples": count}, **options)
        for count in (SAMPLES, 9 * SAMPLES)
    )
    lost = few.reached() & ~more.reached()
    assert lost.sum() <= 1 and more.reached().sum() > few.reached().sum()
    assert 0.1 < more.reached().mean() < 0.95


@pytest.mark.slow
def test_a_map_is_stored_and_resumed_and_knows_its_samples(tmp_path):
    pytest.importorskip("tensorstore")
    whole = swept()
    options = {"dtype": "float64", "statistics": NAMES, "chunk": (2, 2, 1)}
    out = tmp_path / "map.zarr"
    ikjax.sweep(fer(), **study(), **options, out=out)
    (next((out / "reachable" / "c").rglob("[0-9]/[0-9]/[0-9]"))).unlink()
    again = ikjax.sweep(fer(), **study(), **{**options, "chunk": None}, out=out, resume=True)
    assert again.units.missing == 1 and again.units.kept == again.units.total - 1
    back = ikjax.ReachMap.load(out)
    assert back.redundancy_samples == SAMPLES and "5 values of joint7" in back.summary()
    for name, value in whole.to_numpy().items():
        assert value.tobytes() == back.to_numpy()[name].tobytes()
    spec, _ = manifest.describe(back)
    assert spec["redundancy_samples"] == SAMPLES
    with pytest.raises(ValueError, match="redundancy_samples: 5 there, 6 here"):
        ikjax.sweep(
            fer(), **{**study(), "redundancy_samples": 6}, **{**options, "chunk": None}, out=out, resume=True
        )


@pytest.mark.slow
def test_a_certified_sweep_finds_what_lies_between_its_values():
    """It reaches what 999 values reach, and counts solutions at its own values as float64 does."""
    names = ("reachable", "reachable_within", "solutions_within", "mask_within", "limited_by")
    options = {"statistics": names, "free_rolls": 2}
    sure = ikjax.sweep(fer(), **study(), dtype="float32", certify=True, **options)
    few = ikjax.sweep(fer(), **study(), dtype="float64", **options)
    dense = {**study(), "redundancy_samples": 999}
    many = ikjax.sweep(fer(), **dense, dtype="float64", statistics=names[:4], free_rolls=2)
    np.testing.assert_array_equal(sure.arrays["solutions_within"], few.arrays["solutions_within"])
    for name in ("reachable", "reachable_within", "mask_within"):
        np.testing.assert_array_equal(sure.arrays[name], many.arrays[name], err_msg=name)
        assert (few.arrays[name] != many.arrays[name]).any()
    counts = np.unpackbits(sure.arrays["mask_within"].view(np.uint8), axis=-1).sum(-1)
    np.testing.assert_array_equal(counts.reshape(-1), sure.arrays["reachable_within"].reshape(-1))
    assert (sure.arrays["limited_by"] >= 0).all() and (sure.arrays["limited_by"] > 0).any()
    assert sure.statistic_specs["mask_within"]["between_values"] is True
    assert "between_values" not in sure.statistic_specs["solutions_within"]


def test_a_maximum_between_samples_is_found_where_it_is_above_zero():
    """Of two slots with a narrow part each: tents, parabolas, and corners beside a jump."""
    centers = np.linspace(-0.9, 0.9, 40)
    heights = np.array([1e-6, 1e-3, -1e-6, -1e-3])

    def evaluate(goals, values):
        off = values[..., None] - centers[goals % 40][:, None, None]
        top = heights[goals // 40][:, None, None]
        tent = top - np.concatenate([np.abs(off), np.where(off < 0, -off, 3 * off)], -1)
        bump = top - np.concatenate([off**2, np.where(off < -0.05, 1, 40 * off**2)], -1)
        level = np.stack([tent, bump], -1)
        return level, level >= 0

    wanted = np.ones((160, 2), bool)
    wanted[7] = False
    samples = np.linspace(-1, 1, 4 * between.WIDTH)
    found = between.is_reached(evaluate, wanted, samples)
    np.testing.assert_array_equal(found, wanted & (np.arange(160) < 80)[:, None])


def test_the_number_of_values_is_in_the_spec_of_redundant_arms_alone():
    grid, turns = study()["positions"], ikjax.maps.even_rotations(3)
    for name, samples in (("puma560", None), ("fer", 5)):
        arm = ikjax.robots.get(name)
        reach = ikjax.ReachMap(arm, grid, turns, 1, "float64", {}, {}, 0.0, redundancy_samples=samples or 1)
        assert manifest.describe(reach)[0].get("redundancy_samples") == samples


@pytest.mark.parametrize(
    ("name", "options", "message"),
    [
        ("puma560", {"redundancy_samples": 8}, "for arms with redundant joints, puma560 has none"),
        ("puma560", {"statistics": "widest_interval"}, "statistics must be some of"),
        ("fer", {"redundancy_samples": 0}, "redundancy_samples must be a whole number above zero, got 0"),
        ("fer", {"redundancy_samples": 2.0}, "redundancy_samples must be a whole number above zero"),
        ("fer", {"redundancy_samples": 512, "free_rolls": 9}, "must be at most 4,096 .* got 4,608"),
    ],
)
def test_bad_options_are_refused_by_name(name, options, message):
    with pytest.raises(ValueError, match=message):
        ikjax.sweep(ikjax.robots.get(name), ikjax.maps.grid((0, 0, 0), (1, 1, 1), 0.5), 3, **options)
