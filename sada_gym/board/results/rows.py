"""An adversary's figures in a table: over the seeds and tracks of its runs, with its rank."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from sada_gym.board.results.figures import Figure, f1_figure, figure, ranks_of
from sada_gym.board.results.models import SeedResult
from sada_gym.experiment.measure import Measures
from sada_gym.experiment.names import IDEAL
from sada_gym.experiment.record import Experiment
from sada_gym.foundations.files import Strict
from sada_gym.measures.statistics import interquartile_mean

T = TypeVar("T")


class RunSummary(Strict):
    """One run, which is one seed of a result, with what tables show of it.

    Attributes:
        label: The adversary's name in reports.
        entry: The name of the entry.
        experiment: The experiment, with its seed.
        claims: The claims of the entry; for a verified result the verifier's measures and flags.
        control: Whether the adversary is a control, which has no rank.
        disqualified: Whether the verifier found a false claim, or constant or copied samples.
    """

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
    def measures(self) -> Measures | None:
        """The measures of the test samples; None after an error."""
        return self.claims.measures


class Row(Strict):
    """A row of a table: the figures of an adversary on one track, or over several.

    Attributes:
        label: The adversary's name in the table.
        entry: The name of its entry.
        control: Whether it is a control, which has no rank.
        disqualified: Whether a flag of the verifier takes its rank on any of these tracks.
        tracks: The number of tracks on which it has runs.
        runs: The number of its runs.
        failed: The number of further runs that ended with an error.
        complete: Whether it has runs on all tracks of the table, and none that failed. Only then it
            is ranked.
        rank: `1`, or shared `1=`, by F1; by AFR if a track has no coverage. None for controls, and
            for incomplete or disqualified adversaries.
        budget: The mean number of queries that it may spend.
        queries: The mean number of queries that it spent.
        f1: The mean F1 of AFR and coverage, see `f1`; None if a track has no coverage.
        afr: The mean attack fooling rate.
        afr_iqm: The interquartile mean of the attack fooling rate over all runs.
        coverage: The mean coverage, see `Measures`; `relative_coverage` likewise.
        means: Further means, such as `mu_std`, by name; None if no run has the measure.
    """

    label: str
    entry: str
    control: bool
    disqualified: bool
    tracks: int
    runs: int
    failed: int
    complete: bool
    rank: str | None
    budget: float
    queries: float | None
    f1: Figure | None
    afr: Figure | None
    afr_iqm: float | None
    coverage: Figure | None
    relative_coverage: Figure | None
    means: dict[str, float | None]

    @property
    def deciding(self) -> Figure | None:
        """The figure that orders the table: F1, or the AFR if there is no F1."""
        return self.f1 or self.afr

    @property
    def is_first(self) -> bool:
        """Whether it has rank 1, shared or not."""
        return self.rank in ("1", "1=")


@dataclass(frozen=True)
class Measure:
    """A measure in rows: how to get it from a run, and how tables show it.

    Attributes:
        read: Returns it from the measures of a run; None if the run does not have it.
        title: The title of its column; empty for no column.
        places: The number of decimal places; None shows per cent.
        hint: A sentence that explains it.
        optional: Whether a table omits the column if no row has this measure.
    """

    read: Callable[[Measures], float | None]
    title: str = ""
    places: int | None = None
    hint: str = ""
    optional: bool = False


MEANS: Mapping[str, Measure] = {
    "density": Measure(lambda m: m.density, "density", 2),
    "mu_std": Measure(
        lambda m: m.mu_std, "μ_std", 3, "The spread of the samples; 0.577 where they are uniform."
    ),
    "mean_score": Measure(lambda m: m.mean_score, "mean Q", 3),
    "novelty": Measure(lambda m: m.novelty.median if m.novelty else None, "novelty", 3),
    "novelty_ratio": Measure(
        lambda m: m.novelty.ratio if m.novelty else None, "novelty / ideal", 2
    ),
    "novelty_fifth_ratio": Measure(lambda m: m.novelty.fifth_ratio if m.novelty else None),
    "image_novelty_ratio": Measure(
        lambda m: m.image_novelty.ratio if m.image_novelty else None,
        "image novelty / ideal",
        2,
        optional=True,
    ),
    "afr_feasible": Measure(
        lambda m: m.feasible.afr if m.feasible else None,
        "AFR, feasible, %",
        hint="AFR, feasible: the AFR over those samples in whose worlds a privileged agent, which "
        "knows more than the attacked one, succeeds.",
        optional=True,
    ),
}
"""The measures that rows give the mean of; tables have a column for each that has a title."""


def rows_of_runs(runs: Sequence[RunSummary]) -> tuple[Row, ...]:
    """Return a row for each adversary from its runs on one or several tracks, with ranks.

    Rows are ranked by F1. If a track has no coverage, as without a reference set, there is no F1,
    and rows are ranked by AFR. The AFR of ideal samples is that of the control `ideal` on the
    track, or 100 % without runs of `ideal`.
    """
    measured = [(run, run.measures) for run in runs if run.measures is not None]
    tracks = {run.track for run in runs}
    covered = {run.track for run, measures in measured if measures.relative_coverage is not None}
    is_ideal = {run.entry for run in runs if run.experiment.adversary.name == IDEAL}
    ideal = _by_track([(run, m.afr) for run, m in measured if run.entry in is_ideal])
    ideal_afr = {name: float(np.mean(rates)) for name, rates in ideal.items()}
    rows = []
    for entry in dict.fromkeys(run.entry for run in runs):
        own = [run for run in runs if run.entry == entry]
        rows.append(_row(own, tracks, ideal_afr if covered == tracks else None))
    return tuple(_ranked(rows))


def _by_track(values: Sequence[tuple[RunSummary, T]]) -> dict[str, list[T]]:
    by_track: dict[str, list[T]] = {}
    for run, value in values:
        by_track.setdefault(run.track, []).append(value)
    return by_track


def _row(
    runs: Sequence[RunSummary], tracks: set[str], ideal_afr: Mapping[str, float] | None
) -> Row:
    """Sum up the runs of one entry; without `ideal_afr` there is no F1."""
    first = runs[0]
    good = [(run, run.measures) for run in runs if run.measures is not None]

    def measured(read: Callable[[Measures], float | None]) -> list[list[float]]:
        values = [(run, value) for run, m in good if (value := read(m)) is not None]
        return list(_by_track(values).values())

    def mean(values: Sequence[Sequence[float]]) -> float | None:
        return float(np.mean([np.mean(seeds) for seeds in values])) if values else None

    rates = measured(lambda m: m.afr)
    samples = {run.track: run.experiment.protocol.samples for run, _ in good}
    has_f1 = ideal_afr is not None and all(m.relative_coverage is not None for _, m in good)
    return Row(
        label=first.label,
        entry=first.entry,
        control=first.control,
        tracks=len(rates),
        runs=len(good),
        failed=len(runs) - len(good),
        disqualified=any(run.disqualified for run in runs),
        complete=len(good) == len(runs) and {run.track for run, _ in good} == tracks,
        budget=float(np.mean([run.experiment.protocol.budget for run in runs])),
        queries=mean([[run.claims.queries] for run, _ in good]),
        rank=None,
        f1=f1_figure(_by_track(good), samples, ideal_afr or {}) if has_f1 else None,
        afr=figure(rates, list(samples.values())),
        afr_iqm=interquartile_mean([rate for seeds in rates for rate in seeds]) if rates else None,
        coverage=figure(measured(lambda m: m.coverage)),
        relative_coverage=figure(measured(lambda m: m.relative_coverage)),
        means={name: mean(measured(measure.read)) for name, measure in MEANS.items()},
    )


def _ranked(rows: Sequence[Row]) -> Iterator[Row]:
    """Rank the rows of one table, agent and track by F1, or by AFR where none has F1."""
    by = "f1" if any(row.f1 for row in rows) else "afr"
    figures = {row.entry: value for row in rows if (value := getattr(row, by)) is not None}
    unranked = {row.entry for row in rows if row.control or row.disqualified or not row.complete}
    ranks = ranks_of(figures, unranked & figures.keys())
    for row in rows:
        yield row.model_copy(update={"rank": ranks.get(row.entry)})


def front_of(rows: Iterable[Row]) -> dict[str, bool]:
    """Find the entries that no other entry beats in both AFR and coverage.

    Returns:
        Whether each complete entry with both figures, but no control, is on this front, by name.
    """
    points = {
        row.entry: (row.afr.value, row.relative_coverage.value)
        for row in rows
        if not row.control and row.complete and row.afr and row.relative_coverage
    }
    return {
        entry: not any(a > afr and c > coverage for a, c in points.values())
        for entry, (afr, coverage) in points.items()
    }
