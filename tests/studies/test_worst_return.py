"""RRLS' sets for the hopper: the grid, the searches and what is printed; its agent's training."""

import json

import numpy as np
import pytest

from sada_gym.foundations.determinism import one_thread
from studies import worst_return as study
from studies.agents import FOLDER
from studies.training import hopper as training

pytest.importorskip("mujoco")


def still(observation):
    """Fall over sooner or later."""
    return np.zeros(3, np.float32)


@pytest.fixture(autouse=True)
def _one_thread():
    with one_thread():
        yield


def test_the_grid_has_ten_values_a_parameter_from_the_lower_end_on():
    application = study.hopper(2, still)
    physical = application.parameters.physical(study.grid(2))
    assert physical.shape == (100, 2)
    expected = 0.1 + 0.29 * np.arange(10)
    for column in physical.T:
        np.testing.assert_allclose(np.unique(column.round(4)), expected, atol=1e-4)
    assert len(study.grid(3)) == 1_000


def test_parameters_change_the_simulated_robot():
    application = study.hopper(3, still)
    scores = application.evaluate(np.array([[1.0, 1.0, 1.0], [1.0, -1.0, -1.0]]), [0, 0]).score
    assert scores[0] != scores[1]
    assert (scores > 0.0).all()


def test_the_answer_is_the_world_of_the_lowest_return_judged_on_other_episodes():
    found = study.run("random", 1, 12, 0, still)
    application = study.hopper(1, still)
    mu = application.parameters.normalised([[found["world"]["friction"]]])
    returns = study.HIGHEST_RETURN * application.evaluate(np.repeat(mu, 8, axis=0), range(8)).score
    assert returns.min() - 5.0 < found["return"] < returns.max() + 5.0
    assert found["seen"] <= found["return"] + 5.0
    assert found["worlds"] == 12


@pytest.mark.parametrize(
    ("search", "parameters", "worlds"),
    [
        ("grid", 1, 10),
        ("random", 1, 10),
        ("level-set", 1, study.MIN_BUDGET),
        ("bayesian", 1, 10),
        pytest.param("cma-mae", 2, 10, marks=pytest.mark.long),
    ],
)
def test_each_search_asks_as_many_worlds_as_it_may(search, parameters, worlds, monkeypatch):
    asked = []
    played = study.Lowest.__call__

    def counted(self, mu):
        asked.append(len(mu))
        return played(self, mu)

    monkeypatch.setattr(study.Lowest, "__call__", counted)
    monkeypatch.setattr(study, "EPISODES", 1)
    study.run(search, parameters, worlds, 0, still)
    assert sum(asked) == worlds


def test_the_plan_and_the_table(tmp_path):
    runs = list(study.plan())
    assert ("grid", 3, 1_000, 4) in runs
    assert ("bayesian", 2, 10, 0) in runs
    assert ("level-set", 3, 100, 0) in runs
    assert min(worlds for _, _, worlds, _ in runs) == 10
    assert min(worlds for search, _, worlds, _ in runs if search == "level-set") == 100
    assert len(set(runs)) == len(runs)
    for search, parameters, worlds, seed in (("grid", 2, 100, 0), ("random", 2, 10, 0)):
        piece = {"search": search, "parameters": parameters, "worlds": worlds, "return": 12.3}
        (tmp_path / f"{search}-{seed}.json").write_text(json.dumps(piece))
    lines = study.table(tmp_path).splitlines()
    assert lines[0].split(" | ")[1:4] == [
        "d = 1, 10 worlds",
        "d = 2, 100 worlds",
        "d = 2, 10 worlds",
    ]
    assert lines[2] == "| grid | - | 12 | - | - | - |"
    assert lines[3] == "| random | - | - | 12 | - | - |"


def test_the_agent_is_trained_measured_and_written(tmp_path):
    recipe = training.Recipe(steps=64, envs=2, rollout=32)
    training.run(recipe, 0, tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["hopper.zip"]
    figures = training.measure(study.hopper(1, tmp_path / "hopper.zip").agent, seed=0, episodes=2)
    assert figures.count("\n") == 4


def test_the_agent_is_the_one_of_the_card():
    assert study.SHA256 in (FOLDER / "hopper.md").read_text("utf-8")
    assert study.checked(study.AGENT, study.SHA256) == study.AGENT
