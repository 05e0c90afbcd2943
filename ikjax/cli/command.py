"""One command from its words to its exit code.

Outside the storeys.
"""

import sys
import warnings

import jax

from ikjax.cli.say import complain, in_flags
from ikjax.cli.words import parser


def main(argv=None) -> int:
    """Run one command and return its exit code."""
    try:
        options = parser().parse_args(argv)
    except SystemExit as finished:  # after --help, --version, or a mistake that was explained
        return int(finished.code or 0)
    # A program's own choice, which the library never makes: float64 is there when asked for.
    jax.config.update("jax_enable_x64", True)
    try:
        with warnings.catch_warnings():
            warnings.showwarning = lambda message, *_: complain(in_flags(options, str(message)))
            return options.run(options)
    except BrokenPipeError:  # the reader, `head` say, has seen enough
        sys.stdout = None
        return 0
    except (ValueError, OSError, ImportError) as error:
        complain(in_flags(options, str(error)))
        return 2
