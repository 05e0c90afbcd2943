"""Maps of seven-joint arms: the rate, and the goals that more values of the redundant joint would add.

    python benchmarks/redundant.py [arm] [goals]

A goal counts where some value of the redundant joint reaches it within the limits. Few values miss goals
whose self-motion is short. The same goals are swept at several numbers of values, in float32, and compared
goal by goal with the largest of these. Compiling is reported alone, and is not a part of the rate. Certified,
32 values find what lies between them too.
"""

import os
import sys
import time

import jax
import numpy as np

import ikjax

VALUES = (8, 16, 32, 64, 128, 512)
ORIENTATIONS = 512
CERTIFIED = "certified"


def main() -> None:
    name = sys.argv[1] if len(sys.argv) > 1 else "fer"
    goals = int(float(sys.argv[2])) if len(sys.argv) > 2 else 10**6
    jax.config.update("jax_enable_x64", True)
    arm = ikjax.robots.get(name)
    edge = round((goals / ORIENTATIONS) ** (1 / 3))
    around = ikjax.maps.around(arm, 0.1)
    low, high = around.points()[0, 0, 0], around.points()[-1, -1, -1]
    grid = ikjax.maps.Grid(tuple(low.tolist()), float((high - low).max() / (edge - 1)), (edge,) * 3)
    print(
        f"{name}, float32, {jax.device_count()} CPU device, {os.cpu_count()} threads, jax {jax.__version__}: "
        f"{grid.count:,} positions x {ORIENTATIONS} orientations = {grid.count * ORIENTATIONS:,} goals"
    )
    maps = {}
    for count in (*VALUES, CERTIFIED):
        started = time.perf_counter()
        made = ikjax.sweep(
            arm,
            grid,
            ORIENTATIONS,
            redundancy_samples=32 if count == CERTIFIED else count,
            dtype="float32",
            certify=count == CERTIFIED,
            statistics=("reachable_within", "mask_within"),
        )
        whole = time.perf_counter() - started
        maps[count] = made.reached()
        if count == CERTIFIED:
            print(f"certified: {made.seconds:.1f} s, compiling {whole - made.seconds:.1f} s")
            continue
        rate = made.goals * count / made.seconds / 1e6
        rest = whole - made.seconds
        print(
            f"{count:4} values: {made.seconds:6.1f} s, {rate:4.1f} M (goal, value)/s, compiling {rest:4.1f} s"
        )
    most = maps[VALUES[-1]]
    print(f"{VALUES[-1]} values reach {most.mean():.3%} of all goals; of these goals, fewer values miss")
    for count in (*VALUES[:-1], CERTIFIED):
        missed, odd = most & ~maps[count], maps[count] & ~most
        print(
            f"{count:>4}{'' if count == CERTIFIED else ' values'}: "
            f"{missed.sum() / most.sum():.3%} of what {VALUES[-1]} reach, "
            f"{missed.mean():.3%} of all goals; {odd.mean():.3%} the other way"
        )
        partly = (missed.any(-1) & ~maps[count].any(-1)).mean()
        off = np.abs(most.mean(-1) - maps[count].mean(-1))
        print(f"             positions new {partly:.3%}; dexterity off by {off.max():.2%} at most")


if __name__ == "__main__":
    main()
