"""The command `ikjax`: info, convert, solve, project, track, study, sweep, show, verify, doctor, completion.

It may import every room, and none imports it. It prints text for people by default, and one JSON object with
--json. Exit codes: 0 found, 1 none found or a check failed, 2 bad input; `sweep` has more, see its help.
"""

from ikjax.cli.command import main
