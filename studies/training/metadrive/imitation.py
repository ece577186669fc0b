"""A driver imitates MetaDrive's own expert by DAgger, so that PPO begins with one that arrives."""

from __future__ import annotations

from typing import Any

import numpy as np
from stable_baselines3 import PPO
from torch import Tensor

from sada_gym import agents
from sada_gym.envs.metadrive.episodes import DriveEpisodes
from sada_gym.envs.metadrive.start import DriveDistribution, DriveEnd
from studies.training.common import Imitation
from studies.training.imitation import Examples, dagger
from studies.training.imitation import fit as fit_parameters

EXPERT = "metadrive-expert"
_PUSHES, _PUSH, _FADE = 0.05, 0.1, 0.75
"""How often the expert's wheel is pushed, how hard (1: full lock), what is left a step later."""


def imitate(model: PPO, settings: Imitation[DriveDistribution], *, seed: int) -> None:
    """Fit a PPO's policy to the expert; its value is not touched."""
    rng = np.random.default_rng(seed)
    examples = Examples(settings.rounds * settings.steps)
    dagger(
        settings,
        lambda expert_share: _gather(model, settings, examples, expert_share, rng),
        lambda epochs: _fit(model, examples, settings, epochs, rng),
    )


def _gather(
    model: PPO,
    settings: Imitation[DriveDistribution],
    examples: Examples,
    expert_share: float,
    rng: np.random.Generator,
) -> str:
    """Drive for a round, the expert a share of the drives; say how many drives arrived."""
    expert = agents.load(EXPERT, "SADA-DrivingMetaDrive")
    drive = DriveEpisodes([settings.distribution.draw(rng)])
    only, by_expert, push = np.arange(1), rng.random() < expert_share, 0.0
    arrived, ended = 0, 0
    for _ in range(settings.steps):
        observation = drive.observe(only)
        answers = np.clip(expert.act(drive, only), -1.0, 1.0)
        examples.add(observation, answers)
        if by_expert:
            # a push to the wheel now and then, so that the expert shows how to recover
            push = rng.normal(0.0, _PUSH) if rng.random() < _PUSHES else _FADE * push
            actions = answers + np.array([push, 0.0])
        else:
            actions, _ = model.predict(observation, deterministic=True)
        drive.step(only, np.clip(actions, -1.0, 1.0))
        if drive.ending[0] != DriveEnd.UNDER_WAY:
            ended += 1
            arrived += int(drive.ending[0] == DriveEnd.ARRIVED)
            drive.begin(0, settings.distribution.draw(rng))
            by_expert = rng.random() < expert_share
    return f"{arrived} of {ended} drives arrived"


def _fit(
    model: PPO,
    examples: Examples,
    settings: Imitation[DriveDistribution],
    epochs: int,
    rng: np.random.Generator,
) -> float:
    """Fit the policy's mean action to the expert's, and give the last epoch's mean loss."""
    policy: Any = model.policy

    def loss(observation: dict[str, Tensor], answers: Tensor) -> Tensor:
        hidden = policy.mlp_extractor.forward_actor(policy.features_extractor(observation))
        mean: Tensor = (policy.action_net(hidden) - answers).square().mean()
        return mean

    policy.set_training_mode(True)
    parameters = [*policy.mlp_extractor.policy_net.parameters(), *policy.action_net.parameters()]
    mean = fit_parameters(parameters, examples, settings, epochs, rng, loss)
    policy.set_training_mode(False)
    return mean
