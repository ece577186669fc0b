"""Imitation of the expert by DAgger (Ross, Gordon, Bagnell 2011).

Cars drive in lockstep through the training town, in the first round by the expert under noise, in
the later ones more and more by the learner. At every step the expert says what it would do, and the
network is fitted to all that was gathered so far.
"""

from __future__ import annotations

import time

import numpy as np
import numpy.typing as npt
import torch
from stable_baselines3 import PPO
from torch import Tensor

from sada_gym.agents.training import batches
from sada_gym.envs.driving.agent.expert import Expert
from sada_gym.envs.driving.agent.network import new_model
from sada_gym.envs.driving.agent.recipe import Imitation
from sada_gym.envs.driving.camera.pinhole import camera
from sada_gym.envs.driving.drives import Drives, Ending, Observation

_PUSHES, _PUSH, _FADE = 0.08, 0.25, 0.75
"""How often the expert's wheel is pushed, how hard (1: full lock), what is left a step later."""
_STEERING_WEIGHT = 4.0


class Gathered:
    """Observations, and the expert's answers to them."""

    def __init__(self) -> None:
        self._parts: list[Observation] = []
        self._answers: list[npt.NDArray[np.float32]] = []

    def add(self, observation: Observation, answers: npt.NDArray[np.float64]) -> None:
        """Add n observations and the answers (n, 2) to them."""
        self._parts.append(observation)
        self._answers.append(answers.astype(np.float32))

    def arrays(self) -> tuple[Observation, npt.NDArray[np.float32]]:
        """All of them."""
        keys = self._parts[0]
        joined = {key: np.concatenate([part[key] for part in self._parts]) for key in keys}
        answers = np.concatenate(self._answers)
        self._parts, self._answers = [joined], [answers]
        return joined, answers


def imitate(settings: Imitation, *, seed: int) -> PPO:
    """Train a driver from nothing; it is held in a PPO, none of whose own training takes place."""
    rng = np.random.default_rng(seed)
    # whoever loads the model gets a rollout buffer of that many pictures
    model = new_model(seed, n_steps=16, batch_size=16)
    gathered = Gathered()
    started = time.monotonic()
    for number in range(settings.rounds):
        expert_share = 1.0 if number == 0 else 0.5**number
        failures = gather(model, settings, gathered, expert_share, rng)
        last = number == settings.rounds - 1
        epochs = settings.last_epochs if last else settings.epochs
        loss = fit(model, gathered, settings, epochs, rng)
        print(
            f"round {number}: {failures} cars left their lane, loss {loss:.4f}, "
            f"{time.monotonic() - started:.0f} s",
            flush=True,
        )
    return model


def gather(
    model: PPO,
    settings: Imitation,
    gathered: Gathered,
    expert_share: float,
    rng: np.random.Generator,
) -> int:
    """Drive for a round, the expert a share of the drives; gives how many cars left their lane."""
    course, cars = settings.course, settings.cars
    expert = Expert()
    drives = Drives(camera(course.layout), [course.draw(rng) for _ in range(cars)])
    everyone = np.arange(cars)
    by_expert = rng.random(cars) < expert_share
    push = np.zeros(cars)
    failures = 0
    for _ in range(settings.steps // cars):
        observation = drives.observe(everyone)
        answers = expert.act(drives, everyone)
        gathered.add(observation, answers)
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
            failures += int(drives.ending[i] == Ending.LEFT_LANE)
            drives.begin(i, course.draw(rng))
            by_expert[i] = rng.random() < expert_share
    return failures


def fit(
    model: PPO, gathered: Gathered, settings: Imitation, epochs: int, rng: np.random.Generator
) -> float:
    """Fit the policy's mean action to the expert's; gives the last epoch's mean loss."""
    observations, answers = gathered.arrays()
    policy = model.policy
    policy.set_training_mode(True)
    trained = [*policy.features_extractor.parameters(), *policy.action_net.parameters()]
    optimiser = torch.optim.Adam(trained, lr=settings.rate)
    steps = epochs * -(-len(answers) // settings.batch)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimiser, settings.rate, total_steps=steps)
    weights = torch.tensor([_STEERING_WEIGHT, 1.0])
    mean = 0.0
    for _ in range(epochs):
        losses = []
        for rows in batches(len(answers), settings.batch, rng):
            batch = {key: torch.from_numpy(value[rows]) for key, value in observations.items()}
            batch["image"] = _disturbed(batch["image"], settings.light_jitter, rng)
            actions = policy.action_net(policy.features_extractor(batch))
            loss = ((actions - torch.from_numpy(answers[rows])).abs() * weights).mean()
            optimiser.zero_grad()
            loss.backward()
            torch.nn.utils.clip_grad_norm_(trained, 1.0)
            optimiser.step()
            schedule.step()
            losses.append(float(loss.detach()))
        mean = float(np.mean(losses))
    policy.set_training_mode(False)
    return mean


def _disturbed(images: Tensor, jitter: float, rng: np.random.Generator) -> Tensor:
    """Bytes (n, rows, columns, 3) as light (n, 3, rows, columns) in [0, 1], each in another one."""

    def draw(width: float, channels: int) -> Tensor:
        values = rng.uniform(-width, width, (len(images), channels, 1, 1))
        return torch.from_numpy(values.astype(np.float32))

    light = images.permute(0, 3, 1, 2).float() / 255
    gain = 1 + draw(jitter, 1) + draw(jitter / 4, 3)
    return (light * gain + draw(jitter / 4, 1)).clamp_(0, 1)
