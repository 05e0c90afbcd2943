"""Time and memory of maps: `python benchmarks/maps.py rates|linear|rivals|devices|types|all [--quick]`.

    rates     sweeps of five arms in both types; `--only ARM` for one of them
    linear    time and memory from 10^6 to 10^9 goals, a process each, and how much time storing costs
    rivals    EAIK in the same loop, and maps of sampled joints, on the same grids in the same run
    devices   two devices, and two processes, compared with one, on the same cores
    types     float32, and certified float32, compared with float64
    all       all of these; with `--out` and `--pictures` what `make maps` writes

What each figure means: README.md.
"""

import argparse
import sys
import traceback
from pathlib import Path

import jax

jax.config.update("jax_enable_x64", True)
jax.config.update("jax_enable_compilation_cache", False)

import map_devices
import map_growth
import map_rates
import map_rivals
import map_types
import report

PARTS = {
    "rates": map_rates.measure,
    "linear": map_growth.measure,
    "rivals": map_rivals.measure,
    "devices": map_devices.measure,
    "types": map_types.measure,
}


def main() -> int:
    """Measure the requested parts and write the report."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("part", choices=(*PARTS, "all"))
    parser.add_argument("--only", metavar="ARM", help="of the rates, those of one arm")
    parser.add_argument("--quick", action="store_true", help="small sizes: only to see that it runs")
    parser.add_argument("--out", type=Path, default=Path("out/maps.md"))
    parser.add_argument("--pictures", type=Path, default=Path("out"), help="a folder")
    given = parser.parse_args()
    facts = report.environment(given.quick)
    Path("out").mkdir(exist_ok=True)
    given.pictures.mkdir(parents=True, exist_ok=True)
    given.out.parent.mkdir(parents=True, exist_ok=True)
    parts = ["# Maps, measured", "Made by `python benchmarks/maps.py`; what each figure means: README.md."]
    parts.append("\n".join(f"- {key}: {value}" for key, value in facts.items()))
    for name in PARTS if given.part == "all" else [given.part]:
        print(f"{name} ...", file=sys.stderr, flush=True)
        try:
            parts.append(PARTS[name](given))
        except Exception as error:
            traceback.print_exc()
            parts.append(f"## Not measured: {name}\n\n{type(error).__name__}: {error}")
        # After every part, so that the results so far remain if the next part is killed.
        given.out.write_text("\n\n".join(parts) + "\n")
        print(f"{parts[-1]}\n", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
