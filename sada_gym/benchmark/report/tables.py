"""table.md: the results in full, laid out like the paper's Table 1 beside its figures, by track."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Literal

import numpy as np

from sada_gym.benchmark.folder import TABLE_FILE
from sada_gym.benchmark.results import Results
from sada_gym.benchmark.suite import is_default
from sada_gym.files import write_file
from sada_gym.results import paper
from sada_gym.results.columns import row_cells, row_columns
from sada_gym.results.rows import MEANS, Measure, Row, front_of
from sada_gym.results.sheet import (
    BLANK,
    Cell,
    Column,
    markdown_table,
    number_cell,
    rate_cell,
    text_cell,
    titled_table,
)

_CLASSES = {track: name for name, track in paper.CLASS_COLUMNS.items()}

_LEGEND = """\
- F1: how often the samples fool *and* how much they cover, in one figure: the harmonic mean of the
  AFR over that of `ideal`, at most 1, and coverage / ideal. The rank is by F1. Where there is no
  coverage, it is by AFR.
- AFR: the share of an adversary's M test samples that fool the agent, on seeds that training never
  saw. IQM: its interquartile mean over all runs.
- Coverage: the share of the true fooling set, as a dense reference sample shows it, that those
  samples which fool cover; also over that of `ideal`, which draws from that set itself and is
  the best that can be done. Its AFR is below 100 % because a point of the fooling set fools on at
  least half of the seeds, not on all. Density: above the ideal's where samples crowd.
- Front: on how many tracks no other ranked adversary has both a higher AFR and a higher coverage.
- μ_std: the samples' spread, 0.577 where uniform. Novelty: the median distance from a sample to the
  nearest training query; over ideal samples', 0 where it repeats queries.
- In brackets: 95 % intervals. Ranks that the data cannot tell apart are shared (`=`); `ideal` and
  `memorise` are controls and have none.
"""

_BESIDE_THE_PAPER = (
    "Bold: rank 1 by F1 on this track, shared or not. The paper attacked other agents in other "
    "worlds (YOLOv3 in Blender, a driver in CARLA, a pilot in Sim4CV), and its rates are the best "
    "of many settings chosen on the test samples: compare orders, not numbers. Full set: the rate "
    "of uniform points, here from the reference set."
)


def write_tables(out: Path, results: Results, notes: Sequence[str] = ()) -> Path:
    """Write all tables as Markdown into a benchmark's folder; `notes` go to the remarks."""
    path = out / TABLE_FILE
    write_file(path, "\n".join(_lines(results, notes)).encode())
    return path


def _lines(results: Results, notes: Sequence[str]) -> Iterator[str]:
    hints = (measure.hint for measure in _means(results.rows).values() if measure.optional)
    yield from ("# Benchmark results", "", _LEGEND + "".join(f"- {hint}\n" for hint in hints), "")
    tables = {table.name: table for table in results.tables}
    for table in dict.fromkeys(table for table, _ in results.comparisons()):
        yield from _all_applications(results, table, tables[table].title)
    for table, agent in results.comparisons():
        rows = results.rows_of(table, agent, None)
        against = f", {agent}" if agent else ""
        yield from (f"## {tables[table].title}{against}", "", tables[table].note, _budgets(rows))
        tracks = [run.track for run in results.runs if (run.table, run.agent) == (table, agent)]
        by_track = _ByTrack(results, table, dict.fromkeys(tracks, agent))
        over = _tracks(max(row.tracks for row in rows))
        yield from ("", f"### All measures, mean over {over}", "")
        yield from _all_measures(rows, by_track)
        yield from _like_the_paper(by_track, _paper_columns(tracks))
        yield from _rates(by_track)
        yield from _coverages(by_track)
    yield from _targets(results)
    yield from _remarks(results, notes)
    versions = (f"{name} {' and '.join(several)}" for name, several in results.packages.items())
    yield from ("## Versions", "", ", ".join(versions), "")


def _tracks(count: int) -> str:
    return "one track" if count == 1 else f"{count} tracks"


def _budgets(rows: Sequence[Row]) -> str:
    """Say how many training queries there were, and who spent another number."""
    spent = {row.label: row.queries for row in rows if row.queries}
    if not spent:
        return ""
    usual = Counter(spent.values()).most_common(1)[0][0]
    others = [f"{label} {count:,.0f}" for label, count in spent.items() if count != usual]
    none = [row.label for row in rows if row.queries == 0]
    parts = [f"Training queries: {usual:,.0f}", *others, *(f"{label} none" for label in none)]
    return "; ".join(parts) + "."


