"""What is probably in another unit is said once, at the caller's line, and values that are traced are not."""

import warnings

import jax
import numpy as np
import pytest

from ikjax.core.warn import MOST_LOOKED_AT, warn_of_degrees, warn_of_millimetres


@pytest.mark.parametrize(
    ("check", "values", "text"),
    [
        (warn_of_degrees, [0.0, -90.0, 180.0], "x holds 90 rad, which is 14.3 turns: degrees?"),
        (warn_of_degrees, np.array([[7, 0]]), "x holds 7 rad, which is 1.11 turns: degrees?"),
        (warn_of_millimetres, -431.8, "x adds up to 431.8 m: millimetres?"),
    ],
)
def test_it_is_said_once_with_the_argument_and_the_value(check, values, text):
    with pytest.warns(UserWarning) as seen:
        check("x", values)
    assert [str(w.message) for w in seen] == [text] and seen[0].filename == __file__


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(
    "values", [[], 6.2832, [-6.284], [np.inf, -np.inf, np.nan], [1e16], np.zeros((0, 6))]
)
def test_turns_infinities_and_numbers_of_no_unit_are_not_degrees(values):
    warn_of_degrees("x", values)


@pytest.mark.filterwarnings("error")
def test_values_that_are_traced_are_not_looked_at():
    jax.jit(lambda x: warn_of_degrees("x", x))(np.array([90.0]))
    jax.grad(lambda x: warn_of_degrees("x", [0.0, x]) or x)(90.0)
    jax.vmap(lambda x: warn_of_millimetres("x", x) or x)(np.array([90.0]))


def test_values_that_a_jit_captures_are_looked_at():
    captured = jax.numpy.array([0.0, 90.0])
    with pytest.warns(UserWarning, match="x holds 90 rad"):
        jax.jit(lambda y: warn_of_degrees("x", captured) or y)(1.0)


@pytest.mark.filterwarnings("error::UserWarning")
def test_slides_are_no_angles():
    values = np.array([[1.0, 200.0], [2.0, -300.0]])
    warn_of_degrees("x", values, kinds="RP")
    with pytest.warns(UserWarning, match="x holds 200 rad"):
        warn_of_degrees("x", values, kinds="PR")


def test_of_a_long_array_the_beginning_is_looked_at():
    values = np.zeros(MOST_LOOKED_AT + 1)
    values[-1] = 90
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warn_of_degrees("x", jax.numpy.asarray(values))
    with pytest.warns(UserWarning, match="degrees"):
        warn_of_degrees("x", values[1:])
