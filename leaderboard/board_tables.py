"""The tables of the board: rankings, rates by track, the board of agents, what is outdated."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from leaderboard.groups import GroupResults, OutdatedResult, TrackGroup
from sada_gym.benchmark.suite import TABLES, Table
from sada_gym.experiment.record import slug
from sada_gym.results import paper
from sada_gym.results.entry import Entry
from sada_gym.results.models import Tier
from sada_gym.results.rows import Row, RunSummary
from sada_gym.results.sheet import (
    Cell,
    Column,
    Kind,
    Line,
    Sheet,
    number_cell,
    rank_cell,
    rate_cell,
    text_cell,
)
from sada_gym.submission.current import current_target

PAPER_RULE = "paper-budgets"
"""The rule under which the paper's numbers were made."""

_ENTRY = Column("entry", "Entry", numeric=False)
_TIER = Column(
    "tier",
    "Tier",
    "Verified: we scored the samples again on fresh seeds. Claimed: the submitter's own figures.",
    numeric=False,
    choice=True,
)
_COLUMNS = (
    Column(
        "rank",
        "Rank",
        "By AFR, within this tier. Entries that the data cannot tell apart share it.",
    ),
    _ENTRY,
    _TIER,
    Column("afr", "AFR, %", "Attack fooling rate, mean over tracks, with its 95 % interval."),
    Column(
        "seeds_sd",
        "Seeds, ± %",
        "Standard deviation of the AFR between the seeds of a track, and the number of seeds.",
    ),
    Column(
        "relative_coverage",
        "Coverage / ideal, %",
        "The share of the known failures that the samples cover; ideal samples are 100 %.",
    ),
    Column("coverage_rank", "Rank by coverage", "By coverage / ideal, within this tier."),
    Column("coverage", "Coverage, %", "The same without dividing by the ideal samples' coverage."),
    Column("queries", "Queries", "Training queries a run; this is the submitter's word."),
    Column("mu_std", "μ_std", "The spread of the samples; 0.577 where they are uniform."),
    Column("runs", "Runs", "Tracks times seeds."),
    Column("flags", "Flags", "What a reader must know; the entry's page says it.", numeric=False),
)


@dataclass(frozen=True)
class Attack:
    """A row of a comparison, before it is laid out.

    Attributes:
        kind: What it is.
        name: The first cell.
        row: Its figures over all tracks; None for what is no entry.
        cells: Its cells over all tracks, less the first one.
        by_track: The rows of each track.
        rates: The AFR on each track, where there are no such rows.
    """

    kind: Kind
    name: Cell
    row: Row | None
    cells: Mapping[str, Cell]
    by_track: Mapping[str, Row]
    rates: Mapping[str, float]


@dataclass(frozen=True)
class Attacks:
    """All rows of a comparison in one tier, the highest AFR first."""

    table: Table
    agent: str
    tier: Tier
    tracks: tuple[str, ...]
    attacks: tuple[Attack, ...]

    def name(self, group: TrackGroup, what: str) -> str:
        """Name the files of a table."""
        parts = (group.name, self.table.name, self.agent, self.tier, what)
        return ".".join(slug(part) for part in parts if part)


def attack_lines(board: GroupResults, table: Table, agent: str, tier: Tier) -> Attacks:
    """Put entries, controls, the paper's numbers and the reference set's rates in order."""
    results, group = board.results[tier], board.group
    entries = {entry.metadata.name: entry for entry in board.entries}
    runs = [run for run in results.runs if (run.table, run.agent) == (table.name, agent)]
    there = {run.track for run in runs}
    tracks = tuple(track for track in group.tracks if track in there)
    by_track = {track: results.rows_of(table.name, agent, track) for track in tracks}
    attacks = []
    for row in results.rows_of(table.name, agent, None):
        own = [run for run in runs if run.entry == row.entry]
        attacks.append(
            Attack(
                _kind(row),
                text_cell(row.label, href=f"entries/{row.entry}.html"),
                row,
                dict(_cells(row, own, entries[row.entry])),
                {t: one for t in tracks for one in by_track[t] if one.entry == row.entry},
                {},
            )
        )
    attacks.sort(
        key=lambda one: -math.inf if one.row is None or one.row.afr is None else -one.row.afr.value
    )
    attacks += _paper(table, agent, group, tracks)
    attacks += _uniform(agent, tracks)
    return Attacks(table, agent, tier, tracks, tuple(attacks))


