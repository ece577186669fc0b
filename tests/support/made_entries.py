"""Good entries, made in a moment, for tests that spoil them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from sada_gym.board.results.entry import (
    EntryResult,
    GroupFiles,
    read_entry,
    write_metadata,
    write_results,
)
from sada_gym.board.results.models import EntryMetadata, Result, SeedResult
from sada_gym.board.submission.current import current_experiment, current_target
from sada_gym.evaluation.oracle import Oracle
from sada_gym.evaluations import Evaluations
from sada_gym.experiment.adversary import AdversarySpec
from sada_gym.experiment.ideal import Ideal
from sada_gym.experiment.measure import measure
from sada_gym.experiment.record import Experiment
from sada_gym.measures.rates import attack_fooling_rate

ANALYTIC = "SADA-Analytic-v0"
PACKAGES = {"python": "3.11.2", "sada_gym": "0.1.0", "numpy": "2.0.0"}


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
    """Write an entry of `draw(seed, M, d)`, by default uniform samples, and return its folder."""
    options = {"width": 0.5} if options is None else options
    spec = AdversarySpec(name=adversary, preset=preset, options=options)
    experiment = current_experiment(track, agent, rule, spec)
    target, count = current_target(track, agent), experiment.protocol.samples
    samples, claims = {}, []
    with experiment.target.open() as opened:
        for seed in range(seeds):

            def evaluate(mu: npt.ArrayLike, seed: int = seed) -> Evaluations:
                oracle = Oracle(opened.evaluator, budget=count, seed=seed, stream="test")
                oracle(mu)
                return oracle.record

            samples[seed] = evaluate(draw(seed, count, target.dimension))
            ideal = None
            if target.ideal_set is not None:
                drawn = Ideal(target.dimension, seed=seed, fooling_set=target.ideal_set)
                ideal = evaluate(drawn.sample(count))
            measures = measure(
                samples[seed],
                Evaluations.empty(target.dimension),
                experiment.target.fooling_threshold,
                fooling_set=target.fooling_set,
                ideal=ideal,
                images=None,
                seed=seed,
            )
            claims.append(
                SeedResult(seed=seed, queries=queries, measures=measures, packages=PACKAGES)
            )
    folder = parent / name
    folder.mkdir(parents=True, exist_ok=True)
    metadata = EntryMetadata(
        name=name,
        title="My method",
        authors=("Ada L.", "Grace H."),
        licence="CC-BY-4.0",
        paper="https://example.org/paper",
        repository="https://example.org/code",
    )
    write_metadata(folder, metadata)
    write_results(folder, [EntryResult(Result.make(experiment, claims), samples)])
    return folder


def with_changes(
    experiment: Experiment,
    target: dict[str, Any] | None = None,
    application: dict[str, Any] | None = None,
    adversary: dict[str, Any] | None = None,
    protocol: dict[str, Any] | None = None,
) -> Experiment:
    """Return an experiment with other fields of its parts."""
    changes = dict(target or {})
    if application:
        key = experiment.target.application
        changes["application"] = key.model_copy(update=application)
    return experiment.model_copy(
        update={
            "target": experiment.target.model_copy(update=changes),
            "adversary": experiment.adversary.model_copy(update=adversary or {}),
            "protocol": experiment.protocol.model_copy(update=protocol or {}),
        }
    )


def only_result(folder: Path) -> EntryResult:
    """Read the only result of an entry."""
    (result,) = read_entry(folder).results.values()
    return result


def replace_result(folder: Path, result: EntryResult) -> None:
    """Write a result as the only one of its entry; its hash fits its experiment."""
    for path in folder.iterdir():
        if path.name != "entry.toml":
            path.unlink()
    GroupFiles(folder, result.experiment.group).write([result])


def rescored(claims: SeedResult, scores: npt.NDArray[np.float64], threshold: float) -> SeedResult:
    """Claim scores of a seed's samples, and all that follows from them."""
    assert claims.measures is not None
    rate = attack_fooling_rate(scores, threshold)
    changes = {
        "afr": rate.rate,
        "afr_interval_95": (rate.low, rate.high),
        "fooled": rate.fooled,
        "mean_score": float(scores.mean()),
    }
    return claims.model_copy(update={"measures": claims.measures.model_copy(update=changes)})


def change_samples(folder: Path, change: Callable[[Evaluations], Evaluations]) -> None:
    """Write an entry's only result anew, whose claims follow from `change(samples of a seed)`."""
    result = only_result(folder)
    experiment = result.experiment
    samples = {seed: change(rows) for seed, rows in result.samples.items()}
    claims = [
        rescored(claims, samples[claims.seed].score, experiment.target.fooling_threshold)
        for claims in result.claimed.seeds
    ]
    replace_result(folder, EntryResult(Result.make(experiment, claims), samples))
