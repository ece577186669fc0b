"""The tables of the board: rankings, rates by track, the board of agents, what is outdated."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from sada_gym.board.benchmark.results import Results, TableComparison
from sada_gym.board.benchmark.suite import default_agent
from sada_gym.board.results import paper
from sada_gym.board.results.columns import row_cells, row_columns
from sada_gym.board.results.entry import Entry, EntryResult
from sada_gym.board.results.models import Tier
from sada_gym.board.results.rows import Row, RunSummary
from sada_gym.board.results.sheet import (
    BLANK,
    Cell,
    Column,
    Kind,
    Line,
    Sheet,
    entry_link,
    line_of,
    number_cell,
    rate_cell,
    shaded,
    text_cell,
    text_column,
)
from sada_gym.board.submission.current import PAPER_BUDGETS, current_target
from sada_gym.errors import MissingExtra, MissingPart, UserError
from sada_gym.experiment.record import place_of, slug
from sada_gym.foundations.cards import ApplicationCard

_ENTRY = text_column("entry")
_TIER = text_column(
    "tier",
    hint="Verified: we scored the samples again on fresh seeds. Claimed: the submitter's own "
    "figures.",
    choice=True,
)
_SEEDS = Column(
    "seeds_sd",
    "seeds, ± %",
    "Standard deviation of the AFR between the seeds of a track, and the number of seeds.",
)
_FLAGS = text_column("flags", hint="What a reader must know; the entry's page says it.")
_FIGURES = ("rank", "f1", "afr", "relative_coverage", "coverage", "queries", "mu_std", "runs")
_COLUMNS = (
    *row_columns("rank"),
    _ENTRY,
    _TIER,
    *row_columns("f1", "afr"),
    _SEEDS,
    *row_columns("relative_coverage", "coverage", "queries", "mu_std", "runs"),
    _FLAGS,
)
_BY_TRACK = {
    "afr": "AFR on each track, %",
    "relative_coverage": "Coverage / ideal on each track, %",
}


class _RankingLine(NamedTuple):
    """A line of all sheets of a ranking: its cells over all tracks, and its rates by track."""

    kind: Kind
    name: Cell
    cells: Mapping[str, Cell]
    rates: Mapping[str, Mapping[str, float]]
    complete: bool = True

    def line(self, cells: Mapping[str, Cell]) -> Line:
        return Line(self.kind, {"entry": self.name, **cells})


def ranking_sheets(
    card: ApplicationCard, entries: Sequence[Entry], comparison: TableComparison, tier: Tier
) -> tuple[Sheet, Sheet, Sheet, Sheet]:
    """Lay out a comparison in one tier: entries by F1 (AFR without coverage), then other rates.

    Returns:
        All figures over the tracks; those of entries that did not run on every track, with every
        seed; the AFR by track; the coverage by track.
    """
    entry_of = {entry.metadata.name: entry for entry in entries}
    tracks = tuple(track for track in card.board_tracks if track in comparison.by_track)
    rows = sorted(
        comparison.rows,
        key=lambda row: (not row.complete, -row.deciding.value if row.deciding else math.inf),
    )
    lines = [
        _RankingLine(
            "control" if row.control else "ranked" if row.rank else "unranked",
            entry_link(row.entry, row.label),
            _cells(row, comparison.runs, entry_of[row.entry]),
            _rates(row.entry, {track: comparison.by_track[track] for track in tracks}),
            row.complete,
        )
        for row in rows
    ]
    if comparison.table.name == PAPER_BUDGETS and comparison.agent == default_agent(card.name):
        lines += _paper(tracks)
    lines += _uniform(comparison.agent, tracks, entries)
    name = f"{slug(card.page)}.{comparison.name}.{tier}"
    over = f", mean over {len(tracks)} tracks" if len(tracks) > 1 else " on the only track"
    overall, partial = (
        tuple(line.line(line.cells) for line in lines if line.cells and line.complete is complete)
        for complete in (True, False)
    )
    afr, coverage = (
        _by_track(f"{name}.{figure}", card, tracks, lines, figure) for figure in _BY_TRACK
    )
    return (
        Sheet(f"{name}.all", f"All figures{over}", _COLUMNS, overall),
        Sheet(f"{name}.incomplete", f"Incomplete entries{over}", _COLUMNS, partial),
        afr,
        coverage,
    )


def paper_sheet(card: ApplicationCard) -> Sheet | None:
    """Return the paper's numbers where there is no entry yet; None where the paper has none."""
    lines = list(_paper(card.board_tracks))
    if not lines:
        return None
    lines += _uniform(default_agent(card.name), card.board_tracks)
    return _by_track(f"{card.page}.paper", card, card.board_tracks, lines, "afr")


