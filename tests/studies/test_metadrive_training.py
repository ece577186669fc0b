"""The training of a MetaDrive driver: it imitates the expert, then learns by PPO."""

from dataclasses import replace

import pytest
import torch
from zoo import needs

from sada_gym.envs.metadrive import close_engine
from studies.training.metadrive import train
from studies.training.metadrive.recipe import IMITATION, RECIPES

pytestmark = [pytest.mark.slow, needs("metadrive-simulator")]

BRIEF = replace(IMITATION, rounds=2, steps=32, epochs=1, last_epochs=1, batch=16)
SHORT = replace(
    RECIPES["metadrive-ppo"], steps=32, rollout=16, batch=16, epochs=1, value_steps=1_000
)


@pytest.fixture(autouse=True)
def brief_imitation(monkeypatch):
    monkeypatch.setattr(train, "IMITATION", BRIEF)
    yield
    close_engine()


def weights(recipe, seed):
    return train.train(recipe, seed=seed).policy.state_dict()


def test_a_training_is_fixed_by_its_seed():
    first, again, other = (weights(replace(SHORT, value_steps=0), seed) for seed in (0, 0, 1))
    assert all(torch.equal(first[name], again[name]) for name in first)
    assert not torch.equal(first["action_net.weight"], other["action_net.weight"])


def test_the_imitated_policy_is_kept_until_values_are_known(monkeypatch):
    kept = weights(SHORT, 0)
    changed = weights(replace(SHORT, value_steps=0), 0)
    monkeypatch.setattr(train, "IMITATION", replace(BRIEF, rate=0.0))
    untaught = weights(SHORT, 0)
    name = "mlp_extractor.policy_net.0.weight"
    assert not torch.equal(kept[name], untaught[name])  # imitation teaches it
    assert not torch.equal(kept[name], changed[name])  # and PPO later on
    assert torch.equal(kept["log_std"], untaught["log_std"])
