"""Completeness: `solve` gives as many answers as there are, no fewer and no more.

`root_counts.py` finds every real answer at 50 digits, from the DH table and the goal before it is rounded to
float64; each is then put into forward kinematics at 50 digits. The slots must be the same set, one by one.

The arm is the one that is meant: twists within 1e-12 of a quarter turn are one, base and tool are rigid.
"""

import arm_patterns
import arms
import numpy as np
import pytest
import root_counts
from root_counts import mp

import ikjax

NAMES = (
    "RRR, wrist",
    "RRP, wrist",
    "RPR, wrist",
    "PRR, wrist",
    "skew wrist",
    "wrist first, RRRRRR",
    "RRR, point",
    "RRP, point",
    "2, 3, 4 parallel",
    "3, 4, 5 parallel",
    "4, 5, 6 parallel",
    "1, 2, 3 parallel",
    "SCARA RRPR",
    "turret",
    "five axes",
    "five axes, lateral",
    "five axes, leaning",
    "five axes, roll first",
    "motoman_l3",
    "so101",
    "2R",
    "3R",
    "RPR",
    "PRR",
    "puma560",
    "ur5",
)
LEFT_OUT = 0.02
"""At most this share of the goals may be too near a fold to be certain."""


def _arm(name) -> ikjax.Arm:
    return arm_patterns.build(name) if name in arm_patterns.NAMES else ikjax.robots.get(name)


def exact(array) -> np.ndarray:
    return np.vectorize(mp.mpf, otypes=[object])(np.asarray(array, float))


def rigid(pose) -> np.ndarray:
    """The exact pose nearest to a float one, by Newton's iteration for the polar factor."""
    T = exact(pose)
    for _ in range(4):
        R = T[:3, :3]
        T[:3, :3] = R @ (3 * np.eye(3, dtype=int) - R.T @ R) / 2
    return T


def link(theta, d, a, alpha) -> np.ndarray:
    """Spong, Robot Modeling and Control, equation (3.10)."""
    quarters = round(float(alpha) / (np.pi / 2))
    if abs(float(alpha) - quarters * np.pi / 2) < 1e-12:
        alpha = quarters * mp.pi / 2
    (c, s), (ca, sa) = ((mp.cos(x), mp.sin(x)) for x in (theta, alpha))
    rows = [[c, -s * ca, s * sa, a * c], [s, c * ca, -c * sa, a * s], [0, sa, ca, d], [0, 0, 0, 1]]
    return np.array(rows, object)


def chain(arm, stretch=(1,)) -> list[np.ndarray]:
    """C0 to Cn; `stretch` makes links longer."""
    a, alpha, d, theta = (exact(leaf) for leaf in (arm.a, arm.alpha, arm.d, arm.theta))
    C = [rigid(arm.base), *map(link, theta, d, a * stretch, alpha)]
    return [*C[:-1], C[-1] @ rigid(arm.tool)]


def fk(arm, C, joints) -> np.ndarray:
    return C[0] @ root_counts.moved(arm.kinds, C[1:], joints)


def _rotation(rng) -> np.ndarray:
    """A random rotation to 50 digits, from a quaternion."""
    w, x, y, z = exact(rng.normal(size=4))
    size = 2 / (w * w + x * x + y * y + z * z)
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]], object)
    return np.eye(3, dtype=int) + size * (w * cross + cross @ cross)


def exact_goals(arm, C, count) -> list[np.ndarray]:
    """By turns a goal that joints made, and one that may be out of reach.

    The latter has any rotation and a position half as far to half as far again from the base; where the
    task is in a plane or has few joints, it is what an arm with longer or shorter links reaches.
    """
    rng = np.random.default_rng([11, len(arm.name)])
    goals = []
    for i, q in enumerate(arm_patterns.joints(arm, count, seed=11)):
        joints = [mp.expj(x) if kind == "R" else mp.mpf(x) for kind, x in zip(arm.kinds, q, strict=True)]
        if i % 2 == 0:
            goals.append(fk(arm, C, joints))
        elif arm.n == 6 or arm.task == "position":
            goal = fk(arm, C, joints)
            goal[:3, 3] = C[0][:3, 3] + rng.uniform(0.5, 1.5) * (goal[:3, 3] - C[0][:3, 3])
            goal[:3, :3] = _rotation(rng)
            goals.append(goal)
        else:
            # Of the two links before the last, so that the goal stays within the arm's few freedoms.
            stretch = rng.uniform(0.5, 1.5, size=arm.n)
            stretch[:-3] = stretch[-1] = 1
            goals.append(fk(arm, chain(arm, stretch), joints))
    return goals


def _reached(arm, found, goal) -> bool:
    rows = slice(0, 3)
    columns = slice(0, 4) if arm.task in ("pose", "planar_pose") else slice(3, 4)
    return max(abs(x) for x in (found - goal)[rows, columns].flat) < root_counts.REAL


def _floats(arm, joints) -> list[float]:
    return [float(mp.arg(x) if kind == "R" else x) for kind, x in zip(arm.kinds, joints, strict=True)]


def _gap(arm, q, answers) -> np.ndarray:
    """(slot, answer) how far their joints are apart."""
    off = q[:, None] - answers[None]
    return np.where([kind == "R" for kind in arm.kinds], np.abs(arms.wrapped(off)), np.abs(off)).max(-1)


def tally(name, count) -> dict:
    """How many goals have so many answers, how many are left out, and what does not agree."""
    arm = _arm(name)
    C = chain(arm)
    goals = exact_goals(arm, C, count)
    sol = arms.solve_by_hand(arm, np.array(goals, float))
    counts, left_out, wrong = {}, 0, []
    for i, goal in enumerate(goals):
        try:
            answers = root_counts.answers(arm, C, goal)
        except root_counts.NearFoldError:
            left_out += 1
            continue
        assert all(_reached(arm, fk(arm, C, joints), goal) for joints in answers)
        assert len(answers) > 0 or i % 2 == 1
        counts[len(answers)] = counts.get(len(answers), 0) + 1
        slots = sol.q[i][sol.valid[i]]
        wanted = np.array([_floats(arm, joints) for joints in answers]).reshape(-1, arm.n)
        near = _gap(arm, slots, wanted) < 1e-6
        if len(slots) != len(wanted) or (near.sum(0) != 1).any() or (near.sum(1) != 1).any():
            wrong.append((i, len(slots), len(wanted)))
    return {"counts": dict(sorted(counts.items())), "left_out": left_out, "wrong": wrong}


def _check(name, count):
    found = tally(name, count)
    assert found["wrong"] == [], "(goal, slots, answers)"
    assert found["left_out"] < LEFT_OUT * count
    assert len(found["counts"]) >= 2 or len(_arm(name).branches) <= 2
    return found


@pytest.mark.parametrize("name", NAMES)
def test_the_slots_are_all_answers_and_nothing_else(name):
    _check(name, 24)


@pytest.mark.long
@pytest.mark.parametrize("name", NAMES)
def test_the_slots_of_2000_goals_are_all_answers_and_nothing_else(name, capsys):
    found = _check(name, 2000)
    with capsys.disabled():
        print(f"\n{name}: answers: goals {found['counts']}, left out {found['left_out']}")
