"""The results of a benchmark: all runs, and the rows that sum them up; results.json."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from sada_gym import agents
from sada_gym.benchmark.figures import Figure, figure, ranked
from sada_gym.benchmark.folder import (
    SETTINGS_FILE,
    TIMING_FILE,
    BenchmarkSettings,
    Timing,
    read_runs,
)
from sada_gym.benchmark.suite import CONTENDERS, CONTROLS
from sada_gym.errors import UserError
from sada_gym.files import OneLine, Strict, file_errors, read_model, write_model
from sada_gym.measures.statistics import interquartile_mean
from sada_gym.registration import env_ids
from sada_gym.runs.measure import Measures, Search
from sada_gym.runs.record import ReferenceSummary, RunFailure, RunKey, RunReport, RunSettings

RESULTS_FILE = "results.json"
TIMINGS_FILE = "timings.json"
FORMAT = 1


class Target(Strict):
    """An agent that was attacked on a track.

    Attributes:
        track: The environment's id.
        agent: The agent's name.
        application: The application's name.
        version: The application's version.
        application_settings: The application's resolved keywords.
        fingerprint: The agent's SHA-256.
        fooling_threshold: The agent is fooled where Q <= this.
        reference: The reference set; None where there is none.
        seeds: The seeds of its runs.
    """

    track: str
    agent: str
    application: str
    version: int
    application_settings: dict[str, Any]
    fingerprint: str
    fooling_threshold: float
    reference: ReferenceSummary | None
    seeds: tuple[int, ...]


class RunSummary(RunKey):
    """One run: what its folder holds, without what its target and the settings already say."""

    adversary: str
    preset: str | None
    options: dict[str, Any]
    budget: int
    samples: int
    error: str | None
    measures: Measures | None
    search: Search | None
    flags: tuple[OneLine, ...]


class Row(Strict):
    """A contender's figures in a table: on one track, or over all.

    Attributes:
        table: The table's name.
        agent: The agent's name.
        track: The environment's id; None for all tracks.
        label: The contender's label.
        tracks: The number of tracks that it has runs on.
        runs: The number of its runs.
        failed: The number of further runs that ended with an error.
        complete: Whether it has all runs that any contender has. Only then it is ranked.
        budget: The queries that it might spend. This figure and the next ones are means.
        queries: The queries that it spent.
        afr: The attack fooling rate.
        afr_iqm: The interquartile mean of the attack fooling rate over all runs.
        coverage: See `Measures`, also for the next figures.
        relative_coverage: The coverage over that of the ideal samples.
        density: The density.
        mu_std: The spread of the samples.
        mean_score: The mean Q.
        novelty: The median distance to the nearest training query.
        novelty_ratio: The novelty over that of the ideal samples.
        novelty_fifth_ratio: The same ratio of the fifth percentiles.
        image_novelty_ratio: The images' median distance over that of ideal samples.
        afr_feasible: The attack fooling rate over feasible worlds; None where they are not known.
    """

    table: str
    agent: str
    track: str | None
    label: str
    tracks: int
    runs: int
    failed: int
    complete: bool
    budget: float
    queries: float | None
    afr: Figure | None
    afr_iqm: float | None
    coverage: Figure | None
    relative_coverage: Figure | None
    density: float | None
    mu_std: float | None
    mean_score: float | None
    novelty: float | None
    novelty_ratio: float | None
    novelty_fifth_ratio: float | None
    image_novelty_ratio: float | None
    afr_feasible: float | None = None


@dataclass(frozen=True)
class Mean:
    """A measure that a row gives the mean of: how it is read and how the tables show it.

    Attributes:
        of: Reads it off a run's measures; None where the run has none.
        title: The column's title; empty for no column.
        places: Decimal places; None shows per cent.
        legend: A line of the legend. Where no row has the measure, such a column is left out.
    """

    of: Callable[[Measures], float | None]
    title: str = ""
    places: int | None = None
    legend: str = ""


MEANS: Mapping[str, Mean] = {
    "density": Mean(lambda m: m.density, "density", 2),
    "mu_std": Mean(lambda m: m.mu_std, "μ_std", 3),
    "mean_score": Mean(lambda m: m.mean_score, "mean Q", 3),
    "novelty": Mean(lambda m: m.novelty.median if m.novelty else None, "novelty", 3),
    "novelty_ratio": Mean(lambda m: m.novelty.ratio if m.novelty else None, "novelty / ideal", 2),
    "novelty_fifth_ratio": Mean(lambda m: m.novelty.fifth_ratio if m.novelty else None),
    "image_novelty_ratio": Mean(
        lambda m: m.image_novelty.ratio if m.image_novelty else None, "image novelty / ideal", 2
    ),
    "afr_feasible": Mean(
        lambda m: m.feasible.afr if m.feasible else None,
        "AFR, feasible, %",
        legend="- AFR, feasible: the AFR over those samples whose worlds a privileged agent "
        "masters.\n",
    ),
}
"""The measures that rows give the mean of, by the row's field."""


