"""table.md: the results in full, laid out like the paper's Table 1 beside its figures, by track."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from sada_gym.board.benchmark.folder import TABLE_FILE
from sada_gym.board.benchmark.results import Results, TableComparison
from sada_gym.board.benchmark.suite import is_default
from sada_gym.board.results import paper
from sada_gym.board.results.columns import row_cells, row_columns
from sada_gym.board.results.rows import MEANS, Measure, Row, front_of
from sada_gym.board.results.sheet import (
    BLANK,
    Cell,
    Column,
    markdown_table,
    number_cell,
    rate_cell,
    text_cell,
    titled_table,
)
from sada_gym.foundations.cards import cards
from sada_gym.foundations.files import write_file

_CLASSES = {track: name for name, track in paper.CLASS_COLUMNS.items()}

_LEGEND = """\
- F1 joins AFR and coverage: it is the harmonic mean of AFR / ideal AFR (at most 1) and coverage /
  ideal coverage. The rank is by F1; where there is no coverage, it is by AFR.
- AFR: the share of an adversary's M test samples that fool the agent, on seeds that training never
  saw. IQM: its interquartile mean over all runs.
- Coverage: the share of the fooling set that the fooling samples reach. A dense reference sample
  stands for the fooling set. `ideal` draws from the fooling set itself, and *coverage / ideal*
  divides by its coverage. The AFR of `ideal` is below 100 %, because a point belongs to the set if
  it fools on at least half of its seeds. Density is higher than that of `ideal` if samples crowd.
- Front: on how many tracks no other ranked adversary has both a higher AFR and a higher coverage.
- μ_std: the samples' spread, 0.577 where uniform. Novelty: the median distance from a sample to the
  nearest training query. *Novelty / ideal* divides by that of ideal samples; it is 0 where the
  samples repeat queries. *Image novelty / ideal* takes distances between images. Mean Q: the mean
  score of the samples.
- Full set: how often the uniform points of the reference set fool.
- In brackets: 95 % intervals. Ranks that the data cannot tell apart are shared (`=`); `ideal` and
  `memorise` are controls and have none.
"""

_BESIDE_THE_PAPER = (
    "Bold: rank 1 by F1 on the track, shared or not. The paper attacked other agents in other "
    "worlds (YOLOv3 in Blender, a driver in CARLA, a pilot in Sim4CV), and its rates are the best "
    "of many settings chosen on the test samples: compare orders, not numbers."
)


def write_tables(
    out: Path, results: Results, notes: Sequence[str] = (), head: str = "# Benchmark results"
) -> Path:
    """Write all tables as Markdown, below the heading `head`; `notes` are added to the remarks."""
    path = out / TABLE_FILE
    write_file(path, "\n".join((head, *_lines(results, notes))))
    return path


def _lines(results: Results, notes: Sequence[str]) -> Iterator[str]:
    everything = [row for comparison in results.comparisons for row in comparison.rows]
    hints = [mean.hint for mean in _means(everything).values() if mean.optional and mean.hint]
    if any(_paper_columns(comparison.tracks) for comparison in results.comparisons):
        hints.append(_BESIDE_THE_PAPER)
    yield from ("", _LEGEND + "".join(f"- {hint}\n" for hint in hints))
    overviews = {
        table: [*_all_applications(results, table)]
        for table in dict.fromkeys(comparison.table.name for comparison in results.comparisons)
    }
    yield from (line for overview in overviews.values() for line in overview)
    titles = {card.name: card.title for card in cards()}
    notes_of_tables = {c.table.name: c.table.note for c in results.comparisons}
    for comparison in results.comparisons:
        rows, table = comparison.rows, comparison.table
        application = comparison.runs[0].experiment.target.application.name
        title = (table.title, titles.get(application, application), comparison.agent)
        yield from (f"## {', '.join(filter(None, title))}", "")
        yield from (notes_of_tables.pop(table.name, ""), _budgets(rows))
        over = _tracks(max(row.tracks for row in rows))
        yield from ("", f"### All measures, mean over {over}", "")
        yield from _all_measures(comparison)
        by_track = _ByTrack(results, dict.fromkeys(comparison.tracks, comparison))
        columns = _paper_columns(by_track.tracks)
        if not (overviews[table.name] and is_default(application, comparison.agent)):
            yield from _like_the_paper(by_track, columns)
        if len(by_track.tracks) > 1:
            if {c.tracks[0] for c in columns if not c.is_mean} != {*by_track.tracks}:
                yield from _rates(by_track)  # else those columns have them
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


def _all_measures(comparison: TableComparison) -> Iterator[str]:
    shown = ("adversary", "f1", "rank", "afr", "afr_iqm", "relative_coverage")
    more = ("coverage", *_means(comparison.rows), "runs")
    front = Column("front", "front", blank="")
    columns = (*row_columns(*shown), front, *row_columns(*more))
    on_front: dict[str, list[bool]] = {}
    for rows in comparison.by_track.values():
        for entry, is_on_front in front_of(rows).items():
            on_front.setdefault(entry, []).append(is_on_front)
    fronts = {entry: text_cell(f"{sum(on)} of {len(on)}") for entry, on in on_front.items()}
    lines = [
        row_cells(row, (*shown, *more)) | {"front": fronts.get(row.entry, BLANK)}
        for row in comparison.rows
    ]
    yield from (*markdown_table(columns, lines), "")


def _means(rows: Sequence[Row]) -> dict[str, Measure]:
    """Choose the means that the rows' table shows."""
    return {
        name: mean
        for name, mean in MEANS.items()
        if mean.title and (not mean.optional or any(row.means[name] is not None for row in rows))
    }


