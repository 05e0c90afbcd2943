"""Text that came from elsewhere, escaped for the medium it is shown in: one function for each.

Names of arms, branches and statistics come out of files that anyone may have written. They are
text wherever they are shown: nothing in them steers a terminal, forges a line, or is markup or a formula.
"""

import html as _html
import re

_ADDRESS = re.compile(r"(?<=http)(?=:)|(?<=https)(?=:)|(?<=www)(?=\.)|(?=@)", re.IGNORECASE)
_MARKS = re.compile(r"[!-+.:-@\[-`{-~-]")
"""ASCII's punctuation, but for comma and slash, which mark nothing."""


def printable(text: object) -> str:
    """Lines for a terminal: control characters, and those that turn the direction of writing, spelt out."""
    text = str(text)
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() or c == "\n" else repr(c)[1:-1] for c in text)


def line(text: object) -> str:
    """A name for a terminal, a log, an error or a repr: as `printable`, its line ends spelt out too."""
    return printable(text).replace("\n", "\\n")


def one_line(text: object) -> str:
    """A whole message on one line, with single blanks for line ends and for blanks that stand together."""
    return printable(" ".join(str(text).split()))


def html(text: object) -> str:
    """Lines for a page or an attribute of it."""
    return _html.escape(printable(text))


def markdown(text: object) -> str:
    """A name for Markdown, which may hold HTML: no markup, no image, no link, no cell of a table."""
    # Readers look for addresses after they have resolved references to characters: a word joiner, which has
    # no width, keeps an address from being one.
    apart = _ADDRESS.sub("\N{WORD JOINER}", line(text))
    return _MARKS.sub(lambda found: f"&#{ord(found[0])};", apart)


def picture(text: object) -> str:
    """A name for matplotlib, which takes what stands between two dollars for a formula."""
    return line(text).replace("$", r"\$")
