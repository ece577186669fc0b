"""What a benchmark compares: contenders, tables with their budgets, tracks and seeds."""

from __future__ import annotations

import importlib.util
from collections.abc import Collection, Sequence
from typing import Any, Literal

from pydantic import Field

from sada_gym import adversaries, agents
from sada_gym.adversaries.base import Adversary
from sada_gym.cards import ApplicationCard, SuiteCard, cards
from sada_gym.errors import UserError, check_integer, check_known
from sada_gym.evaluation.oracle import MAX_QUERIES
from sada_gym.experiment.ideal import IDEAL
from sada_gym.files import Strict
from sada_gym.ids import names_file
from sada_gym.results.paper import CLASS_COLUMNS, ROWS, TABLE_1_COLUMNS
from sada_gym.submission.models import MAX_SEEDS


class Contender(Strict):
    """An adversary with its options, as a row of the tables.

    Attributes:
        label: The row's name.
        adversary: A registered name, `module:Class`, or `ideal`.
        preset: The named set of options it starts from.
        options: Its other options.
        ranked: Whether it takes part in the ranking; controls do not.
        requires: A package that it needs; the benchmark leaves it out where that is missing.
    """

    label: str
    adversary: str
    preset: str | None = None
    options: dict[str, Any] = Field(default_factory=dict)
    ranked: bool = True
    requires: str | None = None

    @property
    def missing(self) -> bool:
        """Say whether the package that it requires is not installed."""
        return self.requires is not None and importlib.util.find_spec(self.requires) is None


class Budget(Strict):
    """How many training queries a contender may spend.

    Attributes:
        queries: N, the number of queries.
        of_adversary: Another number for some adversaries, by registered name.
        boosting_on_top: Whether boosting's samples come on top of N, as in the paper, or out of it.
    """

    queries: int = Field(ge=1)
    of_adversary: dict[str, int] = Field(default_factory=dict)
    boosting_on_top: bool = False

    def of(self, name: str, adversary: Adversary) -> int:
        """Say how many queries one adversary may spend.

        Args:
            name: Its registered name.
            adversary: The adversary, which knows how many queries its boosting adds.
        """
        queries = self.of_adversary.get(name, self.queries)
        return queries + adversary.extra_queries(queries) * self.boosting_on_top


class Table(Strict):
    """One comparison: every contender on every track under one rule for the budget.

    Attributes:
        name: The table's name on the command line.
        title: The table's title in the report.
        note: What the table compares, in a sentence.
        budget: The rule for the budget.
        budget_of: Another rule for some applications, by name.
        samples: M, the number of test samples; None takes each application's own.
        agents: Whether to attack the default agent alone, all that are shipped, or the others; or
            the names of those to attack.
        contenders: The labels of the contenders that take part; None for all of the suite's.
        rule: The name of the rule for the budget, which results carry; by default the table's name.
            Tables that attack different agents may share a rule.
    """

    name: str
    title: str
    note: str
    budget: Budget
    budget_of: dict[str, Budget] = Field(default_factory=dict)
    samples: int | None = Field(default=None, ge=1)
    agents: Literal["default", "all", "others"] | tuple[str, ...] = "default"
    contenders: tuple[str, ...] | None = None
    rule: str = Field(default_factory=lambda data: data.get("name", ""))

    def attacked(self, default: str, shipped: Sequence[str]) -> list[str]:
        """Choose the agents to attack from those that an application ships."""
        others = [agent for agent in shipped if agent != default]
        if isinstance(self.agents, tuple):
            return list(self.agents)
        if self.agents == "others":
            return others
        return [default, *others] if self.agents == "all" else [default]

    def shows(self, rule: str, application: str, agent: str) -> bool:
        """Say whether this table shows results.

        Args:
            rule: The rule by which they were made.
            application: The application's name.
            agent: The name of the agent that was attacked.
        """
        if rule != self.rule:
            return False
        if isinstance(self.agents, tuple):
            return agent in self.agents
        return self.agents == "all" or is_default(application, agent) == (self.agents == "default")

    def includes(self, contender: Contender) -> bool:
        """Say whether a contender of the suite takes part."""
        return self.contenders is None or contender.label in self.contenders


class Suite(Strict):
    """Everything that one benchmark runs.

    Attributes:
        name: The suite's name on the command line.
        tracks: The ids of the environments.
        tables: The comparisons.
        contenders: The rows of the tables.
        seeds: The number of seeds on each track.
        seeds_of: Another number for some tracks.
        images: The number of samples whose neighbours are compared as images too, on the first
            seed; 0 for none.
    """

    name: str
    tracks: tuple[str, ...]
    tables: tuple[Table, ...]
    contenders: tuple[Contender, ...]
    seeds: int = Field(default=1, ge=1)
    seeds_of: dict[str, int] = Field(default_factory=dict)
    images: int = Field(default=4, ge=0)

    def seeds_on(self, track: str) -> range:
        """List the seeds of a track."""
        return range(self.seeds_of.get(track, self.seeds))


