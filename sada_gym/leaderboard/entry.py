"""An entry of the leaderboard: one adversary's results as a folder of plain data.

    NAME/entry.toml                         who made it, and which adversary it is
    NAME/TRACK.AGENT.RULE.json              what it claims, for each seed
    NAME/TRACK.AGENT.RULE.npz               the test samples of each seed
    NAME/TRACK.AGENT.RULE.verified.json     what the verifier found

Training queries are no part of it. Nothing in an entry is ever executed or unpickled.
"""

from __future__ import annotations

import hashlib
import io
import json
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import AfterValidator, Field, ValidationError
from typing_extensions import Self

from sada_gym.errors import FileError, UserError
from sada_gym.evaluation.oracle import Evaluations
from sada_gym.files import (
    OneLine,
    Strict,
    file_errors,
    first_error,
    read_arrays,
    read_model,
    read_toml,
    write_file,
    write_model,
)
from sada_gym.runs.measure import Measures, Search
from sada_gym.runs.record import ReferenceSummary, RunFailure, RunReport, RunSettings

FORMAT = 1
"""The version of an entry's files. Raise it when they change."""

ABOUT_FILE = "entry.toml"
CLAIMS, SAMPLES, VERIFIED = ".json", ".npz", ".verified.json"
"""What the names of a result's files end in."""

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


Samples = Mapping[int, Evaluations]
"""The test samples of each seed, by ascending seed."""

_KINDS = {"run": ("i8", 1), "mu": ("f4", 2), "score": ("f8", 1), "seed": ("i8", 1)}


def samples_bytes(samples: Samples, dimension: int) -> bytes:
    """Pack samples as NPZ: run (n,) int64, the seed of each row's run, then mu, score, seed.

    Args:
        samples: The samples of each seed.
        dimension: The number of semantic parameters; mu has that many columns even without rows.
    """
    ordered = [samples[seed] for seed in sorted(samples)]
    runs = [np.full(len(samples[seed]), seed, np.int64) for seed in sorted(samples)]
    buffer = io.BytesIO()
    np.savez(
        buffer,
        run=np.concatenate([np.zeros(0, np.int64), *runs]),
        mu=np.concatenate([np.zeros((0, dimension), np.float32), *(one.mu for one in ordered)]),
        score=np.concatenate([np.zeros(0), *(one.score for one in ordered)]),
        seed=np.concatenate([np.zeros(0, np.int64), *(one.seed for one in ordered)]),
    )
    return buffer.getvalue()


def samples_sha256(samples: Samples) -> str:
    """Give the SHA-256 of samples: of each seed, its mu, scores and evaluation seeds."""
    digest = hashlib.sha256()
    for seed in sorted(samples):
        one = samples[seed]
        digest.update(f"{seed}:{len(one)}:{one.mu.shape[1]};".encode())
        for array, dtype in ((one.mu, "<f4"), (one.score, "<f8"), (one.seed, "<i8")):
            digest.update(np.ascontiguousarray(array, dtype).tobytes())
    return digest.hexdigest()


def read_samples(path: Path) -> dict[int, Evaluations]:
    """Read the samples of a result.

    Raises:
        FileError: If the file cannot be read or does not hold such samples.
    """
    arrays = read_arrays(path, _KINDS)
    counts = {name: len(array) for name, array in arrays.items()}
    if len(set(counts.values())) > 1:
        raise FileError(
            f"Expected as many rows of mu as scores and seeds in {path}, got {counts}. "
            "Restore the file, or make it anew."
        )
    found = {}
    for seed in np.unique(arrays["run"]).tolist():
        rows = arrays["run"] == seed
        found[seed] = Evaluations(*(arrays[name][rows] for name in ("mu", "score", "seed")))
    return found


def read_result(path: Path) -> Result:
    """Read what a result claims.

    Raises:
        FileError: If the file cannot be read, is of another format, or was edited by hand.
    """
    result = read_model(path, Result)
    _refuse_other_format(path, result.format)
    if result.identity_sha256 != result.identity.sha256:
        raise FileError(
            f"Expected identity_sha256 in {path} to be the hash of the identity, "
            f"{result.identity.sha256}, got {result.identity_sha256}. Make the entry anew instead "
            "of editing it."
        )
    if path.name != f"{result.identity.stem}{CLAIMS}":
        raise FileError(
            f"Expected the file of this result to be called {result.identity.stem}{CLAIMS}, got "
            f"{path}. Rename it, or make the entry anew."
        )
    seeds = [one.seed for one in result.seeds]
    if seeds != sorted(set(seeds)):
        raise FileError(f"Expected ascending seeds in {path}, each once, got {seeds}.")
    return result


def read_verified(path: Path) -> Verified:
    """Read what the verifier found.

    Raises:
        FileError: If the file cannot be read or is of another format.
    """
    verified = read_model(path, Verified)
    _refuse_other_format(path, verified.format)
    return verified


def write_result(folder: Path, result: Result, samples: Samples) -> None:
    """Write a result's claims and samples; what was verified of other samples is removed.

    The samples come first. Where the process is killed in between, the file holds samples of a seed
    that nothing is claimed of; `ResultFiles.read` leaves them out.

    Args:
        folder: The entry's folder.
        result: The claims.
        samples: The samples of each seed that has measures.
    """
    files = ResultFiles(folder, result.identity.stem)
    mu = next((one.mu for one in samples.values()), np.zeros((0, 1), np.float32))
    with file_errors("remove", files.verified):
        files.verified.unlink(missing_ok=True)
    write_file(files.samples, samples_bytes(samples, mu.shape[1]))
    write_model(files.claims, result)


