"""An entry of the leaderboard: one adversary's results as a folder of plain data.

    NAME/entry.toml                         who made it, and which adversary it is
    NAME/TRACK.AGENT.RULE.json              what it claims, for each seed
    NAME/TRACK.AGENT.RULE.npz               the test samples of each seed
    NAME/TRACK.AGENT.RULE.verified.json     what the verifier found

Training queries are no part of it. Nothing in an entry is ever executed or unpickled.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from pydantic import ValidationError

from sada_gym.errors import FileError, UserError
from sada_gym.evaluations import Evaluations
from sada_gym.files import file_errors, first_error, read_model, read_toml, write_file, write_model
from sada_gym.submission.models import FORMAT, About, Result, Tier, Verified
from sada_gym.submission.samples import Samples, read_samples, samples_bytes, samples_sha256

ABOUT_FILE = "entry.toml"
CLAIMS, SAMPLES, VERIFIED = ".json", ".npz", ".verified.json"
"""What the names of a result's files end in."""


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
    """Read an entry; what is wrong with its contents is for `sada_gym.submission.checks` to find.

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