def _by_track(
    name: str,
    card: ApplicationCard,
    tracks: Sequence[str],
    lines: Sequence[_RankingLine],
    figure: str,
) -> Sheet:
    columns = (_ENTRY, *(Column(track, card.short(track)) for track in tracks))
    shown = tuple(
        line.line({track: shaded(rate_cell(rate)) for track, rate in rates.items()})
        for line in lines
        if (rates := line.rates.get(figure))
    )
    return Sheet(name, _BY_TRACK[figure], columns, shown)


def _rates(entry: str, by_track: Mapping[str, Sequence[Row]]) -> dict[str, dict[str, float]]:
    own = {track: row for track, rows in by_track.items() for row in rows if row.entry == entry}
    return {
        name: {track: figure.value for track, row in own.items() if (figure := getattr(row, name))}
        for name in _BY_TRACK
    }


def _cells(row: Row, runs: Sequence[RunSummary], entry: Entry) -> dict[str, Cell]:
    runs = [run for run in runs if run.entry == row.entry]
    places = dict.fromkeys(run.experiment.place for run in runs)
    results = [entry.results[place] for place in places if place in entry.results]
    tiers = {result.tier for result in results}
    return row_cells(row, _FIGURES) | {
        "tier": text_cell(tiers.pop() if len(tiers) == 1 else "partly verified"),
        "seeds_sd": _spread(runs),
        "flags": _flags(entry, results),
    }


def _spread(runs: Sequence[RunSummary]) -> Cell:
    """Return the deviation between the seeds of a track, its variance pooled over tracks."""
    rates: dict[str, list[float]] = {}
    for run in runs:
        if run.measures is not None:
            rates.setdefault(run.track, []).append(run.measures.afr)
    counts = sorted({len(seeds) for seeds in rates.values()})
    if not counts:
        return BLANK
    several = " to ".join(str(count) for count in dict.fromkeys((counts[0], counts[-1])))
    note = f"{several} seed{'' if counts == [1] else 's'}"
    variances = [float(np.var(seeds, ddof=1)) for seeds in rates.values() if len(seeds) > 1]
    spread = rate_cell(math.sqrt(float(np.mean(variances)))) if variances else BLANK
    return replace(spread, note=note)


def _flags(entry: Entry, results: Sequence[EntryResult]) -> Cell:
    """Name the verifier's flags, and count what else a reader must know."""
    names = dict.fromkeys(
        name for result in results if result.verified for name in result.verified.flags
    )
    count = len(
        {flag for result in results for seed in result.claimed.seeds for flag in seed.flags}
    )
    notes = [f"{count} note{'s' if count > 1 else ''}"] if count else []
    if not names and not notes:
        return BLANK
    return Cell(
        text="".join(notes),
        value="; ".join((*names, *notes)),
        href=f"entries/{entry.metadata.name}.html#flags",
        marks=tuple(names),
    )


def _paper(tracks: Sequence[str]) -> Iterator[_RankingLine]:
    """Return the paper's numbers, where it has any of these tracks."""
    of_classes = set(tracks) <= set(paper.CLASS_COLUMNS.values())
    is_whole = set(tracks) == set(paper.CLASS_COLUMNS.values())
    for name, printed in (paper.CLASS_TABLE if of_classes else paper.TABLE_1).items():
        afr = {track: printed[track] / 100 for track in tracks if track in printed}
        cells = {}
        if is_whole:
            cells["afr"] = rate_cell(printed[paper.AVERAGE] / 100)
            cells["mu_std"] = number_cell(printed["mu_std"], 3)
        elif len(afr) == len(tracks) and not of_classes:
            cells["afr"] = rate_cell(sum(afr.values()) / len(afr))
        if afr:
            yield _RankingLine("paper", text_cell(f"{name} · AAAI 2020"), cells, {"afr": afr})


def _uniform(
    agent: str, tracks: Sequence[str], entries: Sequence[Entry] = ()
) -> Iterator[_RankingLine]:
    """Return the rates of uniform worlds, from the reference sets."""
    found = {track: uniform_rate(track, agent, entries) for track in tracks}
    rates = {track: rate for track, rate in found.items() if rate is not None}
    if rates:
        whole = len(rates) == len(tracks)
        cells = {"afr": rate_cell(sum(rates.values()) / len(rates))} if whole else {}
        name = text_cell("uniform worlds · reference set")
        yield _RankingLine("reference", name, cells, {"afr": rates})


def uniform_rate(track: str, agent: str, entries: Sequence[Entry]) -> float | None:
    """Return the share of uniform worlds that fool an agent; None without a reference set.

    Where a part of the track is missing here, its entries tell.
    """
    if not missing_part(track, agent):
        targets = [current_target(track, agent).target]
    else:
        results = (result for entry in entries for result in entry.results.values())
        targets = [result.experiment.target for result in results]
    for target in targets:
        if (target.track, target.agent) == (track, agent) and target.reference is not None:
            return target.reference.uniform_rate
    return None


