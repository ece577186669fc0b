"""The tables of the board: rankings, rates by track, the board of agents, what is outdated."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from leaderboard.groups import GroupResults, OutdatedResult, TrackGroup
from sada_gym.benchmark.suite import TABLES, Table
from sada_gym.experiment.record import slug
from sada_gym.results import paper
from sada_gym.results.columns import row_cells, row_columns
from sada_gym.results.entry import Entry
from sada_gym.results.models import Tier
from sada_gym.results.rows import Row, RunSummary
from sada_gym.results.sheet import (
    BLANK,
    Cell,
    Column,
    Kind,
    Line,
    Sheet,
    number_cell,
    rate_cell,
    shaded,
    text_cell,
)
from sada_gym.submission.current import current_target

PAPER_RULE = "paper-budgets"
"""The rule under which the paper's numbers were made."""

_ENTRY = Column("entry", "entry", numeric=False)
_TIER = Column(
    "tier",
    "tier",
    "Verified: we scored the samples again on fresh seeds. Claimed: the submitter's own figures.",
    numeric=False,
    choice=True,
)
_SEEDS = Column(
    "seeds_sd",
    "seeds, ± %",
    "Standard deviation of the AFR between the seeds of a track, and the number of seeds.",
)
_FLAGS = Column(
    "flags", "flags", "What a reader must know; the entry's page says it.", numeric=False
)
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


@dataclass(frozen=True)
class RankingLine:
    """A line of a ranking, before it is laid out: its cells, and its rates on each track."""

    kind: Kind
    name: Cell
    cells: Mapping[str, Cell]
    rates: Mapping[str, Mapping[str, float]]


@dataclass(frozen=True)
class RankingLines:
    """All lines of a comparison in one tier: entries by F1 (AFR without coverage), then others."""

    name: str
    tracks: tuple[str, ...]
    lines: tuple[RankingLine, ...]

    def ranking(self) -> Sheet:
        """Lay out the figures over all tracks."""
        count = len(self.tracks)
        over = f", mean over {count} tracks" if count > 1 else " on the only track"
        lines = [
            Line(line.kind, {"entry": line.name, **line.cells}) for line in self.lines if line.cells
        ]
        return Sheet(f"{self.name}.all", f"All figures{over}", _COLUMNS, tuple(lines))

    def by_track(self, group: TrackGroup, figure: str) -> Sheet:
        """Lay out the AFR (`afr`) or the coverage (`relative_coverage`) by track."""
        lines = [
            Line(
                line.kind,
                {"entry": line.name}
                | {track: shaded(rate_cell(rate)) for track, rate in rates.items()},
            )
            for line in self.lines
            if (rates := line.rates.get(figure))
        ]
        columns = (Column(track, group.short(track)) for track in self.tracks)
        return Sheet(f"{self.name}.{figure}", _BY_TRACK[figure], (_ENTRY, *columns), tuple(lines))


def ranking_lines(board: GroupResults, table: Table, agent: str, tier: Tier) -> RankingLines:
    """Put entries, controls, the paper's numbers and the reference set's rates in order."""
    results, group = board.results[tier], board.group
    entries = {entry.metadata.name: entry for entry in board.entries}
    runs = [run for run in results.runs if (run.table, run.agent) == (table.name, agent)]
    attacked = {run.track for run in runs}
    tracks = tuple(track for track in group.tracks if track in attacked)
    on_tracks = [row for track in tracks for row in results.rows_of(table.name, agent, track)]
    rows = results.rows_of(table.name, agent, None)
    rows.sort(key=lambda row: -row.deciding.value if row.deciding else math.inf)
    lines = [
        RankingLine(
            "control" if row.control else "ranked" if row.rank else "unranked",
            text_cell(row.label, href=f"entries/{row.entry}.html"),
            _cells(row, [run for run in runs if run.entry == row.entry], entries[row.entry]),
            _rates([by_track for by_track in on_tracks if by_track.entry == row.entry]),
        )
        for row in rows
    ]
    parts = (group.name, table.name, agent, tier)
    return RankingLines(
        ".".join(slug(part) for part in parts if part),
        tracks,
        (*lines, *_paper(table, agent, group, tracks), *_uniform(agent, tracks)),
    )


def _rates(rows: Sequence[Row]) -> dict[str, dict[str, float]]:
    rates: dict[str, dict[str, float]] = {name: {} for name in _BY_TRACK}
    for row in rows:
        for name, figure in (("afr", row.afr), ("relative_coverage", row.relative_coverage)):
            if row.track is not None and figure is not None:
                rates[name][row.track] = figure.value
    return rates


def paper_sheet(board: GroupResults) -> Sheet | None:
    """Return the paper's numbers where there is no entry yet; None where the paper has none."""
    group, agent = board.group, next(iter(board.group.agents), "")
    lines = tuple(_paper(TABLES[PAPER_RULE], agent, group, group.tracks))
    if not lines:
        return None
    lines = (*lines, *_uniform(agent, group.tracks))
    sheet = RankingLines(group.name, group.tracks, lines).by_track(group, "afr")
    return replace(sheet, name=f"{group.name}.paper")


def _cells(row: Row, runs: Sequence[RunSummary], entry: Entry) -> dict[str, Cell]:
    places = _places(entry, runs)
    tiers = {entry.results[place].tier for place in places}
    return row_cells(row, _FIGURES) | {
        "tier": text_cell(tiers.pop() if len(tiers) == 1 else "partly verified"),
        "seeds_sd": _spread(runs),
        "flags": _flags(entry, places),
    }


def _places(entry: Entry, runs: Iterable[RunSummary]) -> list[str]:
    """Name the results that runs are of."""
    places = dict.fromkeys(run.experiment.place for run in runs)
    return [place for place in places if place in entry.results]


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
    if not variances:
        return Cell(note=note)
    return replace(rate_cell(math.sqrt(float(np.mean(variances)))), note=note)


