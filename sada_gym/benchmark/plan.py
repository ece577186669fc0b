"""The plan: every cell of a suite with all that decides its result, grouped by what they share."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from sada_gym import adversaries, agents
from sada_gym.application import Application
from sada_gym.benchmark.suite import IDEAL, Contender, Suite, Table
from sada_gym.errors import UserError
from sada_gym.evaluation.store import Context
from sada_gym.files import Strict
from sada_gym.measures.coverage import NEAREST
from sada_gym.measures.reference import FOLDER, Reference, load_reference
from sada_gym.registration import make_application
from sada_gym.runs.record import json_compatible, packages


class ReferenceMark(Strict):
    """The reference set that a cell was measured against.

    Attributes:
        sha256: Of its file.
        points: Its points, uniform in the box.
        fooling: How many of them belong to the fooling set.
        uniform_rate: Share of all their evaluations that fooled: the AFR of uniform samples.
    """

    sha256: str
    points: int
    fooling: int
    uniform_rate: float

    @property
    def usable(self) -> bool:
        """Whether half of the fooling set has enough points to measure coverage with."""
        return self.fooling // 2 > NEAREST


class CellKey(Strict):
    """What a cell is called: one contender, in one table, on one track, for one seed.

    Attributes:
        table: The table's name.
        track: The environment's id.
        agent: The agent's name.
        label: The contender's label.
        seed: The seed of the adversary and of all evaluation seeds.
    """

    table: str
    track: str
    agent: str
    label: str
    seed: int

    def __str__(self) -> str:
        """Name the cell for people."""
        agent = f" against {self.agent}" if self.agent else ""
        return f"{self.label} on {self.track}{agent}, seed {self.seed}, table {self.table}"


class CellSettings(CellKey):
    """All that decides a cell's result.

    Attributes:
        adversary: The contender's registered name, `module:Class`, or `ideal`.
        preset: The named set of options it starts from.
        options: Its other options.
        resolved: All its options, defaults too: a cell made with other defaults is another cell.
        budget: Training queries that it may spend.
        samples: Test samples.
        images: Samples whose neighbours are compared as images.
        application: The application's name.
        version: Its version.
        application_settings: Its resolved keywords.
        fingerprint: The agent's SHA-256.
        reference: The reference set; None where there is none.
        packages: Versions of what takes part.
    """

    adversary: str
    preset: str | None
    options: dict[str, Any]
    resolved: dict[str, Any]
    budget: int
    samples: int
    images: int
    application: str
    version: int
    application_settings: dict[str, Any]
    fingerprint: str
    reference: ReferenceMark | None
    packages: dict[str, str]

    @property
    def contender(self) -> Contender:
        """The contender."""
        return Contender(
            label=self.label, adversary=self.adversary, preset=self.preset, options=self.options
        )

    def target(self) -> dict[str, Any]:
        """What was attacked, and the reference set: the same for all cells of track and agent."""
        names = {"application", "version", "application_settings", "fingerprint", "reference"}
        return self.model_dump(include=names)


@dataclass(frozen=True)
class Group:
    """The cells of one track, agent and seed: they share evaluations, so one process does them.

    Attributes:
        track: The environment's id.
        keywords: The environment's keywords that name the agent; empty for the default agent.
        agent: The agent's name.
        seed: The seed.
        cells: In the order in which they are done.
    """

    track: str
    keywords: dict[str, str]
    agent: str
    seed: int
    cells: tuple[CellSettings, ...]


@dataclass(frozen=True)
class Plan:
    """What a call of the benchmark does.

    Attributes:
        suite: What was asked for.
        groups: Its cells.
        notes: What a reader must know, such as an adversary that was left out.
    """

    suite: Suite
    groups: tuple[Group, ...]
    notes: tuple[str, ...]

    @property
    def cells(self) -> Iterator[CellSettings]:
        """All cells."""
        return (cell for group in self.groups for cell in group.cells)


@dataclass(frozen=True)
class _Target:
    """One agent on one track, opened once to read off what the settings need."""

    track: str
    keywords: dict[str, str]
    application: Application
    context: Context
    reference: ReferenceMark | None
    packages: dict[str, str]


def make_plan(suite: Suite, references: Path = FOLDER) -> Plan:
    """Lay out all cells of a suite, and check everything that can be checked beforehand.

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
            dimension = len(target.application.parameters)
            for contender in contenders:
                if contender.adversary != IDEAL:
                    contender.make(dimension, seed=0)
            usable = target.reference is not None and target.reference.usable
            if not usable:
                notes.append(_no_reference(target))
            for seed in suite.seeds_on(track):
                cells = tuple(
                    _cell(suite, table, target, contender, seed)
                    for table in tables
                    for contender in contenders
                    if table.includes(contender) and (contender.adversary != IDEAL or usable)
                )
                name = target.application.agent_name
                groups.append(Group(track, target.keywords, name, seed, cells))
            target.application.close()
    if not any(group.cells for group in groups):
        raise UserError(" ".join(["Expected something to run, got nothing.", *notes]))
    # the longest first, and a whole seed before the next one
    ordered = sorted(groups, key=lambda group: (-len(group.cells), group.seed))
    return Plan(suite, tuple(ordered), tuple(notes))


def open_application(track: str, agent: str) -> Application:
    """Open a track with an agent that a plan's application named."""
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
    chosen, versions = dict[str, list[Table]](), packages()
    for table in suite.tables:
        for agent in suite.agents or table.attacked(default, shipped):
            chosen.setdefault(agent, []).append(table)
    for agent, tables in chosen.items():
        keywords = {} if agent == default else {"agent": agent}
        application = make_application(track, **keywords) if keywords else first
        reference = load_reference(track, application, references)
        mark = None if reference is None else _mark(reference)
        context = Context.of(application)
        yield _Target(track, keywords, application, context, mark, versions), tuple(tables)
    if default not in chosen:
        first.close()


def _mark(reference: Reference) -> ReferenceMark:
    entry = reference.entry
    return ReferenceMark(
        sha256=entry.sha256,
        points=entry.points,
        fooling=int(reference.fooling.sum()),
        uniform_rate=reference.uniform_rate,
    )


def _cell(
    suite: Suite, table: Table, target: _Target, contender: Contender, seed: int
) -> CellSettings:
    application, context = target.application, target.context
    rule = table.budget_of.get(application.name, table.budget)
    ideal = contender.adversary == IDEAL
    return CellSettings(
        table=table.name,
        track=target.track,
        agent=application.agent_name,
        label=contender.label,
        adversary=contender.adversary,
        preset=contender.preset,
        options=json_compatible(contender.options),
        resolved={} if ideal else _resolved(contender),
        budget=0 if ideal else rule.of(contender, len(application.parameters)),
        samples=table.samples or application.sample_size,
        seed=seed,
        images=0 if seed or ideal else suite.images,
        application=context.name,
        version=context.version,
        application_settings=json.loads(context.settings),
        fingerprint=context.fingerprint,
        reference=target.reference,
        packages=target.packages,
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
