"""Statistics say of every position what `solve`, the Jacobian and the limits say of its goals."""

import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import small

import ikjax
from ikjax.arm.forward import reach as reach_of
from ikjax.maps import statistics
from ikjax.maps.kernel import joint_measures

NAMES = (
    *("best_margin_within", "best_limit_share", "best_manipulability", "mean_manipulability_within"),
    *("best_sigma_min_within", "mean_sigma_min"),
)


@pytest.fixture(scope="module")
def arm():
    return ikjax.robots.gx4_351s()


@pytest.fixture(scope="module")
def solved(arm):
    """Solutions of the goals of the small sweep, (positions, orientations, ...)."""
    study = small.study()
    points, turned = study["positions"].points().reshape(-1, 1, 3), study["orientations"]
    goals = np.zeros((len(points), len(turned), 4, 4))
    goals[..., :3, :3], goals[..., :3, 3], goals[..., 3, 3] = turned, points, 1
    return ikjax.solve(arm, goals)


@pytest.fixture(scope="module")
def singular(arm, solved):
    """Singular values of the Jacobian in reaches, (positions, orientations, slots, n)."""
    size = float(reach_of(arm.baked()))
    jacobian = np.array(ikjax.jacobian(arm, solved.q))
    jacobian[..., :3, :] /= size
    jacobian[..., [kind == "P" for kind in arm.kinds]] *= size
    return np.linalg.svd(jacobian, compute_uv=False)


@pytest.fixture(scope="module")
def swept():
    own = [
        ikjax.maps.Measure("elbows", lambda sol: sol.valid.sum(-1), "sum"),
        ikjax.maps.Measure(
            "spread", lambda sol: jnp.abs(sol.q[..., 0, 1] - sol.q[..., 1, 1]), "sum", unit=2**-10
        ),
        ikjax.maps.Measure("least", lambda sol: jnp.where(sol.valid, sol.q[..., 2], jnp.inf).min(-1), "min"),
    ]
    return small.swept(statistics=[*NAMES, *own], dtype="float64")


def test_manipulability_and_sigma_min_are_those_of_the_jacobian(arm, swept, solved, singular):
    valid, inside = np.asarray(solved.valid), np.asarray(ikjax.within_limits(arm, solved).valid)
    volume, least = singular.prod(-1), singular[..., -1]
    flat = {name: value.reshape(-1) for name, value in swept.to_numpy().items()}
    assert 0 < inside.sum() < valid.sum() < valid.size

    def best(flags, value):
        return np.where(flags, value, 0).max((1, 2))

    def mean(flags, value):
        return np.where(flags, value, 0).sum((1, 2)) / np.maximum(flags.sum((1, 2)), 1)

    assert np.allclose(flat["best_manipulability"], best(valid, volume), atol=1e-6)
    assert np.allclose(flat["best_sigma_min_within"], best(inside, least), atol=1e-6)
    assert np.allclose(flat["mean_manipulability_within"], mean(inside, volume), atol=1e-6)
    assert np.allclose(flat["mean_sigma_min"], mean(valid, least), atol=1e-6)
    assert flat["best_manipulability"].max() > 0.1 and flat["mean_sigma_min"].max() > 0.05


def test_limit_distance_and_margin_are_those_of_the_best_solution(arm, swept, solved):
    inside = ikjax.within_limits(arm, solved)
    limited = np.isfinite(arm.limits).all(-1)
    lower, upper = np.asarray(arm.limits)[limited].T
    away = np.abs(np.asarray(inside.q)[..., limited] - (lower + upper) / 2)
    share = (1 - away / ((upper - lower) / 2)).min(-1)
    best = np.where(inside.valid, share, -np.inf).max((1, 2))
    found = swept.arrays["best_limit_share"].reshape(-1)
    hit = best >= 0
    assert hit.any() and np.allclose(found[hit], best[hit], atol=1e-6) and (found[~hit] < 0).all()
    assert np.isneginf(found[~np.asarray(solved.valid).any((1, 2))]).all()
    margin = np.where(inside.valid, solved.margin, -np.inf).max((1, 2))
    assert np.allclose(swept.arrays["best_margin_within"].reshape(-1), margin, atol=1e-6)


def lost_by_hand(arm, goals, rolls: int = 1):
    """Per joint, which goals (...,) a solution reaches within all other limits, and none within all."""
    turned = [goals @ np.asarray(ikjax.pose(rpy=(0, 0, k * 2 * np.pi / rolls))) for k in range(rolls)]

    def reached(limits):
        free = dataclasses.replace(arm, limits=limits)
        sols = [ikjax.within_limits(free, ikjax.solve(arm, goal)) for goal in turned]
        return np.any([np.asarray(sol.valid).any(-1) for sol in sols], axis=0)

    limits = np.asarray(arm.limits)
    within = reached(limits)
    unlimited = [np.where(np.arange(arm.n)[:, None] == j, [-np.inf, np.inf], limits) for j in range(arm.n)]
    return np.stack([reached(each) & ~within for each in unlimited], -1)


