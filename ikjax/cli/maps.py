"""`ikjax sweep`: make a map, or continue one."""

import dataclasses
import math
import sys

import jax

import ikjax
from ikjax.cli import study_file, whole_arm
from ikjax.cli.output import is_study, print_error
from ikjax.cli.show import check_places, report
from ikjax.cli.stop import OTHERS_ENDED, Stop
from ikjax.core.text import line
from ikjax.ik.redundancy import checked_samples
from ikjax.maps.sets.orientations import as_orientations
from ikjax.maps.store.storage import StorageError
from ikjax.maps.sweep import SweepStoppedError


def _requested_study(options) -> study_file.Study:
    """The study that a file or the options describe."""
    if is_study(options.arm):
        return study_file.read(options.arm, options)
    if options.certify and options.other_dtype:
        raise ValueError("--certify is for float32 sweeps; --float64 needs none")
    arm = whole_arm.from_options(options, options.arm)
    orientations = 512 if options.orientations is None else options.orientations
    positions = ikjax.maps.around(arm, options.spacing or 0.05)
    dtype = "float64" if options.other_dtype else "float32"
    statistics = tuple(options.statistics or study_file.STATISTICS)
    rest = statistics, None, dtype, options.certify, options.redundancy_samples, options.title
    return study_file.Study(arm, positions, orientations, options.free_rolls or 1, *rest)


def _join_processes(options) -> None:
    """Join the other processes of --distributed, before jax computes anything."""
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
    _join_processes(options)
    study = _requested_study(options)
    check_places(options)
    if (options.resume or options.force) and not options.out:
        flag = "--resume" if options.resume else "--force"
        raise ValueError(f"{flag} needs --out, the map to go on with or to replace")
    earlier = ikjax.ReachMap.load(options.compare) if options.compare else None
    # Read into memory now: the earlier map may be the one that is replaced.
    earlier = earlier and dataclasses.replace(earlier, arrays=earlier.to_numpy())
    positions = math.prod(study.positions.shape)
    if positions >= 2**31:
        raise ValueError(f"--spacing asks for {positions:.2g} positions, 2^31 or more")
    checked_samples(study.arm, study.redundancy_samples, 1)
    is_first = jax.process_index() == 0
    if is_first and not options.json:
        count = as_orientations(study.orientations).count
        print(line(f"sweeping {study.arm.name}: {positions * count:,} goals"), file=sys.stderr)
    with Stop(options.max_hours) as stop:
        try:
            reach_map = ikjax.sweep(
                **study._asdict(),
                out=options.out,
                resume=options.resume,
                force=options.force,
                progress=is_first and not options.json,
                stop=stop,
            )
        except SweepStoppedError as stopped:
            print_error(stopped)
            return stop.code or OTHERS_ENDED
        except StorageError as error:
            print_error(error)
            return 3
    return report(options, reach_map, earlier, options.compare) if is_first else 0
