"""What a benchmark compares: adversaries, tables with their budgets, tracks and seeds."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import Any, Literal

from pydantic import Field

from sada_gym import adversaries, agents
from sada_gym.adversaries.base import Adversary
from sada_gym.board.results.models import MAX_SEEDS
from sada_gym.board.results.paper import CLASS_COLUMNS, ROWS, TABLE_1_COLUMNS
from sada_gym.errors import UserError, check_integer, check_known
from sada_gym.evaluation.oracle import MAX_QUERIES
from sada_gym.experiment.adversary import AdversarySpec
from sada_gym.experiment.ideal import IDEAL
from sada_gym.experiment.record import Experiment, Protocol
from sada_gym.experiment.target import OpenTarget
from sada_gym.foundations.cards import ApplicationCard, SuiteCard, cards
from sada_gym.foundations.files import Strict
from sada_gym.foundations.ids import names_file


class Budget(Strict):
    """How many training queries an adversary may spend.

    Attributes:
        queries: The number N of queries.
        of_adversary: Another number for some adversaries, by name.
        boosting_on_top: Whether boosting may query its samples beyond N, as in the paper.
    """

    queries: int = Field(ge=1)
    of_adversary: dict[str, int] = Field(default_factory=dict)
    boosting_on_top: bool = False

    def of(self, name: str, adversary: Adversary | None) -> int:
        """Return an adversary's number of queries. Pass None for one that is not shipped."""
        if name == IDEAL:
            return 0
        if adversary is None:
            return self.queries
        queries = self.of_adversary.get(name, self.queries)
        return queries + adversary.extra_queries(queries) * self.boosting_on_top


class Table(Strict):
    """One comparison: every adversary on every track under one rule for the budget.

    Attributes:
        name: The table's name on the command line, and the name of the rule in results.
        note: A sentence that says what the table compares.
        budget_of: Another budget for some applications, by name.
        samples: M, the number of test samples; None takes each application's own.
        agents: The agents to attack: `default` (only that one), `all` shipped ones, the `others`
            (all except the default), or their names.
        adversaries: The labels of the adversaries that take part; None for all of the suite's.
    """

    name: str
    title: str
    note: str
    budget: Budget
    budget_of: dict[str, Budget] = Field(default_factory=dict)
    samples: int | None = Field(default=None, ge=1)
    agents: Literal["default", "all", "others"] | tuple[str, ...] = "default"
    adversaries: tuple[str, ...] | None = None

    def attacked(self, default: str, shipped: Sequence[str]) -> list[str]:
        """Return which of an application's shipped agents to attack."""
        others = [agent for agent in shipped if agent != default]
        named = {"default": [default], "all": [default, *others], "others": others}
        return list(self.agents) if isinstance(self.agents, tuple) else named[self.agents]

    def shows(self, experiment: Experiment) -> bool:
        """Return whether this table shows the results of an experiment."""
        target = experiment.target
        if experiment.protocol.rule != self.name:
            return False
        if isinstance(self.agents, tuple):
            return target.agent in self.agents
        default = is_default(target.application.name, target.agent)
        return self.agents == "all" or default == (self.agents == "default")

    def includes(self, label: str) -> bool:
        """Return whether an adversary of the suite takes part, by its label."""
        return self.adversaries is None or label in self.adversaries

    def protocol(
        self, target: OpenTarget, adversary: AdversarySpec, solver: Adversary | None
    ) -> Protocol:
        """Return the rules for an adversary. `solver` is the adversary itself if it is shipped."""
        budget = self.budget_of.get(target.target.application.name, self.budget)
        return Protocol(
            rule=self.name,
            budget=budget.of(adversary.name, solver),
            samples=self.samples or target.sample_size,
        )


class BenchmarkSuite(Strict):
    """Everything that one benchmark runs.

    Attributes:
        adversaries: The rows of the tables: the adversaries by label; by default all shipped ones.
        seeds: The number of seeds on each track, unless `seeds_of` has another one.
        images: The number of samples that are also compared as images with the nearest queries, on
            the first seed; 0 for none.
    """

    name: str
    tracks: tuple[str, ...]
    tables: tuple[Table, ...]
    adversaries: dict[str, AdversarySpec] = Field(default_factory=lambda: dict(ADVERSARIES))
    seeds: int = Field(default=1, ge=1)
    seeds_of: dict[str, int] = Field(default_factory=dict)
    images: int = Field(default=4, ge=0)

    def seeds_on(self, track: str) -> range:
        """Return the seeds of a track."""
        return range(self.seeds_of.get(track, self.seeds))


