"""The command `ikjax`: info, solve, sweep, show, verify, doctor.

Outside the storeys: it may import everything, nothing imports it. Text for people by default, one
JSON object with --json. Exit codes: 0 found, 1 none found or a check failed, 2 bad input; `sweep` has more,
see its help.
"""

from ikjax.cli.command import main
