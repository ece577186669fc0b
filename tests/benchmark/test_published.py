"""The results in docs/results/ that were measured before results became entries."""

from pathlib import Path

import pytest

from sada_gym.benchmark.folder import TABLE_FILE

DOCS = Path(__file__).parents[2] / "docs"
FROZEN = ("driving",)
MADE_BY = (
    "These results were made by commit 81cc8a5, before results became entries of the leaderboard; "
    "they will be measured anew."
)


@pytest.mark.parametrize("name", FROZEN)
def test_frozen_tables_say_which_commit_made_them(name):
    text = (DOCS / "results" / name / TABLE_FILE).read_text(encoding="utf-8")
    heading, blank, below, *_ = text.splitlines()
    assert heading == "# Benchmark results"
    assert (blank, below) == ("", MADE_BY)
