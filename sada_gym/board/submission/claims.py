"""Checks that a result's claims follow from its samples, without evaluating anything."""

from __future__ import annotations

import math
from typing import Any, NoReturn

import numpy as np

from sada_gym.board.results.models import SeedResult
from sada_gym.board.submission.current import current_target
from sada_gym.errors import UserError
from sada_gym.evaluations import Evaluations
from sada_gym.experiment.record import Experiment
from sada_gym.measures.coverage import fooling_coverage
from sada_gym.measures.rates import attack_fooling_rate, mu_std

_SLACK = 0.01  # of coverage, whose ties other processors may decide differently
_NO_EDITING = "Do not edit claims; make the entry anew"


def refuse(where: str, expected: str, got: object, mend: str = "Make the entry anew") -> NoReturn:
    """Raise a UserError that says what was expected, where, what came, and how to mend it."""
    raise UserError(f"Expected {expected} {where}, got {got}. {mend}.")


def check_samples(where: str, samples: Evaluations) -> None:
    """Check that samples lie in the box, and their scores between 0 and 1."""
    outside = ~(np.abs(samples.mu) <= 1.0)  # a NaN is not <= 1 either
    if outside.any():
        refuse(where, "mu within [-1, 1]", samples.mu[outside][0])
    outside = ~((samples.score >= 0.0) & (samples.score <= 1.0))
    if outside.any():
        refuse(where, "scores within [0, 1]", samples.score[outside][0])


def check_claims(
    where: str, experiment: Experiment, claims: SeedResult, samples: Evaluations
) -> None:
    """Check what follows from the samples alone."""
    measures = claims.measures
    assert measures is not None
    rate = attack_fooling_rate(samples.score, experiment.target.fooling_threshold)
    low, high = measures.afr_interval_95
    for name, claimed, value in (
        ("fooled", measures.fooled, rate.fooled),
        ("afr", measures.afr, rate.rate),
        ("mean_score", measures.mean_score, float(samples.score.mean())),
        ("mu_std", measures.mu_std, mu_std(samples.mu)),
        ("afr_interval_95.0", low, rate.low),
        ("afr_interval_95.1", high, rate.high),
    ):
        if not math.isclose(claimed, value, rel_tol=1e-9, abs_tol=1e-9):
            refuse(where, f"{name} = {value}, as the samples give it,", claimed, _NO_EDITING)
    feasible, count = measures.feasible, experiment.protocol.samples
    if feasible is not None and not feasible.fooled <= feasible.worlds <= count:
        got = f"{feasible.fooled:,} of {feasible.worlds:,}"
        refuse(where, f"at most {count:,} feasible worlds", got)
    covered = (measures.density, measures.coverage, measures.relative_coverage)
    if experiment.target.reference is None and any(value is not None for value in covered):
        refuse(where, "no coverage, as there is no reference set,", "one")
    if measures.coverage is not None and measures.coverage > 1:
        refuse(where, "a coverage of at most 1", measures.coverage)
    smallest = min(_numbers(claims.model_dump(mode="json")))
    if smallest < 0:
        refuse(where, "no negative numbers", smallest)


def check_coverage(
    where: str, experiment: Experiment, claims: SeedResult, samples: Evaluations
) -> None:
    """Compare coverage and density with those of today's reference set."""
    measures, attacked = claims.measures, experiment.target
    points = current_target(attacked.track, attacked.agent).fooling_set
    if measures is None or points is None:
        return
    fooled = samples.fooled(attacked.fooling_threshold)
    computed = fooling_coverage(samples.mu, fooled, points, seed=claims.seed)
    for name, claimed, value in (
        ("coverage", measures.coverage, computed.coverage),
        ("density", measures.density, computed.density),
    ):
        if claimed is None or abs(claimed - value) > _SLACK * max(1.0, value):
            refuse(where, f"{name} = {value}, as the samples give it,", claimed, _NO_EDITING)


def _numbers(value: Any) -> list[float]:
    if isinstance(value, dict):
        return _numbers(list(value.values()))
    if isinstance(value, list):
        return [number for item in value for number in _numbers(item)]
    return [value] if isinstance(value, int | float) else []
