"""Files of rounded numbers: which tolerance is taken, what the table holds, and what is said of it."""

import warnings

import numpy as np
import pytest

import ikjax
from ikjax.solvers.pipeline import as_solved

PI = np.pi


def from_rows(rows, limit=2.6, **options) -> ikjax.Arm:
    """An arm of (xyz, rpy) for each joint, about z."""
    links = "".join(f'<link name="l{i}"/>' for i in range(len(rows) + 1))
    joints = "".join(
        f'<joint name="j{i}" type="revolute"><parent link="l{i}"/><child link="l{i + 1}"/>'
        f'<origin xyz="{xyz}" rpy="{rpy}"/><axis xyz="0 0 1"/>'
        f'<limit lower="{-limit}" upper="{limit}"/></joint>'
        for i, (xyz, rpy) in enumerate(rows)
    )
    return ikjax.Arm.from_urdf(f'<robot name="arm">{links}{joints}</robot>', **options)


def by_hand(rows, q) -> np.ndarray:
    """Forward kinematics of the same rows, in numpy alone."""

    def about(axis, angle):
        cross = np.cross(np.eye(3), axis)
        return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross

    T = np.eye(4)
    for (xyz, rpy), turn in zip(rows, q, strict=True):
        step, (roll, pitch, yaw) = np.eye(4), map(float, rpy.split())
        x, y, z = np.eye(3)
        step[:3, :3] = about(z, yaw) @ about(y, pitch) @ about(x, roll) @ about(z, turn)
        step[:3, 3] = list(map(float, xyz.split()))
        T = T @ step
    return T


# Right angles of four digits, as published for a Doosan M1013.
M1013 = [
    ("0 0 0.1525", "0 0 0"),
    ("0 0.0345 0", "0 -1.571 -1.571"),
    ("0.62 0 0", "0 0 1.571"),
    ("0 -0.559 0", "1.571 0 0"),
    ("0 0 0", "-1.571 0 0"),
    ("0 -0.121 0", "1.571 0 0"),
]
# Half a turn of five digits, as published for a Kinova Gen3 Lite: axes 2 and 3 meet 38 km away.
GEN3_LITE = [
    ("0 0 0.12825", "0 0 0"),
    ("0 -0.03 0.115", "1.5708 0 0"),
    ("0 0.28 0", "-3.1416 0 0"),
    ("0 -0.14 0.02", "1.5708 0 0"),
    ("0.0285 0 0.105", "0 1.5708 0"),
    ("-0.105 0 0.0285", "0 -1.5708 0"),
]
# A wrist that is off by 5 mm by design, as published for a Schunk LWA4P.
LWA4P = [
    ("0 0 0", "0 0 0"),
    ("0 0 0", "1.5708 0 0"),
    ("0 0.350 0", "0 3.14159 0"),
    ("0 0 0", "-1.5708 3.14159 0"),
    ("0 0.005263 0.305", "1.5708 0 3.14159"),
    ("0 0 0", "-1.5708 0 0"),
]


@pytest.mark.parametrize("rows", [M1013, GEN3_LITE, LWA4P], ids=["M1013", "Gen3 Lite", "LWA4P"])
def test_the_arm_is_the_one_in_the_file_in_both_types(rows):
    arm = from_rows(rows)
    for q in np.random.default_rng(0).uniform(-2.6, 2.6, (5, 6)):
        T = by_hand(rows, q)
        np.testing.assert_allclose(ikjax.fk(arm, q), T, atol=1e-12)
        np.testing.assert_allclose(ikjax.fk(arm.astype(np.float32), q.astype(np.float32)), T, atol=2e-6)


@pytest.mark.parametrize("rows", [M1013, GEN3_LITE, LWA4P], ids=["M1013", "Gen3 Lite", "LWA4P"])
def test_the_table_has_the_size_of_the_arm(rows):
    arm = from_rows(rows)
    assert np.abs(np.asarray(arm.d)).max() < 1 and np.abs(np.asarray(arm.a)).max() < 1


def test_the_least_tolerance_that_gives_a_family_is_taken():
    """A wrist that misses its point by 0.2 mm, of an arm of 1.5 m."""
    rows = [(xyz, rpy.replace("1.571", f"{PI / 2:.15f}")) for xyz, rpy in M1013]
    rows[4] = "0.0002 0 0", rows[4][1]
    arm = from_rows(rows)
    assert arm.family == "ortho_parallel_wrist"
    assert 1e-4 < np.abs(np.asarray(arm.correction)).max() < 3e-4
    assert from_rows(rows, axis_tolerance=1e-5).family is None
    assert "0.0002 m" in ikjax.explain(arm) and "complete" not in ikjax.explain(arm)


