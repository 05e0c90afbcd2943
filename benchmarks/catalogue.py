"""What the first `solve` of each arm in the catalogue costs: `python benchmarks/catalogue.py`.

One process, the persistent compilation cache off, JAX as it starts (float32). For each arm the seconds of
its first eager call, and of a later one with as many goals; the sum stands last.
"""

import time

import jax

jax.config.update("jax_enable_compilation_cache", False)

import ikjax


def main() -> None:
    """Print a table."""
    print(f"jax {jax.__version__}")
    print("| arm | family | first solve [s] | a later one [s] |")
    print("|---|---|---|---|")
    total = 0.0
    for name in ikjax.robots.names():
        arm = ikjax.robots.get(name)
        goals = ikjax.fk(arm, jax.random.uniform(jax.random.key(0), (100, arm.n)))
        seconds = []
        for _ in range(2):
            started = time.perf_counter()
            jax.block_until_ready(ikjax.solve(arm, goals))
            seconds.append(time.perf_counter() - started)
        total += seconds[0]
        print(f"| {name} | {arm.family} | {seconds[0]:.2f} | {seconds[1]:.4f} |", flush=True)
    print(f"| all {len(ikjax.robots.names())} | | {total:.1f} | |")


if __name__ == "__main__":
    main()
