"""An arm whose limits are shifted by whole turns gives the same results."""

import dataclasses

import jax
import numpy as np
import pytest

import ikjax
from ikjax.ik.multistart import sampling_ranges, scattered_starts

TURN = 2 * np.pi
LOWER, UPPER = [-1.2, -2.0, -0.15, -1.5], [1.6, 1.4, 0.0, 2.0]
ARM = dataclasses.replace(ikjax.robots.gx4_351s(), limits=np.stack([LOWER, UPPER], 1))
SHIFT = np.array([TURN, -2 * TURN, 0, TURN])
FURTHER = dataclasses.replace(ARM, limits=ARM.limits + SHIFT[:, None])
Q = np.random.default_rng(0).uniform(-2.5, 2.5, (40, 4)) * [1, 1, 0.03, 1] - [0, 0, 0.075, 0]
GOALS = np.array(ikjax.fk(ARM, Q))
OFF = GOALS.copy()
OFF[:, :3, 3] += np.random.default_rng(1).normal(size=(40, 3)) * 0.05


def in_limits(arm):
    return ikjax.within_limits(arm, ikjax.solve(arm, GOALS))


def both(function, atol=1e-9):
    """The results of a function for both arms are equal; those of the first are returned."""
    one, other = jax.tree.map(np.asarray, (function(ARM, 0 * SHIFT), function(FURTHER, SHIFT)))
    for x, y in zip(jax.tree.leaves(one), jax.tree.leaves(other), strict=True):
        np.testing.assert_allclose(y, x, rtol=0, atol=atol)
    return one


def test_solutions_within_limits_and_the_nearest_of_them():
    def chosen(arm, shift):
        sol = in_limits(arm)
        q, found = ikjax.nearest(arm, sol, Q + shift)
        every = np.where(np.asarray(sol.valid)[..., None], np.asarray(sol.q) - shift, 0)
        return every, sol.valid, (np.asarray(q) - shift)[found], found

    _, valid, _, found = both(chosen)
    assert 0 < valid.mean() < 0.5 and 0.1 < found.mean() < 0.9


def test_distances_to_limits_and_margins():
    both(
        lambda arm, _: (
            ikjax.limit_clearance(arm, Q),
            ikjax.limit_clearance(arm, Q + 3 * TURN * (SHIFT != 0)),
        )
    )
    both(lambda arm, _: ikjax.limited_margins(arm, ikjax.solve(arm, GOALS)).margin)
    both(lambda arm, _: ikjax.best_margin(arm, ikjax.solve(arm, GOALS), blur=0.01))


def test_maps_and_proofs():
    def swept(arm, _):
        names = ("reachable_within", "solutions_within", "best_margin_within", "best_limit_share")
        grid = ikjax.maps.grid((-0.3, -0.3, 0), (0.3, 0.3, 0.1), 0.1)
        return ikjax.sweep(arm, grid, np.array([np.diag([1.0, -1, -1]), np.eye(3)]), statistics=names).arrays

    assert both(swept, 1e-6)["solutions_within"].sum() > 0
    # A turning joint meets one limit alone by whole turns, wherever that is.
    open_ended = [
        dataclasses.replace(arm, limits=np.array([(arm.limits[0, 0], np.inf), *arm.limits[1:]]))
        for arm in (ARM, FURTHER)
    ]
    one, other = (swept(arm, 0)["best_limit_share"] for arm in open_ended)
    np.testing.assert_allclose(other, one, atol=1e-6)
    both(lambda arm, _: list(ikjax.verify(arm, 200)[3:-1]))


@pytest.mark.parametrize(
    "bounds", [(-1.2, 1.6), (-9.0, 9.0), (-1.2, np.inf), (-np.inf, 1.6), (-np.inf, np.inf)]
)
def test_starts_are_spread_over_the_limits_wherever_they_lie(bounds):
    arms = [dataclasses.replace(ARM, limits=np.array([np.add(bounds, k * TURN)] * 4)) for k in (0, 1)]
    one, other = (np.asarray(scattered_starts(arm, (3,), 64)) for arm in arms)
    low, high = arms[1].limits[0]
    assert (
        one.shape == (3, 64, 4)
        and np.isfinite(other).all()
        and (other >= low).all()
        and (other <= high).all()
    )
    turning = np.array([True, True, False, True])
    width = min(bounds[1] - bounds[0], TURN)
    assert (np.ptp(other[..., turning], axis=-2) > 0.8 * width).all()
    if np.isfinite(bounds).any():
        np.testing.assert_allclose(other, one + TURN, atol=1e-12)
    # A slide: all between two limits, else two reaches.
    ends = [float(end[2]) for end in sampling_ranges(arms[0])]
    reach = float(sum(abs(ARM.a)) + sum(abs(ARM.d)) + sum(abs(ARM.tool[:3, 3])))
    both_sides = np.isfinite(bounds).all()
    assert ends[1] - ends[0] == pytest.approx(bounds[1] - bounds[0] if both_sides else 2 * reach)
    assert all(e == b for e, b in zip(ends, bounds, strict=True) if np.isfinite(b))


def test_an_arm_of_slides_alone_has_starts_and_limits_may_be_traced():
    slides = ikjax.Arm.from_dh(
        a=[0, 0],
        alpha=[np.pi / 2, 0],
        d=[0, 0],
        kinds="PP",
        convention="standard",
        limits=[(1.5, 3), (2, np.inf)],
    )
    q = np.asarray(scattered_starts(slides, (), 32))
    assert (q >= [1.5, 2]).all() and (q <= [3, 4]).all() and (np.ptp(q, axis=0) > [1.2, 1.6]).all()
    traced = jax.jit(lambda arm: scattered_starts(arm, (), 32))(FURTHER)
    np.testing.assert_allclose(traced, scattered_starts(FURTHER, (), 32), atol=1e-12)


@pytest.mark.slow
def test_nearest_poses():
    def projected(arm, shift):
        near = ikjax.project(arm, OFF)
        return near.cost, np.asarray(near.q) - shift, near.converged

    assert both(projected, 1e-6)[2].all()
    both(lambda arm, shift: ikjax.refine(arm, OFF, Q).cost, 1e-9)
    both(lambda arm, shift: np.asarray(ikjax.refine(arm, OFF, Q + shift).q) - shift, 1e-6)

    def loss(arm, goal, q):
        return ((ikjax.fk(arm, q) - goal)[:3, 3] ** 2).sum()

    both(lambda arm, shift: ikjax.refine(arm, OFF[:4], Q[:4], loss=loss, steps=5).cost, 1e-9)


@pytest.mark.slow
def test_a_path():
    start, end = np.array([-1.0, -1.5, -0.1, -1.0]), np.array([1.5, -0.4, -0.02, 1.8])
    q = start + np.linspace(0, 1, 20)[:, None] * (end - start)
    goals = ikjax.fk(ARM, q)
    path = both(
        lambda arm, shift: (lambda p: (np.asarray(p.q) - shift, p.followed))(ikjax.track(arm, goals, start)),
        1e-7,
    )
    np.testing.assert_allclose(path[0], q, atol=1e-6)


@pytest.mark.slow
def test_places_and_designs():
    options = {"spacing": 0.2, "turns": 4, "starts": 2, "steps": 0}

    def stood(arm, _):
        found = ikjax.place(arm, GOALS, **options)
        return found.share, found.worst_margin, found.base

    both(stood, 1e-6)

    def designed(arm, _):
        made = ikjax.design(arm, GOALS, {"base.xyz": (-0.1, 0.1)}, steps=10, starts=2)
        return made.score, made.margin, list(made.values.values())

    both(designed, 1e-6)
