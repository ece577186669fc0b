"""Makes the tables in docs/ from the entries: `python -m leaderboard.tables`.

A page marks the place of a table by a line `<!-- table: NAME -->`; what follows, up to
`<!-- end of table -->`, is replaced. The pages `docs/results/SUITE/table.md` are written as a
whole.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from pathlib import Path
from typing import Annotated

import typer

from sada_gym import agents
from sada_gym.board.benchmark.results import Results, TableComparison, results_of
from sada_gym.board.benchmark.suite import ADVERSARIES, TABLES, default_agent, find_suite
from sada_gym.board.benchmark.suite import SUITES as ALL_SUITES
from sada_gym.board.benchmark.tables import write_tables
from sada_gym.board.results.columns import row_cells, row_columns
from sada_gym.board.results.entry import Entry, read_entries
from sada_gym.board.results.rows import Row
from sada_gym.board.results.sheet import (
    BLANK,
    Cell,
    markdown_table,
    rate_cell,
    text_cell,
    titled_table,
)
from sada_gym.foundations.cards import ApplicationCard, SuiteCard, cards

ROOT = Path(__file__).parents[1]
ENTRIES = ROOT / "leaderboard" / "entries"
DOCS = ROOT / "docs"

_WITH_SUITE = tuple((card, card.suite) for card in cards() if card.suite is not None)
_MISSING = {suite.name for card, suite in _WITH_SUITE if card.missing}

MEASURED = tuple(
    suite.name for suite in ALL_SUITES if suite.name != "quick" and suite.name not in _MISSING
)
"""The suites that `make results` measures: not those whose parts are not installed."""

SUITES = tuple(
    suite.name
    for suite in ALL_SUITES
    if suite.name not in ("quick", "table-1-columns") and (DOCS / "results" / suite.name).is_dir()
)
"""The suites that have a page `docs/results/SUITE/table.md`."""

_BLOCK = re.compile(r"(<!-- table: ([\w-]+) -->\n).*?(<!-- end of table -->)", re.DOTALL)


@dataclass(frozen=True)
class Headline:
    """The comparison of all adversaries that the pages show of a suite: one table, one agent."""

    title: str
    suite: str
    table: str
    agent: str

    def rows(self, entries: Sequence[Entry], track: str | None = None) -> tuple[Row, ...]:
        """Return the verified rows, over all of the suite's tracks or on one.

        Means over different tracks do not compare: there is no row until each has all tracks.
        """
        verified = self.verified(entries)
        tracks = find_suite(self.suite).tracks
        if verified is None or any(row.tracks < len(tracks) for row in verified.rows):
            return ()
        return verified.rows if track is None else verified.by_track[track]

    def verified(self, entries: Sequence[Entry]) -> TableComparison | None:
        """Return what is verified on any of the suite's tracks."""
        return _verified(self.suite, self.table, tuple(entries)).find(self.table, self.agent)

    def by_label(self, entries: Sequence[Entry], track: str | None = None) -> dict[str, Row]:
        """Return the same rows by the adversaries' labels."""
        return {row.label: row for row in self.rows(entries, track)}


@lru_cache(maxsize=16)
def _verified(suite: str, table: str, entries: tuple[Entry, ...]) -> Results:
    """Put together what is verified on a suite's tracks, once for all pages that show it."""
    return results_of(_on(find_suite(suite).tracks, entries), [TABLES[table]], tier="verified")


def _headline(card: ApplicationCard, suite: SuiteCard) -> Headline:
    agent = default_agent(card.name)
    return Headline(suite.name.capitalize(), suite.name, suite.tables[0], agent)


HEADLINES = {suite.name: _headline(card, suite) for card, suite in _WITH_SUITE if suite.overview}
"""The comparisons that pages show, by the names of their suites."""


def results_of_suite(entries: Sequence[Entry], suite: str) -> Results:
    """Put together what the entries claim on the tracks of a suite."""
    chosen = find_suite(suite)
    return results_of(_on(chosen.tracks, entries), chosen.tables)


def heading(suite: str) -> str:
    """Return how a page `docs/results/SUITE/table.md` begins."""
    title = {"table-1": "The SADA paper's Table 1", "agents": "The other agents"}
    where = {"table-1": "the paper's tracks", "agents": "the other agents", "robot": "the robot"}
    return (
        f"# {title.get(suite, suite.capitalize())} in full\n\n"
        f"**Every measure of every adversary on {where.get(suite, suite)}, as the "
        "[leaderboard's](../../leaderboard.md) entries claim them.** [The results](../index.md) "
        "show fewer measures, which the verifier measured again on fresh seeds."
    )


def _on(tracks: Sequence[str], entries: Sequence[Entry]) -> list[Entry]:
    kept = (entry.keeping(lambda result: result.track in tracks) for entry in entries)
    return [entry for entry in kept if entry.results]


def _row_table(rows: Sequence[Row], *keys: str) -> Iterator[str]:
    return markdown_table(row_columns(*keys), (row_cells(row, keys, places=0) for row in rows))


def _pairs(rows: Mapping[str, Mapping[str, Row]], labels: Iterable[str]) -> Iterator[str]:
    """Show AFR / coverage of adversaries by column, which has rows by label; rank 1 is bold."""

    def pair(row: Row | None) -> Cell:
        if row is None:
            return BLANK
        cells = row_cells(row, ("afr", "relative_coverage"), places=0).values()
        return text_cell(" / ".join(cell.text or "-" for cell in cells), bold=row.is_first)

    lines = ((text_cell(label), *(pair(of.get(label)) for of in rows.values())) for label in labels)
    return titled_table(("adversary", *rows), lines)


