"""What the board shows: entries by group of tracks, ranked within a tier, and what is outdated."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

from leaderboard.board_tables import outdated_sheet, paper_sheet, ranking_sheets, strongest_sheet
from leaderboard.groups import GroupResults, OutdatedResult, TrackGroup, track_of
from sada_gym.benchmark.results import results_of
from sada_gym.benchmark.suite import Table, tables_of
from sada_gym.cards import ApplicationCard, cards
from sada_gym.experiment.record import slug
from sada_gym.results.entry import Entry
from sada_gym.results.front import Chart, make_chart
from sada_gym.results.models import Tier
from sada_gym.results.rows import Row
from sada_gym.results.sheet import Sheet
from sada_gym.submission.checks import find_outdated

TIERS: tuple[Tier, ...] = ("verified", "claimed")
"""The tiers in the order of the pages. Figures of one are never ranked with those of another."""


@dataclass(frozen=True)
class Ranking:
    """One comparison in one tier: the rows, and the tables over all tracks and on each of them.

    Attributes:
        open: Whether the page unfolds it: it has entries that no higher tier has.
    """

    tier: Tier
    rows: tuple[Row, ...]
    whole: Sheet
    by_track: Sheet
    coverage_by_track: Sheet | None
    open: bool

    @cached_property
    def chart(self) -> Chart | None:
        """The chart of AFR against coverage; None where fewer than two entries have both."""
        return make_chart(self.rows, f"Attack fooling rate against coverage, {self.tier}")


@dataclass(frozen=True)
class Comparison:
    """All entries that attacked one agent under one rule for the budget, by tier."""

    table: Table
    agent: str
    rankings: tuple[Ranking, ...]

    @property
    def anchor(self) -> str:
        """The place on the group's page."""
        return slug(f"{self.table.name}.{self.agent}".strip("."))


@dataclass(frozen=True, eq=False)
class GroupBoard(GroupResults):
    """The board of one group."""

    @cached_property
    def comparisons(self) -> tuple[Comparison, ...]:
        """Each table with each agent, the claims' order first."""
        claimed = self.results["claimed"]
        tables = {table.name: table for table in claimed.tables}
        return tuple(
            Comparison(tables[table], agent, tuple(self._rankings(tables[table], agent)))
            for table, agent in claimed.comparisons()
        )

    @property
    def outdated_sheet(self) -> Sheet | None:
        """The table of outdated results; None without any."""
        return outdated_sheet(self.group.name, self.outdated) if self.outdated else None

    @cached_property
    def paper_sheet(self) -> Sheet | None:
        """The paper's numbers alone, where there is no entry yet and the paper has the tracks."""
        return None if self.comparisons else paper_sheet(self)

    def _rankings(self, table: Table, agent: str) -> Iterator[Ranking]:
        verified = {row.entry for row in self.results["verified"].rows_of(table.name, agent, None)}
        for tier in TIERS:
            rows = self.results[tier].rows_of(table.name, agent, None)
            if not rows:
                continue
            whole, by_track, coverage = ranking_sheets(self, table, agent, tier)
            is_open = any(row.entry not in verified for row in rows)
            yield Ranking(
                tier, tuple(rows), whole, by_track, coverage if coverage.lines else None, is_open
            )


@dataclass(frozen=True, eq=False)
class Board:
    """The whole board; `elsewhere` are outdated results on tracks that are no longer there."""

    entries: tuple[Entry, ...]
    groups: tuple[GroupBoard, ...]
    elsewhere: tuple[OutdatedResult, ...]

    @property
    def outdated(self) -> tuple[OutdatedResult, ...]:
        """All outdated results."""
        return (*(late for group in self.groups for late in group.outdated), *self.elsewhere)

    @cached_property
    def strongest(self) -> Sheet:
        """The board of agents: the strongest verified attack on each track and agent."""
        return strongest_sheet(self.groups)


def make_board(
    entries: Sequence[Entry], applications: Sequence[ApplicationCard] | None = None
) -> Board:
    """Sort entries into groups, set aside what is outdated, and rank the rest.

    Args:
        entries: All entries.
        applications: The applications with a place on the board; by default all that are known.
            Those beside the five of the benchmark's suites have a page where there are results.
    """
    groups = [TrackGroup.of(card) for card in (cards() if applications is None else applications)]
    group_of = {track: group for group in groups for track in group.tracks}
    outdated = [
        OutdatedResult(entry, result, reason)
        for entry in entries
        for result in entry.results.values()
        if (reason := find_outdated(result.claimed.experiment)) is not None
    ]
    left_out = {id(late.result) for late in outdated}

    def outdated_of(group: TrackGroup | None) -> tuple[OutdatedResult, ...]:
        return tuple(late for late in outdated if group_of.get(track_of(late.result)) == group)

    def current(entry: Entry, group: TrackGroup) -> Entry:
        tracks = group.tracks
        return entry.keeping(
            lambda result: track_of(result) in tracks and id(result) not in left_out
        )

    with_suite = {card.name for card in cards() if card.suite is not None}
    boards = []
    for group in groups:
        chosen = tuple(current(entry, group) for entry in entries)
        rules = {
            result.claimed.experiment.protocol.rule
            for entry in chosen
            for result in entry.results.values()
        }
        # every entry goes in, so that two of one title are told apart on every page
        results = {tier: results_of(chosen, tables_of(rules), tier=tier) for tier in TIERS}
        with_results = tuple(entry for entry in chosen if entry.results)
        late = outdated_of(group)
        if with_results or late or group.application in with_suite:
            boards.append(GroupBoard(group, with_results, results, late))
    return Board(tuple(entries), tuple(boards), outdated_of(None))
