"""The long form: a million random goals for each arm of the catalogue."""

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
@pytest.mark.parametrize("name", ikjax.robots.names())
class TestMillion:
    def test_float64_makes_no_mistake(self, name):
        assert _tally(name, np.float64) == (0, 0, 0)

    def test_float32_is_never_wrong(self, name, capsys):
        wrong, none, missing = _tally(name, np.float32)
        with capsys.disabled():
            print(f"\n{name} float32: {none} of {COUNT} goals without an answer, {missing} joints missing")
        assert wrong == 0
        assert none < COUNT * 1e-4
