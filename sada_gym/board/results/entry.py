"""An entry of the leaderboard: one adversary's results as a folder of plain data.

    NAME/entry.toml                     who made it
    NAME/APPLICATION.json               what it claims on the tracks of an application, seed by seed
    NAME/APPLICATION.npz                the test samples
    NAME/APPLICATION.verified.json      what the verifier found

Training queries are no part of it. Nothing in an entry is ever executed or unpickled. A file that
cannot be read or written is a FileError.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

from pydantic import ValidationError
from typing_extensions import Self

from sada_gym.board.results.models import (
    FORMAT,
    ClaimedResults,
    EntryMetadata,
    Result,
    SeedResult,
    Tier,
    Verified,
    VerifiedResults,
)
from sada_gym.board.results.samples import (
    Samples,
    check_ascending,
    read_samples,
    samples_bytes,
    samples_sha256,
)
from sada_gym.errors import FileError, UserError
from sada_gym.evaluations import Evaluations
from sada_gym.experiment.adversary import AdversarySpec
from sada_gym.experiment.record import Experiment
from sada_gym.foundations.files import (
    file_errors,
    first_error,
    read_model,
    read_toml,
    write_file,
    write_model,
)

METADATA_FILE = "entry.toml"
CLAIMS, SAMPLES, VERIFIED = ".json", ".npz", ".verified.json"
"""What the names of an entry's other files end in."""


@dataclass(frozen=True, eq=False)
class EntryResult:
    """One result of an entry.

    Attributes:
        claimed: The figures that the entry claims.
        samples: The samples of each seed that has measures.
        verified: What the verifier found for these samples; None if it has not evaluated them.
    """

    claimed: Result
    samples: Samples
    verified: Verified | None = None

    @property
    def experiment(self) -> Experiment:
        """The experiment of the result, without a seed."""
        return self.claimed.experiment

    @property
    def place(self) -> str:
        """The name of the result in its entry: `TRACK.AGENT.RULE`."""
        return self.experiment.place

    @property
    def track(self) -> str:
        """The environment's id."""
        return self.experiment.target.track

    @property
    def tier(self) -> Tier:
        """How far the result was checked: `claimed` or `verified`."""
        return "claimed" if self.verified is None else "verified"

    def with_seed(self, claims: SeedResult, samples: Evaluations | None) -> Self:
        """Return the result with one more seed, or with new claims and samples for a seed."""
        seeds = {old.seed: old for old in self.claimed.seeds} | {claims.seed: claims}
        all_samples = {**self.samples, claims.seed: samples}
        return replace(
            self,
            claimed=Result.make(self.experiment, seeds.values()),
            samples={s: rows for s, rows in sorted(all_samples.items()) if rows is not None},
            verified=None,
        )


@dataclass(frozen=True)
class GroupFiles:
    """The files of an entry's results on the tracks of one application, its group."""

    folder: Path
    group: str

    @property
    def claims(self) -> Path:
        """The claims."""
        return self.folder / f"{self.group}{CLAIMS}"

    @property
    def samples(self) -> Path:
        """The samples."""
        return self.folder / f"{self.group}{SAMPLES}"

    @property
    def verified(self) -> Path:
        """What the verifier found."""
        return self.folder / f"{self.group}{VERIFIED}"

    def read(self, claims: Iterable[Result] | None = None) -> dict[str, EntryResult]:
        """Read the results, by place, without seeds that lack claims or samples.

        There are none where the files are missing. A file that cannot be read is a FileError.
        `claims` are those of `read_claims`, where they were read before.
        """
        if not self.claims.exists():
            return {}
        claims = self.read_claims() if claims is None else claims
        samples, findings = read_samples(self.samples), self.read_verified()
        places = {result.experiment.place: result for result in claims}
        return {
            place: _join(result, samples.get(place, {}), findings.get(place))
            for place, result in places.items()
        }

    def read_claims(self) -> tuple[Result, ...]:
        """Read the claims; a FileError if they are of another format, or were edited by hand."""
        path = self.claims
        content = read_model(path, ClaimedResults)
        _check_format(path, content.format)
        results = content.results
        check_ascending(path, "results", [result.experiment.place for result in results])
        for result in results:
            experiment = result.experiment
            place, group, expected = experiment.place, experiment.group, experiment.sha256
            if result.sha256 != expected:
                raise FileError(
                    f"Expected sha256 of {place} in {path} to be the hash of its experiment, "
                    f"{expected}, got {result.sha256}. Make the entry again instead of editing it."
                )
            if group != self.group:
                raise FileError(
                    f"Expected the results on {group} in a file called {group}{CLAIMS}, got {path}."
                    " Rename it, or make the entry again."
                )
            check_ascending(path, f"seeds of {place}", [claims.seed for claims in result.seeds])
        return results

    def read_verified(self) -> dict[str, Verified]:
        """Read what the verifier found, by the place of the result; nothing without the file."""
        if not self.verified.exists():
            return {}
        content = read_model(self.verified, VerifiedResults)
        _check_format(self.verified, content.format)
        return content.results

    def write(self, results: Iterable[EntryResult]) -> None:
        """Write results; what was verified of other samples is removed.

        The samples come first. Where the process is killed in between, the file holds samples of a
        seed that nothing is claimed of; `read` leaves them out. Samples that were not evaluated on
        the test seeds of their seed are a UserError.
        """
        ordered = sorted(results, key=lambda result: result.place)
        write_file(self.samples, samples_bytes({r.place: r.samples for r in ordered}))
        claimed = tuple(result.claimed for result in ordered)
        write_model(self.claims, ClaimedResults(format=FORMAT, results=claimed))
        self._write_verified({r.place: r.verified for r in ordered if r.verified is not None})

    def add_verified(self, place: str, verified: Verified) -> None:
        """Write what the verifier found of a result beside what it found of others."""
        self._write_verified(self.read_verified() | {place: verified})

    def _write_verified(self, findings: Mapping[str, Verified]) -> None:
        if findings:
            ordered = dict(sorted(findings.items()))
            write_model(self.verified, VerifiedResults(format=FORMAT, results=ordered))
        else:
            with file_errors("remove", self.verified):
                self.verified.unlink(missing_ok=True)


