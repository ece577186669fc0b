"""The studies of stress testing, of few queries and of many dimensions."""

from __future__ import annotations

import numpy as np
import pytest

from sada_gym import StressEnv
from studies import few_queries, many_dimensions, stress

ANALYTIC = [
    name
    for names in many_dimensions.BY_DIMENSION.values()
    for name in names
    if not name.startswith("cart-pole")
]


@pytest.mark.long
def test_no_search_beats_the_likeliest_failure_of_the_walk(tmp_path, monkeypatch):
    monkeypatch.setattr(stress, "FOLDER", tmp_path)
    monkeypatch.setattr(stress, "METHODS", ("draws", "cross-entropy", "level-set"))
    stress.measure("walk", [0], steps=4_000)
    rows = stress.read("walk")
    assert [row["method"] for row in rows] == ["draws", "cross-entropy", "level-set"]
    assert all(row["failures"] > 0 for row in rows)
    assert min(row["half_sum"] for row in rows) >= 30 * (1 / 3) ** 2 / 2
    stress.measure("walk", [0], steps=4_000)
    assert stress.read("walk") == rows
    assert stress.table().count("| walk |") == 3


@pytest.mark.long
@pytest.mark.parametrize(("system", "first", "passes"), [("lander", 2, 3), ("robot", 0, 0)])
def test_an_undisturbed_agent_passes_in_the_world_of_a_run(system, first, passes):
    application = stress.SYSTEMS[system]()
    env = StressEnv(application, actions="normal", miss=300.0)
    assert stress.passing_seed(env, first) == passes
    counted = stress.Counted(env, passes, 0, 1)
    counted.play(np.zeros((1, 2)))
    assert -counted.left < application.step_limit


@pytest.mark.long
def test_few_queries_goes_on_where_it_stopped(tmp_path, monkeypatch):
    monkeypatch.setattr(few_queries, "FOLDER", tmp_path)
    few_queries.measure("SADA-Digits-3-v0", ["random", "trees"], [50], [0])
    rows = few_queries.read("SADA-Digits-3-v0")
    random, trees = rows
    assert random["f1"] < trees["f1"] <= 1.0
    assert trees["false"] <= trees["named"]
    few_queries.measure("SADA-Digits-3-v0", ["random", "trees"], [50], [0])
    assert few_queries.read("SADA-Digits-3-v0") == rows
    assert "| Digits-3 | 1 | 50 | " in few_queries.tables()


@pytest.mark.parametrize("name", ANALYTIC)
def test_a_tenth_of_uniform_worlds_fails_in_many_dimensions(name):
    problem = many_dimensions.Problem(name)
    mu = np.random.default_rng(1).uniform(-1.0, 1.0, (4_000, problem.dimension))
    rate = (problem.score(mu.astype(np.float32)) <= problem.threshold).mean()
    assert 0.05 <= rate <= 0.2
    assert len(problem.fooling_set) == len(problem.ideal) == 1_000
