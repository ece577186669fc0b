import json

import numpy as np
import pytest
from made_entries import PACKAGES, make_entry
from sada_gym.submission.entry import ResultFiles, read_entry, write_result, write_verified
from sada_gym.submission.models import Result, SeedResult, Verified
from sada_gym.submission.today import board_tracks, find_rule, today

from sada_gym.errors import FileError, UserError
from sada_gym.submission.checks import check_entry, is_outdated


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


def test_the_budget_of_boosting_comes_on_top(digits):
    ((_, result),) = read_entry(digits).results.items()
    assert result.claimed.identity.budget == 1_200
    assert is_outdated(result.claimed.identity) is None
    assert today("SADA-Digits-3-v0", "cnn", "equal-queries", "gp", None, {}).budget == 2_000
    assert today("SADA-Detection-Car-v0", "surveyor", "paper-budgets", "x", None, {}).budget == (
        find_rule("paper-budgets").budget_of["SADA-Detection"].queries
    )
    assert today("SADA-Digits-3-v0", "cnn", "paper-budgets", "ideal", None, {}).budget == 0


def test_general_ids_are_no_tracks():
    assert "SADA-Digits-3-v0" in board_tracks()
    assert "SADA-Analytic-v0" in board_tracks()
    assert "SADA-Digits-v0" not in board_tracks()


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"fooling_threshold": 0.2}, "fooling_threshold was 0.2 and is 0.1"),
        ({"budget": 5}, "budget was 5 and is 1200"),
        ({"samples": 50}, "samples was 50 and is 250"),
        ({"version": 7}, "version was 7 and is 0"),
        ({"fingerprint": "0"}, "fingerprint was '0' and is "),
        ({"reference": None}, "reference was None and is "),
        ({"resolved": {}}, "resolved"),
        ({"track": "SADA-Digits-3-v9"}, "Expected the track to be one of "),
        ({"agent": "resnet"}, "Expected the agent on SADA-Digits-3-v0 to be one of cnn; got"),
        ({"rule": "no-limit"}, "Expected the rule to be one of paper-budgets, equal-queries"),
        ({"options": {"stepz": 1}}, "Expected the option of bbgan-boost to be one of"),
    ],
)
def test_what_is_no_longer_todays_is_outdated(digits, changes, said):
    ((_, result),) = read_entry(digits).results.items()
    found = is_outdated(result.claimed.identity.model_copy(update=changes))
    assert found is not None
    assert said in found


def test_strangers_options_are_theirs():
    told = ("SADA-Analytic-v0", "", "paper-budgets", "os:system", "fast", {"command": "ls"})
    identity = today(*told, resolved={"command": "ls", "depth": 3})
    assert is_outdated(identity) is None
    assert identity.resolved["depth"] == 3


def changed(folder, change_identity=None, change_seed=None, change_samples=None):
    """Write the only result of an entry anew, so that its hash fits."""
    ((_, result),) = read_entry(folder).results.items()
    claimed, samples = result.claimed, result.samples
    identity = claimed.identity.model_copy(update=change_identity or {})
    seeds = [one.model_copy(update=change_seed or {}) for one in claimed.seeds]
    for one in samples.values():
        if change_samples:
            change_samples(one)
    for path in folder.glob("SADA*"):
        path.unlink()
    write_result(folder, Result.make(identity, seeds), samples)


def test_an_outdated_entry_is_right_but_cannot_be_submitted(tmp_path):
    folder = make_entry(tmp_path)
    changed(folder, {"version": 7, "track": "SADA-Analytic-v7"})
    check_entry(folder, submission=False)
    with pytest.raises(UserError, match=r"Expected .* to be of today's track, agent, rule and opt"):
        check_entry(folder)


def test_verified_results_are_no_submission(tmp_path):
    folder = make_entry(tmp_path)
    ((stem, result),) = read_entry(folder).results.items()
    verified = Verified.make(result.claimed, result.samples, "1")
    write_verified(folder, stem, verified)
    check_entry(folder, submission=False)
    with pytest.raises(UserError, match="Expected no results of the verifier in a submission"):
        check_entry(folder)
    ResultFiles(folder, stem).verified.write_text('{"format": 1}')
    with pytest.raises(FileError, match="as sada-gym writes it"):
        check_entry(folder, submission=False)


def test_a_failure_is_a_result(tmp_path):
    folder = make_entry(tmp_path)
    ((_, result),) = read_entry(folder).results.items()
    failed = SeedResult(seed=0, queries=0, error="too small", measures=None, packages=PACKAGES)
    write_result(folder, Result.make(result.claimed.identity, [failed]), {})
    check_entry(folder)


def test_coverage_must_be_that_of_the_samples(digits, tmp_path):
    folder = tmp_path / digits.name
    folder.mkdir()
    for path in digits.iterdir():
        (folder / path.name).write_bytes(path.read_bytes())
    (path,) = folder.glob("*.json")
    claims = json.loads(path.read_text())
    claims["seeds"][1]["measures"]["coverage"] += 0.1
    path.write_text(json.dumps(claims))
    with pytest.raises(UserError, match=r"Expected coverage = .* of seed 1, as its samples give"):
        check_entry(folder)


def test_seeds_cannot_be_chosen(tmp_path):
    folder = make_entry(tmp_path)
    ((_, result),) = read_entry(folder).results.items()
    write_result(
        folder,
        Result.make(result.claimed.identity, result.claimed.seeds[1:]),
        {1: result.samples[1]},
    )
    check_entry(folder, submission=False)
    with pytest.raises(UserError, match=r"Expected the seeds 0, 1, 2 and so on in .*, got .1."):
        check_entry(folder)


def test_samples_must_be_evaluated_on_their_seeds(tmp_path):
    folder = make_entry(tmp_path)
    changed(folder, change_samples=lambda one: one.seed.__setitem__(3, 4))
    with pytest.raises(UserError, match="Expected the evaluation seeds of the test stream of seed"):
        check_entry(folder)
    folder = make_entry(tmp_path)
    changed(folder, change_samples=lambda one: one.mu.__setitem__((3, 1), np.float32(1.5)))
    with pytest.raises(UserError, match=r"Expected mu of seed 0 within \[-1, 1\] in .*, got 1.5"):
        check_entry(folder)
