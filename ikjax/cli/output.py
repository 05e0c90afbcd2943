"""What the commands print: text for people, or one JSON object."""

import json
import re
import sys

from ikjax.core.text import one_line, printable

FILE_OPTIONS = ("base", "tip", "axis_tolerance")


def print_result(options, text: str, data: dict) -> None:
    """Text for people, or the data as JSON."""
    print(json.dumps(data, allow_nan=False) if options.json else printable(text))


def print_error(message: object) -> None:
    """One line on stderr."""
    print(f"ikjax: {one_line(message)}", file=sys.stderr)


def file_options(options) -> dict:
    """The given options of a robot file."""
    return {key: getattr(options, key) for key in FILE_OPTIONS}


def with_flags(options, text: str) -> str:
    """The library's text, with --tip for tip= where the command has that option."""
    if not hasattr(options, "tip") or str(options.arm).endswith(".toml"):
        return text
    return re.sub(
        rf"\b({'|'.join(FILE_OPTIONS)})=(:?)", lambda m: f"--{m[1].replace('_', '-')}{m[2] or ' '}", text
    )
