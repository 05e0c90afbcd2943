"""`ikjax sweep`: a map is made, or gone on with.

Outside the storeys.
"""

import dataclasses
import math
import sys

import jax

import ikjax
from ikjax.cli import study_file
from ikjax.cli.say import FILE_OPTIONS, complain, file_options
from ikjax.cli.show import check_places, report
from ikjax.cli.stop import OTHERS_ENDED, Stop
from ikjax.core.text import line
from ikjax.maps.sets.orientations import as_orientations
from ikjax.maps.store.storage import StorageError
from ikjax.maps.sweep import SweepStoppedError


def _study(options) -> study_file.Recipe:
    """What is asked for, by a file or by options."""
    if options.arm.endswith(".toml"):
        for name in ("spacing", "orientations", "other_dtype", "certify", *FILE_OPTIONS):
            if getattr(options, name):
                flag = "float64" if name == "other_dtype" else name
                raise ValueError(f"--{flag} is for {options.arm} to say")
        return study_file.read(options.arm)
    if options.certify and options.other_dtype:
        raise ValueError("--certify is for float32 sweeps; --float64 needs none")
    arm = study_file.find_arm(options.arm, **file_options(options))
    orientations = 512 if options.orientations is None else options.orientations
    positions = ikjax.maps.around(arm, options.spacing or 0.05)
    dtype = "float64" if options.other_dtype else "float32"
    kept = study_file.STATISTICS, None, dtype, options.certify
    return study_file.Recipe(arm, positions, orientations, 1, *kept)


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
        print(line(f"sweeping {study.arm.name}: {positions * count:,} goals"), file=sys.stderr)
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
    return report(options, reach, earlier, options.compare) if leads else 0
