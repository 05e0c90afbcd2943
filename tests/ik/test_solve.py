"""`solve` as a whole: what raises, what agrees with what, and that bits depend on the goal alone."""

import dataclasses
import re
import subprocess
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import ikjax
from ikjax.core.xla import LARGEST_LOOP
from ikjax.ik.batched import FEW

ARM = ikjax.robots.get("puma560")
FIELDS = ("q", "valid", "margin", "continuum", "position_error", "rotation_error")


@pytest.fixture(scope="module")
def goals() -> np.ndarray:
    q = np.random.default_rng(5).uniform(-np.pi, np.pi, (5000, 6))
    return np.array(ikjax.fk(ARM, q))


def same_bits(sol, wanted, rows=slice(None)):
    for field in FIELDS:
        one, other = np.asarray(getattr(sol, field)), np.asarray(getattr(wanted, field))[rows]
        assert one.dtype == other.dtype and one.tobytes() == np.ascontiguousarray(other).tobytes(), field


def close(sol, wanted, dtype):
    np.testing.assert_array_equal(sol.valid, wanted.valid)
    np.testing.assert_array_equal(sol.continuum, wanted.continuum)
    off = np.abs(np.asarray(sol.q, float) - np.asarray(wanted.q, float))
    off = np.minimum(off, np.abs(off - 2 * np.pi)).max(-1)
    # Rounding of the goal over the distance from the nearest fold, which these goals keep.
    assert np.median(off) < 40 * np.finfo(dtype).eps
    assert off[np.asarray(wanted.valid)].max() < 1e5 * np.finfo(dtype).eps
    np.testing.assert_allclose(sol.margin, wanted.margin, atol=20 * np.finfo(dtype).eps)


class TestBits:
    @pytest.mark.parametrize("count", [0, 65, 1000, 4096])
    def test_they_do_not_depend_on_the_size_of_the_batch(self, goals, count, dtype):
        wanted = ikjax.solve(ARM, goals.astype(dtype))
        same_bits(ikjax.solve(ARM, goals[:count].astype(dtype)), wanted, slice(count))

    @pytest.mark.parametrize("count", [2, 3, 7])
    def test_they_do_not_depend_on_how_few_goals_there_are(self, goals, count, dtype):
        wanted = ikjax.solve(ARM, goals[:FEW].astype(dtype))
        same_bits(ikjax.solve(ARM, goals[:count].astype(dtype)), wanted, slice(count))

    def test_one_goal_and_few_and_many_agree_to_rounding(self, goals, dtype):
        goals = goals[:FEW].astype(dtype)
        many = jax.tree.map(lambda x: x[:FEW], ikjax.solve(ARM, np.concatenate([goals, goals])))
        close(ikjax.solve(ARM, goals), many, dtype)
        alone = [ikjax.solve(ARM, goal) for goal in goals]
        close(jax.tree.map(lambda *rows: np.stack(rows), *alone), many, dtype)

    def test_one_goal_and_many_answer_the_same_singular_goals(self, dtype):
        q = np.random.default_rng(4).integers(-3, 4, (200, 6)) * (np.pi / 2)
        goals = np.asarray(ikjax.fk(ARM, q)).astype(dtype)
        assert ikjax.solve(ARM, goals).valid.any(-1).all()
        assert all(ikjax.solve(ARM, goal).valid.any() for goal in goals)

    @pytest.mark.parametrize("count", [4097, 16384, 16385, 40_000])
    def test_they_do_not_depend_on_the_pieces_it_is_cut_into(self, goals, count, dtype):
        goals = goals.astype(dtype)
        many = np.resize(goals, (count, 4, 4))
        alone, together = ikjax.solve(ARM, goals[:4000]), ikjax.solve(ARM, many)
        for place in range(0, count - 4000, 5000):
            same_bits(jax.tree.map(lambda x, i=place: x[i : i + 4000], together), alone)
        same_bits(jax.tree.map(lambda x: x[-70:], together), ikjax.solve(ARM, many[-70:]))

    def test_they_do_not_depend_on_the_place_in_the_batch(self, goals, dtype):
        wanted = ikjax.solve(ARM, goals.astype(dtype))
        order = np.random.default_rng(1).permutation(len(goals))
        same_bits(ikjax.solve(ARM, goals[order].astype(dtype)), wanted, order)
        same_bits(ikjax.solve(ARM, goals[4095:4195].astype(dtype)), wanted, slice(4095, 4195))

    def test_batch_axes_do_not_matter(self, goals):
        same_bits(ikjax.solve(ARM, goals[17]), ikjax.solve(ARM, goals[17:18]), 0)

    def test_a_bad_row_leaves_the_others_alone(self, goals, dtype):
        wanted = ikjax.solve(ARM, goals.astype(dtype))
        bad = goals.astype(dtype)
        bad[[3, 4500], 1, 2] = np.nan, np.inf
        sol = ikjax.solve(ARM, bad)
        others = np.ones(len(goals), bool)
        others[[3, 4500]] = False
        assert not sol.valid[~others].any()
        assert all(np.isfinite(getattr(sol, f)).all() for f in FIELDS)
        same_bits(jax.tree.map(lambda x: x[others], sol), wanted, others)

    def test_q_now_of_other_rows_does_not_matter(self, goals):
        now = np.random.default_rng(2).uniform(-1e3, 1e3, (100, 6))
        wanted = ikjax.solve(ARM, goals[:100], now)
        same_bits(ikjax.solve(ARM, goals[20:90], now[20:90]), wanted, slice(20, 90))

    def test_q_now_only_enters_where_a_joint_is_arbitrary(self, goals):
        now = np.full((100, 6), 0.7)
        one, other = ikjax.solve(ARM, goals[:100], now), ikjax.solve(ARM, goals[:100], -now)
        assert not one.continuum.any()
        same_bits(one, other)


