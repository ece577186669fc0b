"""The first checks of an entry: everything that can be checked without evaluating anything.

Entries come from strangers. Files are measured before they are read, nothing is unpickled or
imported, and every fault is one sentence.
"""

from __future__ import annotations

import itertools
import os
import re
import stat
from collections.abc import Mapping, Sequence
from pathlib import Path

from sada_gym import __version__
from sada_gym.errors import UserError
from sada_gym.evaluations import Evaluations
from sada_gym.experiment.adversary import AdversarySpec
from sada_gym.experiment.differences import differences
from sada_gym.experiment.record import Experiment
from sada_gym.files import as_path, file_errors, shown
from sada_gym.measures.coverage import NEAREST
from sada_gym.results.entry import (
    CLAIMS,
    METADATA_FILE,
    SAMPLES,
    VERIFIED,
    GroupFiles,
    read_metadata,
)
from sada_gym.results.models import EntryMetadata, Result
from sada_gym.results.samples import read_samples
from sada_gym.submission.claims import check_claims, check_coverage, check_samples, refuse
from sada_gym.submission.current import current_experiment, current_target
from sada_gym.submission.strict_json import check_strict_json

MAX_FILES = 100
"""The most files of an entry."""

MAX_BYTES = {METADATA_FILE: 2**16, CLAIMS: 2**24, SAMPLES: 2**26}
"""The most bytes of entry.toml, of the JSON of results, and of their samples."""

MAX_ENTRY_BYTES = 2**27
"""The most bytes of all files of an entry."""

_STEM = re.compile(r"[A-Za-z0-9][A-Za-z0-9._+-]{0,150}")
_WORD = re.compile(r"[A-Za-z0-9][A-Za-z0-9._+!-]*")
_LICENCE = re.compile(r"[A-Za-z0-9.+-]+( (AND|OR|WITH) [A-Za-z0-9.+-]+)*")
_ADDRESS = re.compile(r"https?://[^\s<>\"'`\\]+")
_RESERVED = re.compile(r"(con|prn|aux|nul|com\d|lpt\d)(\..*)?")  # no file of Windows
_ARCHIVE_BYTES = 2**12
"""What an NPZ file adds to the arrays of a result is less than this."""

_MAX_DIMENSION = 2**12
"""More parameters than any application has."""


def check_entry(folder: str | Path, *, submission: bool = True) -> None:
    """Check an entry; nothing is evaluated, imported or changed.

    Args:
        folder: The entry's folder.
        submission: Whether it is about to be submitted. It must then be of today's tracks, name its
            authors and its licence, have the seeds 0, 1 and so on, and hold nothing verified. An
            entry that was accepted earlier may be outdated.

    Raises:
        UserError: If something is wrong; the message names the first fault.
    """
    folder = as_path(folder, "an entry")
    groups = _check_files(folder, submission)
    metadata = read_metadata(folder)
    check_metadata(metadata, folder / METADATA_FILE, submission)
    adversaries = [
        (files, result.experiment.adversary)
        for files in (GroupFiles(folder, group) for group in groups)
        for result in _check_group(files, submission)
    ]
    _check_adversaries(adversaries)


def find_outdated(experiment: Experiment) -> str | None:
    """Say what of a result's track, agent, rule or options has changed since; None if nothing.

    An outdated result is not wrong, but it no longer compares with others.
    """
    target, rule = experiment.target, experiment.protocol.rule
    try:
        now = current_experiment(target.track, target.agent, rule, experiment.adversary)
    except UserError as error:
        return shown(str(error))
    return shown("; ".join(differences(experiment.model_dump(), now.model_dump()))) or None


def _check_files(folder: Path, submission: bool) -> list[str]:
    """Check names, kinds and sizes of all files, and give what the results' files begin with."""
    with file_errors("read", folder):
        name = folder.absolute().name
        if not _STEM.fullmatch(name) or _RESERVED.fullmatch(name):
            raise UserError(
                "Expected an entry's folder to be named by small letters, digits and - + . _, got "
                f"{shown(repr(name))}. Rename it."
            )
        if folder.is_symlink() or not stat.S_ISDIR(folder.lstat().st_mode):
            raise UserError(f"Expected the folder of an entry, got {folder}, which is none.")
        with os.scandir(folder) as found:
            files = list(itertools.islice(found, MAX_FILES + 1))
        if len(files) > MAX_FILES:
            raise UserError(
                f"Expected at most {MAX_FILES:,} files in {folder}, got more. Submit fewer results."
            )
        sizes = {file.name: _checked_size(folder, file, submission) for file in files}
    if METADATA_FILE not in sizes:
        raise UserError(
            f"Expected {METADATA_FILE} in {folder}, got none. Make an entry by sada-gym submit."
        )
    total = sum(sizes.values())
    if total > MAX_ENTRY_BYTES:
        raise UserError(
            f"Expected at most {MAX_ENTRY_BYTES >> 20} MiB in {folder}, got {total >> 20} MiB. "
            "Submit fewer results."
        )
    return _check_pairs(folder, sizes)


