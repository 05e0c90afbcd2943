"""What the commands print: text for people, or one JSON object.

Outside the storeys.
"""

import json
import sys


def say(options, text: str, data: dict) -> None:
    print(json.dumps(data, allow_nan=False) if options.json else plain(text))


def complain(message: object) -> None:
    """One line on stderr."""
    print(f"ikjax: {plain(' '.join(str(message).split()))}", file=sys.stderr)


def plain(text: str) -> str:
    """Text without control characters, which a name could use to write over the terminal."""
    return "".join(c if c.isprintable() or c == "\n" else repr(c)[1:-1] for c in text)
