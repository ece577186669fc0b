"""Failures of a run: confirmed on fresh seeds, grouped, and told in words."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from toy import Greedy, Toy

from sada_gym import attack, make_application
from sada_gym.analyses.failures import confirm_failures, fresh_seeds
from sada_gym.errors import UserError
from sada_gym.evaluation.evaluator import Evaluated, Evaluator
from sada_gym.evaluation.store import EvaluationStore
from sada_gym.evaluations import evaluation_seeds
from sada_gym.measures.failures import FAILURES_FILE, Failures, read_failures

ANALYTIC = "SADA-Analytic-v0"
NOISY = {"noise": 0.2, "volume": 0.3}


def run(folder: Path, environment: Any = ANALYTIC, **keywords: Any) -> Any:
    given = {"budget": 0, "samples": 60, "pictures": False, **keywords}
    return attack(environment, "random", out=folder, **given)


def test_each_failure_is_tried_again_on_seeds_that_nothing_else_used(tmp_path: Path) -> None:
    result = run(tmp_path / "run", env_kwargs=NOISY, confirm=5)
    failures = result.failures
    assert failures == read_failures(tmp_path / "run")
    application = make_application(ANALYTIC, **NOISY)
    fooled = result.samples.fooled(0.3)
    assert failures.fooled.fooled == fooled.sum() == len(failures.failures)
    used = {*result.samples.seed.tolist(), *evaluation_seeds(0, "train", 0, 1_000)}
    for failure in failures.failures:
        seeds = fresh_seeds(0, failure.sample, 5)
        assert not used & {*seeds}
        again = application.evaluate(np.repeat([failure.mu], 5, axis=0), seeds)
        assert failure.fooled_seeds == again.fooled.sum()
        assert failure.valid_seeds == 5
        assert failure.score == result.samples.score[failure.sample]
    confirmed = sum(2 * failure.fooled_seeds > 5 for failure in failures.failures)
    assert 0 < confirmed < len(failures.failures), "the noise is strong"
    assert failures.confirmed.fooled == failures.confirmed_afr.fooled == confirmed
    assert failures.confirmed_afr.samples == 60
    certainties = [failure.fooled_seeds for failure in failures.failures]
    assert certainties == sorted(certainties, reverse=True)
    text = repr(result)
    assert f" confirmed: {confirmed} of {len(failures.failures)} fail again on most of 5" in text


def test_groups_hold_each_failure_once_and_a_representative(tmp_path: Path) -> None:
    failures = run(tmp_path / "run", env_kwargs={"volume": 0.3}, samples=200, confirm=0).failures
    assert len(failures.groups) >= 4, "there are four regions"
    for number, group in enumerate(failures.groups, 1):
        inside = [failure.sample for failure in failures.failures if failure.group == number]
        assert len(inside) == group.failures
        assert group.representative in inside
    assert failures.confirmed is failures.confirmed_afr is None
    assert sum(event.count for event in failures.behaviours.events) == failures.behaviours.worlds


def test_more_seeds_ask_only_for_the_further_ones(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    result = run(tmp_path / "run", env_kwargs=NOISY, confirm=2)
    count = len(result.failures.failures)
    reported: list[tuple[int, int, int]] = []
    found = confirm_failures(tmp_path / "run", 5, on_scores=lambda *counts: reported.append(counts))
    assert found is not None
    assert reported[0] == (2 * count, 5 * count, 2 * count)
    assert reported[-1] == (5 * count, 5 * count, 2 * count)
    assert found.seeds == 5

    def fail(*_: Any) -> Evaluated:
        raise AssertionError("nothing is to be evaluated")

    monkeypatch.setattr(Evaluator, "evaluate", fail)
    assert confirm_failures(tmp_path / "run", 5) == found
    assert confirm_failures(tmp_path / "run", 0) == found, "what is known is not thrown away"
    assert run(tmp_path / "run", env_kwargs=NOISY, confirm=5, resume=True).failures == found


def test_by_default_as_many_failures_are_tried_again_as_is_cheap(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    few = run(tmp_path / "few", env_kwargs=NOISY, samples=60)
    assert (few.failures.seeds, few.failures.tried) == (0, 0)
    assert "not yet tried on fresh seeds" in repr(few)
    assert f"sada-gym confirm {tmp_path / 'few'} --seeds 2" in repr(few)
    result = run(tmp_path / "run", env_kwargs=NOISY, samples=400)
    found = result.failures
    assert found.tried == 400 * 0.05 // 2 < found.fooled.fooled
    rows = sorted(failure.sample for failure in found.failures if failure.valid_seeds is not None)
    assert rows == np.flatnonzero(result.samples.fooled(0.3))[:10].tolist()
    assert (found.confirmed.samples, found.confirmed_afr.samples) == (10, rows[-1] + 1)
    assert f"{found.confirmed.fooled} of 10 tried fail again on fresh seeds" in repr(result)

    def fail(*_: Any) -> Evaluated:
        raise AssertionError("nothing is to be evaluated")

    (tmp_path / "run" / FAILURES_FILE).unlink()
    commit = EvaluationStore.commit
    monkeypatch.setattr(EvaluationStore, "commit", fail)
    assert run(tmp_path / "run", env_kwargs=NOISY, samples=400, resume=True).failures == found
    monkeypatch.setattr(EvaluationStore, "commit", commit)
    whole = run(tmp_path / "run", env_kwargs=NOISY, samples=400, resume=True, confirm=2).failures
    assert whole.tried == whole.fooled.fooled == len(whole.failures)


def test_a_stopped_confirmation_goes_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    whole = run(tmp_path / "whole", env_kwargs=NOISY, samples=120, confirm=3)
    result = run(tmp_path / "run", env_kwargs=NOISY, samples=120)
    commit = EvaluationStore.commit
    calls = []

    def stop_at_second(*arguments: Any, **keywords: Any) -> Any:
        calls.append(0)
        if len(calls) == 2:
            raise KeyboardInterrupt
        return commit(*arguments, **keywords)

    monkeypatch.setattr(EvaluationStore, "commit", stop_at_second)
    with pytest.raises(KeyboardInterrupt):
        confirm_failures(tmp_path / "run", 3)
    monkeypatch.undo()
    assert read_failures(tmp_path / "run") == result.failures
    reported: list[tuple[int, int, int]] = []
    confirm_failures(tmp_path / "run", 3, on_scores=lambda *counts: reported.append(counts))
    assert reported[0][2] > 0
    names = [tmp_path / name / FAILURES_FILE for name in ("run", "whole")]
    assert names[0].read_bytes() == names[1].read_bytes()
    assert whole.failures.confirmed is not None


@pytest.mark.parametrize("damage", ["", "{", '{"version": 9}'])
def test_a_damaged_file_is_made_anew(tmp_path: Path, damage: str) -> None:
    result = run(tmp_path / "run")
    (tmp_path / "run" / FAILURES_FILE).write_text(damage)
    assert run(tmp_path / "run", resume=True).failures == result.failures
    assert read_failures(tmp_path / "run") == result.failures


def test_a_run_without_failures_has_no_file(tmp_path: Path) -> None:
    result = run(tmp_path / "run", Toy(offset=0.9), confirm=3)
    assert result.failures is None
    assert not (tmp_path / "run" / FAILURES_FILE).exists()
    assert confirm_failures(tmp_path / "run", application=Toy(offset=0.9)) is None
    assert read_failures(tmp_path / "run") is None


def test_workers_confirm_the_same(tmp_path: Path) -> None:
    found = [
        attack(
            Toy(),
            Greedy,
            out=tmp_path / str(workers),
            budget=60,
            samples=20,
            confirm=3,
            workers=workers,
            pictures=False,
        ).failures
        for workers in (1, 2)
    ]
    assert found[0] == found[1]


@pytest.mark.parametrize("seeds", [-1, 1.5, "3", True, 1_001])
def test_bad_numbers_of_seeds_are_one_sentence(tmp_path: Path, seeds: Any) -> None:
    with pytest.raises((UserError, TypeError), match="Expected confirm"):
        run(tmp_path / "run", confirm=seeds)
    assert not (tmp_path / "run").exists()


class Odd(Toy):
    """Its words fail in one of several ways."""

    what: Any = ()

    def behaviours(self, mu: Any, seeds: Any) -> Any:
        if isinstance(self.what, Exception):
            raise self.what
        return self.what


@pytest.mark.parametrize("what", [RuntimeError("no words"), ["fell"], (), None])
def test_an_application_that_fails_to_tell_costs_no_result(tmp_path: Path, what: Any) -> None:
    application = Odd()
    application.what = what
    with pytest.warns(UserWarning, match=r"What the agent did is left out. Odd.behaviours"):
        result = run(tmp_path / "run", application, samples=100)
    assert result.failures.behaviours is None
    assert result.failures.failures


def test_of_very_many_failures_the_first_ones_are_listed_and_counted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("sada_gym.analyses.failures._MOST_LISTED", 7)
    result = run(tmp_path / "run", env_kwargs=NOISY, samples=100, confirm=1)
    rows = np.flatnonzero(result.samples.fooled(0.3))[:7]
    assert sorted(failure.sample for failure in result.failures.failures) == rows.tolist()
    assert result.failures.fooled.samples == rows[-1] + 1
    assert Failures.model_validate(json.loads((tmp_path / "run" / FAILURES_FILE).read_text()))