def test_a_family_that_holds_needs_no_tolerance():
    arm = from_rows(M1013)
    assert arm.family == "pieper"
    looser = from_rows(M1013, axis_tolerance=1e-3)
    assert looser.family == "ortho_parallel_wrist" and looser.correction is not None


def test_slots_that_may_be_too_few_are_said():
    """A correction of a millimetre where no other family holds."""
    arm = ikjax.robots.get("puma560")
    table = {key: np.asarray(getattr(arm, key)) for key in ("a", "alpha", "d")}
    correction = np.zeros((7, 6))
    correction[5, 0] = 1e-3
    given = ikjax.Arm.from_dh(**table, correction=correction, convention="standard")
    assert given.family == "ortho_parallel_wrist" and not given.complete
    assert "complete = False" in ikjax.explain(given)
    assert arm.complete


@pytest.mark.parametrize("tolerance", [None, 1e-2])
def test_a_complete_family_comes_before_one_that_may_miss_slots(tolerance):
    assert from_rows(LWA4P, axis_tolerance=tolerance).family == "offset_wrist"
    assert from_rows(LWA4P, axis_tolerance=tolerance).complete


@pytest.mark.slow
def test_an_offset_by_design_loses_no_solution():
    arm = from_rows(LWA4P, axis_tolerance=1e-2)
    q = np.random.default_rng(1).uniform(-2.9, 2.9, (1500, 6))
    sol = ikjax.solve(arm, ikjax.fk(arm, q))
    off = np.abs((np.asarray(sol.q) - q[:, None] + PI) % (2 * PI) - PI).max(-1)
    assert (np.where(sol.valid, off, 9).min(-1) < 1e-4).all()


def test_a_correction_that_valid_cannot_see_is_left_out():
    arm = ikjax.robots.get("puma560")
    for off, seen in ((1e-12, ()), (1e-9, ("float64",)), (1e-5, ("float32", "float64"))):
        table = {key: np.asarray(getattr(arm, key)) for key in ("a", "alpha", "d")}
        correction = np.zeros((7, 6))
        correction[2, 3] = off
        given = ikjax.Arm.from_dh(**table, correction=correction, convention="standard")
        for dtype in ("float32", "float64"):
            solved = as_solved(given.astype(dtype).baked())
            assert (solved.correction is not None) == (dtype in seen)


def test_a_table_of_rounded_twists_is_told_of_its_faster_family():
    table = {"a": [0, 0.43, 0.02, 0, 0, 0], "d": [0.6, 0.1, 0, 0.43, 0, 0.4], "convention": "standard"}
    rounded = [-1.5708, 0, 1.5708, -1.5708, 1.5708, 0]
    with pytest.warns(UserWarning, match="ortho_parallel_wrist, which is faster: .* axis_tolerance=1e-05"):
        arm = ikjax.Arm.from_dh(alpha=rounded, **table)
    assert arm.family == "pieper"
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert ikjax.Arm.from_dh(alpha=rounded, axis_tolerance=1e-5, **table).family == "ortho_parallel_wrist"
        ikjax.Arm.from_dh(alpha=np.round(np.array(rounded) * 2 / PI) * PI / 2, **table)


def test_a_table_of_kilometres_is_rewritten():
    """Common normals of axes that are parallel but for 7e-3 rad lie hundreds of metres away."""
    table = {
        "a": [0, -0.6127, -0.57155, 0, 0, 0],
        "alpha": [PI / 2, 0.0014, 0.0069, PI / 2, -PI / 2, 0],
        "d": [0.18, 439.14, -446.03, 6.886 + 0.174, 0.12, 0.117],
        "theta": [0, 1.6, -1.69, 0.09, 0, 0],
    }
    arm = ikjax.Arm.from_dh(**table, convention="standard")
    assert np.abs(np.asarray(arm.d)).max() < 20
    T = np.eye(4)
    q = np.array([0.3, -1.2, 0.8, 0.4, -0.9, 2.0])
    for i, turn in enumerate(q):
        s, c = np.sin(table["theta"][i] + turn), np.cos(table["theta"][i] + turn)
        sa, ca = np.sin(table["alpha"][i]), np.cos(table["alpha"][i])
        a, d = table["a"][i], table["d"][i]
        T = T @ [[c, -s * ca, s * sa, a * c], [s, c * ca, -c * sa, a * s], [0, sa, ca, d], [0, 0, 0, 1]]
    np.testing.assert_allclose(ikjax.fk(arm, q), T, atol=1e-10)