def paper_sheet(board: GroupResults) -> Sheet | None:
    """Give the paper's numbers where there is no entry yet; None where the paper has none."""
    group, agent = board.group, next(iter(board.group.agents), "")
    paper_rows = tuple(_paper(TABLES[PAPER_RULE], agent, group, group.tracks))
    if not paper_rows:
        return None
    rows = (*paper_rows, *_uniform(agent, group.tracks))
    found = Attacks(TABLES[PAPER_RULE], agent, "claimed", group.tracks, rows)
    return replace(by_track_sheet(board, found, "afr"), name=f"{group.name}.paper")


def ranking_sheet(board: GroupResults, found: Attacks) -> Sheet:
    """Lay out the figures over all tracks."""
    lines = [Line(one.kind, {"entry": one.name, **one.cells}) for one in found.attacks]
    return Sheet(
        found.name(board.group, "all"),
        _over(len(found.tracks)),
        _COLUMNS,
        tuple(line for line in lines if len(line.cells) > 1),
    )


def _over(tracks: int) -> str:
    return (
        "All figures on the only track"
        if tracks == 1
        else f"All figures, mean over {tracks} tracks"
    )


def by_track_sheet(
    board: GroupResults, found: Attacks, what: Literal["afr", "relative_coverage"]
) -> Sheet:
    """Lay out a rate by track."""
    titles = {
        "afr": "AFR on each track, %",
        "relative_coverage": "Coverage / ideal on each track, %",
    }
    lines = []
    for one in found.attacks:
        cells = {
            track: rate_cell(rate, shaded=True)
            for track in found.tracks
            if (rate := _rate(one, track, what)) is not None
        }
        if cells:
            lines.append(Line(one.kind, {"entry": one.name, **cells}))
    columns = [Column(track, board.group.short(track)) for track in found.tracks]
    return Sheet(found.name(board.group, what), titles[what], (_ENTRY, *columns), tuple(lines))


def _rate(one: Attack, track: str, what: Literal["afr", "relative_coverage"]) -> float | None:
    if track in one.by_track:
        figure = one.by_track[track].afr if what == "afr" else one.by_track[track].relative_coverage
        return None if figure is None else figure.value
    return one.rates.get(track) if what == "afr" else None


def _kind(row: Row) -> Kind:
    if row.control:
        return "control"
    return "ranked" if row.afr and row.afr.rank else "unranked"


def _cells(row: Row, runs: Sequence[RunSummary], entry: Entry) -> Iterator[tuple[str, Cell]]:
    yield "rank", rank_cell(row.afr)
    yield "tier", text_cell(_tier(runs, entry))
    yield "afr", rate_cell(row.afr)
    yield "seeds_sd", _spread(runs)
    yield "relative_coverage", rate_cell(row.relative_coverage)
    yield "coverage_rank", rank_cell(row.relative_coverage)
    yield "coverage", rate_cell(row.coverage.value if row.coverage else None)
    yield "queries", number_cell(row.queries)
    yield "mu_std", number_cell(row.mu_std, 3)
    note = f"{row.failed} failed" if row.failed else ("" if row.complete else "incomplete")
    yield "runs", number_cell(row.runs, note=note)
    yield "flags", flags_cell(runs, entry)


def _of(entry: Entry, runs: Iterable[RunSummary]) -> list[str]:
    """Name the results that runs are of."""
    return [
        place
        for place in dict.fromkeys(run.experiment.place for run in runs)
        if place in entry.results
    ]


def _tier(runs: Sequence[RunSummary], entry: Entry) -> str:
    tiers = {entry.results[stem].tier for stem in _of(entry, runs)}
    return tiers.pop() if len(tiers) == 1 else "partly verified"


