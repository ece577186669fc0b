"""Scores and measures the samples of a seed, for submissions and for the verifier."""

from __future__ import annotations

import numpy as np

from sada_gym.application import feasible_worlds
from sada_gym.evaluations import Evaluations
from sada_gym.experiment.algorithm import OnProgress, RunProgress, Stage, ignore_progress
from sada_gym.experiment.ideal import Ideal
from sada_gym.experiment.measure import Measures, feasible_rate, measure
from sada_gym.experiment.target import OpenTarget
from sada_gym.parameters import Mu


def measure_samples(
    target: OpenTarget,
    mu: Mu,
    evaluation_seeds: list[int],
    *,
    seed: int,
    on_progress: OnProgress = ignore_progress,
) -> tuple[Evaluations, Measures]:
    """Score samples, and as many ideal ones where there is a reference set, each once.

    `mu` is (M, d) float32 in [-1, 1], scored on the M evaluation seeds; `seed` fixes the ideal
    samples and the draws of reference points.
    """
    samples, ideal = score(target, mu, evaluation_seeds, "test", on_progress), None
    if target.ideal_set is not None:
        drawn = Ideal(target.dimension, seed=seed, fooling_set=target.ideal_set).sample(len(mu))
        ideal = score(target, drawn, evaluation_seeds, "measure", on_progress)
    threshold = target.target.fooling_threshold
    feasible = feasible_worlds(target.application, mu, evaluation_seeds)
    measures = measure(
        samples,
        Evaluations.empty(target.dimension),
        threshold,
        fooling_set=target.fooling_set,
        ideal=ideal,
        images=None,
        seed=seed,
        feasible=feasible_rate(samples.fooled(threshold), feasible),
    )
    return samples, measures


def score(
    target: OpenTarget,
    mu: Mu,
    seeds: list[int],
    stage: Stage = "test",
    on_progress: OnProgress = ignore_progress,
) -> Evaluations:
    """Score each of some mu once, on its own evaluation seed."""

    def report(done: int, cached: int) -> None:
        on_progress(RunProgress(stage, done, len(mu), cached, done - cached))

    scores, _, reasons = target.evaluator.evaluate(mu, seeds, report)
    invalid = np.zeros(len(mu), np.bool_)
    invalid[[*reasons]] = True
    return Evaluations(mu, scores, np.array(seeds, np.int64), invalid)
