"""The plan: every run of a suite with all that decides its result, grouped by what they share."""

from __future__ import annotations

import shlex
from collections.abc import Iterator, Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

from pydantic import ValidationError

from sada_gym import adversaries, agents
from sada_gym.adversaries.base import Adversary
from sada_gym.board.benchmark.suite import ADVERSARIES, BenchmarkSuite, Table
from sada_gym.board.results.models import EntryMetadata, Result, entry_name
from sada_gym.errors import UserError
from sada_gym.experiment.adversary import AdversarySpec, json_compatible
from sada_gym.experiment.ideal import IDEAL
from sada_gym.experiment.packages import packages
from sada_gym.experiment.record import Experiment, RunSettings
from sada_gym.experiment.target import OpenTarget, Target
from sada_gym.foundations.files import first_error
from sada_gym.measures.coverage import NEAREST
from sada_gym.measures.reference import FOLDER
from sada_gym.parameters import Mu

AUTHORS, LICENCE = ("sada_gym's developers",), "MIT"
"""Who made the entries of our own adversaries, and the licence of their data."""

_MAX_PLACE = 150


@dataclass(frozen=True, eq=False)
class RunGroup:
    """The runs of one target and seed. They share a store, so they run in this order, one by one.

    Attributes:
        fooling_set: The points by which coverage is measured, (R, d); None if none are known.
        ideal_set: Other points known to fool, (R, d), from which `ideal` draws its samples.
    """

    target: Target
    seed: int
    runs: tuple[RunSettings, ...]
    fooling_set: Mu | None = None
    ideal_set: Mu | None = None


@dataclass(frozen=True)
class BenchmarkPlan:
    """All runs of a benchmark, in groups, and the `metadata` of its entries by label."""

    suite: BenchmarkSuite
    groups: tuple[RunGroup, ...]
    metadata: Mapping[str, EntryMetadata]
    notes: tuple[str, ...]

    @property
    def runs(self) -> Iterator[RunSettings]:
        """All runs, group by group."""
        return (run for group in self.groups for run in group.runs)


def make_plan(suite: BenchmarkSuite, references: Path = FOLDER) -> BenchmarkPlan:
    """Plan all runs of a suite, and check everything that can be checked before a run.

    Raises a TypeError or ValueError if a part of the suite is not valid.
    """
    notes, rows = list[str](), dict[str, AdversarySpec]()
    for label, spec in suite.adversaries.items():
        package = adversaries.missing_package(spec.name)
        if package is None:
            rows[label] = spec
        else:
            notes.append(
                f"{label} is left out: it needs the package {package}, which is not installed."
            )
    metadata = {label: metadata_of(label, spec) for label, spec in rows.items()}
    groups = []
    for track in suite.tracks:
        for target, tables in _targets(suite, track, references):
            if target.fooling_set is None:
                notes.append(_no_reference(target))
            # each is made once, so that what is wrong with one shows before anything runs
            solvers = [
                (label, spec, spec.make(target.dimension, seed=0, ideal_set=target.ideal_set))
                for label, spec in rows.items()
                if spec.name != IDEAL or target.ideal_set is not None
            ]
            runs = [
                _settings(suite, table, target, label, spec.resolve(), solver)
                for table in tables
                for label, spec, solver in solvers
                if table.includes(label)
            ]
            for seed in suite.seeds_on(track):
                seeded = tuple(_at_seed(run, seed) for run in runs)
                sets = target.fooling_set, target.ideal_set
                groups.append(RunGroup(target.target, seed, seeded, *sets))
    if not any(group.runs for group in groups):
        raise UserError(" ".join(["Expected something to run, got nothing.", *notes]))
    # the longest first, and a whole seed before the next one
    ordered = sorted(groups, key=lambda group: (-len(group.runs), group.seed))
    plan = BenchmarkPlan(suite, tuple(ordered), metadata, tuple(notes))
    _check_places(plan)
    return plan


