"""The families that need the general quartic: `python benchmarks/quartic.py [GOALS]`.

The kernel with component arrays and every slot, as in `run.py`, for arms of general lengths and twists; every
answer is checked by forward kinematics.
"""

import sys

import jax

jax.config.update("jax_enable_x64", True)
jax.config.update("jax_enable_compilation_cache", False)

import numpy as np
import own

import ikjax

FIRST = {"a": (0.12, 0.4, 0.07), "alpha": (70, 25, -80), "d": (0.3, 0.11, 0.06)}
ARMS = {
    "three joints, square wrist": {
        "a": (*FIRST["a"], 0, 0, 0.03),
        "alpha": (*FIRST["alpha"], 90, -90, 20),
        "d": (*FIRST["d"], 0.4, 0, 0.1),
    },
    "three joints, skew wrist": {
        "a": (*FIRST["a"], 0, 0, 0.03),
        "alpha": (*FIRST["alpha"], 60, -70, 20),
        "d": (*FIRST["d"], 0.4, 0, 0.1),
    },
    "wrist at the base": {
        "a": (0, 0, 0.4, 0.07, 0.12, 0.03),
        "alpha": (90, -80, 35, -80, 70, 20),
        "d": (0.3, 0, 0.06, 0.4, 0.1, 0.1),
    },
    "three parallel axes": {
        "a": (0.11, 0.37, 0.29, 0.08, 0.05, 0.03),
        "alpha": (70, 0, 180, 80, -75, 20),
        "d": (0.3, 0.1, 0.07, 0.12, 0.09, 0.1),
    },
}


def main(count: str = "1e6") -> None:
    """Print a table of rates and failures."""
    goals = int(float(count))
    print(f"{goals:,} goals, medians of 7 runs, jax {jax.__version__}")
    print("| arm | family | type | M goals/s | compile [s] | wrong | none | missing |")
    print("|---|---|---|---|---|---|---|---|")
    for name, table in ARMS.items():
        table = {**table, "alpha": np.deg2rad(table["alpha"])}
        arm = ikjax.Arm.from_dh(**table, theta=np.zeros(6), convention="standard", name=name)
        batch = own.Batch.of(arm, goals)
        for dtype in ("float32", "float64"):
            row = own.kernel(batch, dtype, 7)
            t = row.tally
            print(
                f"| {name} | {arm.family} | {dtype} | {row.timing.rate(len(batch.q)):.2f} "
                f"| {row.compile_seconds:.1f} | {t.wrong} | {t.none} | {t.missing} |",
                flush=True,
            )


if __name__ == "__main__":
    main(*sys.argv[1:])