class Results(Strict):
    """The contents of results.json. No wall-clock times: a resumed benchmark's file is the same.

    Attributes:
        format: The version of this file's format.
        settings: What all runs have in common.
        targets: The agents that were attacked.
        rows: The figures over all tracks, then those of each.
        runs: The runs.
    """

    format: int
    settings: BenchmarkSettings
    targets: tuple[Target, ...]
    rows: tuple[Row, ...]
    runs: tuple[RunSummary, ...]

    def rows_of(self, table: str, agent: str, track: str | None) -> list[Row]:
        """List the rows of one table and agent, over all tracks or on one."""
        key = (table, agent, track)
        return [row for row in self.rows if (row.table, row.agent, row.track) == key]

    def comparisons(self) -> list[tuple[str, str]]:
        """List each table with each agent that it attacks."""
        return list(dict.fromkeys((run.table, run.agent) for run in self.runs))


class RunTiming(RunKey, Timing):
    """The time and memory that a run took, see `Timing`."""


class Timings(Strict):
    """The contents of timings.json: time and memory of all runs. It is never the same twice."""

    runs: tuple[RunTiming, ...]


def write_results(out: Path) -> Results:
    """Sum up all runs that a folder holds, in results.json, and their costs in timings.json.

    Raises:
        ValueError: If it is no benchmark's folder, or holds no finished run.
    """
    with file_errors("read", out):
        ours = (out / SETTINGS_FILE).exists()
    if not ours:
        raise UserError(f"Expected a benchmark's folder, got {out} without a {SETTINGS_FILE}.")
    settings = read_model(out / SETTINGS_FILE, BenchmarkSettings)
    there = read_runs(out)
    if not there:
        raise UserError(f"Expected finished runs in {out}, got none yet. Run the benchmark.")
    tables = [table.name for table in settings.tables]
    there.sort(key=lambda one: _run_order(one[0].settings, tables))
    targets = {
        (result.settings.track, result.settings.agent): Target(
            **result.settings.model_dump(include=set(Target.model_fields)),
            fooling_threshold=result.fooling_threshold,
            seeds=(),
        )
        for result, _ in there
    }
    results = put_together(settings, targets, [_summary(result) for result, _ in there])
    write_model(out / RESULTS_FILE, results)
    timings = [_timing(result.settings, folder) for result, folder in there]
    write_model(out / TIMINGS_FILE, Timings(runs=tuple(timings)))
    return results


def put_together(
    settings: BenchmarkSettings,
    targets: Mapping[tuple[str, str], Target],
    runs: Sequence[RunSummary],
) -> Results:
    """Put runs in order, and sum them up.

    Args:
        settings: What all runs have in common.
        targets: What was attacked, by track and agent; its seeds are found anew.
        runs: The runs.
    """
    tables = [table.name for table in settings.tables]
    ordered = sorted(runs, key=lambda run: _run_order(run, tables))
    seeds: dict[tuple[str, str], set[int]] = {}
    for run in ordered:
        seeds.setdefault((run.track, run.agent), set()).add(run.seed)
    return Results(
        format=FORMAT,
        settings=settings,
        targets=tuple(
            targets[place].model_copy(update={"seeds": tuple(sorted(own))})
            for place, own in seeds.items()
        ),
        rows=tuple(rows_of_runs(ordered)),
        runs=tuple(ordered),
    )