def _join(result: Result, samples: Samples, verified: Verified | None) -> EntryResult:
    seeds = tuple(s for s in result.seeds if s.measures is None or s.seed in samples)
    measured = {claims.seed for claims in seeds if claims.measures is not None}
    samples = {seed: rows for seed, rows in samples.items() if seed in measured}
    # findings of another result, or of samples that were changed since, do not count
    if verified is not None and (
        verified.sha256 != result.sha256 or verified.samples_sha256 != samples_sha256(samples)
    ):
        verified = None
    return EntryResult(result.model_copy(update={"seeds": seeds}), samples, verified)


@dataclass(frozen=True, eq=False)
class Entry:
    """An entry of the leaderboard. `results` holds its results by `TRACK.AGENT.RULE`."""

    folder: Path
    metadata: EntryMetadata
    results: dict[str, EntryResult] = field(default_factory=dict)

    @property
    def adversary(self) -> AdversarySpec | None:
        """The adversary of all its results; None without results."""
        return next((r.experiment.adversary for r in self.results.values()), None)

    def keeping(self, wanted: Callable[[EntryResult], bool]) -> Entry:
        """Return the entry with only those results for which `wanted(result)` is true."""
        kept = {place: result for place, result in self.results.items() if wanted(result)}
        return replace(self, results=kept)


def read_entry(folder: Path) -> Entry:
    """Read an entry from its folder, without the checks of `check_entry`."""
    metadata, groups = read_metadata(folder), group_files(folder)
    results = {place: result for files in groups for place, result in files.read().items()}
    return Entry(folder, metadata, results)


def read_entries(folder: Path) -> list[Entry]:
    """Read all entries in a folder, sorted by name; hidden folders are skipped."""
    with file_errors("read", folder):
        folders = sorted(path for path in folder.iterdir() if not path.name.startswith("."))
    return [read_entry(path) for path in folders if path.is_dir()]


def write_results(folder: Path, results: Iterable[EntryResult]) -> None:
    """Write results into an entry, in the place of those that it has in the same places."""
    by_group: dict[str, list[EntryResult]] = {}
    for result in results:
        by_group.setdefault(result.experiment.group, []).append(result)
    for group, new in by_group.items():
        files = GroupFiles(folder, group)
        files.write((files.read() | {result.place: result for result in new}).values())


def group_files(folder: Path) -> list[GroupFiles]:
    """List the files of an entry's results."""
    with file_errors("read", folder):
        return [
            GroupFiles(folder, path.name.removesuffix(CLAIMS))
            for path in sorted(folder.glob(f"*{CLAIMS}"))
            if not path.name.endswith(VERIFIED) and not path.name.startswith(".")
        ]


def _check_format(path: Path, number: object) -> None:
    if number != FORMAT:
        # TOML holds anything, such as integers that are too long to be shown
        is_short = isinstance(number, int) and abs(number) < 2**63
        raise FileError(
            f"Expected format {FORMAT} in {path}, got {number if is_short else 'another'}. Make "
            "the entry again with this version of sada_gym."
        )


def write_metadata(folder: Path, metadata: EntryMetadata) -> None:
    """Write entry.toml."""
    lines = ["# Made by sada-gym. The results are in the files beside this one."]
    for name, value in metadata.model_dump(mode="json").items():
        # a JSON string is a TOML string too, unless characters are escaped
        lines.append(f"{name} = {json.dumps(value, ensure_ascii=False)}")
    write_file(folder / METADATA_FILE, "\n".join([*lines, ""]))


def read_metadata(folder: Path) -> EntryMetadata:
    """Read entry.toml; a FileError if it is no such file, or of another format."""
    path = folder / METADATA_FILE
    content = read_toml(path)
    _check_format(path, content.get("format", FORMAT))
    try:
        metadata = EntryMetadata.model_validate(content)
    except ValidationError as error:
        raise FileError(
            f"Expected {path} to describe an entry, got something else ({first_error(error)}). "
            "Fix that place, or make the entry again."
        ) from error
    if metadata.name != folder.resolve().name:
        raise UserError(
            f"Expected the folder of the entry {metadata.name} to have its name, got {folder}. "
            "Rename one of them."
        )
    return metadata