def _by_name(*names: str) -> list[Contender]:
    """Give contenders that are called as their adversaries are."""
    return [Contender(label=name, adversary=name) for name in names]


CONTENDERS: tuple[Contender, ...] = (
    Contender(label=IDEAL, adversary=IDEAL, ranked=False),
    Contender(label="random", adversary="random"),
    Contender(label="archive", adversary="archive", ranked=False),
    *_by_name("svm", "gp", "gaussian", "gmm10", "gmm50", "bayesian"),
    Contender(label="bbgan (paper)", adversary="bbgan", preset="paper"),
    Contender(label="bbgan-boost (paper)", adversary="bbgan-boost", preset="paper"),
    *_by_name("bbgan", "bbgan-boost", "cross-entropy", "smc"),
    Contender(label="cma-mae", adversary="cma-mae", requires="ribs"),
    *_by_name("trees", "level-set", "reinforce", "ppo", "sac", "td3"),
)
"""All rows: controls, the paper's baselines in its order, BBGAN, later methods, RL."""

_PAPER_ROWS = tuple(c for c in CONTENDERS if c.label in {IDEAL, *ROWS})
"""The rows that the paper's tables have, and the ideal."""

CONTROLS = frozenset(contender.adversary for contender in CONTENDERS if not contender.ranked)
"""The adversaries that have no rank, by name."""

_PAPER_BUDGETS = Table(
    name="paper-budgets",
    title="The paper's budgets",
    note="As in the paper: N queries for every adversary, another number for the Bayesian one; "
    "boosting's samples come on top of N.",
    budget=Budget(queries=1_000, boosting_on_top=True),
    budget_of={
        "SADA-Detection": Budget(
            queries=20_000, of_adversary={"bayesian": 10_000}, boosting_on_top=True
        )
    },
    agents="all",
)
_EQUAL_QUERIES = Table(
    name="equal-queries",
    title="Equal queries",
    note="The same number of queries for every adversary, boosting and Bayesian included.",
    budget=Budget(queries=2_000),
    agents="all",
)
_OTHER_AGENTS = Table(
    name="other-agents",
    title="Other agents",
    note="One or two adversaries of each kind against all agents but the default. Every adversary "
    "gets 1,000 queries, and 2,000 on detection.",
    budget=Budget(queries=1_000),
    budget_of={"SADA-Detection": Budget(queries=2_000)},
    agents="others",
    contenders=(
        *(IDEAL, "random", "gp", "gmm50", "bbgan", "bbgan-boost", "smc"),
        *("trees", "level-set", "sac"),
    ),
)
TABLES = {table.name: table for table in (_PAPER_BUDGETS, _EQUAL_QUERIES, _OTHER_AGENTS)}
"""All tables of the suites, by name."""


def is_default(application: str, agent: str) -> bool:
    """Say whether an agent is the default one; where none is shipped, every agent is."""
    shipped = agents.names(application)
    return not shipped or agent == shipped[0]


def _against_the_default(table: Table) -> Table:
    """Give a table that attacks the default agent alone."""
    return table.model_copy(update={"agents": "default"})


def _suite_of(card: ApplicationCard, suite: SuiteCard) -> Suite:
    """Make the suite of an application's tracks, as its card declares it."""
    return Suite(
        name=suite.name,
        tracks=card.track_ids,
        tables=tuple(_against_the_default(TABLES[name]) for name in suite.tables),
        contenders=CONTENDERS,
        seeds=suite.seeds,
        seeds_of={card.track_id(suffix): seeds for suffix, seeds in suite.seeds_of.items()},
        images=suite.images,
    )


_TABLE_1 = tuple(track for track in TABLE_1_COLUMNS.values() if track is not None)

