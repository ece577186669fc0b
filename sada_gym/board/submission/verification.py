"""The verifier scores the samples of entries again, on evaluation seeds that nobody knew.

Claims do not enter what it measures. It compares them with its own figures, and flags whatever else
speaks against a result: see `sada_gym.board.submission.flags`.
"""

from __future__ import annotations

import hashlib
import itertools
import json
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Literal

import numpy as np

from sada_gym.board.results.entry import SAMPLES, Entry, EntryResult, GroupFiles, read_entry
from sada_gym.board.results.models import Verified, VerifiedSeed
from sada_gym.board.results.samples import read_samples
from sada_gym.board.submission.checks import check_entry, find_outdated
from sada_gym.board.submission.flags import Evidence, SeedEvidence, find_flags
from sada_gym.board.submission.scoring import measure_samples, score
from sada_gym.errors import UserError
from sada_gym.evaluations import seed_of
from sada_gym.experiment.record import Experiment, place_of
from sada_gym.experiment.target import OpenTarget
from sada_gym.parameters import Mu

State = Literal["verified", "unchanged", "outdated", "differs", "refused"]


@dataclass(frozen=True)
class Verdict:
    """What became of one result, or of an entry that was refused, which has no place.

    Attributes:
        state: `verified` now; `unchanged`, because it was verified with this nonce before;
            `outdated`, so that nothing was evaluated; `differs` from the file that is there, where
            files are only checked; or `refused`.
        reason: Why it is outdated, differs or was refused.
        verified: What the verifier found; None where it did not evaluate.
    """

    entry: str
    place: str
    state: State
    reason: str = ""
    verified: Verified | None = None


def verify(
    folders: Iterable[Path],
    nonce: str | None,
    *,
    workers: int = 1,
    again: bool = False,
    missing: bool = False,
    check: bool = False,
    against: Path | None = None,
) -> Iterator[Verdict]:
    """Verify entries, and write what is found beside their claims.

    An entry that is refused does not stop the others. What needs no evaluation comes first. Then
    results of one track and agent follow each other, whatever their entries; the findings do not
    depend on this order.

    Args:
        folders: The entries' folders.
        nonce: A text that the submitters did not know; it makes the evaluation seeds fresh. None,
            which needs `check`, takes that of each file.
        workers: The number of processes that evaluate; the findings do not depend on it.
        again: Whether to evaluate results again that were verified with this nonce.
        missing: Whether to leave alone what was verified with any nonce.
        check: Whether to compare with the files that are there instead of writing any.
        against: The folder of the entries whose samples are compared; None takes each entry's own
            neighbours.

    Raises:
        UserError: If there is no nonce, and files are not only checked.
        WorkerError: If a process that evaluates died.
    """
    if nonce is None and not check:
        raise UserError(
            "Expected a nonce, got none. Choose a text that nobody could know before the entries "
            "were submitted."
        )
    due: list[tuple[Entry, EntryResult, str]] = []
    for folder in folders:
        try:
            check_entry(folder, submission=False)
            entry = read_entry(folder)
        except UserError as error:
            yield Verdict(folder.absolute().name, "", "refused", str(error))
            continue
        for result in entry.results.values():
            old, verdict = result.verified, partial(Verdict, entry.metadata.name, result.place)
            chosen = old.nonce if nonce is None and old else nonce
            if outdated := find_outdated(result.experiment):
                yield verdict("outdated", outdated)
            elif chosen is None:
                yield verdict("differs", "nothing of these samples is verified")
            elif old and not (again or check) and (missing or old.nonce == chosen):
                yield verdict("unchanged", verified=old)
            else:
                due.append((entry, result, chosen))
    for _, listed in itertools.groupby(sorted(due, key=_attacked), _attacked):
        first, *others = listed
        try:
            opened = first[1].experiment.target.open(workers=workers)
        except UserError as error:
            for entry, result, _ in (first, *others):
                yield Verdict(entry.metadata.name, result.place, "refused", str(error))
            continue
        with opened:
            for entry, result, chosen in (first, *others):
                yield _judge(opened, entry, result, chosen, check, against)


