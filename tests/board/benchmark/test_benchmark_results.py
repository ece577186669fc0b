"""Entries are put together in tables: by rule and agents, of one tier, with intervals and ranks."""

from pathlib import Path

import numpy as np
import pytest
from made_experiments import made_experiment, made_target

from sada_gym.board.benchmark.results import results_of
from sada_gym.board.benchmark.suite import TABLES, Budget, Table, tables_of
from sada_gym.board.results.entry import Entry, EntryResult
from sada_gym.board.results.models import EntryMetadata, Result, SeedResult, Verified, VerifiedSeed
from sada_gym.errors import UserError
from sada_gym.evaluations import Evaluations
from sada_gym.experiment.measure import measure

EQUAL = TABLES["equal-queries"]
TRACKS = ("SADA-Driving-Straight-v0", "SADA-Driving-OneCurve-v0")


def measures(fooled, count=100):
    mu = np.random.default_rng(fooled).uniform(-1, 1, (count, 3)).astype(np.float32)
    score = np.where(np.arange(count) < fooled, 0.0, 1.0)
    samples = Evaluations(mu, score, np.arange(count))
    none = Evaluations(mu[:0], score[:0], np.arange(0))
    return samples, measure(samples, none, 0.3, fooling_set=None, ideal=None, images=None, seed=0)


def result(
    fooled,
    *,
    track=TRACKS[0],
    agent="cil",
    rule="equal-queries",
    adversary="gp",
    verified=None,
    numpy="2.0",
    fingerprint="f",
):
    """A result that claims so many fooled samples of 100 in each seed; None where a seed failed."""
    target = made_target(track, agent, application="SADA-Driving", fingerprint=fingerprint)
    experiment = made_experiment(target, adversary, rule=rule, budget=2_000, samples=100)
    samples, seeds = {}, []
    for seed, count in enumerate(fooled):
        measured = None
        if count is not None:
            samples[seed], measured = measures(count)
        error = "It cannot." if count is None else None
        seeds.append(
            SeedResult(
                seed=seed, queries=7, error=error, measures=measured, packages={"numpy": numpy}
            )
        )
    claimed = Result.make(experiment, seeds)
    if verified is not None:
        verified = Verified.make(
            claimed,
            samples,
            ("entry", "result"),
            "n",
            (
                VerifiedSeed(seed=seed, measures=measures(count)[1])
                for seed, count in enumerate(verified)
            ),
            {"claimed": "The claim is outside of the interval."},
        )
    return EntryResult(claimed, samples, verified)


def entry(name, *results, title=None):
    metadata = EntryMetadata(name=name, title=title or name, authors=(), licence="")
    return Entry(Path(name), metadata, {result.place: result for result in results})


def rows(results, table="equal-queries", agent="cil", track=None):
    return {row.entry: row for row in results.rows_of(table, agent, track)}


def names(comparison):
    return comparison.table.name, comparison.agent


def test_tables_take_the_results_of_their_rule_and_agents():
    results = (
        result([10], rule="paper-budgets"),
        result([20], rule="other-agents", agent="ppo"),
        result([30]),
        result([40], agent="ppo"),
        result([50], rule="paper-budgets", agent="ppo"),
    )
    everything = results_of([entry("gp", *results)], tuple(TABLES.values()))
    assert {
        names(comparison): comparison.runs[0].measures.fooled
        for comparison in everything.comparisons
    } == {
        ("paper-budgets", "cil"): 10,
        ("other-agents", "ppo"): 20,
        ("equal-queries", "cil"): 30,
        ("equal-queries", "ppo"): 40,
        ("paper-budgets", "ppo"): 50,
    }
    assert len(everything.runs) == 5
    assert names(everything.comparisons[0]) == ("paper-budgets", "cil")
    default = EQUAL.model_copy(update={"agents": "default"})
    (shown,) = results_of([entry("gp", *results)], [default]).comparisons
    assert names(shown) == ("equal-queries", "cil")
    named = EQUAL.model_copy(update={"agents": ("ppo", "mine")})
    (shown,) = results_of([entry("gp", *results)], [named]).comparisons
    assert names(shown) == ("equal-queries", "ppo")


def test_a_user_s_own_agent_is_the_default_one_of_its_application():
    table = Table(name="t", title="", note="", budget=Budget(queries=1))
    target = made_target("Mine-v0", "anything", application="SADA-Mine")
    own, other = (
        made_experiment(target, "gp", rule=rule, budget=1, samples=1) for rule in ("t", "other")
    )
    assert table.shows(own)
    assert not table.shows(other)
    assert not table.model_copy(update={"agents": "others"}).shows(own)


