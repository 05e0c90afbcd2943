"""The signs of a family carry their names, however an arm is built."""

import dataclasses
import json

import pytest

import ikjax
from ikjax.arm.recognition.rules import RULES
from ikjax.arm.recognition.signs import SIGNS, PairSplit, PieperSigns, RegionalSplit, named_signs


def test_every_family_has_its_signs():
    assert list(SIGNS) == list(RULES)
    for name in ikjax.robots.names():
        arm = ikjax.robots.get(name)
        assert arm.family is None or type(arm.signs) is SIGNS[arm.family]


def test_a_plain_sequence_gets_its_names_back():
    arm = ikjax.robots.get("stanford")
    stored = json.loads(json.dumps(arm.signs))
    assert stored == list(arm.signs)
    again = dataclasses.replace(arm, signs=tuple(stored)).signs
    assert again == arm.signs and type(again) is PieperSigns
    assert isinstance(again.split, RegionalSplit) and hash(again) == hash(arm.signs)
    signs = named_signs("parallel_axes", [2, "within 1e-5", False, 1, 1, -1])
    assert signs.split is PairSplit.WITHIN_1E_5 and signs.split.is_split
    assert named_signs(None, [1, 2]) == (1, 2)


@pytest.mark.parametrize("values", [[1, 1], ["no such split", 1, 1, 1]])
def test_signs_that_the_family_does_not_have_are_refused(values):
    with pytest.raises(ValueError, match=r"signs of family pieper|no such split"):
        named_signs("pieper", values)
