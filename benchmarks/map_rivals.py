"""Maps of rivals, on the same grids in the same run: EAIK in a loop, and sampled joints."""

import sys
import time

import map_child
import map_pictures
import map_sampled
import numpy as np
import report
import rivals

import ikjax

ARM = "puma560"
WITHIN = "mask_within"
EAIK_GOALS, EAIK_QUICK, EAIK_ORIENTATIONS = 2e6, 2e4, 64
EAIK_BATCH = 2**14
CELLS, CELLS_QUICK = 3.4e7, 2e6
LEVEL = 1
SAMPLES, SAMPLES_QUICK = (10**6, 10**7, 10**8, 10**9), (10**5, 10**6, 10**7)
RUNS = 3
ERRORS = ("positions missed", "positions more", "cells missed", "cells more", "dexterity off by")
OWN = "cells missed, met later"


def measure(given) -> str:
    """All tables, as Markdown; a picture is written too."""
    arm = ikjax.robots.get(ARM)
    return f"## Rivals\n\n{_eaik(arm, given.quick)}\n\n{_sampled(arm, given)}"


def swept(arm, grid, orientations, statistics) -> tuple[ikjax.ReachMap, float]:
    """Our map, and the seconds of the median run, without compile time."""
    sweep = {"positions": grid, "orientations": orientations, "statistics": statistics, "dtype": "float32"}
    runs = sorted((ikjax.sweep(arm, **sweep) for _ in range(RUNS)), key=lambda reach: reach.seconds)
    return runs[RUNS // 2], runs[RUNS // 2].seconds


def _eaik(arm, quick: bool) -> str:
    """A map by EAIK: goals are made, solved, checked against the limits and counted, all timed."""
    grid = map_child.grid_of(arm, EAIK_QUICK if quick else EAIK_GOALS, EAIK_ORIENTATIONS)
    try:
        robot = rivals.eaik_robot(arm)
    except rivals.AbsentError as absent:
        return f"EAIK: absent: {absent}"
    turns, points = ikjax.maps.even_rotations(EAIK_ORIENTATIONS), grid.points().reshape(-1, 3)
    counts, solving, started = np.zeros(grid.count, np.int32), 0.0, time.perf_counter()
    step = EAIK_BATCH // EAIK_ORIENTATIONS
    for first in range(0, grid.count, step):
        here = points[first : first + step]
        poses = np.broadcast_to(np.eye(4), (len(here), EAIK_ORIENTATIONS, 4, 4)).copy()
        poses[..., :3, :3], poses[..., :3, 3] = turns, here[:, None]
        goals = list(poses.reshape(-1, 4, 4))
        begun = time.perf_counter()
        found = robot.IK_batched(goals, rivals.THREADS)
        solving += time.perf_counter() - begun
        counts[first : first + step] = _reached(arm, found).reshape(len(here), -1).sum(1)
    seconds = time.perf_counter() - started
    goals = grid.count * EAIK_ORIENTATIONS
    ours, own = swept(arm, grid, turns, ("reachable_within",))
    gap = counts - ours.reachable_within.reshape(-1)
    rows = [
        ["EAIK in the loop", "float64", goals / seconds],
        ["EAIK's own calls in it", "float64", goals / solving],
        ["ikjax.sweep", "float32", goals / own],
    ]
    body = [
        [*names, report.figure(rate / 1e6), report.figure(goals / own / rate, "x")] for *names, rate in rows
    ]
    return (
        f"{arm.name}, {goals:,} goals ({grid.count:,} positions x {EAIK_ORIENTATIONS} orientations), within "
        f"the joint limits. Both count the reached orientations of every position: {(gap != 0).sum():,} "
        f"positions differ, by {np.abs(gap).sum():,} of {ours.reachable_within.sum():,} goals reached.\n\n"
        + report.table(["what", "type", "M goals/s", "ours is faster by"], body)
    )


def _reached(arm, found: list) -> np.ndarray:
    """Whether each goal has an exact answer within the limits, at any whole turn."""
    sizes = [len(each.Q) for each in found]
    joints = np.concatenate([each.Q for each in found if len(each.Q)])
    exact = ~np.concatenate([np.asarray(each.is_LS, bool) for each in found if len(each.Q)])
    low, high = np.asarray(arm.limits, float).T
    exact &= ((joints - low) % (2 * np.pi) <= high - low).all(1)
    return np.bincount(np.repeat(np.arange(len(found)), sizes), exact, len(found)) > 0


def _sampled(arm, given) -> str:
    """A map of sampled joints compared with ours, cell by cell, for growing numbers of samples."""
    orientations = ikjax.maps.hopf(LEVEL)
    cells, samples = (CELLS_QUICK, SAMPLES_QUICK) if given.quick else (CELLS, SAMPLES)
    grid = map_child.grid_of(arm, cells, orientations.count)
    ours, own = swept(arm, grid, orientations, (WITHIN,))
    _, usual = swept(arm, grid, orientations, ("reachable_within",))
    truth = ours.reached()
    theirs = map_sampled.Sampler(arm, grid, orientations)
    theirs.check()
    body, shown, all_marks = [], [], []
    for count in samples:
        theirs.sample_until(count)
        marks = theirs.marks()
        errors = compare(truth, marks)
        shown.append((theirs.samples, marks.sum(-1) / orientations.count, errors))
        rates = [theirs.samples / theirs.seconds / 1e6, theirs.seconds / own]
        body.append([f"{theirs.samples:,}", f"{theirs.seconds:.2f}", *(report.figure(x) for x in rates)])
        columns = {key: f"{errors[key]:.2%}" for key in ERRORS}
        columns["cells missed"] += f" ({(truth & ~marks).sum():,})"
        body[-1] += columns.values()
        all_marks.append(marks.copy())
        print(" | ".join(body[-1]), file=sys.stderr, flush=True)
    for line, marks in zip(body, all_marks, strict=True):
        line.append(f"{compare(all_marks[-1] | truth, marks)['cells missed']:.2%}")
    map_pictures.sampled(ours, shown, given.pictures / "maps_sampled.png")
    head = ["samples", "seconds", "M samples/s", "x our time", *ERRORS, OWN]
    return (
        f"{arm.name}, {truth.size:,} cells ({grid.count:,} positions {1000 * grid.spacing:.0f} mm apart x "
        f"{orientations.count} orientations), within the joint limits. Ours: {own:.2f} s, "
        f"{truth.size / own / 1e6:.0f} M goals/s, for a bit of every cell ({usual:.2f} s, "
        f"{truth.size / usual / 1e6:.0f} M goals/s, for the counts alone); {truth.sum():,} cells of "
        f"{truth.any(-1).sum():,} positions are reached.\n\n"
        f"{report.table(head, body)}\n\n"
        "![Our map, sampled ones, and where they differ](../docs/maps_sampled.png)"
    )


def compare(truth: np.ndarray, marks: np.ndarray) -> dict[str, float]:
    """Shares by which marks (..., orientations) differ from the truth.

    Missed: reached cells without a mark, as a share of the reached ones. More: marked cells whose middle is
    not reached, also as a share of the reached cells. Dexterity: the mean difference over positions that are
    reached.
    """
    reached, hit = truth.any(-1), marks.any(-1)
    gap = np.abs(truth.mean(-1) - marks.mean(-1))
    return {
        "positions missed": float((reached & ~hit).sum() / reached.sum()),
        "positions more": float((hit & ~reached).sum() / reached.sum()),
        "cells missed": float((truth & ~marks).sum() / truth.sum()),
        "cells more": float((marks & ~truth).sum() / truth.sum()),
        "dexterity off by": float(gap[reached].mean()),
    }
