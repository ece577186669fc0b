"""What pilots are taken, and what becomes of those that give no numbers or fail."""

import numpy as np
import pytest
import torch
from torch import nn

from sada_gym import agents
from sada_gym.agents.policy import POLICY_TILE
from sada_gym.envs.uav.agent.network import WaypointNetwork, new_model
from sada_gym.envs.uav.agent.pilot import PrivilegedPilot, WaypointPilot
from sada_gym.envs.uav.application import UAVApplication
from sada_gym.envs.uav.episodes import ACTION_SPACE, OBSERVATION_SPACE, POLICY_HZ
from sada_gym.envs.uav.world.track import GATES


class Own:
    """A model of one's own."""

    observation_space, action_space = OBSERVATION_SPACE, ACTION_SPACE

    def predict(self, observation, *, deterministic):
        return np.zeros((POLICY_TILE, 4), np.float32), None


def race(agent, mu):
    return UAVApplication(3, agent=agent).evaluate(mu, list(range(len(mu))))


def assert_all_lost(application, decisions=0):
    outcome = application.evaluate(np.zeros((2, 6)), [0, 1])
    assert outcome.score.tolist() == [0, 0]
    assert {e for info in outcome.infos for e in info["endings"]} == {"lost"}
    # within a decision each, not after a flight out of the world
    assert max(info["time_s"] for info in outcome.infos) <= (decisions + GATES) / POLICY_HZ


def test_a_slip_in_a_models_own_code_is_not_taken_for_a_bad_pilot():
    class Slipping(Own):
        def predict(self, observation, *, deterministic):
            first, second, third = observation["gates"].shape
            return first, second, third

    with pytest.raises(ValueError, match="not enough values to unpack"):
        UAVApplication(3, agent=Slipping())


def test_nor_is_one_that_shows_in_flight_alone():
    class Flying(Own):
        def predict(self, observation, *, deterministic):
            # where the application tries a model out, it is shown random numbers
            if np.ptp(observation["motion"], axis=0).max() == 0:
                np.zeros(3).reshape(2, 2)
            return super().predict(observation, deterministic=deterministic)

    with pytest.raises(ValueError, match="cannot reshape"):
        race(Flying(), np.zeros((1, 6)))


def test_a_real_policy_shown_another_shape_says_so():
    class Cut(Own):
        def __init__(self):
            self.model = new_model(0)

        def predict(self, observation, *, deterministic):
            cut = {**observation, "gates": observation["gates"][:, :5]}
            return self.model.predict(cut, deterministic=deterministic)

    with pytest.raises(ValueError, match=r"Unexpected observation shape \(16, 5\)"):
        UAVApplication(3, agent=Cut())


@pytest.mark.long
def test_a_drone_that_is_told_nothing_costs_the_others_nothing():
    class Choosy(Own):
        """Refuses, as torch does, a tile with a drone that flies fast to its left."""

        def __init__(self):
            self.model = agents.load("ppo", "SADA-UAV")

        def predict(self, observation, *, deterministic):
            if (observation["motion"][:, 1] > 0.6).any():
                torch.distributions.Normal(torch.full((3,), torch.nan), 1.0)
            return self.model.predict(observation, deterministic=deterministic)

    mu = np.random.default_rng(0).uniform(-1, 1, (6, 6)).astype(np.float32)
    application = UAVApplication(3, agent=Choosy())
    together = application.evaluate(mu, list(range(6)))
    lost = [info["endings"].count("lost") for info in together.infos]
    assert sum(lost) > 0
    assert together.score.max() > 0
    for i in range(6):
        alone = application.evaluate(mu[i : i + 1], [i])
        assert alone.infos[0]["endings"] == together.infos[i]["endings"]
        assert alone.infos[0]["time_s"] == together.infos[i]["time_s"]


@pytest.mark.parametrize("given", [np.nan, np.inf, -np.inf])
def test_a_model_that_gives_no_finite_number_misses_every_gate(given):
    class Endless(Own):
        def predict(self, observation, *, deterministic):
            return np.tile(np.array([0.5, given, 0.0, 0.0], np.float32), (POLICY_TILE, 1)), None

    assert_all_lost(UAVApplication(3, agent=Endless()))


def test_so_does_one_of_sb3s():
    model = new_model(0)
    application = UAVApplication(3, agent=model)
    with torch.no_grad():  # only now: an application refuses such weights
        model.policy.action_net.bias[0] = torch.nan
    assert_all_lost(application)


def test_what_only_reads_like_torchs_refusal_is_the_models_own_error():
    class Worded(Own):
        def predict(self, observation, *, deterministic):
            raise ValueError("Expected the budget to satisfy the constraint Real()")

    with pytest.raises(ValueError, match="Expected the budget"):
        UAVApplication(3, agent=Worded())


def test_so_does_a_network_that_says_infinity_in_full_flight():
    class Late(WaypointNetwork):
        calls = 0

        def forward(self, light, motion):
            self.calls += 1
            answer = super().forward(light, motion)
            if self.calls > 10:
                answer[:, 5] = torch.inf
            return answer

    class Pilot(WaypointPilot):
        def start(self, count):
            self.network.calls = 0

    network = Late()
    network.load_state_dict(agents.load("waypoint-pid", "SADA-UAV").state_dict())
    assert_all_lost(UAVApplication(3, agent=Pilot(network)), decisions=10)


class Anonymous:
    """A pilot without a fingerprint."""

    def start(self, count):
        pass

    def act(self, races, which):
        return PrivilegedPilot().act(races, which)


@pytest.mark.parametrize(
    ("agent", "lacks"),
    [
        (nn.Linear(3, 4), "Linear, which has no fingerprint and no start and no act"),
        (Anonymous(), "Anonymous, which has no fingerprint"),
        (None, "NoneType, which has no fingerprint and no start and no act"),
    ],
)
def test_what_cannot_fly_is_refused_with_what_can(agent, lacks):
    kinds = "a WaypointNetwork, an SB3 model trained on SADA-RacingTask-v0, or an object with"
    with pytest.raises(ValueError, match=rf"Expected {kinds} .*, got {lacks}\."):
        UAVApplication(3, agent=agent)


def test_what_can_fly_is_taken():
    class Finer(WaypointNetwork):
        pass

    for agent in (Finer(), Own(), PrivilegedPilot()):
        assert UAVApplication(3, agent=agent).agent is agent
