import dataclasses
import functools
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.flatten_util import ravel_pytree

import ikjax
from ikjax.arm.arm import Arm

PUMA = {
    "a": [0, 0.4318, 0.0203, 0, 0, 0],
    "alpha": np.multiply([90, 0, -90, 90, -90, 0], math.pi / 180),
    "d": [0, 0, 0.15005, 0.4318, 0, 0],
    "convention": "standard",
}
BASE = np.array([[0.36, 0.48, -0.8, 0.1], [-0.8, 0.6, 0, -0.2], [0.48, 0.64, 0.6, 0.3], [0, 0, 0, 1]])
TOOL = np.array([[0, -1.0, 0, 0.05], [1, 0, 0, 0.02], [0, 0, 1, 0.13], [0, 0, 0, 1]])
LEAVES = ("a", "alpha", "d", "theta", "base", "tool", "limits")


def fk(arm, q):
    """Compiled for this arm alone, which is quick."""
    return jax.jit(functools.partial(ikjax.fk, arm.baked()))(q)


def put(values, i, value):
    """A copy with one entry changed."""
    copy = np.array(values, float)
    copy[i] = value
    return copy


def awkward():
    """Every leaf in use, a sliding joint, no angle round."""
    return Arm.from_dh(
        a=[0.1, -0.4, 0.05, 0.2],
        alpha=[0.3, -1.2, math.pi / 2, 2.0],
        d=[0.3, 0.02, -0.1, 0.4],
        theta=[0.1, -0.2, 0.3, 2.9],
        kinds="RPRR",
        limits=[(-1, 2), (0, 0.5), (-math.pi, math.pi), (-math.inf, math.inf)],
        base=BASE,
        tool=TOOL,
        convention="standard",
        name="awkward",
    )


SUSPECT = [
    ({"alpha": [90, 0, -90, 90, -90, 0]}, "alpha holds 90 rad, which is 14.3 turns: degrees?"),
    ({"theta": [0, 0, 180, 0, 0, 0]}, "theta holds 180 rad, which is 28.6 turns: degrees?"),
    ({"limits": [(-185, 185)] * 6}, "limits holds 185 rad, which is 29.4 turns: degrees?"),
    ({"limits": [(-1, 1)] * 5 + [(-400, math.inf)]}, "limits holds 400 rad, which is 63.7 turns: degrees?"),
    ({"a": [0, 431.8, 20.3, 0, 0, 0]}, "a adds up to 452.1 m: millimetres?"),
    ({"d": [0, 0, 150.05, 431.8, 0, 0]}, "d adds up to 581.9 m: millimetres?"),
]


@pytest.mark.parametrize(
    ("change", "text"), SUSPECT, ids=lambda x: "" if isinstance(x, str) else next(iter(x))
)
def test_a_table_in_degrees_or_millimetres_is_noticed_once(change, text):
    with pytest.warns(UserWarning) as seen:
        Arm.from_dh(**{**PUMA, **change})
    assert [str(w.message) for w in seen] == [text] and seen[0].filename == __file__


@pytest.mark.filterwarnings("error")
def test_turns_and_arms_of_the_catalogue_are_not_taken_for_degrees():
    Arm.from_dh(**{**PUMA, "theta": [2 * math.pi] * 6, "limits": [(-4 * math.pi, 4 * math.pi)] * 6})
    # Calibrated: nearly parallel axes have their common normal far away, and come back.
    Arm.from_dh(**{**PUMA, "d": [0.1, 439.1, -439.2, 0.4, 0, 0]})
    Arm.from_dh(a=[1], alpha=[0], d=[0], kinds="P", limits=[(-400, 400)], convention="standard")
    jax.eval_shape(
        lambda theta: Arm.from_dh(**PUMA, theta=theta, family="ortho_parallel_wrist"), np.full(6, 90.0)
    )
    for name in ikjax.robots.names():
        ikjax.robots.get(name)


