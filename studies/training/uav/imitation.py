"""The perception network imitates the privileged pilot, its expert, by DAgger.

Drones fly in lockstep over mild tracks, in the first round to the true places of the gates, in the
later ones more and more to those that the network sees. The truth is kept at every step, and the
network is fitted to all that was gathered so far.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from torch import Tensor

from sada_gym.agents.tile import Batch
from sada_gym.envs.uav.agent.network import WaypointNetwork, new_network
from sada_gym.envs.uav.agent.pilot import PrivilegedPilot, WaypointPilot, motion
from sada_gym.envs.uav.episodes import RacingEpisodes
from sada_gym.envs.uav.world.guidance import SPEED_M_S
from sada_gym.envs.uav.world.referee import GateOutcome
from studies.training.common import Imitation
from studies.training.imitation import Examples, dagger, relight
from studies.training.imitation import fit as fit_parameters
from studies.training.uav.answers import in_drone

_PUSHES, _PUSH, _FADE = 0.06, 0.35, 0.85
"""How often a drone is pushed off its way, how hard (1: all it can), what is left a step later."""
_ASTRAY_M, _BEHIND_M = 15.0, 1.0
"""Farther from the next gate, or past it by more, a drone begins another race."""
_NEAR_M = 2.0
"""Errors of a waypoint weigh as if it were farther by that."""
_DIRECTION_WEIGHT = 0.3


def imitate(settings: Imitation[Any], *, seed: int) -> WaypointNetwork:
    """Train a network from nothing."""
    rng = np.random.default_rng(seed)
    network = new_network(seed)
    examples = Examples(settings.rounds * settings.steps)

    def gather_round(expert_share: float) -> str:
        astray = gather(network, settings, examples, expert_share, rng)
        return f"{len(examples):,} images, {astray} drones went astray"

    dagger(settings, gather_round, lambda epochs: fit(network, examples, settings, epochs, rng))
    return network.eval()


def gather(
    network: WaypointNetwork,
    settings: Imitation[Any],
    examples: Examples,
    expert_share: float,
    rng: np.random.Generator,
) -> int:
    """Fly for a round, the expert a share of the races; give how many drones went astray."""
    pilot, expert, drones = WaypointPilot(network), PrivilegedPilot(SPEED_M_S), settings.lockstep
    races = RacingEpisodes([settings.distribution.draw(rng) for _ in range(drones)])
    everyone = np.arange(drones)
    by_expert = rng.random(drones) < expert_share
    push = np.zeros((drones, 4))
    astray = 0
    for _ in range(settings.steps // drones):
        observation: Batch = {"image": races.render(everyone), "motion": motion(races.states)}
        examples.add(observation, in_drone(races.states, races.waypoints(everyone)))
        actions = expert.act(races, everyone)
        if not by_expert.all():
            by_network = np.flatnonzero(~by_expert)
            actions[by_network] = pilot.act(races, by_network)
        pushed = rng.random((drones, 1)) < _PUSHES
        fresh = rng.normal(0, _PUSH, (drones, 4)) * [1.0, 1.0, 0.4, 1.0]
        push = np.where(pushed, fresh, _FADE * push)
        races.step(everyone, actions + push)
        lost = strayed(races)
        finished = races.next_gate == races.gates.shape[1]
        astray += int(lost.sum())
        for i in np.flatnonzero(lost | finished).tolist():
            races.begin(i, settings.distribution.draw(rng))
            by_expert[i] = rng.random() < expert_share
            push[i] = 0.0
    return astray


def strayed(races: RacingEpisodes) -> npt.NDArray[np.bool_]:
    """Return which drones missed their gate: nothing ahead of them shows where it is."""
    gates = races.gates.shape[1]
    flying = np.flatnonzero(races.next_gate < gates)
    missed: npt.NDArray[np.bool_] = np.any(races.endings > GateOutcome.PASSED, axis=1)
    x, y, _, turn = races.waypoints(flying).T
    ahead = x * np.cos(turn) + y * np.sin(turn)
    missed[flying] |= (ahead < -_BEHIND_M) | (np.hypot(x, y) > _ASTRAY_M)
    return missed


def fit(
    network: WaypointNetwork,
    examples: Examples,
    settings: Imitation[Any],
    epochs: int,
    rng: np.random.Generator,
) -> float:
    """Fit the network to all examples, and give the last epoch's mean loss."""

    def loss_of(observation: dict[str, Tensor], truth: Tensor) -> Tensor:
        jitter = settings.light_jitter
        light = relight(observation["image"], jitter, jitter / 3, rng)
        return loss(network(light, observation["motion"]), truth)

    network.train()
    mean = fit_parameters([*network.parameters()], examples, settings, epochs, rng, loss_of)
    network.eval()
    return mean


def loss(answer: Tensor, truth: Tensor) -> Tensor:
    """Average the errors of answers (n, 6): of places relative to their distance, of directions."""
    error = (answer - truth).abs()
    far = truth[:, :3].norm(dim=1, keepdim=True) + _NEAR_M / 10
    mean: Tensor = (error[:, :3] / far).mean() + _DIRECTION_WEIGHT * error[:, 3:].mean()
    return mean
