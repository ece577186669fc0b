import dataclasses
import json
import shutil
import subprocess
import sys
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
from made_entries import (
    ANALYTIC,
    change_samples,
    make_entry,
    only_result,
    replace_result,
    uniform,
    with_changes,
)
from make_golden import GOLDEN, NONCE
from typer.testing import CliRunner

from leaderboard.verify import app
from sada_gym import adversaries
from sada_gym.board.results.entry import EntryResult, GroupFiles, read_entry
from sada_gym.board.results.models import Result
from sada_gym.board.results.samples import samples_bytes
from sada_gym.board.submission.current import current_target
from sada_gym.board.submission.verification import fresh_seeds, verify
from sada_gym.errors import UserError
from sada_gym.evaluation.evaluator import Evaluator
from sada_gym.evaluation.oracle import Oracle
from sada_gym.evaluations import Evaluations, evaluation_seeds
from sada_gym.experiment.ideal import Ideal

ROOT = Path(__file__).parents[2]
DIGITS, DIGIT_5 = "SADA-Digits-0-v0", "SADA-Digits-5-v0"
PLACE = f"{ANALYTIC}.paper-budgets"
GROUP = "SADA-Analytic"


def verified_file(folder):
    return GroupFiles(folder, GROUP).verified


def read_verified(folder):
    (verified,) = GroupFiles(folder, GROUP).read_verified().values()
    return verified


@pytest.fixture(scope="module")
def honest(tmp_path_factory):
    return make_entry(tmp_path_factory.mktemp("honest"), "honest")


@pytest.fixture
def entry(honest, tmp_path):
    return Path(shutil.copytree(honest, tmp_path / "board" / "honest"))


def test_samples_are_scored_again_on_seeds_that_the_run_did_not_see():
    seeds = fresh_seeds(("mine", "a" * 64), "nonce", 0, 1_000)
    assert all(0 <= seed < 2**31 for seed in seeds)
    assert len(set(seeds)) == 1_000
    for stream in ("train", "test", "validation"):
        assert not {*seeds} & {*evaluation_seeds(0, stream, 0, 1_000)}
    # what a world takes from a seed's lowest bits is as it was when the entry was made
    assert {seed % 4 for seed in seeds} == {seed % 4 for seed in evaluation_seeds(0, "test", 0, 9)}
    for other in (
        (("yours", "a" * 64), "nonce", 0),
        (("mine", "b" * 64), "nonce", 0),
        (("mine", "a" * 64), "other", 0),
        (("mine", "a" * 64), "nonce", 1),
    ):
        assert not {*seeds} & {*fresh_seeds(*other, 1_000)}


def test_an_honest_entry_is_verified_without_a_flag(entry):
    (finding,) = verify([entry], "nonce")
    assert (finding.entry, finding.place, finding.state) == ("honest", PLACE, "verified")
    assert finding.verified == read_verified(entry)
    assert finding.verified.flags == {}
    result = read_entry(entry).results[PLACE]
    assert result.tier == "verified"
    # the landscape has no noise: the measures are those that the entry claims
    for claims, verified in zip(result.claimed.seeds, finding.verified.seeds, strict=True):
        assert verified.seed == claims.seed
        assert verified.measures == claims.measures


def test_verifying_twice_and_in_any_order_gives_the_same_bytes(entry, tmp_path):
    other = make_entry(
        entry.parent, "other", rule="equal-queries", draw=lambda s, *a: uniform(s + 9, *a)
    )
    list(verify([entry, other], "nonce"))
    first = [verified_file(folder).read_bytes() for folder in (entry, other)]
    assert [finding.state for finding in verify([other, entry], "nonce")] == ["unchanged"] * 2
    assert [finding.state for finding in verify([other, entry], "nonce", again=True)] == [
        "verified"
    ] * 2
    assert [verified_file(folder).read_bytes() for folder in (entry, other)] == first
    assert [finding.state for finding in verify([entry], "another", missing=True)] == ["unchanged"]
    list(verify([entry], "another", workers=2))
    assert verified_file(entry).read_bytes() != first[0]
    list(verify([entry], "nonce", workers=2))
    assert verified_file(entry).read_bytes() == first[0]


