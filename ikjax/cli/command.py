"""Run one command: from its arguments to its exit code."""

import os
import sys
import warnings
from pathlib import Path

import jax

from ikjax.cli.output import print_error, with_flags
from ikjax.cli.parser import build_parser
from ikjax.cli.waiting import saying_so_when_it_takes_long


def main(argv=None) -> int:
    """Run one command and return its exit code."""
    try:
        options = build_parser().parse_args(argv)
    except SystemExit as finished:  # after --help, --version, or an error that was printed
        return int(finished.code or 0)
    # The library never sets this; the command is a program of its own, and has float64 where it is asked for.
    jax.config.update("jax_enable_x64", True)
    if not options.no_cache:
        _keep_programs()
    try:
        with warnings.catch_warnings():
            warnings.showwarning = lambda message, *_: print_error(with_flags(options, str(message)))
            with saying_so_when_it_takes_long(not options.json):
                return options.run(options)
    except BrokenPipeError:  # the reader, such as `head`, has closed the pipe
        sys.stdout = None
        return 0
    except (ValueError, OSError, ImportError) as error:
        print_error(with_flags(options, str(error)))
        return 2


def _keep_programs() -> None:
    """Keep compiled programs in the user's cache folder, unless another one is set.

    Source: XDG Base Directory Specification; a relative XDG_CACHE_HOME is ignored.
    """
    if jax.config.values["jax_compilation_cache_dir"]:
        return
    folder = Path(os.environ.get("XDG_CACHE_HOME", ""))
    home = folder if folder.is_absolute() else Path.home() / ".cache"
    jax.config.update("jax_compilation_cache_dir", str(home / "ikjax"))
    # Many small programs take longer together than one that compiles for a second.
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0)