def _all_measures(rows: Sequence[Row], by_track: _ByTrack) -> Iterator[str]:
    shown = ("adversary", "f1", "rank", "afr", "afr_iqm", "relative_coverage")
    more = ("coverage", *_means(rows), "runs")
    front = Column("front", "front", blank="")
    columns = (*row_columns(*shown), front, *row_columns(*more))
    fronts = by_track.fronts()
    lines = [
        row_cells(row, (*shown, *more)) | {"front": fronts.get(row.label, BLANK)} for row in rows
    ]
    yield from (*markdown_table(columns, lines), "")


def _means(rows: Sequence[Row]) -> dict[str, Measure]:
    """Choose the means that the rows' table shows."""
    return {
        name: mean
        for name, mean in MEANS.items()
        if mean.title and (not mean.optional or any(row.means[name] is not None for row in rows))
    }


def _all_applications(results: Results, table: str, title: str) -> Iterator[str]:
    """Put all applications in one table, each by its default agent; none if there is only one."""
    application_of = {target.track: target.application.name for target in results.targets}
    agent_of = {
        run.track: run.agent
        for run in results.runs
        if run.table == table and is_default(application_of[run.track], run.agent)
    }
    if len({application_of[track] for track in agent_of}) < 2:
        return
    agents = ", ".join(dict.fromkeys(agent_of.values()))
    yield from (f"## {title}: all applications", "", f"Agents: {agents}.", "")
    by_track, columns = _ByTrack(results, table, agent_of), _paper_columns(agent_of)
    yield from _like_the_paper(by_track, columns)
    # the paper itself has no coverage
    yield from by_track.coverage("### The same columns: coverage / ideal, %", columns)


@dataclass(frozen=True)
class _TrackColumn:
    """A column of a table by track: one track, or the average of several, beside the paper's."""

    title: str
    tracks: Sequence[str]
    theirs: Callable[[str], float | None] = lambda _: None
    average: bool = False

    def mean_of(self, values: Mapping[tuple[str, str], float], label: str) -> Cell:
        """Average an adversary's rates on the tracks; blank unless it has all of them."""
        rates = [values[track, label] for track in self.tracks if (track, label) in values]
        whole = rates and len(rates) == len(self.tracks)
        return rate_cell(float(np.mean(rates)) if whole else None)


class _ByTrack:
    """The rows of a table with one agent on each track, to lay out in columns."""

    def __init__(self, results: Results, table: str, agent_of: Mapping[str, str]) -> None:
        agents = dict.fromkeys(agent_of.values())
        self.tracks = list(agent_of)
        self.overall = {
            row.label: row for agent in agents for row in results.rows_of(table, agent, None)
        }
        self.rows = {
            (track, row.label): row
            for track, agent in agent_of.items()
            for row in results.rows_of(table, agent, track)
        }
        self._uniform = {
            (target.track, paper.FULL_SET): target.reference.uniform_rate
            for target in results.targets
            if target.reference and agent_of.get(target.track) == target.agent
        }

    def values(self, name: Literal["afr", "relative_coverage"]) -> dict[tuple[str, str], float]:
        """Return a figure by track and label, where there is one."""
        figures = {key: getattr(row, name) for key, row in self.rows.items()}
        return {key: figure.value for key, figure in figures.items() if figure is not None}

    def fronts(self) -> dict[str, Cell]:
        """Count the tracks on which each ranked adversary is on the front of AFR and coverage."""
        on_front, tracks = Counter[str](), Counter[str]()
        for track in self.tracks:
            of_track = {row.entry: row for (name, _), row in self.rows.items() if name == track}
            for entry, is_on_front in front_of(of_track.values()).items():
                tracks[of_track[entry].label] += 1
                on_front[of_track[entry].label] += is_on_front
        return {
            label: text_cell(f"{on_front[label]} of {count}") for label, count in tracks.items()
        }

    def rates(
        self, columns: Sequence[_TrackColumn], spread: Callable[[str], Cell] | None = None
    ) -> Iterator[str]:
        """Lay the AFR out in columns beside the paper's, rank 1 in bold."""
        values = self.values("afr") | self._uniform
        lines = []
        for label in dict.fromkeys((paper.FULL_SET, *self.overall)):
            cells = [text_cell(label)]
            for column in columns:
                cell, theirs = column.mean_of(values, label), column.theirs(label)
                row = None if column.average else self.rows.get((column.tracks[0], label))
                text = f"**{cell.text}**" if row and row.is_first else cell.text or "-"
                cells.append(text_cell(text if theirs is None else f"{text} / {theirs:.1f}"))
            lines.append(cells if spread is None else [*cells, spread(label)])
        more = [] if spread is None else [column.title for column in row_columns("mu_std")]
        return titled_table(("adversary", *(column.title for column in columns), *more), lines)

    def coverage(self, title: str, columns: Sequence[_TrackColumn]) -> Iterator[str]:
        """Lay coverage out in columns; nothing where there is none."""
        values = self.values("relative_coverage")
        if columns and values:
            titles = ("adversary", *(column.title for column in columns))
            lines = (
                (text_cell(label), *(column.mean_of(values, label) for column in columns))
                for label in self.overall
            )
            yield from (title, "", *titled_table(titles, lines), "")


