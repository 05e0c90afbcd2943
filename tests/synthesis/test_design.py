"""Arms designed by gradient: known optima, ties, bounds, constraints, structure, bad rows."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest

import ikjax
from ikjax.synthesis.parameters import Parameters, choose_parameters

INNER, OUTER = 0.3, 1.0
BEST = (INNER + OUTER) / 2
"""Length of both links with the greatest clearance to both rims of a ring, for the least total length."""


def ring(dtype=np.float64, count=12):
    r = np.linspace(INNER, OUTER, count)
    return ikjax.position(r, 0 * r, 0 * r).astype(dtype)


def clearance_for_length(arm, sol, blur):
    return ikjax.objectives.worst_margin(arm, sol, blur) - 0.5 * arm.a.sum()


def never(arm, sol, blur):
    return sol.margin.sum() * np.nan


def study(**settings):
    settings = {"blur": (0.1, 1e-4), "steps": 250, "starts": 3, "vary": {"a": (0.1, 2.0)}, **settings}
    return ikjax.design(ikjax.robots.planar_2r(0.9, 0.3), settings.pop("goals", ring()), **settings)


@pytest.fixture(scope="module")
def found():
    return study(objective=clearance_for_length, steps=400)


def test_a_known_optimum_is_reached_from_every_start(found):
    assert np.abs(found.numbers - BEST).max() < 1e-4
    assert found.reached.all() and found.history.shape == (400, 3)
    np.testing.assert_allclose(found.score, INNER - BEST, atol=1e-4)
    assert found.start_score < found.score - 0.3


def test_the_report_says_what_moved_and_what_is_out_of_reach(found):
    text = found.report()
    assert "a1       +0.65" in text and "12 of 12 reached" in text
    lost = dataclasses.replace(found, reached=np.arange(12) != 4, margin=np.full(12, -0.02))
    assert "goal 4 at (0.555, 0.000, 0.000): 20.0 mm out of reach" in lost.report()


def test_rows_that_are_no_poses_change_nothing_but_the_report(found):
    bad = np.full((2, 4, 4), np.nan)
    again = study(objective=clearance_for_length, steps=400, goals=np.concatenate([bad, ring()]))
    np.testing.assert_array_equal(again.numbers, found.numbers)
    np.testing.assert_array_equal(again.left_out, [0, 1])
    assert "left out: 2 rows" in again.report()


def test_a_local_search_improves_the_result_and_never_makes_it_worse(found):
    again = study(objective=clearance_for_length, steps=400, local_search=300)
    assert again.score >= found.score and again.scores.max() == found.scores.max()
    assert np.abs(np.array(list(again.values.values())) - BEST).max() < 1e-5


def test_a_search_alone_finds_an_optimum_on_a_bound():
    vary = {"a": (0.7, 2.0)}
    alone = study(objective=clearance_for_length, vary=vary, steps=0, local_search=600)
    np.testing.assert_allclose(list(alone.values.values()), 0.7, atol=1e-6)
    np.testing.assert_allclose(alone.score, INNER - 0.7, atol=1e-6)


def test_a_search_meets_a_constraint_before_it_looks_at_the_score():
    # The best of all arms 1.2 long may have 1.1 only: every step towards that makes the score worse.
    short, arm = (lambda arm: arm.a.sum() - 1.1,), ikjax.robots.planar_2r(0.6, 0.6)
    vary = {"a": (0.1, 2.0)}
    alone = ikjax.design(
        arm, ring(), vary, "worst_margin", constraints=short, starts=1, steps=0, local_search=101
    )
    assert alone.violation < 1e-4
    np.testing.assert_allclose([alone.start_score, alone.score], [0.2, 0.1], atol=1e-3)


def test_a_constraint_holds_in_the_end():
    # The greatest clearance for a total length of 1.3: both links alike.
    short = study(objective="worst_margin", constraints=(lambda arm: arm.a.sum() - 1.3,), steps=400)
    assert short.violation < 1e-4
    np.testing.assert_allclose(short.numbers, BEST, atol=2e-3)


def test_a_constraint_may_be_an_inequality_in_words(rng):
    arm, vary = ikjax.robots.planar_2r(0.9, 0.3), {"a": (0.1, 2.0)}
    for rule in ("a1 + a2 <= 1.3", "1.3 >= a1 + a2", "a1 - 1.3 <= -1 * a2", "-a1 - a2 >= -1.3"):
        made = choose_parameters(arm, vary, inequalities=[rule])
        for a1, a2 in rng.uniform(0.1, 2, (5, 2)):
            np.testing.assert_allclose(made.violations(jnp.array([a1, a2])), [a1 + a2 - 1.3], atol=1e-12)
    found = ikjax.design(arm, ring(), vary, constraints="a1 + a2 <= 1.3", starts=1, steps=0)
    assert found.violation == pytest.approx(-0.1)


def test_a_constraint_that_is_no_number_is_not_met():
    def short(arm):
        return jnp.log(0.45 - arm.a[1])  # negative below 0.45, no number above

    def length(arm, sol, blur):
        return arm.a.sum()

    given, vary, rule = ikjax.robots.planar_2r(0.6, 0.5), {"a2": (0.3, 0.7)}, [short]
    alone, made = (
        ikjax.design(given, ring(), vary, length, constraints=rule, starts=starts, steps=0)
        for starts in (1, 12)
    )
    assert alone.violation == np.inf and "constraints: the worst is +inf" in alone.report()
    assert made.violation <= 0 and made.values["a2"] < 0.45 and made.score < alone.score


@pytest.mark.slow
def test_ties_hold_on_the_way_to_the_best_manipulability():
    # Of all triangles with one perimeter and one base, the isosceles one has the largest area.
    tied = study(objective="mean_manipulability", ties=["a1 + a2 = 1.3"], optimizer=optax.sgd(3.0))
    np.testing.assert_allclose(tied.numbers, BEST, atol=2e-3)
    np.testing.assert_allclose(tied.numbers.sum(-1), 1.3, atol=1e-12)
    assert (np.diff(tied.history, axis=0) > -1e-12).all()


@pytest.mark.slow
def test_a_base_moves_to_where_the_goals_are():
    arm = ikjax.robots.planar_2r().astype(np.float32)
    goals = ring(np.float32).at[:, 1, 3].add(3.0)
    vary = {"base.xyz": ((-0.5, 0, -1), (0.5, 4, 1), (True, True, False)), "base.rz": (-1, 1)}
    moved = ikjax.design(arm, goals, vary, "coverage", steps=100, starts=2, batch=6)
    assert set(moved.values) == {"base.x", "base.y", "base.rz"}
    assert moved.start_score == 0 and moved.reached.mean() > 0.6
    turn = np.asarray(moved.arm.base)[:2, :2]
    np.testing.assert_allclose(np.arctan2(turn[1, 0], turn[0, 0]), moved.values["base.rz"], atol=1e-5)
    sol = ikjax.within_limits(moved.arm, ikjax.solve(moved.arm, goals))
    np.testing.assert_array_equal(moved.reached, sol.valid.any(-1))


TIED = Parameters(
    ("a1", "a2", "a3", "d1"),
    (0.1, -1.0, 0.2, 0.0),
    (0.9, 1.0, 0.8, 2.0),
    ((1, -1, 1, 0, 0.7), (0, 2, 0, 1, 1.2)),
)


def test_bounds_and_ties_hold_for_any_coordinates(rng):
    values = np.asarray(jax.jit(jax.vmap(TIED.values))(jnp.asarray(rng.normal(size=(500, 4)) * 4)))
    assert (values >= np.array(TIED.lower)).all() and (values <= np.array(TIED.upper)).all()
    ties = np.array(TIED.ties)
    np.testing.assert_allclose(values @ ties[:, :-1].T, np.broadcast_to(ties[:, -1], (500, 2)), atol=1e-9)


def test_derivatives_of_tied_numbers_are_those_of_differences(rng):
    z = jnp.asarray(rng.normal(size=4))
    numbers, step = jax.jit(TIED.values), 1e-5
    exact = jax.jacfwd(numbers)(z)
    rough = [(numbers(z + step * e) - numbers(z - step * e)) / (2 * step) for e in np.eye(4)]
    np.testing.assert_allclose(exact, np.stack(rough, -1), atol=1e-8)
    np.testing.assert_allclose(jax.jacrev(numbers)(z), exact, atol=1e-12)


def test_the_given_numbers_are_where_a_study_starts():
    arm = ikjax.robots.puma560()
    made = choose_parameters(
        arm, {"a2": (0.2, 0.6), "d4": (0.3, 0.6), "tool": (-0.1, 0.2), "base.rz": (-3, 3)}
    )
    values = made.values(jnp.asarray(made.coordinates(made.of(arm))))
    np.testing.assert_allclose(values, [0.4318, 0.4318] + [0] * 7, atol=1e-12)
    same = made.put(arm, values)
    for one, other in zip(jax.tree.leaves(arm), jax.tree.leaves(same), strict=True):
        np.testing.assert_allclose(one, other, atol=1e-12)


def test_what_is_free_is_what_keeps_the_family():
    assert set(ikjax.robots.puma560().free) >= {"a1", "a2", "a3", "d1", "d4", "theta2"}
    assert not set(ikjax.robots.puma560().free) & {"alpha1", "alpha2", "a4", "a5", "d5"}
    assert "d5" in ikjax.robots.ur5e().free


@pytest.mark.parametrize(
    "vary, ties, message",
    [
        ({}, (), r"vary must name what may move: free are a1, a2"),
        (
            {"d5": (0, 0.1)},
            (),
            r"d5 = .* takes puma560 out of the family ortho_parallel_wrist: .*meet.*free are a1",
        ),
        ({"alpha1": (1, 2)}, (), r"alpha1 = .* perpendicular"),
        ({"alpha4": (-1.5, 1.5)}, (), r"alpha4 = .*"),
        ({"a7": (0, 1)}, (), r"'a7' is no number of puma560.*free are"),
        ({"q": (0, 1)}, (), r"'q' is no number"),
        ({"base.w": (0, 1)}, (), r"'base.w' is no number"),
        ({"a2": (0.5, 0.2)}, (), r"finite lower < upper for a2"),
        ({"a2": 0.5}, (), r"must be \(lower, upper\)"),
        ({"a2": (0.2, 0.5), "a": (0.1, 0.5)}, (), r"names a2 twice"),
        ({"a2": (0.2, 0.5)}, ["a2 + d4"], r"an equation"),
        ({"a2": (0.2, 0.5)}, ["a2 + wrong = 1"], r"cannot read 'wrong'"),
        ({"a2": (0.2, 0.5)}, ["d4 = 1"], r"nothing that varies"),
        ({"a2": (0.2, 0.5)}, ["a2 + base.x = 1"], r"base.x, which does not vary"),
        ({"a2": (0.2, 0.5)}, "a2 = -0.1", r"'a2 = -0.1' cannot be met within the bounds"),
        ({"a2": (0.2, 0.5)}, ["a2 + d4 = 2"], r"cannot be met within the bounds"),
    ],
)
def test_what_cannot_be_moved_is_refused_by_name(vary, ties, message):
    with pytest.raises(ValueError, match=message):
        ikjax.design(ikjax.robots.puma560(), np.eye(4), vary, ties=ties)


def test_fixed_numbers_count_in_a_tie():
    arm = ikjax.robots.puma560()
    made = choose_parameters(arm, {"a2": (0.1, 0.9)}, ["2 a2 = d4 + 0.2"])
    np.testing.assert_allclose(made.values(jnp.zeros(1)), [(0.4318 + 0.2) / 2], atol=1e-12)


@pytest.mark.parametrize(
    "change, message",
    [
        ({"objective": "beauty"}, "objective must be a function or one of coverage, dexterous_share"),
        ({"goals": np.full((3, 4, 4), np.nan)}, "none of them is one"),
        ({"starts": 0}, "starts must be at least 1"),
        ({"batch": 0}, "batch must be at least 1"),
        ({"blur": (0, 0)}, "blur must be two positive numbers"),
        ({"constraints": lambda arm: arm.a.sum()}, "constraints must be a sequence of functions"),
        ({"constraints": [lambda arm: arm.a.sum() <= 1.3]}, r"not whether it is: .*<lambda> returns bool"),
        ({"constraints": [lambda arm: arm.n == 2]}, "returns bool"),
        ({"constraints": [1.3]}, "must be a function or an inequality such as .*, got 1.3"),
        ({"constraints": ["a1 + a2 = 1.3"]}, "a constraint must be a function or an inequality"),
        ({"constraints": ["a1 <= "]}, "a constraint must have something on both sides"),
        ({"constraints": ["a1 <= 1 <= a2"]}, "a constraint must be a function or an inequality"),
        ({"constraints": ["d1 <= 1"]}, "the constraint 'd1 <= 1' speaks of nothing that varies"),
        ({"constraints": ["a1 + b <= 1"]}, "cannot read 'b' in the constraint"),
        ({"objective": never, "steps": 0}, "objective must give a number for some arm"),
        ({"objective": "dexterous_share"}, r"dexterous_share wants goals \(positions, orientations"),
    ],
)
def test_other_mistakes_are_named(change, message):
    with pytest.raises(ValueError, match=message):
        study(**{"objective": "coverage", **change})