MISTAKES = [
    ({"a": put(PUMA["a"], 2, math.nan)}, r"a\[2\] \(joint 3\) must be a finite number, got nan"),
    ({"d": put(PUMA["d"], 0, -math.inf)}, r"d\[0\] \(joint 1\) must be a finite number, got -inf"),
    ({"alpha": put(PUMA["alpha"], 5, math.nan)}, r"alpha\[5\] \(joint 6\) must be a finite number"),
    ({"theta": put(np.zeros(6), 1, math.nan)}, r"theta\[1\] \(joint 2\) must be a finite number"),
    ({"a": put(PUMA["a"], 1, 1e300)}, r"a\[1\] \(joint 2\) must be a finite number, got 1e\+300"),
    ({"a": [0.4, 0.3]}, r"a, alpha and d must have one length, got .*\(2,\)"),
    ({"d": np.zeros((6, 1))}, r"d must have shape \(n,\) with n >= 1 joints, got \(6, 1\)"),
    ({"a": [], "alpha": [], "d": []}, r"a must have shape \(n,\) with n >= 1 joints, got \(0,\)"),
    ({"theta": np.zeros(5)}, r"theta must have shape \(6,\), got \(5,\)"),
    ({"a": ["x"] * 6}, "a must hold real numbers"),
    ({"d": np.zeros(6) + 1j}, "d must hold real numbers"),
    ({"convention": "craig"}, 'convention must be "standard" or "modified", got \'craig\''),
    ({"convention": None}, 'convention must be "standard" or "modified", got None'),
    ({"kinds": "RRRRR"}, 'kinds must be 6 letters "R" or "P", got \'RRRRR\''),
    ({"kinds": "RRXRRR"}, "kinds must be 6 letters"),
    ({"kinds": list("RRRRRR")}, "kinds must be 6 letters"),
    ({"limits": np.zeros((2, 6))}, r"limits must have shape \(6, 2\), got \(2, 6\)"),
    (
        {"limits": put(np.tile([-1.0, 1], (6, 1)), 3, [2, 1])},
        r"limits\[3\] \(joint 4\) must be lower <= upper",
    ),
    ({"limits": put(np.tile([-1.0, 1], (6, 1)), 0, [math.nan, 1])}, r"limits\[0\] \(joint 1\)"),
    ({"base": np.eye(3)}, r"base must have shape \(4, 4\), got \(3, 3\)"),
    ({"tool": np.eye(4) * math.nan}, "tool must hold finite numbers"),
    ({"tool": BASE.T}, r"tool must have bottom row \(0, 0, 0, 1\), got .*transposed\?"),
    ({"base": np.diag([1.0, 1, -1, 1])}, "base must hold a rotation"),
    ({"base": np.diag([1.0, 1, 1.001, 1])}, "base must hold a rotation, its R\\^T R - I has norm 0.002"),
    ({"family": "snake"}, "family must be one of ortho_parallel_wrist, .*got 'snake'"),
    ({"family": "three_parallel"}, "the arm is not of family three_parallel: axis 3 parallel to axis 4"),
]


@pytest.mark.parametrize(("change", "text"), MISTAKES, ids=[text[:30] for _, text in MISTAKES])
def test_a_mistake_is_named_when_the_arm_is_built(change, text):
    with pytest.raises(ValueError, match=text):
        Arm.from_dh(**{**PUMA, **change})


def test_the_convention_is_never_guessed():
    with pytest.raises(TypeError, match="convention"):
        Arm.from_dh(**{key: value for key, value in PUMA.items() if key != "convention"})


def test_limits_may_be_missing_equal_or_more_than_a_turn():
    np.testing.assert_array_equal(Arm.from_dh(**PUMA).limits, 6 * [[-math.inf, math.inf]])
    given = [(1, 1), (-7, 7), (-math.inf, 2), (0, math.inf), (-1, 1), (-1, 1)]
    np.testing.assert_array_equal(Arm.from_dh(**PUMA, limits=given).limits, given)


def test_twists_must_be_known_when_an_arm_is_built():
    with pytest.raises(ValueError, match="alpha must be concrete"):
        jax.jit(lambda alpha: Arm.from_dh(**{**PUMA, "alpha": alpha}))(PUMA["alpha"])


@pytest.mark.parametrize("column", ["a", "d"])
def test_traced_lengths_need_a_promised_family(column):
    with pytest.raises(
        ValueError, match="from_dh with traced lengths needs family=, one of ortho_parallel_wrist"
    ):
        jax.jit(lambda x: Arm.from_dh(**{**PUMA, column: x}))(np.array(PUMA[column]))


