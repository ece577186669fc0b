import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from made_entries import PACKAGES, make_entry, only_result, replace_result, with_changes

from sada_gym.board.benchmark.suite import TABLES
from sada_gym.board.results.entry import EntryResult, GroupFiles, write_results
from sada_gym.board.results.models import Result, SeedResult, Verified
from sada_gym.board.submission.checks import check_entry, find_outdated
from sada_gym.board.submission.current import board_tracks, current_experiment
from sada_gym.errors import FileError, UserError
from sada_gym.experiment.adversary import AdversarySpec


@pytest.fixture(scope="module")
def digits(tmp_path_factory):
    return make_entry(
        tmp_path_factory.mktemp("entries"),
        "bbgan-boost-paper",
        track="SADA-Digits-3-v0",
        agent="cnn",
        adversary="bbgan-boost",
        preset="paper",
        options={"steps": 10},
    )


def test_a_good_entry_passes(tmp_path, digits):
    check_entry(make_entry(tmp_path))
    check_entry(digits)
    check_entry(digits, submission=False)


def budget_of(track, agent, rule, adversary):
    return current_experiment(track, agent, rule, AdversarySpec(name=adversary)).protocol.budget


def test_the_budget_of_boosting_comes_on_top(digits):
    experiment = only_result(digits).claimed.experiment
    assert experiment.protocol.budget == 1_200
    assert find_outdated(experiment) is None
    assert budget_of("SADA-Digits-3-v0", "cnn", "equal-queries", "gp") == 2_000
    assert budget_of("SADA-Detection-Car-v0", "surveyor", "paper-budgets", "x") == (
        TABLES["paper-budgets"].budget_of["SADA-Detection"].queries
    )
    assert budget_of("SADA-Digits-3-v0", "cnn", "paper-budgets", "ideal") == 0


def test_general_ids_are_no_tracks():
    assert "SADA-Digits-3-v0" in board_tracks()
    assert "SADA-Analytic-v0" in board_tracks()
    assert "SADA-Digits-v0" not in board_tracks()


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"target": {"fooling_threshold": 0.2}}, "fooling_threshold was 0.2 and is 0.1"),
        ({"protocol": {"budget": 5}}, "budget was 5 and is 1200"),
        ({"protocol": {"samples": 50}}, "samples was 50 and is 250"),
        ({"application": {"version": 7}}, "version was 7 and is 0"),
        ({"application": {"fingerprint": "0"}}, "fingerprint was '0' and is "),
        ({"application": {"name": "SADA-Robot"}}, "name was 'SADA-Robot' and is 'SADA-Digits'"),
        ({"target": {"reference": None}}, "reference was None and is "),
        ({"adversary": {"resolved": {}}}, "resolved"),
        ({"target": {"track": "SADA-Digits-3-v9"}}, "Expected the track to be one of "),
        (
            {"target": {"agent": "resnet"}},
            "Expected the agent on SADA-Digits-3-v0 to be one of cnn; got",
        ),
        (
            {"protocol": {"rule": "no-limit"}},
            "Expected the rule to be one of paper-budgets, equal-queries",
        ),
        (
            {"adversary": {"options": {"stepz": 1}}},
            "Expected the option of bbgan-boost to be one of",
        ),
    ],
)
def test_what_is_no_longer_todays_is_outdated(digits, changes, said):
    reason = find_outdated(with_changes(only_result(digits).claimed.experiment, **changes))
    assert reason is not None
    assert said in reason


def test_strangers_options_are_theirs():
    options = {"command": "ls"}
    spec = AdversarySpec(name="os:system", preset="fast", options=options)
    resolved = spec.model_copy(update={"resolved": {"command": "ls", "depth": 3}})
    experiment = current_experiment("SADA-Analytic-v0", "", "paper-budgets", resolved)
    assert find_outdated(experiment) is None
    assert experiment.adversary.resolved["depth"] == 3
    experiment = current_experiment("SADA-Analytic-v0", "", "paper-budgets", spec)
    assert experiment.adversary.resolved == options


