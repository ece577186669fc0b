"""The first checks of an entry: everything that can be checked without evaluating anything.

Entries come from strangers. Files are measured before they are read, nothing is unpickled or
imported, and every fault is one sentence.
"""

from __future__ import annotations

import itertools
import os
import re
import stat
from collections.abc import Mapping
from pathlib import Path

from sada_gym import __version__
from sada_gym.errors import UserError
from sada_gym.evaluations import Evaluations
from sada_gym.experiment.record import differences
from sada_gym.files import as_path, file_errors, shown
from sada_gym.measures.coverage import NEAREST
from sada_gym.submission.claims import check_claims, check_coverage, check_samples, refuse
from sada_gym.submission.entry import (
    ABOUT_FILE,
    CLAIMS,
    SAMPLES,
    VERIFIED,
    ResultFiles,
    read_about,
    read_result,
    read_verified,
)
from sada_gym.submission.models import About, Identity, Result
from sada_gym.submission.samples import read_samples
from sada_gym.submission.strict_json import parse_json, refuse_loose
from sada_gym.submission.today import find_target, is_ours, today

MAX_FILES = 1_000
"""The most files of an entry."""

MAX_BYTES = {ABOUT_FILE: 2**16, CLAIMS: 2**22, SAMPLES: 2**24}
"""The most bytes of entry.toml, of a result's JSON, and of its samples."""

MAX_ENTRY_BYTES = 2**27
"""The most bytes of all files of an entry."""

_STEM = re.compile(r"[A-Za-z0-9][A-Za-z0-9._+-]{0,150}")
_WORD = re.compile(r"[A-Za-z0-9][A-Za-z0-9._+!-]*")
_LICENCE = re.compile(r"[A-Za-z0-9.+-]+( (AND|OR|WITH) [A-Za-z0-9.+-]+)*")
_ADDRESS = re.compile(r"https?://[^\s<>\"'`\\]+")
_RESERVED = re.compile(r"(con|prn|aux|nul|com\d|lpt\d)(\..*)?")  # no file of Windows
_ARCHIVE_BYTES = 2**12
"""What an NPZ file adds to its arrays is less than this."""


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
    stems = _check_files(folder, submission)
    about = read_about(folder)
    check_about(about, folder / ABOUT_FILE, submission)
    for stem in stems:
        _check_result(ResultFiles(folder, stem), about, submission)


def is_outdated(identity: Identity) -> str | None:
    """Say what of a result's track, agent, rule or options is no longer today's; None if nothing.

    An outdated result is not wrong, but it no longer compares with others.
    """
    try:
        now = today(
            identity.track,
            identity.agent,
            identity.rule,
            identity.adversary,
            identity.preset,
            identity.options,
            resolved=identity.resolved,
        )
    except UserError as error:
        return shown(str(error))
    changes = differences(identity.model_dump(mode="json"), now.model_dump(mode="json"))
    return shown("; ".join(changes)) or None


