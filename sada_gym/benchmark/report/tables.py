"""table.md: the results in full, laid out like the paper's Table 1 beside its figures, by track."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path

import numpy as np

from sada_gym.benchmark.folder import TABLE_FILE
from sada_gym.benchmark.results import Results
from sada_gym.benchmark.suite import is_default
from sada_gym.files import write_file
from sada_gym.results import paper
from sada_gym.results.figures import Figure
from sada_gym.results.rows import MEANS, Mean, Row

_BLANK = "-"
_CLASSES = {track: name for name, track in paper.CLASS_COLUMNS.items()}

_LEGEND = """\
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
  `archive` are controls and have none.
"""


def write_tables(out: Path, results: Results, notes: Sequence[str] = ()) -> Path:
    """Write all tables as Markdown.

    Args:
        out: The benchmark's folder.
        results: The benchmark's results.
        notes: What else a reader must know.
    """
    path = out / TABLE_FILE
    write_file(path, "\n".join(_lines(results, notes)).encode())
    return path


def _lines(results: Results, notes: Sequence[str]) -> Iterator[str]:
    legend = "".join(mean.legend for mean in _columns(results.rows).values())
    yield from ("# Benchmark results", "", _LEGEND + legend, "")
    tables = {table.name: table for table in results.tables}
    for table in dict.fromkeys(table for table, _ in results.comparisons()):
        yield from _table_1(results, table, tables[table].title)
    for table, agent in results.comparisons():
        rows = results.rows_of(table, agent, None)
        against = f", {agent}" if agent else ""
        yield from (f"## {tables[table].title}{against}", "", tables[table].note, _budgets(rows))
        over = _tracks(max(row.tracks for row in rows))
        yield from ("", f"### All measures, mean over {over}", "")
        tracks = [run.track for run in results.runs if (run.table, run.agent) == (table, agent)]
        ours = _ByTrack(results, table, dict.fromkeys(tracks, agent))
        yield from _measures(rows, _fronts(ours))
        yield from _like_the_paper(ours, _paper_columns(tracks))
        yield from _by_track(ours)
        yield from _coverage_by_track(ours)
    yield from _targets(results)
    yield from _remarks(results, notes)
    versions = (f"{name} {' and '.join(found)}" for name, found in results.packages.items())
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


def _fronts(ours: _ByTrack) -> dict[str, str]:
    """Count the tracks on which each ranked contender is on the front of AFR and coverage."""
    held, tracks = Counter[str](), Counter[str]()
    points = {
        key: (row.afr.value, row.relative_coverage.value)
        for key, row in ours.rows.items()
        if not row.control and row.afr and row.relative_coverage
    }
    for (track, label), (afr, coverage) in points.items():
        others = [point for (other, _), point in points.items() if other == track]
        tracks[label] += 1
        held[label] += not any(a > afr and c > coverage for a, c in others)
    return {label: f"{held[label]} of {count}" for label, count in tracks.items()}


def _measures(rows: Sequence[Row], fronts: Mapping[str, str]) -> Iterator[str]:
    means = _columns(rows)
    known = "adversary", "AFR, %", "rank", "IQM, %", "coverage / ideal, %", "rank", "front"
    yield from table_head((*known, "coverage, %", *(mean.title for mean in means.values()), "runs"))
    for row in rows:
        afr, relative = row.afr, row.relative_coverage
        runs = f"{row.runs}" + (f", {row.failed} failed" if row.failed else "")
        yield table_line(
            row.label,
            with_interval(afr),
            rank_of(afr),
            percent(row.afr_iqm),
            with_interval(relative),
            rank_of(relative),
            fronts.get(row.label, ""),
            percent(row.coverage.value if row.coverage else None),
            *(_number(getattr(row, name), mean.places) for name, mean in means.items()),
            runs if row.complete else f"{runs} (incomplete)",
        )
    yield ""


def _columns(rows: Sequence[Row]) -> dict[str, Mean]:
    """Choose the measures that the rows' table shows."""
    return {
        name: mean
        for name, mean in MEANS.items()
        if mean.title and (not mean.legend or any(getattr(row, name) is not None for row in rows))
    }


