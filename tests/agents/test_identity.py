"""What stores know an agent by, and agents whose weights are no finite numbers."""

import copy
import json

import gymnasium as gym
import numpy as np
import pytest
import torch
from safetensors.torch import load_file, save_file
from stable_baselines3 import PPO
from torch import nn

from sada_gym import agents
from sada_gym.agents.policy import POLICY_TILE
from sada_gym.envs.detection import DetectionApplication
from sada_gym.envs.detection.agent.network import Detector
from sada_gym.envs.detection.shapes import CLASSES
from sada_gym.envs.driving import DrivingApplication
from sada_gym.envs.driving.agent.network import new_model as new_driver
from sada_gym.envs.uav import RacingTaskEnv, UAVApplication
from sada_gym.envs.uav.agent.network import WaypointNetwork, new_network
from sada_gym.envs.uav.agent.pilot import as_pilot
from sada_gym.envs.uav.episodes import ACTION_SPACE, OBSERVATION_SPACE
from sada_gym.errors import UserError
from sada_gym.measures.reference import FOLDER

PUBLISHED = {
    ("SADA-Detection-Car-v0", "photographer"): "710dee85db84a4c1",
    ("SADA-Detection-Car-v0", "surveyor"): "dde3d92be527df0e",
    ("SADA-Driving-Straight-v0", "cil"): "c7b2afedd804c31a",
    ("SADA-Driving-Straight-v0", "cil-augmented"): "5cf5a7e585c112f5",
    ("SADA-Driving-Straight-v0", "ppo"): "041a26fb9608de26",
    ("SADA-UAV-3Anchors-v0", "waypoint-pid"): "daaec9758aed2f1a",
    ("SADA-UAV-3Anchors-v0", "ppo"): "19524a301fb174d0",
}


def own_ppo(activation=nn.Tanh):
    settings = {"net_arch": [8], "activation_fn": activation}
    env = RacingTaskEnv()
    return PPO("MultiInputPolicy", env, policy_kwargs=settings, n_steps=8, batch_size=8, seed=0)


class OwnPilot:
    """An object that only holds what chooses its actions."""

    observation_space, action_space = OBSERVATION_SPACE, ACTION_SPACE

    def __init__(self, model):
        self.model = model

    def predict(self, observation, *, deterministic):
        return np.zeros((POLICY_TILE, 4), np.float32), None


def broken(module, value=np.nan):
    with torch.no_grad():
        next(module.parameters()).flatten()[0] = value
    return module


def test_shipped_agents_are_known_by_what_published_scores_are_kept_under():
    prints = {
        (track, name): gym.make(track, agent=name).unwrapped.application.fingerprint[:16]
        for track, name in PUBLISHED
    }
    assert prints == PUBLISHED
    index = FOLDER / "index.json"
    for row in json.loads(index.read_text())["references"]:
        known = PUBLISHED.get((row["track"], row["agent"]), row["fingerprint"][:16])
        assert known == row["fingerprint"][:16]


def test_equal_weights_under_another_activation_are_another_agent():
    first, same, other = own_ppo(), own_ppo(), own_ppo(nn.ReLU)
    other.policy.load_state_dict(first.policy.state_dict())
    prints = [as_pilot(model).fingerprint for model in (first, same, other)]
    assert prints[0] == prints[1] != prints[2]
    first.predict(OBSERVATION_SPACE.sample())
    assert as_pilot(first).fingerprint == prints[0]


def test_equal_weights_in_another_class_are_another_agent():
    class Finer(WaypointNetwork):
        pass

    network, finer = new_network(0), Finer()
    finer.load_state_dict(network.state_dict())
    assert agents.fingerprint(finer) != agents.fingerprint(network)


def test_a_detectors_settings_are_part_of_what_it_is():
    first, other = Detector(CLASSES), Detector(CLASSES, floor=0.3)
    other.load_state_dict(first.state_dict())
    assert agents.fingerprint(first) != agents.fingerprint(other)