def _attacked(listed: tuple[Entry, EntryResult, str]) -> tuple[str, str]:
    target = listed[1].experiment.target
    return target.track, target.agent


def _judge(
    target: OpenTarget,
    entry: Entry,
    result: EntryResult,
    nonce: str,
    check: bool,
    against: Path | None,
) -> Verdict:
    """Verify a result; write what is found, or compare it with what the file has."""
    old, verdict = result.verified, partial(Verdict, entry.metadata.name, result.place)
    # what was verified under another name is checked under that name
    salt = old.salt if check and old else (entry.metadata.name, result.claimed.sha256)
    try:
        new = _verify_result(target, entry, result, salt, nonce, against)
        if not check:
            GroupFiles(entry.folder, result.experiment.group).add_verified(result.place, new)
    except UserError as error:
        return verdict("refused", str(error))
    if check and old != new:
        return verdict("differs", "the file does not hold what the verifier finds", new)
    return verdict("unchanged" if check else "verified", verified=new)


def fresh_seeds(salt: tuple[str, str], nonce: str, seed: int, count: int) -> list[int]:
    """Return the evaluation seeds of a seed's samples: a hash of the salt, the nonce and the seed.

    They belong to the stream `test`, as the claimed ones do. Seeds of one stream have their lowest
    bits in common: should a world depend on these, seeds of another stream would not be
    exchangeable with the claimed ones.
    """
    texts = (json.dumps([*salt, nonce, seed, row]) for row in range(count))
    return [seed_of(hashlib.sha256(t.encode()).digest()[:4], "test") for t in texts]


def _verify_result(
    target: OpenTarget,
    entry: Entry,
    result: EntryResult,
    salt: tuple[str, str],
    nonce: str,
    against: Path | None,
) -> Verified:
    experiment, seeds, measured = result.experiment, [], []
    for claims in result.claimed.seeds:
        if claims.measures is None:
            continue
        samples, text = result.samples[claims.seed], json.dumps([*salt, nonce, claims.seed])
        fresh = fresh_seeds(salt, nonce, claims.seed, len(samples))
        again, measures = measure_samples(target, samples.mu, fresh, seed=claims.seed)
        uniform = None
        if target.reference is None:
            seed = int.from_bytes(hashlib.sha256(text.encode()).digest()[:8], "big")
            mu = np.random.default_rng(seed).uniform(-1.0, 1.0, samples.mu.shape)
            uniform = score(target, mu.astype(np.float32), fresh)
        seeds.append(SeedEvidence(claims.seed, samples, again, uniform))
        measured.append(VerifiedSeed(seed=claims.seed, measures=measures))
    folder = entry.folder.absolute().parent if against is None else against
    neighbours = _neighbours(folder, entry.metadata.name, experiment, target.dimension)
    flags = find_flags(Evidence(experiment, seeds, target.reference, neighbours))
    return Verified.make(result.claimed, result.samples, salt, nonce, measured, flags)


def _neighbours(folder: Path, name: str, experiment: Experiment, dimension: int) -> dict[str, Mu]:
    """Read the samples that other entries have on a track and agent; broken ones are left out."""
    target = experiment.target
    prefix = f"{place_of(target.track, target.agent, '')}."
    neighbours = {}
    for path in sorted(folder.glob(f"*/{experiment.group}{SAMPLES}")):
        other = path.parent.name
        if other == name or other.startswith("."):
            continue
        try:
            places = read_samples(path)
        except UserError:
            continue
        arrays = [
            rows.mu
            for place, samples in places.items()
            if place.startswith(prefix)
            for rows in samples.values()
            if rows.mu.shape[1] == dimension and np.isfinite(rows.mu).all()
        ]
        if arrays:
            neighbours[other] = np.concatenate(arrays)
    return neighbours