def write_verified(folder: Path, stem: str, verified: Verified) -> None:
    """Write what the verifier found beside what the result claims."""
    write_model(ResultFiles(folder, stem).verified, verified)


@dataclass(frozen=True)
class ResultFiles:
    """Where the files of one result are.

    Attributes:
        folder: The entry's folder.
        stem: What the files' names begin with.
    """

    folder: Path
    stem: str

    @property
    def claims(self) -> Path:
        """The claims."""
        return self.folder / f"{self.stem}{CLAIMS}"

    @property
    def samples(self) -> Path:
        """The samples."""
        return self.folder / f"{self.stem}{SAMPLES}"

    @property
    def verified(self) -> Path:
        """What the verifier found."""
        return self.folder / f"{self.stem}{VERIFIED}"

    def read(self) -> tuple[Result, dict[int, Evaluations]]:
        """Read claims and samples; seeds that only one of the files has are left out.

        Raises:
            FileError: If a file cannot be read.
        """
        result, samples = read_result(self.claims), read_samples(self.samples)
        kept = [one for one in result.seeds if one.measures is None or one.seed in samples]
        claimed = {one.seed for one in kept if one.measures is not None}
        return (
            result.model_copy(update={"seeds": tuple(kept)}),
            {seed: one for seed, one in samples.items() if seed in claimed},
        )


@dataclass(frozen=True, eq=False)
class EntryResult:
    """One result of an entry, read from its files.

    Attributes:
        claimed: What it claims.
        samples: Its samples.
        verified: What the verifier found of these very samples; None where it has not seen them.
    """

    claimed: Result
    samples: dict[int, Evaluations]
    verified: Verified | None

    @property
    def tier(self) -> Tier:
        """How far the result was checked."""
        return "claimed" if self.verified is None else "verified"


@dataclass(frozen=True, eq=False)
class Entry:
    """An entry of the leaderboard.

    Attributes:
        folder: Its folder.
        about: Who made it, and which adversary it is.
        results: Its results, by the beginning of their files' names.
    """

    folder: Path
    about: About
    results: dict[str, EntryResult] = field(default_factory=dict)

    def keeping(self, wanted: Callable[[EntryResult], bool]) -> Entry:
        """Give the entry with those of its results that are wanted."""
        kept = {stem: result for stem, result in self.results.items() if wanted(result)}
        return replace(self, results=kept)


def read_entry(folder: Path) -> Entry:
    """Read an entry; what is wrong with its contents is for `sada_gym.leaderboard.checks` to find.

    Raises:
        FileError: If a file cannot be read.
    """
    about = read_about(folder)
    results = {}
    for path in claims_files(folder):
        files = ResultFiles(folder, path.name.removesuffix(CLAIMS))
        claimed, samples = files.read()
        verified = None
        if files.verified.exists():
            found = read_verified(files.verified)
            # another result's, or of samples that were changed since
            if (found.identity_sha256, found.samples_sha256) == (
                claimed.identity_sha256,
                samples_sha256(samples),
            ):
                verified = found
        results[files.stem] = EntryResult(claimed, samples, verified)
    return Entry(folder, about, results)


def read_entries(folder: Path) -> list[Entry]:
    """Read all entries of a folder, by name; hidden folders are left out.

    Raises:
        FileError: If a file cannot be read.
    """
    with file_errors("read", folder):
        folders = sorted(one for one in folder.iterdir() if not one.name.startswith("."))
    return [read_entry(one) for one in folders if one.is_dir()]


def claims_files(folder: Path) -> list[Path]:
    """List the files that hold an entry's claims."""
    with file_errors("read", folder):
        return sorted(
            path
            for path in folder.glob(f"*{CLAIMS}")
            if not path.name.endswith(VERIFIED) and not path.name.startswith(".")
        )


def _refuse_other_format(path: Path, found: int) -> None:
    if found != FORMAT:
        raise FileError(
            f"Expected format {FORMAT} in {path}, got {found}. Make the entry anew with this "
            "version of sada_gym."
        )


_COMMENT = "# Made by sada-gym. The results are in the files beside this one.\n"


def write_about(folder: Path, about: About) -> None:
    """Write entry.toml."""
    lines = [_COMMENT]
    for name, value in about.model_dump(mode="json", exclude_none=True).items():
        # a JSON string is a TOML string too, as long as it is written as it is
        text = json.dumps(value, ensure_ascii=False)
        lines.append(f"{name} = {text}\n")
    write_file(folder / ABOUT_FILE, "".join(lines).encode())


def read_about(folder: Path) -> About:
    """Read entry.toml.

    Raises:
        FileError: If the file cannot be read, is no such file, or of another format.
    """
    path = folder / ABOUT_FILE
    try:
        about = About.model_validate(read_toml(path))
    except ValidationError as error:
        raise FileError(
            f"Expected {path} to describe an entry, got something else ({first_error(error)}). "
            "Mend that place, or make the entry anew."
        ) from error
    _refuse_other_format(path, about.format)
    if about.name != folder.resolve().name:
        raise UserError(
            f"Expected the folder of the entry {about.name} to have its name, got {folder}. Rename "
            "one of them."
        )
    return about