@pytest.mark.parametrize(("rolls", "certify"), [(1, False), pytest.param(3, True, marks=pytest.mark.slow)])
def test_limited_by_counts_what_one_joint_alone_loses(rolls, certify):
    arm = ikjax.robots.puma560()
    positions = ikjax.maps.grid((0.2, -0.6, -0.4), (0.8, 0.6, 0.8), 0.2)
    found = ikjax.sweep(
        arm,
        positions,
        16,
        statistics=["reachable", "reachable_within", "limited_by"],
        free_rolls=rolls,
        certify=certify,
        dtype="float32" if certify else "float64",
    )
    points, turned = positions.points().reshape(-1, 1, 3), found.rotations
    goals = np.zeros((len(points), len(turned), 4, 4))
    goals[..., :3, :3], goals[..., :3, 3], goals[..., 3, 3] = turned, points, 1
    lost = lost_by_hand(arm, goals, rolls).sum(1)
    assert (lost.sum(0) > 0).sum() >= 3  # several joints cost some
    np.testing.assert_array_equal(found.arrays["limited_by"].reshape(-1, arm.n), lost)
    shares = found.numbers()["limited_by"]
    np.testing.assert_allclose(shares, lost.sum(0) / found.goals)
    worst = int(np.argmax(shares))
    assert f"lost to one joint alone: joint{worst + 1} {shares[worst]:.2%}" in found.summary()


def test_a_measure_of_ones_own_is_reduced_exactly(swept, solved, tmp_path):
    flat = {name: value.reshape(-1) for name, value in swept.to_numpy().items()}
    assert (flat["elbows"] == np.asarray(solved.valid).sum((1, 2))).all()
    spread = np.abs(np.asarray(solved.q)[..., 0, 1] - np.asarray(solved.q)[..., 1, 1])
    assert np.abs(flat["spread"] - spread.sum(1)).max() <= 48 * 2**-11
    assert (flat["spread"] * 2**10 == np.round(flat["spread"] * 2**10)).all()
    least = np.where(solved.valid, np.asarray(solved.q)[..., 2], np.inf).min((1, 2))
    assert np.allclose(flat["least"], least, atol=1e-6)
    pytest.importorskip("tensorstore")
    swept.save(tmp_path / "map.zarr")
    assert small.bits(ikjax.ReachMap.load(tmp_path / "map.zarr")) == small.bits(swept)


@pytest.mark.slow
def test_bits_do_not_depend_on_units_and_another_program_is_another_study(tmp_path):
    pytest.importorskip("tensorstore")

    def names(step):
        own = ikjax.maps.Measure("turned", lambda sol: jnp.sin(step * sol.q[..., 0, 0]), "sum", unit=1e-3)
        return ["mean_manipulability", "mask", "branches_within", own]

    whole = small.swept(statistics=names(1))
    assert small.bits(small.swept(tmp_path / "map.zarr", statistics=names(1), chunk=(3, 5, 2))) == small.bits(
        whole
    )
    assert small.swept(tmp_path / "map.zarr", statistics=names(1), resume=True, chunk=None).units.kept == 6
    with pytest.raises(ValueError, match=r"statistics\.turned\.code: .* there, .* here"):
        small.swept(tmp_path / "map.zarr", statistics=names(2), resume=True, chunk=None)
    branches = whole.arrays["branches_within"]
    assert branches.shape == (8, 8, 2, 2) and 0 < branches.sum() == small.swept().solutions_within.sum()


def test_numbers_that_cannot_be_summed_exactly_are_refused():
    wild = ikjax.maps.Measure("wild", lambda sol: 1 / (sol.q[..., 0, 0] - sol.q[..., 0, 0]), "sum")
    with pytest.raises(ValueError, match="wild gave numbers that are not finite"):
        small.swept(statistics=[wild])


def test_without_limits_nothing_is_near_one(arm):
    free = dataclasses.replace(arm, limits=np.tile([-np.inf, np.inf], (4, 1)))
    reach = ikjax.sweep(free, **small.study(), statistics=["best_limit_share", "reachable"])
    assert (reach.arrays["best_limit_share"][reach.reachable > 0] == 1).all()


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: ikjax.maps.Measure("a b", len, "sum"), "name must be of small letters"),
        (lambda: ikjax.maps.Measure("a", len, "mean"), 'reduce must be "sum", "max" or "min"'),
        (lambda: ikjax.maps.Measure("a", len, "sum", unit=0), "unit must be a positive number"),
        (
            lambda: small.swept(statistics=[ikjax.maps.Measure("a", lambda sol: sol.q, "max")]),
            "one number a goal",
        ),
        (
            lambda: small.swept(statistics=[ikjax.maps.Measure("mask", lambda sol: 1, "max")]),
            "some of",
        ),
        (lambda: small.swept(statistics=["reachable", "reachable"]), "some of"),
    ],
)
def test_a_measure_that_is_none_is_refused(call, message):
    with pytest.raises(ValueError, match=message):
        call()


