"""The verifier scores the samples of entries again, on evaluation seeds that nobody knew.

Claims do not enter what it measures. It compares them with its own figures, and flags whatever else
speaks against a result: see `sada_gym.submission.flags`.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from typing_extensions import Self

from sada_gym.errors import UserError
from sada_gym.evaluation.evaluator import Evaluator
from sada_gym.evaluations import Evaluations, seed_of
from sada_gym.experiment.assemble import RunTarget
from sada_gym.experiment.ideal import Ideal
from sada_gym.experiment.measure import feasible_rate, measure
from sada_gym.measures.reference import load_reference
from sada_gym.parameters import Mu
from sada_gym.submission.checks import check_entry, is_outdated
from sada_gym.submission.entry import SAMPLES, Entry, read_entry, write_verified
from sada_gym.submission.flags import Evidence, SeedEvidence, find_flags
from sada_gym.submission.models import Identity, Verified, VerifiedSeed, result_stem
from sada_gym.submission.samples import read_samples

State = Literal["verified", "unchanged", "outdated", "differs", "refused"]


@dataclass(frozen=True)
class Finding:
    """What became of one result, or of an entry that was refused.

    Attributes:
        entry: The entry's name.
        stem: What the names of the result's files begin with; empty for a refused entry.
        state: `verified` now; `unchanged`, because it was verified with this nonce before;
            `outdated`, so that nothing was evaluated; `differs` from the file that is there, where
            files are only checked; or `refused`.
        reason: Why it is outdated, differs or was refused.
        verified: What the verifier found; None where it did not evaluate.
    """

    entry: str
    stem: str
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
    entries, refused = _read_entries(folders)
    yield from refused
    with Verifier(workers=workers) as verifier:
        for entry, stem in _by_target(entries):
            result = entry.results[stem]
            found = result.verified
            told = found.nonce if nonce is None and found is not None else nonce
            outdated = is_outdated(result.claimed.identity)
            if outdated:
                yield Finding(entry.about.name, stem, "outdated", outdated)
                continue
            if told is None:
                reason = "nothing of these samples is verified"
                yield Finding(entry.about.name, stem, "differs", reason)
                continue
            if found is not None and not again and not check and (missing or found.nonce == told):
                yield Finding(entry.about.name, stem, "unchanged", verified=found)
                continue
            try:
                new = verifier.verify(entry, stem, told, against=against)
                if not check:
                    write_verified(entry.folder, stem, new)
            except UserError as error:
                yield Finding(entry.about.name, stem, "refused", str(error))
                continue
            if not check:
                yield Finding(entry.about.name, stem, "verified", verified=new)
            elif found == new:
                yield Finding(entry.about.name, stem, "unchanged", verified=new)
            else:
                reason = "the file holds something else than the verifier finds"
                yield Finding(entry.about.name, stem, "differs", reason, new)


def _read_entries(folders: Iterable[Path]) -> tuple[list[Entry], list[Finding]]:
    entries, refused = [], []
    for folder in folders:
        try:
            check_entry(folder, submission=False)
            entries.append(read_entry(folder))
        except UserError as error:
            refused.append(Finding(folder.absolute().name, "", "refused", str(error)))
    return entries, refused


def _by_target(entries: Sequence[Entry]) -> list[tuple[Entry, str]]:
    """List all results so that those of one track and agent follow each other."""
    listed = [(entry, stem) for entry in entries for stem in entry.results]

    def key(one: tuple[Entry, str]) -> tuple[str, str]:
        identity = one[0].results[one[1]].claimed.identity
        return identity.track, identity.agent

    return sorted(listed, key=key)


def fresh_seeds(entry: str, identity_sha256: str, nonce: str, run: int, count: int) -> list[int]:
    """Give the evaluation seeds of a run's samples: a hash of all that names them, and the nonce.

    They belong to the stream `test`, as the claimed ones do. Seeds of one stream have their lowest
    bits in common: should a world depend on these, seeds of another stream would not be
    exchangeable with the claimed ones.
    """
    texts = (json.dumps([entry, identity_sha256, nonce, run, row]) for row in range(count))
    return [seed_of(hashlib.sha256(t.encode()).digest()[:4], "test") for t in texts]


class Verifier:
    """Scores samples again; it keeps one track with one agent open at a time.

    Args:
        workers: The number of processes that evaluate.
    """

    def __init__(self, *, workers: int = 1) -> None:
        self._workers = workers
        self._evaluator: Evaluator | None = None
        self._target: RunTarget | None = None

    def __enter__(self) -> Self:
        """Give itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """Close what is open."""
        self.close()

    def close(self) -> None:
        """Stop the workers and close the application."""
        evaluator, self._evaluator, self._target = self._evaluator, None, None
        if evaluator is not None:
            evaluator.close()

    def verify(
        self, entry: Entry, stem: str, nonce: str, *, against: Path | None = None
    ) -> Verified:
        """Score the samples of a result again, each once, and measure them.

        Args:
            entry: The entry, which passed `check_entry`.
            stem: What the names of the result's files begin with.
            nonce: What makes the evaluation seeds fresh.
            against: The folder of the entries whose samples are compared; None takes the entry's
                neighbours.

        Raises:
            UserError: If the track or its reference set cannot be opened.
        """
        result = entry.results[stem]
        identity = result.claimed.identity
        evaluator, target = self._open(identity.track, identity.agent)
        rng_text = [entry.about.name, identity.sha256, nonce]
        seeds = []
        for claimed in result.claimed.seeds:
            if claimed.measures is None:
                continue
            samples = result.samples[claimed.seed]
            fresh = fresh_seeds(
                entry.about.name, identity.sha256, nonce, claimed.seed, len(samples)
            )
            again = _score(evaluator, samples.mu, fresh)
            ideal = uniform = None
            if target.split[1] is not None:
                drawn = Ideal(target.dimension, seed=claimed.seed, fooling_set=target.split[1])
                ideal = _score(evaluator, drawn.sample(len(samples)), fresh)
            if target.reference is None:
                mu = _uniform(json.dumps([*rng_text, claimed.seed]), samples.mu.shape)
                uniform = _score(evaluator, mu, fresh)
            assert evaluator.application is not None
            feasible = evaluator.application.feasible(again.mu, fresh)
            measures = measure(
                again,
                Evaluations.empty(target.dimension),
                identity.fooling_threshold,
                fooling_set=target.split[0],
                ideal=ideal,
                images=None,
                seed=claimed.seed,
                feasible=feasible_rate(again.fooled(identity.fooling_threshold), feasible),
            )
            seeds.append(SeedEvidence(claimed, samples, again, ideal, uniform, measures))
        evidence = Evidence(
            identity, tuple(seeds), target.reference, _neighbours(entry, identity, against)
        )
        return Verified.make(
            result.claimed,
            result.samples,
            nonce,
            (VerifiedSeed(seed=one.claimed.seed, measures=one.measures) for one in seeds),
            find_flags(evidence),
        )

    def _open(self, track: str, agent: str) -> tuple[Evaluator, RunTarget]:
        """Open a track with an agent, unless it is open."""
        target = self._target
        if target is None or (target.track, target.application.agent_name) != (track, agent):
            self.close()
            evaluator = Evaluator(track, workers=self._workers)
            if evaluator.application is not None and evaluator.application.agent_name != agent:
                evaluator.close()
                evaluator = Evaluator(track, env_kwargs={"agent": agent}, workers=self._workers)
            application = evaluator.application
            assert application is not None
            self._evaluator = evaluator
            self._target = RunTarget(track, application, load_reference(track, application))
        assert self._evaluator is not None
        assert self._target is not None
        return self._evaluator, self._target


