"""A small board of made-up entries: all tiers, a control, flags, hostile texts, an old result."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from sada_gym.board.results.entry import EntryResult, write_metadata, write_results
from sada_gym.board.results.models import EntryMetadata, Result, SeedResult, Verified, VerifiedSeed
from sada_gym.board.submission.current import current_experiment, current_target
from sada_gym.evaluations import Evaluations, evaluation_seeds
from sada_gym.experiment.adversary import AdversarySpec
from sada_gym.experiment.measure import Measures, measure
from sada_gym.experiment.target import OpenTarget
from sada_gym.foundations.cards import find_card

DIGITS = ("SADA-Digits-3-v0", "SADA-Digits-4-v0")
RACING = tuple(f"SADA-UAV-{n}Anchors-v0" for n in (3, 4, 5))
CARDS = tuple(find_card(name) for name in ("SADA-UAV", "SADA-Digits", "SADA-Analytic"))
"""The applications of the board: few, so that it is made quickly."""

HOSTILE = "<img src=x onerror=alert(1)> \"quoted\" 'title'"
FLAG = "Half of the samples equal <b>another one</b>."


@dataclass(frozen=True)
class Made:
    """An entry: how often its samples fool, in which tier and on which tracks."""

    name: str
    rate: float
    title: str = ""
    tracks: tuple[str, ...] = DIGITS
    agent: str = "cnn"
    adversary: str = "my-method"
    verified: bool = True
    verified_rate: float | None = None
    flags: tuple[tuple[str, str], ...] = ()
    notes: tuple[str, ...] = ()
    paper: str = ""
    version: int | None = None


ENTRIES = (
    Made("strong", 0.9, HOSTILE, paper="https://example.org/paper", notes=("It stopped early.",)),
    Made("level", 0.89, "=level"),
    Made("middle", 0.6, flags=(("duplicates", FLAG),)),
    Made("weak", 0.2),
    Made("boaster", 0.99, verified_rate=0.3, flags=(("claims", "It claims more than we found."),)),
    Made("ideal", 0.8, adversary="ideal"),
    Made("newcomer", 0.95, verified=False, paper="javascript:alert(1)"),
    Made("racer", 0.5, tracks=RACING, agent="ppo", verified=False),
    Made("old", 0.97, version=99),
)


def make_entries(parent: Path, entries: tuple[Made, ...] = ENTRIES) -> Path:
    """Write entries; their scores are made up, so that nothing is evaluated."""
    for entry in entries:
        folder = parent / entry.name
        folder.mkdir(parents=True)
        metadata = EntryMetadata(
            name=entry.name,
            title=entry.title or entry.name,
            authors=("Ada <L.>",),
            licence="CC-BY-4.0",
            paper=entry.paper,
            command="sada-gym attack && echo '</pre><script>'",
        )
        write_metadata(folder, metadata)
        write_results(folder, [_make_result(entry, track) for track in entry.tracks])
    return parent


def _make_result(entry: Made, track: str) -> EntryResult:
    spec = AdversarySpec(name=entry.adversary)
    experiment = current_experiment(track, entry.agent, "paper-budgets", spec)
    if entry.version is not None:
        target = experiment.target
        application = target.application.model_copy(update={"version": entry.version})
        target = target.model_copy(update={"application": application})
        experiment = experiment.model_copy(update={"target": target})
    current, count = current_target(track, entry.agent), experiment.protocol.samples
    samples, claims, findings = {}, [], []
    for seed in range(2):
        samples[seed], measures = _measured(entry.rate, current, seed, count)
        claims.append(SeedResult(seed=seed, queries=900, measures=measures, flags=entry.notes))
        rate = entry.rate if entry.verified_rate is None else entry.verified_rate
        _, measures = _measured(rate, current, seed, count)
        findings.append(VerifiedSeed(seed=seed, measures=measures))
    claimed, verified = Result.make(experiment, claims), None
    if entry.verified:
        salt = entry.name, claimed.sha256
        verified = Verified.make(claimed, samples, salt, "1", findings, dict(entry.flags))
    return EntryResult(claimed, samples, verified)


def _measured(
    rate: float, target: OpenTarget, seed: int, count: int
) -> tuple[Evaluations, Measures]:
    rng = np.random.default_rng(seed)
    mu = rng.uniform(-1, 1, (count, target.dimension)).astype(np.float32)
    fooled = np.arange(count) < round(count * (rate - 0.02 * seed))
    seeds = np.array(evaluation_seeds(seed, "test", 0, count), np.int64)
    samples = Evaluations(mu, np.where(fooled, 0.0, 1.0), seeds)
    ideal = None
    if target.ideal_set is not None:
        chosen = rng.choice(len(target.ideal_set), count)
        ideal = Evaluations(target.ideal_set[chosen], np.zeros(count), seeds)
    measures = measure(
        samples,
        Evaluations.empty(target.dimension),
        target.target.fooling_threshold,
        fooling_set=target.fooling_set,
        ideal=ideal,
        images=None,
        seed=seed,
    )
    return samples, measures