def _run_order(run: RunKey, tables: Sequence[str]) -> tuple[Any, ...]:
    """Give a key to sort runs by: known names in their order, then other names."""

    def place(name: str, known: Sequence[str]) -> tuple[int, str]:
        return (known.index(name) if name in known else len(known), name)

    return (
        place(run.table, tables),
        place(run.agent, agents.names()),
        place(run.track, env_ids()),
        place(run.label, [contender.label for contender in CONTENDERS]),
        run.seed,
    )


def _summary(result: RunReport | RunFailure) -> RunSummary:
    settings = result.settings.model_dump(include=set(RunSummary.model_fields))
    if isinstance(result, RunFailure):
        return RunSummary(**settings, error=result.error, measures=None, search=None, flags=())
    return RunSummary(
        **settings,
        error=None,
        measures=result.measures(),
        search=result.search,
        flags=result.flags,
    )


def _timing(settings: RunSettings, folder: Path) -> RunTiming:
    costs = read_model(folder / TIMING_FILE, Timing)
    return RunTiming(**settings.model_dump(include=set(RunKey.model_fields)), **costs.model_dump())


def rows_of_runs(runs: Sequence[RunSummary]) -> Iterator[Row]:
    """Give the rows of each table and agent: over all tracks, then of each track."""
    for table, agent in dict.fromkeys((run.table, run.agent) for run in runs):
        of_both = [run for run in runs if (run.table, run.agent) == (table, agent)]
        for track in (None, *dict.fromkeys(run.track for run in of_both)):
            chosen = [run for run in of_both if track in (None, run.track)]
            every = {(run.track, run.seed) for run in chosen}
            labels = dict.fromkeys(run.label for run in chosen)
            rows = [
                _row(track, [run for run in chosen if run.label == label], every)
                for label in labels
            ]
            yield from _with_ranks(rows)


def _row(track: str | None, runs: Sequence[RunSummary], every: set[tuple[str, int]]) -> Row:
    first = runs[0]
    good = [(run, run.measures) for run in runs if run.measures is not None]

    def measured(get: Callable[[Measures], float | None]) -> list[list[float]]:
        """Give a measure of all runs by track, less what has none."""
        by_track: dict[str, list[float]] = {}
        for run, measures in good:
            if (value := get(measures)) is not None:
                by_track.setdefault(run.track, []).append(value)
        return list(by_track.values())

    def mean(values: Sequence[Sequence[float]]) -> float | None:
        return float(np.mean([np.mean(seeds) for seeds in values])) if values else None

    rates = measured(lambda m: m.afr)
    samples = {run.track: run.samples for run, _ in good}
    return Row(
        table=first.table,
        agent=first.agent,
        track=track,
        label=first.label,
        tracks=len(rates),
        runs=len(good),
        failed=len(runs) - len(good),
        complete={(run.track, run.seed) for run, _ in good} == every,
        budget=float(np.mean([run.budget for run in runs])),
        queries=mean([[run.search.queries] for run, _ in good if run.search is not None]),
        afr=figure(rates, list(samples.values())),
        afr_iqm=interquartile_mean([rate for seeds in rates for rate in seeds]) if rates else None,
        coverage=figure(measured(lambda m: m.coverage)),
        relative_coverage=figure(measured(lambda m: m.relative_coverage)),
        **{name: mean(measured(one.of)) for name, one in MEANS.items()},
    )


def _with_ranks(rows: Sequence[Row]) -> list[Row]:
    """Rank the contenders of one table, agent and track by AFR and by coverage."""
    unranked = [row.label for row in rows if row.label in CONTROLS or not row.complete]
    for name in ("afr", "coverage", "relative_coverage"):
        there = {row.label: one for row in rows if (one := getattr(row, name)) is not None}
        with_ranks = ranked(there, unranked)
        rows = [row.model_copy(update={name: with_ranks.get(row.label)}) for row in rows]
    return list(rows)
