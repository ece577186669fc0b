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
    """The rules that an adversary plays by.

    Attributes:
        rule: The name of the rule for the budget, see `board.benchmark.suite.Table`; empty for
            an attack of one's own.
        budget: The number of training queries that it may spend.
        samples: M, the number of test samples.
    """

    rule: str = ""
    budget: int = Field(ge=0)
    samples: int = Field(ge=1)


class Experiment(Strict):
    """All that decides a result: with another experiment, it is another result.

    The seed is that of the adversary and of all evaluation seeds; None stands for any seed.
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
        """Name the track, the agent and the rule: `TRACK.AGENT.RULE`, which any file system takes.

        An entry has one result in each such place.
        """
        return place_of(self.target.track, self.target.agent, self.protocol.rule)

    @property
    def group(self) -> str:
        """Name the application: an entry keeps all results on its tracks together."""
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
    """What a run does.

    Attributes:
        label: What reports call the adversary.
        images: The number of samples whose nearest queries are compared as images.
        packages: Versions of what takes part: a run is not resumed with others.
    """

    experiment: Experiment
    label: str
    images: int = 0
    packages: dict[str, str]

    @property
    def seed(self) -> int:
        """The seed of the adversary and of all evaluation seeds."""
        assert self.experiment.seed is not None
        return self.experiment.seed

    @property
    def key(self) -> RunKey:
        """The name of the run."""
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

    It holds no wall-clock times: a resumed run's file is the same.

    Attributes:
        nearest_fooling_query: Distances from the samples to the nearest training query that fooled
            the agent; None where none did.
        seeds: How the seeds follow from the settings' seed.
        flags: What a reader must know, such as that no training query fooled.
        invalid: The worlds that broke; None where there are none.
        uniform: The training queries that were uniform; None where there are none.
        in_use: How often the agent fails in ordinary use; None where no density is known, or no
            query tells.
        nominal: The world in ordinary use, and what makes the agent fail there; None where the
            application does not know that world.
        influences: How much of the failure probability's variance each parameter explains, by all
            queries and samples; none where there are too few worlds, failures or others.
        requirements: Which of several requirements failed; None where the score is a single one, no
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
        """Return the measures alone."""
        return Measures(**{name: getattr(self, name) for name in Measures.model_fields})


class RunFailure(Strict):
    """A run of a benchmark whose adversary could not do its work, and its `AdversaryError`."""

    settings: RunSettings
    error: str