def _flags(entry: Entry, places: Sequence[str]) -> Cell:
    """Name the verifier's flags, and count what else a reader must know."""
    results = [entry.results[place] for place in places]
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


def _paper(
    table: Table, agent: str, group: TrackGroup, tracks: Sequence[str]
) -> Iterator[RankingLine]:
    """Return the paper's numbers, where it has this rule, this agent's place and these tracks."""
    if table.name != PAPER_RULE or agent != next(iter(group.agents), ""):
        return
    for name, row in paper.rows_on(tracks).items():
        cells = {"afr": rate_cell(row.average), "mu_std": number_cell(row.mu_std, 3)}
        label = text_cell(f"{name} · AAAI 2020")
        shown = cells if row.average is not None else {}
        yield RankingLine("paper", label, shown, {"afr": row.afr})


def _uniform(agent: str, tracks: Sequence[str]) -> Iterator[RankingLine]:
    """Return the rates of uniform worlds, from the reference sets."""
    rates = {track: rate for track in tracks if (rate := uniform_rate(track, agent)) is not None}
    if rates:
        whole = len(rates) == len(tracks)
        cells = {"afr": rate_cell(sum(rates.values()) / len(rates))} if whole else {}
        label = text_cell("uniform worlds · reference set")
        yield RankingLine("reference", label, cells, {"afr": rates})


def uniform_rate(track: str, agent: str) -> float | None:
    """Return the share of uniform worlds that fool an agent; None without a reference set."""
    reference = current_target(track, agent).target.reference
    return None if reference is None else reference.uniform_rate


_STRONGEST = (
    Column("agent", "agent", numeric=False),
    Column("track", "track", numeric=False),
    Column("group", "group", numeric=False, choice=True),
    Column("nominal", "in nominal worlds, it", numeric=False),
    Column(
        "uniform_rate",
        "uniform worlds, %",
        "The share of uniform worlds that fool the agent, from the track's reference set.",
    ),
    Column(
        "afr",
        "strongest attack, AFR %",
        "The verified entry whose F1 (AFR without coverage) has the highest lower bound; its AFR "
        "with the 95 % interval.",
    ),
    *row_columns("relative_coverage"),
    _ENTRY,
    Column("rule", "budget rule", numeric=False, choice=True),
    *row_columns("queries"),
)


def strongest_sheet(groups: Sequence[GroupResults]) -> Sheet:
    """Return the strongest verified attack on each track and agent beside its usual rate."""
    lines = []
    for board in groups:
        for agent in board.group.agents or {"": ""}:
            for track in board.group.tracks:
                cells = {
                    "agent": text_cell(agent or "-"),
                    "track": text_cell(track, href=f"{board.group.name}.html"),
                    "group": text_cell(board.group.title),
                    "nominal": text_cell(board.group.nominal.get(agent, "")),
                    "uniform_rate": rate_cell(uniform_rate(track, agent)),
                }
                if row := _strongest(board, track, agent):
                    cells |= row_cells(row, ("afr", "relative_coverage", "queries")) | {
                        "entry": text_cell(row.label, href=f"entries/{row.entry}.html"),
                        "rule": text_cell(row.table),
                    }
                lines.append(Line("ranked", cells))
    # what was attacked comes first, the weakest agent at the top
    lines.sort(key=lambda line: -float(line.cells.get("afr", BLANK).value or -1.0))
    return Sheet("agents", "The strongest verified attack on each agent", _STRONGEST, tuple(lines))


def _strongest(board: GroupResults, track: str, agent: str) -> Row | None:
    """Return the ranked verified entry without flags of the verifier whose interval is highest."""
    results = board.results["verified"]
    flagged = {
        (entry.metadata.name, experiment.protocol.rule)
        for entry in board.entries
        for result in entry.results.values()
        for experiment in [result.claimed.experiment]
        if result.verified is not None and result.verified.flags
        if (experiment.target.track, experiment.target.agent) == (track, agent)
    }
    bounds = {
        (row.table, row.entry): (row.deciding.interval_95[0], row)
        for table in results.tables
        for row in results.rows_of(table.name, agent, track)
        if (row.entry, table.name) not in flagged
        if row.rank is not None and row.deciding is not None and row.deciding.interval_95
    }
    if not bounds:
        return None
    # of equal bounds the first by name, so that the choice does not depend on the order
    return bounds[min(bounds, key=lambda place: (-bounds[place][0], place))][1]


_OUTDATED = (
    _ENTRY,
    Column("track", "track", numeric=False),
    Column("agent", "agent", numeric=False),
    Column("rule", "budget rule", numeric=False),
    Column("afr", "AFR as claimed, %", "The mean over its seeds."),
    Column("reason", "what is no longer today's", numeric=False),
)


def outdated_sheet(name: str, outdated: Sequence[OutdatedResult]) -> Sheet:
    """List results that no longer compare with others."""
    lines = []
    for late in outdated:
        experiment, metadata = late.result.claimed.experiment, late.entry.metadata
        rates = [seed.measures.afr for seed in late.result.claimed.seeds if seed.measures]
        cells = {
            "entry": text_cell(metadata.title, href=f"entries/{metadata.name}.html"),
            "track": text_cell(experiment.target.track),
            "agent": text_cell(experiment.target.agent),
            "rule": text_cell(experiment.protocol.rule),
            "afr": rate_cell(float(np.mean(rates)) if rates else None),
            "reason": text_cell(late.reason),
        }
        lines.append(Line("unranked", cells))
    return Sheet(f"{name}.outdated", "Outdated results", _OUTDATED, tuple(lines))
