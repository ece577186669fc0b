"""The tables in docs/ are made from the entries, and the entries are of today's agents."""

import re

import pytest

from leaderboard.tables import BLOCKS, DOCS, ENTRIES, SUITES, pages, results_of_suite
from sada_gym.benchmark.report.tables import TABLE_FILE, write_tables
from sada_gym.leaderboard.checks import check_entry, is_outdated
from sada_gym.leaderboard.entry import read_entries


@pytest.fixture(scope="module")
def entries():
    return read_entries(ENTRIES)


def test_there_are_verified_entries_of_all_adversaries_of_a_suite(entries):
    results = results_of_suite(entries, "digits", "verified")
    assert len(results.rows_of("paper-budgets", "cnn", None)) == 22
    assert len(results.runs) == 22 * 10 * 3


def test_the_pages_say_what_the_entries_say(entries):
    for path, text in pages(entries).items():
        assert path.read_text(encoding="utf-8") == text, "run: python -m leaderboard.tables"


def test_every_table_has_its_place():
    for name, (page, _) in BLOCKS.items():
        marks = re.findall(r"<!-- table: ([\w-]+) -->", (DOCS / page).read_text(encoding="utf-8"))
        assert marks.count(name) == 1


@pytest.mark.parametrize("suite", SUITES)
def test_the_whole_tables_say_what_the_entries_say(entries, suite, tmp_path):
    written = write_tables(tmp_path, results_of_suite(entries, suite)).read_text(encoding="utf-8")
    published = DOCS / "results" / suite / TABLE_FILE
    assert published.read_text(encoding="utf-8") == written, "run: python -m leaderboard.tables"


def test_an_entry_that_changes_changes_the_pages(entries):
    fewer = [entry for entry in entries if entry.about.name != "gp"]
    (before,), (after,) = pages(entries).values(), pages(fewer).values()
    assert "| gp |" in before
    assert "| gp |" not in after.partition("table: digits")[2].partition("end of table")[0]


def test_the_entries_pass_the_checks_and_are_of_today(entries):
    for entry in entries:
        check_entry(entry.folder, submission=False)
        for result in entry.results.values():
            assert is_outdated(result.claimed.identity) is None
