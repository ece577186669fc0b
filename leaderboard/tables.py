"""Makes the tables in docs/ from the entries: `python -m leaderboard.tables`.

With `--suites` it prints the names of the suites that `make results` measures instead.

A page marks the place of a table by a line `<!-- table: NAME -->`; what follows, up to
`<!-- end of table -->`, is replaced. The pages `docs/results/SUITE/table.md` are written as a
whole.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from pathlib import Path

from leaderboard.groups import track_of
from sada_gym import agents
from sada_gym.benchmark.report.tables import write_tables
from sada_gym.benchmark.results import Results, results_of
from sada_gym.benchmark.suite import ADVERSARIES, TABLES, find_suite
from sada_gym.benchmark.suite import SUITES as ALL_SUITES
from sada_gym.cards import cards
from sada_gym.results.columns import COLUMNS, row_cells, row_columns
from sada_gym.results.entry import Entry, read_entries
from sada_gym.results.models import Tier
from sada_gym.results.rows import Row
from sada_gym.results.sheet import Cell, Column, Line, Sheet, text_cell

ROOT = Path(__file__).parents[1]
ENTRIES = ROOT / "leaderboard" / "entries"
DOCS = ROOT / "docs"

MEASURED = tuple(suite.name for suite in ALL_SUITES if suite.name != "quick")
"""The suites that `make results` measures."""

SUITES = tuple(name for name in MEASURED if name != "table-1-columns")
"""The suites that have a page `docs/results/SUITE/table.md`."""

_BLOCK = re.compile(r"(<!-- table: ([\w-]+) -->\n).*?(<!-- end of table -->)", re.DOTALL)
_NONE = "No verified result yet."


@dataclass(frozen=True)
class Comparison:
    """All adversaries against one agent.

    Attributes:
        title: What was attacked.
        suite: The suite's name.
        table: The table's name.
        agent: The agent's name.
    """

    title: str
    suite: str
    table: str
    agent: str

    def rows(self, entries: Sequence[Entry], track: str | None = None) -> list[Row]:
        """Give the verified rows, over all of the suite's tracks or on one.

        Means over different tracks do not compare: there is no row until each has all tracks.
        """
        results = _verified(self.suite, self.table, tuple(entries))
        over_all = results.rows_of(self.table, self.agent, None)
        tracks = len(find_suite(self.suite).tracks)
        if any(row.tracks < tracks for row in over_all):
            return []
        return over_all if track is None else results.rows_of(self.table, self.agent, track)


@lru_cache(maxsize=16)
def _verified(suite: str, table: str, entries: tuple[Entry, ...]) -> Results:
    """Put together what is verified on a suite's tracks, once for all pages that show it."""
    held = _on(find_suite(suite).tracks, entries)
    return results_of(held, [TABLES[table]], tier="verified")


COMPARISONS = {
    suite.name: Comparison(
        suite.name.capitalize(),
        suite.name,
        suite.tables[0],
        card.agents[0].name if card.agents else "",
    )
    for card in cards()
    if (suite := card.suite) is not None
}
"""The comparisons that pages show, by the names of their tables."""


def results_of_suite(entries: Sequence[Entry], suite: str, tier: Tier = "claimed") -> Results:
    """Put together what the entries hold on the tracks of a suite.

    Args:
        entries: The entries.
        suite: The suite's name.
        tier: Whether the figures are the submitters' or the verifier's.
    """
    chosen = find_suite(suite)
    return results_of(_on(chosen.tracks, entries), chosen.tables, tier=tier)


def _on(tracks: Sequence[str], entries: Sequence[Entry]) -> list[Entry]:
    """Keep the results on some tracks."""
    kept = (entry.keeping(lambda result: track_of(result) in tracks) for entry in entries)
    return [entry for entry in kept if entry.results]


def _sheet(rows: Sequence[Row], *keys: str) -> Iterator[str]:
    lines = [Line("ranked", row_cells(row, keys, places=0)) for row in rows]
    return Sheet("", "", row_columns(*keys), tuple(lines)).markdown()


def compared(comparison: Comparison, entries: Sequence[Entry]) -> Iterator[str]:
    """Show each adversary's F1 with its rank, and the AFR and coverage that it joins."""
    rows = comparison.rows(entries)
    if not rows:
        yield _NONE
        return
    yield from _sheet(rows, "adversary", "f1", "rank", "afr", "relative_coverage")


