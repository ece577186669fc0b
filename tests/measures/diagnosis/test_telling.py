"""Weaknesses say what the agent does in them, and how many of their failures are confirmed."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from sada_gym import attack, diagnose, make_application
from sada_gym.application import Application
from sada_gym.measures.diagnosis.record import DIAGNOSIS_FILE, read_diagnosis
from sada_gym.measures.diagnosis.rules import holds

ANALYTIC = {"regions": 1, "volume": 0.2, "noise": 0.05}


def run(folder: Path, **options: Any) -> Any:
    given = {"budget": 1_000, "samples": 100, "env_kwargs": ANALYTIC, "pictures": False, **options}
    return attack("SADA-Analytic-v0", "random", out=folder, **given)


def test_a_weakness_tells_what_happens_in_it_and_what_is_confirmed(tmp_path: Path) -> None:
    result = run(tmp_path / "run", confirm=3)
    (weakness, *_) = result.diagnosis.weaknesses
    assert "in region 0 in" in weakness.behaviour
    space = make_application("SADA-Analytic-v0", **ANALYTIC).parameters
    mu = np.array([failure.mu for failure in result.failures.failures], np.float32)
    inside = holds(weakness.conditions, space, mu)
    again = [2 * failure.fooled_seeds > 3 for failure in result.failures.failures]
    assert weakness.confirmed.samples == inside.sum()
    assert weakness.confirmed.fooled == np.sum(inside & np.array(again))
    assert read_diagnosis(tmp_path / "run") == result.diagnosis


def test_a_later_diagnosis_tells_the_same_as_the_attack(tmp_path: Path) -> None:
    first = run(tmp_path / "run", env_kwargs={**ANALYTIC, "regions": 3}).diagnosis
    (tmp_path / "run" / DIAGNOSIS_FILE).unlink()
    assert diagnose(tmp_path / "run", workers=2) == first
    assert diagnose(tmp_path / "run") == first
    assert any(weakness.behaviour for weakness in first.weaknesses)


def test_a_finished_run_gets_them_later_and_plays_nothing_twice(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    first = run(tmp_path / "run", confirm=0)
    assert first.diagnosis.weaknesses[0].confirmed is None
    assert diagnose(tmp_path / "run", confirm=2).weaknesses[0].confirmed is not None

    def fail(*_: Any) -> Any:
        raise AssertionError("nothing is to be played")

    monkeypatch.setattr("sada_gym.analyses.failures.PlayedAgain.play", fail)
    again = run(tmp_path / "run", resume=True)
    assert again.diagnosis == read_diagnosis(tmp_path / "run")
    assert again.diagnosis.weaknesses[0].confirmed is not None


def test_no_failure_is_played_twice_at_the_end_of_an_attack(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    batches = []
    played = Application.behaviours

    def count(self: Application, mu: Any, seeds: Any) -> Any:
        batches.append([*zip(map(bytes, mu), seeds, strict=True)])
        return played(self, mu, seeds)

    monkeypatch.setattr(Application, "behaviours", count)
    result = run(tmp_path / "run", env_kwargs={**ANALYTIC, "regions": 3})
    assert all(weakness.behaviour for weakness in result.diagnosis.weaknesses)
    worlds = [world for batch in batches for world in batch]
    assert len(worlds) == len({*worlds})
    assert len(batches) <= 3  # failures, passes, and what weaknesses lack