def _spread(runs: Sequence[RunSummary]) -> Cell:
    """Give the standard deviation between the seeds of a track, its variance pooled over tracks."""
    rates: dict[str, list[float]] = {}
    for run in runs:
        if run.measures is not None:
            rates.setdefault(run.track, []).append(run.measures.afr)
    counts = sorted({len(seeds) for seeds in rates.values()})
    if not counts:
        return Cell()
    several = " to ".join(str(count) for count in dict.fromkeys((counts[0], counts[-1])))
    note = f"{several} seed{'' if counts == [1] else 's'}"
    variances = [float(np.var(seeds, ddof=1)) for seeds in rates.values() if len(seeds) > 1]
    if not variances:
        return Cell(note=note)
    spread = math.sqrt(float(np.mean(variances)))
    return Cell(text=f"{100 * spread:.1f}", value=spread, note=note)


def flags_cell(runs: Sequence[RunSummary], entry: Entry) -> Cell:
    """Name the verifier's flags, and count what else a reader must know."""
    names: dict[str, None] = {}
    for stem in _of(entry, runs):
        if (verified := entry.results[stem].verified) is not None:
            names.update(dict.fromkeys(verified.flags))
    claimed = {
        flag
        for stem in _of(entry, runs)
        for seed in entry.results[stem].claimed.seeds
        for flag in seed.flags
    }
    count = len(claimed)
    text = "" if not count else "1 note" if count == 1 else f"{count} notes"
    if not names and not text:
        return Cell()
    return Cell(
        text=text,
        value="; ".join((*names, *((text,) if text else ()))),
        href=f"entries/{entry.metadata.name}.html#flags",
        marks=tuple(names),
    )


def _paper(table: Table, agent: str, group: TrackGroup, tracks: Sequence[str]) -> Iterator[Attack]:
    """Give the paper's own numbers, where it has this rule, this agent's place and these tracks."""
    if table.name != PAPER_RULE or agent != next(iter(group.agents), ""):
        return
    for name, row in _paper_rows(tracks).items():
        cells = {"afr": rate_cell(row.average), "mu_std": number_cell(row.mu_std, 3)}
        label = text_cell(f"{name} · AAAI 2020")
        yield Attack("paper", label, None, cells if row.average else {}, {}, row.rates)


@dataclass(frozen=True)
class _PaperRow:
    rates: Mapping[str, float]
    average: float | None
    mu_std: float | None


def _paper_rows(tracks: Sequence[str]) -> Mapping[str, _PaperRow]:
    rows = {}
    if set(tracks) <= set(paper.CLASS_COLUMNS.values()):
        whole = set(tracks) == set(paper.CLASS_COLUMNS.values())
        for name, row in paper.CLASS_TABLE.items():
            rates = dict(zip(paper.CLASS_COLUMNS.values(), row.afr, strict=True))
            rows[name] = _PaperRow(
                {track: rates[track] / 100 for track in tracks},
                row.average / 100 if whole else None,
                row.mu_std if whole else None,
            )
        return rows
    columns = {track: i for i, track in enumerate(paper.TABLE_1_COLUMNS.values()) if track}
    for name, printed in paper.TABLE_1.items():
        found = {
            track: rate / 100
            for track in tracks
            if track in columns and (rate := printed[columns[track]]) is not None
        }
        if found:
            average = sum(found.values()) / len(found) if set(found) == set(tracks) else None
            rows[name] = _PaperRow(found, average, None)
    return rows


def _uniform(agent: str, tracks: Sequence[str]) -> Iterator[Attack]:
    """Give the rates of uniform worlds, from the reference sets."""
    found = {track: uniform_rate(track, agent) for track in tracks}
    rates = {track: rate for track, rate in found.items() if rate is not None}
    if rates:
        average = sum(rates.values()) / len(rates) if len(rates) == len(tracks) else None
        cells = {"afr": rate_cell(average)} if average is not None else {}
        yield Attack(
            "reference", text_cell("uniform worlds · reference set"), None, cells, {}, rates
        )