def side_by_side(labels: Sequence[str] | None, entries: Sequence[Entry]) -> Iterator[str]:
    """Show AFR / coverage of adversaries in all comparisons; rank 1 is bold.

    Args:
        labels: The adversaries; None for all.
        entries: The entries.
    """
    rows = {one.title: _by_label(one.rows(entries)) for one in COMPARISONS.values()}
    lines = [
        Line(
            "ranked",
            {"adversary": text_cell(label)}
            | {
                title: _pair(of_title[label])
                for title, of_title in rows.items()
                if label in of_title
            },
        )
        for label in labels or ADVERSARIES
    ]
    columns = (*row_columns("adversary"), *(Column(title, title) for title in rows))
    return Sheet("", "", columns, tuple(lines)).markdown()


def on_track(
    name: str, track: str, labels: Sequence[str], entries: Sequence[Entry]
) -> Iterator[str]:
    """Show AFR and coverage of some adversaries on one track of a comparison."""
    rows = _by_label(COMPARISONS[name].rows(entries, track))
    chosen = [rows[label] for label in labels if label in rows]
    return _sheet(chosen, "adversary", "afr", "relative_coverage")


_AGAINST = ("random", "gp", "smc", "bbgan", "bbgan-boost", "trees", "level-set")


def robustness(entries: Sequence[Entry]) -> Iterator[str]:
    """Show how often uniform worlds, and those of some adversaries, fool each shipped agent."""
    lines = []
    for default in COMPARISONS.values():
        for agent in agents.names(_application(default.suite)):
            other = replace(default, table="other-agents", agent=agent)
            rows = _by_label((default if agent == default.agent else other).rows(entries))
            cells = {label: _afr(rows[label]) for label in _AGAINST if label in rows}
            heads = {"application": text_cell(default.title), "agent": text_cell(agent)}
            lines.append(Line("ranked", heads | cells))
    columns = tuple(Column(key, key) for key in ("application", "agent", *_AGAINST))
    return Sheet("", "", columns, tuple(lines)).markdown()


def _application(suite: str) -> str:
    return next(card.name for card in cards() if card.suite and card.suite.name == suite)


def _by_label(rows: Sequence[Row]) -> dict[str, Row]:
    return {row.label: row for row in rows}


def _afr(row: Row) -> Cell:
    return replace(COLUMNS["afr"].cell(row, 0), interval=None)


def _pair(row: Row) -> Cell:
    """Join AFR / coverage, in bold where the row has rank 1, shared or not."""
    pair = (COLUMNS[key].cell(row, 0).text for key in ("afr", "relative_coverage"))
    return text_cell(" / ".join(text or "-" for text in pair), bold=row.is_first)


_RL = ("reinforce", "ppo", "sac", "td3")
_BESIDE_RL = ("random", "gmm50", "bbgan", "bbgan-boost", "level-set", *_RL)
_HEADLINE = ("random", "bbgan (paper)", "gmm50", "bbgan-boost", "bayesian", "level-set")

BLOCKS: Mapping[str, tuple[str, Callable[[Sequence[Entry]], Iterator[str]]]] = {
    "readme": ("../README.md", partial(side_by_side, _HEADLINE)),
    "overview": ("results/index.md", partial(side_by_side, None)),
    **{
        name: ("results/adversaries.md", partial(compared, comparison))
        for name, comparison in COMPARISONS.items()
    },
    "rl": ("results/rl.md", partial(side_by_side, _BESIDE_RL)),
    "rl-rare": (
        "results/rl.md",
        partial(on_track, "digits", "SADA-Digits-4-v0", _BESIDE_RL),
    ),
    "robustness": ("results/agents.md", robustness),
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
    """Write all tables of the documentation, or print the names of the suites."""
    if sys.argv[1:] == ["--suites"]:
        print(*MEASURED)
        return
    entries = read_entries(ENTRIES)
    for suite in SUITES:
        path = write_tables(DOCS / "results" / suite, results_of_suite(entries, suite))
        print(f"{path.relative_to(ROOT)}")
    for path, text in pages(entries).items():
        path.write_text(text, encoding="utf-8")
        print(f"{path.relative_to(ROOT)}")


if __name__ == "__main__":
    main()
