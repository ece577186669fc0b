import numpy as np
import pytest
import torch
from gymnasium import spaces

from sada_gym.agents.pilot.network import new_network
from sada_gym.agents.pilot.reinforcement import new_model
from sada_gym.envs.uav.application import UAVApplication
from sada_gym.envs.uav.pilot import TaskPilot, WaypointPilot, pilot
from sada_gym.envs.uav.reference import Reference


@pytest.fixture(scope="module")
def model():
    return new_model(0)


def race(agent, mu, seeds=None):
    application = UAVApplication(3, agent=agent)
    return application.evaluate(mu, seeds or list(range(len(mu))))


def test_what_flies_an_agent(model):
    assert isinstance(pilot(new_network(0)), WaypointPilot)
    assert isinstance(pilot(model), TaskPilot)
    reference = Reference()
    assert pilot(reference) is reference


@pytest.mark.parametrize("kind", ["network", "model"])
def test_a_race_does_not_depend_on_the_others_in_the_batch(kind, model):
    agent = new_network(0) if kind == "network" else model
    mu = np.random.default_rng(0).uniform(-1, 1, (5, 6)).astype(np.float32)
    together = race(agent, mu, [3, 4, 5, 6, 7])
    for i in (4, 1):
        alone = race(agent, mu[i : i + 1], [3 + i])
        assert alone.score[0] == together.score[i]
        assert alone.infos[0]["time_s"] == together.infos[i]["time_s"]
        assert alone.infos[0]["endings"] == together.infos[i]["endings"]


@pytest.mark.parametrize("kind", ["network", "model"])
def test_a_pilot_without_numbers_misses_every_gate(kind):
    agent = new_network(0) if kind == "network" else new_model(0)
    broken = agent if kind == "network" else agent.policy
    with torch.no_grad():
        for weights in broken.parameters():
            weights.fill_(np.nan)
    outcome = race(agent, np.zeros((3, 6)))
    assert outcome.score.tolist() == [0, 0, 0]
    assert {e for info in outcome.infos for e in info["endings"]} == {"lost"}


def test_another_tasks_model_is_refused(model):
    class Other:
        observation_space = model.observation_space
        action_space = spaces.Box(-1, 1, (2,), np.float32)

        def predict(self, observation, *, deterministic):
            raise AssertionError

    with pytest.raises(ValueError, match="SADA-RacingTask-v0"):
        UAVApplication(3, agent=Other())


def test_fingerprints_tell_weights_apart(model):
    assert pilot(model).fingerprint == pilot(new_model(0)).fingerprint
    assert pilot(model).fingerprint != pilot(new_model(1)).fingerprint