def _all_applications(results: Results, table: str) -> Iterator[str]:
    """Put all applications in one table, each by its default agent; none if there is only one."""
    application_of = {target.track: target.application.name for target in results.targets}
    comparison_of = {
        track: comparison
        for comparison in results.comparisons
        if comparison.table.name == table
        for track in comparison.tracks
        if is_default(application_of[track], comparison.agent)
    }
    if len({application_of[track] for track in comparison_of}) < 2:
        return
    titles = dict.fromkeys(comparison.table.title for comparison in comparison_of.values())
    agents = dict.fromkeys(comparison.agent for comparison in comparison_of.values())
    yield from (f"## {next(iter(titles))}: all applications", "")
    yield from (f"Agents: {', '.join(agents)}. A dash: not run on all tracks of the column.", "")
    by_track, columns = _ByTrack(results, comparison_of), _paper_columns(comparison_of)
    yield from _like_the_paper(by_track, columns)
    # the paper itself has no coverage
    yield from _coverage(by_track, "### The same columns: coverage / ideal, %", columns)


class _ByTrack:
    """The rows of a table with one agent on each track; rates are by track and label."""

    def __init__(self, results: Results, comparison_of: Mapping[str, TableComparison]) -> None:
        self.tracks = list(comparison_of)
        self.overall = {row.label: row for c in comparison_of.values() for row in c.rows}
        self.rows = {
            (track, row.label): row
            for track, comparison in comparison_of.items()
            for row in comparison.by_track[track]
        }
        self.afr = {key: row.afr.value for key, row in self.rows.items() if row.afr} | {
            (target.track, paper.FULL_SET): target.reference.uniform_rate
            for target in results.targets
            if target.track in comparison_of and target.reference
            if comparison_of[target.track].agent == target.agent
        }
        self.coverage = {
            key: row.relative_coverage.value
            for key, row in self.rows.items()
            if row.relative_coverage
        }


class _TrackColumn(NamedTuple):
    """A column of a table by track: one track or a mean, and the paper's rates by label."""

    title: str
    tracks: Sequence[str]
    printed: Mapping[str, float] = {}
    is_mean: bool = False

    def cell(self, rates: Mapping[tuple[str, str], float], label: str) -> Cell:
        """Average an adversary's rates on the tracks; blank unless it has all of them."""
        own = [rates[track, label] for track in self.tracks if (track, label) in rates]
        whole = own and len(own) == len(self.tracks)
        return rate_cell(float(np.mean(own)) if whole else None)


def _paper_columns(tracks: Collection[str]) -> list[_TrackColumn]:
    """Choose the columns of the paper's Table 1 for which there are tracks."""
    columns = []
    for title, track in paper.TABLE_1_COLUMNS.items():
        own = [track] if track else list(_CLASSES)
        if set(own) <= set(tracks):
            printed = paper.rates_of(paper.TABLE_1, track or paper.AVERAGE)
            columns.append(_TrackColumn(title, own, printed, is_mean=track is None))
    return columns


def _beside_the_paper(by_track: _ByTrack, columns: Sequence[_TrackColumn]) -> dict[str, list[Cell]]:
    """Lay the AFR out in columns beside the paper's, rank 1 in bold: a line for each label."""

    def cell(column: _TrackColumn, label: str) -> Cell:
        text, printed = column.cell(by_track.afr, label).text, column.printed.get(label)
        row = None if column.is_mean else by_track.rows.get((column.tracks[0], label))
        text = f"**{text}**" if row and row.is_first else text or "-"
        return text_cell(text if printed is None else f"{text} / {printed:.1f}")

    labels = dict.fromkeys((paper.FULL_SET, *by_track.overall))
    return {label: [text_cell(label), *(cell(c, label) for c in columns)] for label in labels}