def _check_files(folder: Path, submission: bool) -> list[str]:
    """Check names, kinds and sizes of all files, and give what the results' names begin with."""
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
    if ABOUT_FILE not in sizes:
        raise UserError(
            f"Expected {ABOUT_FILE} in {folder}, got none. Make an entry by sada-gym submit."
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
            f"Expected only {ABOUT_FILE} and results in {folder}, got {shown(repr(name))}. "
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
    if name == ABOUT_FILE:
        return ABOUT_FILE
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


def check_about(about: About, path: Path, submission: bool) -> None:
    """Check what an entry says of itself.

    Args:
        about: What it says.
        path: The file that says so, for messages.
        submission: Whether authors and a licence are needed.

    Raises:
        UserError: If something is missing or does not fit.
    """
    blank = [name for name in ("title", "adversary") if not getattr(about, name).strip()]
    if submission:
        blank += [] if about.licence.strip() else ["licence"]
        blank += [] if any(author.strip() for author in about.authors) else ["authors"]
    if blank:
        refuse(path, f"a text as {blank[0]}", "an empty one", "Fill it in")
    if about.licence and not _LICENCE.fullmatch(about.licence):
        mend = "Write one as SPDX names it, such as CC-BY-4.0 or MIT"
        refuse(path, "a licence's SPDX name", repr(about.licence), mend)
    for name in ("paper", "repository"):
        address = getattr(about, name)
        if address and not _ADDRESS.fullmatch(address):
            mend = "Write it in full, as https://doi.org/10.1609/aaai.v34i07.6722, or leave it out"
            refuse(path, f"the address of a page as {name}", repr(address), mend)
    options = parse_json(about.options, path)
    if not isinstance(options, dict):
        refuse(path, "options that are a JSON object", shown(repr(options)))


def _check_result(files: ResultFiles, about: About, submission: bool) -> None:
    refuse_loose(files.claims, MAX_BYTES[CLAIMS])
    result = read_result(files.claims)
    identity = result.identity
    _check_adversary(files, identity, about)
    outdated = is_outdated(identity)
    if submission and outdated:
        raise UserError(
            f"Expected {files.claims} to be of today's track, agent, rule and options, but: "
            f"{outdated.rstrip('.')}. Make the result anew with this version of sada_gym."
        )
    if identity.reference is not None and identity.samples <= NEAREST:
        refuse(files.claims, f"more than {NEAREST} samples of each seed", identity.samples)
    _check_seeds(files, result, submission)
    dimension = None if outdated else find_target(identity.track, identity.agent).dimension
    samples = _read_samples(files, result, dimension)
    for one in result.seeds:
        if one.measures is not None:
            check_samples(files.samples, identity, one.seed, samples[one.seed])
            check_claims(files.claims, identity, one, samples[one.seed])
            if not outdated:
                check_coverage(files.claims, identity, one, samples[one.seed])
    if not submission and files.verified.exists():
        refuse_loose(files.verified, MAX_BYTES[CLAIMS])
        read_verified(files.verified)


def _check_adversary(files: ResultFiles, identity: Identity, about: About) -> None:
    given = {
        "adversary": about.adversary,
        "preset": about.preset,
        "options": parse_json(about.options, files.folder / ABOUT_FILE),
    }
    for name, expected in given.items():
        found = getattr(identity, name)
        if found != expected:
            refuse(
                files.claims,
                f"the {name} of {ABOUT_FILE}, {shown(repr(expected))}",
                shown(repr(found)),
                "One entry is of one adversary with one set of options",
            )
    if (
        not is_ours(identity.adversary)
        and not identity.options.items() <= identity.resolved.items()
    ):
        refuse(files.claims, "resolved options that hold the given ones", "others")


def _check_seeds(files: ResultFiles, result: Result, submission: bool) -> None:
    path, identity = files.claims, result.identity
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
        if one.queries > identity.budget:
            mend = "Spend no more than the rule allows"
            allowed = f"at most {identity.budget:,} queries {where}, the budget of {identity.rule},"
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
    files: ResultFiles, result: Result, dimension: int | None
) -> dict[int, Evaluations]:
    """Read the samples; the file may hardly be larger than the claims make it."""
    path, count = files.samples, result.identity.samples
    claimed = [one.seed for one in result.seeds if one.measures is not None]
    most = MAX_BYTES[SAMPLES]
    if dimension is not None:
        most = min(most, len(claimed) * count * (24 + 4 * dimension) + _ARCHIVE_BYTES)
    size = path.lstat().st_size
    if size > most:
        refuse(path, f"at most {most:,} bytes for {len(claimed)} x {count:,} samples", f"{size:,}")
    samples = read_samples(path)
    if sorted(samples) != claimed:
        found = shown(str(sorted(samples)))
        refuse(path, f"samples of the seeds {shown(str(claimed))}, as claimed,", found)
    for seed, one in samples.items():
        if len(one) != count:
            refuse(path, f"{count:,} samples of seed {seed}", f"{len(one):,}")
        if dimension is not None and one.mu.shape[1] != dimension:
            shape = one.mu.shape
            refuse(path, f"mu of shape ({count}, {dimension}) of seed {seed}", f"{shape}")
    return samples