def test_means_of_many_solutions_are_rounded_so_that_sums_fit():
    for slots in (1, 2, 8, 16):
        for rolls in (1, 5, 36, 1024):
            whole = joint_measures.LARGEST / joint_measures.unit_of_mean(slots, rolls) * slots * rolls
            assert whole * statistics.GOALS_PER_WORD <= 2**31


def with_weights(weights) -> dict:
    """Functions that give other numbers with other weights, each holding them in another way."""
    w, array, key = np.asarray(weights), jnp.asarray(weights), jax.random.key(int(weights[0]))
    long = np.zeros(4000)
    long[2000:2002] = w  # where jax prints an ellipsis

    def weighted(x, w):
        return (x * w.reshape((1,) * (x.ndim - 1) + (-1,))).max(-1)

    inner = jax.jit(lambda x: weighted(x, array))
    ruled = jax.custom_jvp(lambda x: inner(x))
    ruled.defjvp(lambda x, t: (ruled(*x), ruled(*t)))

    class Thing:
        def __call__(self, sol):
            return jax.jit(lambda x: weighted(x, w))(sol.margin)

    return {
        "numpy": lambda sol: weighted(sol.margin, w),
        "a float": lambda sol: sol.margin.max(-1) * float(w[0]),
        "a last digit": lambda sol: sol.margin.max(-1) + (1 + 2.3e-16 * float(w[0])),
        "partial": functools.partial(lambda w, sol: weighted(sol.margin, w), w),
        "an object": Thing(),
        "jit": lambda sol: inner(sol.margin),
        "jit in jit": lambda sol: jax.jit(lambda x: inner(x))(sol.margin),
        "vmap of jit": lambda sol: jax.vmap(inner)(sol.margin),
        "grad of jit": lambda sol: jax.grad(lambda x: inner(x).sum())(sol.margin).max(-1),
        "cond": lambda sol: jax.lax.cond(sol.valid.any(), inner, lambda x: x.min(-1), sol.margin),
        "scan": lambda sol: jax.lax.map(inner, sol.margin),
        "while": lambda sol: jax.lax.fori_loop(0, 2, lambda i, x: x + inner(sol.margin), sol.margin.max(-1)),
        "remat": lambda sol: jax.checkpoint(inner)(sol.margin),
        "custom_jvp": lambda sol: ruled(sol.margin),
        "a long array": lambda sol: jax.jit(lambda x: x.max(-1) + jnp.asarray(long).sum())(sol.margin),
        "a key": lambda sol: jax.jit(lambda x: x.max(-1) + jax.random.normal(key, ()))(sol.margin),
    }


@pytest.mark.parametrize("name", with_weights([1.0, 1.0]))
def test_every_number_that_a_measure_holds_is_part_of_its_program(arm, name):
    first, again, other = (
        ikjax.maps.Measure("score", with_weights(w)[name], "max").facts(arm)["code"]
        for w in ([1.0, 1.0], [1.0, 1.0], [5.0, 5.0])
    )
    assert first == again != other


def test_what_a_measure_reads_from_outside_counts_as_it_is_when_the_sweep_begins():
    weight = [1.0]
    own = [ikjax.maps.Measure("score", lambda sol: weight[0] * sol.margin.max(-1), "max")]
    one = small.swept(statistics=own).arrays["score"]
    weight[0] = 4.0
    np.testing.assert_array_equal(small.swept(statistics=own).arrays["score"], 4 * one)


def test_a_measure_whose_program_cannot_be_told_is_refused(arm):
    calls = iter(range(100))

    def host(sol):
        shape = jax.ShapeDtypeStruct(sol.margin.shape[:-1], sol.margin.dtype)
        return jax.jit(lambda x: jax.pure_callback(lambda x: np.asarray(x).max(-1), shape, x))(sol.margin)

    for function, message in (
        (lambda sol: sol.margin.max(-1) * next(calls), "score must do the same whenever it is called"),
        (host, "score must be made by jax alone, got pure_callback"),
    ):
        with pytest.raises(ValueError, match=message):
            small.swept(statistics=[ikjax.maps.Measure("score", function, "max")])


def test_a_statistic_is_not_called_as_an_axis_of_the_map_is():
    for name in ("x", "rotations"):
        with pytest.raises(ValueError, match=f"cannot keep a statistic '{name}'"):
            small.swept(statistics=[ikjax.maps.Measure(name, lambda sol: sol.margin.max(-1), "max")])