CRAIG = {
    "a": [0.05, 0, 0.4318, 0.0203, 0, 0],
    "alpha": np.multiply([0, -90, 0, -90, 90, -90], math.pi / 180),
    "d": [0.2, 0, 0.15005, 0.4318, 0, 0.1],
    "convention": "modified",
}


@pytest.mark.parametrize("table", [PUMA, CRAIG], ids=["standard", "modified"])
def test_an_arm_built_while_tracing_is_the_arm_built_before(table):
    whole = {**table, "base": np.diag([1.0, -1, -1, 1])}
    before = Arm.from_dh(**whole)
    inside = jax.jit(lambda a: Arm.from_dh(**{**whole, "a": a}, family="ortho_parallel_wrist"))(
        np.array(table["a"])
    )
    assert (inside.family, inside.branches, inside.signs) == (before.family, before.branches, before.signs)
    for key in LEAVES:
        np.testing.assert_allclose(getattr(inside, key), getattr(before, key), atol=1e-15, err_msg=key)


def test_modified_tables_place_the_tool_where_craig_does(rng):
    a, alpha, d, theta, q = rng.uniform(-2, 2, (5, 6))
    arm = Arm.from_dh(a=a, alpha=alpha, d=d, theta=theta, convention="modified", base=BASE, tool=TOOL)
    wanted = BASE
    for i, angle in enumerate(theta + q):
        c, s, ca, sa = np.cos(angle), np.sin(angle), np.cos(alpha[i]), np.sin(alpha[i])
        # Craig, Introduction to Robotics, 3rd ed., equation (3.6).
        rows = [[c, -s, 0, a[i]], [s * ca, c * ca, -sa, -sa * d[i]], [s * sa, c * sa, ca, ca * d[i]]]
        wanted = wanted @ np.array([*rows, [0, 0, 0, 1]])
    np.testing.assert_allclose(fk(arm, q), wanted @ TOOL, atol=1e-14)


def test_leaves_have_one_floating_type(dtype):
    for arm in (Arm.from_dh(**PUMA, dtype=dtype), Arm.from_dh(**PUMA).astype(dtype)):
        assert arm.dtype == dtype
        assert {leaf.dtype for leaf in jax.tree.leaves(arm)} == {np.dtype(dtype)}
        assert (arm.n, arm.kinds, arm.family) == (6, "RRRRRR", "ortho_parallel_wrist")


MOUNT = np.array([[0.36, 0.48, -0.8, 0.1], [-0.8, 0.6, 0, 0.2], [0.48, 0.64, 0.6, 0.3], [0, 0, 0, 1]])
TURNED = np.linalg.matrix_power(MOUNT, 3)
"""No two of its digits are alike."""


@pytest.mark.parametrize("rounded", [TURNED.round(6), TURNED.astype(np.float32).astype(float)])
def test_a_rounded_base_and_tool_are_rotations_all_the_same(rounded):
    arm = Arm.from_dh(**{**PUMA, "base": rounded, "tool": rounded})
    narrow = Arm.from_dh(**{**PUMA, "base": TURNED, "tool": TURNED}, dtype=np.float32)
    for each in (arm, narrow.astype(np.float64)):
        for mount in (each.base, each.tool):
            np.testing.assert_allclose(mount, TURNED, atol=2e-6)
            turn = np.asarray(mount)[:3, :3]
            np.testing.assert_allclose(turn.T @ turn, np.eye(3), atol=1e-15)
    exact = Arm.from_dh(**PUMA)
    np.testing.assert_array_equal(exact.astype(np.float32).astype(np.float64).alpha, exact.alpha)
    for each in (arm, narrow.astype(np.float64)):
        sol = ikjax.solve(each, fk(each, np.array([[0.1, 0.2, 0.3, 0.4, 0.5, 0.6]])))
        assert sol.valid.any()


