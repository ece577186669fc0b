"""Results out of entries of the leaderboard: their runs by table, and the rows that sum them up."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from functools import partial
from typing import Any

from sada_gym import agents
from sada_gym.benchmark.suite import ADVERSARIES, CONTROLS, Table
from sada_gym.experiment.differences import check_same_record
from sada_gym.experiment.packages import in_order
from sada_gym.experiment.target import Target
from sada_gym.files import Strict
from sada_gym.registration import env_ids
from sada_gym.results.entry import Entry, EntryResult
from sada_gym.results.models import DISQUALIFYING, SeedResult, Tier, entry_name
from sada_gym.results.rows import Row, RunSummary, rows_of_runs


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

    def seeds_of(self, target: Target) -> list[int]:
        """List the seeds of the runs that attack a target."""
        return sorted({run.claims.seed for run in self.runs if run.experiment.target == target})

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
            `sada_gym.results.entry.Entry`.
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
            experiment = result.claimed.experiment
            target, verified = experiment.target, result.verified if tier == "verified" else None
            showing = [table for table in tables if table.shows(experiment)]
            seeds = list(_seeds(result, tier))
            if not showing or not seeds:
                continue
            check_same_record(
                f"results of one version of {target.track} and of its agent",
                targets.setdefault((target.track, target.agent), target).model_dump(),
                target.model_dump(),
                "Leave those out that are outdated, or make them anew.",
            )
            for claims in seeds:
                for name, version in claims.packages.items():
                    versions.setdefault(name, set()).add(version)
                runs += [
                    RunSummary(
                        table=table.name,
                        label=labels[entry.metadata.name],
                        entry=entry.metadata.name,
                        experiment=experiment.at(claims.seed),
                        claims=claims,
                        control=experiment.adversary.name in CONTROLS,
                        disqualified=verified is not None
                        and not DISQUALIFYING.isdisjoint(verified.flags),
                    )
                    for table in showing
                ]
    runs.sort(key=partial(_run_order, tables=[table.name for table in tables]))
    ordered = in_order({name: ", ".join(sorted(several)) for name, several in versions.items()})
    return Results(
        tables=tuple(tables),
        packages={name: tuple(sorted(versions[name])) for name in ordered},
        targets=tuple(
            targets[key] for key in dict.fromkeys((run.track, run.agent) for run in runs)
        ),
        rows=tuple(rows_of_runs(runs)),
        runs=tuple(runs),
    )


def _labels(entries: Sequence[Entry]) -> dict[str, str]:
    """Return each entry's label: its title, and its name too where another one has this title."""
    times = Counter(entry.metadata.title for entry in entries)
    labels = {}
    for metadata in (entry.metadata for entry in entries):
        name, title = metadata.name, metadata.title
        is_clear = times[title] == 1 or name == entry_name(title)
        labels[name] = title if is_clear else f"{title} [{name}]"
    return labels


def _seeds(result: EntryResult, tier: Tier) -> Iterator[SeedResult]:
    """Return the claims of each seed, with the verifier's measures and flags in its tier."""
    if tier == "claimed":
        yield from result.claimed.seeds
    elif result.verified is not None:
        measures = {seed.seed: seed.measures for seed in result.verified.seeds}
        flags = tuple(f"{name}: {text}" for name, text in result.verified.flags.items())
        for claims in result.claimed.seeds:
            if claims.measures is None:
                yield claims
            elif claims.seed in measures:
                changes = {"measures": measures[claims.seed], "flags": (*claims.flags, *flags)}
                yield claims.model_copy(update=changes)


def _run_order(run: RunSummary, tables: Sequence[str]) -> tuple[Any, ...]:
    """Return a key to sort runs by: known names in their order, then other names."""

    def place(name: str, names: Sequence[str]) -> tuple[int, str]:
        return (names.index(name) if name in names else len(names), name)

    return (
        place(run.table, tables),
        place(run.agent, agents.names()),
        place(run.track, env_ids()),
        place(run.label, list(ADVERSARIES)),
        run.claims.seed,
    )
