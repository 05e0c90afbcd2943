"""`ikjax sweep` and `ikjax show`: a map is made, and looked at.

Outside the storeys.
"""

import dataclasses
import math
import pathlib
import sys
from typing import Any

import jax

import ikjax
from ikjax.cli.say import complain, plain, say
from ikjax.study import compare, recipe
from ikjax.study.orientations import as_orientations
from ikjax.study.place import Place, StorageError
from ikjax.study.stop import OTHERS_ENDED, Stop
from ikjax.study.sweep import SweepStoppedError


def check_places(options) -> None:
    """Raise now what a sweep would find out at its end: nothing to draw with, nowhere to write."""
    out = getattr(options, "out", None)
    if options.picture:
        pathlib.Path(options.picture).absolute().parent.mkdir(parents=True, exist_ok=True)
    if out:
        Place(out)
    if options.picture:
        from ikjax import plot

        kinds = plot.file_types()
        if pathlib.Path(options.picture).suffix[1:].lower() not in kinds:
            raise ValueError(f"--picture must end in one of {', '.join(kinds)}, got {options.picture!r}")


def _study(options) -> recipe.Recipe:
    """What is asked for, by a file or by options."""
    if options.arm.endswith(".toml"):
        for name in ("spacing", "orientations", "other_dtype"):
            if getattr(options, name):
                flag = "float64" if name == "other_dtype" else name
                raise ValueError(f"--{flag} is for {options.arm} to say")
        return recipe.read(options.arm)
    arm = recipe.find_arm(options.arm)
    orientations = 512 if options.orientations is None else options.orientations
    positions = ikjax.around(arm, options.spacing or 0.05)
    dtype = "float64" if options.other_dtype else "float32"
    return recipe.Recipe(arm, positions, orientations, 1, recipe.STATISTICS, None, dtype)


def _join(options) -> None:
    """Become one of several processes, before jax computes anything."""
    explicit = (options.coordinator, options.processes, options.process)
    if not options.distributed:
        if any(given is not None for given in explicit):
            raise ValueError("--coordinator, --processes and --process go with --distributed")
        return
    if not options.out:
        raise ValueError("--distributed needs --out, a place that all processes can write to")
    if any(given is None for given in explicit) and any(given is not None for given in explicit):
        raise ValueError("--coordinator, --processes and --process go together")
    try:
        jax.distributed.initialize(*explicit)
    except RuntimeError as error:
        raise ValueError(f"--distributed: {error}") from error


def run_sweep(options) -> int:
    _join(options)
    study = _study(options)
    check_places(options)
    if (options.resume or options.force) and not options.out:
        flag = "--resume" if options.resume else "--force"
        raise ValueError(f"{flag} needs --out, the map to go on with or to replace")
    earlier = ikjax.ReachMap.load(options.compare) if options.compare else None
    # Read now: the earlier map may be the one that is replaced.
    earlier = earlier and dataclasses.replace(earlier, arrays=earlier.to_numpy())
    positions = math.prod(study.positions.shape)
    if positions >= 2**31:
        raise ValueError(f"--spacing asks for {positions:.2g} positions, 2^31 or more")
    leads = jax.process_index() == 0
    if leads and not options.json:
        count = as_orientations(study.orientations).count
        print(plain(f"sweeping {study.arm.name}: {positions * count:,} goals"), file=sys.stderr)
    with Stop(options.max_hours) as stop:
        try:
            reach = ikjax.sweep(
                **study._asdict(),
                out=options.out,
                resume=options.resume,
                force=options.force,
                progress=leads and not options.json,
                stop=stop,
            )
        except SweepStoppedError as stopped:
            complain(stopped)
            return stop.code or OTHERS_ENDED
        except StorageError as error:
            complain(error)
            return 3
    return report(options, reach, earlier) if leads else 0


def run_show(options) -> int:
    check_places(options)
    return report(options, ikjax.ReachMap.load(options.map))


def report(options, reach: ikjax.ReachMap, earlier: ikjax.ReachMap | None = None) -> int:
    text = reach.summary()
    data: dict[str, Any] = {"arm": reach.arm.name, **reach.numbers()}
    if reach.units is not None:
        text += f"\n  map               {options.out}: {reach.units}"
        data["units"] = reach.units._asdict()
    if options.picture:
        from ikjax import plot

        plot.reach_map(reach, options.picture)
        text += f"\n  picture           {options.picture}"
    if earlier is not None:
        data["compared"] = compare.compare(earlier, reach)
        text += f"\n{compare.in_words(data['compared'], options.compare)}"
    say(options, text, data)
    return 0 if data["positions_reachable"] > 0 else 1
