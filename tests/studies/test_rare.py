"""The forty problems of rare failures have the probability that they say."""

from __future__ import annotations

import numpy as np
import pytest

from studies.rare import before, held, problems


@pytest.mark.long
def test_forty_problems_fail_as_often_as_they_say():
    listed = problems()
    assert len(listed) == 40
    rng = np.random.default_rng(0)
    for problem in listed:
        if problem.truth < 5e-4:
            continue
        z = rng.normal(size=(30_000, problem.dimension))
        rate = problem.answers(z, rng).failed.mean()
        error = np.sqrt(problem.truth / 30_000)
        assert rate == pytest.approx(problem.truth, abs=5.0 * error), problem.name


def test_weighted_uniform_worlds_hold_a_likely_failure():
    problem = problems()[0]
    found = np.array([before(problem, seed) for seed in range(6)])
    assert held(found, problem.truth).mean() >= 0.6
