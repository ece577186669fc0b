"""Checks that a result's claims follow from its samples, without evaluating anything."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from sada_gym.errors import UserError
from sada_gym.evaluations import Evaluations
from sada_gym.experiment.measure import Measures
from sada_gym.experiment.record import Experiment
from sada_gym.measures.coverage import fooling_coverage
from sada_gym.measures.rates import attack_fooling_rate, mu_std
from sada_gym.results.models import SeedResult
from sada_gym.submission.current import current_target

_SLACK = 0.01  # of coverage, whose ties other processors may decide differently


def refuse(path: Path, expected: str, got: object, mend: str = "Make the entry anew") -> NoReturn:
    """Raise a UserError that says what was expected in a file, what came, and how to mend it."""
    raise UserError(f"Expected {expected} in {path}, got {got}. {mend}.")


def check_samples(path: Path, seed: int, samples: Evaluations) -> None:
    """Check that samples lie in the box, and their scores between 0 and 1."""
    of = f"of seed {seed}"
    bad = ~(np.abs(samples.mu) <= 1.0)  # a NaN is not <= 1 either
    if bad.any():
        refuse(path, f"mu {of} within [-1, 1]", samples.mu[bad][0])
    bad = ~((samples.score >= 0.0) & (samples.score <= 1.0))
    if bad.any():
        refuse(path, f"scores {of} within [0, 1]", samples.score[bad][0])


def check_claims(path: Path, experiment: Experiment, claimed: SeedResult, one: Evaluations) -> None:
    """Check what follows from the samples alone."""
    measures = claimed.measures
    assert measures is not None
    rate = attack_fooling_rate(one.score, experiment.target.fooling_threshold)
    found: dict[str, float] = {
        "fooled": rate.fooled,
        "afr": rate.rate,
        "mean_score": float(one.score.mean()),
        "mu_std": mu_std(one.mu),
    }
    given: dict[str, float] = {name: getattr(measures, name) for name in found}
    for i, end in enumerate((rate.low, rate.high)):
        name = f"afr_interval_95.{i}"
        found[name], given[name] = end, measures.afr_interval_95[i]
    for name, value in found.items():
        if not math.isclose(given[name], value, rel_tol=1e-9, abs_tol=1e-9):
            expected = f"{name} = {value} of seed {claimed.seed}, as its samples give it,"
            refuse(path, expected, given[name], "Do not edit claims; make the entry anew")
    _check_ranges(path, experiment, claimed.seed, measures)
    numbers = _numbers(claimed.model_dump(mode="json"))
    if min(numbers) < 0:
        refuse(path, f"no negative numbers of seed {claimed.seed}", min(numbers))


def _check_ranges(path: Path, experiment: Experiment, seed: int, measures: Measures) -> None:
    feasible, count = measures.feasible, experiment.protocol.samples
    if feasible is not None and not feasible.fooled <= feasible.worlds <= count:
        found = f"{feasible.fooled:,} of {feasible.worlds:,}"
        refuse(path, f"at most {count:,} feasible worlds of seed {seed}", found)
    covered = (measures.density, measures.coverage, measures.relative_coverage)
    if experiment.target.reference is None and any(value is not None for value in covered):
        refuse(path, f"no coverage of seed {seed}, as there is no reference set,", "one")
    if measures.coverage is not None and measures.coverage > 1:
        refuse(path, f"a coverage of at most 1 of seed {seed}", measures.coverage)


def check_coverage(
    path: Path, experiment: Experiment, claimed: SeedResult, one: Evaluations
) -> None:
    """Compare coverage and density with those of today's reference set."""
    measures, target = (
        claimed.measures,
        current_target(experiment.target.track, experiment.target.agent),
    )
    if measures is None or target.fooling_set is None:
        return
    fooled = one.fooled(experiment.target.fooling_threshold)
    found = fooling_coverage(one.mu, fooled, target.fooling_set, seed=claimed.seed)
    for name, given in (("coverage", measures.coverage), ("density", measures.density)):
        value = getattr(found, name)
        if given is None or abs(given - value) > _SLACK * max(1.0, value):
            expected = f"{name} = {value} of seed {claimed.seed}, as its samples give it,"
            refuse(path, expected, given, "Do not edit claims; make the entry anew")


def _numbers(value: Any) -> list[float]:
    """List all numbers in what JSON holds."""
    if isinstance(value, dict):
        return _numbers(list(value.values()))
    if isinstance(value, list):
        return [number for item in value for number in _numbers(item)]
    return [value] if isinstance(value, int | float) else []
