"""Escaping text from files for where it is shown: a terminal, a log, HTML, Markdown, matplotlib.

Names of arms, joints, branches and statistics come from files that anyone may have written. With one function
for each medium they stay text: nothing in them controls a terminal, forges a line of a log, or is markup or a
formula.
"""

import html as _html
import re

_ADDRESS = re.compile(r"(?<=http)(?=:)|(?<=https)(?=:)|(?<=www)(?=\.)|(?=@)", re.IGNORECASE)
_MARKS = re.compile(r"[!-+.:-@\[-`{-~-]")
"""ASCII's punctuation, but for comma and slash, which are no markup."""


def printable(text: object) -> str:
    """Lines for a terminal; characters that control it or change the direction of writing are spelt out."""
    text = str(text)
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() or c == "\n" else repr(c)[1:-1] for c in text)


def line(text: object) -> str:
    """A name for a terminal, a log, an error or a repr: as `printable`, with line ends spelt out too."""
    return printable(text).replace("\n", "\\n")


def one_line(text: object) -> str:
    """A whole message on one line: line ends and runs of blanks become single blanks."""
    return printable(" ".join(str(text).split()))


def html(text: object) -> str:
    """Lines for HTML, as text or as the value of an attribute."""
    return _html.escape(printable(text))


def markdown(text: object) -> str:
    """A name for Markdown, which may hold HTML: without markup, images, links or cells of a table."""
    # Viewers turn addresses into links after they have resolved character references. A word joiner, which
    # has no width, keeps an address from being recognized.
    apart = _ADDRESS.sub("\N{WORD JOINER}", line(text))
    return _MARKS.sub(lambda mark: f"&#{ord(mark[0])};", apart)


def picture(text: object) -> str:
    """A name for a figure: matplotlib typesets what stands between two dollar signs as a formula."""
    return line(text).replace("$", r"\$")
