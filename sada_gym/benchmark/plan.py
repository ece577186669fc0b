"""The plan: every run of a suite with all that decides its result, grouped by what they share."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from pydantic import ValidationError

from sada_gym import agents
from sada_gym.adversaries.base import Adversary
from sada_gym.benchmark.entries import about_of
from sada_gym.benchmark.suite import Contender, Suite, Table
from sada_gym.errors import UserError
from sada_gym.evaluation.problems import make_application
from sada_gym.experiment.assemble import RunTarget, make_adversary, make_settings
from sada_gym.experiment.ideal import IDEAL
from sada_gym.experiment.record import RunSettings
from sada_gym.files import first_error
from sada_gym.measures.coverage import NEAREST
from sada_gym.measures.reference import FOLDER, load_reference
from sada_gym.parameters import Mu
from sada_gym.submission.models import About, Identity

_MAX_STEM = 150


@dataclass(frozen=True, eq=False)
class Group:
    """The runs of one track, agent and seed: they share a store, so one follows the other.

    Attributes:
        track: The environment's id.
        keywords: The environment's keywords that name the agent; empty for the default agent.
        agent: The agent's name.
        seed: The seed.
        runs: The runs, in the order in which they are done.
        rules: The rule of each table, by the table's name.
        fooling_threshold: The agent is fooled where Q <= this.
        fooling_set: The points that coverage is measured by, (R, d); None where none are known.
        ideal_set: Other points known to fool, (R, d), which ideal samples are drawn from.
    """

    track: str
    keywords: dict[str, str]
    agent: str
    seed: int
    runs: tuple[RunSettings, ...]
    rules: Mapping[str, str]
    fooling_threshold: float
    fooling_set: Mu | None = None
    ideal_set: Mu | None = None

    def identity(self, run: RunSettings) -> Identity:
        """Give the identity of the result that a run of this group belongs to."""
        return Identity.of(run, self.rules[run.table], self.fooling_threshold)


@dataclass(frozen=True)
class Plan:
    """All runs that a call of the benchmark does.

    Attributes:
        suite: The suite that was asked for.
        groups: Its runs.
        abouts: What each contender's entry says of it, by the contender's label.
        notes: What a reader must know, such as an adversary that was left out.
    """

    suite: Suite
    groups: tuple[Group, ...]
    abouts: Mapping[str, About]
    notes: tuple[str, ...]

    @property
    def runs(self) -> Iterator[RunSettings]:
        """List all runs."""
        return (run for group in self.groups for run in group.runs)


def make_plan(suite: Suite, references: Path = FOLDER) -> Plan:
    """Lay out all runs of a suite, and check everything that can be checked beforehand.

    Args:
        suite: The suite to lay out.
        references: The folder of the reference sets.

    Raises:
        TypeError, ValueError: If a track, an agent, a contender or a reference set does not fit.
    """
    contenders = tuple(c for c in suite.contenders if not c.missing)
    notes = [
        f"{c.label} is left out: it needs the package {c.requires}, which is not installed."
        for c in suite.contenders
        if c.missing
    ]
    for label, times in Counter(c.label for c in contenders).items():
        if times > 1:
            raise UserError(f"Expected distinct contenders, got {label!r} twice. Name it once.")
    abouts = {contender.label: about_of(contender) for contender in contenders}
    groups = []
    for track in suite.tracks:
        for target, keywords, tables in _targets(suite, track, references):
            to_cover, to_draw = target.split
            if to_cover is None:
                notes.append(_no_reference(target))
            # each is made once, so that what is wrong with one shows before anything runs
            solvers = [
                (
                    one,
                    make_adversary(
                        one.adversary,
                        target.dimension,
                        seed=0,
                        preset=one.preset,
                        options=one.options,
                        ideal_set=to_draw,
                    ),
                )
                for one in contenders
                if one.adversary != IDEAL or to_draw is not None
            ]
            for seed in suite.seeds_on(track):
                runs = tuple(
                    _settings(suite, table, target, contender, solver, seed)
                    for table in tables
                    for contender, solver in solvers
                    if table.includes(contender)
                )
                groups.append(
                    Group(
                        track,
                        keywords,
                        target.application.agent_name,
                        seed,
                        runs,
                        {table.name: table.rule for table in tables},
                        float(target.application.fooling_threshold),
                        to_cover,
                        to_draw,
                    )
                )
            target.application.close()
    if not any(group.runs for group in groups):
        raise UserError(" ".join(["Expected something to run, got nothing.", *notes]))
    # the longest first, and a whole seed before the next one
    ordered = sorted(groups, key=lambda group: (-len(group.runs), group.seed))
    plan = Plan(suite, tuple(ordered), abouts, tuple(notes))
    _refuse_misplaced(plan)
    return plan


def _refuse_misplaced(plan: Plan) -> None:
    """Refuse runs that no entry can hold, and two that would be the same seed of one result."""
    known: dict[tuple[str, str, int], RunSettings] = {}
    for group in plan.groups:
        for run in group.runs:
            try:
                # some file systems do not tell capitals from small letters
                stem = group.identity(run).stem.lower()
            except ValidationError as error:
                raise UserError(
                    f"Expected a run that an entry can describe, got {run} ({first_error(error)}). "
                    "Give the track, the agent and the rule shorter names."
                ) from error
            if len(stem) > _MAX_STEM:
                raise UserError(
                    f"Expected names of the track, the agent and the rule of at most {_MAX_STEM} "
                    f"characters in all, since files are called by them, got {len(stem)} ({run}). "
                    "Give them shorter names."
                )
            twin = known.setdefault((plan.abouts[run.label].name, stem, run.seed), run)
            if twin is not run:
                raise UserError(
                    f"Expected runs that have a place of their own in the entries, got {twin} and "
                    f"{run}, which would share one. Choose one of the tables (--table) or "
                    "adversaries (--adversary), or give them other labels or rules."
                )


def _targets(
    suite: Suite, track: str, references: Path
) -> Iterator[tuple[RunTarget, dict[str, str], tuple[Table, ...]]]:
    """Open each agent that is to be attacked on a track.

    Yields:
        The target, the environment's keywords that name its agent, and the tables it stands in.
    """
    first = make_application(track)
    default, shipped = first.agent_name, agents.names(first.name)
    chosen = dict[str, list[Table]]()
    for table in suite.tables:
        for agent in table.attacked(default, shipped):
            chosen.setdefault(agent, []).append(table)
    for agent, tables in chosen.items():
        keywords = {} if agent == default else {"agent": agent}
        application = make_application(track, **keywords) if keywords else first
        reference = load_reference(track, application, references)
        yield RunTarget(track, application, reference), keywords, tuple(tables)
    if default not in chosen:
        first.close()


def _settings(
    suite: Suite,
    table: Table,
    target: RunTarget,
    contender: Contender,
    solver: Adversary,
    seed: int,
) -> RunSettings:
    application = target.application
    rule = table.budget_of.get(application.name, table.budget)
    ideal = contender.adversary == IDEAL
    samples = table.samples or application.sample_size
    if target.split[0] is not None and samples <= NEAREST:
        raise UserError(
            f"Expected at least {NEAREST + 1} test samples on {target.track}, which has a "
            f"reference set to measure coverage by, got {samples} (table {table.name}). "
            "Raise the number of samples (--samples)."
        )
    return make_settings(
        target,
        contender.adversary,
        type(solver),
        preset=contender.preset,
        options=contender.options,
        budget=0 if ideal else rule.of(contender.adversary, solver),
        samples=samples,
        seed=seed,
        table=table.name,
        label=contender.label,
        images=0 if seed or ideal else suite.images,
    )


def _no_reference(target: RunTarget) -> str:
    name = target.application.agent_name
    agent = f" with the agent {name}" if name else ""
    what = "no reference set" if target.reference is None else "hardly any fooling reference point"
    return (
        f"{target.track}{agent} has {what}: the row ideal, coverage, density and relative "
        "novelty stay blank there."
    )
