"""Tests of texts that others wrote, such as an error's: one line, which UTF-8 can hold."""

from __future__ import annotations

import pytest

from sada_gym.errors import UserError, check_plain, described, is_plain, plain
from sada_gym.foundations.files import Strict, read_model, write_model

FAMILY = "\N{MAN}\N{ZERO WIDTH JOINER}\N{WOMAN}"
SCOTLAND = "\N{WAVING BLACK FLAG}\U000e0067\U000e0062\U000e007f"


class Wordless(Exception):  # noqa: N818 - reads as what it is
    """Its text cannot be had."""

    def __str__(self):
        raise RuntimeError("no words")


class Noted(Strict):
    """A record of a text."""

    text: str


@pytest.mark.parametrize(
    "text", ["wet road", "10\u00a0km/h", FAMILY, SCOTLAND, "\u05d0\u200fb", ""]
)
def test_letters_spaces_and_emoji_are_plain(text):
    assert is_plain(text)
    assert plain(text) == text


@pytest.mark.parametrize(
    ("text", "escaped"),
    [
        ("a\nb", r"a\nb"),
        ("\x1b[2J", r"\x1b[2J"),
        ("caf\udce9", r"caf\udce9"),
        ("\u202etxt.exe", r"\u202etxt.exe"),
        ("a\u2028b\x85", r"a\u2028b\x85"),
    ],
)
def test_what_a_terminal_obeys_is_escaped(text, escaped):
    assert plain(text) == escaped
    with pytest.raises(UserError, match="Expected a name in one line"):
        check_plain("a name", text)


def test_an_error_is_described_whatever_its_text_is():
    assert described(OSError("caf\udce9.xml")) == r"OSError: caf\udce9.xml"
    assert described(Wordless()).startswith("Wordless without a message")


@pytest.mark.parametrize(
    "text", ["caf\udce9", "\ud83d", FAMILY, r"a\udce9b", "\\\udce9\\", "\\\\ud83d"]
)
def test_a_record_holds_any_text(text, tmp_path):
    write_model(tmp_path / "a.json", Noted.model_construct(text=text))
    read = read_model(tmp_path / "a.json", Noted).text
    assert read == text.encode(errors="backslashreplace").decode()
