"""Good entries, made in a moment, for tests that spoil them."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from sada_gym.submission.entry import write_about, write_result
from sada_gym.submission.models import FORMAT, About, Result, SeedResult
from sada_gym.submission.today import find_target, today

from sada_gym.evaluation.evaluator import Evaluator
from sada_gym.evaluation.oracle import Oracle
from sada_gym.evaluations import Evaluations
from sada_gym.experiment.ideal import Ideal
from sada_gym.experiment.measure import measure
from sada_gym.measures.rates import attack_fooling_rate

ANALYTIC = "SADA-Analytic-v0"
PACKAGES = {"python": "3.11.2", "sada_gym": "0.1.0", "numpy": "2.0.0"}
NOTHING = Evaluations(np.zeros((0, 2), np.float32), np.zeros(0), np.zeros(0, np.int64))


def uniform(seed: int, count: int, dimension: int) -> npt.NDArray[np.float64]:
    """Draw uniform samples."""
    return np.random.default_rng(seed).uniform(-1, 1, (count, dimension))


def make_entry(
    parent: Path,
    name: str = "mine",
    *,
    track: str = ANALYTIC,
    agent: str = "",
    rule: str = "paper-budgets",
    adversary: str = "my-method",
    preset: str | None = None,
    options: dict[str, Any] | None = None,
    seeds: int = 2,
    queries: int = 900,
    draw: Callable[[int, int, int], npt.ArrayLike] = uniform,
) -> Path:
    """Write an entry of `draw(seed, M, d)`, by default uniform samples, and give its folder."""
    options = {"width": 0.5} if options is None else options
    identity = today(track, agent, rule, adversary, preset, options)
    target = find_target(track, agent)
    evaluator = Evaluator(track, env_kwargs={"agent": agent} if agent else {})
    samples, claims = {}, []
    for seed in range(seeds):

        def asked(mu, seed=seed):
            oracle = Oracle(evaluator, budget=len(mu), seed=seed, stream="test")
            oracle(mu)
            return oracle.record

        samples[seed] = asked(draw(seed, identity.samples, target.dimension))
        ideal = None
        if target.ideal_set is not None:
            drawn = Ideal(target.dimension, seed=seed, fooling_set=target.ideal_set)
            ideal = asked(drawn.sample(identity.samples))
        measures = measure(
            samples[seed],
            NOTHING,
            target.fooling_threshold,
            fooling_set=target.fooling_set,
            ideal=ideal,
            images=None,
            seed=seed,
        )
        claims.append(SeedResult(seed=seed, queries=queries, measures=measures, packages=PACKAGES))
    evaluator.close()
    folder = parent / name
    folder.mkdir(parents=True, exist_ok=True)
    about = About(
        format=FORMAT,
        name=name,
        title="My method",
        authors=("Ada L.", "Grace H."),
        licence="CC-BY-4.0",
        paper="https://example.org/paper",
        repository="https://example.org/code",
        adversary=adversary,
        preset=preset,
        options=json.dumps(options),
    )
    write_about(folder, about)
    write_result(folder, Result.make(identity, claims), samples)
    return folder


def rescored(one: SeedResult, scores: npt.NDArray[np.float64], threshold: float) -> SeedResult:
    """Claim scores of a seed's samples, and all that follows from them."""
    assert one.measures is not None
    rate = attack_fooling_rate(scores, threshold)
    told = {
        "afr": rate.rate,
        "afr_interval_95": (rate.low, rate.high),
        "fooled": rate.fooled,
        "mean_score": float(scores.mean()),
    }
    return one.model_copy(update={"measures": one.measures.model_copy(update=told)})