def _table_1(results: Results, table: str, title: str) -> Iterator[str]:
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
    ours, columns = _ByTrack(results, table, agent_of), _paper_columns(agent_of)
    yield from _like_the_paper(ours, columns)
    # the paper itself has no coverage
    yield from ours.coverage("### The same columns: coverage / ideal, %", columns)


@dataclass(frozen=True)
class _Column:
    """A column of a table by track: one track, or the average of several, beside the paper's."""

    title: str
    tracks: Sequence[str]
    theirs: Callable[[str], float | None] = lambda _: None
    average: bool = False


class _ByTrack:
    """The rows of a table with one agent on each track, to lay out in columns.

    Args:
        results: The benchmark's results.
        table: The table's name.
        agent_of: The agent that was attacked on each track.
    """

    def __init__(self, results: Results, table: str, agent_of: Mapping[str, str]) -> None:
        agents = dict.fromkeys(agent_of.values())
        self.tracks = list(agent_of)
        self.overall = {
            row.label: row for agent in agents for row in results.rows_of(table, agent, None)
        }
        self._uniform = {
            target.track: target.reference.uniform_rate
            for target in results.targets
            if target.reference and agent_of.get(target.track) == target.agent
        }
        rows = (
            row for track, agent in agent_of.items() for row in results.rows_of(table, agent, track)
        )
        self.rows = {(row.track, row.label): row for row in rows}

    def rates(self, columns: Sequence[_Column]) -> Iterator[tuple[str, list[str]]]:
        """Give each row's label and its cells: our AFR and the paper's, rank 1 in bold."""
        found = {key: row.afr for key, row in self.rows.items() if row.afr}
        values = {key: one.value for key, one in found.items()}
        values |= {(track, paper.FULL_SET): rate for track, rate in self._uniform.items()}
        best = {key for key, one in found.items() if one.rank in ("1", "1=")}
        for label in (paper.FULL_SET, *self.overall):
            cells = []
            for column in columns:
                keys, theirs = [(t, label) for t in column.tracks], column.theirs(label)
                text = percent(_mean([values.get(key) for key in keys]))
                text = f"**{text}**" if not column.average and keys[0] in best else text
                cells.append(text if theirs is None else f"{text} / {theirs:.1f}")
            yield label, cells

    @cached_property
    def coverages(self) -> dict[tuple[str | None, str], float]:
        """Give the coverage over the ideal's by track and label, where there is one."""
        found = {key: row.relative_coverage for key, row in self.rows.items()}
        return {key: one.value for key, one in found.items() if one}

    def coverage(self, title: str, columns: Sequence[_Column]) -> Iterator[str]:
        """Lay coverage out in columns; nothing where there is none."""
        if not columns or not self.coverages:
            return
        yield from (title, "", *table_head(("adversary", *(column.title for column in columns))))
        for label in self.overall:
            found = [[self.coverages.get((t, label)) for t in one.tracks] for one in columns]
            yield table_line(label, *(percent(_mean(values)) for values in found))
        yield ""


def _paper_columns(tracks: Collection[str]) -> list[_Column]:
    """Choose the columns of the paper's Table 1 for which there are tracks."""
    columns = []
    for title, track in paper.TABLE_1_COLUMNS.items():
        own = [track] if track else list(_CLASSES)
        if set(own) <= set(tracks):
            theirs = partial(paper.table_1, column=title)
            columns.append(_Column(title, own, theirs, average=track is None))
    return columns


def _like_the_paper(ours: _ByTrack, columns: Sequence[_Column]) -> Iterator[str]:
    """Lay the AFR out like the paper's Table 1: ours / the paper's."""
    if not columns:
        return
    yield from ("### Beside the paper's Table 1: AFR in %, ours / the paper's", "")
    yield from table_head(("adversary", *(column.title for column in columns)))
    yield from (table_line(label, *cells) for label, cells in ours.rates(columns))
    yield ""
    yield (
        "Bold: rank 1 on this track, shared or not. The paper attacked other agents in other "
        "worlds (YOLOv3 in Blender, a driver in CARLA, a pilot in Sim4CV), and its rates are the "
        "best of many settings chosen on the test samples: compare orders, not numbers. Full set: "
        "the rate of uniform points, here from the reference set."
    )
    yield ""


