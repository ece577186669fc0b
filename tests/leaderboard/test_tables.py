"""The tables in docs/ are made from the entries, and the entries are of today's agents."""

import re
import sys

import pytest
import typer
from prose import numbers, rows

from leaderboard import tables
from leaderboard.tables import (
    BLOCKS,
    DOCS,
    ENTRIES,
    HEADLINES,
    SUITES,
    pages,
    results_of_suite,
    robustness,
)
from sada_gym.board.benchmark.suite import ADVERSARIES, find_suite
from sada_gym.board.benchmark.suite import SUITES as SUITES_OF_ALL
from sada_gym.board.benchmark.tables import TABLE_FILE, write_tables
from sada_gym.board.results.entry import read_entries
from sada_gym.board.submission.checks import check_entry, find_outdated


@pytest.fixture(scope="module")
def entries():
    return read_entries(ENTRIES)


@pytest.mark.parametrize("comparison", HEADLINES.values(), ids=HEADLINES)
def test_all_adversaries_are_verified_on_all_tracks(entries, comparison):
    rows = comparison.rows(entries)
    assert [row.label for row in rows] == list(ADVERSARIES)
    tracks = find_suite(comparison.suite).tracks
    assert {row.tracks for row in rows} == {len(tracks)}
    assert all(row.failed == 0 for row in rows)


def test_all_agents_are_verified_on_all_tracks(entries):
    _, _, *lines = robustness(entries)
    assert lines
    assert not [line for line in lines if "| - " in line]


def test_the_pages_say_what_the_entries_say(entries):
    for path, text in pages(entries).items():
        assert path.read_text(encoding="utf-8") == text, "run: python -m leaderboard.tables"


@pytest.mark.parametrize(("option", "code"), [("--help", 0), ("--sweets", 2)])
def test_an_option_writes_no_page(option, code, monkeypatch, tmp_path, capsys):
    monkeypatch.setattr(tables, "DOCS", tmp_path)
    monkeypatch.setattr(sys, "argv", ["tables", option])
    with pytest.raises(SystemExit) as ended:
        typer.run(tables.main)
    assert ended.value.code == code
    assert "--suites" in "".join(capsys.readouterr())
    assert not any(tmp_path.iterdir())


def test_every_table_has_its_place():
    for name, (page, _) in BLOCKS.items():
        marks = re.findall(r"<!-- table: ([\w-]+) -->", (DOCS / page).read_text(encoding="utf-8"))
        assert marks.count(name) == 1


@pytest.mark.long
@pytest.mark.parametrize("suite", SUITES)
def test_the_whole_tables_say_what_the_entries_say(entries, suite, tmp_path):
    results, head = results_of_suite(entries, suite), tables.heading(suite)
    written = write_tables(tmp_path, results, head=head).read_text(encoding="utf-8")
    published = DOCS / "results" / suite / TABLE_FILE
    assert published.read_text(encoding="utf-8") == written, "run: python -m leaderboard.tables"


@pytest.mark.long
def test_an_entry_that_changes_changes_the_pages(entries):
    fewer = [entry for entry in entries if entry.metadata.name != "gp"]
    page = DOCS / "results" / "adversaries.md"
    before, after = pages(entries)[page], pages(fewer)[page]
    assert "| gp |" in before
    assert "| gp |" not in after


def sentences(text):
    """A page's sentences, without its tables, code blocks, comments and links' targets."""
    text = re.sub(r"^---\n.*?^---\n|```.*?```|<!--.*?-->", "", text, flags=re.DOTALL | re.MULTILINE)
    text = re.sub(r"\]\([^)]*\)", "]", text)
    lines = (line for line in text.splitlines() if not line.startswith("|"))
    return re.split(r"(?<=[.:;])\s|\n\n|\n- ", "\n".join(lines))


def settings(entries):
    """The numbers that say what was measured: budgets, samples, seeds, tracks; and the level."""
    figures = {"0", "1", "3", "4", "5", "9", "95", "100", "250"}
    figures |= {
        f"{result.experiment.protocol.budget:,}"
        for entry in entries
        for result in entry.results.values()
    }
    for suite in SUITES_OF_ALL:
        figures |= {f"{len(suite.tracks)}"}
        for table in suite.tables:
            for rule in (table.budget, *table.budget_of.values()):
                figures |= {f"{number:,}" for number in (rule.queries, *rule.of_adversary.values())}
    return figures


@pytest.mark.parametrize("name", ["index", "adversaries", "paper", "rl", "agents"])
def test_every_figure_of_a_sentence_stands_in_a_row_that_it_names(entries, name):
    page = DOCS / "results" / f"{name}.md"
    text = page.read_text(encoding="utf-8")
    included = re.findall(r"{include} (\S+)", text)
    known = rows(text + "".join((page.parent / file).read_text("utf-8") for file in included))
    set_up = settings(entries)
    for sentence in sentences(text):
        named = [label for label in re.findall(r"`([^`]+)`", sentence) if label in known] or [""]
        allowed = set_up.union(*(known.get(label, set()) for label in named))
        assert numbers(re.sub(r"`[^`]*`", "", sentence)) <= allowed, sentence


def test_a_figure_of_another_row_is_noticed():
    known = rows("| a | 12 |\n| b | 34.5 (30 to 40) |")
    assert known == {"a": {"12"}, "b": {"34.5", "30", "40"}, "": {"12", "34.5", "30", "40"}}
    assert sentences("One `a` has 12 %. Another\nsays 3.\n\n- Two [b](c9)\n| a | 5 |\n") == [
        "One `a` has 12 %.",
        "Another\nsays 3.",
        "",
        "Two [b]",
    ]


def test_the_first_pages_table_has_whoever_is_first_anywhere(entries):
    shown = {line.split("|")[1].strip() for line in tables.beside_the_first((), entries)}
    everybody = [line.split("|") for line in tables.side_by_side(None, entries)]
    first = {cells[1].strip() for cells in everybody if any("**" in cell for cell in cells)}
    assert {"gp", "level-set"} <= first == shown - {"adversary", "---"}


@pytest.mark.long
def test_the_entries_pass_the_checks_and_are_of_today(entries):
    for entry in entries:
        check_entry(entry.folder, submission=False)
        for result in entry.results.values():
            assert find_outdated(result.experiment) is None
