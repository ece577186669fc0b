"""A driver imitates the privileged driver, its expert, by DAgger.

Cars drive in lockstep through the training town, in the first round by the expert under noise, in
the later ones more and more by the learner. At every step the expert says what it would do, and the
network is fitted to all that was gathered so far.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from stable_baselines3 import PPO
from torch import Tensor

from sada_gym.envs.driving.agent.network import new_model
from sada_gym.envs.driving.camera.pinhole import camera
from sada_gym.envs.driving.episodes import DrivingEnd, DrivingEpisodes
from studies.training.common import Imitation
from studies.training.driving.privileged import PrivilegedDriver
from studies.training.imitation import Examples, dagger, relight
from studies.training.imitation import fit as fit_parameters

_PUSHES, _PUSH, _FADE = 0.08, 0.25, 0.75
"""How often the expert's wheel is pushed, how hard (1: full lock), what is left a step later."""
_STEERING_WEIGHT = 4.0


def imitate(settings: Imitation[Any], *, seed: int) -> PPO:
    """Train a driver from nothing, and give it in a PPO, whose own training never runs."""
    rng = np.random.default_rng(seed)
    # whoever loads the model gets a rollout buffer of that many pictures
    model = new_model(seed, n_steps=16, batch_size=16)
    examples = Examples(settings.rounds * settings.steps)

    def gather_round(expert_share: float) -> str:
        failures = gather(model, settings, examples, expert_share, rng)
        return f"{failures} cars left their lane"

    dagger(settings, gather_round, lambda epochs: fit(model, examples, settings, epochs, rng))
    return model


def gather(
    model: PPO,
    settings: Imitation[Any],
    examples: Examples,
    expert_share: float,
    rng: np.random.Generator,
) -> int:
    """Drive for a round, the expert a share of the drives; give how many cars left their lane."""
    distribution, cars = settings.distribution, settings.lockstep
    expert = PrivilegedDriver()
    drives = DrivingEpisodes(
        camera(distribution.layout), [distribution.draw(rng) for _ in range(cars)]
    )
    everyone = np.arange(cars)
    by_expert = rng.random(cars) < expert_share
    push = np.zeros(cars)
    failures = 0
    for _ in range(settings.steps // cars):
        observation = drives.observe(everyone)
        answers = expert.act(drives, everyone)
        examples.add(observation, answers)
        actions = answers.copy()
        if not by_expert.all():
            learnt, _ = model.predict(observation, deterministic=True)
            actions[~by_expert] = learnt[~by_expert]
        # a push to the wheel now and then, so that the expert shows how to recover
        pushed = rng.random(cars) < _PUSHES
        push = np.where(pushed, rng.normal(0, _PUSH, cars), _FADE * push)
        actions[by_expert, 0] += push[by_expert]
        drives.step(everyone, np.clip(actions, -1, 1))
        for i in np.flatnonzero(drives.ending).tolist():
            failures += int(drives.ending[i] == DrivingEnd.LEFT_LANE)
            drives.begin(i, distribution.draw(rng))
            by_expert[i] = rng.random() < expert_share
    return failures


def fit(
    model: PPO,
    examples: Examples,
    settings: Imitation[Any],
    epochs: int,
    rng: np.random.Generator,
) -> float:
    """Fit the policy's mean action to the expert's, and give the last epoch's mean loss."""
    policy = model.policy
    weights = torch.tensor([_STEERING_WEIGHT, 1.0])

    def loss(observation: dict[str, Tensor], answers: Tensor) -> Tensor:
        jitter = settings.light_jitter
        observation["image"] = relight(observation["image"], jitter, jitter / 4, rng)
        actions = policy.action_net(policy.features_extractor(observation))
        mean: Tensor = ((actions - answers).abs() * weights).mean()
        return mean

    policy.set_training_mode(True)
    parameters = [*policy.features_extractor.parameters(), *policy.action_net.parameters()]
    mean = fit_parameters(parameters, examples, settings, epochs, rng, loss)
    policy.set_training_mode(False)
    return mean
