"""Figures in the README and in docs/ stand in an entry or a card, or beside what measures them.

The pages of the results are held to more, see tests/leaderboard/test_tables.py.
"""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from prose import numbers, rows

from leaderboard.tables import ENTRIES, HEADLINES
from sada_gym.board.results.entry import read_entries, read_entry
from sada_gym.board.results.models import Result
from sada_gym.board.results.sheet import rate_cell

ROOT = Path(__file__).resolve().parent.parent
DOCS = ROOT / "docs"
PAGES = [
    ROOT / "README.md",
    *(page for page in sorted(DOCS.rglob("*.md")) if "results" not in page.parts),
]
CARDS = sorted((ROOT / "sada_gym" / "envs").glob("*/agent/*.md"))
MEASURES_IT = re.compile(r"\b(?:python|sada-gym|pytest|make) [\w-]")
DEFINED = {
    "appendix-diagnosis.md": {"5"},  # an option: the share of fresh worlds
    "attack.md": {"90"},  # the level of an interval
    "diagnosis.md": {"5"},  # an option: the share of fresh worlds
    "level-set.md": {"98"},  # an option
    "measures.md": {"50"},  # by definition
    "own-agent-broken-worlds.md": {"20"},  # when an attack ends
    "own-agent.md": {"5"},  # when a warning is given
    "regression.md": {"5"},  # the level of a test
    "robot.md": {"90"},  # a world's setting
}
"""Percentages that were not measured for the page, by its name."""


def percentages(section: str) -> set[str]:
    """The percentages of a section's sentences, without its tables and code."""
    text = re.sub(r"```.*?```|<!--.*?-->|^(?:    |\|).*?$", "", section, flags=re.DOTALL | re.M)
    lists = re.findall(r"(\d[\d.]*(?:(?:,| and| to) \d[\d.]*)*) ?%", text)
    return numbers(" ".join(lists))


def unfounded(page: str, cards: str, defined: set[str]) -> set[str]:
    """The percentages of sections that name no command, and that no table or card holds."""
    known = rows(page)[""] | numbers(cards) | defined | {"0", "95", "100"}
    sections = re.split(r"^#+ ", page, flags=re.MULTILINE)
    return {
        number
        for section in sections
        if not MEASURES_IT.search(section)
        for number in percentages(section) - known
    }


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_every_percentage_stands_in_a_table_or_a_card_or_beside_its_command(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    cards = "".join(card.read_text(encoding="utf-8") for card in CARDS if shown(page, card))
    assert not unfounded(text, cards, DEFINED.get(page.name, set()))


def shown(page: Path, card: Path) -> bool:
    """Whether a page is on a card's application, or on all agents."""
    return page.stem in ("agents", "model-cards", card.parent.parent.name)


def test_a_percentage_from_nowhere_is_noticed() -> None:
    page = "# A\n\nIt fools 12, 13 and 14 %.\n\n| a | 12 |\n\n# B\n\n`make attack` gives 7 %."
    assert unfounded(page, "14.0 % and 13", {"14"}) == set()
    assert unfounded(page, "", set()) == {"13", "14"}


@pytest.mark.parametrize(
    ("application", "agent"),
    [
        ("driving", "cil"),
        ("driving", "cil-augmented"),
        ("driving", "ppo"),
        ("uav", "ppo"),
        ("uav", "waypoint-pid"),
    ],
)
def test_the_agents_that_are_compared_are_those_of_the_cards(application: str, agent: str) -> None:
    card = (ROOT / "sada_gym" / "envs" / application / "agent" / f"{agent}.md").read_text("utf-8")
    page = (DOCS / "model-cards.md").read_text(encoding="utf-8")
    shipped = re.findall(rf"^\| `{agent}`, 0 \(shipped\) (\|.*\|)$", page, re.MULTILINE)
    assert any(numbers(row) <= rows(card)[""] for row in shipped)


@pytest.mark.long
def test_the_example_of_a_citation_is_what_the_board_says() -> None:
    (row,) = (
        row
        for row in HEADLINES["digits"].rows(read_entries(ENTRIES), "SADA-Digits-3-v0")
        if row.label == "level-set"
    )
    afr, coverage = (
        rate_cell(figure).markdown().replace(" (", " % (", 1)
        for figure in (row.afr, row.relative_coverage)
    )
    page = (DOCS / "measures.md").read_text(encoding="utf-8")
    assert (
        f"> `level-set` on SADA-Digits-3-v0 against `cnn`: AFR {afr}, coverage {coverage}" in page
    )


def claims_of(name: str, place: str) -> Result:
    return read_entry(ENTRIES / name).results[place].claimed


def afr_of(claims: Result, seed: int) -> float:
    (measures,) = (of_seed.measures for of_seed in claims.seeds if of_seed.seed == seed)
    assert measures is not None
    return measures.afr


def test_the_example_of_a_submission_is_what_the_entry_of_gp_claims() -> None:
    claims = claims_of("gp", "SADA-Digits-3-v0.cnn.paper-budgets")
    afr = (afr_of(claims, 0) + afr_of(claims, 1)) / 2
    page = (DOCS / "leaderboard.md").read_text(encoding="utf-8")
    assert f"SADA-Digits-3-v0.cnn.paper-budgets: AFR {100 * afr:.1f} % (" in page


def test_the_pages_show_one_table_of_make_attack_near_the_entries_claims() -> None:
    row = re.compile(r"^ *(random|BBGAN|level-set).* (\d+) %, \d+ of 250 +(\d+) %$", re.MULTILINE)
    pages = ROOT / "README.md", DOCS / "index.md"
    table, same = (row.findall(page.read_text(encoding="utf-8")) for page in pages)
    assert table == same
    assert len(table) == 3
    for name, afr, variety in table:
        claims = claims_of(name.lower(), "SADA-Detection-Car-v0.photographer.equal-queries")
        measures = claims.seeds[0].measures
        assert measures is not None
        assert measures.relative_coverage is not None
        # the entries were made by other kernels; 250 samples tell a rate to 5 points
        assert abs(int(afr) - 100 * measures.afr) < 5
        assert abs(int(variety) - 100 * measures.relative_coverage) < 5
