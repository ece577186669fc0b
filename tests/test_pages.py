"""The environments' pages and the gallery show all that there is, and their pictures exist."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from sada_gym.foundations.cards import APPLICATIONS, ApplicationCard, find_card
from sada_gym.foundations.lazy import load

ROOT = Path(__file__).resolve().parent.parent
FOLDER = ROOT / "docs" / "environments"
IN_THE_TABLE = {"Observation Space", "Rewards", "Starting State"}
"""Headings of a docstring that the table of facts or the page on all environments replaces."""

everywhere = pytest.mark.parametrize("folder", APPLICATIONS)


def card_of(folder: str) -> ApplicationCard:
    return load(f"sada_gym.envs.{folder}.card:CARD")


def page_name(folder: str) -> str:
    return folder.replace("_", "-")


def page_of(folder: str) -> str:
    return (FOLDER / f"{page_name(folder)}.md").read_text(encoding="utf-8")


@everywhere
def test_a_page_begins_with_a_picture_and_its_facts(folder: str) -> None:
    name = card_of(folder).name
    assert find_card(name) is not None
    page = page_of(folder)
    picture, facts = page.index("!["), page.index(f"```{{environment}} {name}\n")
    assert picture < facts < page.index("```{docstring}")
    assert len(page[:picture].split()) < 60


@everywhere
def test_a_page_leaves_out_no_part_of_its_docstring(folder: str) -> None:
    documented = card_of(folder).application
    shown: list[str] = []
    for only in re.findall(rf"docstring}} {documented}\n:only: (.+)", page_of(folder)):
        shown += only.split(", ")
    headings = re.findall(r"^ *## (.+)", load(documented).__doc__, re.MULTILINE)
    assert len(shown) == len(set(shown))
    assert set(headings) - set(shown) <= IN_THE_TABLE
    assert [heading for heading in headings if heading in shown] == shown


@everywhere
def test_the_gallery_shows_it(folder: str) -> None:
    gallery = page_of("index")
    name = page_name(folder)
    assert f"(../images/gallery-{name}.png)]({name}.md)" in gallery
    card = card_of(folder)
    named = re.findall(r"`([\w-]+-v\d)`", gallery)
    full = {track if track.startswith("SADA") else card.name + track for track in named}
    assert card.id in full
    assert len(card.tracks) > 3 or full >= set(card.track_ids)


def test_pictures_of_the_readme_exist() -> None:
    sources = re.findall(r'<img src="([^"]+)"', (ROOT / "README.md").read_text(encoding="utf-8"))
    assert sources[0].endswith(".svg")  # first the loop, then failures
    assert len(sources) == 5
    assert all((ROOT / source).is_file() for source in sources)


@pytest.mark.parametrize("page", [ROOT / "README.md", *sorted(FOLDER.glob("*.md"))], ids=str)
def test_no_table_has_two_rows_of_headings(page: Path) -> None:
    """A heading over several columns leaves empty ones beside it, and a second row below it."""
    for head in re.findall(r"^\|(.+)\|\n\|[ :|-]+\|$", page.read_text(encoding="utf-8"), re.M):
        cells = [cell.strip() for cell in head.split("|")]
        assert all(cells[1:]) or not any(cells), head


def test_no_line_begins_with_a_percent_sign() -> None:
    """Markdown of Sphinx takes such a line for a comment, and leaves it out."""
    pages = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
    lines = [(page, line) for page in pages for line in page.read_text("utf-8").splitlines()]
    assert [found for found in lines if found[1].lstrip().startswith("%")] == []