def test_claims_never_change_what_is_verified(entry):
    list(verify([entry], "nonce"))
    honest = read_verified(entry)
    change_samples(entry, lambda rows: dataclasses.replace(rows, score=np.zeros(len(rows))))
    # it counts no longer, and the file is gone
    assert read_entry(entry).results[PLACE].tier == "claimed"
    (finding,) = verify([entry], "nonce")
    assert finding.verified.seeds == honest.seeds
    assert finding.verified.samples_sha256 != honest.samples_sha256
    assert "500 of 500 samples fool the agent as claimed" in finding.verified.flags["claim"]


def test_an_honest_claim_on_images_that_follow_from_the_seed_is_not_flagged(tmp_path):
    # digit 5 has 44 images, of which the seeds of each stream see 11: take the place where those of
    # the stream `test` fool more than those of `verification`
    places = uniform(0, 200, 6).astype(np.float32)
    with closing(Evaluator(DIGIT_5)) as evaluator:
        asked = np.repeat(places, 44, axis=0), [*range(44)] * len(places)
        scores = evaluator.evaluate(*asked, lambda *_: None)[0].reshape(-1, 11, 4)
        fooled = (scores <= evaluator.threshold).mean(axis=1)
    chosen = places[np.argmax(fooled[:, 1] - fooled[:, 3])]

    def near(seed, count, dimension):
        return np.clip(chosen + 0.01 * uniform(seed, count, dimension), -1.0, 1.0)

    folder = make_entry(tmp_path, "near", track=DIGIT_5, agent="cnn", draw=near)
    for nonce in "abc":
        (finding,) = verify([folder], nonce)
        assert {*finding.verified.flags} <= {"collapsed", "worse than random"}


def test_what_was_verified_counts_for_no_other_samples(entry):
    list(verify([entry], "nonce"))
    before = verified_file(entry).read_bytes()
    change_samples(entry, lambda rows: dataclasses.replace(rows, mu=rows.mu * np.float32(0.5)))
    assert not verified_file(entry).exists()
    verified_file(entry).write_bytes(before)
    assert read_entry(entry).results[PLACE].verified is None


def test_a_few_lucky_claims_are_no_fraud(entry):
    def add_luck(rows):
        score = rows.score.copy()
        score[np.flatnonzero(score > 0.3)[:8]] = 0.1  # 16 rows of two seeds: p = 1.5e-5
        return dataclasses.replace(rows, score=score)

    change_samples(entry, add_luck)
    (finding,) = verify([entry], "nonce")
    assert finding.verified.flags == {}


def test_constant_scores_are_flagged_where_the_true_ones_vary(entry):
    change_samples(entry, lambda rows: dataclasses.replace(rows, score=np.full(len(rows), 0.9)))
    (finding,) = verify([entry], "nonce")
    assert "all 250 samples of seed 0 have Q = 0.9 as claimed" in finding.verified.flags["constant"]
    assert "claim" not in finding.verified.flags


def test_samples_of_another_entry_are_flagged(entry):
    make_entry(entry.parent, "thief", rule="equal-queries")  # the same samples
    (finding,) = verify([entry.parent / "thief"], "nonce")
    assert finding.verified.flags == {
        "duplicates": "100.0 % of the samples equal samples of the entry honest"
    }
    elsewhere = entry.parents[1] / "elsewhere"
    elsewhere.mkdir()
    (finding,) = verify([entry.parent / "thief"], "nonce", again=True, against=elsewhere)
    assert finding.verified.flags == {}


def test_a_broken_neighbour_is_left_out(entry):
    broken = entry.parent / "broken"
    broken.mkdir()
    (broken / f"{GROUP}.npz").write_bytes(b"no archive")
    other = entry.parent / "other"
    other.mkdir()
    samples = {
        f"{ANALYTIC}.{rule}": {0: Evaluations(mu, np.zeros(9), np.array(test_seeds))}
        for test_seeds in [evaluation_seeds(0, "test", 0, 9)]
        for rule, mu in (
            ("paper-budgets", np.zeros((9, 3), np.float32)),
            ("equal-queries", np.full((9, 2), np.nan, np.float32)),
        )
    }
    (other / f"{GROUP}.npz").write_bytes(samples_bytes(samples))
    (finding,) = verify([entry], "nonce")
    assert finding.verified.flags == {}


