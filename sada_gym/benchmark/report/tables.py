"""table.md: the results in full, laid out like the paper's Table 1 beside its figures, by track."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np

from sada_gym.benchmark import paper
from sada_gym.benchmark.figures import Figure
from sada_gym.benchmark.results import MEANS, Mean, Results, Row
from sada_gym.benchmark.suite import CONTROLS
from sada_gym.files import write_file

TABLE_FILE = "table.md"

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
    titles = {table.name: table for table in results.settings.tables}
    for table in dict.fromkeys(table for table, _ in results.comparisons()):
        yield from _table_1(results, table, titles[table].title)
    for table, agent in results.comparisons():
        rows = results.rows_of(table, agent, None)
        against = f", {agent}" if agent else ""
        yield from (f"## {titles[table].title}{against}", "", titles[table].note, _budgets(rows))
        yield from (
            "",
            f"### All measures, mean over {_tracks(max(row.tracks for row in rows))}",
            "",
        )
        yield from _measures(rows, _fronts(results, table, agent))
        yield from _like_the_paper(
            results, table, dict.fromkeys(_of_tracks(results, table, agent), agent)
        )
        yield from _by_track(results, table, agent)
        yield from _coverage_by_track(results, table, agent)
    yield from _targets(results)
    yield from _remarks(results, notes)
    packages = results.settings.packages.items()
    yield from ("## Versions", "", ", ".join(f"{name} {number}" for name, number in packages), "")


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


def _fronts(results: Results, table: str, agent: str) -> dict[str, str]:
    """Count the tracks on which each ranked contender is on the front of AFR and coverage."""
    held, tracks = Counter[str](), Counter[str]()
    for rows in _of_tracks(results, table, agent).values():
        points = {
            row.label: (row.afr.value, row.relative_coverage.value)
            for row in rows
            if row.label not in CONTROLS and row.afr and row.relative_coverage
        }
        for label, (afr, coverage) in points.items():
            tracks[label] += 1
            held[label] += not any(a > afr and c > coverage for a, c in points.values())
    return {label: f"{held[label]} of {count}" for label, count in tracks.items()}


def _measures(rows: Sequence[Row], fronts: Mapping[str, str]) -> Iterator[str]:
    means = _columns(rows)
    yield from _head(
        (
            "adversary",
            "AFR, %",
            "rank",
            "IQM, %",
            "coverage / ideal, %",
            "rank",
            "front",
            "coverage, %",
            *(mean.title for mean in means.values()),
            "runs",
        )
    )
    for row in rows:
        afr, relative = row.afr, row.relative_coverage
        runs = f"{row.runs}" + (f", {row.failed} failed" if row.failed else "")
        yield _line(
            row.label,
            _with_interval(afr),
            _rank(afr),
            _percent(row.afr_iqm),
            _with_interval(relative),
            _rank(relative),
            fronts.get(row.label, ""),
            _percent(row.coverage.value if row.coverage else None),
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
    """All applications in one table, each by its default agent; none where there is but one."""
    applications = dict.fromkeys(target.application for target in results.targets)
    if len(applications) == 1:
        return
    agent_of: dict[str, str] = {}
    for run in results.runs:  # in the order of the shipped agents: the default one first
        if run.table == table:
            agent_of.setdefault(run.track, run.agent)
    yield from (f"## {title}: all applications", "")
    yield "Agents: " + ", ".join(dict.fromkeys(agent_of.values())) + "."
    yield ""
    yield from _like_the_paper(results, table, agent_of)
    yield from _paper_coverage(results, table, agent_of)


def _paper_columns(tracks: Collection[str]) -> list[str]:
    """Choose the columns of the paper's Table 1 for which there are tracks."""
    return [
        title
        for title, track in paper.TABLE_1_COLUMNS.items()
        if (track in tracks if track else set(tracks) >= _CLASSES.keys())
    ]


def _paper_tracks(title: str) -> list[str]:
    track = paper.TABLE_1_COLUMNS[title]
    return list(_CLASSES) if track is None else [track]


