"""Results out of entries of the leaderboard: their runs by table, and the rows that sum them up."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from sada_gym import agents
from sada_gym.benchmark.figures import Figure, figure, ranked
from sada_gym.benchmark.suite import CONTENDERS, CONTROLS, Table
from sada_gym.experiment.measure import Measures, Search
from sada_gym.experiment.packages import in_order
from sada_gym.experiment.record import ReferenceSummary, RunKey, refuse_other
from sada_gym.files import OneLine, Strict
from sada_gym.measures.statistics import interquartile_mean
from sada_gym.registration import env_ids
from sada_gym.submission.entry import Entry, EntryResult
from sada_gym.submission.models import DISQUALIFYING, Identity, SeedResult, Tier, entry_name


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
    """One run: a seed of a result, in a table that shows it.

    Attributes:
        entry: The name of the entry.
        rule: The rule for the budget by which the result was made.
        adversary: See `sada_gym.submission.models.Identity`, also for the next four.
        preset: The named set of options that the adversary starts from.
        options: Its other options.
        budget: The number of training queries that it might spend.
        samples: The number of test samples.
        queries: See `sada_gym.submission.models.SeedResult`, also for the next four.
        error: Why the adversary could not do its work.
        measures: The measures of the test samples, those of the verifier in its tier.
        search: What the training queries found.
        flags: What a reader must know, with what the verifier found in its tier.
        disqualified: Whether the verifier found what takes the rank: see `DISQUALIFYING`.
    """

    entry: str
    rule: str
    adversary: str
    preset: str | None
    options: dict[str, Any]
    budget: int
    samples: int
    queries: int
    error: str | None
    measures: Measures | None
    search: Search | None
    flags: tuple[OneLine, ...]
    disqualified: bool


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


class Results(Strict):
    """The results of entries, put together in tables.

    Attributes:
        tables: The tables.
        packages: The versions of the packages that took part in any run, by package.
        targets: The agents that were attacked.
        rows: The figures over all tracks, then those of each.
        runs: The runs.
    """

    tables: tuple[Table, ...]
    packages: dict[str, tuple[str, ...]]
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


def results_of(
    entries: Sequence[Entry], tables: Sequence[Table], *, tier: Tier = "claimed"
) -> Results:
    """Put the results of entries together in tables, with intervals and ranks.

    Args:
        entries: The entries. Leave out the results that are outdated; see
            `sada_gym.submission.entry.Entry`.
        tables: The tables. Each takes the results that were made by its rule against its agents.
        tier: What to show: what all entries claim, or what the verifier found of those results
            that it has seen.

    Raises:
        UserError: If two results attack different versions of a track or of its agent.
    """
    labels = _labels(entries)
    runs, targets = list[RunSummary](), dict[tuple[str, str], Target]()
    versions: dict[str, set[str]] = {}
    for entry in entries:
        for result in entry.results.values():
            identity = result.claimed.identity
            showing = [
                table
                for table in tables
                if table.shows(identity.rule, identity.application, identity.agent)
            ]
            seeds = list(_seeds(result, tier))
            if not showing or not seeds:
                continue
            _add_target(targets, identity)
            for one in seeds:
                for name, version in one.packages.items():
                    versions.setdefault(name, set()).add(version)
                runs += [
                    _summary(table.name, entry, labels[entry.about.name], result, one, tier)
                    for table in showing
                ]
    names = [table.name for table in tables]
    runs.sort(key=lambda run: _run_order(run, names))
    of: dict[tuple[str, str], set[int]] = {}
    for run in runs:
        of.setdefault((run.track, run.agent), set()).add(run.seed)
    ordered = in_order({name: ", ".join(sorted(found)) for name, found in versions.items()})
    return Results(
        tables=tuple(tables),
        packages={name: tuple(sorted(versions[name])) for name in ordered},
        targets=tuple(
            targets[place].model_copy(update={"seeds": tuple(sorted(own))})
            for place, own in of.items()
        ),
        rows=tuple(rows_of_runs(runs)),
        runs=tuple(runs),
    )


def _labels(entries: Sequence[Entry]) -> dict[str, str]:
    """Give each entry's label: its title, and its name too where another one has this title."""
    times = Counter(entry.about.title for entry in entries)
    return {
        about.name: about.title
        if times[about.title] == 1 or about.name == entry_name(about.title)
        else f"{about.title} [{about.name}]"
        for about in (entry.about for entry in entries)
    }


def _seeds(result: EntryResult, tier: Tier) -> Iterator[SeedResult]:
    """Give the seeds of a result, with the measures of a tier."""
    if tier == "claimed":
        yield from result.claimed.seeds
    elif result.verified is not None:
        measures = {one.seed: one.measures for one in result.verified.seeds}
        flags = tuple(f"{name}: {text}" for name, text in result.verified.flags.items())
        for one in result.claimed.seeds:
            if one.measures is None:
                yield one
            elif one.seed in measures:
                found = {"measures": measures[one.seed], "flags": (*one.flags, *flags)}
                yield one.model_copy(update=found)


def _add_target(targets: dict[tuple[str, str], Target], identity: Identity) -> None:
    """Add what a result attacks, unless it is known.

    Raises:
        UserError: If another version of it is known.
    """
    target = Target(**identity.model_dump(include=set(Target.model_fields)), seeds=())
    known = targets.setdefault((target.track, target.agent), target)
    refuse_other(
        f"results of one version of {identity.track} and of its agent",
        known.model_dump(),
        target.model_dump(),
        "Leave those out that are outdated, or make them anew.",
    )


def _summary(
    table: str, entry: Entry, label: str, result: EntryResult, one: SeedResult, tier: Tier
) -> RunSummary:
    named = {"rule", "track", "agent", "adversary", "preset", "options", "budget", "samples"}
    flags = result.verified.flags if tier == "verified" and result.verified is not None else {}
    return RunSummary(
        table=table,
        entry=entry.about.name,
        label=label,
        disqualified=not DISQUALIFYING.isdisjoint(flags),
        **result.claimed.identity.model_dump(include=named),
        **{
            name: getattr(one, name)
            for name in ("seed", "queries", "error", "measures", "search", "flags")
        },
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
    samples = {run.track: run.samples for run, _ in good}
    return Row(
        table=first.table,
        agent=first.agent,
        track=track,
        label=first.label,
        entry=first.entry,
        control=first.adversary in CONTROLS,
        tracks=len(rates),
        runs=len(good),
        failed=len(runs) - len(good),
        disqualified=any(run.disqualified for run in runs),
        complete=len(good) == len(runs) and {run.track for run, _ in good} == every,
        budget=float(np.mean([run.budget for run in runs])),
        queries=mean([[run.queries] for run, _ in good]),
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