def _section(title: str, titles: Sequence[str], lines: Iterable[Iterable[Cell]]) -> Iterator[str]:
    yield from (title, "", *titled_table(titles, lines), "")


def _like_the_paper(by_track: _ByTrack, columns: Sequence[_TrackColumn]) -> Iterator[str]:
    """Lay the AFR out like the paper's Table 1: ours / the paper's."""
    if columns:
        lines = _beside_the_paper(by_track, columns).values()
        title = "### Compared with the paper's Table 1: AFR in %, ours / the paper's"
        yield from _section(title, ("adversary", *(column.title for column in columns)), lines)


def _rates(by_track: _ByTrack) -> Iterator[str]:
    """Show the AFR of every track, beside the paper's appendix where that has the class."""
    tracks, classes, of_class = by_track.tracks, set(_CLASSES), paper.CLASS_TABLE
    by_class = "### By class: AFR in %, ours / the paper's appendix"
    other = "### By track: AFR in %"
    columns = [
        _TrackColumn(short_name(track), [track], paper.rates_of(of_class, track))
        for track in tracks
    ]
    whole = set(tracks) == classes
    average = paper.AVERAGE if whole else f"mean of {_tracks(len(tracks))}"
    spreads = paper.rates_of(of_class, "mu_std" if whole else "")
    printed = paper.rates_of(of_class, average)
    columns.append(_TrackColumn(average, tracks, printed, is_mean=True))
    lines = _beside_the_paper(by_track, columns)
    for label, cells in lines.items():
        row = by_track.overall.get(label)
        cell = number_cell(row.means["mu_std"] if row else None, 3)
        if label in spreads:
            cell = text_cell(f"{cell.text or '-'} / {spreads[label]:.3f}")
        cells.append(cell)
    titles = ("adversary", *(column.title for column in columns), MEANS["mu_std"].title)
    is_by_class = set(tracks) <= classes
    yield from _section(by_class if is_by_class else other, titles, lines.values())
    if is_by_class:
        yield from ("In some cells the paper's appendix differs from its Table 1.", "")


def _coverage(by_track: _ByTrack, title: str, columns: Sequence[_TrackColumn]) -> Iterator[str]:
    """Lay coverage out in columns; nothing where there is none."""
    if columns and by_track.coverage:
        lines = (
            (text_cell(label), *(column.cell(by_track.coverage, label) for column in columns))
            for label in by_track.overall
        )
        yield from _section(title, ("adversary", *(column.title for column in columns)), lines)


def _coverages(by_track: _ByTrack) -> Iterator[str]:
    """Show the coverage of every track that has a reference set."""
    covered = {track for track, _ in by_track.coverage}
    tracks = [track for track in by_track.tracks if track in covered]
    kind = "class" if set(tracks) <= set(_CLASSES) else "track"
    columns = [_TrackColumn(short_name(track), [track]) for track in tracks]
    columns.append(_TrackColumn(f"mean of {_tracks(len(tracks))}", tracks))
    yield from _coverage(by_track, f"### By {kind}: coverage / ideal, %", columns)


def _targets(results: Results) -> Iterator[str]:
    titles = (
        *("track", "agent", "ε", "seeds", "reference points"),
        *("full set", "fooling set", "agent's SHA-256"),
    )
    lines = []
    for target in results.targets:
        reference, fingerprint = target.reference, target.application.fingerprint
        texts = (
            *(target.track, target.agent, f"{target.fooling_threshold:g}"),
            f"{len(results.seeds_of(target))}",
            f"{reference.points:,}" if reference else "none",
            f"{100 * reference.uniform_rate:.1f} %" if reference else "",
            f"{100 * reference.fooling / reference.points:.1f} %" if reference else "",
            f"`{fingerprint[:12]}`" if fingerprint else "",
        )
        lines.append(map(text_cell, texts))
    yield from _section("## What was attacked", titles, lines)


def _remarks(results: Results, notes: Sequence[str]) -> Iterator[str]:
    """List the adversaries' flags, errors, and what is missing."""
    flags: Counter[tuple[str, str, str]] = Counter()
    for run in results.runs:
        table = run.experiment.protocol.rule
        flags.update((table, run.label, flag) for flag in run.claims.flags)
        if run.claims.error is not None:
            flags[table, run.label, f"failed: {run.claims.error}"] += 1
    lines = [f"- {note}" for note in notes]
    for (table, label, text), count in flags.items():
        runs = "one run" if count == 1 else f"{count} runs"
        lines.append(f"- {label} ({table}, {runs}): {text}")
    if lines:
        yield from ("## Remarks", "", *lines, "")


def short_name(track: str) -> str:
    """Shorten a track's name for a column: the class where it is one of the paper's twelve."""
    return _CLASSES.get(track) or track.removeprefix("SADA-").rpartition("-v")[0] or track
