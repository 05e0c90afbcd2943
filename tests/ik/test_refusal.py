"""An arm without closed form is refused in one line: the verdict, the fact that fails, and what to do."""

import re

import jax
import numpy as np
import pytest

import ikjax
from ikjax.ik.refusal import LADDER, refusal

RIGHT = np.pi / 2
PUMA = {
    "a": [0, 0.43, 0.02, 0, 0, 0],
    "alpha": [RIGHT, 0, -RIGHT, RIGHT, -RIGHT, 0],
    "d": [0, 0, 0.15, 0.43, 0, 0],
}
UR = {
    "a": [0, -0.24, -0.21, 0, 0, 0],
    "alpha": [RIGHT, 0, 0, RIGHT, -RIGHT, 0],
    "d": [0.15, 0, 0, 0.11, 0.08, 0.08],
}


def arm_of(table, axis_tolerance=None, **change):
    table = {key: np.array(table[key], float) for key in table}
    for entry, value in change.items():
        table[entry[:-1]][int(entry[-1]) - 1] += value
    return ikjax.Arm.from_dh(**table, convention="standard", name="mine", axis_tolerance=axis_tolerance)


def calibrated(rng, size):
    """A table of which every number is off a little."""
    return {key: np.array(UR[key]) + rng.normal(size=6) * size for key in UR}


HELPED = {
    "an angle typed with three decimals": (
        PUMA,
        {"alpha1": 2e-4, "alpha2": 2e-4, "d5": 1e-5},
        "ortho_parallel_wrist",
    ),
    "axes that just miss": (PUMA, {"a5": 2e-4, "alpha2": 1e-4}, "ortho_parallel_wrist"),
    "nearly parallel axes": (UR, {"alpha2": 1e-3}, "three_parallel"),
    "a wrist off by a hundredth": (PUMA, {"d5": 0.01, "alpha2": 1e-3}, "offset_wrist"),
}


@pytest.mark.parametrize("change", [{"a5": 2e-4}, {"d5": 1e-5}])
def test_an_arm_that_nearly_has_eight_slots_is_told_of_the_tolerance(change):
    with pytest.warns(UserWarning, match=r"ortho_parallel_wrist, which is faster: build it with axis_tol"):
        arm = arm_of(PUMA, **change)
    assert arm.family == "offset_wrist"


@pytest.mark.parametrize(("table", "change", "family"), HELPED.values(), ids=HELPED)
def test_the_tolerance_that_helps_is_named_and_helps(table, change, family):
    arm = arm_of(table, **change)
    assert arm.family is None
    text = refusal(arm)
    tolerance = re.search(
        rf"project\(\) takes any arm; within ([\de.-]+) it is {family}: .*axis_tolerance=(\S+);", text
    )
    off, tolerance = float(tolerance[1]), tolerance[2]
    assert tolerance in LADDER and off <= 1.5 * float(tolerance)
    assert arm_of(table, float(tolerance), **change).family == family


def test_a_calibrated_table_is_told_its_tolerance_with_or_without_a_correction(rng):
    table = calibrated(rng, 1e-4)
    arm = arm_of(table)
    assert "it is three_parallel: build it with axis_tolerance=1e-3" in refusal(arm)
    assert arm_of(table, 1e-3).family == "three_parallel"
    # Not enough of a tolerance: what is kept in the correction counts as well.
    small = arm_of(table, 1e-5)
    assert small.family is None and refusal(small).split("project")[1] == refusal(arm).split("project")[1]


@pytest.mark.parametrize(
    ("change", "fact"),
    [
        ({"alpha2": 0.3, "a5": 0.076}, "for pieper, the nearest, axes 5 and 6 are 76 mm apart. "),
        (
            {"a4": 0.1, "a5": 0.002},
            "for ortho_parallel_wrist, the nearest, axes 4 and 5 are 100 mm apart (and 1 more). ",
        ),
    ],
)
def test_where_no_tolerance_helps_the_nearest_family_and_the_gap_are_named(change, fact):
    text = refusal(arm_of(PUMA, **change))
    assert text == f"mine has no closed form here: {fact}project() takes any arm; explain(arm) says more"


@pytest.mark.parametrize("n", [1, 10])
def test_numbers_of_joints_that_no_family_has_are_named(n):
    arm = ikjax.Arm.from_dh(a=np.full(n, 0.3), alpha=np.full(n, 0.4), d=np.zeros(n), convention="standard")
    assert (
        refusal(arm)
        == f"arm has no closed form here: no family has joints {'R' * n}. project() takes any arm"
    )


def test_every_refusal_is_one_line_that_names_project(rng):
    for n in range(1, 8):
        for _ in range(3):
            kinds = "".join(rng.choice(["R", "R", "P"], n))
            a, alpha, d = rng.uniform(-1, 1, (3, n))
            arm = ikjax.Arm.from_dh(a=a, alpha=alpha, d=d, kinds=kinds, convention="standard")
            if arm.family is None:
                text = refusal(arm)
                assert len(text) < 300 and text.count("\n") == 0 and "project() takes any arm" in text
                assert ikjax.explain(arm).startswith(text)


def test_a_traced_arm_is_refused_too():
    arm = arm_of(PUMA, alpha2=0.3, a5=0.076)
    with pytest.raises(ValueError, match=r"mine has no closed form here\. project\(\) takes any arm"):
        jax.jit(ikjax.solve)(arm, np.eye(4))
    with pytest.raises(ValueError, match=r"axes 5 and 6 are 76 mm apart"):
        jax.jit(lambda T: ikjax.solve(arm, T))(np.eye(4))
