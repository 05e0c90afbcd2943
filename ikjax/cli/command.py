"""Run one command: from its arguments to its exit code."""

import sys
import warnings

import jax

from ikjax.cli.output import print_error, with_flags
from ikjax.cli.parser import build_parser


def main(argv=None) -> int:
    """Run one command and return its exit code."""
    try:
        options = build_parser().parse_args(argv)
    except SystemExit as finished:  # after --help, --version, or an error that was printed
        return int(finished.code or 0)
    # The library never sets this; the command is a program of its own, and has float64 where it is asked for.
    jax.config.update("jax_enable_x64", True)
    try:
        with warnings.catch_warnings():
            warnings.showwarning = lambda message, *_: print_error(with_flags(options, str(message)))
            return options.run(options)
    except BrokenPipeError:  # the reader, such as `head`, has closed the pipe
        sys.stdout = None
        return 0
    except (ValueError, OSError, ImportError) as error:
        print_error(with_flags(options, str(error)))
        return 2
