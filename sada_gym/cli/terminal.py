"""What the command line finds around it: encodings, a width, a working directory."""

from __future__ import annotations

import codecs
import os
import sys
import unicodedata

_PLAIN = {
    **{"\u2212": "-", "\u2010": "-", "\u2011": "-", "\u2013": "-", "\u2014": "-"},
    **{"\u2018": "'", "\u2019": "'", "\u201c": '"', "\u201d": '"', "\u00d7": "x"},
    **{"°": " deg", "·": ".", "±": "+-", "≤": "<=", "≥": ">=", "→": "->", "μ": "mu"},
}


def prepare() -> None:
    """Make the command line work in any pipe and in a terminal of unknown width.

    Raises:
        FileNotFoundError: If the working directory was deleted.
    """
    codecs.register_error("sada_gym.plain", _as_plain)
    for stream in (sys.stdout, sys.stderr):
        reconfigure = getattr(stream, "reconfigure", None)
        if reconfigure is not None:  # streams that a user has put there may lack it
            reconfigure(errors="sada_gym.plain")
    if os.environ.get("COLUMNS", "").strip("0") == "":
        os.environ.pop("COLUMNS", None)
    os.getcwd()


def _as_plain(error: UnicodeError) -> tuple[str, int]:
    if not isinstance(error, UnicodeEncodeError):
        raise error
    text = error.object[error.start : error.end]
    return "".join(map(_plain, text)), error.end


def _plain(character: str) -> str:
    known = _PLAIN.get(character)
    decomposed = unicodedata.normalize("NFKD", character).encode("ascii", "ignore").decode()
    return known or decomposed or "?"