def _like_the_paper(results: Results, table: str, agent_of: Mapping[str, str]) -> Iterator[str]:
    """Lay the AFR out like the paper's Table 1: ours and, behind it, the paper's.

    Args:
        results: The benchmark's results.
        table: The table's name.
        agent_of: The agent that was attacked on each track.
    """
    columns = _paper_columns(agent_of)
    if not columns:
        return
    ours = {track: results.rows_of(table, agent, track) for track, agent in agent_of.items()}
    yield from ("### Beside the paper's Table 1: AFR in %, ours / the paper's", "")
    yield from _head(("adversary", *columns))
    for label in (paper.FULL_SET, *_labels(results, table, agent_of.values())):
        cells = []
        for title in columns:
            tracks = _paper_tracks(title)
            value = _mean([_afr(results, ours[t], t, agent_of[t], label) for t in tracks])
            best = len(tracks) == 1 and _best(ours[tracks[0]], label)
            cells.append(_pair(value, paper.table_1(label, title), bold=best))
        yield _line(label, *cells)
    yield ""
    yield (
        "Bold: rank 1 on this track, shared or not. The paper attacked other agents in other "
        "worlds (YOLOv3 in Blender, a driver in CARLA, a pilot in Sim4CV), and its rates are the "
        "best of many settings chosen on the test samples: compare orders, not numbers. Full set: "
        "the rate of uniform points, here from the reference set."
    )
    yield ""


def _paper_coverage(results: Results, table: str, agent_of: Mapping[str, str]) -> Iterator[str]:
    """Lay coverage out in the columns of the paper's Table 1, which has no coverage itself."""
    columns = _paper_columns(agent_of)
    found = {
        (track, row.label): row.relative_coverage.value
        for track, agent in agent_of.items()
        for row in results.rows_of(table, agent, track)
        if row.relative_coverage
    }
    if not columns or not found:
        return
    yield from ("### The same columns: coverage / ideal, %", "")
    yield from _head(("adversary", *columns))
    for label in _labels(results, table, agent_of.values()):
        values = [_mean([found.get((t, label)) for t in _paper_tracks(title)]) for title in columns]
        yield _line(label, *map(_percent, values))
    yield ""


def _by_track(results: Results, table: str, agent: str) -> Iterator[str]:
    """Give the AFR of every track, beside the paper's appendix where that has the class."""
    ours = _of_tracks(results, table, agent)
    if set(ours) <= set(_CLASSES):
        yield from ("### By class: AFR in %, ours / the paper's appendix", "")
    else:
        yield from ("### By track: AFR in %, where the paper has the track / the paper's", "")
    average = paper.AVERAGE if set(ours) == set(_CLASSES) else f"mean of {_tracks(len(ours))}"
    yield from _head(("adversary", *map(short_name, ours), average, "μ_std"))
    overall = {row.label: row for row in results.rows_of(table, agent, None)}
    for label in (paper.FULL_SET, *_labels(results, table, [agent])):
        theirs = paper.class_row(label)
        values = {track: _afr(results, rows, track, agent, label) for track, rows in ours.items()}
        cells = [
            _pair(
                value,
                theirs.afr[list(_CLASSES).index(track)] if theirs and track in _CLASSES else None,
                bold=_best(ours[track], label),
            )
            for track, value in values.items()
        ]
        whole = average == paper.AVERAGE and theirs is not None
        spread = overall[label].mu_std if label in overall else None
        yield _line(
            label,
            *cells,
            _pair(_mean(list(values.values())), theirs.average if whole and theirs else None),
            _number(spread, 3) + (f" / {theirs.mu_std:.3f}" if whole and theirs else ""),
        )
    yield ""


def _coverage_by_track(results: Results, table: str, agent: str) -> Iterator[str]:
    """Give the coverage of every track that has a reference set."""
    figures = {
        track: {row.label: row.relative_coverage for row in rows if row.relative_coverage}
        for track, rows in _of_tracks(results, table, agent).items()
    }
    figures = {track: of_track for track, of_track in figures.items() if of_track}
    if not figures:
        return
    kind = "class" if set(figures) <= set(_CLASSES) else "track"
    yield from (f"### By {kind}: coverage / ideal, %", "")
    yield from _head(("adversary", *map(short_name, figures), f"mean of {_tracks(len(figures))}"))
    for label in _labels(results, table, [agent]):
        found = [of_track.get(label) for of_track in figures.values()]
        values = [one.value if one else None for one in found]
        yield _line(label, *map(_percent, values), _percent(_mean(values)))
    yield ""