def test_an_arm_split_and_joined_is_the_same(dtype):
    arm = awkward().astype(dtype)
    known, rest = arm.split()
    joined = Arm.join(known, rest)
    for key in LEAVES:
        np.testing.assert_array_equal(np.asarray(getattr(joined, key), dtype), getattr(arm, key), err_msg=key)
    assert joined.kinds == arm.kinds and joined.name == ""


def test_arms_that_differ_in_lengths_alone_share_what_is_known():
    known = Arm.from_dh(**PUMA).split()[0]
    longer, twisted, offset = (
        Arm.from_dh(**{**PUMA, key: put(PUMA[key], i, value)}).split()[0]
        for key, i, value in (("a", 1, 0.6), ("alpha", 3, 1.0), ("d", 5, 0.1))
    )
    assert known == longer and hash(known) == hash(longer)
    assert known != twisted and known != offset


def pasted(arm):
    return exec(str(arm), scope := {"Arm": Arm}) or scope["arm"]


@pytest.mark.parametrize("name", [*ikjax.robots.names(), "awkward"])
def test_a_printed_arm_can_be_pasted_back(name):
    arm = awkward() if name == "awkward" else ikjax.robots.get(name)
    again = pasted(arm)
    for key in LEAVES:
        np.testing.assert_allclose(
            getattr(again, key), getattr(arm, key), rtol=1e-11, atol=1e-12, err_msg=key
        )
    for fact in ("kinds", "name", "family", "signs", "branches", "task", "locked"):
        assert getattr(again, fact) == getattr(arm, fact)


@pytest.mark.parametrize("name", ['6" pipe arm', "two\nlines", "back\\slash"])
def test_a_strange_name_can_be_pasted_back(name):
    assert pasted(Arm.from_dh(**PUMA, name=name)).name == name.replace("\n", "\\n")


def test_a_traced_arm_prints_too():
    texts = []
    jax.jit(lambda arm: texts.append(str(arm)) or arm.a)(awkward())
    assert texts == ["<Arm awkward: RPRR, family None>"]


def test_an_arm_is_a_tree_of_numbers():
    arm = awkward()
    doubled = jax.tree.map(lambda leaf: 2 * leaf, arm)
    np.testing.assert_array_equal(doubled.d, 2 * arm.d)
    assert doubled.kinds == arm.kinds
    assert len(jax.tree.leaves(arm)) == len(LEAVES)
    longer = dataclasses.replace(arm, a=arm.a + 1.0)
    np.testing.assert_array_equal(longer.a, arm.a + 1)
    assert longer.d is arm.d


def test_many_arms_can_be_mapped_over(rng):
    lengths = rng.uniform(0.1, 1, (3, 4))
    arms = [dataclasses.replace(awkward(), a=jnp.asarray(a)) for a in lengths]
    stacked = jax.tree.map(lambda *leaves: jnp.stack(leaves), *arms)
    q = rng.uniform(-1, 1, 4)
    together = jax.jit(jax.vmap(ikjax.fk, (0, None)))(stacked, q)
    np.testing.assert_allclose(together, np.stack([fk(arm, q) for arm in arms]), atol=1e-15)


def test_every_number_of_an_arm_has_its_gradient(rng):
    arm = Arm.from_dh(
        a=[0.1, -0.4], alpha=[0.3, math.pi / 2], d=[0.3, 0.02], kinds="RP", convention="standard"
    )
    flat, unravel = ravel_pytree(dataclasses.replace(arm, base=jnp.asarray(BASE), tool=jnp.asarray(TOOL)))
    weights, step = rng.uniform(-1, 1, (4, 4)), 1e-6

    def height(x):
        return (ikjax.fk(unravel(x), np.array([0.7, 0.2])) * weights).sum()

    moved = np.asarray(flat) + step * np.eye(flat.size) * np.array([1, -1])[:, None, None]
    above, below = jax.jit(jax.vmap(jax.vmap(height)))(moved)
    gradient = jax.jit(jax.grad(height))(flat)
    np.testing.assert_allclose(gradient, (above - below) / (2 * step), atol=1e-9)
    gradient = unravel(gradient)
    np.testing.assert_array_equal(gradient.limits, 0)
    for key in LEAVES[:-1]:
        # All of them matter, but for the bottom rows of the poses.
        assert np.all(getattr(gradient, key)[:3] != 0), key
