"""Numbers in the pages of docs/, for the tests that compare them with what was measured."""

from __future__ import annotations

import re


def numbers(text: str) -> set[str]:
    """The numbers of a text, as they are written."""
    return set(re.findall(r"(?<![\w-])\d+(?:[.,]\d+)*(?!\w)", text))


def rows(text: str) -> dict[str, set[str]]:
    """The numbers of each row of the tables, by its first cell; of all rows under ''."""
    figures: dict[str, set[str]] = {"": set()}
    for line in text.splitlines():
        if line.startswith("|"):
            label = line.split("|")[1].strip()
            for name in (label, ""):
                figures.setdefault(name, set()).update(numbers(line))
    return figures