def _targets(results: Results) -> Iterator[str]:
    yield from ("## What was attacked", "")
    yield from _head(
        ("track", "agent", "ε", "seeds", "reference points", "fooling set", "agent's SHA-256")
    )
    for target in results.targets:
        reference = target.reference
        yield _line(
            target.track,
            target.agent or _BLANK,
            f"{target.fooling_threshold:g}",
            f"{len(target.seeds)}",
            f"{reference.points:,}" if reference else "none",
            f"{reference.fooling / reference.points:.1%}".replace("%", " %")
            if reference
            else _BLANK,
            f"`{target.fingerprint[:12]}`" if target.fingerprint else _BLANK,
        )
    yield ""


def _remarks(results: Results, notes: Sequence[str]) -> Iterator[str]:
    """List the adversaries' flags, errors, and what is missing."""
    flags: Counter[tuple[str, str, str]] = Counter()
    for run in results.runs:
        flags.update((run.table, run.label, flag) for flag in run.flags)
        if run.error is not None:
            flags[run.table, run.label, f"failed: {run.error}"] += 1
    lines = [f"- {note}" for note in notes]
    for (table, label, text), count in flags.items():
        runs = "one run" if count == 1 else f"{count} runs"
        lines.append(f"- {label} ({table}, {runs}): {text}")
    if lines:
        yield from ("## Remarks", "", *lines, "")


def short_name(track: str) -> str:
    """Shorten a track's name for a column: the class where it is one of the paper's twelve."""
    return _CLASSES.get(track) or track.removeprefix("SADA-").rpartition("-v")[0] or track


def _of_tracks(results: Results, table: str, agent: str) -> dict[str, list[Row]]:
    tracks = dict.fromkeys(run.track for run in results.runs if run.agent == agent)
    rows = {track: results.rows_of(table, agent, track) for track in tracks}
    return {track: of_track for track, of_track in rows.items() if of_track}


def _labels(results: Results, table: str, agents: Iterable[str]) -> list[str]:
    return list(
        dict.fromkeys(row.label for agent in agents for row in results.rows_of(table, agent, None))
    )


def _afr(results: Results, rows: Sequence[Row], track: str, agent: str, label: str) -> float | None:
    """Give a contender's AFR on a track, or the reference points' rate for the full set."""
    if label == paper.FULL_SET:
        marks = [t.reference for t in results.targets if (t.track, t.agent) == (track, agent)]
        return marks[0].uniform_rate if marks[0] else None
    found = [row.afr.value for row in rows if row.label == label and row.afr]
    return found[0] if found else None


def _best(rows: Sequence[Row], label: str) -> bool:
    ranks = [row.afr.rank for row in rows if row.label == label and row.afr]
    return bool(ranks and ranks[0] and ranks[0].rstrip("=") == "1")


def _mean(values: Sequence[float | None]) -> float | None:
    there = [value for value in values if value is not None]
    return float(np.mean(there)) if there and len(there) == len(values) else None


def _pair(ours: float | None, theirs: float | None, *, bold: bool = False) -> str:
    text = _percent(ours)
    text = f"**{text}**" if bold else text
    return text if theirs is None else f"{text} / {theirs:.1f}"


def _percent(value: float | None) -> str:
    return _BLANK if value is None else f"{100 * value:.1f}"


def _number(value: float | None, places: int | None) -> str:
    """Write a number with so many decimal places, or as per cent."""
    if value is None or places is None:
        return _percent(value)
    return f"{value:.{places}f}"


def _with_interval(figure: Figure | None) -> str:
    if figure is None or figure.interval_95 is None:
        return _percent(figure.value if figure else None)
    low, high = (100 * end for end in figure.interval_95)
    return f"{_percent(figure.value)} ({low:.1f} to {high:.1f})"


def _rank(figure: Figure | None) -> str:
    return figure.rank or "" if figure else ""


def _head(columns: Sequence[str]) -> tuple[str, str]:
    return _line(*columns), _line(*("---" for _ in columns))


def _line(*cells: str) -> str:
    return f"| {' | '.join(cell.replace('|', '/') for cell in cells)} |"