def test_samples_that_avoid_the_fooling_set_are_worse_than_random(tmp_path):
    with_edge = lambda seed, n, d: uniform(seed, n, d) * 0.01 + 0.0  # noqa: E731 - no box is there
    folder = make_entry(tmp_path, "bad", draw=with_edge)
    (finding,) = verify([folder], "nonce")
    assert finding.verified.seeds[0].measures.fooled == 0
    assert {*finding.verified.flags} == {"collapsed", "worse than random"}


def test_a_refused_entry_does_not_stop_the_others(entry):
    bad = make_entry(
        entry.parent, "bad", rule="equal-queries", draw=lambda s, *a: uniform(s + 9, *a)
    )
    path = GroupFiles(bad, GROUP).claims
    content = json.loads(path.read_text())
    content["results"][0]["seeds"][0]["queries"] = 10_000_000
    path.write_text(json.dumps(content))
    first, second = verify([bad, entry], "nonce")
    assert (first.entry, first.state) == ("bad", "refused")
    assert "10,000,000" in first.reason  # over budget: not even evaluated
    assert second.state == "verified"
    assert not list(bad.glob("*.verified.json"))


def test_an_outdated_result_is_not_evaluated(entry):
    result = only_result(entry)
    experiment = with_changes(result.experiment, application={"fingerprint": "0" * 64})
    claimed = Result.make(experiment, result.claimed.seeds)
    replace_result(entry, EntryResult(claimed, result.samples))
    (finding,) = verify([entry], "nonce")
    assert finding.state == "outdated"
    assert "fingerprint" in finding.reason
    assert not list(entry.glob("*.verified.json"))


def test_without_a_nonce_nothing_is_fresh(entry):
    with pytest.raises(UserError, match="Expected a nonce, got none"):
        list(verify([entry], None))


def test_check_compares_and_writes_nothing(entry):
    (finding,) = verify([entry], None, check=True)
    assert finding.state == "differs"
    assert not list(entry.glob("*.verified.json"))
    list(verify([entry], "nonce"))
    (finding,) = verify([entry], None, check=True)
    assert finding.state == "unchanged"
    path = verified_file(entry)
    edited = path.read_text().replace('"afr": 0.', '"afr": 0.9')
    path.write_text(edited)
    (finding,) = verify([entry], None, check=True)
    assert finding.state == "differs"
    assert path.read_text() == edited


def test_the_command_says_what_it_found(entry):
    def run(*words):
        return CliRunner().invoke(app, [*map(str, words)])

    refused = run(entry)
    assert refused.exit_code == 2
    assert "Expected a nonce" in refused.output
    done = run(entry, "--nonce", "2026-11")
    assert done.exit_code == 0
    assert f"honest {PLACE}: verified" in done.output
    assert "seed 1: AFR" in done.output
    assert "verified before, and unchanged" in run(entry, "--nonce", "2026-11").output
    missing = run(entry, entry.parent / "missing", "--nonce", "2026-11")
    assert missing.exit_code == 1
    assert "missing: refused:" in missing.output


