"""What adversaries ask in planted settings: the real ones, and quick simulations of them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from sada_gym.foundations.arrays import Bools, Floats
from studies.planted_settings import THRESHOLD, PlantedApplication, Setting
from studies.without_hits import without_hits

ADVERSARIES = ("level-set", "random", "bbgan")
LEARNING = ("level-set", "bbgan")
QUERIES, SAMPLES = 2_000, 250


@dataclass(frozen=True)
class Known:
    """What a run knows: shares of the ranges, (n, d), which fooled, and which are uniform."""

    shares: Floats
    fooled: Bools
    uniform: Bools


def ask(
    setting: Setting, adversary: str, rng: np.random.Generator, queries: int = QUERIES
) -> Known:
    """Choose queries and samples as an adversary does, or nearly so: quickly."""
    first = queries if adversary != "level-set" else int(0.4 * queries)
    shares = rng.random((first, len(setting.space)))
    fooled = rng.random(first) < setting.rates(shares)
    if adversary == "random":
        samples = rng.random((SAMPLES, len(setting.space)))
    elif adversary == "bbgan":  # learns the points that fooled, not quite
        centres = shares[fooled][rng.integers(max(fooled.sum(), 1), size=SAMPLES)]
        samples = np.clip(centres + 0.05 * rng.normal(size=centres.shape), 0.0, 1.0)
    else:
        shares, fooled, samples = _level_set(setting, shares, fooled, queries, rng)
    uniform = np.arange(len(shares) + len(samples)) < first
    if adversary == "random":
        uniform[:] = True
    more = rng.random(len(samples)) < setting.rates(samples)
    return Known(np.concatenate([shares, samples]), np.append(fooled, more), uniform)


def _level_set(
    setting: Setting, shares: Floats, fooled: Bools, queries: int, rng: np.random.Generator
) -> tuple[Floats, Bools, Floats]:
    """Ask at the border of where a forest predicts failures; then sample beyond it."""
    for _ in range(4):
        pool = rng.random((8_000, len(setting.space)))
        p = _forest(shares, fooled, rng)(pool)
        odds = p * (1.0 - p) + 1e-9
        odds = 0.75 * odds / odds.sum() + 0.25 / len(pool)
        new = pool[rng.choice(len(pool), (queries * 6 // 10) // 4, replace=False, p=odds)]
        shares = np.concatenate([shares, new])
        fooled = np.append(fooled, rng.random(len(new)) < setting.rates(new))
    pool = rng.random((8_000, len(setting.space)))
    best = np.argsort(-_forest(shares, fooled, rng)(pool))
    return shares, fooled, pool[rng.permutation(best[: 2 * SAMPLES])[:SAMPLES]]


def _forest(shares: Floats, fooled: Bools, rng: np.random.Generator) -> Callable[[Floats], Floats]:
    from sklearn.ensemble import ExtraTreesClassifier

    forest = ExtraTreesClassifier(
        30, min_samples_leaf=3, random_state=int(rng.integers(2**31))
    ).fit(shares, fooled)
    return lambda pool: forest.predict_proba(pool)[:, -1] if fooled.any() else np.zeros(len(pool))


def attack_for_real(setting: Setting, adversary: str, queries: int = QUERIES) -> Known:
    """Let the real adversary choose queries and samples."""
    from sada_gym import adversaries
    from sada_gym.oracle import Oracle

    application = PlantedApplication(setting)
    options = without_hits(adversary)
    solver = adversaries.make(adversary, dimension=len(setting.space), seed=setting.seed, **options)
    with Oracle(application, budget=queries, seed=setting.seed) as oracle:
        solver.train(oracle)
        record = oracle.record
    with Oracle(application, budget=SAMPLES, seed=setting.seed, stream="test") as oracle:
        oracle(solver.sample(SAMPLES))
        samples = oracle.record
    both = record + samples
    even = np.arange(len(both)) < solver.uniform_part(len(record))
    return Known((both.mu.astype(np.float64) + 1.0) / 2.0, both.fooled(THRESHOLD), even)
