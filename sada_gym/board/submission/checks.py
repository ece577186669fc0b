"""The first checks of an entry: everything that can be checked without evaluating anything.

Entries come from strangers. Files are measured before they are read, nothing is unpickled or
imported, and every fault is one sentence.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from sada_gym import __version__
from sada_gym.board.results.entry import (
    CLAIMS,
    METADATA_FILE,
    VERIFIED,
    GroupFiles,
    read_metadata,
)
from sada_gym.board.results.models import EntryMetadata, Result, SeedResult
from sada_gym.board.results.samples import read_samples
from sada_gym.board.submission.current import current_experiment, current_target
from sada_gym.board.submission.files import MAX_BYTES, check_files, check_strict_json, refuse
from sada_gym.errors import UserError
from sada_gym.evaluations import Evaluations
from sada_gym.experiment.adversary import AdversarySpec
from sada_gym.experiment.differences import differences
from sada_gym.experiment.record import Experiment
from sada_gym.foundations.files import as_path, shown
from sada_gym.measures.coverage import NEAREST, fooling_coverage
from sada_gym.measures.rates import attack_fooling_rate, mu_std

_WORD = re.compile(r"[A-Za-z0-9][A-Za-z0-9._+!-]*")
_LICENCE = re.compile(r"[A-Za-z0-9.+-]+( (AND|OR|WITH) [A-Za-z0-9.+-]+)*")
_ADDRESS = re.compile(r"https?://[^\s<>\"'`\\]+")
_ARCHIVE_BYTES = 2**12  # an NPZ file adds less than this to the arrays of a result
_MAX_DIMENSION = 2**12  # more than any application has
_SLACK = 0.01  # of coverage, whose ties other processors may decide differently
_NO_EDITING = "Do not edit claims; make the entry again"


def check_entry(folder: str | Path, *, submission: bool = True) -> None:
    """Check an entry without evaluating anything. A UserError names the first fault.

    A submission must be made on the current tracks, name its authors and its licence, have the
    seeds 0, 1 and so on, and hold nothing verified. An accepted entry may differ in all of that.
    """
    folder = as_path(folder, "an entry")
    groups = [GroupFiles(folder, group) for group in check_files(folder, submission=submission)]
    check_metadata(read_metadata(folder), folder / METADATA_FILE, submission=submission)
    _check_together([(g.claims, result) for g in groups for result in _check_group(g, submission)])


def find_outdated(experiment: Experiment) -> str | None:
    """Say what has changed since in a result's track, agent, rule or options; None if nothing.

    An outdated result is not wrong, but it cannot be compared with current ones.
    """
    target, rule = experiment.target, experiment.protocol.rule
    try:
        current = current_experiment(target.track, target.agent, rule, experiment.adversary)
    except UserError as error:
        return shown(str(error))
    changes = differences(experiment.at(None).model_dump(), current.model_dump())
    return shown("; ".join(changes)) or None


def check_metadata(metadata: EntryMetadata, path: Path, *, submission: bool) -> None:
    """Raise a UserError if entry.toml does not fit; a submission needs authors and a licence."""
    required = {"title": metadata.title}
    if submission:
        required |= {"licence": metadata.licence, "authors": "".join(metadata.authors)}
    for name, text in required.items():
        if not text.strip():
            refuse(f"in {path}", f"a text as {name}", "an empty one", "Fill it in")
    if metadata.licence and not _LICENCE.fullmatch(metadata.licence):
        fix = "Write one as SPDX names it, such as CC-BY-4.0 or MIT"
        refuse(f"in {path}", "a licence's SPDX name", repr(metadata.licence), fix)
    for name, address in (("paper", metadata.paper), ("repository", metadata.repository)):
        if address and not _ADDRESS.fullmatch(address):
            fix = "Write it in full, as https://doi.org/10.1609/aaai.v34i07.6722, or leave it out"
            refuse(f"in {path}", f"the address of a page as {name}", repr(address), fix)


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
            fix = "Make the result again with this version of sada_gym"
            current = f"{place} to be of today's track, agent, rule and options"
            refuse(f"in {files.claims}", current, f"other ones: {changes.rstrip('.')}", fix)
        _check_result(files.claims, result, submission)
    samples = _read_samples(files, results, dimensions)
    for result in results:
        experiment, place = result.experiment, result.experiment.place
        for claims in result.seeds:
            if claims.measures is None:
                continue
            rows, seed = samples[place][claims.seed], f"for seed {claims.seed} of {place} in "
            _check_samples(f"{seed}{files.samples}", rows)
            _check_claims(f"{seed}{files.claims}", experiment, claims, rows)
            if place in dimensions:
                _check_coverage(f"{seed}{files.claims}", experiment, claims, rows)
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
        fix = "Submit all of them, so that nobody can choose the best ones"
        refuse(where, "the seeds 0, 1, 2 and so on", shown(str(seeds)), fix)
    for claims in result.seeds:
        _check_seed(f"for seed {claims.seed} of {place}", experiment, claims)


def _check_seed(where: str, experiment: Experiment, claims: SeedResult) -> None:
    protocol, search = experiment.protocol, claims.search
    if (claims.measures is None) == (claims.error is None):
        got = "neither" if claims.measures is None else "both"
        refuse(where, "either measures or an error", got)
    if claims.queries > protocol.budget:
        fix = "Spend no more than the rule allows"
        allowed = f"at most {protocol.budget:,} queries, the budget of {protocol.rule},"
        refuse(where, allowed, f"{claims.queries:,}", fix)
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


def _check_samples(where: str, samples: Evaluations) -> None:
    """Check that samples lie in the box, and their scores between 0 and 1."""
    outside = ~(np.abs(samples.mu) <= 1.0)  # a NaN is not <= 1 either
    if outside.any():
        refuse(where, "mu within [-1, 1]", samples.mu[outside][0])
    outside = ~((samples.score >= 0.0) & (samples.score <= 1.0))
    if outside.any():
        refuse(where, "scores within [0, 1]", samples.score[outside][0])


def _check_claims(
    where: str, experiment: Experiment, claims: SeedResult, samples: Evaluations
) -> None:
    """Check what follows from the samples alone."""
    measures = claims.measures
    assert measures is not None
    rate = attack_fooling_rate(samples.score, experiment.target.fooling_threshold)
    low, high = measures.afr_interval_95
    for name, claimed, value in (
        ("fooled", measures.fooled, rate.fooled),
        ("afr", measures.afr, rate.rate),
        ("mean_score", measures.mean_score, float(samples.score.mean())),
        ("mu_std", measures.mu_std, mu_std(samples.mu)),
        ("afr_interval_95.0", low, rate.low),
        ("afr_interval_95.1", high, rate.high),
    ):
        if not math.isclose(claimed, value, rel_tol=1e-9, abs_tol=1e-9):
            refuse(where, f"{name} = {value}, as the samples give it,", claimed, _NO_EDITING)
    feasible, count = measures.feasible, experiment.protocol.samples
    if feasible is not None and not feasible.fooled <= feasible.worlds <= count:
        got = f"{feasible.fooled:,} of {feasible.worlds:,}"
        refuse(where, f"at most {count:,} feasible worlds", got)
    covered = (measures.density, measures.coverage, measures.relative_coverage)
    if experiment.target.reference is None and any(value is not None for value in covered):
        refuse(where, "no coverage, as there is no reference set,", "one")
    if measures.coverage is not None and measures.coverage > 1:
        refuse(where, "a coverage of at most 1", measures.coverage)
    smallest = min(_numbers(claims.model_dump(mode="json")))
    if smallest < 0:
        refuse(where, "no negative numbers", smallest)


def _check_coverage(
    where: str, experiment: Experiment, claims: SeedResult, samples: Evaluations
) -> None:
    """Compare coverage and density with those of today's reference set."""
    measures, attacked = claims.measures, experiment.target
    points = current_target(attacked.track, attacked.agent).fooling_set
    if measures is None or points is None:
        return
    fooled = samples.fooled(attacked.fooling_threshold)
    computed = fooling_coverage(samples.mu, fooled, points, seed=claims.seed)
    for name, claimed, value in (
        ("coverage", measures.coverage, computed.coverage),
        ("density", measures.density, computed.density),
    ):
        if claimed is None or abs(claimed - value) > _SLACK * max(1.0, value):
            refuse(where, f"{name} = {value}, as the samples give it,", claimed, _NO_EDITING)


def _numbers(value: Any) -> list[float]:
    if isinstance(value, dict):
        return _numbers(list(value.values()))
    if isinstance(value, list):
        return [number for item in value for number in _numbers(item)]
    return [value] if isinstance(value, int | float) else []