def metadata_of(label: str, adversary: AdversarySpec) -> EntryMetadata:
    """Return the metadata for the entry of an adversary.

    It raises `UserError` if the label gives no name for a folder, or the options are not JSON.
    """
    ours = ADVERSARIES.get(label) == adversary
    try:
        json_compatible(adversary.options)
        return EntryMetadata(
            name=entry_name(label),
            title=label,
            authors=AUTHORS if ours else (),
            licence=LICENCE if ours else "",
            command=shlex.join(["sada-gym", "benchmark", "-a", label]) if ours else "",
        )
    except (ValidationError, UserError) as error:
        reason = first_error(error) if isinstance(error, ValidationError) else str(error)
        raise UserError(
            f"Expected an adversary that an entry can describe, got {label!r} ({reason}). Give it "
            "a short label, and options that can be written as JSON."
        ) from error


def _at_seed(run: RunSettings, seed: int) -> RunSettings:
    """Return a run with a seed; images are only compared on the first one."""
    changes = {"experiment": run.experiment.at(seed), "images": 0 if seed else run.images}
    return run.model_copy(update=changes)


def _check_places(plan: BenchmarkPlan) -> None:
    """Refuse runs that no entry can hold, and two that would be the same seed of one result."""
    known: dict[tuple[str, str, int], RunSettings] = {}
    for run in plan.runs:
        Result.make(run.experiment, ())  # refuses names that no entry can hold
        # two places that differ in capitals alone would be mistaken for one another
        place = run.experiment.place.lower()
        if len(place) > _MAX_PLACE:
            raise UserError(
                f"Expected names of the track, the agent and the rule of at most {_MAX_PLACE} "
                f"characters in all, since results are called by them, got {len(place)} ({run}). "
                "Give them shorter names."
            )
        twin = known.setdefault((plan.metadata[run.label].name, place, run.seed), run)
        if twin is not run:
            raise UserError(
                f"Expected runs that have a place of their own in the entries, got {twin} and "
                f"{run}, which would share one. Choose one of the tables (--table) or "
                "adversaries (--adversary), or give them other labels or rules."
            )


def _targets(
    suite: BenchmarkSuite, track: str, references: Path
) -> Iterator[tuple[OpenTarget, tuple[Table, ...]]]:
    """Open each agent that is to be attacked on a track, with the tables that it stands in."""
    with ExitStack() as stack:
        first = stack.enter_context(OpenTarget.of(track, references=references))
        default, shipped = first.target.agent, agents.names(first.target.application.name)
        chosen = dict[str, list[Table]]()
        for table in suite.tables:
            for agent in table.attacked(default, shipped):
                chosen.setdefault(agent, []).append(table)
        if default in chosen:
            yield first, tuple(chosen.pop(default))
    for agent, tables in chosen.items():
        with OpenTarget.of(track, agent=agent, references=references) as target:
            yield target, tuple(tables)


def _settings(
    suite: BenchmarkSuite,
    table: Table,
    target: OpenTarget,
    label: str,
    spec: AdversarySpec,
    solver: Adversary,
) -> RunSettings:
    protocol = table.protocol(target, spec, solver)
    if target.fooling_set is not None and protocol.samples <= NEAREST:
        raise UserError(
            f"Expected at least {NEAREST + 1} test samples on {target.target.track}, which has a "
            f"reference set to measure coverage by, got {protocol.samples} (table {table.name}). "
            "Raise the number of samples (--samples)."
        )
    return RunSettings(
        experiment=Experiment(target=target.target, adversary=spec, protocol=protocol),
        label=label,
        images=0 if spec.name == IDEAL else suite.images,
        packages=packages(target.application, type(solver)),
    )


def _no_reference(target: OpenTarget) -> str:
    name = target.target.agent
    agent = f" with the agent {name}" if name else ""
    reference = target.target.reference
    what = "no reference set" if reference is None else "hardly any fooling reference point"
    return (
        f"{target.target.track}{agent} has {what}: the row ideal, coverage, density and relative "
        "novelty stay blank there."
    )
