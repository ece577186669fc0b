"""Results out of entries of the leaderboard: their runs by table, and the rows that sum them up."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

from sada_gym import agents
from sada_gym.board.benchmark.suite import ADVERSARIES, CONTROLS, Table, tables_of
from sada_gym.board.results.entry import Entry, EntryResult
from sada_gym.board.results.models import DISQUALIFYING, Tier, entry_name
from sada_gym.board.results.rows import Row, RunSummary, rows_of_runs
from sada_gym.experiment.differences import check_same_record
from sada_gym.experiment.packages import in_order
from sada_gym.experiment.record import slug
from sada_gym.experiment.target import Target
from sada_gym.foundations.registration import env_ids


@dataclass(frozen=True)
class TableComparison:
    """The runs of a table against one agent."""

    table: Table
    agent: str
    runs: tuple[RunSummary, ...]

    @property
    def name(self) -> str:
        """The name in files and links: `TABLE.AGENT`."""
        return slug(f"{self.table.name}.{self.agent}".strip("."))

    @property
    def names(self) -> tuple[str, ...]:
        """The table's title, and the agent's name if it has one."""
        return (self.table.title, self.agent) if self.agent else (self.table.title,)

    @property
    def tracks(self) -> tuple[str, ...]:
        """The tracks that have runs."""
        return tuple(dict.fromkeys(run.track for run in self.runs))

    @cached_property
    def rows(self) -> tuple[Row, ...]:
        """The figures over all tracks."""
        return rows_of_runs(self.runs)

    @cached_property
    def by_track(self) -> dict[str, tuple[Row, ...]]:
        """The figures on each track."""
        return {
            track: rows_of_runs([run for run in self.runs if run.track == track])
            for track in self.tracks
        }


@dataclass(frozen=True)
class Results:
    """The results of entries, in tables.

    Attributes:
        targets: The agents that were attacked, each on its track.
        comparisons: One for each table and each agent that it attacks.
    """

    targets: tuple[Target, ...]
    comparisons: tuple[TableComparison, ...]

    @property
    def runs(self) -> tuple[RunSummary, ...]:
        """All runs."""
        return tuple(run for comparison in self.comparisons for run in comparison.runs)

    @property
    def packages(self) -> dict[str, tuple[str, ...]]:
        """The versions of all packages that the runs used, by package."""
        versions: dict[str, set[str]] = {}
        for name, version in (pair for run in self.runs for pair in run.claims.packages.items()):
            versions.setdefault(name, set()).add(version)
        ordered = in_order({name: ", ".join(sorted(several)) for name, several in versions.items()})
        return {name: tuple(sorted(versions[name])) for name in ordered}

    def seeds_of(self, target: Target) -> list[int]:
        """Return the seeds of the runs that attack a target."""
        return sorted({run.claims.seed for run in self.runs if run.experiment.target == target})

    def find(self, table: str, agent: str) -> TableComparison | None:
        """Return the runs of a table against an agent, or None."""
        named = (c for c in self.comparisons if (c.table.name, c.agent) == (table, agent))
        return next(named, None)

    def rows_of(self, table: str, agent: str, track: str | None) -> tuple[Row, ...]:
        """Return a table's rows against an agent, on one track or over all tracks (None)."""
        comparison = self.find(table, agent)
        if comparison is None:
            return ()
        return comparison.rows if track is None else comparison.by_track.get(track, ())


def results_of(
    entries: Sequence[Entry], tables: Sequence[Table] = (), *, tier: Tier = "claimed"
) -> Results:
    """Make tables of the results of entries, with intervals and ranks.

    Args:
        entries: The entries, without outdated results (see `Entry.keeping`).
        tables: The tables. Each shows the results of its rule for the budget against its agents.
            Without any, there is a table for every rule that occurs.
        tier: Which figures to show: `claimed`, those of the entries; or `verified`, those of the
            verifier, for the results that it checked.

    Raises:
        UserError: If two results attack different versions of a track or of its agent.
    """
    if not tables:
        tables = tables_of(
            {r.experiment.protocol.rule for e in entries for r in e.results.values()}
        )
    labels = _labels(entries)
    targets: dict[tuple[str, str], Target] = {}
    runs_of: dict[tuple[int, str], list[RunSummary]] = {}
    for entry in entries:
        name = entry.metadata.name
        for result in entry.results.values():
            target = result.experiment.target
            showing = [i for i, table in enumerate(tables) if table.shows(result.experiment)]
            runs = list(_runs(labels[name], name, result, tier)) if showing else []
            if runs:
                check_same_record(
                    f"results of one version of {target.track} and of its agent",
                    targets.setdefault((target.track, target.agent), target).model_dump(),
                    target.model_dump(),
                    "Leave those out that are outdated, or make them again.",
                )
                for table in showing:
                    runs_of.setdefault((table, target.agent), []).extend(runs)
    known = agents.names()
    comparisons = tuple(
        TableComparison(tables[table], agent, tuple(sorted(runs_of[table, agent], key=_run_order)))
        for table, agent in sorted(runs_of, key=lambda key: (key[0], _place(key[1], known)))
    )
    attacked = dict.fromkeys((track, c.agent) for c in comparisons for track in c.tracks)
    return Results(tuple(targets[key] for key in attacked), comparisons)


def _labels(entries: Sequence[Entry]) -> dict[str, str]:
    """Return each entry's label: its title, and its name too where another one has this title."""
    titles = {entry.metadata.name: entry.metadata.title for entry in entries}
    times = Counter(entry.metadata.title for entry in entries)
    return {
        name: title if times[title] == 1 or name == entry_name(title) else f"{title} [{name}]"
        for name, title in titles.items()
    }


def _runs(label: str, entry: str, result: EntryResult, tier: Tier) -> Iterator[RunSummary]:
    """Return each seed of a result, with the verifier's measures and flags in its tier."""
    experiment, verified = result.experiment, result.verified
    measures = {seed.seed: seed.measures for seed in verified.seeds} if verified else {}
    flags = verified.flags if verified else {}
    for claims in result.claimed.seeds:
        if tier == "verified":
            if verified is None or (claims.measures and claims.seed not in measures):
                continue
            if claims.measures:
                more = (f"{name}: {text}" for name, text in flags.items())
                changes = {"measures": measures[claims.seed], "flags": (*claims.flags, *more)}
                claims = claims.model_copy(update=changes)
        yield RunSummary(
            label=label,
            entry=entry,
            experiment=experiment.at(claims.seed),
            claims=claims,
            control=experiment.adversary.name in CONTROLS,
            disqualified=tier == "verified" and not DISQUALIFYING.isdisjoint(flags),
        )


def _run_order(run: RunSummary) -> tuple[tuple[int, str], tuple[int, str], int]:
    return _place(run.track, env_ids()), _place(run.label, list(ADVERSARIES)), run.claims.seed


def _place(name: str, names: Sequence[str]) -> tuple[int, str]:
    """Return a key to sort by: known names in their order, then others."""
    return (names.index(name) if name in names else len(names), name)
