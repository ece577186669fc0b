"""The paired test: exact p-values, bounds, and what is decided from them."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import binom

from sada_gym.analyses.regression.compare import (
    FALSE_ALARM,
    Change,
    combine,
    decide,
    decide_ordinary,
    demand,
    gate,
    increase_at_most,
    verdict_of,
)
from sada_gym.errors import UserError
from sada_gym.measures.likelihood import FailureEstimate


def changes(broken=0, fixed=0, same=0) -> list[Change]:
    return ["new failure"] * broken + ["fixed"] * fixed + ["still passes"] * same


@pytest.mark.parametrize(
    ("broken", "fixed", "status"),
    [
        (0, 0, "passed"),  # nothing broke
        (0, 1, "passed"),
        (1, 0, "inconclusive"),
        (6, 0, "inconclusive"),  # p = 1/64
        (7, 0, "failed"),  # p = 1/128
        (10, 2, "inconclusive"),
        (12, 2, "failed"),
        (1, 12, "passed"),
        (3, 3, "inconclusive"),
        (5, 12, "inconclusive"),
    ],
)
def test_without_a_margin_the_exact_test_decides(broken, fixed, status):
    decision = decide(changes(broken, fixed, 40))
    assert decision.status == status
    assert decision.p_worse == pytest.approx(binom.sf(broken - 1, broken + fixed, 0.5))
    assert (decision.more is not None) == (status == "inconclusive")


def test_the_number_of_missing_worlds_is_the_smallest_that_decides():
    decision = decide(changes(2, 1, 40))
    assert decision.more == 8
    assert f"at least {decision.more} more worlds" in decision.reason
    assert decide(changes(2 + 8, 1, 40)).status == "failed"
    assert decide(changes(2 + 7, 1, 40)).status == "inconclusive"


def test_the_number_of_suites_that_would_decide():
    decision = decide(changes(4, 1, 40))
    n = decision.repeats
    assert f"about {n} suites like this one" in decision.reason
    assert decide(changes(4 * n, n, 40)).status == "failed"
    assert decide(changes(4 * (n - 1), n - 1, 40)).status == "inconclusive"
    assert decide(changes(3, 3, 40)).repeats is None
    assert decide(changes(same=20), margin=0.05).repeats == 3  # 59 worlds


def test_controls_that_were_unlucky_count_as_changed_back():
    lucky = changes(9, 1, 40)
    assert decide(lucky, unlucky=(0, 0)).status == "inconclusive"
    assert decide(changes(10, 1, 40)).status == "failed"
    assert decide(changes(10, 1, 40), unlucky=(6, 0)).status == "inconclusive"
    assert decide(changes(2, 12, 40)).status == "passed"
    assert decide(changes(2, 12, 40), unlucky=(0, 6)).status == "inconclusive"


@pytest.mark.parametrize(
    ("chosen", "ordinary", "status"),
    [
        ((0, 20), (0, 0), "passed"),
        ((0, 20), (1, 0), "passed"),  # at most 4.7 % more
        ((0, 20), (3, 0), "inconclusive"),
        ((0, 20), (9, 0), "failed"),
        ((9, 0), (0, 0), "failed"),
        ((3, 3), (0, 0), "inconclusive"),
    ],
)
def test_the_worse_of_the_arms_decides(chosen, ordinary, status):
    arm = decide_ordinary(changes(*ordinary, 100 - sum(ordinary)), margin=None)
    both = combine(decide(changes(*chosen, 20)), arm)
    assert both.status == status
    assert "In ordinary worlds: " in both.reason
    assert (both.more is not None) == (status == "inconclusive")


def test_a_margin_asks_for_enough_worlds():
    small = decide(changes(same=20), margin=0.05)
    assert small.status == "inconclusive"
    enough = 20 + small.more
    assert enough == 59  # 0.95 ** 59 < 0.05: the rule of three
    assert decide(changes(same=enough), margin=0.05).status == "passed"
    assert decide(changes(same=enough - 1), margin=0.05).status == "inconclusive"
    assert decide(changes(same=20), margin=0.05, unchanged=True).status == "passed"


def test_a_margin_tolerates_a_small_increase_and_fails_a_large_one():
    assert decide(changes(7, 0, 600)).status == "failed"
    assert decide(changes(7, 0, 600), margin=0.05).status == "passed"
    assert decide(changes(60, 0, 540), margin=0.05).status == "failed"
    hopeless = decide(changes(4, 0, 16), margin=0.05)
    assert (hopeless.status, hopeless.more) == ("inconclusive", None)
    assert "no number" in hopeless.reason


def test_the_same_agent_whose_worlds_changed_is_not_unchanged():
    assert decide(changes(7, 0, 5), unchanged=True).status == "failed"


def test_the_bound_holds_95_times_in_100():
    rng = np.random.default_rng(0)
    broken, fixed, worlds = 0.12, 0.07, 60
    counts = rng.multinomial(worlds, [broken, fixed, 1 - broken - fixed], size=1_000)
    held = [increase_at_most(b, m, worlds) >= broken - fixed for b, m, _ in counts.tolist()]
    assert np.mean(held) >= 0.95


def test_an_agent_that_is_no_worse_seldom_fails():
    rng = np.random.default_rng(1)
    counts = rng.multinomial(40, [0.15, 0.15, 0.7], size=400)
    failed = [decide(changes(*row)).status == "failed" for row in counts.tolist()]
    assert np.mean(failed) <= FALSE_ALARM


def test_invalid_worlds_do_not_count():
    decision = decide([*changes(1, 0, 3), "not comparable"])
    assert decision.worlds == 4
    with pytest.raises(UserError, match="all of them are invalid"):
        decide(["not comparable"])


@pytest.mark.parametrize("margin", ["5 %", True, 0.0, 1.0, -0.1, float("nan")])
def test_a_bad_margin_is_told(margin):
    with pytest.raises(UserError, match=r"Expected (a )?margin"):
        decide(changes(same=3), margin=margin)


@pytest.mark.parametrize(
    ("fooled", "invalid", "verdict"),
    [
        ([1, 1, 0], [0, 0, 0], "fail"),
        ([1, 0, 0], [0, 0, 0], "pass"),
        ([1, 0], [0, 0], "pass"),
        ([1, 0], [0, 1], "fail"),
        ([0, 0], [1, 1], None),
    ],
)
def test_most_valid_seeds_decide_a_world(fooled, invalid, verdict):
    assert verdict_of(np.array(fooled, bool), np.array(invalid, bool)) == verdict


@pytest.mark.parametrize(
    ("asked", "status", "reason"),
    [
        ({}, "passed", "No regression: 3 fixed, 5 known failures remain, none new."),
        ({"max_failing": 5, "require_fixed": 0.375}, "passed", "No regression"),
        ({"max_failing": 4}, "failed", "5 worlds fail; at most 4 may."),
        ({"max_failing": 0}, "failed", "5 worlds fail; at most 0 may."),
        ({"require_fixed": 0.5}, "failed", "3 of 8 known failures are fixed, and 50 % must be."),
    ],
)
def test_more_may_be_asked_than_no_regression(asked, status, reason):
    found = [*changes(fixed=3, same=10), *["still fails"] * 5]
    decision = demand(decide(found), found, **asked)
    assert decision.status == status
    assert decision.reason.startswith(reason)


@pytest.mark.parametrize("asked", [{"max_failing": -1}, {"require_fixed": 1.5}])
def test_what_may_be_asked(asked):
    with pytest.raises(UserError, match="Expected"):
        demand(decide(changes(same=3)), changes(same=3), **asked)


@pytest.mark.parametrize(
    ("interval", "refused", "status"),
    [
        ((1e-4, 9e-4), None, "passed"),
        ((1.1e-3, 2e-3), None, "failed"),
        ((5e-4, 2e-3), None, "inconclusive"),
        ((1e-4, 9e-4), "few draws", "inconclusive"),
    ],
)
def test_the_probability_in_ordinary_use_is_a_gate(interval, refused, status):
    found = FailureEstimate(
        probability=sum(interval) / 2, interval=interval, queries=2_000, method="plain draws",
        refused=refused, held=1.0, drawn=1_100, failures=9, plain=550, plain_failures=1,
        effective=9.0, unseen=5e-3, density={}, seed=0, to_halve=6_000,
    )  # fmt: skip
    gated = gate(decide(changes(same=40)), found, 1e-3)
    assert gated.status == status
    assert "at most 1 of 1,000 may" in gated.reason
    assert (gated.more == 6_000) == (status == "inconclusive")
    assert gate(decide(changes(9, 0, 40)), found, 1e-3).status == "failed"
