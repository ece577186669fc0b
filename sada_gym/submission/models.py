"""What an entry of the leaderboard says: who made it, its claims, and what the verifier found."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Iterable, Mapping
from types import MappingProxyType
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, Field
from typing_extensions import Self

from sada_gym.experiment.measure import Measures, Search
from sada_gym.experiment.record import ReferenceSummary, RunFailure, RunReport, RunSettings
from sada_gym.files import OneLine, Strict
from sada_gym.submission.samples import Samples, samples_sha256

FORMAT = 1
"""The version of an entry's files. Raise it when they change."""

MAX_SEEDS = 100
"""The most seeds of a result."""

MAX_ERROR = 2_000
"""The most characters of a seed's error."""

DISQUALIFYING = frozenset({"claim", "constant", "copied"})
"""The verifier's flags that take a result's rank: its figures do not say what they seem to say."""

Tier = Literal["claimed", "verified"]
"""How far a result was checked. Another tier will hold results whose queries a judge counted."""


def slug(text: str) -> str:
    """Make a name that any file system takes."""
    return re.sub(r"[^A-Za-z0-9._+]+", "-", text).strip("-")


def entry_name(label: str) -> str:
    """Make an entry's name of what reports call its adversary."""
    return slug(label).lower().strip("._+-")


def _checked_name(name: str) -> str:
    # no capitals: some file systems do not tell them apart
    if not re.fullmatch(r"[a-z0-9][a-z0-9._+-]{0,63}", name) or name.endswith((".", ".tmp")):
        raise ValueError(
            f"expected a name of at most 64 small letters, digits and - + . _, got {name!r}"
        )
    return name


EntryName = Annotated[str, AfterValidator(_checked_name)]
ShortLine = Annotated[OneLine, Field(max_length=200)]
Sha256 = Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]


class About(Strict):
    """Who made an entry, and which adversary it is: entry.toml.

    Attributes:
        format: The version of the entry's files.
        name: The name of the entry and of its folder.
        title: What the board calls it.
        authors: Who made it.
        licence: The licence of its data, as SPDX names it.
        paper: The address of a paper.
        repository: The address of the code.
        command: How the results are made.
        adversary: The adversary's registered name, `module:Class`, or what its authors call it.
        preset: The named set of options that it starts from.
        options: Its other options, as one line of JSON.
    """

    format: int
    name: EntryName
    title: ShortLine
    authors: tuple[ShortLine, ...] = Field(max_length=50)
    licence: ShortLine
    paper: ShortLine = ""
    repository: ShortLine = ""
    command: Annotated[OneLine, Field(max_length=1_000)] = ""
    adversary: ShortLine
    preset: ShortLine | None = None
    options: Annotated[OneLine, Field(max_length=10_000)] = "{}"


class Identity(Strict):
    """All that decides a result besides its seeds: with another one, it is another result.

    Attributes:
        track: The environment's id.
        agent: The name of the agent under attack; empty where it has none.
        rule: The name of the rule for the budget, see `sada_gym.benchmark.suite.Table`.
        budget: The number of training queries that the rule allows.
        samples: M, the number of test samples of each seed.
        application: The application's name.
        version: The application's version.
        application_settings: The application's resolved keywords.
        fingerprint: The agent's SHA-256.
        fooling_threshold: The agent is fooled where Q <= this.
        reference: The reference set that coverage is measured by; None where there is none.
        adversary: See `About`, also for the next two.
        preset: The named set of options that the adversary starts from.
        options: Its other options.
        resolved: All its options, defaults included. An adversary that is not ours has no others.
    """

    track: ShortLine
    agent: ShortLine
    rule: ShortLine
    budget: int = Field(ge=0)
    samples: int = Field(ge=1)
    application: ShortLine
    version: int
    application_settings: dict[str, Any]
    fingerprint: ShortLine
    fooling_threshold: float
    reference: ReferenceSummary | None
    adversary: ShortLine
    preset: ShortLine | None
    options: dict[str, Any]
    resolved: dict[str, Any]

    @classmethod
    def of(cls, settings: RunSettings, rule: str, fooling_threshold: float) -> Self:
        """Take what decides the result from a run's settings."""
        names = set(cls.model_fields) - {"rule", "fooling_threshold"}
        held = settings.model_dump(mode="json", include=names)
        return cls(**held, rule=rule, fooling_threshold=fooling_threshold)

    @property
    def sha256(self) -> str:
        """Give the SHA-256 of the identity as canonical JSON."""
        text = json.dumps(self.model_dump(mode="json"), sort_keys=True, separators=(",", ":"))
        return hashlib.sha256(text.encode()).hexdigest()

    @property
    def stem(self) -> str:
        """Give what the names of the result's files begin with."""
        return result_stem(self.track, self.agent, self.rule)