def uniform_rate(track: str, agent: str) -> float | None:
    """Give the share of uniform worlds that fool an agent; None where there is no reference set."""
    reference = current_target(track, agent).target.reference
    return None if reference is None else reference.uniform_rate


_STRONGEST = (
    Column("agent", "Agent", numeric=False),
    Column("track", "Track", numeric=False),
    Column("group", "Group", numeric=False, choice=True),
    Column("nominal", "In nominal worlds, it", numeric=False),
    Column(
        "uniform_rate",
        "Uniform worlds, %",
        "The share of uniform worlds that fool the agent, from the track's reference set.",
    ),
    Column(
        "afr",
        "Strongest attack, AFR %",
        "The verified entry whose AFR has the highest lower bound, with its 95 % interval.",
    ),
    Column("entry", "Entry", numeric=False),
    Column("rule", "Budget rule", numeric=False, choice=True),
    Column("queries", "Queries"),
)


def strongest_sheet(groups: Sequence[GroupResults]) -> Sheet:
    """Give the strongest verified attack on each track and agent beside the agent's usual rate."""
    lines = []
    for board in groups:
        for agent in board.group.agents or {"": ""}:
            for track in board.group.tracks:
                row = _strongest(board, track, agent)
                uniform = uniform_rate(track, agent)
                cells = {
                    "agent": text_cell(agent or "-"),
                    "track": text_cell(track, href=f"{board.group.name}.html"),
                    "group": text_cell(board.group.title),
                    "nominal": text_cell(board.group.nominal.get(agent, "")),
                    "uniform_rate": rate_cell(uniform),
                    "afr": rate_cell(row.afr if row else None),
                }
                if row is not None:
                    cells |= {
                        "entry": text_cell(row.label, href=f"entries/{row.entry}.html"),
                        "rule": text_cell(row.table),
                        "queries": number_cell(row.queries),
                    }
                lines.append(Line("ranked", cells))
    # what was attacked comes first, the weakest agent at the top
    lines.sort(key=lambda line: -float(line.cells["afr"].value or -1.0))
    return Sheet("agents", "The strongest verified attack on each agent", _STRONGEST, tuple(lines))


def _strongest(board: GroupResults, track: str, agent: str) -> Row | None:
    """Give the ranked verified entry without flags of the verifier whose interval is highest."""
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
        (row.table, row.entry): (row.afr.interval_95[0], row)
        for table in results.tables
        for row in results.rows_of(table.name, agent, track)
        if (row.entry, table.name) not in flagged
        if row.afr is not None and row.afr.rank is not None and row.afr.interval_95 is not None
    }
    if not bounds:
        return None
    # of equal bounds the first by name, so that the choice does not depend on the order
    return bounds[min(bounds, key=lambda place: (-bounds[place][0], place))][1]


_OUTDATED = (
    _ENTRY,
    Column("track", "Track", numeric=False),
    Column("agent", "Agent", numeric=False),
    Column("rule", "Budget rule", numeric=False),
    Column("afr", "AFR as claimed, %", "The mean over its seeds."),
    Column("reason", "What is no longer today's", numeric=False),
)


def outdated_sheet(name: str, outdated: Sequence[OutdatedResult]) -> Sheet:
    """List results that no longer compare with others."""
    lines = []
    for one in outdated:
        experiment, metadata = one.result.claimed.experiment, one.entry.metadata
        rates = [seed.measures.afr for seed in one.result.claimed.seeds if seed.measures]
        cells = {
            "entry": text_cell(metadata.title, href=f"entries/{metadata.name}.html"),
            "track": text_cell(experiment.target.track),
            "agent": text_cell(experiment.target.agent),
            "rule": text_cell(experiment.protocol.rule),
            "afr": rate_cell(float(np.mean(rates)) if rates else None),
            "reason": text_cell(one.reason),
        }
        lines.append(Line("unranked", cells))
    return Sheet(f"{name}.outdated", "Outdated results", _OUTDATED, tuple(lines))
