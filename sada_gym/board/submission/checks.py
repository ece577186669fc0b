"""The first checks of an entry: everything that can be checked without evaluating anything.

Entries come from strangers. Files are measured before they are read, nothing is unpickled or
imported, and every fault is one sentence.
"""

from __future__ import annotations

import itertools
import os
import re
import stat
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from sada_gym import __version__
from sada_gym.board.results.entry import (
    CLAIMS,
    METADATA_FILE,
    SAMPLES,
    VERIFIED,
    GroupFiles,
    read_metadata,
)
from sada_gym.board.results.models import EntryMetadata, Result, SeedResult
from sada_gym.board.results.samples import read_samples
from sada_gym.board.submission.claims import check_claims, check_coverage, check_samples, refuse
from sada_gym.board.submission.current import current_experiment, current_target
from sada_gym.board.submission.strict_json import check_strict_json
from sada_gym.errors import UserError
from sada_gym.evaluations import Evaluations
from sada_gym.experiment.adversary import AdversarySpec
from sada_gym.experiment.differences import differences
from sada_gym.experiment.record import Experiment
from sada_gym.foundations.files import as_path, file_errors, shown
from sada_gym.measures.coverage import NEAREST

MAX_FILES = 100  #: The most files of an entry.
MAX_BYTES = {METADATA_FILE: 2**16, CLAIMS: 2**24, SAMPLES: 2**26, VERIFIED: 2**24}
"""The most bytes of entry.toml, of the JSON of results, of their samples, and of findings."""

MAX_ENTRY_BYTES = 2**27  #: The most bytes of all files of an entry.

_STEM = re.compile(r"[A-Za-z0-9][A-Za-z0-9._+-]{0,150}")
_WORD = re.compile(r"[A-Za-z0-9][A-Za-z0-9._+!-]*")
_LICENCE = re.compile(r"[A-Za-z0-9.+-]+( (AND|OR|WITH) [A-Za-z0-9.+-]+)*")
_ADDRESS = re.compile(r"https?://[^\s<>\"'`\\]+")
_RESERVED = re.compile(r"(con|prn|aux|nul|com\d|lpt\d)(\..*)?")  # no file of Windows
_ARCHIVE_BYTES = 2**12  # an NPZ file adds less than this to the arrays of a result
_MAX_DIMENSION = 2**12  # more than any application has


def check_entry(folder: str | Path, *, submission: bool = True) -> None:
    """Check an entry without evaluating anything; a UserError names the first fault.

    A submission must be of today's tracks, name its authors and its licence, have the seeds 0, 1
    and so on, and hold nothing verified. An entry that was accepted earlier may be outdated.
    """
    folder = as_path(folder, "an entry")
    groups = [GroupFiles(folder, group) for group in check_files(folder, submission=submission)]
    check_metadata(read_metadata(folder), folder / METADATA_FILE, submission=submission)
    _check_together([(g.claims, result) for g in groups for result in _check_group(g, submission)])


def find_outdated(experiment: Experiment) -> str | None:
    """Say what of a result's track, agent, rule or options has changed since; None if nothing.

    An outdated result is not wrong, but it no longer compares with others.
    """
    target, rule = experiment.target, experiment.protocol.rule
    try:
        current = current_experiment(target.track, target.agent, rule, experiment.adversary)
    except UserError as error:
        return shown(str(error))
    changes = differences(experiment.at(None).model_dump(), current.model_dump())
    return shown("; ".join(changes)) or None


def check_files(folder: Path, *, submission: bool) -> list[str]:
    """Check names, kinds and sizes of an entry's files, and return the names of its groups."""
    where = f"in {folder}"
    with file_errors("read", folder):
        name = folder.absolute().name
        if not _STEM.fullmatch(name) or _RESERVED.fullmatch(name):
            allowed = "to be named by small letters, digits and - + . _"
            refuse(allowed, "an entry's folder", shown(repr(name)), "Rename it")
        if folder.is_symlink() or not stat.S_ISDIR(folder.lstat().st_mode):
            raise UserError(f"Expected the folder of an entry, got {folder}, which is no folder.")
        with os.scandir(folder) as listed:
            files = list(itertools.islice(listed, MAX_FILES + 1))
        if len(files) > MAX_FILES:
            refuse(where, f"at most {MAX_FILES:,} files", "more", "Submit fewer results")
        sizes = {file.name: _measure_file(folder, file, submission) for file in files}
    if METADATA_FILE not in sizes:
        refuse(where, METADATA_FILE, "none", "Make an entry by sada-gym submit")
    limit, total = MAX_ENTRY_BYTES >> 20, sum(sizes.values())
    if total > MAX_ENTRY_BYTES:
        refuse(where, f"at most {limit} MiB", f"{total >> 20} MiB", "Submit fewer results")
    return _check_pairs(folder, sizes)


