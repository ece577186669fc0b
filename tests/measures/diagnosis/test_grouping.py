"""Failures are grouped by their weakness, and by wide gaps within it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from sada_gym import attack, diagnose
from sada_gym.analyses.failures import confirm_failures
from sada_gym.measures.failures import read_failures


@pytest.mark.parametrize(("dimension", "regions"), [(2, 1), (4, 3), (8, 2)])
def test_there_are_as_many_groups_as_regions(tmp_path: Path, dimension: int, regions: int) -> None:
    result = attack(
        "SADA-Analytic-v0",
        "random",
        env_kwargs={"dimension": dimension, "regions": regions, "volume": 0.2},
        budget=1_500,
        samples=250,
        out=tmp_path / "run",
        pictures=False,
    )
    assert result.failures is not None
    groups = result.failures.groups
    apart = [group for group in groups if group.weakness] or groups
    assert abs(len(apart) - regions) <= 1


def test_a_new_diagnosis_groups_anew_and_a_confirmation_keeps_the_groups(tmp_path: Path) -> None:
    folder = tmp_path / "run"
    given = {"regions": 3, "volume": 0.2, "noise": 0.05}
    options = {"budget": 800, "samples": 100, "env_kwargs": given, "pictures": False}
    before = attack("SADA-Analytic-v0", "random", out=folder, diagnose=False, **options).failures
    assert before is not None
    assert {group.weakness for group in before.groups} == {None}
    diagnosis = diagnose(folder)
    found = read_failures(folder)
    assert found is not None
    assert {group.weakness for group in found.groups} >= {1}
    for group in found.groups:
        inside = [one for one in found.failures if found.groups[one.group - 1] == group]
        assert len(inside) == group.failures
        assert group.representative in {one.sample for one in inside}
        alone = [one.weakness for one in found.groups].count(group.weakness) == 1
        if group.weakness and alone:
            assert group.where == diagnosis.weaknesses[group.weakness - 1].text
    assert np.sum([group.failures for group in found.groups]) == before.fooled.fooled
    confirmed = confirm_failures(folder, 2)
    assert confirmed is not None
    assert confirmed.groups == found.groups