@pytest.mark.slow
def test_it_works_without_jit_for_debugging(goals):
    with jax.disable_jit():
        valid = ikjax.solve(ARM, goals[0]).valid
    np.testing.assert_array_equal(valid, ikjax.solve(ARM, goals[0]).valid)


def test_solutions_print_in_one_line(goals):
    sol = ikjax.solve(ARM, goals[:3].astype(np.float32))
    assert repr(sol) == "<Solutions of goals (3,), 8 slots of 6 joints, float32: 3 of 3 goals are answered>"
    shapes = jax.eval_shape(lambda T: ikjax.solve(ARM, T), goals[:3].astype(np.float32))
    assert repr(shapes) == "<Solutions of goals (3,), 8 slots of 6 joints, float32>"


@pytest.mark.parametrize("with_now", [False, True])
def test_every_field_has_the_type_of_the_goals(goals, dtype, with_now):
    now = np.zeros(6, dtype) if with_now else None
    shapes = [
        jax.eval_shape(lambda T: ikjax.solve(ARM, T, now), goals[:3].astype(dtype)),
        jax.eval_shape(lambda arm, T: ikjax.solve(arm, T, now), ARM, goals[:3].astype(dtype)),
        ikjax.solve(ARM, goals[:3].astype(dtype), now),
    ]
    for sol in shapes:
        for field in ("q", "margin", "position_error", "rotation_error"):
            assert getattr(sol, field).dtype == dtype, field
        assert sol.valid.dtype == bool and sol.continuum.dtype == bool


@pytest.mark.parametrize("with_now", [False, True])
def test_float32_goals_make_no_float64_program(goals, with_now):
    now = np.zeros(6, np.float32) if with_now else None
    jaxpr = jax.make_jaxpr(lambda arm, T: ikjax.solve(arm, T, now).q)(
        ARM.astype(np.float32), goals[:3].astype("f4")
    )
    wide = [line for line in str(jaxpr).splitlines() if "f64[3]" in line]
    assert not wide, f"{len(wide)} lines, the first {wide[0]}"


class TestInsideJit:
    def test_it_equals_the_eager_call(self, goals, costly_dtype):
        part = jnp.asarray(goals[:500], costly_dtype)
        close(jax.jit(lambda T: ikjax.solve(ARM, T))(part), ikjax.solve(ARM, part), costly_dtype)

    @pytest.mark.parametrize("name", ["puma560", pytest.param("ur5", marks=pytest.mark.slow)])
    def test_a_count_stays_one_loop_that_xla_keeps_whole(self, name):
        arm, goals = ikjax.robots.get(name), jnp.zeros((4096, 4, 4))
        program = jax.jit(lambda T: ikjax.solve(arm, T).valid.any(-1).sum()).lower(goals).compile().as_text()
        loops = re.findall(r"^%?[\w.]+ \(.*?^\}", program, re.MULTILINE | re.DOTALL)
        assert max(len(loop.splitlines()) for loop in loops) < LARGEST_LOOP

    def test_a_traced_arm_equals_the_eager_call(self, goals, costly_dtype):
        part = jnp.asarray(goals[:200], costly_dtype)
        close(_solved(ARM.astype(costly_dtype), part), ikjax.solve(ARM, part), costly_dtype)

    def test_counting_needs_nothing_else(self, goals):
        far = goals.copy()
        far[::3, :3, 3] *= 10
        count = jax.jit(lambda T: ikjax.solve(ARM, T).valid.any(-1).sum())(jnp.asarray(far))
        assert int(count) == int(np.asarray(ikjax.solve(ARM, far).valid).any(-1).sum())
        assert 0 < int(count) < len(goals)

    def test_many_arms_and_many_goals_compile_once(self, goals):
        sizes = np.linspace(0.8, 1.2, 4)
        arms = [dataclasses.replace(ARM, a=ARM.a * s, d=ARM.d * s) for s in sizes]
        stack = jax.tree.map(lambda *leaves: jnp.stack(leaves), *arms)
        part, traces = jnp.asarray(goals[:60]), []

        def count(arm, T):
            traces.append(1)
            return ikjax.solve(arm, T).valid.sum(-1)

        every = jax.jit(jax.vmap(lambda arm: jax.vmap(lambda T: count(arm, T))(part)))
        found = every(stack)
        every(jax.tree.map(lambda x: x * 1, stack))
        assert len(traces) == 1
        single = jax.jit(count)
        wanted = np.stack([single(arm, part) for arm in arms])
        np.testing.assert_array_equal(found, wanted)
        assert len(set(wanted.sum(1).tolist())) > 1

    @pytest.mark.parametrize(
        ("leaf", "joint", "value"),
        [
            ("a", 4, 0.05),
            ("a", 3, -0.1),
            ("d", 4, 0.07),
            ("alpha", 0, 1.4),
            ("alpha", 1, 0.1),
            ("alpha", 3, 1.2),
        ],
    )
    def test_an_arm_that_breaks_its_promise_is_never_answered_wrongly(self, goals, leaf, joint, value):
        broken = dataclasses.replace(ARM, **{leaf: getattr(ARM, leaf).at[joint].set(value)})
        part = jnp.asarray(goals[:200])
        sol = _solved(broken, part)
        found = ikjax.fk(broken, sol.q)
        gap = jnp.abs(found - part[:, None]).max((-2, -1))
        assert not (np.asarray(sol.valid) & (np.asarray(gap) > 1e-8)).any()
        assert not sol.valid.any()
        assert all(np.isfinite(getattr(sol, field)).all() for field in FIELDS)