def _specs(*adversaries: str | tuple[str, str]) -> dict[str, AdversarySpec]:
    pairs = [(given, None) if isinstance(given, str) else given for given in adversaries]
    specs = [AdversarySpec(name=name, preset=preset) for name, preset in pairs]
    return {spec.label: spec for spec in specs}


ADVERSARIES: Mapping[str, AdversarySpec] = _specs(
    *(IDEAL, "random", "memorise", "svm", "gp", "gaussian", "gmm10", "gmm50", "bayesian"),
    *(("bbgan", "paper"), ("bbgan-boost", "paper"), "bbgan", "bbgan-boost"),
    *("cross-entropy", "smc", "cma-mae", "trees", "level-set", "reinforce", "ppo", "sac", "td3"),
)
"""All rows by label: controls, the paper's baselines in its order, BBGAN, later methods, RL."""

_PAPER_ROWS = {label: ADVERSARIES[label] for label in ADVERSARIES if label in {IDEAL, *ROWS}}
"""The rows that the paper's tables have, and the ideal."""

CONTROLS = frozenset({IDEAL, "memorise"})
"""The adversaries that have no rank, by name."""

_PAPER_BUDGETS = Table(
    name="paper-budgets",
    title="The paper's budgets",
    note="As in the paper: N queries for each adversary; the samples that boosting adds are extra.",
    budget=Budget(queries=1_000, boosting_on_top=True),
    budget_of={
        "SADA-Detection": Budget(
            queries=20_000, of_adversary={"bayesian": 10_000}, boosting_on_top=True
        )
    },
)
_EQUAL_QUERIES = Table(
    name="equal-queries",
    title="Equal queries",
    note="The same number of queries for every adversary, boosting and Bayesian included.",
    budget=Budget(queries=2_000),
)
_OTHER_AGENTS = Table(
    name="other-agents",
    title="Other agents",
    note="One or two adversaries of each kind against all agents but the default. Every adversary "
    "gets 1,000 queries, and 2,000 on detection.",
    budget=Budget(queries=1_000),
    budget_of={"SADA-Detection": Budget(queries=2_000)},
    agents="others",
    adversaries=(
        *(IDEAL, "random", "gp", "gmm50", "bbgan", "bbgan-boost", "smc"),
        *("trees", "level-set", "sac"),
    ),
)
_TABLES = {table.name: table for table in (_PAPER_BUDGETS, _EQUAL_QUERIES, _OTHER_AGENTS)}
TABLES = {
    name: table.model_copy(update={"agents": "all"}) if table.agents == "default" else table
    for name, table in _TABLES.items()
}
"""All tables of the suites, by name, with results against all agents."""


def default_agent(application: str) -> str:
    """Return the first shipped agent of an application, or an empty text if it has none."""
    return next(iter(agents.names(application)), "")


def is_default(application: str, agent: str) -> bool:
    """Say whether an agent is the default one; where none is shipped, every agent is."""
    return default_agent(application) in ("", agent)


def _suite_of(card: ApplicationCard, suite: SuiteCard) -> BenchmarkSuite:
    return BenchmarkSuite(
        name=suite.name,
        tracks=tuple(map(card.track_id, suite.tracks)) or card.board_tracks,
        tables=tuple(_TABLES[name] for name in suite.tables),
        seeds=suite.seeds,
        seeds_of={card.track_id(suffix): seeds for suffix, seeds in suite.seeds_of.items()},
        images=suite.images,
        adversaries={label: ADVERSARIES[label] for label in suite.adversaries or ADVERSARIES},
    )


_TABLE_1 = tuple(track for track in TABLE_1_COLUMNS.values() if track is not None)

SUITES: tuple[BenchmarkSuite, ...] = (
    *(_suite_of(card, card.suite) for card in cards() if card.suite is not None),
    BenchmarkSuite(
        name="quick",
        tracks=tuple(track for track in CLASS_COLUMNS.values() if track in _TABLE_1),
        tables=(_EQUAL_QUERIES,),
    ),
    BenchmarkSuite(
        name="table-1",
        tracks=tuple(dict.fromkeys((*CLASS_COLUMNS.values(), *_TABLE_1))),
        tables=(_PAPER_BUDGETS,),
        adversaries=_PAPER_ROWS,
    ),
    BenchmarkSuite(name="table-1-columns", tracks=_TABLE_1, tables=(_PAPER_BUDGETS,)),
    BenchmarkSuite(
        name="agents",
        tracks=tuple(
            track
            for card in cards()
            if card.suite is not None and len(card.agents) > 1
            for track in card.track_ids
        ),
        tables=(_OTHER_AGENTS,),
        images=0,
    ),
)
"""All suites: one for each application, and some that span several applications.

`table-1` has the paper's rows in all columns. `table-1-columns` has all rows, but only in the
columns that are single tracks, because 20,000 queries on each track of detection take long.
"""


