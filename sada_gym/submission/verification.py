"""The verifier scores the samples of entries again, on evaluation seeds that nobody knew.

Claims do not enter what it measures. It compares them with its own figures, and flags whatever else
speaks against a result: see `sada_gym.submission.flags`.
"""

from __future__ import annotations

import functools
import hashlib
import json
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from typing_extensions import Self

from sada_gym.errors import UserError
from sada_gym.evaluations import Evaluations, seed_of
from sada_gym.experiment.record import Experiment, place_of
from sada_gym.experiment.target import OpenTarget, Target
from sada_gym.parameters import Mu
from sada_gym.results.entry import SAMPLES, Entry, GroupFiles, read_entry
from sada_gym.results.models import SeedResult, Verified, VerifiedSeed
from sada_gym.results.samples import read_samples
from sada_gym.submission.checks import check_entry, find_outdated
from sada_gym.submission.flags import Evidence, SeedEvidence, find_flags
from sada_gym.submission.scoring import measure_samples, score

State = Literal["verified", "unchanged", "outdated", "differs", "refused"]


@dataclass(frozen=True)
class Finding:
    """What became of one result, or of an entry that was refused.

    Attributes:
        entry: The entry's name.
        place: The place of the result in the entry; empty for a refused entry.
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
    entries = []
    for folder in folders:
        try:
            check_entry(folder, submission=False)
            entries.append(read_entry(folder))
        except UserError as error:
            yield Finding(folder.absolute().name, "", "refused", str(error))
    with Verifier(workers=workers, against=against) as verifier:
        for entry, place in _by_target(entries):
            finding = functools.partial(Finding, entry.metadata.name, place)
            result = entry.results[place]
            old = result.verified
            chosen = old.nonce if nonce is None and old is not None else nonce
            outdated = find_outdated(result.claimed.experiment)
            if outdated:
                yield finding("outdated", outdated)
            elif chosen is None:
                yield finding("differs", "nothing of these samples is verified")
            elif old and not again and not check and (missing or old.nonce == chosen):
                yield finding("unchanged", verified=old)
            else:
                # what was verified under another name is checked under that name
                salt = old.salt if check and old else None
                try:
                    new = verifier.verify(entry, place, chosen, salt=salt)
                    if not check:
                        GroupFiles(entry.folder, result.group).add_verified(place, new)
                except UserError as error:
                    yield finding("refused", str(error))
                    continue
                if check and old != new:
                    reason = "the file does not hold what the verifier finds"
                    yield finding("differs", reason, new)
                else:
                    yield finding("unchanged" if check else "verified", verified=new)


def _by_target(entries: Sequence[Entry]) -> list[tuple[Entry, str]]:
    """List all results so that those of one track and agent follow each other."""

    def key(listed: tuple[Entry, str]) -> tuple[str, str]:
        entry, place = listed
        target = entry.results[place].claimed.experiment.target
        return target.track, target.agent

    return sorted(((entry, place) for entry in entries for place in entry.results), key=key)


def fresh_seeds(salt: tuple[str, str], nonce: str, seed: int, count: int) -> list[int]:
    """Return the evaluation seeds of a seed's samples: a hash of the salt, the nonce and the seed.

    They belong to the stream `test`, as the claimed ones do. Seeds of one stream have their lowest
    bits in common: should a world depend on these, seeds of another stream would not be
    exchangeable with the claimed ones.
    """
    texts = (json.dumps([*salt, nonce, seed, row]) for row in range(count))
    return [seed_of(hashlib.sha256(t.encode()).digest()[:4], "test") for t in texts]


class Verifier:
    """Scores samples again; it keeps one track with one agent open at a time.

    Args:
        workers: The number of processes that evaluate.
        against: The folder of the entries whose samples are compared; None takes the neighbours of
            each entry.
    """

    def __init__(self, *, workers: int = 1, against: Path | None = None) -> None:
        self._workers, self._against = workers, against
        self._opened: OpenTarget | None = None

    def __enter__(self) -> Self:
        """Return itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """Close what is open."""
        self.close()

    def close(self) -> None:
        """Stop the workers and close the application."""
        opened, self._opened = self._opened, None
        if opened is not None:
            opened.close()

    def verify(
        self, entry: Entry, place: str, nonce: str, *, salt: tuple[str, str] | None = None
    ) -> Verified:
        """Score the samples of a result again, each once, and measure them.

        Args:
            entry: The entry, which passed `check_entry`.
            place: The place of the result in the entry.
            nonce: What makes the evaluation seeds fresh.
            salt: The names that go into them; None takes those of the entry and of the result.

        Raises:
            UserError: If the track or its reference set cannot be opened.
        """
        result = entry.results[place]
        experiment = result.claimed.experiment
        salt = salt or (entry.metadata.name, result.claimed.sha256)
        target = self._open(experiment.target)
        seeds = tuple(
            _seed_evidence(target, claims, result.samples[claims.seed], salt, nonce)
            for claims in result.claimed.seeds
            if claims.measures is not None
        )
        folder = entry.folder.absolute().parent if self._against is None else self._against
        neighbours = _neighbours(folder, entry.metadata.name, experiment, target.dimension)
        evidence = Evidence(experiment, seeds, target.reference, neighbours)
        return Verified.make(
            result.claimed,
            result.samples,
            salt,
            nonce,
            (VerifiedSeed(seed=seed.claimed.seed, measures=seed.measures) for seed in seeds),
            find_flags(evidence),
        )

    def _open(self, target: Target) -> OpenTarget:
        if self._opened is None or self._opened.target != target:
            self.close()
            self._opened = target.open(workers=self._workers)
        return self._opened


def _seed_evidence(
    target: OpenTarget, claimed: SeedResult, samples: Evaluations, salt: tuple[str, str], nonce: str
) -> SeedEvidence:
    """Score and measure the samples of one seed on fresh evaluation seeds."""
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