@lru_cache(maxsize=256)
def missing_part(track: str, agent: str) -> str:
    """Say which part of a track or its agent has to be installed; empty where all are there."""
    try:
        current_target(track, agent)
    except (MissingExtra, MissingPart) as error:
        return str(error)
    except UserError:  # no such track or agent: the result is outdated
        pass
    return ""


_STRONGEST = (
    text_column("agent"),
    text_column("track"),
    text_column("nominal", "in nominal worlds, it"),
    Column(
        "uniform_rate",
        "uniform worlds, %",
        "The share of uniform worlds that fool the agent, from the track's reference set, or from "
        "the verified entry that draws uniform worlds.",
    ),
    Column(
        "afr",
        "strongest attack, AFR %",
        "The verified entry whose F1 (AFR without coverage) has the highest lower bound; its AFR "
        "with the 95 % interval.",
    ),
    *row_columns("relative_coverage"),
    _ENTRY,
    text_column("rule", "budget rule", choice=True),
)


def strongest_sheet(groups: Iterable[tuple[ApplicationCard, Sequence[Entry], Results]]) -> Sheet:
    """Return the strongest verified attack on each track and agent beside its usual rate.

    Each application comes with its entries and what is verified of them.
    """
    lines = []
    for card, entries, verified in groups:
        nominal = {agent.name: agent.nominal for agent in card.offered} or {"": ""}
        for agent, track in itertools.product(nominal, card.board_tracks):
            cells = {
                "agent": text_cell(agent or "-"),
                "track": text_cell(track, href=f"{card.page}.html"),
                "nominal": text_cell(nominal[agent]),
            }
            uniform = uniform_rate(track, agent, entries)
            if uniform is None:
                uniform = _rate_of("random", verified, track, agent)
            cells["uniform_rate"] = rate_cell(uniform)
            if strongest := _strongest(entries, verified, track, agent):
                rule, row = strongest
                cells |= row_cells(row, ("afr", "relative_coverage"))
                cells |= {"entry": entry_link(row.entry, row.label), "rule": text_cell(rule)}
            lines.append(Line("ranked", cells))
    # what was attacked comes first, the weakest agent at the top
    lines.sort(key=lambda line: -float(line.cells.get("afr", BLANK).value or -1.0))
    return Sheet("agents", "The strongest verified attack on each agent", _STRONGEST, tuple(lines))


def _rate_of(entry: str, verified: Results, track: str, agent: str) -> float | None:
    """Return the verified AFR of an entry on a track, if it has one."""
    for comparison in verified.comparisons:
        for row in comparison.by_track.get(track, ()) if comparison.agent == agent else ():
            if row.entry == entry and row.afr is not None:
                return row.afr.value
    return None


def _strongest(
    entries: Sequence[Entry], verified: Results, track: str, agent: str
) -> tuple[str, Row] | None:
    """Return the ranked verified entry without the verifier's flags whose interval is highest."""
    bounds = {}
    for comparison in verified.comparisons:
        rule = comparison.table.name
        flagged = {
            entry.metadata.name
            for entry in entries
            if (result := entry.results.get(place_of(track, agent, rule))) is not None
            if result.verified is not None and result.verified.flags
        }
        for row in comparison.by_track.get(track, ()) if comparison.agent == agent else ():
            figure = row.deciding
            if row.rank and figure and figure.interval_95 and row.entry not in flagged:
                # of equal bounds the first by name, so that the choice does not depend on the order
                bounds[-figure.interval_95[0], rule, row.entry] = rule, row
    return bounds[min(bounds)] if bounds else None


_OUTDATED = (
    _ENTRY,
    text_column("track"),
    text_column("agent"),
    text_column("rule", "budget rule"),
    Column("afr", "AFR as claimed, %", "The mean over its seeds."),
    text_column("reason", "what is no longer today's"),
)


@dataclass(frozen=True, eq=False)
class OutdatedResult:
    """A result of an entry that no longer compares with others: what differs from today's."""

    entry: Entry
    result: EntryResult
    reason: str


def outdated_sheet(name: str, outdated: Sequence[OutdatedResult]) -> Sheet:
    """List results that no longer compare with others."""
    lines = []
    for late in outdated:
        experiment, metadata = late.result.experiment, late.entry.metadata
        rates = [seed.measures.afr for seed in late.result.claimed.seeds if seed.measures]
        cells = (
            entry_link(metadata.name, metadata.title),
            text_cell(experiment.target.track),
            text_cell(experiment.target.agent),
            text_cell(experiment.protocol.rule),
            rate_cell(float(np.mean(rates)) if rates else None),
            text_cell(late.reason),
        )
        lines.append(line_of(_OUTDATED, cells, "unranked"))
    return Sheet(f"{name}.outdated", "Outdated results", _OUTDATED, tuple(lines))