_solved = jax.jit(ikjax.solve)


class TestRaises:
    def test_an_arm_without_a_family(self):
        arm = ikjax.Arm.from_dh(a=[0.1] * 6, alpha=[0.3] * 6, d=[0.2] * 6, convention="standard", name="odd")
        with pytest.raises(ValueError, match=r"odd has no closed form here: .*\. project\(\) takes"):
            ikjax.solve(arm, np.eye(4))

    @pytest.mark.parametrize("shape", [(), (5,), (2, 7)])
    def test_a_wrong_place(self, shape):
        with pytest.raises(ValueError, match=r"q_now must have shape \(\.\.\., 6\), got"):
            ikjax.solve(ARM, np.eye(4)[None], np.zeros(shape))

    def test_places_that_do_not_fit_the_goals(self):
        with pytest.raises(ValueError, match=r"q_now must .*\(3, 6\)"):
            ikjax.solve(ARM, np.tile(np.eye(4), (2, 1, 1)), np.zeros((3, 6)))

    def test_goals_of_a_wrong_type_inside_jit(self):
        with pytest.raises(ValueError, match="use float32 or float64"):
            jax.jit(lambda T: ikjax.solve(ARM, T).q)(jnp.eye(4, dtype=jnp.float16))


class TestRequire:
    def test_it_hands_on_what_is_solved(self, goals):
        sol = ikjax.solve(ARM, goals[:3])
        assert sol.require() is sol

    def test_it_names_the_goals_that_are_lost(self, goals):
        lost = goals[:8].copy()
        lost[[1, 2, 3, 4, 5, 6], 0, 3] += 5
        with pytest.raises(
            ValueError, match=r"6 of 8 goals have no solution: goal 1 \(margin -3\.53 m\), 2 .* and 1 more"
        ):
            ikjax.solve(ARM, lost).require()
        with pytest.raises(ValueError, match=r"goal \(0, 1\) \(margin"):
            ikjax.solve(ARM, lost.reshape(2, 4, 4, 4)).require()
        with pytest.raises(ValueError, match=r"1 of 1 goals have no solution"):
            ikjax.solve(ARM, lost[1]).require()

    def test_it_cannot_stand_inside_jit(self, goals):
        with pytest.raises(ValueError, match="cannot stand inside jit"):
            jax.jit(lambda T: ikjax.solve(ARM, T).require().q)(goals[:2])


def test_a_tolerance_widens_what_is_valid():
    stretched = np.eye(4)
    stretched[0, 3], stretched[1, 3] = 0.4318 + np.hypot(0.4318, 0.0203) + 1e-4, 0.15005
    assert not ikjax.solve(ARM, stretched).valid.any()
    sol = ikjax.solve(ARM, stretched, pose_tolerance=1e-3)
    assert sol.valid.any()
    assert float(sol.margin.max()) == pytest.approx(-1e-4, rel=1e-6)


X64_OFF = """
import warnings, numpy as np, ikjax
arm, goal = ikjax.robots.get("puma560"), np.eye(4)
with warnings.catch_warnings(record=True) as said:
    warnings.simplefilter("always")
    first = ikjax.solve(arm, goal)
    ikjax.solve(arm, goal)
    ikjax.solve(arm, goal.astype(np.float32))
texts = [str(w.message) for w in said if "x64" in str(w.message)]
print(len(said), len(texts), first.q.dtype, said[0].filename if said else None)
"""


def test_that_x64_is_off_is_said_once():
    done = subprocess.run([sys.executable, "-c", X64_OFF], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["1", "1", "float32", "<string>"], done.stdout