def _score(evaluator: Evaluator, mu: Mu, seeds: list[int]) -> Evaluations:
    scores, _ = evaluator.evaluate(mu, seeds, lambda *_: None)
    return Evaluations(mu, scores, np.array(seeds, np.int64))


def _uniform(text: str, shape: tuple[int, ...]) -> Mu:
    seed = int.from_bytes(hashlib.sha256(text.encode()).digest()[:8], "big")
    return np.random.default_rng(seed).uniform(-1.0, 1.0, shape).astype(np.float32)


def _neighbours(entry: Entry, identity: Identity, against: Path | None) -> dict[str, Mu]:
    """Read the samples that other entries have on a track and agent; broken ones are left out."""
    folder = entry.folder.absolute().parent if against is None else against
    pattern = f"*/{result_stem(identity.track, identity.agent, '')}.*{SAMPLES}"
    found: dict[str, list[Mu]] = {}
    for path in sorted(folder.glob(pattern)):
        name = path.parent.name
        if name == entry.about.name or name.startswith("."):
            continue
        try:
            samples = read_samples(path)
        except UserError:
            continue
        found.setdefault(name, []).extend(
            one.mu for one in samples.values() if np.isfinite(one.mu).all()
        )
    return {name: np.concatenate(parts) for name, parts in found.items() if parts}
