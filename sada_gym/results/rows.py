"""A contender's figures in a table: over the seeds and tracks of its runs, with ranks."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from sada_gym.experiment.measure import Measures
from sada_gym.experiment.record import Experiment
from sada_gym.files import Strict
from sada_gym.measures.statistics import interquartile_mean
from sada_gym.results.figures import Figure, figure, ranked
from sada_gym.results.models import SeedResult


class RunSummary(Strict):
    """One run: a seed of a result, in a table that shows it.

    Attributes:
        table: The table's name.
        label: What reports call the adversary.
        entry: The name of the entry.
        experiment: The experiment, with its seed.
        claims: What the entry claims; in the verifier's tier its measures, and its flags too.
        control: Whether the adversary is a control, which has no rank.
        disqualified: Whether the verifier found what takes the rank: see `DISQUALIFYING`.
    """

    table: str
    label: str
    entry: str
    experiment: Experiment
    claims: SeedResult
    control: bool
    disqualified: bool

    @property
    def track(self) -> str:
        """The environment's id."""
        return self.experiment.target.track

    @property
    def agent(self) -> str:
        """The agent's name."""
        return self.experiment.target.agent

    @property
    def measures(self) -> Measures | None:
        """The measures of the test samples; None after an error."""
        return self.claims.measures


class Row(Strict):
    """A contender's figures in a table: on one track, or over all.

    Attributes:
        table: The table's name.
        agent: The agent's name.
        track: The environment's id; None for all tracks.
        label: The contender's label.
        entry: The name of its entry.
        control: Whether it is a control, which has no rank.
        disqualified: Whether the verifier found what takes its rank on any of these tracks.
        tracks: The number of tracks that it has runs on.
        runs: The number of its runs.
        failed: The number of further runs that ended with an error.
        complete: Whether it has runs on all tracks that any contender has, and none that failed.
            Only then it is ranked.
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
    entry: str
    control: bool
    disqualified: bool
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


def rows_of_runs(runs: Sequence[RunSummary]) -> Iterator[Row]:
    """Give the rows of each table and agent: over all tracks, then of each track."""
    for table, agent in dict.fromkeys((run.table, run.agent) for run in runs):
        of_both = [run for run in runs if (run.table, run.agent) == (table, agent)]
        for track in (None, *dict.fromkeys(run.track for run in of_both)):
            chosen = [run for run in of_both if track in (None, run.track)]
            every = {run.track for run in chosen}
            rows = [
                _row(track, [run for run in chosen if run.entry == entry], every)
                for entry in dict.fromkeys(run.entry for run in chosen)
            ]
            yield from _with_ranks(rows)


def _row(track: str | None, runs: Sequence[RunSummary], every: set[str]) -> Row:
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
    samples = {run.track: run.experiment.protocol.samples for run, _ in good}
    return Row(
        table=first.table,
        agent=first.agent,
        track=track,
        label=first.label,
        entry=first.entry,
        control=first.control,
        tracks=len(rates),
        runs=len(good),
        failed=len(runs) - len(good),
        disqualified=any(run.disqualified for run in runs),
        complete=len(good) == len(runs) and {run.track for run, _ in good} == every,
        budget=float(np.mean([run.experiment.protocol.budget for run in runs])),
        queries=mean([[run.claims.queries] for run, _ in good]),
        afr=figure(rates, list(samples.values())),
        afr_iqm=interquartile_mean([rate for seeds in rates for rate in seeds]) if rates else None,
        coverage=figure(measured(lambda m: m.coverage)),
        relative_coverage=figure(measured(lambda m: m.relative_coverage)),
        **{name: mean(measured(one.of)) for name, one in MEANS.items()},
    )


def _with_ranks(rows: Sequence[Row]) -> list[Row]:
    """Rank the contenders of one table, agent and track by AFR and by coverage."""
    unranked = [row.entry for row in rows if row.control or row.disqualified or not row.complete]
    for name in ("afr", "coverage", "relative_coverage"):
        there = {row.entry: one for row in rows if (one := getattr(row, name)) is not None}
        with_ranks = ranked(there, unranked)
        rows = [row.model_copy(update={name: with_ranks.get(row.entry)}) for row in rows]
    return list(rows)