SUITES: tuple[Suite, ...] = (
    *(_suite_of(card, card.suite) for card in cards() if card.suite is not None),
    Suite(
        name="quick",
        tracks=tuple(track for track in CLASS_COLUMNS.values() if track in _TABLE_1),
        tables=(_against_the_default(_EQUAL_QUERIES),),
        contenders=CONTENDERS,
    ),
    Suite(
        name="table-1",
        tracks=tuple(dict.fromkeys((*CLASS_COLUMNS.values(), *_TABLE_1))),
        tables=(_against_the_default(_PAPER_BUDGETS),),
        contenders=_PAPER_ROWS,
    ),
    Suite(
        name="table-1-columns",
        tracks=_TABLE_1,
        tables=(_against_the_default(_PAPER_BUDGETS),),
        contenders=CONTENDERS,
    ),
    Suite(
        name="agents",
        tracks=tuple(
            track
            for card in cards()
            if card.suite is not None and len(card.agents) > 1
            for track in card.track_ids
        ),
        tables=(_OTHER_AGENTS,),
        contenders=CONTENDERS,
        images=0,
    ),
)
"""All suites: one for each application, and some that span several applications.

`table-1` has the paper's rows in all columns. `table-1-columns` has all rows, but only in the
columns that are single tracks, because 20,000 queries on each track of detection take long.
"""


def find_suite(name: str) -> Suite:
    """Find a suite by its name.

    Raises:
        ValueError: If there is none of that name.
    """
    check_known("suite", [name], [suite.name for suite in SUITES])
    return next(suite for suite in SUITES if suite.name == name)


def tables_of(rules: Collection[str]) -> tuple[Table, ...]:
    """Give the tables that show results made by some rules: ours, and a plain one for any other."""
    ours = [table for table in TABLES.values() if table.rule in rules]
    unknown = sorted(set(rules) - {table.rule for table in ours})
    plain = [
        Table(name=rule, title=rule, note="", budget=Budget(queries=1), agents="all")
        for rule in unknown
    ]
    return (*ours, *plain)


def find_contender(text: str) -> Contender:
    """Find a contender by its label, its registered name, `name:preset`, or `module:Class`.

    Raises:
        ValueError: If nothing is known by that name. A preset or class is only checked by `make`.
    """
    known = {contender.label: contender for contender in CONTENDERS}
    if text in known:
        return known[text]
    name, colon, rest = text.partition(":")
    if not colon:
        check_known("adversary", [text], [*known, "module:Class"])
    if name not in adversaries.names():
        return Contender(label=text, adversary=text)
    if rest == "default":
        return find_contender(name)
    label = f"{name} ({rest})"
    return known.get(label) or Contender(label=label, adversary=name, preset=rest)


def choose(
    suite: Suite,
    *,
    tracks: Sequence[str] = (),
    tables: Sequence[str] = (),
    contenders: Sequence[str] = (),
    agents: Sequence[str] = (),
    seeds: int | None = None,
    budget: int | None = None,
    samples: int | None = None,
    images: int | None = None,
) -> Suite:
    """Narrow or change a suite as the command line does; what is not given stays.

    Args:
        suite: The suite to start from.
        tracks: Ids of environments.
        tables: Names of the suite's tables.
        contenders: What `find_contender` takes.
        agents: The agents that every table attacks.
        seeds: The number of seeds on every track.
        budget: N of every table and adversary; where boosting comes on top it still does.
        samples: The number of test samples.
        images: The number of samples whose neighbours are compared as images.

    Raises:
        ValueError: If a table or a contender is unknown, a track is a file, or a number is out of
            range.
    """
    for name, value, most in (
        ("seeds", seeds, MAX_SEEDS),
        ("budget", budget, MAX_QUERIES),
        ("samples", samples, MAX_QUERIES),
    ):
        if value is not None:
            check_integer(name, value, 1, most)
    if images is not None:
        check_integer("images", images, 0)
    files = [*filter(names_file, tracks)]
    if files:
        raise UserError(
            f"Expected tracks that are ids of environments, got the file {files[0]}. Attack it by "
            "sada-gym attack."
        )
    check_known("table", tables, [table.name for table in suite.tables])
    changes: dict[str, Any] = {
        "tracks": tuple(dict.fromkeys(tracks)) or suite.tracks,
        "tables": tuple(
            _changed(table, tuple(dict.fromkeys(agents)), budget, samples)
            for table in suite.tables
            if not tables or table.name in tables
        ),
    }
    if contenders:
        changes["contenders"] = tuple(map(find_contender, dict.fromkeys(contenders)))
    if seeds is not None:
        changes |= {"seeds": seeds, "seeds_of": {}}
    if images is not None:
        changes["images"] = images
    return suite.model_copy(update=changes)


def _changed(
    table: Table, agents: tuple[str, ...], budget: int | None, samples: int | None
) -> Table:
    changes: dict[str, Any] = {} if samples is None else {"samples": samples}
    if agents:
        changes["agents"] = agents
    if budget is not None:
        rule = Budget(queries=budget, boosting_on_top=table.budget.boosting_on_top)
        changes |= {"budget": rule, "budget_of": {}}
    return table.model_copy(update=changes)
