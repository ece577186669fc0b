"""The plan: every run of a suite with all that decides its result, grouped by what they share."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from sada_gym import adversaries, agents
from sada_gym.adversaries.base import Adversary
from sada_gym.application import Application
from sada_gym.benchmark.suite import Contender, Suite, Table
from sada_gym.errors import UserError
from sada_gym.evaluation.store import Context
from sada_gym.measures.coverage import NEAREST
from sada_gym.measures.reference import FOLDER, Reference, load_reference
from sada_gym.parameters import Mu
from sada_gym.registration import make_application
from sada_gym.runs.ideal import IDEAL, Ideal
from sada_gym.runs.packages import in_order, packages
from sada_gym.runs.record import ReferenceSummary, RunSettings, json_compatible


@dataclass(frozen=True, eq=False)
class Group:
    """The runs of one track, agent and seed: they share a store, so one follows the other.

    Attributes:
        track: The environment's id.
        keywords: The environment's keywords that name the agent; empty for the default agent.
        agent: The agent's name.
        seed: The seed.
        runs: In the order in which they are done.
        fooling_set: (R, d) points known to fool, to measure by; None where none are known.
        ideal_set: (R, d) other such points, which ideal samples are drawn from.
    """

    track: str
    keywords: dict[str, str]
    agent: str
    seed: int
    runs: tuple[RunSettings, ...]
    fooling_set: Mu | None = None
    ideal_set: Mu | None = None


@dataclass(frozen=True)
class Plan:
    """What a call of the benchmark does.

    Attributes:
        suite: What was asked for.
        groups: Its runs.
        notes: What a reader must know, such as an adversary that was left out.
    """

    suite: Suite
    groups: tuple[Group, ...]
    notes: tuple[str, ...]

    @property
    def runs(self) -> Iterator[RunSettings]:
        """All runs."""
        return (run for group in self.groups for run in group.runs)

    @property
    def packages(self) -> dict[str, str]:
        """Versions of all that takes part in any run."""
        found: dict[str, str] = {}
        for run in self.runs:
            found |= run.packages
        return in_order(found)


@dataclass(frozen=True, eq=False)
class _Target:
    """One agent on one track, opened once to read off what the settings need."""

    track: str
    keywords: dict[str, str]
    application: Application
    context: Context
    reference: Reference | None

    @property
    def summary(self) -> ReferenceSummary | None:
        """What is recorded of the reference set."""
        return None if self.reference is None else ReferenceSummary.of(self.reference)

    def halves(self) -> tuple[Mu, Mu] | tuple[None, None]:
        """Points to measure by and points to draw from, where there are enough of them."""
        summary = self.summary
        if self.reference is None or summary is None or not summary.usable:
            return None, None
        return self.reference.halves()


def make_plan(suite: Suite, references: Path = FOLDER) -> Plan:
    """Lay out all runs of a suite, and check everything that can be checked beforehand.

    Args:
        suite: What to do.
        references: Where the reference sets lie.

    Raises:
        TypeError, ValueError: If a track, an agent, a contender or a reference set is bad.
    """
    contenders = tuple(c for c in suite.contenders if not c.missing)
    notes = [
        f"{c.label} is left out: it needs the package {c.requires}, which is not installed."
        for c in suite.contenders
        if c.missing
    ]
    _refuse_doubles([c.label for c in contenders])
    groups = []
    for track in suite.tracks:
        for target, tables in _targets(suite, track, references):
            made = _made(contenders, len(target.application.parameters))
            to_cover, to_draw = target.halves()
            if to_cover is None:
                notes.append(_no_reference(target))
            for seed in suite.seeds_on(track):
                runs = tuple(
                    _settings(suite, table, target, contender, kind, seed)
                    for table in tables
                    for contender, kind in made
                    if table.includes(contender)
                    and (contender.adversary != IDEAL or to_draw is not None)
                )
                name = target.application.agent_name
                group = Group(track, target.keywords, name, seed, runs, to_cover, to_draw)
                groups.append(group)
            target.application.close()
    if not any(group.runs for group in groups):
        raise UserError(" ".join(["Expected something to run, got nothing.", *notes]))
    # the longest first, and a whole seed before the next one
    ordered = sorted(groups, key=lambda group: (-len(group.runs), group.seed))
    return Plan(suite, tuple(ordered), tuple(notes))


def open_application(track: str, agent: str) -> Application:
    """Open a track with an agent that a result names."""
    application = make_application(track)
    if application.agent_name == agent:
        return application
    application.close()
    return make_application(track, agent=agent)


def _targets(
    suite: Suite, track: str, references: Path
) -> Iterator[tuple[_Target, tuple[Table, ...]]]:
    """Open each agent that is to be attacked on a track, with the tables it stands in."""
    first = make_application(track)
    default, shipped = first.agent_name, agents.names(first.name)
    chosen = dict[str, list[Table]]()
    for table in suite.tables:
        for agent in suite.agents or table.attacked(default, shipped):
            chosen.setdefault(agent, []).append(table)
    for agent, tables in chosen.items():
        keywords = {} if agent == default else {"agent": agent}
        application = make_application(track, **keywords) if keywords else first
        reference = load_reference(track, application, references)
        context = Context.of(application)
        yield _Target(track, keywords, application, context, reference), tuple(tables)
    if default not in chosen:
        first.close()


def _made(
    contenders: Sequence[Contender], dimension: int
) -> list[tuple[Contender, type[Adversary]]]:
    """Make each adversary once, so that what is wrong with one shows before anything runs."""
    return [
        (one, Ideal if one.adversary == IDEAL else type(one.make(dimension, seed=0)))
        for one in contenders
    ]


def _settings(
    suite: Suite,
    table: Table,
    target: _Target,
    contender: Contender,
    kind: type[Adversary],
    seed: int,
) -> RunSettings:
    application, context, summary = target.application, target.context, target.summary
    rule = table.budget_of.get(application.name, table.budget)
    ideal = contender.adversary == IDEAL
    samples = table.samples or application.sample_size
    if summary is not None and summary.usable and samples <= NEAREST:
        raise UserError(
            f"Expected at least {NEAREST + 1} test samples on {target.track}, which has a "
            f"reference set to measure coverage by, got {samples} (table {table.name}). "
            "Raise the number of samples (--samples)."
        )
    return RunSettings(
        table=table.name,
        track=target.track,
        agent=application.agent_name,
        label=contender.label,
        adversary=contender.adversary,
        preset=contender.preset,
        options=json_compatible(contender.options),
        resolved={} if ideal else _resolved(contender),
        budget=0 if ideal else rule.of(contender, len(application.parameters)),
        samples=samples,
        seed=seed,
        images=0 if seed or ideal else suite.images,
        application=context.name,
        version=context.version,
        application_settings=json.loads(context.settings),
        fingerprint=context.fingerprint,
        reference=summary,
        packages=packages(application, kind),
    )


def _resolved(contender: Contender) -> dict[str, Any]:
    preset = {} if contender.preset is None else {"preset": contender.preset}
    return json_compatible(adversaries.resolve(contender.adversary, preset | contender.options))


def _no_reference(target: _Target) -> str:
    agent = (
        f" with the agent {target.application.agent_name}" if target.application.agent_name else ""
    )
    what = "no reference set" if target.reference is None else "hardly any fooling reference point"
    return (
        f"{target.track}{agent} has {what}: the ideal row, coverage, density and novelty beside "
        "the ideal are blank there."
    )


def _refuse_doubles(labels: list[str]) -> None:
    for label in labels:
        if labels.count(label) > 1:
            raise UserError(f"Expected distinct contenders, got {label!r} twice. Name it once.")
