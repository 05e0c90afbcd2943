"""Text is text in every medium: nothing in it steers, forges, is markup or is a formula."""

import html
import re

import pytest

from ikjax.core import text

ATTACK = (
    "</title><script>alert(1)</script><img src=q onerror=alert(1)> ![x](/etc/hostname) [y](javascript:z) "
    "http://a.bc www.a.bc a@b.cd **b** `c` | {1+1} \x1b[31m\x9b2J\r\x00\u202e\ud800 $\\frac$ "
    "\n- item\n# head\u2028end"
)


def test_what_is_printed_has_no_control_character_and_no_surrogate():
    for said in (text.printable(ATTACK), text.line(ATTACK), text.one_line(ATTACK)):
        assert all(c.isprintable() or c == "\n" for c in said)
        assert r"\x1b[31m\x9b2J" in said and r"\x00\u202e\ud800" in said
    assert text.printable(ATTACK).count("\n") == 2
    assert text.line(ATTACK).count(r"\n") == 2 and "\n" not in text.line(ATTACK)
    assert "$ - item # head" in text.one_line(ATTACK).replace(r"\u2028", "")


def test_a_plain_name_stays_as_it_is_and_what_was_escaped_is_not_escaped_again():
    for name in ("puma560", "Ölf 7", "front/up/noflip"):
        assert name == text.line(name) == text.html(name) == text.markdown(name) == text.picture(name)
    assert text.line(text.line(ATTACK)) == text.line(ATTACK)


def test_html_has_no_tag_and_reads_as_it_was_written():
    said = text.html(ATTACK)
    assert not set(said) & set("<>\"'") and html.unescape(said) == text.printable(ATTACK)


def test_markdown_has_no_mark_and_no_address_and_reads_as_it_was_written():
    said = text.markdown(ATTACK)
    assert set(re.sub(r"&#\d+;", "", said)) & set("<>[]()!*_`|{}$#\\&\n-.:@~") == set()
    read = html.unescape(said)
    assert read.replace("\N{WORD JOINER}", "") == text.line(ATTACK)
    assert not re.search(r"https?:|www\.|\w@", read)


def test_a_reader_of_markdown_finds_nothing_but_text():
    markdown = pytest.importorskip("markdown_it")
    reader = markdown.MarkdownIt("commonmark", {"html": True}).enable(["table", "strikethrough"])
    (start, inline, end) = reader.parse(text.markdown(ATTACK))
    assert (start.type, end.type) == ("paragraph_open", "paragraph_close")
    assert {child.type for child in inline.children} <= {"text", "text_special"}
    assert {token.type for token in reader.parse(ATTACK)} & {"html_block", "bullet_list_open"}


def test_a_picture_takes_no_dollar_for_a_formula():
    cbook = pytest.importorskip("matplotlib.cbook")
    said = text.picture(ATTACK + "$x$")
    assert not cbook.is_math_text(said) and said.replace(r"\$", "$") == text.line(ATTACK + "$x$")
    assert cbook.is_math_text("$x$")
