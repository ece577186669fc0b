"""The record of an experiment, which travels through runs, entries, plans and reports."""

from __future__ import annotations

import hashlib
import json
import re
from typing import Any

from pydantic import Field
from typing_extensions import Self

from sada_gym.experiment.adversary import AdversarySpec
from sada_gym.experiment.invalid import InvalidWorlds
from sada_gym.experiment.measure import Distances, Measures, Search
from sada_gym.experiment.nominal import NominalWorld
from sada_gym.experiment.target import Target
from sada_gym.foundations.files import OneLine, Strict
from sada_gym.measures.sensitivity import Influence


class Protocol(Strict):
    """How many queries and samples an adversary gets.

    Attributes:
        rule: The benchmark's name of the rule for the budget, such as `paper-budgets`; empty for
            a single attack.
        budget: The number of training queries that the adversary may spend.
        samples: M, the number of test samples.
    """

    rule: str = ""
    budget: int = Field(ge=0)
    samples: int = Field(ge=1)


class Experiment(Strict):
    """Everything that decides a result: the target, the adversary, the protocol and the seed.

    `seed` fixes the adversary's random draws and all evaluation seeds; None stands for any seed.
    """

    target: Target
    adversary: AdversarySpec
    protocol: Protocol
    seed: int | None = None

    def at(self, seed: int | None) -> Self:
        """Return the same experiment with another seed."""
        return self.model_copy(update={"seed": seed})

    @property
    def sha256(self) -> str:
        """The SHA-256 of the record as canonical JSON."""
        text = json.dumps(self.model_dump(mode="json"), sort_keys=True, separators=(",", ":"))
        return hashlib.sha256(text.encode()).hexdigest()

    @property
    def place(self) -> str:
        """`TRACK.AGENT.RULE`, the name of its result in an entry; it is valid as a file name."""
        return place_of(self.target.track, self.target.agent, self.protocol.rule)

    @property
    def group(self) -> str:
        """The application's name; an entry keeps all results on its tracks in one file."""
        return slug(self.target.application.name)


def slug(text: str) -> str:
    """Make a name that any file system takes."""
    return re.sub(r"[^A-Za-z0-9._+]+", "-", text).strip("-")


def place_of(track: str, agent: str, rule: str) -> str:
    """Name a track, an agent and a rule as one, see `Experiment.place`."""
    return ".".join(slug(part) for part in (track, agent, rule) if part)


class RunKey(Strict):
    """The name of a run: one adversary, by its label, on one track, for one seed.

    Attributes:
        table: The benchmark's table; empty for a single attack.
        agent: What the agent under test is called; empty where there is none.
    """

    table: str = ""
    track: str
    agent: str
    label: str
    seed: int

    def __str__(self) -> str:
        """Name the run for people."""
        agent = f" against {self.agent}" if self.agent else ""
        table = f", table {self.table}" if self.table else ""
        return f"{self.label} on {self.track}{agent}, seed {self.seed}{table}"


class RunSettings(Strict):
    """The settings of a run: its experiment, and what else reports and resumed runs need.

    Attributes:
        label: The adversary's name in reports.
        images: The number of samples whose images are compared with those of the nearest queries.
        packages: Versions of the packages in use. A run cannot be resumed with other versions.
    """

    experiment: Experiment
    label: str
    images: int = 0
    packages: dict[str, str]

    @property
    def seed(self) -> int:
        """The seed of the experiment, which is never None here."""
        assert self.experiment.seed is not None
        return self.experiment.seed

    @property
    def key(self) -> RunKey:
        """The table, track, agent, label and seed, which together name the run."""
        target = self.experiment.target
        return RunKey(
            table=self.experiment.protocol.rule,
            track=target.track,
            agent=target.agent,
            label=self.label,
            seed=self.seed,
        )

    def __str__(self) -> str:
        """Name the run for people."""
        return str(self.key)


class UniformQueries(Strict):
    """The training queries that were uniform in the box, in valid worlds.

    Attributes:
        fooled: How many of them fooled the agent.
    """

    worlds: int
    fooled: int


class FailureProbability(Strict):
    """How often the agent fails in ordinary use, by uniform worlds.

    These are training queries, and of `random` the test samples; after `estimate` its fresh draws.

    Attributes:
        density: The densities of parameters by name, see `sada_gym.densities`; worlds outside their
            ranges are left out.
        held: The share of the density that lies in the ranges.
        worlds: The number of uniform worlds that are valid.
        worth: How many draws from the density these are worth.
    """

    probability: float
    interval_95: tuple[float, float]
    density: dict[str, dict[str, Any]]
    held: float
    worlds: int
    worth: float


class BrokenRequirements(Strict):
    """Which of several requirements failing samples broke; of many, the first ones.

    Attributes:
        worlds: The number of these samples.
        each: How many of them broke each requirement.
        together: How many broke exactly these and no others, such as `up and calm`, the most
            frequent first. Over several episodes the mean margins count, which may all hold.
    """

    worlds: int
    each: dict[OneLine, int]
    together: dict[OneLine, int]


class RunReport(Measures):
    """The contents of result.json: the measures of a run, and its settings.

    It holds no wall-clock times, so that a resumed run writes the same file.

    Attributes:
        nearest_fooling_query: Distances from the samples to the nearest training query that fooled
            the agent; None if none did.
        search: What the training queries found.
        seeds: How the seeds follow from the seed of the settings.
        flags: Warnings, such as that no training query fooled.
        invalid: The invalid worlds; None if there are none.
        uniform: The training queries that were uniform; None if there are none.
        in_use: How often the agent fails in ordinary use; None without a density or uniform worlds.
        nominal: The nominal world, and what makes the agent fail near it; None if the application
            declares no nominal world.
        influences: How much of the failure probability's variance each parameter explains, over all
            queries and samples; empty if there are too few worlds, failures or passes.
        requirements: Which of several requirements failed; None if the score is a single one, no
            sample fooled, or scores do not repeat.
    """

    settings: RunSettings
    nearest_fooling_query: Distances | None
    search: Search
    seeds: dict[str, str | int]
    flags: tuple[OneLine, ...]
    invalid: InvalidWorlds | None = None
    uniform: UniformQueries | None = None
    in_use: FailureProbability | None = None
    nominal: NominalWorld | None = None
    influences: tuple[Influence, ...] = ()
    requirements: BrokenRequirements | None = None
    where: Any = Field(None, exclude=True)  # of files before the diagnosis alone said it

    def measures(self) -> Measures:
        """Return only the measures, without settings and search."""
        return Measures(**{name: getattr(self, name) for name in Measures.model_fields})


class RunFailure(Strict):
    """A run of a benchmark that ended with an `AdversaryError`, and the error's message."""

    settings: RunSettings
    error: str
