"""Makes the tables in docs/ from the entries: `python -m leaderboard.tables`.

A page marks the place of a table by a line `<!-- table: NAME -->`; what follows, up to
`<!-- end of table -->`, is replaced. The pages under docs/results/ are written as a whole.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path

from sada_gym.benchmark.figures import Figure
from sada_gym.benchmark.report.tables import (
    percent,
    rank_of,
    table_head,
    table_line,
    with_interval,
    write_tables,
)
from sada_gym.benchmark.results import Results, results_of
from sada_gym.benchmark.suite import find_suite
from sada_gym.leaderboard.entry import Entry, Tier, read_entries

ROOT = Path(__file__).parents[1]
ENTRIES = ROOT / "leaderboard" / "entries"
DOCS = ROOT / "docs"

SUITES = ("digits",)
"""The suites whose results are entries, each with a page `docs/results/SUITE/table.md`."""

_BLOCK = re.compile(r"(<!-- table: ([\w-]+) -->\n).*?(<!-- end of table -->)", re.DOTALL)


def results_of_suite(entries: Sequence[Entry], suite: str, tier: Tier = "claimed") -> Results:
    """Put together what the entries hold on the tracks of a suite.

    Args:
        entries: The entries.
        suite: The suite's name.
        tier: Whether the figures are the submitters' or the verifier's.
    """
    chosen = find_suite(suite)
    held = [
        entry.keeping(lambda result: result.claimed.identity.track in chosen.tracks)
        for entry in entries
    ]
    return results_of([entry for entry in held if entry.results], chosen.tables, tier=tier)


def digits(entries: Sequence[Entry]) -> Iterator[str]:
    """Give AFR and coverage over the ten digits, and those of the digit that is hardest to fool."""
    results, agent = results_of_suite(entries, "digits", "verified"), "cnn"
    hardest = {
        row.label: row for row in results.rows_of("paper-budgets", agent, "SADA-Digits-4-v0")
    }
    columns = "adversary", "AFR, %", "rank", "coverage", "rank", "AFR on digit 4", "coverage"
    yield from table_head(columns)
    for row in results.rows_of("paper-budgets", agent, None):
        coverage, four = row.relative_coverage, hardest[row.label]
        yield table_line(
            row.label,
            with_interval(row.afr, 0),
            rank_of(row.afr),
            _alone(coverage),
            rank_of(coverage),
            _alone(four.afr),
            _alone(four.relative_coverage),
        )


def _alone(figure: Figure | None) -> str:
    return percent(None if figure is None else figure.value, 0)


BLOCKS: Mapping[str, tuple[str, Callable[[Sequence[Entry]], Iterator[str]]]] = {
    "digits": ("results.md", digits),
}
"""The tables within pages, by name: the page, and what makes the table's lines."""


def pages(entries: Sequence[Entry], docs: Path = DOCS) -> dict[Path, str]:
    """Give the text of every page that holds a table, as the entries have it now.

    Args:
        entries: The entries.
        docs: The folder of the documentation.

    Raises:
        KeyError: If a page marks the place of a table that nothing makes.
    """
    found = {}
    for name in dict.fromkeys(page for page, _ in BLOCKS.values()):
        text = (docs / name).read_text(encoding="utf-8")
        found[docs / name] = _BLOCK.sub(
            lambda match: "\n".join((match[1].rstrip(), *BLOCKS[match[2]][1](entries), match[3])),
            text,
        )
    return found


def main() -> None:
    """Write all tables of the documentation."""
    entries = read_entries(ENTRIES)
    for suite in SUITES:
        path = write_tables(DOCS / "results" / suite, results_of_suite(entries, suite))
        print(f"{path.relative_to(ROOT)}")
    for path, text in pages(entries).items():
        path.write_text(text, encoding="utf-8")
        print(f"{path.relative_to(ROOT)}")


if __name__ == "__main__":
    main()
