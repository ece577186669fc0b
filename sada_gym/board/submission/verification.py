"""The verifier scores the samples of entries again, on evaluation seeds that nobody knew.

Claims do not enter what it measures. It compares them with its own figures, and flags whatever else
speaks against a result: see `sada_gym.board.submission.flags`.
"""

from __future__ import annotations

import functools
import hashlib
import itertools
import json
from collections.abc import Iterable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from sada_gym.board.results.entry import SAMPLES, Entry, EntryResult, GroupFiles, read_entry
from sada_gym.board.results.models import SeedResult, Verified, VerifiedSeed
from sada_gym.board.results.samples import read_samples
from sada_gym.board.submission.checks import check_entry, find_outdated
from sada_gym.board.submission.flags import Evidence, SeedEvidence, find_flags
from sada_gym.board.submission.scoring import measure_samples, score
from sada_gym.errors import UserError
from sada_gym.evaluations import Evaluations, seed_of
from sada_gym.experiment.record import Experiment, place_of
from sada_gym.experiment.target import OpenTarget
from sada_gym.parameters import Mu

State = Literal["verified", "unchanged", "outdated", "differs", "refused"]


@dataclass(frozen=True)
class Finding:
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
) -> Iterator[Finding]:
    """Verify entries, and write what is found beside their claims.

    An entry that is refused does not stop the others. Results of one track and agent follow each
    other, whatever their entries; the findings do not depend on this order.

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
    results: list[tuple[Entry, EntryResult]] = []
    for folder in folders:
        try:
            check_entry(folder, submission=False)
            entry = read_entry(folder)
        except UserError as error:
            yield Finding(folder.absolute().name, "", "refused", str(error))
        else:
            results += [(entry, result) for result in entry.results.values()]
    for _, same_target in itertools.groupby(sorted(results, key=_attacked), _attacked):
        with ExitStack() as stack:
            target: OpenTarget | None = None
            for entry, result in same_target:
                finding = functools.partial(Finding, entry.metadata.name, result.place)
                experiment, old = result.claimed.experiment, result.verified
                chosen = old.nonce if nonce is None and old else nonce
                if outdated := find_outdated(experiment):
                    yield finding("outdated", outdated)
                    continue
                if chosen is None:
                    yield finding("differs", "nothing of these samples is verified")
                    continue
                if old and not again and not check and (missing or old.nonce == chosen):
                    yield finding("unchanged", verified=old)
                    continue
                # what was verified under another name is checked under that name
                salt = old.salt if check and old else (entry.metadata.name, result.claimed.sha256)
                try:
                    if target is None:
                        target = stack.enter_context(experiment.target.open(workers=workers))
                    new = _verify_result(target, entry, result, salt, chosen, against)
                    if not check:
                        GroupFiles(entry.folder, result.group).add_verified(result.place, new)
                except UserError as error:
                    yield finding("refused", str(error))
                    continue
                if check and old != new:
                    reason = "the file does not hold what the verifier finds"
                    yield finding("differs", reason, new)
                else:
                    yield finding("unchanged" if check else "verified", verified=new)


def _attacked(listed: tuple[Entry, EntryResult]) -> tuple[str, str]:
    target = listed[1].claimed.experiment.target
    return target.track, target.agent


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
    experiment = result.claimed.experiment
    seeds = tuple(
        _seed_evidence(target, claims, result.samples[claims.seed], salt, nonce)
        for claims in result.claimed.seeds
        if claims.measures is not None
    )
    folder = entry.folder.absolute().parent if against is None else against
    neighbours = _neighbours(folder, entry.metadata.name, experiment, target.dimension)
    evidence = Evidence(experiment, seeds, target.reference, neighbours)
    measured = [VerifiedSeed(seed=seed.claimed.seed, measures=seed.measures) for seed in seeds]
    flags = find_flags(evidence)
    return Verified.make(result.claimed, result.samples, salt, nonce, measured, flags)


def _seed_evidence(
    target: OpenTarget, claimed: SeedResult, samples: Evaluations, salt: tuple[str, str], nonce: str
) -> SeedEvidence:
    fresh = fresh_seeds(salt, nonce, claimed.seed, len(samples))
    again, measures = measure_samples(target, samples.mu, fresh, seed=claimed.seed)
    uniform = None
    if target.reference is None:
        mu = _uniform(json.dumps([*salt, nonce, claimed.seed]), samples.mu.shape)
        uniform = score(target, mu, fresh)
    return SeedEvidence(claimed, samples, again, uniform, measures)


def _uniform(text: str, shape: tuple[int, ...]) -> Mu:
    seed = int.from_bytes(hashlib.sha256(text.encode()).digest()[:8], "big")
    return np.random.default_rng(seed).uniform(-1.0, 1.0, shape).astype(np.float32)


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
