"""A small board of made-up entries: all tiers, a control, flags, hostile texts, an old result."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from sada_gym.submission.entry import read_entry, write_about, write_result, write_verified
from sada_gym.submission.models import FORMAT, About, Result, SeedResult, Verified, VerifiedSeed
from sada_gym.submission.today import find_target, today

from sada_gym.cards import find_card
from sada_gym.evaluations import Evaluations
from sada_gym.experiment.measure import measure

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
    changes: tuple[tuple[str, object], ...] = ()


ENTRIES = (
    Made("strong", 0.9, HOSTILE, paper="https://example.org/paper", notes=("It stopped early.",)),
    Made("level", 0.89, "=level"),
    Made("middle", 0.6, flags=(("duplicates", FLAG),)),
    Made("weak", 0.2),
    Made("boaster", 0.99, verified_rate=0.3, flags=(("claims", "It claims more than we found."),)),
    Made("ideal", 0.8, adversary="ideal"),
    Made("newcomer", 0.95, verified=False, paper="javascript:alert(1)"),
    Made("racer", 0.5, tracks=RACING, agent="ppo", verified=False),
    Made("old", 0.97, changes=(("version", 99),)),
)


def make_entries(parent: Path, entries: tuple[Made, ...] = ENTRIES) -> Path:
    """Write entries; their scores are made up, so that nothing is evaluated."""
    for one in entries:
        folder = parent / one.name
        folder.mkdir(parents=True)
        write_about(folder, _about(one))
        for track in one.tracks:
            _write(folder, one, track)
    return parent


def _about(one: Made) -> About:
    return About(
        format=FORMAT,
        name=one.name,
        title=one.title or one.name,
        authors=("Ada <L.>",),
        licence="CC-BY-4.0",
        paper=one.paper,
        adversary=one.adversary,
        command="sada-gym attack && echo '</pre><script>'",
    )


def _write(folder: Path, one: Made, track: str) -> None:
    identity = today(track, one.agent, "paper-budgets", one.adversary, None, {})
    identity = identity.model_copy(update=dict(one.changes))
    target = find_target(track, one.agent)
    samples, claims, verified = {}, [], []
    for seed in range(2):
        samples[seed], measures = _measured(one.rate, target, seed, identity.samples)
        claims.append(SeedResult(seed=seed, queries=900, measures=measures, flags=one.notes))
        rate = one.rate if one.verified_rate is None else one.verified_rate
        found = _measured(rate, target, seed, identity.samples)[1]
        verified.append(VerifiedSeed(seed=seed, measures=found))
    write_result(folder, Result.make(identity, claims), samples)
    if one.verified:
        held = read_entry(folder).results[identity.stem]
        found = Verified.make(held.claimed, held.samples, "1", verified, dict(one.flags))
        write_verified(folder, identity.stem, found)


def _measured(rate, target, seed, count):
    rng = np.random.default_rng(seed)
    mu = rng.uniform(-1, 1, (count, target.dimension)).astype(np.float32)
    fooled = np.arange(count) < round(count * (rate - 0.02 * seed))
    seeds = rng.integers(0, 2**31, count)
    samples = Evaluations(mu, np.where(fooled, 0.0, 1.0), seeds)
    ideal = None
    if target.ideal_set is not None:
        chosen = rng.choice(len(target.ideal_set), count)
        ideal = Evaluations(target.ideal_set[chosen], np.zeros(count), seeds)
    measures = measure(
        samples,
        Evaluations(mu[:0], np.zeros(0), np.zeros(0, np.int64)),
        target.fooling_threshold,
        fooling_set=target.fooling_set,
        ideal=ideal,
        images=None,
        seed=seed,
    )
    return samples, measures