def find_suite(name: str) -> BenchmarkSuite:
    """Return a suite by its name; raises a ValueError for an unknown name."""
    check_known("suite", [name], [suite.name for suite in SUITES])
    return next(suite for suite in SUITES if suite.name == name)


def tables_of(rules: Collection[str]) -> tuple[Table, ...]:
    """Return the tables of some rules for the budget; for an unknown rule, one without a note."""
    ours = [table for name, table in TABLES.items() if name in rules]
    plain = [
        Table(name=rule, title=rule, note="", budget=Budget(queries=1), agents="all")
        for rule in sorted(set(rules) - set(TABLES))
    ]
    return (*ours, *plain)


def find_adversary(text: str) -> tuple[str, AdversarySpec]:
    """Return the label and the adversary for a label, name, `name:preset` or `module:Class`.

    Raises a ValueError for an unknown name. Only `AdversarySpec.make` checks presets and classes.
    """
    if text in ADVERSARIES:
        return text, ADVERSARIES[text]
    name, colon, preset = text.partition(":")
    if not colon:
        check_known("adversary", [text], [*ADVERSARIES, "module:Class"])
    if name not in adversaries.names():
        return text, AdversarySpec(name=text)
    spec = AdversarySpec(name=name, preset=None if preset == "default" else preset)
    return spec.label, spec


_RANGES = {
    "seeds": (1, MAX_SEEDS),
    "budget": (1, MAX_QUERIES),
    "samples": (1, MAX_QUERIES),
    "images": (0, None),
}


def choose(
    suite: BenchmarkSuite,
    *,
    tracks: Sequence[str] = (),
    tables: Sequence[str] = (),
    chosen: Sequence[str] = (),
    agents: Sequence[str] = (),
    seeds: int | None = None,
    budget: int | None = None,
    samples: int | None = None,
    images: int | None = None,
) -> BenchmarkSuite:
    """Return a suite with some parts chosen or changed; what is not given stays.

    `chosen` are adversaries, as texts for `find_adversary`. The agents, seeds, budget and samples
    apply to every table and track. Where boosting may exceed the budget, it still may.

    Raises:
        ValueError: If a table or an adversary is unknown, a track is a file, or a number is out of
            range.
    """
    numbers = {"seeds": seeds, "budget": budget, "samples": samples, "images": images}
    for name, value in numbers.items():
        if value is not None:
            check_integer(name, value, *_RANGES[name])
    for file in filter(names_file, tracks):
        raise UserError(
            f"Expected tracks that are ids of environments, got the file {file}. Attack it by "
            "sada-gym attack."
        )
    check_known("table", tables, [table.name for table in suite.tables])
    of_tables: dict[str, Any] = {}
    if samples is not None:
        of_tables["samples"] = samples
    if agents:
        of_tables["agents"] = tuple(dict.fromkeys(agents))

    def changed(table: Table) -> Table:
        if budget is None:
            return table.model_copy(update=of_tables)
        rule = Budget(queries=budget, boosting_on_top=table.budget.boosting_on_top)
        return table.model_copy(update={**of_tables, "budget": rule, "budget_of": {}})

    kept = [table for table in suite.tables if not tables or table.name in tables]
    changes: dict[str, Any] = {"tables": tuple(map(changed, kept))}
    if tracks:
        changes["tracks"] = tuple(dict.fromkeys(tracks))
    if chosen:
        changes["adversaries"] = _find_adversaries(chosen)
    if seeds is not None:
        changes |= {"seeds": seeds, "seeds_of": {}}
    if images is not None:
        changes["images"] = images
    return suite.model_copy(update=changes)


def _find_adversaries(texts: Sequence[str]) -> dict[str, AdversarySpec]:
    specs: dict[str, AdversarySpec] = {}
    for label, spec in map(find_adversary, dict.fromkeys(texts)):
        if label in specs:
            raise UserError(f"Expected distinct adversaries, got {label!r} twice. Name it once.")
        specs[label] = spec
    return specs
