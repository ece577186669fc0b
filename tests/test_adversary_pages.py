"""The pages about adversaries name every adversary, and their tables hold the true defaults."""

from __future__ import annotations

import re
from collections import defaultdict
from fractions import Fraction
from math import isclose
from pathlib import Path
from typing import Any

import pytest

from sada_gym import adversaries

FOLDER = Path(__file__).parents[1] / "docs" / "adversaries"
PAGES = sorted(FOLDER.glob("*.md"))
MOST_WORDS = 1_200

Cells = dict[tuple[str, str], dict[str, str]]


def documented() -> Cells:
    """Return the cells of all tables of options: (adversary, preset) to option to value."""
    cells: Cells = defaultdict(dict)
    for page in PAGES:
        for table in re.findall(r"(?:^\|.*\n)+", page.read_text("utf-8"), re.MULTILINE):
            head, _, *rows = [
                [cell.strip() for cell in line.strip("|\n ").split("|")]
                for line in table.splitlines()
            ]
            if head[0] == "option":
                add(cells, head, rows)
    return cells


def add(cells: Cells, head: list[str], rows: list[list[str]]) -> None:
    """Read a table: a column is headed by adversaries' names, and a preset where it shows one."""
    before: list[str] = []
    for column, title in list(enumerate(head))[1:-1]:
        words = re.findall(r"`([\w-]+)`", title)
        named = [word for word in words if word in adversaries.names()] or before
        preset = next((word for word in words if word not in adversaries.names()), "default")
        before = named
        for row in rows:
            for name in named:
                if row[column]:
                    cells[name, preset][row[0].strip("`")] = row[column]


def equal(shown: str, value: Any) -> bool:
    """Say whether a cell shows a value: `128, 128` a tuple, `1/3` a float."""
    if isinstance(value, tuple):
        return shown.split(", ") == list(map(str, value))
    if isinstance(value, float):
        return isclose(Fraction(shown), value)
    return shown == str(value)


@pytest.mark.parametrize("name", adversaries.names())
def test_the_options_and_defaults_are_those_of_the_code(name: str) -> None:
    cells = documented()
    described = next(row for row in adversaries.describe() if row.name == name)
    for preset in ["default", *described.presets]:
        if preset == "default" or (name, preset) in cells:
            chosen = {"preset": preset} if described.presets else {}
            values = {k: v for k, v in adversaries.resolve(name, chosen).items() if k != "preset"}
            shown = cells[name, preset]
            assert set(shown) == set(values)
            wrong = {k: (shown[k], v) for k, v in values.items() if not equal(shown[k], v)}
            assert not wrong


def test_a_wrong_default_would_be_seen() -> None:
    assert not equal("128, 64", (128, 128))
    assert not equal("0.3", 1 / 3)
    assert not equal("2000", None)


def test_the_first_page_lists_every_adversary_once() -> None:
    page = (FOLDER / "index.md").read_text("utf-8")
    _, _, rest = page.partition("## All of them")
    column = "".join(re.findall(r"^\| \[(.*?)\]", rest, re.MULTILINE))
    assert sorted(re.findall(r"`([\w-]+)`", column)) == sorted(adversaries.names())


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_a_page_is_short(page: Path) -> None:
    if page.stem.startswith("appendix"):
        pytest.skip("an appendix may be long")
    assert len(page.read_text("utf-8").split()) < MOST_WORDS


def test_every_picture_is_shown() -> None:
    text = "".join(page.read_text("utf-8") for page in PAGES)
    pictures = (FOLDER.parent / "images").glob("adversaries*.png")
    assert all(f"../images/{picture.name}" in text for picture in pictures)


def rows_of(page: Path, head: str) -> list[list[str]]:
    """Return the cells of a page's first table whose heading begins like that, without marks."""
    text = re.sub(r"[*`]", "", page.read_text("utf-8"))
    found = re.search(rf"^\| {head} \|.*\n(?:\|.*\n)+", text, re.MULTILINE)
    assert found is not None
    lines = found[0].splitlines()
    return [[cell.strip() for cell in line[1:-1].split("|")] for line in lines if "---" not in line]


def overview() -> dict[tuple[str, str], str]:
    """Return the figures of the results: (adversary, application) to AFR / coverage."""
    head, *rows = rows_of(FOLDER.parent / "results" / "index.md", "adversary")
    return {
        (row[0], name.lower()): cell
        for row in rows
        for name, cell in zip(head[1:], row[1:], strict=True)
    }


@pytest.mark.parametrize("name", ["level-set", "bbgan", "rare-events", "reinforcement-learning"])
def test_the_figures_of_a_page_are_those_of_the_results(name: str) -> None:
    (_, *heads), *rows = rows_of(FOLDER / f"{name}.md", "application")
    named = ["bbgan (paper)" if head == "bbgan, paper" else head for head in heads]
    shown = {(a, row[0]): cell for row in rows for a, cell in zip(named, row[1:], strict=True)}
    assert shown.items() <= overview().items()


def test_the_figures_of_the_baselines_are_those_of_the_results() -> None:
    (_, *heads), *rows = rows_of(FOLDER / "paper-baselines.md", "adversary")
    shown = {(row[0], a): cell for row in rows for a, cell in zip(heads, row[1:], strict=True)}
    assert shown.items() <= overview().items()