def test_the_tables_of_rules_are_ours_or_plain():
    assert [table.name for table in tables_of({"equal-queries"})] == ["equal-queries"]
    ours = tables_of({"paper-budgets", "mine"})
    assert [table.name for table in ours] == ["paper-budgets", "mine"]
    target = made_target(TRACKS[0], "ppo", application="SADA-Driving")
    assert ours[-1].shows(made_experiment(target, "gp", rule="mine", budget=1, samples=1))


def test_the_verified_tier_shows_what_was_verified_alone():
    entries = [
        entry("good", result([90, 90], verified=[80, 84])),
        entry("unseen", result([99, 99])),
    ]
    claimed, verified = (results_of(entries, [EQUAL], tier=t) for t in ("claimed", "verified"))
    assert rows(claimed)["good"].afr.value == pytest.approx(0.9)
    assert set(rows(claimed)) == {"good", "unseen"}
    assert rows(verified)["good"].afr.value == pytest.approx(0.82)
    assert set(rows(verified)) == {"good"}
    assert {run.claims.flags for run in claimed.runs} == {()}
    assert {run.claims.flags for run in verified.runs} == {
        ("claimed: The claim is outside of the interval.",)
    }


@pytest.mark.parametrize("flag", ["claim", "constant", "copied", "duplicates"])
def test_what_shows_that_figures_mean_nothing_takes_the_rank(flag):
    thief = result([99, 99], verified=[99, 99])
    flagged = thief.verified.model_copy(update={"flags": {flag: "It is."}})
    entries = [
        entry("thief", EntryResult(thief.claimed, thief.samples, flagged)),
        entry("good", result([50, 50], verified=[50, 50])),
    ]
    verified = rows(results_of(entries, [EQUAL], tier="verified"))
    ranks = {name: row.rank for name, row in verified.items()}
    if flag == "duplicates":
        assert ranks == {"thief": "1", "good": "2"}
    else:
        assert ranks == {"thief": None, "good": "1"}
    assert rows(results_of(entries, [EQUAL]))["thief"].rank == "1"


def test_failed_seeds_are_counted_in_both_tiers():
    entries = [entry("gp", result([None, 50]))]
    [row] = results_of(entries, [EQUAL]).rows_of("equal-queries", "cil", None)
    assert (row.runs, row.failed, row.complete, row.queries) == (1, 1, False, 7)
    failed = result([None])
    checked = EntryResult(failed.claimed, failed.samples, result([1], verified=[1]).verified)
    [row] = results_of([entry("gp", checked)], [EQUAL], tier="verified").rows_of(
        "equal-queries", "cil", None
    )
    assert (row.runs, row.failed, row.afr) == (0, 1, None)


def test_controls_are_known_by_their_adversary_and_have_no_rank():
    entries = [
        entry("ideal", result([95], adversary="ideal")),
        entry("theirs", result([90]), title="ideal"),
        entry("weak", result([20])),
    ]
    by_entry = rows(results_of(entries, [EQUAL]))
    assert {name: (row.control, row.rank) for name, row in by_entry.items()} == {
        "ideal": (True, None),
        "theirs": (False, "1"),
        "weak": (False, "2"),
    }
    # the title of another entry does not make two rows one
    assert {name: row.label for name, row in by_entry.items()} == {
        "ideal": "ideal",
        "theirs": "ideal [theirs]",
        "weak": "weak",
    }


def test_seeds_may_differ_in_number_but_tracks_may_not():
    entries = [
        entry("many", *(result([60, 61, 62, 63], track=track) for track in TRACKS)),
        entry("few", *(result([30], track=track) for track in TRACKS)),
        entry("one-track", result([90], track=TRACKS[0])),
    ]
    results = results_of(entries, [EQUAL])
    assert {name: row.rank for name, row in rows(results).items()} == {
        "many": "1",
        "few": "2",
        "one-track": None,
    }
    assert rows(results, track=TRACKS[0])["one-track"].rank == "1"
    assert [results.seeds_of(target) for target in results.targets] == [[0, 1, 2, 3]] * 2


def test_versions_of_packages_may_differ():
    entries = [entry("a", result([1], numpy="2.1")), entry("b", result([2], numpy="2.0"))]
    assert results_of(entries, [EQUAL]).packages == {"numpy": ("2.0", "2.1")}


def test_versions_of_a_track_may_not_differ():
    entries = [entry("a", result([1])), entry("b", result([2], fingerprint="other"))]
    with pytest.raises(
        UserError, match=r"one version of SADA-Driving-Straight-v0.*fingerprint was"
    ):
        results_of(entries, [EQUAL])


def test_no_entries_make_empty_results():
    empty = results_of([], tuple(TABLES.values()))
    assert (empty.runs, empty.comparisons, empty.targets, empty.packages) == ((), (), (), {})