def _checked_size(folder: Path, file: os.DirEntry[str], submission: bool) -> int:
    name, ending = file.name, _ending(file.name)
    if ending is None:
        raise UserError(
            f"Expected only {METADATA_FILE} and results in {folder}, got {shown(repr(name))}. "
            "Remove it."
        )
    status = file.stat(follow_symlinks=False)
    if not stat.S_ISREG(status.st_mode):
        raise UserError(
            f"Expected a regular file in {folder / name}, got a link, a folder or a device. "
            "Put the file itself there."
        )
    if submission and ending == VERIFIED:
        raise UserError(
            f"Expected no results of the verifier in a submission, got {folder / name}. Remove it; "
            "the verifier writes such files."
        )
    most = MAX_BYTES[CLAIMS if ending == VERIFIED else ending]
    if status.st_size > most:
        raise UserError(
            f"Expected at most {most:,} bytes in {folder / name}, got {status.st_size:,}. "
            "Make the entry anew."
        )
    return status.st_size


def _ending(name: str) -> str | None:
    """Give which of an entry's files a name stands for; None where it is none of them."""
    if name == METADATA_FILE:
        return METADATA_FILE
    for ending in (VERIFIED, CLAIMS, SAMPLES):
        if name.endswith(ending) and _STEM.fullmatch(name.removesuffix(ending)):
            return ending
    return None


def _check_pairs(folder: Path, names: Mapping[str, int]) -> list[str]:
    stems = {
        ending: {name.removesuffix(ending) for name in names if _ending(name) == ending}
        for ending in (CLAIMS, SAMPLES, VERIFIED)
    }
    if not stems[CLAIMS] | stems[SAMPLES]:
        raise UserError(f"Expected at least one result in {folder}, got none.")
    for stem in sorted(set().union(*stems.values())):
        for ending, other in ((CLAIMS, SAMPLES), (SAMPLES, CLAIMS)):
            if stem not in stems[ending]:
                there = other if stem in stems[other] else VERIFIED
                raise UserError(
                    f"Expected {stem}{ending} beside {stem}{there} in {folder}, got none. Add it, "
                    "or remove the other file."
                )
    return sorted(stems[CLAIMS])


def check_metadata(metadata: EntryMetadata, path: Path, submission: bool) -> None:
    """Check what an entry says of itself.

    Args:
        metadata: What it says.
        path: The file that says so, for messages.
        submission: Whether authors and a licence are needed.

    Raises:
        UserError: If something is missing or does not fit.
    """
    blank = [] if metadata.title.strip() else ["title"]
    if submission:
        blank += [] if metadata.licence.strip() else ["licence"]
        blank += [] if any(author.strip() for author in metadata.authors) else ["authors"]
    if blank:
        refuse(path, f"a text as {blank[0]}", "an empty one", "Fill it in")
    if metadata.licence and not _LICENCE.fullmatch(metadata.licence):
        mend = "Write one as SPDX names it, such as CC-BY-4.0 or MIT"
        refuse(path, "a licence's SPDX name", repr(metadata.licence), mend)
    for name in ("paper", "repository"):
        address = getattr(metadata, name)
        if address and not _ADDRESS.fullmatch(address):
            mend = "Write it in full, as https://doi.org/10.1609/aaai.v34i07.6722, or leave it out"
            refuse(path, f"the address of a page as {name}", repr(address), mend)


def _check_group(files: GroupFiles, submission: bool) -> tuple[Result, ...]:
    """Check the results that an entry has on the tracks of one application."""
    check_strict_json(files.claims, MAX_BYTES[CLAIMS])
    results = files.read_claims()
    if not results:
        refuse(files.claims, "at least one result", "none")
    outdated = {result.sha256: find_outdated(result.experiment) for result in results}
    for result in results:
        changes = outdated[result.sha256]
        if submission and changes:
            raise UserError(
                f"Expected {result.experiment.place} in {files.claims} to be of today's track, "
                f"agent, rule and options, but: {changes.rstrip('.')}. Make the result anew with "
                "this version of sada_gym."
            )
        _check_result(files.claims, result, submission)
    samples = _read_samples(files, results, outdated)
    for result in results:
        for claims in result.seeds:
            if claims.measures is not None:
                held = samples[result.experiment.place][claims.seed]
                check_samples(files.samples, claims.seed, held)
                check_claims(files.claims, result.experiment, claims, held)
                if not outdated[result.sha256]:
                    check_coverage(files.claims, result.experiment, claims, held)
    if not submission and files.verified.exists():
        check_strict_json(files.verified, MAX_BYTES[CLAIMS])
        files.read_verified()
    return results


