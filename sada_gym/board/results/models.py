"""The contents of an entry's files: who made it, its claims, and what the verifier found."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from typing import Annotated, Literal

from pydantic import AfterValidator, Field, ValidationError, model_validator
from typing_extensions import Self

from sada_gym.board.results.samples import Samples, samples_sha256
from sada_gym.errors import UserError, is_plain, plain
from sada_gym.experiment.measure import Measures, Search
from sada_gym.experiment.record import Experiment, RunFailure, RunReport, slug
from sada_gym.foundations.files import OneLine, Strict, first_error

FORMAT = 2  #: The version of an entry's files. Raise it when they change.
MAX_SEEDS = 100  #: The most seeds of a result.
MAX_ERROR = 2_000  #: The most characters of a seed's error.

DISQUALIFYING = frozenset({"claim", "constant", "copied"})
"""The verifier's flags that take a result's rank: its figures do not say what they seem to say."""

Tier = Literal["claimed", "verified"]
"""How far a result was checked. Another tier will hold results whose queries a judge counted."""

_MAX_TEXT = 200


def entry_name(label: str) -> str:
    """Derive an entry's name from what reports call its adversary."""
    return slug(label).lower().strip("._+-")


def _validate_name(name: str) -> str:
    # no capitals: some file systems do not tell them apart
    if not re.fullmatch(r"[a-z0-9][a-z0-9._+-]{0,63}", name) or name.endswith((".", ".tmp")):
        raise ValueError(
            f"expected a name of at most 64 small letters, digits and - + . _, got {name!r}"
        )
    return name


EntryName = Annotated[str, AfterValidator(_validate_name)]
ShortLine = Annotated[OneLine, Field(max_length=_MAX_TEXT)]
Sha256 = Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]


class EntryMetadata(Strict):
    """The metadata of an entry, stored in entry.toml.

    Attributes:
        name: The name of the entry and of its folder: small letters, digits and `- + . _`.
        title: Its name on the leaderboard; empty takes `name`.
        authors: The names of its authors.
        licence: The licence of its data, as an SPDX name such as `CC-BY-4.0`.
        paper: The address of its paper, or empty.
        repository: The address of its code, or empty.
        command: The command that makes the results; empty takes that of the first run.
        description: What the adversary does, in a sentence.
        date: When it was submitted, such as 2026-11-28.
    """

    format: int = Field(default=FORMAT, ge=FORMAT, le=FORMAT)
    name: EntryName
    title: ShortLine = ""
    authors: tuple[ShortLine, ...] = Field(max_length=50)
    licence: ShortLine
    paper: ShortLine = ""
    repository: ShortLine = ""
    command: Annotated[OneLine, Field(max_length=1_000)] = ""
    description: Annotated[OneLine, Field(max_length=300)] = ""
    date: Annotated[str, Field(pattern=r"^(\d{4}-\d\d-\d\d)?$")] = ""


class SeedResult(Strict):
    """The claims of a result for one seed.

    Attributes:
        queries: The number of training queries that were spent.
        error: The message of an `AdversaryError`; None without an error.
        measures: The measures of the test samples; None after an error.
        search: What the training queries found; None if the queries are not known.
        flags: Warnings, such as that no training query fooled.
        packages: Versions of the packages in use.
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
        """Return the claims of a run."""
        settings = report.settings
        if isinstance(report, RunFailure):
            # an adversary of a user's own may raise with any text
            error = plain(" ".join(report.error.split()))[:MAX_ERROR]
            packages = settings.packages
            return cls(seed=settings.seed, queries=0, error=error, measures=None, packages=packages)
        return cls(
            seed=settings.seed,
            queries=report.search.queries,
            measures=report.measures(),
            search=report.search,
            flags=report.flags,
            packages=settings.packages,
        )


class Result(Strict):
    """The claims of an entry for one experiment: `seeds` lists them by ascending seed."""

    experiment: Experiment
    sha256: Sha256
    seeds: tuple[SeedResult, ...] = Field(max_length=MAX_SEEDS)

    @classmethod
    def make(cls, experiment: Experiment, seeds: Iterable[SeedResult]) -> Self:
        """Make the result of an experiment, whose seed is ignored; `seeds` may have any order.

        Raises a UserError if a name is too long or not printable.
        """
        experiment = experiment.at(None)
        ordered = sorted(seeds, key=lambda claims: claims.seed)
        try:
            return cls(experiment=experiment, sha256=experiment.sha256, seeds=tuple(ordered))
        except ValidationError as error:
            reason = first_error(error).removeprefix("the file: Value error, ")
            raise UserError(
                f"Expected an experiment that an entry can describe, but {reason}. Give the "
                "track, the agent, the adversary and the rule shorter names."
            ) from error

    @model_validator(mode="after")
    def _check_experiment(self) -> Self:
        experiment, target = self.experiment, self.experiment.target
        if experiment.seed is not None:
            raise ValueError(
                f"expected no seed of the experiment of all seeds, got {experiment.seed}"
            )
        for name, text in (
            ("track", target.track),
            ("agent", target.agent),
            ("application", target.application.name),
            ("fingerprint", target.application.fingerprint),
            ("adversary", experiment.adversary.name),
            ("preset", experiment.adversary.preset or ""),
            ("rule", experiment.protocol.rule),
        ):
            if not is_plain(text) or len(text) > _MAX_TEXT:
                raise ValueError(
                    f"expected the {name} in one line of at most {_MAX_TEXT} characters, got "
                    f"{text[:_MAX_TEXT]!r}"
                )
        return self


class ClaimedResults(Strict):
    """GROUP.json: the results of an entry on the tracks of one application, by ascending place."""

    format: int
    results: tuple[Result, ...]


class VerifiedSeed(Strict):
    """The measures of a seed on fresh evaluation seeds, without novelty: that needs the queries."""

    seed: int
    measures: Measures


class Verified(Strict):
    """What the verifier found for a result.

    Attributes:
        samples_sha256: The SHA-256 of the samples. For other samples the findings do not hold.
        salt: The names of the entry and of the result, which the fresh evaluation seeds depend on.
        nonce: The secret text that the fresh evaluation seeds depend on, published afterwards.
        seeds: The measures of each seed on fresh evaluation seeds.
        flags: What speaks against the result: the name of each flag, and a sentence.
    """

    sha256: Sha256
    samples_sha256: Sha256
    salt: tuple[ShortLine, ShortLine]
    nonce: ShortLine
    seeds: tuple[VerifiedSeed, ...]
    flags: dict[str, OneLine]

    @classmethod
    def make(
        cls,
        claimed: Result,
        samples: Samples,
        salt: tuple[str, str],
        nonce: str,
        seeds: Iterable[VerifiedSeed] = (),
        flags: Mapping[str, str] | None = None,
    ) -> Self:
        """Make the record of findings, with the digests of the result and its samples."""
        return cls(
            sha256=claimed.sha256,
            samples_sha256=samples_sha256(samples),
            salt=salt,
            nonce=nonce,
            seeds=tuple(seeds),
            flags=dict(flags or {}),
        )


class VerifiedResults(Strict):
    """GROUP.verified.json: what the verifier found of the results in GROUP.json, by place."""

    format: int
    results: dict[str, Verified]