def _measure_file(folder: Path, file: os.DirEntry[str], submission: bool) -> int:
    path, ending = folder / file.name, _ending(file.name)
    if ending is None:
        only = f"only {METADATA_FILE} and results"
        refuse(f"in {folder}", only, shown(repr(file.name)), "Remove it")
    status, limit = file.stat(follow_symlinks=False), MAX_BYTES[ending]
    if not stat.S_ISREG(status.st_mode):
        got, mend = "a link, a folder or a device", "Put the file itself there"
        refuse(f"in {path}", "a regular file", got, mend)
    if submission and ending == VERIFIED:
        mend = "Remove it; the verifier writes such files"
        refuse("in a submission", "no results of the verifier", path, mend)
    if status.st_size > limit:
        refuse(f"in {path}", f"at most {limit:,} bytes", f"{status.st_size:,}")
    return status.st_size


def _ending(name: str) -> str | None:
    if name == METADATA_FILE:
        return METADATA_FILE
    for ending in (VERIFIED, CLAIMS, SAMPLES):
        if name.endswith(ending) and _STEM.fullmatch(name.removesuffix(ending)):
            return ending
    return None


def _check_pairs(folder: Path, names: Iterable[str]) -> list[str]:
    endings: dict[str, set[str]] = {}
    for name in names:
        if (ending := _ending(name)) not in (None, METADATA_FILE):
            endings.setdefault(name.removesuffix(ending), set()).add(ending)
    if not set().union(*endings.values()) & {CLAIMS, SAMPLES}:
        refuse(f"in {folder}", "at least one result", "none")
    for stem, present in sorted(endings.items()):
        for ending in (CLAIMS, SAMPLES):
            if ending not in present:
                beside, mend = f"beside {stem}{min(present)}", "Add it, or remove the other file"
                refuse(f"in {folder}", f"{stem}{ending} {beside}", "none", mend)
    return sorted(endings)


def check_metadata(metadata: EntryMetadata, path: Path, *, submission: bool) -> None:
    """Raise a UserError if entry.toml does not fit; a submission needs authors and a licence."""
    required = {"title": metadata.title}
    if submission:
        required |= {"licence": metadata.licence, "authors": "".join(metadata.authors)}
    for name, text in required.items():
        if not text.strip():
            refuse(f"in {path}", f"a text as {name}", "an empty one", "Fill it in")
    if metadata.licence and not _LICENCE.fullmatch(metadata.licence):
        mend = "Write one as SPDX names it, such as CC-BY-4.0 or MIT"
        refuse(f"in {path}", "a licence's SPDX name", repr(metadata.licence), mend)
    for name, address in (("paper", metadata.paper), ("repository", metadata.repository)):
        if address and not _ADDRESS.fullmatch(address):
            mend = "Write it in full, as https://doi.org/10.1609/aaai.v34i07.6722, or leave it out"
            refuse(f"in {path}", f"the address of a page as {name}", repr(address), mend)


def _check_group(files: GroupFiles, submission: bool) -> tuple[Result, ...]:
    check_strict_json(files.claims, MAX_BYTES[CLAIMS])
    results = files.read_claims()
    if not results:
        refuse(f"in {files.claims}", "at least one result", "none")
    dimensions: dict[str, int] = {}
    for result in results:
        place, target = result.experiment.place, result.experiment.target
        changes = find_outdated(result.experiment)
        if not changes:
            dimensions[place] = current_target(target.track, target.agent).dimension
        elif submission:
            mend = "Make the result anew with this version of sada_gym"
            current = f"{place} to be of today's track, agent, rule and options"
            refuse(f"in {files.claims}", current, f"other ones: {changes.rstrip('.')}", mend)
        _check_result(files.claims, result, submission)
    samples = _read_samples(files, results, dimensions)
    for result in results:
        experiment, place = result.experiment, result.experiment.place
        for claims in result.seeds:
            if claims.measures is None:
                continue
            rows, seed = samples[place][claims.seed], f"for seed {claims.seed} of {place} in "
            check_samples(f"{seed}{files.samples}", rows)
            check_claims(f"{seed}{files.claims}", experiment, claims, rows)
            if place in dimensions:
                check_coverage(f"{seed}{files.claims}", experiment, claims, rows)
    if not submission and files.verified.exists():
        check_strict_json(files.verified, MAX_BYTES[VERIFIED])
        places = [result.experiment.place for result in results]
        unknown = sorted(set(files.read_verified()) - set(places))
        if unknown:
            expected = f"findings of {shown(', '.join(places))} alone"
            refuse(f"in {files.verified}", expected, shown(repr(unknown[0])), "Verify it again")
    return results


