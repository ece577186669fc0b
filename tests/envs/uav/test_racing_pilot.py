import pickle

import numpy as np
import pytest
import torch
from gymnasium import spaces
from stable_baselines3 import PPO

from sada_gym.agents.policy import Policy
from sada_gym.envs.uav.agent.network import WaypointNetwork, new_model, new_network
from sada_gym.envs.uav.agent.pilot import PrivilegedPilot, WaypointPilot, as_pilot
from sada_gym.envs.uav.application import UAVApplication
from sada_gym.envs.uav.task import RacingTaskVectorEnv
from sada_gym.foundations.sb3_vec_env import SB3VecEnv


@pytest.fixture(scope="module")
def model():
    return new_model(0)


def race(agent, mu, seeds=None):
    application = UAVApplication(3, agent=agent)
    return application.evaluate(mu, seeds or list(range(len(mu))))


def test_what_flies_an_agent(model):
    assert isinstance(as_pilot(new_network(0)), WaypointPilot)
    assert isinstance(as_pilot(model), Policy)
    reference = PrivilegedPilot()
    assert as_pilot(reference) is reference


def said(outcome):
    """All that evaluations tell, comparable."""
    return [
        {key: np.asarray(value).tolist() for key, value in info.items()} for info in outcome.infos
    ]


@pytest.mark.long
@pytest.mark.parametrize(
    ("agent", "numbers"),
    [
        ("waypoint-pid", range(10)),
        ("ppo", range(20)),
        pytest.param("waypoint-pid", range(256), marks=pytest.mark.slow),
        pytest.param("ppo", range(256), marks=pytest.mark.slow),
    ],
)
def test_a_race_does_not_depend_on_the_others_in_the_batch(agent, numbers):
    application = UAVApplication(5, agent=agent)
    seeds = np.array(numbers)
    mu = np.random.default_rng(1).uniform(-1, 1, (256, 10)).astype(np.float32)[seeds]
    turned = np.random.default_rng(3).permutation(len(seeds))
    together = said(application.evaluate(mu, seeds.tolist()))
    assert any("hit" in info["endings"] for info in together)
    shuffled = said(application.evaluate(mu[turned], seeds[turned].tolist()))
    assert shuffled == [together[i] for i in turned]
    for i in (0, 4, 5):
        assert said(application.evaluate(mu[i : i + 1], seeds[i : i + 1].tolist())) == [together[i]]


@pytest.mark.parametrize("kind", ["network", "model"])
def test_a_pilot_without_numbers_misses_every_gate(kind):
    agent = new_network(0) if kind == "network" else new_model(0)
    application = UAVApplication(3, agent=agent)
    broken = agent if kind == "network" else agent.policy
    with torch.no_grad():  # only now: an application refuses such weights
        for weights in broken.parameters():
            weights.fill_(np.nan)
    outcome = application.evaluate(np.zeros((3, 6)), [0, 1, 2])
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
    assert as_pilot(model).fingerprint == as_pilot(new_model(0)).fingerprint
    assert as_pilot(model).fingerprint != as_pilot(new_model(1)).fingerprint


def test_answers_of_another_shape_are_refused(model):
    class Narrow(WaypointNetwork):
        def forward(self, light, motion):
            return super().forward(light, motion)[:, :5]

    class Lame(PrivilegedPilot):
        def act(self, races, which):
            return super().act(races, which)[:, :3]

    with pytest.raises(ValueError, match=r"answers of shape \(8, 6\) from Narrow, got \(8, 5\)"):
        race(Narrow(), np.zeros((1, 6)))
    with pytest.raises(ValueError, match=r"actions of shape \(2, 4\), one for .*, got \(2, 3\)"):
        race(Lame(), np.zeros((2, 6)))


def test_a_model_fresh_from_its_training_can_be_sent_to_another_process():
    env = RacingTaskVectorEnv(num_envs=2)
    model = PPO("MultiInputPolicy", SB3VecEnv(env), n_steps=8, batch_size=8, device="cpu")
    model.learn(16)
    again = pickle.loads(pickle.dumps(UAVApplication(3, agent=model)))
    assert again.fingerprint == UAVApplication(3, agent=model).fingerprint
    env.close()
