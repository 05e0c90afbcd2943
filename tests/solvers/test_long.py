"""The long form: a million random goals for each arm and each family."""

import dataclasses

import arm_patterns
import arms
import numpy as np
import pytest

import ikjax

COUNT, BATCH = 10**6, 50_000


def _tally(name, dtype):
    """Wrong slots, goals without an answer, generating joints missing where the arm is regular."""
    arm = arms.build(name)
    wrong = none = missing = 0
    for part in range(COUNT // BATCH):
        q = arms.joints(name, BATCH, seed=100 + part)
        goals = arms.numpy_fk(arm, q)
        sol = arms.solve(arm, goals, dtype=dtype)
        wrong += int(arms.wrong(arm, sol, goals, dtype).sum())
        none += int((~sol.valid.any(-1)).sum())
        missing += int(arms.missing(arm, sol, q, dtype).sum())
    return wrong, none, missing


@pytest.mark.long
@pytest.mark.parametrize("name", arms.CATALOGUE)
class TestMillion:
    def test_float64_makes_no_mistake(self, name):
        assert _tally(name, np.float64) == (0, 0, 0)

    def test_float32_is_never_wrong(self, name, capsys):
        wrong, none, missing = _tally(name, np.float32)
        with capsys.disabled():
            print(f"\n{name} float32: {none} of {COUNT} goals without an answer, {missing} joints missing")
        assert wrong == 0
        assert none < COUNT * 1e-4


EVERY = {
    "parallel_axes": "2, 3, 4 parallel",
    "offset_wrist": "offset wrist",
    "offset_wrist_reversed": "offset wrist, reversed",
    "pieper": "RRR, wrist",
    "pieper_reversed": "wrist first, RRRRRR",
}
EVERY |= {"position": "RRR, point", "scara": "SCARA RRPR", "turret": "turret", "planar_pose": "3R"}
EVERY |= {"five_axis": "five axes, lateral"}


@pytest.mark.long
@pytest.mark.parametrize("family", EVERY)
def test_a_million_goals_of_every_other_family(family, dtype, capsys):
    arm = arm_patterns.build(EVERY[family])
    exact = dtype == np.float64
    eps = np.finfo(dtype).eps
    bound = arms.TOLERANCE[np.dtype(dtype).name] + 40 * eps
    # A pose is right to some 64 eps, joints to that over sigma_min, beside a fold to its square root.
    close, root = (1e-8, 1e-3) if exact else (20 * 64 * eps, np.sqrt(20 * 64 * eps))
    regular = 1e-6 if exact else 1e-2
    assert arm.family == family
    wrong = none = missing = 0
    for part in range(COUNT // BATCH):
        q = arm_patterns.joints(arm, BATCH, seed=100 + part)
        goals = arms.numpy_fk(arm, q)
        sol = ikjax.solve(arm, goals.astype(dtype))
        sol = ikjax.Solutions(**{k: np.asarray(v) for k, v in vars(sol).items()})
        sol = dataclasses.replace(sol, q=sol.q.astype(np.float64))
        goals = goals.astype(dtype).astype(np.float64)
        gap, turn = arm_patterns.errors(arm, sol.q, goals[:, None])
        size = arms.reach(arm) + np.linalg.norm(goals[:, :3, 3], axis=-1)[:, None]
        wrong += int((sol.valid & ((gap > bound * size) | (turn > bound))).sum())
        none += int((~sol.valid.any(-1)).sum())
        off = np.abs(sol.q - q[:, None])
        off = np.where([kind == "R" for kind in arm.kinds], np.abs(arms.wrapped(off)), off).max(-1)
        least = arm_patterns.sigma_min(arm, q)
        near = np.where(sol.valid, off, np.inf).min(-1)
        allowed = np.minimum(close / np.maximum(least, 1e-300), root)
        missing += int(((near > allowed) & (least > regular)).sum())
    with capsys.disabled():
        print(
            f"\n{family} {dtype.__name__}: of {COUNT} goals {wrong} slots wrong, "
            f"{none} without an answer, {missing} missing"
        )
    assert wrong == 0
    assert (none, missing) == (0, 0) if exact else none < COUNT * 1e-4