def test_a_name_stands_for_kind_weights_and_use_as_well():
    def named(agent, agent_id="mine", **more):
        return UAVApplication(3, agent=agent, agent_id=agent_id, **more).fingerprint

    network = new_network(0)
    prints = [
        named(network),
        named(network, "other"),
        named(new_network(1)),
        named(OwnPilot(None)),
        UAVApplication(3, agent=network).fingerprint,
    ]
    assert len(set(prints)) == len(prints)
    assert all(len(digest) == 64 for digest in prints)
    assert named(copy.deepcopy(network)) == prints[0]


def test_no_name_and_no_weights_is_no_identity():
    assert agents.identity(None, OwnPilot(None), None) is None
    assert agents.identity(None, len, "mine") is not None


@pytest.mark.parametrize("agent_id", [3, b"mine", ["mine"]])
def test_an_agent_id_is_a_name(agent_id):
    with pytest.raises(UserError, match=r"Expected agent_id in one line, .*, got .*Rename it"):
        UAVApplication(3, agent=new_network(0), agent_id=agent_id)


def nan_policy(model):
    broken(model.policy)
    return model


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_a_detector_whose_weights_are_no_numbers_is_refused(value):
    detector = broken(Detector(CLASSES).eval(), value)
    for agent in (detector, detector.forward):
        with pytest.raises(
            ValueError, match=r"finite numbers, got .* with NaN or infinity in fine"
        ):
            DetectionApplication("car", agent=agent, labels={"car": 7}, agent_id="mine")


def test_a_driver_whose_weights_are_no_numbers_is_refused():
    with pytest.raises(
        ValueError, match=r"got PPO with NaN or infinity in policy\..*Train it again"
    ):
        DrivingApplication("straight", agent=nan_policy(new_driver(0)))


@pytest.mark.parametrize(
    ("make", "name"),
    [
        (lambda: broken(new_network(0)), r"WaypointNetwork .* in convolutions\.0\.weight"),
        (lambda: nan_policy(own_ppo()), r"PPO .* in policy\."),
        (lambda: OwnPilot(nan_policy(own_ppo())), r"OwnPilot .* in model\."),
        (lambda: OwnPilot(broken(nn.Linear(2, 2))), r"OwnPilot .* in model\.weight"),
    ],
    ids=["network", "sb3", "holds sb3", "holds torch"],
)
def test_a_pilot_whose_weights_are_no_numbers_is_refused(make, name):
    with pytest.raises(ValueError, match=f"Expected an agent whose weights .*, got {name}"):
        UAVApplication(3, agent=make())


def test_infinity_in_a_mask_is_no_weight():
    layer = nn.Linear(2, 2)
    layer.register_buffer("mask", torch.full((2, 2), -torch.inf))
    agents.check_finite_weights(layer)
    half_bytes = nn.Module()
    half_bytes.register_buffer("mask", torch.ones(2).to(torch.float8_e5m2))
    agents.check_finite_weights(half_bytes)
    layer.mask[0, 0] = torch.nan
    with pytest.raises(ValueError, match="in mask"):
        agents.check_finite_weights(layer)


@pytest.mark.parametrize(
    ("name", "application"),
    [
        ("photographer", "SADA-Detection"),
        ("cil", "SADA-Driving"),
        ("waypoint-pid", "SADA-UAV"),
    ],
)
def test_a_file_whose_weights_are_no_numbers_is_refused(name, application, tmp_path):
    card, path = agents.card(name), tmp_path / "mine.safetensors"
    weights = load_file(card.path)
    key = next(key for key, value in weights.items() if value.is_floating_point())
    weights[key].flatten()[0] = torch.nan
    from safetensors import safe_open

    with safe_open(card.path, "pt") as file:
        save_file(weights, path, file.metadata())
    with pytest.raises(
        ValueError, match=r"all of them finite, got NaN or infinity in .* Write such"
    ):
        agents.load(path, application)