def result_stem(track: str, agent: str, rule: str) -> str:
    """Give what the names of a result's files begin with."""
    return ".".join(slug(part) for part in (track, agent, rule) if part)


class SeedResult(Strict):
    """What a result claims of one seed.

    Attributes:
        seed: The seed of the adversary and of its evaluation seeds.
        queries: The number of training queries spent.
        error: Why the adversary could not do its work; None where it did.
        measures: The measures of the test samples; None after an error.
        search: What the training queries found; None where they are not known.
        flags: What a reader must know.
        packages: The versions of the packages that took part.
    """

    seed: int = Field(ge=0, lt=2**63)
    queries: int = Field(ge=0)
    error: Annotated[OneLine, Field(max_length=MAX_ERROR)] | None = None
    measures: Measures | None
    search: Search | None = None
    flags: tuple[OneLine, ...] = Field(default=(), max_length=50)
    packages: dict[ShortLine, ShortLine] = Field(default_factory=dict, max_length=50)

    @classmethod
    def of(cls, report: RunReport | RunFailure) -> Self:
        """Take a run's measures."""
        settings = report.settings
        if isinstance(report, RunFailure):
            # an adversary of a user's own may raise with any text
            printable = "".join(one if one.isprintable() else " " for one in report.error)
            error = " ".join(printable.split())[:MAX_ERROR]
            return cls(
                seed=settings.seed,
                queries=0,
                error=error,
                measures=None,
                packages=settings.packages,
            )
        return cls(
            seed=settings.seed,
            queries=report.search.queries,
            measures=report.measures(),
            search=report.search,
            flags=report.flags,
            packages=settings.packages,
        )


class Result(Strict):
    """What an entry claims on one track, against one agent, under one rule for the budget.

    Attributes:
        format: The version of the entry's files.
        identity_sha256: The SHA-256 of the identity.
        identity: What the result is of.
        seeds: The claims, by ascending seed.
    """

    format: int
    identity_sha256: Sha256
    identity: Identity
    seeds: tuple[SeedResult, ...] = Field(max_length=MAX_SEEDS)

    @classmethod
    def make(cls, identity: Identity, seeds: Iterable[SeedResult]) -> Self:
        """Put seeds in order under their identity."""
        ordered = sorted(seeds, key=lambda one: one.seed)
        return cls(
            format=FORMAT, identity_sha256=identity.sha256, identity=identity, seeds=tuple(ordered)
        )


class VerifiedSeed(Strict):
    """What the verifier found of one seed's samples.

    Attributes:
        seed: The seed.
        measures: The measures on fresh evaluation seeds; without novelty, which needs the queries.
    """

    seed: int
    measures: Measures


class Verified(Strict):
    """What the verifier found of a result.

    Attributes:
        format: The version of the entry's files.
        identity_sha256: The identity of the result that was verified.
        samples_sha256: The SHA-256 of its samples; with other samples it counts no longer.
        nonce: What made the evaluation seeds fresh.
        seeds: The measures of each seed that had samples.
        flags: What speaks against the result, each by its name and a sentence.
    """

    format: int
    identity_sha256: Sha256
    samples_sha256: Sha256
    nonce: ShortLine
    seeds: tuple[VerifiedSeed, ...]
    flags: dict[str, OneLine]

    @classmethod
    def make(
        cls,
        claimed: Result,
        samples: Samples,
        nonce: str,
        seeds: Iterable[VerifiedSeed] = (),
        flags: Mapping[str, str] = MappingProxyType({}),
    ) -> Self:
        """Put findings under the identity and the samples that they are of."""
        return cls(
            format=FORMAT,
            identity_sha256=claimed.identity_sha256,
            samples_sha256=samples_sha256(samples),
            nonce=nonce,
            seeds=tuple(seeds),
            flags=dict(flags),
        )
