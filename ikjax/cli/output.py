"""What the commands print: text for people, or one JSON object."""

import json
import re
import sys

from ikjax.cli.whole_arm import KEYS
from ikjax.core.text import one_line, printable


def is_study(name: object) -> bool:
    """Whether a name is that of a study file."""
    return str(name).lower().endswith(".toml")


def print_result(options, text: str, data: dict) -> None:
    """Text for people, or the data as JSON."""
    if getattr(options, "csv", None) == "-":
        return  # the rows are there already
    print(json.dumps(data, allow_nan=False) if options.json else printable(text))


def print_error(message: object) -> None:
    """One line on stderr."""
    print(f"ikjax: {one_line(message)}", file=sys.stderr)


def with_flags(options, text: str) -> str:
    """The library's text, with --tip for tip= where the command has that option."""
    if not hasattr(options, "tip") or is_study(options.arm):
        return text
    # A command names a frame of a MuJoCo model as it names a link.
    text = text.replace("site= or body=", "tip=")
    return re.sub(rf"\b({'|'.join(KEYS)})=(:?)", lambda m: f"--{m[1].replace('_', '-')}{m[2] or ' '}", text)