@pytest.mark.slow
def test_it_runs_as_a_module(entry):
    done = subprocess.run(
        [sys.executable, "-m", "leaderboard.verify", str(entry), "--nonce", "a"],
        cwd=ROOT,
        check=False,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    assert verified_file(entry).exists()


def of_the_truth(jitter):
    """Draw what a cheat submits: points of the reference set that fool, shaken."""
    inside = current_target(DIGITS, "cnn").fooling_set

    def draw(seed, count, dimension):
        rng = np.random.default_rng(seed + 100)
        points = inside[rng.choice(len(inside), count, replace=False)]
        return np.clip(points + rng.normal(0.0, jitter, points.shape), -1.0, 1.0)

    return draw


def of_one_point(seed, count, dimension):
    return np.repeat(current_target(DIGITS, "cnn").fooling_set[:1] + 0.01, count, axis=0).clip(
        -1, 1
    )


def of_memorised(seed, count, dimension):
    seed += 50  # its first queries would be the samples of `uniform`
    with Oracle(DIGITS, budget=1_000, seed=seed) as oracle:
        memorise = adversaries.make("memorise", dimension, seed=seed)
        memorise.train(oracle)
        return memorise.sample(count)


@pytest.fixture(scope="module")
def tiny_board(tmp_path_factory):
    board = tmp_path_factory.mktemp("board")
    ideal_set = current_target(DIGITS, "cnn").ideal_set

    def make(name, draw, **changes):
        where = {"track": DIGITS, "agent": "cnn", "queries": 0, **changes}
        return make_entry(board, name, draw=draw, **where)

    folders = [
        make("random", uniform, adversary="random", options={}),
        make("memorise", of_memorised, adversary="memorise", options={}),
        make("constant", of_one_point),
        make(
            "ideal",
            lambda seed, n, d: Ideal(d, seed=seed, fooling_set=ideal_set).sample(n),
            adversary="ideal",
            options={},
        ),
        make("cheat", of_the_truth(0.05)),
        make("bold-cheat", of_the_truth(0.0)),
    ]
    findings = list(verify(folders, "nonce"))
    assert all(finding.state == "verified" for finding in findings), findings
    return {finding.entry: finding.verified for finding in findings}


def test_each_control_lands_where_it_belongs(tiny_board):
    afr, covered = (
        {
            name: np.mean([getattr(seed.measures, measure) for seed in verified.seeds])
            for name, verified in tiny_board.items()
        }
        for measure in ("afr", "relative_coverage")
    )
    assert afr["random"] < 0.5
    # `memorise` repeats uniform queries that fooled: of these 67.7 % fool again on another seed
    assert afr["memorise"] == pytest.approx(0.677, abs=0.06)
    # the points of the fooling set fool on 68.0 to 71.6 % of fresh seeds, by eight nonces
    assert afr["ideal"] == pytest.approx(0.70, abs=0.05)
    assert covered["constant"] < 0.05 < covered["random"] < covered["ideal"]
    assert covered["ideal"] == pytest.approx(1.0)
    for seed in tiny_board["ideal"].seeds:
        assert seed.measures.relative_coverage == 1.0


def test_the_cheats_are_flagged_and_nobody_else_is_accused(tiny_board):
    flags = {name: {*verified.flags} for name, verified in tiny_board.items()}
    assert "copied" in flags["cheat"]
    assert "copied" in flags["bold-cheat"]
    assert "to the last bit" in tiny_board["bold-cheat"].flags["copied"]
    assert {"collapsed", "duplicates"} <= flags["constant"]
    assert "copied" not in flags["constant"]
    assert flags["ideal"] == {"control"}
    assert flags["random"] == set()
    assert flags["memorise"] == set()


def test_the_golden_folder_is_verified_as_ever(tmp_path):
    board = Path(shutil.copytree(GOLDEN, tmp_path / "golden"))
    expected = {path.name: read_verified(path) for path in board.iterdir()}
    assert {verified.nonce for verified in expected.values()} == {NONCE}
    # with the salt of each file, so that the fresh seeds are the same
    findings = list(verify(sorted(board.iterdir()), None, check=True))
    assert {finding.state for finding in findings} <= {"unchanged", "differs"}
    computed = {finding.entry: finding.verified for finding in findings}
    assert computed.keys() == expected.keys()
    for name, verified in computed.items():
        assert verified.salt == expected[name].salt
        assert verified.flags == expected[name].flags
        for ours, golden in zip(verified.seeds, expected[name].seeds, strict=True):
            measures, others = ours.measures.model_dump(), golden.measures.model_dump()
            for measure in ("mean_score", "mu_std"):
                # processors may sum up a mean in another order
                assert measures.pop(measure) == pytest.approx(others.pop(measure), rel=1e-12)
            assert (ours.seed, measures) == (golden.seed, others)
    assert {name: {*verified.flags} for name, verified in computed.items()} == {
        "at-the-centre": {"collapsed", "worse than random"},
        "edited": {"claim", "constant"},
        "honest": {"duplicates"},  # nobody can tell who was first
        "thief": {"duplicates"},
        "two-points": {"duplicates"},
    }
