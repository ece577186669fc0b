"""Fifty gates of an unchanged agent whose behaviour is noisy: hardly any may fail it."""

from __future__ import annotations

import pytest

from sada_gym.analyses.regression.regress import regress
from studies.false_alarms import Noisy, noisy_suite

GATES, MOST_FALSE = 50, 1


@pytest.fixture(scope="module")
def suite(tmp_path_factory):
    return noisy_suite(tmp_path_factory.mktemp("noisy"), 1.0)


@pytest.mark.long
@pytest.mark.parametrize("baseline", [False, True])
def test_an_unchanged_noisy_agent_seldom_fails(suite, baseline):
    status = []
    for trial in range(GATES):
        before = Noisy(1_000 + trial) if baseline else None
        result = regress(suite, Noisy(2 + trial), baseline=before)
        status.append(result.decision.status)
        if status[-1] == "inconclusive":
            assert result.decision.more or "no number" in result.decision.reason
    assert status.count("failed") <= MOST_FALSE


@pytest.mark.long
def test_an_agent_that_is_really_worse_fails(suite):
    gates = [regress(suite, Noisy(2 + trial, worse=1.5)) for trial in range(10)]
    assert all(result.exit_code == 1 for result in gates)
    assert all(result.ordinary.status == "failed" for result in gates)