def compared(headline: Headline, entries: Sequence[Entry]) -> Iterator[str]:
    """Show F1 with its rank, AFR and coverage of the first adversaries, and of some others."""
    rows = [row for row in headline.rows(entries) if row.is_first or row.label in _BESIDE_FIRST]
    if not rows:
        return iter(["No verified result yet."])
    return _row_table(rows, "adversary", "f1", "rank", "afr", "relative_coverage")


def side_by_side(labels: Sequence[str] | None, entries: Sequence[Entry]) -> Iterator[str]:
    """Show AFR / coverage of adversaries, or of all, in all comparisons; rank 1 is bold."""
    rows = {headline.title: headline.by_label(entries) for headline in HEADLINES.values()}
    return _pairs(rows, labels or ADVERSARIES)


def beside_the_first(labels: Sequence[str], entries: Sequence[Entry]) -> Iterator[str]:
    """Show some adversaries as `side_by_side` does, and all that have rank 1 anywhere."""
    compared = [headline.rows(entries) for headline in HEADLINES.values()]
    first = {row.label for rows in compared for row in rows if row.is_first}
    chosen = [label for label in ADVERSARIES if label in first or label in labels]
    return side_by_side(chosen, entries)


def by_track(card: ApplicationCard, suite: SuiteCard, entries: Sequence[Entry]) -> Iterator[str]:
    """Show each adversary's AFR / coverage on each track that has a verified result."""
    verified = _headline(card, suite).verified(entries)
    if verified is None:
        return iter(["No verified result yet."])
    on_tracks = {
        card.short(track): {row.label: row for row in rows}
        for track, rows in verified.by_track.items()
    }
    return _pairs(on_tracks, (row.label for row in verified.rows))


def on_track(
    name: str, track: str, labels: Sequence[str], entries: Sequence[Entry]
) -> Iterator[str]:
    """Show AFR and coverage of some adversaries on one track of a comparison."""
    rows = HEADLINES[name].by_label(entries, track)
    chosen = [rows[label] for label in labels if label in rows]
    return _row_table(chosen, "adversary", "afr", "relative_coverage")


_BESIDE_FIRST = ("ideal", "memorise", "random", "bayesian", "bbgan (paper)", "bbgan", "bbgan-boost")
_AGAINST = ("random", "gp", "smc", "bbgan", "bbgan-boost", "trees", "level-set")


def robustness(entries: Sequence[Entry]) -> Iterator[str]:
    """Show how often uniform worlds, and those of some adversaries, fool each shipped agent."""
    lines = []
    for card in cards():
        default = HEADLINES.get(card.suite.name) if card.suite else None
        for agent in agents.names(card.name) if default else ():
            assert default is not None
            other = replace(default, table="other-agents", agent=agent)
            rows = (default if agent == default.agent else other).by_label(entries)
            rates = (rows[label].afr if label in rows else None for label in _AGAINST)
            cells = (rate_cell(afr.value if afr else None, 0) for afr in rates)
            lines.append((text_cell(default.title), text_cell(agent), *cells))
    return titled_table(("application", "agent", *_AGAINST), lines)


_RL = ("reinforce", "ppo", "sac", "td3")
_BESIDE_RL = ("random", "gmm50", "bbgan", "bbgan-boost", "level-set", *_RL)
_HEADLINE = ("random", "bbgan (paper)", "gmm50", "bbgan-boost", "bayesian", "level-set")

BLOCKS: Mapping[str, tuple[str, Callable[[Sequence[Entry]], Iterator[str]]]] = {
    "readme": ("../README.md", partial(beside_the_first, _HEADLINE)),
    "overview": ("results/index.md", partial(side_by_side, None)),
    **{
        name: ("results/adversaries.md", partial(compared, headline))
        for name, headline in HEADLINES.items()
    },
    **{  # on the environment's own page
        suite.name: (f"environments/{suite.name}.md", partial(by_track, card, suite))
        for card, suite in _WITH_SUITE
        if not suite.overview
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
    """Return the text of every page that holds a table, as the entries have it now.

    Raises:
        KeyError: If a page marks the place of a table that nothing makes.
    """

    def filled(match: re.Match[str]) -> str:
        return "\n".join((match[1].rstrip(), *BLOCKS[match[2]][1](entries), match[3]))

    paths = dict.fromkeys(docs / page for page, _ in BLOCKS.values())
    return {path: _BLOCK.sub(filled, path.read_text(encoding="utf-8")) for path in paths}


def main(
    suites: Annotated[
        bool, typer.Option("--suites", help="Print what `make results` measures; write nothing.")
    ] = False,
) -> None:
    """Write all tables of the documentation, or print the names of the suites."""
    if suites:
        print(*MEASURED)
        return
    entries = read_entries(ENTRIES)
    for suite in SUITES:
        folder = DOCS / "results" / suite
        folder.mkdir(exist_ok=True)
        path = write_tables(folder, results_of_suite(entries, suite), head=heading(suite))
        print(f"{path.relative_to(ROOT)}")
    for path, text in pages(entries).items():
        path.write_text(text, encoding="utf-8")
        print(f"{path.relative_to(ROOT)}")


if __name__ == "__main__":
    typer.run(main)
