"""RAPTOR, computed here, against the package's own code."""

from importlib.metadata import distribution

import numpy as np
import pytest
from zoo import needs

from sada_gym import agents
from sada_gym.envs.quadrotor.agent.raptor import Raptor
from sada_gym.foundations.cards import find_card

pytestmark = needs("foundation-policy", "h5py")


class Shown:
    """Episodes that show what they are told to."""

    def __init__(self, observations):
        self.observations = observations

    def observe(self, which):
        return {"state": self.observations[which]}


@pytest.fixture(scope="module")
def raptor():
    return agents.load("raptor", "SADA-Quadrotor")


@pytest.fixture(scope="module")
def example():
    """The observations and actions that RAPTOR's authors put beside the weights."""
    import h5py

    (member,) = find_card("SADA-Quadrotor").packaged[0].members
    with h5py.File(distribution("foundation-policy").locate_file(member), "r") as file:
        return file["example/input"][()], file["example/output"][()]


def test_it_acts_as_its_authors_say(raptor, example):
    from foundation_policy import Raptor as Original

    theirs, both = Original(), np.arange(2)
    theirs.reset()
    raptor.start(2)
    for observations, actions in zip(*example, strict=True):
        mine = raptor.act(Shown(observations), both)
        np.testing.assert_allclose(
            mine, theirs.evaluate_step(observations.astype(float)), atol=1e-12
        )
        np.testing.assert_allclose(mine, actions, atol=1e-5)


def test_flights_do_not_share_a_memory(raptor, example):
    observations = example[0][:50].transpose(1, 0, 2)
    raptor.start(2)
    together = [raptor.act(Shown(observations[:, k]), np.arange(2)) for k in range(50)]
    for which in (0, 1):
        raptor.start(2)
        for k in range(50):
            alone = raptor.act(Shown(observations[:, k]), np.array([which]))
            np.testing.assert_array_equal(alone[0], together[k][which])


def test_its_fingerprint_is_that_of_its_weights(raptor):
    arrays = {
        "0/weights": np.ones((16, 22), np.float32),
        "0/biases": np.ones((1, 16), np.float32),
        "2/weights": np.ones((4, 16), np.float32),
        "2/biases": np.ones((1, 4), np.float32),
        "1/initial_hidden_state": np.zeros(16, np.float32),
    }
    for part in ("input", "hidden"):
        arrays[f"1/weights_{part}"] = np.ones((48, 16), np.float32)
        arrays[f"1/biases_{part}"] = np.ones(48, np.float32)
    other = Raptor(arrays)
    arrays["2/biases"] = np.full((1, 4), 2.0, np.float32)
    assert len({raptor.fingerprint, other.fingerprint, Raptor(arrays).fingerprint}) == 3
