"""What the commands print: text for people, or one JSON object.

Outside the storeys.
"""

import json
import sys

from ikjax.core.text import one_line, printable


def say(options, text: str, data: dict) -> None:
    print(json.dumps(data, allow_nan=False) if options.json else printable(text))


def complain(message: object) -> None:
    """One line on stderr."""
    print(f"ikjax: {one_line(message)}", file=sys.stderr)