def _by_track(ours: _ByTrack) -> Iterator[str]:
    """Give the AFR of every track, beside the paper's appendix where that has the class."""
    if set(ours.tracks) <= set(_CLASSES):
        yield from ("### By class: AFR in %, ours / the paper's appendix", "")
    else:
        yield from ("### By track: AFR in %, where the paper has the track / the paper's", "")
    columns = [
        _Column(
            short_name(track), [track], partial(paper.class_rate, class_name=_CLASSES.get(track))
        )
        for track in ours.tracks
    ]
    whole = set(ours.tracks) == set(_CLASSES)
    average = paper.AVERAGE if whole else f"mean of {_tracks(len(ours.tracks))}"
    theirs = partial(paper.class_rate, class_name=average)
    columns.append(_Column(average, ours.tracks, theirs, average=True))
    yield from table_head(("adversary", *(column.title for column in columns), "μ_std"))
    for label, cells in ours.rates(columns):
        row, known = ours.overall.get(label), paper.class_row(label) if whole else None
        spread = _number(row.mu_std if row else None, 3) + (
            f" / {known.mu_std:.3f}" if known else ""
        )
        yield table_line(label, *cells, spread)
    yield ""


def _coverage_by_track(ours: _ByTrack) -> Iterator[str]:
    """Give the coverage of every track that has a reference set."""
    tracks = [track for track in ours.tracks if any(track == t for t, _ in ours.coverages)]
    kind = "class" if set(tracks) <= set(_CLASSES) else "track"
    columns = [_Column(short_name(track), [track]) for track in tracks]
    columns.append(_Column(f"mean of {_tracks(len(tracks))}", tracks))
    yield from ours.coverage(f"### By {kind}: coverage / ideal, %", columns)


def _targets(results: Results) -> Iterator[str]:
    yield from ("## What was attacked", "")
    yield from table_head(
        ("track", "agent", "ε", "seeds", "reference points", "fooling set", "agent's SHA-256")
    )
    for target in results.targets:
        reference, fingerprint = target.reference, target.application.fingerprint
        yield table_line(
            target.track,
            target.agent or _BLANK,
            f"{target.fooling_threshold:g}",
            f"{len(results.seeds_of(target))}",
            f"{reference.points:,}" if reference else "none",
            f"{percent(reference.fooling / reference.points)} %" if reference else _BLANK,
            f"`{fingerprint[:12]}`" if fingerprint else _BLANK,
        )
    yield ""


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


def _mean(values: Sequence[float | None]) -> float | None:
    there = [value for value in values if value is not None]
    return float(np.mean(there)) if there and len(there) == len(values) else None


def percent(value: float | None, places: int = 1) -> str:
    """Write a share as per cent."""
    return _BLANK if value is None else f"{100 * value:.{places}f}"


def _number(value: float | None, places: int | None) -> str:
    """Write a number with so many decimal places, or as per cent."""
    return percent(value) if value is None or places is None else f"{value:.{places}f}"


def with_interval(figure: Figure | None, places: int = 1) -> str:
    """Write a figure as per cent, with its interval where it has one."""
    if figure is None or figure.interval_95 is None:
        return percent(figure.value if figure else None, places)
    low, high = (percent(end, places) for end in figure.interval_95)
    return f"{percent(figure.value, places)} ({low} to {high})"


def rank_of(figure: Figure | None) -> str:
    """Give a figure's rank; empty where it has none."""
    return figure.rank or "" if figure else ""


def table_head(columns: Sequence[str]) -> tuple[str, str]:
    """Give the first two lines of a Markdown table."""
    return table_line(*columns), table_line(*("---" for _ in columns))


def table_line(*cells: str) -> str:
    """Give a line of a Markdown table."""
    return f"| {' | '.join(cell.replace('|', '/') for cell in cells)} |"