def _check_result(path: Path, result: Result, submission: bool) -> None:
    experiment = result.experiment
    samples, adversary = experiment.protocol.samples, experiment.adversary
    if experiment.seed is not None:
        refuse(path, "no seed of the experiment", experiment.seed)
    if not adversary.name.strip():
        refuse(path, "a text as adversary", "an empty one", "Fill it in")
    if experiment.target.reference is not None and samples <= NEAREST:
        refuse(path, f"more than {NEAREST} samples of each seed", samples)
    resolved = adversary.resolved or {}
    if not adversary.is_ours and not adversary.options.items() <= resolved.items():
        refuse(path, "resolved options that hold the given ones", "others")
    _check_seeds(path, result, submission)


def _check_adversaries(adversaries: Sequence[tuple[GroupFiles, AdversarySpec]]) -> None:
    """Check that all results are of one adversary with one preset and one set of options."""
    first = adversaries[0][1]
    for files, adversary in adversaries:
        for name in ("name", "preset", "options"):
            expected, found = getattr(first, name), getattr(adversary, name)
            if found != expected:
                refuse(
                    files.claims,
                    f"the adversary's {name} of the other results, {shown(repr(expected))}",
                    shown(repr(found)),
                    "One entry is of one adversary with one set of options",
                )


def _check_seeds(path: Path, result: Result, submission: bool) -> None:
    protocol = result.experiment.protocol
    seeds = [one.seed for one in result.seeds]
    if not seeds:
        refuse(path, "at least one seed", "none")
    if submission and seeds != list(range(len(seeds))):
        mend = "Submit all of them, so that nobody can choose the best ones"
        refuse(path, "the seeds 0, 1, 2 and so on", shown(str(seeds)), mend)
    for one in result.seeds:
        where = f"of seed {one.seed}"
        if (one.measures is None) == (one.error is None):
            got = "neither" if one.measures is None else "both"
            refuse(path, f"either measures or an error {where}", got)
        if one.queries > protocol.budget:
            mend = "Spend no more than the rule allows"
            allowed = f"at most {protocol.budget:,} queries {where}, the budget of {protocol.rule},"
            refuse(path, allowed, f"{one.queries:,}", mend)
        if one.search is not None and (
            one.search.queries != one.queries or one.search.fooled > one.queries
        ):
            found = f"{one.search.fooled:,} fooling ones of {one.search.queries:,}"
            refuse(path, f"a search of {one.queries:,} queries {where}", found)
        _check_packages(path, one.packages, where)


def _check_packages(path: Path, packages: Mapping[str, str], where: str) -> None:
    for name, version in packages.items():
        if not _WORD.fullmatch(name) or not _WORD.fullmatch(version):
            refuse(path, f"names and versions of packages {where}", f"{name!r}: {version!r}")
    made_by = packages.get("sada_gym")
    if made_by is None:
        refuse(path, f"the version of sada_gym among the packages {where}", "none")
    if not _release(made_by) or _release(made_by) > _release(__version__):
        mend = "Install the newest sada_gym"
        refuse(path, f"sada_gym {__version__} or older {where}", made_by, mend)


def _release(version: str) -> tuple[int, ...]:
    found = re.match(r"\d+(\.\d+)*", version)
    return tuple(int(part) for part in found[0].split(".")) if found else ()


def _read_samples(
    files: GroupFiles, results: Sequence[Result], outdated: Mapping[str, str | None]
) -> dict[str, dict[int, Evaluations]]:
    """Read the samples; the file may hardly be larger than the claims make it."""
    path, most = files.samples, _ARCHIVE_BYTES
    claimed: dict[str, list[int]] = {}
    dimensions: dict[str, int] = {}
    for result in results:
        target, place = result.experiment.target, result.experiment.place
        seeds = [claims.seed for claims in result.seeds if claims.measures is not None]
        if seeds:
            claimed[place] = seeds
        if not outdated[result.sha256]:
            dimensions[place] = current_target(target.track, target.agent).dimension
        row = 8 + 4 * dimensions.get(place, _MAX_DIMENSION)
        most += _ARCHIVE_BYTES + len(seeds) * (8 + result.experiment.protocol.samples * row)
    size = path.lstat().st_size
    if size > most:
        count = sum(map(len, claimed.values()))
        refuse(path, f"at most {most:,} bytes for the samples of {count} seeds", f"{size:,}")
    samples = read_samples(path)
    if sorted(samples) != sorted(claimed):
        found = shown(str(sorted(samples)))
        refuse(path, f"samples of {shown(str(sorted(claimed)))}, as claimed,", found)
    for result in results:
        place, count = result.experiment.place, result.experiment.protocol.samples
        for seed, held in samples.get(place, {}).items():
            if seed not in claimed[place]:
                refuse(path, f"samples of the seeds {shown(str(claimed[place]))} of {place}", seed)
            expected = (count, dimensions.get(place, held.mu.shape[1]))
            if held.mu.shape != expected:
                refuse(path, f"mu of shape {expected} of seed {seed} of {place}", held.mu.shape)
        missing = set(claimed.get(place, ())) - set(samples.get(place, {}))
        if missing:
            refuse(path, f"samples of seed {min(missing)} of {place}, as claimed,", "none")
    return samples
