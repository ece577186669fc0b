"""What the board shows: entries by group of tracks, ranked within a tier, and what is outdated."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

from leaderboard.board_tables import (
    OutdatedResult,
    missing_part,
    outdated_sheet,
    paper_sheet,
    ranking_sheets,
    strongest_sheet,
)
from sada_gym.board.benchmark.results import Results, TableComparison, results_of
from sada_gym.board.results.entry import Entry, EntryResult
from sada_gym.board.results.front import FrontChart, make_chart
from sada_gym.board.results.models import Tier
from sada_gym.board.results.rows import Row
from sada_gym.board.results.sheet import Sheet
from sada_gym.board.submission.checks import find_outdated
from sada_gym.foundations.cards import ApplicationCard, cards

TIERS: tuple[Tier, ...] = ("verified", "claimed")
"""The tiers in the order of the pages. Figures of one are never ranked with those of another."""


@dataclass(frozen=True)
class Ranking:
    """One comparison in one tier: the rows, and the tables over all tracks and on each of them.

    Attributes:
        partial: The table of entries that did not run on every track, with every seed; None
            without any.
        open: Whether the page unfolds it: it has entries that no higher tier has.
    """

    tier: Tier
    rows: tuple[Row, ...]
    whole: Sheet
    partial: Sheet | None
    by_track: Sheet
    coverage_by_track: Sheet | None
    open: bool

    @cached_property
    def chart(self) -> FrontChart | None:
        """The chart of AFR against coverage; None where fewer than two entries have both."""
        return make_chart(self.rows, f"Attack fooling rate against coverage, {self.tier}")


@dataclass(frozen=True, eq=False)
class GroupBoard:
    """What the entries hold on the tracks of one application: a page of the board.

    Attributes:
        entries: The entries with those of their results that are of this group and today's.
        results: What the results sum up to, by tier.
        unchecked: Which parts are missing here, so that nobody can tell whether results of theirs
            are outdated; a sentence each.
    """

    card: ApplicationCard
    entries: tuple[Entry, ...]
    results: Mapping[Tier, Results]
    outdated: tuple[OutdatedResult, ...]
    unchecked: tuple[str, ...] = ()

    @cached_property
    def comparisons(self) -> tuple[tuple[TableComparison, tuple[Ranking, ...]], ...]:
        """What is claimed in each table against each agent, with its rankings by tier."""
        claims = self.results["claimed"].comparisons
        return tuple((claimed, tuple(self._rankings(claimed))) for claimed in claims)

    @property
    def outdated_sheet(self) -> Sheet | None:
        """The table of outdated results; None without any."""
        return outdated_sheet(self.card.page, self.outdated) if self.outdated else None

    @cached_property
    def paper_sheet(self) -> Sheet | None:
        """The paper's numbers alone, where there is no entry yet and the paper has the tracks."""
        return None if self.comparisons else paper_sheet(self.card)

    def _rankings(self, claimed: TableComparison) -> Iterator[Ranking]:
        verified = self.results["verified"].find(claimed.table.name, claimed.agent)
        known = {row.entry for row in verified.rows} if verified else set()
        for tier, comparison in zip(TIERS, (verified, claimed), strict=True):
            if comparison is None:
                continue
            rows = comparison.rows
            whole, partial, by_track, coverage = ranking_sheets(
                self.card, self.entries, comparison, tier
            )
            yield Ranking(
                tier,
                rows,
                whole,
                partial if partial.lines else None,
                by_track,
                coverage if coverage.lines else None,
                open=any(row.entry not in known for row in rows),
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
        return strongest_sheet((g.card, g.entries, g.results["verified"]) for g in self.groups)


def make_board(
    entries: Sequence[Entry], applications: Sequence[ApplicationCard] | None = None
) -> Board:
    """Sort entries into groups, set aside what is outdated, and rank the rest.

    Args:
        entries: All entries.
        applications: The applications with a place on the board; by default all that are known.
            Those beside the five of the benchmark's suites have a page where there are results.
    """
    missing: dict[str, str] = {}
    outdated = []
    for entry in entries:
        for result in entry.results.values():
            experiment = result.experiment
            track, agent = experiment.target.track, experiment.target.agent
            if lacking := missing_part(track, agent):
                missing[track] = lacking
            elif (reason := find_outdated(experiment)) is not None:
                outdated.append(OutdatedResult(entry, result, reason))
    left_out = {id(late.result) for late in outdated}
    boards, elsewhere = [], outdated
    for card in cards() if applications is None else applications:
        tracks = card.board_tracks
        late = tuple(result for result in outdated if result.result.track in tracks)
        elsewhere = [result for result in elsewhere if result not in late]

        def is_current(result: EntryResult, tracks: Collection[str] = tracks) -> bool:
            return result.track in tracks and id(result) not in left_out

        # every entry goes in, so that two of one title are told apart on every page
        chosen = [entry.keeping(is_current) for entry in entries]
        results = {tier: results_of(chosen, tier=tier) for tier in TIERS}
        with_results = tuple(entry for entry in chosen if entry.results)
        if with_results or late or (card.suite and card.suite.overview):
            lacking_here = dict.fromkeys(missing[track] for track in tracks if track in missing)
            boards.append(GroupBoard(card, with_results, results, late, tuple(lacking_here)))
    return Board(tuple(entries), tuple(boards), tuple(elsewhere))
