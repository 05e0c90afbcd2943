"""What float32 does to a map: `python benchmarks/certified.py [ARM ...] [--goals N]`.

For each arm the same goals are swept in float32, in float64, and in float32 with doubtful goals solved again
(`certify=True`): how many goals and cells count otherwise than in float64, and at what rate each is swept.
"""

import argparse

import jax
import numpy as np

import ikjax

ARMS = ("puma560", "ur5e", "irb2400", "stanford", "so101", "gx4_351s")
COUNTS = ("reachable", "solutions", "reachable_within", "solutions_within")
ORIENTATIONS = 512


def spacing_for(arm, goals: float) -> float:
    """Such that a grid around the arm has about so many goals."""
    fine = ikjax.around(arm, 0.05)
    return 0.05 * (fine.count * ORIENTATIONS / goals) ** (1 / 3)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("arms", nargs="*", default=ARMS, metavar="ARM")
    parser.add_argument("--goals", type=float, default=1e7)
    options = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    print(
        "arm, goals; of all masks within limits and without: goals and cells that float32 counts otherwise;"
    )
    print("cells that the certified map counts otherwise; million goals/s of float32, float64, certified")
    for name in options.arms:
        arm = ikjax.robots.get(name)
        grid = ikjax.around(arm, spacing_for(arm, options.goals))
        maps = [
            ikjax.sweep(arm, grid, ORIENTATIONS, statistics=(*COUNTS, "mask", "mask_within"), **how)
            for how in ({"dtype": "float32"}, {"dtype": "float64"}, {"dtype": "float32", "certify": True})
        ]
        narrow, wide, certified = (each.to_numpy() for each in maps)
        goals = sum(int(np.bitwise_count(narrow[key] ^ wide[key]).sum()) for key in ("mask", "mask_within"))
        cells, left = (
            int(np.any([each[key] != wide[key] for key in COUNTS], axis=0).sum())
            for each in (narrow, certified)
        )
        rates = ", ".join(f"{each.goals / each.seconds / 1e6:.0f}" for each in maps)
        print(f"{name}, {maps[0].goals:,}; {goals:,} and {cells:,}; {left:,}; {rates}", flush=True)


if __name__ == "__main__":
    main()