def _check_result(path: Path, result: Result, submission: bool) -> None:
    experiment = result.experiment
    place = f"{experiment.place} in {path}"
    where = f"for {place}"
    samples, adversary = experiment.protocol.samples, experiment.adversary
    if not adversary.name.strip():
        refuse(where, "a text as adversary", "an empty one", "Fill it in")
    if experiment.target.reference is not None and samples <= NEAREST:
        refuse(where, f"more than {NEAREST} samples of each seed", samples)
    resolved = adversary.resolved or {}
    if not adversary.is_ours and not adversary.options.items() <= resolved.items():
        refuse(where, "resolved options that hold the given ones", "others")
    seeds = [claims.seed for claims in result.seeds]
    if not seeds:
        refuse(where, "at least one seed", "none")
    if submission and seeds != list(range(len(seeds))):
        mend = "Submit all of them, so that nobody can choose the best ones"
        refuse(where, "the seeds 0, 1, 2 and so on", shown(str(seeds)), mend)
    for claims in result.seeds:
        _check_seed(f"for seed {claims.seed} of {place}", experiment, claims)


def _check_seed(where: str, experiment: Experiment, claims: SeedResult) -> None:
    protocol, search = experiment.protocol, claims.search
    if (claims.measures is None) == (claims.error is None):
        got = "neither" if claims.measures is None else "both"
        refuse(where, "either measures or an error", got)
    if claims.queries > protocol.budget:
        mend = "Spend no more than the rule allows"
        allowed = f"at most {protocol.budget:,} queries, the budget of {protocol.rule},"
        refuse(where, allowed, f"{claims.queries:,}", mend)
    if search is not None and (search.queries != claims.queries or search.fooled > claims.queries):
        got = f"{search.fooled:,} fooling ones of {search.queries:,}"
        refuse(where, f"a search of {claims.queries:,} queries", got)
    for name, version in claims.packages.items():
        if not _WORD.fullmatch(name) or not _WORD.fullmatch(version):
            refuse(where, "names and versions of packages", f"{name!r}: {version!r}")
    made_by = claims.packages.get("sada_gym")
    if made_by is None:
        refuse(where, "the version of sada_gym among the packages", "none")
    if not _release(made_by) or _release(made_by) > _release(__version__):
        refuse(where, f"sada_gym {__version__} or older", made_by, "Install the newest sada_gym")


def _release(version: str) -> tuple[int, ...]:
    numbers = re.match(r"\d+(\.\d+)*", version)
    return tuple(int(number) for number in numbers[0].split(".")) if numbers else ()


def _check_together(results: Sequence[tuple[Path, Result]]) -> None:
    first_path, first = results[0][0], results[0][1].experiment
    places: dict[str, Path] = {}
    for path, result in results:
        place, adversary = result.experiment.place, result.experiment.adversary
        check_same_adversary(path, adversary, first_path, first.adversary)
        other = places.setdefault(place, path)
        if other != path:
            refuse(f"in {path.parent}", f"{place} once", f"it in {other} and {path}")


def check_same_adversary(
    source: object, adversary: AdversarySpec, other_source: object, other: AdversarySpec
) -> None:
    """Raise a UserError if results from two sources differ in adversary, preset or options."""
    for name, got, expected in (
        ("adversary", adversary.name, other.name),
        ("preset", adversary.preset, other.preset),
        ("options", adversary.options, other.options),
    ):
        if got != expected:
            raise UserError(
                "Expected all results of an entry to be of one adversary with one set of options, "
                f"got the {name} {shown(repr(got))} in {source} beside {shown(repr(expected))} in "
                f"{other_source}. Submit them as two entries."
            )


def _read_samples(
    files: GroupFiles, results: Sequence[Result], dimensions: Mapping[str, int]
) -> dict[str, dict[int, Evaluations]]:
    """Read the samples; the file may hardly be larger than the claims make it."""
    path, limit = files.samples, _ARCHIVE_BYTES
    claimed: dict[str, list[int]] = {}
    for result in results:
        place = result.experiment.place
        seeds = [claims.seed for claims in result.seeds if claims.measures is not None]
        if seeds:
            claimed[place] = seeds
        row = 8 + 4 * dimensions.get(place, _MAX_DIMENSION)
        limit += _ARCHIVE_BYTES + len(seeds) * (8 + result.experiment.protocol.samples * row)
    size = path.lstat().st_size
    if size > limit:
        count = sum(map(len, claimed.values()))
        allowed = f"at most {limit:,} bytes for the samples of {count} seeds"
        refuse(f"in {path}", allowed, f"{size:,}")
    samples = read_samples(path)
    if list(samples) != list(claimed):
        got = shown(str(list(samples)))
        refuse(f"in {path}", f"samples of {shown(str(list(claimed)))}, as claimed,", got)
    for result in results:
        place, count = result.experiment.place, result.experiment.protocol.samples
        where = f"for {place} in {path}"
        if list(samples.get(place, ())) != claimed.get(place, []):
            got = shown(str(list(samples[place])))
            refuse(where, f"samples of the seeds {shown(str(claimed[place]))}, as claimed,", got)
        for rows in samples.get(place, {}).values():
            expected = (count, dimensions.get(place, rows.mu.shape[1]))
            if rows.mu.shape != expected:
                refuse(where, f"mu of shape {expected} of each seed", rows.mu.shape)
    return samples