def change(folder, *, seeds=None, samples=None, **changes):
    """Write the only result of an entry anew, so that its hash fits."""
    result = only_result(folder)
    experiment = with_changes(result.experiment, **changes)
    claims = [claims.model_copy(update=seeds or {}) for claims in result.claimed.seeds]
    all_samples = {s: samples(rows) if samples else rows for s, rows in result.samples.items()}
    replace_result(folder, EntryResult(Result.make(experiment, claims), all_samples))


def test_an_outdated_entry_is_right_but_cannot_be_submitted(tmp_path):
    folder = make_entry(tmp_path)
    change(folder, application={"version": 7}, target={"track": "SADA-Analytic-v7"})
    check_entry(folder, submission=False)
    with pytest.raises(UserError, match=r"Expected .* to be of today's track, agent, rule and opt"):
        check_entry(folder)


def make_verified(result):
    return Verified.make(result.claimed, result.samples, ("mine", result.claimed.sha256), "1")


def test_verified_results_are_no_submission(tmp_path):
    folder = make_entry(tmp_path)
    result = only_result(folder)
    files = GroupFiles(folder, result.experiment.group)
    files.add_verified(result.place, make_verified(result))
    check_entry(folder, submission=False)
    with pytest.raises(UserError, match="Expected no results of the verifier in a submission"):
        check_entry(folder)
    files.verified.write_text('{"format": 2}')
    with pytest.raises(FileError, match="as sada-gym writes it"):
        check_entry(folder, submission=False)


@pytest.mark.parametrize("place", ["SADA-Analytic-v0.equal-queries", "a\x1b[2J"])
def test_findings_are_of_results(tmp_path, place):
    folder = make_entry(tmp_path)
    result = only_result(folder)
    files = GroupFiles(folder, result.experiment.group)
    files.add_verified(place, make_verified(result))
    with pytest.raises(UserError, match=r"Expected findings of .*paper-budgets.* got") as caught:
        check_entry(folder, submission=False)
    assert str(caught.value).isprintable()


def test_a_place_is_in_one_group_alone(tmp_path):
    folder = make_entry(tmp_path)
    result = only_result(folder)
    experiment = with_changes(result.experiment, application={"name": "SADA-Other"})
    write_results(folder, [replace(result, claimed=Result.make(experiment, result.claimed.seeds))])
    with pytest.raises(
        UserError, match=r"Expected SADA-Analytic-v0.paper-budgets once in .*, got it in"
    ):
        check_entry(folder, submission=False)


def test_a_failure_is_a_result(tmp_path):
    folder = make_entry(tmp_path)
    failed = SeedResult(seed=0, queries=0, error="too small", measures=None, packages=PACKAGES)
    experiment = only_result(folder).claimed.experiment
    replace_result(folder, EntryResult(Result.make(experiment, [failed]), {}))
    check_entry(folder)


def test_coverage_must_be_that_of_the_samples(digits, tmp_path):
    folder = Path(shutil.copytree(digits, tmp_path / digits.name))
    (path,) = folder.glob("*.json")
    content = json.loads(path.read_text())
    content["results"][0]["seeds"][1]["measures"]["coverage"] += 0.1
    path.write_text(json.dumps(content))
    with pytest.raises(
        UserError, match=r"Expected coverage = .*, as the samples give it, for seed 1"
    ):
        check_entry(folder)


def test_seeds_cannot_be_chosen(tmp_path):
    folder = make_entry(tmp_path)
    result = only_result(folder)
    claimed = Result.make(result.experiment, result.claimed.seeds[1:])
    replace_result(folder, EntryResult(claimed, {1: result.samples[1]}))
    check_entry(folder, submission=False)
    with pytest.raises(UserError, match=r"Expected the seeds 0, 1, 2 and so on for .*, got .1."):
        check_entry(folder)


def test_samples_lie_in_the_box(tmp_path):
    folder = make_entry(tmp_path)
    assert len(only_result(folder).samples[0]) == 250

    def leave_the_box(rows):
        mu = rows.mu.copy()
        mu[3, 1] = np.float32(1.5)
        return replace(rows, mu=mu)

    change(folder, samples=leave_the_box)
    with pytest.raises(UserError, match=r"Expected mu within \[-1, 1\] for seed 0 of .*, got 1.5"):
        check_entry(folder)