def _paper_columns(tracks: Collection[str]) -> list[_TrackColumn]:
    """Choose the columns of the paper's Table 1 for which there are tracks."""
    columns = []
    for title, track in paper.TABLE_1_COLUMNS.items():
        own = [track] if track else list(_CLASSES)
        if set(own) <= set(tracks):
            theirs = partial(paper.table_1, column=title)
            columns.append(_TrackColumn(title, own, theirs, average=track is None))
    return columns


def _like_the_paper(by_track: _ByTrack, columns: Sequence[_TrackColumn]) -> Iterator[str]:
    """Lay the AFR out like the paper's Table 1: ours / the paper's."""
    if columns:
        yield from ("### Beside the paper's Table 1: AFR in %, ours / the paper's", "")
        yield from (*by_track.rates(columns), "", _BESIDE_THE_PAPER, "")


def _rates(by_track: _ByTrack) -> Iterator[str]:
    """Show the AFR of every track, beside the paper's appendix where that has the class."""
    by_class = "### By class: AFR in %, ours / the paper's appendix"
    other = "### By track: AFR in %, where the paper has the track / the paper's"
    yield from (by_class if set(by_track.tracks) <= set(_CLASSES) else other, "")
    columns = [
        _TrackColumn(
            short_name(track), [track], partial(paper.class_rate, class_name=_CLASSES.get(track))
        )
        for track in by_track.tracks
    ]
    whole = set(by_track.tracks) == set(_CLASSES)
    average = paper.AVERAGE if whole else f"mean of {_tracks(len(by_track.tracks))}"
    theirs = partial(paper.class_rate, class_name=average)
    columns.append(_TrackColumn(average, by_track.tracks, theirs, average=True))

    def spread(label: str) -> Cell:
        row, known = by_track.overall.get(label), paper.class_row(label) if whole else None
        cell = number_cell(row.means["mu_std"] if row else None, 3)
        return text_cell(f"{cell.text or '-'} / {known.mu_std:.3f}") if known else cell

    yield from (*by_track.rates(columns, spread), "")


def _coverages(by_track: _ByTrack) -> Iterator[str]:
    """Show the coverage of every track that has a reference set."""
    covered = {track for track, _ in by_track.values("relative_coverage")}
    tracks = [track for track in by_track.tracks if track in covered]
    kind = "class" if set(tracks) <= set(_CLASSES) else "track"
    columns = [_TrackColumn(short_name(track), [track]) for track in tracks]
    columns.append(_TrackColumn(f"mean of {_tracks(len(tracks))}", tracks))
    yield from by_track.coverage(f"### By {kind}: coverage / ideal, %", columns)


def _targets(results: Results) -> Iterator[str]:
    titles = ("track", "agent", "ε", "seeds", "reference points", "fooling set", "agent's SHA-256")
    lines = []
    for target in results.targets:
        reference, fingerprint = target.reference, target.application.fingerprint
        fooling = rate_cell(reference.fooling / reference.points) if reference else None
        texts = (
            target.track,
            target.agent,
            f"{target.fooling_threshold:g}",
            f"{len(results.seeds_of(target))}",
            f"{reference.points:,}" if reference else "none",
            f"{fooling.text} %" if fooling else "",
            f"`{fingerprint[:12]}`" if fingerprint else "",
        )
        lines.append([text_cell(text) for text in texts])
    yield from ("## What was attacked", "", *titled_table(titles, lines), "")


def _remarks(results: Results, notes: Sequence[str]) -> Iterator[str]:
    """List the adversaries' flags, errors, and what is missing."""
    flags: Counter[tuple[str, str, str]] = Counter()
    for run in results.runs:
        flags.update((run.table, run.label, flag) for flag in run.claims.flags)
        if run.claims.error is not None:
            flags[run.table, run.label, f"failed: {run.claims.error}"] += 1
    lines = [f"- {note}" for note in notes]
    for (table, label, text), count in flags.items():
        runs = "one run" if count == 1 else f"{count} runs"
        lines.append(f"- {label} ({table}, {runs}): {text}")
    if lines:
        yield from ("## Remarks", "", *lines, "")


def short_name(track: str) -> str:
    """Shorten a track's name for a column: the class where it is one of the paper's twelve."""
    return _CLASSES.get(track) or track.removeprefix("SADA-").rpartition("-v")[0] or track
